"""Rungs, and the limits that they meet or miss."""

from bench.compare.choosing import Limits, Rung, best_rung, has_validation, usable_rungs


def rung(name, size, score, time=None):
    return Rung(size, score, time, of=name)


def test_equals_go_to_the_smaller_file_then_to_the_faster_then_to_the_first():
    several = [rung("large", 3, 30.0, time=1.0), rung("slow", 2, 30.0, time=9.0), rung("fast", 2, 30.0, time=5.0)]
    assert best_rung([*several, rung("unknown", 2, 30.0)], Limits(size=9)).of == "fast"
    assert best_rung([rung("first", 2, 30.0), rung("second", 2, 30.0)], Limits(size=9)).of == "first"


def test_a_score_is_missed_by_decibels_over_ten_and_sizes_by_shares():
    assert Limits(score=40.0, size=8).misses(rung("a", 12, 30.0)) == {"size": 0.5, "score": 1.0}


def test_choices_without_an_error_and_with_validation_pairs_are_rungs():
    good = {
        "material": "satin",
        "label": "pca",
        "bytes": 9,
        "ns_per_sample": 5.0,
        "validation": {"mean": 30.0, "slices": 4},
    }
    good |= {"ratio_to_floor": 2.0, "ratio_interval95": [1.5, 2.4]}
    others = [good | {"error": "none"}, good | {"material": "brick"}, good | {"validation": {"slices": 0}}]
    others.append(good | {"label": "table", "codec": "table"})  # uncompressed
    assert usable_rungs([*others, good], "satin") == [Rung(9, 30.0, 6.0, good)]


def test_only_a_job_with_scores_of_validation_and_of_test_pairs_may_be_chosen():
    group = {"metrics": {"psnr_display": {"mean": 30.0}}}
    assert has_validation({"scores": {"heldout": group, "validation": group}})
    for job in ({}, {"scores": {"heldout": group}}, {"scores": {"all": group, "validation": group}}):
        assert not has_validation(job)
