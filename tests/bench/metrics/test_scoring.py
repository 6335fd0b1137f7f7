import json
import threading
import weakref
from unittest.mock import Mock

import numpy as np
import pytest

from bench import metrics
from bench.btf import BTF, ArraySource, box_filter
from bench.inputs.errors import InputError
from bench.metrics import display, scoring
from bench.metrics.scoring import Scorer, footprint_errors, polar_maps, summarise, summarise_footprints
from bench.records import MOST_DB


def make(count=20, shape=(16, 18), seed=0, periodic=True):
    """A small BTF of noise, pairs from the normal to 80°, and a decoding of it that is a little wrong."""
    rng = np.random.default_rng(seed)
    values = rng.random((count, *shape, 3), dtype=np.float32) ** 2 * 3
    theta, phi = np.radians(rng.uniform(0, 80, (2, count))), rng.uniform(0, 2 * np.pi, (2, count))
    wo, wi = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], -1)
    decoded = values * (1 + 0.1 * rng.standard_normal(values.shape, dtype=np.float32))
    return BTF("noise", wo, wi, ArraySource(values), periodic=periodic), decoded


def test_raw_numbers_are_those_of_each_metric_on_each_slice():
    btf, decoded = make()
    pairs = [3, 0, 17, 5, 6]
    names = [*metrics.chosen_names(metrics.DEFAULTS, True), "ssim", "flip_ldr_20ppd"]
    scores = Scorer(btf, names, exposure=0.5).score(pairs, lambda i: decoded[i])
    assert scores.pairs.tolist() == pairs
    for name in names:
        metric = metrics.get(name).load()
        expected = [metric.score(metric.prepare(btf[i], 0.5), decoded[i]) for i in pairs]
        np.testing.assert_allclose(scores.raw[name], expected, rtol=1e-12)
    np.testing.assert_allclose(scores.radiance, [btf[i].mean() for i in pairs], rtol=1e-5)


def test_the_error_of_the_abrdf_is_the_log_error_of_each_texel():
    btf, decoded = make()
    scores = Scorer(btf, ["psnr_log1p"]).score(np.arange(20), lambda i: decoded[i])
    truth = np.log1p(8 * scores.exposure * np.stack(list(btf)))
    error = (np.log1p(8 * scores.exposure * decoded.clip(0)) - truth) ** 2
    np.testing.assert_allclose(scores.abrdf, error.mean((0, 3)), rtol=1e-4)
    assert scores.abrdf.mean() == pytest.approx(scores.raw["psnr_log1p"].mean(), rel=1e-12)


def test_the_reference_is_read_once_for_many_codecs_and_the_byte_limit_changes_no_number():
    btf, decoded = make(40, (64, 64))
    btf.source.slice = read = Mock(side_effect=btf.source.slice)
    roomy, tight = Scorer(btf, exposure=1.0), Scorer(btf, cache_bytes=0, exposure=1.0)
    assert read.call_count == 0  # a known exposure needs no sample
    expected = roomy.score(np.arange(40), lambda i: decoded[i])
    roomy.score(np.arange(40), lambda i: decoded[i])
    assert read.call_count == 40
    for _ in range(2):
        scores = tight.score(np.arange(40), lambda i: decoded[i])
    assert read.call_count == 120
    assert all((scores.raw[name] == expected.raw[name]).all() for name in scores.raw)
    assert (scores.abrdf == expected.abrdf).all()


@pytest.mark.parametrize("threads", [1, 3])
def test_numbers_do_not_depend_on_threads_and_the_decoder_runs_in_the_callers(threads):
    btf, decoded = make(40, (64, 64))
    seen = set()

    def decode(i):
        seen.add(threading.current_thread())
        return decoded[i]

    expected = Scorer(btf, threads=2).score(np.arange(40), decode)
    scores = Scorer(btf, threads=threads).score(np.arange(40), decode)
    assert seen == {threading.current_thread()}
    assert all((scores.raw[name] == expected.raw[name]).all() for name in scores.raw)
    assert (scores.abrdf == expected.abrdf).all()


def test_few_slices_are_in_memory_at_once(monkeypatch):
    monkeypatch.setattr(scoring, "_STACK_TEXELS", 1)
    btf, decoded = make(60, (32, 32))
    slices, alive = [], []

    def decode(i):
        picture = decoded[i].copy()
        slices.append(weakref.ref(picture))
        alive.append(sum(each() is not None for each in slices))
        return picture

    Scorer(btf, threads=2, cache_bytes=0).score(np.arange(60), decode)
    assert max(alive) <= 2


@pytest.mark.parametrize("spoil", [lambda x: x * np.nan, lambda x: x[:-1], lambda x: (x * 255).astype(np.uint8)])
def test_a_bad_slice_is_named(spoil):
    btf, decoded = make(periodic=False)
    with pytest.raises(InputError, match="pair 7"):
        Scorer(btf).score(np.arange(20), lambda i: spoil(decoded[i]) if i == 7 else decoded[i])
    btf.source.values[5, 1, 1, 1] = np.nan
    with pytest.raises(InputError, match="noise: pair 5: "):
        Scorer(btf, exposure=1.0).score(np.arange(20), lambda i: decoded[i])
    with pytest.raises(InputError, match="ssim_periodic"):
        Scorer(btf, ["ssim_periodic"])


def test_a_metric_that_does_not_apply_is_none():
    btf, decoded = make(shape=(8, 8), periodic=False)
    scores = Scorer(btf).score(np.arange(20), lambda i: decoded[i])
    assert np.isnan(scores.raw["ssim"]).all()
    stats = summarise(scores, btf.wo, btf.wi, {"all": np.arange(20)})["all"]["metrics"]["ssim"]
    assert stats == {"mean": None, "std": None, "pooled": None, "exact": 0, "slices": 0}


def test_hdr_flip_has_one_range_for_the_material():
    btf, decoded = make(6)
    scorer = Scorer(btf, ["flip_hdr_67ppd_periodic"])
    scores = scorer.score(np.arange(6), lambda i: decoded[i])
    errors = scores.raw["flip_hdr_67ppd_periodic"]
    metric = scorer.metrics["flip_hdr_67ppd_periodic"]
    assert errors == pytest.approx([metric.score(metric.prepare(btf[i], 1.0), decoded[i]) for i in range(6)])
    assert scores.fixed == {"flip_hdr_67ppd_periodic": {"start": metric.range.start, "stop": metric.range.stop}}


def test_exposure_of_a_large_material_is_a_seeded_sample(monkeypatch):
    btf, _ = make(40, (32, 32))
    bright = np.percentile(np.percentile(btf.source.values, 99, axis=(1, 2, 3)), 90)
    assert Scorer(btf).exposure == pytest.approx(0.8 / bright)
    monkeypatch.setattr(display, "SAMPLE_VALUES", 60_000)
    assert display.sample(btf).shape == (40, 500, 3)
    assert display.exposure(btf, seed=1) == display.exposure(btf, seed=1) != display.exposure(btf, seed=2)
    # 1,500 values of each slice, of a smooth density, put the percentiles within a percent or so.
    assert display.exposure(btf) == pytest.approx(0.8 / bright, rel=0.02)
    monkeypatch.setattr(display, "SAMPLE_SLICES", 8)
    assert display.sample(btf).shape == (8, 2_500, 3)


def summary():
    btf, decoded = make(200)
    decoded[4] = btf[4]
    groups = {"training": np.arange(0, 150), "heldout": np.arange(150, 200)}
    scores = Scorer(btf, ["psnr_display", "rmse_linear", "ssim_periodic"]).score(
        np.arange(100, 200), lambda i: decoded[i]
    )
    return btf, scores, groups


def test_groups_are_of_the_pairs_that_were_scored():
    btf, scores, groups = summary()
    table = summarise(scores, btf.wo, btf.wi, groups)
    assert (table["training"]["slices"], table["heldout"]["slices"]) == (50, 50)
    theta = np.degrees(np.arccos(btf.wo[100:, 2]))
    assert table["grazing view"]["slices"] == (theta > 60).sum() > 0
    assert table["heldout, grazing view"]["slices"] == (theta[50:] > 60).sum()
    assert {"grazing light", "heldout, grazing light", "training, grazing view"} <= set(table)
    maps = polar_maps(scores, btf.wo, btf.wi)
    assert np.shape(maps["psnr_display"]["view"]["value"]) == (6, 12)
    json.dumps([table, maps], allow_nan=False)


def test_statistics_of_a_group():
    btf, scores, groups = summary()
    stats = summarise(scores, btf.wo, btf.wi, groups)["heldout"]
    mse = scores.raw["psnr_display"][50:]
    assert stats["metrics"]["psnr_display"]["pooled"] == pytest.approx(-10 * np.log10(mse.mean()))
    assert stats["metrics"]["psnr_display"]["mean"] == pytest.approx(np.mean(-10 * np.log10(mse)))
    assert stats["metrics"]["psnr_display"]["std"] == pytest.approx(np.std(-10 * np.log10(mse)))
    worst = np.sort(-10 * np.log10(mse))[: int(np.ceil(len(mse) / 10))]
    assert stats["metrics"]["psnr_display"]["worst"] == pytest.approx(worst.mean())
    assert "worst" not in stats["metrics"]["rmse_linear"]
    relative = np.sqrt(scores.raw["rmse_linear"][50:].mean()) / scores.radiance[50:].mean()
    assert stats["metrics"]["rmse_linear"]["relative"] == pytest.approx(relative)


def test_exact_slices_are_counted_and_have_the_most_decibels():
    btf, decoded = make(4)
    decoded[:2] = np.stack([btf[0], btf[1]])
    scores = Scorer(btf).score(np.arange(4), lambda i: decoded[i])
    table = summarise(
        scores, btf.wo, btf.wi, {"all": np.arange(4), "equal": np.array([0, 1]), "none": np.array([], int)}
    )
    psnr = table["all"]["metrics"]["psnr_display"]
    assert (psnr["exact"], psnr["slices"]) == (2, 4)
    assert psnr["mean"] == pytest.approx(MOST_DB / 2 - 5 * np.log10(scores.raw["psnr_display"][2:]).mean())
    assert [table["equal"]["metrics"]["psnr_display"][name] for name in ("mean", "pooled", "worst")] == [MOST_DB] * 3
    assert table["none"]["metrics"]["psnr_display"]["worst"] is None
    assert all(stats["exact"] == 2 for stats in table["equal"]["metrics"].values())
    assert table["none"]["slices"] == 0
    json.dumps(table, allow_nan=False)


def boxes_of(pictures):
    """What decodes pair i of these pictures at some footprints."""
    return lambda i, factors: {factor: box_filter(pictures[i], factor) for factor in factors}


def test_footprints_are_compared_with_box_filtered_truth():
    btf, decoded = make(shape=(16, 18))
    summary = summarise_footprints(footprint_errors(btf, [1, 4], boxes_of(btf), 0.5))
    assert list(summary) == ["1", "2", "4", "8"]
    assert all(
        entry == {"psnr_display": MOST_DB, "mean": MOST_DB, "exact": 2, "slices": 2} for entry in summary.values()
    )
    summary = summarise_footprints(footprint_errors(btf, [1, 4], boxes_of(decoded), 0.5))
    # Averaging removes independent noise, so the error falls with the footprint.
    values = [entry["psnr_display"] for entry in summary.values()]
    assert values == sorted(values)
    single = Scorer(btf, ["psnr_display"], exposure=0.5).score([1, 4], lambda i: decoded[i])
    assert values[0] == pytest.approx(-10 * np.log10(single.raw["psnr_display"].mean()), abs=1e-5)


def test_a_footprint_larger_than_the_picture_is_left_out_and_a_wrong_size_refused():
    btf, decoded = make(shape=(4, 4))
    assert list(footprint_errors(btf, [0], boxes_of(decoded), 1.0)) == [1, 2, 4]
    with pytest.raises(InputError, match=r"pair 0 .*footprint 2"):
        footprint_errors(btf, [0], lambda i, factors: dict.fromkeys(factors, decoded[i]), 1.0)
