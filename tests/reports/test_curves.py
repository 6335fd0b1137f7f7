"""The tables of curves: Bjøntegaard's differences, and three metrics at one size."""

from bench.records import FLIP, PSNR, SSIM
from reports.curves import curves_tables
from tests.reports.test_rungs import at_bits, run_of


def rungs(codec, material, ahead, **more):
    similar = {SSIM + "_periodic": {"mean": 0.9}, FLIP: {"mean": 0.1}}
    jobs = []
    for bits, value in ((4, 20.0), (16, 30.0), (64, 40.0)):
        each = at_bits(f"{codec} x={bits}", bits, value, value + ahead, material=material, **more)
        each["scores"]["heldout"]["metrics"] |= similar
        jobs.append(each)
    return jobs


def tables(tmp_path, *jobs):
    return list(curves_tables(run_of(tmp_path / "run", *jobs)))


def test_differences_are_shown_with_median_interval_surfaces_and_bytes(tmp_path):
    jobs = []
    for number in range(10):
        jobs += rungs("neubtf-direct", f"m{number}", 0.0)
        jobs += rungs("neumip", f"m{number}", 2.5 if number else -5.0)
    (against, *_) = tables(tmp_path, *jobs)
    (row,) = against.rows
    named = dict(zip((" ".join(header) for header in against.headers), row, strict=True))
    assert named["codec "] == "neumip"
    assert (named["all dB ↑"], named["ahead on ↑"]) == ("+2.5", "9 of 10")
    assert named["measured, 10 dB ↑"].startswith("+2.5 (")
    assert named["BD-rate median ↓"] == "−29 %"  # 2.5 dB of 5 a doubling: 2^−0.5 of the bytes
    assert "10 surfaces" in against.notes[0]
    assert named["95 % interval of the median"] == "+2.5 to +2.5*"  # one of ten surfaces hardly moves a median


def test_a_codec_that_never_comes_to_the_others_quality_takes_more_bytes_than_any(tmp_path):
    """On two of three surfaces it stays below; on the third it is level. And no kind has a mean over a part of it."""
    jobs = []
    for material, behind in (("satin", -25.0), ("rock", -25.0), ("wool", 0.0)):
        jobs += rungs("neubtf-direct", material, 0.0)
        jobs += rungs("pca", material, behind)
        if material != "rock":
            jobs += rungs("vq", material, -1.0)
    (against, *_) = tables(tmp_path, *jobs)
    rates = {row[0]: row[-1] for row in against.rows}
    assert rates["pca"] == "∞"
    measured = against.headers.index(("measured, 3", "dB ↑"))
    assert {row[0]: row[measured] for row in against.rows} == {"vq": "—", "pca": "−25.0 (−25.0 to +0.0)"}


def test_nothing_is_told_apart_on_few_surfaces(tmp_path):
    (against, *_) = tables(tmp_path, *rungs("neubtf-direct", "satin", 0.0), *rungs("neumip", "satin", 9.0))
    assert "10 surfaces" in against.notes[0]
    assert "*" not in "".join(against.rows[0])


def test_a_run_without_three_rungs_of_a_codec_has_no_such_table(tmp_path):
    assert tables(tmp_path, *rungs("pca", "satin", 0.0)[:2]) == []


def test_footprints_are_read_off_at_one_size_and_the_best_at_a_distance_comes_first(tmp_path):
    def with_footprints(jobs, gain):
        for job in jobs:
            mean = job["scores"]["heldout"]["metrics"][PSNR]["mean"]
            sides = {"1": mean, "2": mean + gain / 3, "4": mean + gain / 2, "8": mean + gain}
            job["footprints"] = {side: {"mean": value} for side, value in sides.items()}
        return jobs

    filters = with_footprints(rungs("neumip", "satin", -1.0), 3.0)
    aliases = with_footprints(rungs("neubtf-direct", "satin", 0.0), -6.0)
    table = tables(tmp_path, *filters, *aliases)[-1]
    assert table.title.endswith("footprint")
    assert table.rows == [
        ["neumip", "34.0", "35.0", "35.5", "37.0"],
        ["neubtf-direct", "35.0", "33.0", "32.0", "29.0"],
    ]


def test_jobs_without_a_score_of_validation_pairs_are_counted_below(tmp_path):
    (without, *_) = rungs("vq", "m0", 0.0)
    del without["scores"]["validation"]
    *_, last = tables(tmp_path, *rungs("pca", "m0", 0.0), without)
    assert "1 of made, without a score of validation pairs" in last.notes[-1]
