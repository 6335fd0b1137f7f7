import numpy as np
import pytest

from bench.compare.rates import deltas, fronts

SIZES = np.array([1000, 2000, 4000, 8000, 16000])
QUALITY = [20.0, 23.0, 26.0, 29.0, 32.0]


def jobs(codec, sizes, qualities, seeds=1, **settings):
    return [
        {
            "codec": codec,
            "label": f"{codec} rate={size}",
            "settings": settings,
            "bytes": {"total": int(size)},
            "scores": {"heldout": {"metrics": {"psnr_display": {"pooled": quality}}}},
        }
        for size, quality in zip(sizes, qualities, strict=True)
        for _ in range(seeds)
    ]


def test_half_the_bytes_at_equal_quality_are_minus_fifty_percent_and_twice_them_against_the_other():
    worth = deltas(fronts(jobs("pca", SIZES, QUALITY) + jobs("vq", SIZES // 2, QUALITY, seeds=3)))
    assert worth["vq", "pca"].rate.value == pytest.approx(-50)
    assert worth["pca", "vq"].rate.value == pytest.approx(100)
    # Quality rises by 3 dB a doubling, so half the bytes are worth 3 dB.
    assert worth["vq", "pca"].quality.value == pytest.approx(3)
    assert worth["vq", "pca"].rate.overlap == pytest.approx(1)
    assert set(worth) == {("vq", "pca"), ("pca", "vq")}


def test_fronts_that_share_no_quality_are_compared_at_equal_bytes_alone():
    worth = deltas(fronts(jobs("pca", SIZES, QUALITY) + jobs("vq", SIZES, [40.0, 41.0, 42.0, 43.0, 44.0])))
    assert worth["vq", "pca"].rate is None
    assert worth["vq", "pca"].quality.value == pytest.approx(16)


def test_a_front_leaves_out_what_a_smaller_file_of_the_codec_beats():
    worse = jobs("pca", [3000, 4000], [22.0, 25.0])
    front = fronts(jobs("pca", SIZES, QUALITY) + worse[:1] + [worse[1] | {"label": "pca of other settings"}])["pca"]
    assert front.tolist() == [[size, quality] for size, quality in zip(SIZES, QUALITY, strict=True)]


def test_a_published_recipe_is_a_codec_of_its_own():
    both = jobs("neumip", SIZES, QUALITY, recipe="ours") + jobs("neumip", SIZES * 2, QUALITY, recipe="paper")
    assert deltas(fronts(both))["neumip", "neumip recipe=paper"].rate.value == pytest.approx(-50)


def test_short_fronts_and_jobs_without_a_quality_have_none():
    assert deltas(fronts(jobs("pca", SIZES, QUALITY) + jobs("table", SIZES[:1], [33.0]))) == {}
    points = fronts(jobs("vq", SIZES, [None, 23.0, 26.0, 29.0, 32.0]))["vq"]
    assert len(points) == 4
