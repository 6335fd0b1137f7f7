import numpy as np
import pytest

from bench.runs.rates import rate_records

SIZES = np.array([1000, 2000, 4000, 8000, 16000])


def jobs(curve, sizes, qualities, seeds=1):
    return [
        {
            "curve": curve,
            "label": f"{curve} rate={i}",
            "bytes": {"total": int(size)},
            "scores": {"heldout": {"metrics": {"psnr_display": {"pooled": quality}}}},
        }
        for i, (size, quality) in enumerate(zip(sizes, qualities, strict=True))
        for _ in range(seeds)
    ]


QUALITY = [20.0, 23.0, 26.0, 29.0, 32.0]
ANCHOR = jobs("pca", SIZES, QUALITY)


def test_half_the_bytes_at_equal_quality_are_minus_fifty_percent():
    (record,) = rate_records(ANCHOR + jobs("vq", SIZES // 2, QUALITY, seeds=3))
    assert record["curve"] == "vq"
    assert record["bd_rate_percent"] == pytest.approx(-50)
    # Quality rises by 3 dB a doubling, so half the bytes are worth 3 dB.
    assert record["bd_psnr_db"] == pytest.approx(3)
    assert record["quality_overlap"] == pytest.approx(1)
    assert record["quality_db"] == pytest.approx([20, 32])


def test_curves_that_share_no_quality_have_a_reason_instead_of_a_number():
    (record,) = rate_records(ANCHOR + jobs("vq", SIZES, [40.0, 41.0, 42.0, 43.0, 44.0]))
    assert "share no quality" in record["error"]
    assert "bd_rate_percent" not in record


def test_short_ladders_and_a_missing_anchor_give_no_record():
    assert list(rate_records(ANCHOR + jobs("table", SIZES[:1], [33.0]))) == []
    assert list(rate_records(jobs("vq", SIZES, QUALITY))) == []


def test_a_job_without_any_error_has_no_point():
    (record,) = rate_records(ANCHOR + jobs("vq", SIZES, [None, 23.0, 26.0, 29.0, 32.0]))
    assert len(record["points"]) == 4
