import numpy as np
import pytest

from baselines.mean_colour import MeanColour
from baselines.table import Table
from bench.conformance.check import tiny_btf
from bench.demand.frame_scorer import FLIP, PSNR, FrameScorer, table_of
from bench.demand.pair_weights import pair_shares
from bench.demand.truth import truth
from bench.hemisphere import uniform
from bench.metrics.display import to_display
from bench.metrics.scoring import Scorer, summarise, weighted
from tests.baselines.made import decoded
from tests.bench.demand.scenes import camera, demand_of, light, surface

SCENE = (
    camera(32, 24, 40, [0, -1, 2])
    + surface(size=[1.2, 1.2], repeat=[2, 2])
    + light("point", position=[0.5, 0, 2], intensity=[4, 4, 4])
)


def demand(text=SCENE):
    return demand_of(text)


def test_the_reference_at_a_pair_and_a_texel_is_the_btf_itself():
    btf, queries = tiny_btf(8, 6, 6), demand()
    rng = np.random.default_rng(0)
    pair, row, col = (rng.integers(0, n, len(queries)) for n in (36, 8, 8))
    columns = {"wo": btf.wo[pair], "wi": btf.wi[pair], "footprint": np.zeros(len(queries), np.float32)}
    columns["place"] = np.stack([(col + 0.5) / 8, 1 - (row + 0.5) / 8], 1).astype(np.float32)
    exact = type(queries)(**(vars(queries) | columns))
    np.testing.assert_allclose(truth(btf, exact), btf.gather(pair, row, col), atol=2e-5)


def test_the_reference_over_a_box_is_its_mean():
    btf, queries = tiny_btf(8, 6, 6), demand()
    count = len(queries)
    columns = {"wo": np.repeat(btf.wo[7:8], count, 0), "wi": np.repeat(btf.wi[7:8], count, 0)}
    columns["footprint"] = np.full(count, 0.5, np.float32)  # four texels
    columns["place"] = np.full((count, 2), 0.25, np.float32)  # the middle of the box at the lower left
    box = type(queries)(**(vars(queries) | columns))
    np.testing.assert_allclose(truth(btf, box)[0], btf[7][4:, :4].mean((0, 1)), atol=1e-5)


def test_the_table_makes_the_frames_of_the_reference_and_a_mean_colour_does_not():
    coarse = SCENE.replace("repeat = [2, 2]", "repeat = [1, 1]")  # a pixel is smaller than a texel
    btf, queries = tiny_btf(8, 6, 6), demand(coarse)
    scorer = FrameScorer(btf, queries)
    exact, plain = (scorer.score(decoded(codec, btf)) for codec in (Table(), MeanColour()))
    assert exact[PSNR] > 60  # the table is of half floats
    assert exact[FLIP] < 0.005
    assert plain[PSNR] < 40 < exact[PSNR]
    seen = scorer.seen
    truth, ours = scorer.truth, scorer.frames(decoded(MeanColour(), btf))
    error = np.square(to_display(truth, scorer.exposure) - to_display(ours, scorer.exposure))[seen].mean()
    assert plain[PSNR] == pytest.approx(-10 * np.log10(error))


def test_pixels_without_material_do_not_count():
    btf = tiny_btf(8, 6, 6)
    text = SCENE.replace("[1.2, 1.2]", "[0.3, 0.3]").replace("repeat = [2, 2]", "repeat = [0.5, 0.5]")
    scorer = FrameScorer(btf, demand(text))
    assert 0.01 < scorer.seen.mean() < 0.3
    grey = scorer.frames(decoded(MeanColour(), btf))
    worse = np.where(scorer.seen[..., None], grey, 9.0)
    assert scorer.compare(worse, (PSNR,)) == scorer.compare(grey, (PSNR,))


def test_a_table_whose_held_out_pairs_are_scattered_is_that_of_the_training_pairs():
    btf = tiny_btf(8, 6, 6)
    assert table_of(btf) is btf
    mask = np.zeros(36, bool)
    mask[5] = True
    scattered = type(btf)("a", btf.wo[:35], btf.wi[:35], btf.source, heldout=mask[:35], pairs=np.arange(35))
    assert len(table_of(scattered)) == 34


def test_shares_of_pairs_add_up_and_lie_where_the_scene_looks():
    btf, queries = tiny_btf(8, 9, 9), demand()
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


def test_directions_at_random_have_shares_everywhere():
    btf, queries = tiny_btf(8, 6, 6), demand()
    rng = np.random.default_rng(0)
    columns = {name: uniform(rng, len(queries)) for name in ("wo", "wi")}
    assert (pair_shares(btf.layout, type(queries)(**(vars(queries) | columns))) > 0).all()
