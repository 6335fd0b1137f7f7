from dataclasses import replace

import numpy as np
import pytest

from baselines.mean_colour import MeanColour
from baselines.neumip import NeuMIP
from baselines.table import Table
from bench.btf import BTF, ArraySource
from bench.conformance.check import tiny_btf
from bench.demand.frame_scorer import FLIP, PSNR, FrameScorer, truth
from bench.demand.needed_part import pair_shares
from bench.metrics.display import to_display
from bench.metrics.scoring import Scorer, summarise, weighted
from bench.records import MOST_DB
from tests.baselines.made import decoded
from tests.bench.demand.scenes import camera, demand_of, light, surface

SCENE = (
    camera(32, 24, 40, [0, -1, 2])
    + surface(size=[1.2, 1.2], repeat=[2, 2])
    + light("point", position=[0.5, 0, 2], intensity=[4, 4, 4])
)


def test_the_reference_at_a_pair_and_a_texel_is_the_btf_itself_and_over_a_box_its_mean():
    btf, queries = tiny_btf(8, 6, 6), demand_of(SCENE)
    count = len(queries)
    rng = np.random.default_rng(0)
    pair, row, col = (rng.integers(0, n, count) for n in (36, 8, 8))
    place = np.stack([(col + 0.5) / 8, 1 - (row + 0.5) / 8], 1).astype(np.float32)
    exact = replace(queries, wo=btf.wo[pair], wi=btf.wi[pair], footprint=np.zeros(count, np.float32), place=place)
    np.testing.assert_allclose(truth(btf, exact), btf.gather(pair, row, col), atol=2e-5)
    size, corner = np.full(count, 0.5, np.float32), np.full((count, 2), 0.25, np.float32)  # four texels, lower left
    box = replace(exact, footprint=size, place=corner)
    expected = np.stack([btf[p][4:, :4].mean((0, 1)) for p in pair[:9]])
    np.testing.assert_allclose(truth(btf, box)[:9], expected, atol=1e-5)


def test_the_table_makes_the_frames_of_the_reference_and_a_mean_colour_does_not():
    coarse = SCENE.replace("repeat = [2, 2]", "repeat = [1, 1]")  # a pixel is smaller than a texel
    btf, queries = tiny_btf(8, 6, 6), demand_of(coarse)
    scorer = FrameScorer(btf, queries)
    exact, plain = (scorer.score(decoded(codec, btf)) for codec in (Table(), MeanColour()))
    assert exact[PSNR] == MOST_DB  # the table is of half floats
    assert exact[FLIP] < 0.005
    assert plain[PSNR] < 40 < exact[PSNR]
    seen = scorer.seen
    truth, ours = scorer.truth, scorer.frames(decoded(MeanColour(), btf))
    error = np.square(to_display(truth, scorer.exposure) - to_display(ours, scorer.exposure))[seen].mean()
    assert plain[PSNR] == pytest.approx(-10 * np.log10(error))


def test_a_table_that_is_asked_at_points_has_the_frames_of_one_without_a_level_of_detail():
    rng = np.random.default_rng(0)
    fine = tiny_btf(32, 6, 6)
    noisy = BTF("noisy", fine.wo, fine.wi, ArraySource(rng.random((36, 32, 32, 3), np.float32)), periodic=True)
    scorer = FrameScorer(noisy, demand_of(SCENE.replace("repeat = [2, 2]", "repeat = [9, 9]")))
    table, filtering = decoded(Table(), noisy), decoded(NeuMIP(steps=4, batch=64), noisy)
    aliased = scorer.compare(scorer.at_points, (PSNR,))[PSNR]
    assert scorer.score(table, (PSNR,))[PSNR] == pytest.approx(aliased, abs=0.05)
    assert aliased < 30
    assert not scorer.filters(table)
    assert scorer.filters(filtering)


def test_pixels_without_material_do_not_count():
    btf = tiny_btf(8, 6, 6)
    text = SCENE.replace("[1.2, 1.2]", "[0.3, 0.3]").replace("repeat = [2, 2]", "repeat = [0.5, 0.5]")
    scorer = FrameScorer(btf, demand_of(text))
    assert 0.01 < scorer.seen.mean() < 0.3
    grey = scorer.frames(decoded(MeanColour(), btf))
    worse = np.where(scorer.seen[..., None], grey, 9.0)
    assert scorer.compare(worse, (PSNR,)) == scorer.compare(grey, (PSNR,))


def test_stored_frames_are_few_small_and_what_a_display_shows(monkeypatch):
    monkeypatch.setattr("bench.demand.frame_scorer.KEPT_SIDE", 12)
    places = ", ".join(f"{{position = [0, {y}, 2]}}" for y in (-1, -0.5, 0.2, 1))
    moving = SCENE.replace("position = [0, -1, 2]", f"path = [{places}]")
    scorer = FrameScorer(tiny_btf(8, 6, 6), demand_of(moving))
    frames = scorer.truth / 2
    kept = scorer.pictures(frames)
    assert kept["truth"].shape == kept["decoded"].shape == (3, 8, 10, 3)  # 24 × 32 in boxes of 3 × 3
    assert kept["truth"].dtype == np.uint8
    for name, whole in (("truth", scorer.truth), ("decoded", frames)):
        box = whole[3][12:15, 15:18].mean((0, 1))  # in the last of the four
        assert box.min() > 0
        np.testing.assert_array_equal(kept[name][2, 4, 5], np.round(255 * to_display(box, scorer.exposure)))


def test_shares_of_pairs_add_up_and_lie_where_the_scene_looks():
    btf, queries = tiny_btf(8, 9, 9), demand_of(SCENE)
    share = pair_shares(btf.layout, queries)
    assert share.sum() == pytest.approx(1)
    middle = share @ btf.wo
    assert np.degrees(np.arccos(middle @ (queries.importance @ queries.wo) / np.linalg.norm(middle))) < 12


def test_weighted_statistics_of_equal_shares_are_the_plain_ones():
    btf = tiny_btf(12, 4, 4)
    material = decoded(MeanColour(), btf)
    scores = Scorer(btf).score(range(16), lambda i: material.slice(btf.wo[i].tolist(), btf.wi[i].tolist()).numpy())
    plain = summarise(scores, btf.wo, btf.wi, {"all": np.arange(16)})["all"]
    even = weighted(scores, np.full(16, 1 / 16))
    for name, stats in plain["metrics"].items():
        stats.pop("worst", None)  # `weighted` leaves it out
        assert even["metrics"][name] == pytest.approx(stats, nan_ok=True), name
    one_pair = weighted(scores, np.eye(16)[3])
    assert one_pair["slices"] == 1
    assert one_pair["metrics"]["psnr_display"]["pooled"] == pytest.approx(-10 * np.log10(scores.raw["psnr_display"][3]))
