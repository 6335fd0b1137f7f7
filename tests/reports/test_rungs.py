"""The rungs of a run: their choice within budgets, the curves that they make, and what is read off these."""

import numpy as np
import pytest

from bench.compare.frame import EAGER, FUSED, line_of, setting_of
from bench.compare.statistics import Curve, bd_psnr
from bench.records import FLIP, MOST_DB, PSNR, append, load_run
from reports.curves import curves_tables
from reports.front import front_table, mean_ranks, when_table
from reports.rungs import BITS, BYTES, DRAWS, Budget, Hull, _drawn, _weights, rungs_of, summarised
from reports.table import BOLD

SIDE = 64
METRICS = {PSNR: {"unit": "dB", "direction": "higher", "space": "display", "version": 1}}


def group(psnr, **more):
    return {"slices": 4, "metrics": {PSNR: {"pooled": psnr, "mean": psnr, "exact": 0, "slices": 4} | more}}


def job(label, size, validation, test=20.0, material="satin", seed=0, **more):
    scores = {"heldout": group(test), "train": group(50.0)}
    scores |= {} if validation is None else {"validation": group(validation)}
    recipe = {"recipe": "paper"} if "recipe=paper" in label else {}
    key = {"btf": "f", "exposure": 1.0, "sha256": "0", "metrics": {PSNR: 1}}
    record = {"kind": "job", "job": f"{material}/{label}/{seed}", "run": "1", "material": material, "label": label}
    record |= {"codec": label.split()[0], "seed": seed, "status": "ok", "shape": [SIDE, SIDE], "score_key": key}
    record |= {"settings": {"label": label} | recipe, "bytes": {"total": size}, "parameters": 1, "metrics": METRICS}
    return record | {"scores": scores} | more


def timing(job, ratio, **more):
    known = {"kind": "timing", "job": job, "run": "1", "ns_per_sample": 1.0, "interval95_ns": [1.0, 1.0]}
    return known | {"ratio_to_floor": ratio, "ratio_interval95": [ratio, ratio]} | more


def run_of(folder, *records):
    folder.mkdir(exist_ok=True)
    machine = {"processor": "a processor", "cores": 2}
    append(folder, {"kind": "run", "run": "1", "suite": "made", "machine": machine})
    for record in records:
        append(folder, record)
    return load_run(folder)


def picks(run, budget, material="satin"):
    rungs = rungs_of(run)
    return {line: rungs.frame.at[rung, "setting"] for line, rung in rungs.picks(budget, [material])[material].items()}


def test_the_best_that_fits_is_chosen_and_one_that_is_a_byte_too_large_is_not(tmp_path):
    fits = 16 * SIDE * SIDE // 8
    run = run_of(tmp_path / "run", job("a x=1", fits, 30.0), job("a x=2", fits + 1, 40.0), job("a x=3", 10, 20.0))
    assert (picks(run, Budget(BYTES, 16)), picks(run, Budget(BYTES, 32))) == ({"a": "x=1"}, {"a": "x=2"})


def test_a_model_of_a_scene_answers_for_that_scene_alone_and_is_never_chosen(tmp_path):
    of_scene = job("a scene", 5, 40.0, settings={"scene": True})
    run = run_of(tmp_path / "run", job("a x=1", 10, 10.0), of_scene)
    assert picks(run, Budget(BYTES, 16)) == {"a": "x=1"}
    assert rungs_of(run).without == []


def test_records_without_validation_are_never_chosen_and_are_told(tmp_path):
    run = run_of(tmp_path / "run", job("a x=1", 10, None, test=99.0), job("a x=2", 10, 10.0))
    assert picks(run, Budget(BYTES, 16)) == {"a": "x=2"}
    assert [each["label"] for each in rungs_of(run).without] == ["a x=1"]


def test_the_mean_over_slices_decides(tmp_path):
    pooled, steady = job("a pooled", 10, 30.0), job("a steady", 10, 31.0)
    pooled["scores"]["validation"]["metrics"][PSNR]["pooled"] = 50.0
    assert picks(run_of(tmp_path / "run", pooled, steady), Budget(BYTES, 16)) == {"a": "steady"}


def test_what_is_as_published_is_a_line_of_its_own(tmp_path):
    run = run_of(tmp_path / "run", job("a x=1", 10, 30.0), job("a recipe=paper x=1", 10, 40.0))
    assert picks(run, Budget(BYTES, 16)) == {"a": "x=1", "a, as published": "x=1"}
    assert line_of(job("a recipe=paper", 1, 1.0)) == "a, as published"
    assert setting_of(job("a recipe=paper", 1, 1.0)) == "default"


def test_seeds_make_one_rung_of_their_means_that_fits_where_their_mean_bytes_do(tmp_path):
    fits, at = 16 * SIDE * SIDE // 8, Budget(BYTES, 16)
    b = [job("b x=1", fits, 30.0), job("b x=1", fits + 2, 40.0, seed=1), job("b x=2", fits, 34.0)]
    run = run_of(tmp_path / "run", job("a x=1", fits - 1, 30.0, 20.0), job("a x=1", fits + 1, 40.0, 30.0, seed=1), *b)
    rungs = rungs_of(run)
    mean = rungs.of_picks(rungs.picks(at, ["satin"])).at["a", "satin"]
    assert (mean, picks(run, at)) == (25.0, {"a": "x=1", "b": "x=2"})


def test_told_apart_by_the_numbers_of_the_table_with_or_without_stored_slices(tmp_path):
    """Above what a display shows nothing counts: b is 5 dB ahead of the anchor there alone, and level with it below."""
    jobs = []
    for material, anchor in (("satin", 46.0), ("rock", 47.0), ("wool", 49.0), ("bark", 50.0)):
        jobs.append(job("neubtf-direct", 10, 40.0, anchor, material=material))
        jobs.append(job("a", 10, 40.0, anchor - 4.0, material=material))
        jobs.append(job("b", 10, 40.0, anchor + 5.0 if anchor > 48.13 else anchor, material=material))
    result = rungs_of(run_of(tmp_path / "run", *jobs))
    assert result.told_apart(Budget(BYTES, 16), ["satin", "rock", "wool", "bark"]) == {"a"}
    assert result.told_apart(Budget(BYTES, 16), ["satin", "rock"]) == set()


def test_other_test_scores_change_no_choice(tmp_path):
    def jobs(sign):
        return [job(f"a x={i}", 900 * i, 30.0 + i % 3, 30.0 + sign * i) for i in range(5)]

    runs = [run_of(tmp_path / str(sign), *jobs(sign)) for sign in (-1, 1)]
    first, second = ({budget: picks(run, budget) for budget in rungs_of(run).limits} for run in runs)
    assert first == second


def test_a_rung_fits_a_time_if_its_median_does(tmp_path):
    jobs = [job(f"a x={i}", 10, 30.0 + i) for i in range(3)]
    times = [timing(each["job"], 3.9 + 0.2 * i) for i, each in enumerate(jobs)]
    run = run_of(tmp_path / "run", *jobs, *times)
    assert (picks(run, Budget(EAGER, 4)), picks(run, Budget(EAGER, 8))) == ({"a": "x=0"}, {"a": "x=2"})
    assert rungs_of(run).frame[EAGER].tolist()[1] == 4.1


def test_fused_times_have_budgets_of_their_own(tmp_path):
    quality = {
        "codec": "a",
        "settings": {},
        "score_key": {"sha256": "0"},
        "psnr": 20.0,
        "worst": 9.0,
        "flip": 0.1,
        "bytes": 10,
        "limit_ns": 0.1,
    }
    of = {"material": "satin", "label": "a", "of": "satin/a/0", "execution": "fused", "threads": 1}
    fused = timing("satin/a/0/fused", 2.8, ratio_interval95=[2.5, 3.0], **of, **quality)
    fused |= {"dtype": "float32", "device": "cpu", "batch": 1}
    run = run_of(tmp_path / "run", job("a", 10, 30.0), timing("satin/a/0", 9.0), fused)
    assert (picks(run, Budget(FUSED, 4)), picks(run, Budget(EAGER, 8))) == ({"a": "default"}, {})


def test_rungs_over_several_surfaces_are_those_that_were_measured_on_each(tmp_path):
    both = [job("a x=1", 10, 30.0, 20.0, material) for material in ("satin", "brick")]
    found = rungs_of(run_of(tmp_path / "run", *both, job("a x=2", 10, 40.0, 30.0)))
    assert [found.ranked(Budget(BYTES, 16), on)["a"] for on in (["satin"], ["satin", "brick"])] == [30.0, 20.0]


def test_what_was_measured_on_other_data_than_last_is_left_out(tmp_path):
    old = job("a x=1", 10, 40.0)
    newest = job("a x=2", 10, 30.0, run="2")
    newest["score_key"] = newest["score_key"] | {"btf": "other"}
    run = run_of(tmp_path / "run", old, newest)
    assert picks(run, Budget(BYTES, 16)) == {"a": "x=2"}
    assert [each["label"] for each in rungs_of(run).unlike] == ["a x=1"]


def test_a_run_without_any_comparable_job_has_no_rungs(tmp_path):
    lacking = job("a x=1", 10, 40.0)
    del lacking["run"]  # without it nothing says whether the job is comparable
    found = rungs_of(run_of(tmp_path / "run", lacking))
    assert found.frame.empty
    assert [each["label"] for each in found.unlike] == ["a x=1"]
    assert list(front_table(load_run(tmp_path / "run"))) == []


def at_bits(label, bits, validation, test, **more):
    return job(label, round(bits * SIDE * SIDE / 8), validation, test, **more)


def curve_of(run, line, score="psnr", material="satin"):
    rungs = rungs_of(run)
    return rungs.curve(rungs.hulls[line][material], score)


def test_a_curve_has_the_rungs_on_the_hull_of_validation_pairs_with_their_scores_of_test_pairs(tmp_path):
    run = run_of(
        tmp_path / "run",
        at_bits("a x=1", 4, 20.0, 19.0),
        at_bits("a x=2", 8, 21.0, 99.0),  # below the line from 4 to 16 bits, whatever test pairs say
        at_bits("a x=3", 16, 30.0, 28.0),
        at_bits("a x=4", 32, 29.0, 99.0),  # larger and worse
        at_bits("a x=5", 64, 31.0, 30.5),
        at_bits("b x=1", 4, 20.0, 19.0),
        at_bits("b x=2", 8, 21.0, 20.0),  # two rungs are no curve
    )
    assert list(rungs_of(run).hulls) == ["a"]
    curve = curve_of(run, "a")
    assert curve.sizes == pytest.approx([2, 4, 6])
    assert curve.values == [19.0, 28.0, 30.5]


def test_a_curve_goes_on_level_from_its_best_rung_to_the_largest(tmp_path):
    """A file of 16 bits may be used where 32 are allowed; beyond the largest rung nothing is known."""
    run = run_of(
        tmp_path / "run",
        at_bits("a x=1", 4, 20.0, 19.0),
        at_bits("a x=2", 16, 30.0, 28.0),
        at_bits("a x=3", 32, 29.0, 27.0),
    )
    curve = curve_of(run, "a")
    assert curve.sizes == pytest.approx([2, 4, 5])
    assert curve.values == [19.0, 28.0, 28.0]
    rungs = rungs_of(run)
    assert rungs.read(32).at["a", "satin"] == 28.0
    assert rungs.read(33).isna().all(axis=None)
    assert rungs.read(33, to_end=True).at["a", "satin"] == 28.0


def test_seeds_count_by_their_mean(tmp_path):
    rungs = ((4, 20.0, 40.0), (8, 24.0, 56.0), (16, 26.0, 60.0))
    jobs = [at_bits(f"a x={bits}", bits, validation, test) for bits, validation, test in rungs]
    jobs.append(at_bits("a x=4", 4, 20.0, 44.0, seed=1))
    run = run_of(tmp_path / "run", *jobs)
    assert curve_of(run, "a").values == [42.0, 56.0, 60.0]
    assert curve_of(run, "a", "flip") is None  # a metric that a job lacks


def test_a_summary_has_an_interval_over_surfaces_and_tells_apart_only_with_enough_of_them(tmp_path):
    steady = {str(number): [1.0] * (1 + DRAWS) for number in range(12)}
    found = summarised(steady)
    assert found[:3] == (1.0, 12, 12)
    assert (found.low, found.high) == (1.0, 1.0)
    assert found.apart
    assert not summarised(dict(list(steady.items())[:9])).apart
    mixed = {str(number): [float(number % 2) - 0.4] * (1 + DRAWS) for number in range(12)}
    found = summarised(mixed)
    assert found.low < 0 < found.high
    assert not found.apart
    assert found.won == 6


def test_the_interval_of_one_surface_comes_from_draws_of_its_seeds(tmp_path):
    jobs = []
    for bits in (4, 8, 16):
        jobs += [at_bits(f"neubtf-direct x={bits}", bits, 20.0 + bits, 30.0)]
        jobs += [at_bits(f"b x={bits}", bits, 20.0 + bits, 30.0 + seed, seed=seed) for seed in (0, 2)]
    lead = rungs_of(run_of(tmp_path / "run", *jobs)).lead("b")
    assert lead.median == pytest.approx(1.0)
    assert 0.0 <= lead.low < 0.7
    assert 1.3 < lead.high <= 2.0


def test_draws_of_seeds_are_weighted_as_the_curves_that_they_make_are():
    """BD-PSNR is linear in the values of curves, so that no curve of a draw is made."""
    ours, theirs = Hull([2.0, 3.5, 5.0], [0, 1, 1]), Hull([1.0, 4.0], [2, 3])
    seeds = [[20.0, 21.0], [25.0], [18.0, 19.0, 23.0], [26.0, 24.0]]
    drawn = _drawn(seeds, np.random.default_rng(0))
    assert drawn.shape == (DRAWS, 4)
    assert set(drawn[:, 0]) == {20.0, 20.5, 21.0}
    assert set(drawn[:, 1]) == {25.0}
    a, b, c, d = drawn[7].tolist()
    gap = bd_psnr(Curve(ours.sizes, [a, b, b]), Curve(theirs.sizes, [c, d]))
    assert drawn[7] @ _weights(ours, theirs) == pytest.approx(gap)


LADDER = [at_bits(f"a x={bits}", bits, score, score) for bits, score in ((8, 20.0), (16, 30.0), (48, 34.0))]


def ranked(rungs, budget, score="psnr"):
    return rungs.ranked(budget, ["satin"], score).to_dict()


def test_a_size_is_read_off_the_curve_and_at_its_end_beyond_it(tmp_path):
    single = at_bits("b", 20, 31.0, 31.0)  # one rung is no curve
    rungs = rungs_of(run_of(tmp_path / "run", *LADDER, single))

    found = {bits: ranked(rungs, Budget(BYTES, bits)) for bits in (4, 16 * 3**0.5, 128)}
    assert found.pop(4) == {}
    assert found.pop(128) == {"a": 34.0, "b": 31.0}
    assert list(found.values()) == [{"a": pytest.approx(32.0), "b": 31.0}]  # halfway from 16 to 48 bits, over their log


def test_a_time_has_the_rung_that_validation_pairs_choose(tmp_path):
    times = [timing(each["job"], 2.0 + 3.0 * rung) for rung, each in enumerate(LADDER)]
    rungs = rungs_of(run_of(tmp_path / "run", *LADDER, *times))
    assert ranked(rungs, Budget(EAGER, 8)) == {"a": 34.0}
    assert ranked(rungs, Budget(EAGER, 4)) == {"a": 20.0}


def test_lines_are_ranked_by_their_means_the_least_flip_first(tmp_path):
    jobs = [at_bits(label, 16, 30.0, test) for label, test in (("a", 20.0), ("b", 30.0))]
    for each, flip in zip(jobs, (0.2, 0.1), strict=True):
        each["scores"]["heldout"]["metrics"][FLIP] = {"pooled": flip, "mean": flip}
    rungs = rungs_of(run_of(tmp_path / "run", *jobs))
    budget = Budget(BYTES, 16)
    assert list(ranked(rungs, budget)) == list(ranked(rungs, budget, "flip")) == ["b", "a"]


def test_the_fewest_bytes_are_those_at_which_a_curve_is_within_half_a_decibel_of_the_best(tmp_path):
    (table,) = when_table(run_of(tmp_path / "run", *LADDER))
    (answer,) = (answer for question, *answer in table.rows if question.endswith(": 64 bits a texel"))
    assert answer == ["a", "—", "34.0 dB", "—"]  # at 32 bits the curve has 32.5


def test_ranks_do_not_depend_on_where_rungs_stand(tmp_path):
    """At 32 bits b has a rung of 31.9 dB, and a has none; but the curve of a has 32.5 there."""
    jobs = []
    for material in ("satin", "rock", "wool"):
        for label, bits, score in (("a", 8, 20.0), ("a", 16, 30.0), ("a", 48, 34.0), ("b", 8, 19.0), ("b", 32, 31.9)):
            jobs.append(at_bits(f"{label} x={bits}", bits, score, score, material=material))
    rungs = rungs_of(run_of(tmp_path / "run", *jobs))
    assert mean_ranks(rungs).mean == {"a": 1.0, "b": 2.0}


def test_beyond_what_a_display_shows_codecs_share_their_rank(tmp_path):
    jobs = []
    for material in ("satin", "rock", "wool"):
        jobs.append(job("a", 10, MOST_DB, MOST_DB, material))
        jobs.append(job("b", 10, MOST_DB, MOST_DB, material))
    rungs = rungs_of(run_of(tmp_path / "run", *jobs))
    assert mean_ranks(rungs).mean == {"a": 1.5, "b": 1.5}
    assert ranked(rungs, Budget(BYTES, 4)) == {"a": MOST_DB, "b": MOST_DB}


def ladder(codec, material, sizes, tests, validations=()):
    """Rungs of sizes in bits a texel, with their PSNR at test pairs and, if it is another, at validation pairs."""
    bytes_a_bit = SIDE * SIDE // 8
    rungs = zip(sizes, tests, validations or tests, strict=True)
    return [job(f"{codec} x={bits}", bits * bytes_a_bit, seen, test, material) for bits, test, seen in rungs]


def best_of(table):
    """The first cells of the rows with the best of a column, by the column's name."""
    return {table.headers[column][0]: table.rows[row][0] for (row, column), mark in table.marks.items() if mark == BOLD}


def test_a_lead_on_fewer_surfaces_than_others_have_is_neither_ranked_nor_first(tmp_path):
    records = []
    for material in ("m0", "m1", "m2"):
        for codec, more in (("neubtf-direct", 0), ("good", 1), ("weak", -1)):
            records += ladder(codec, material, (8, 16, 32), (28 + more, 29 + more, 30 + more))
    run = run_of(tmp_path / "run", *records, *ladder("few", "m0", (8, 16, 32), (33, 34, 35)))
    (front,) = front_table(run)
    assert [row[0] for row in front.rows] == ["good", "neubtf-direct", "weak", "few"]
    assert front.rows[-1][2] == "+5.0 on 1"
    assert best_of(front) == {"lead": "good"}
    curves, *_ = curves_tables(run)
    assert (curves.rows[-1][0], {*best_of(curves).values()}) == ("few", {"good"})


def test_a_codec_with_a_single_rung_on_some_surfaces_may_keep_a_best_from_being_marked(tmp_path):
    records = []
    for material in ("m0", "m1", "m2"):
        records += ladder("a", material, (16, 32, 64), (29, 30, 31)) + ladder("b", material, (16, 32, 64), (28, 29, 30))
    ahead = run_of(tmp_path / "ahead", *records, *ladder("one", "m0", (16,), (39,)))
    behind = run_of(tmp_path / "behind", *records, *ladder("one", "m0", (16,), (20,)))
    budget = Budget(BYTES, 32)
    assert rungs_of(ahead).absent_leader(budget, ["m0", "m1", "m2"]) == "one"
    assert rungs_of(behind).absent_leader(budget, ["m0", "m1", "m2"]) == ""
    assert [best_of(table).get("measured, 3") for run in (ahead, behind) for table in front_table(run)] == [None, "a"]


def test_no_best_is_marked_where_a_line_that_ended_before_has_more_but_its_own_dip_is_no_reason(tmp_path):
    dips = ladder("a", "m0", (16, 32, 64), (29, 31, 30), (29, 30, 31)) + ladder("b", "m0", (16, 32, 64), (27, 28, 29))
    run = run_of(tmp_path / "dips", *dips)
    assert not rungs_of(run).is_outdone(Budget(BYTES, 64), ["m0"])
    run = run_of(tmp_path / "ended", *dips, *ladder("small", "m0", (4, 8, 16), (34, 35, 36)))
    outdone = [bits for bits in BITS if rungs_of(run).is_outdone(Budget(BYTES, bits), ["m0"])]
    assert outdone == [32, 64]
    (front,) = front_table(run)
    assert "measured, 1" not in best_of(front)
    assert any("smaller size" in note for note in front.notes)
