import json

from bench.compare.choosing import Limits, Rung, best_rung, usable_rungs
from bench.compare.choosing.budgets import BYTES, EAGER, FUSED, Budget, budgets, line_of, mean_test_score, setting_of
from bench.records import FLIP, PSNR, TRADE, append, load_run
from bench.records.lines import TRADE_FORMAT

SIDE = 64
METRICS = {PSNR: {"unit": "dB", "direction": "higher", "space": "display", "version": 1}}


def rung(name, size, score, time=None):
    return Rung(size, score, time, of=name)


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
    picked = budgets(run).picks(budget, [material])
    return {line: setting_of(rungs[material].of[0]) for line, rungs in picked.items()}


def test_the_best_that_fits_is_chosen_and_one_that_is_a_byte_too_large_is_not(tmp_path):
    fits = 16 * SIDE * SIDE // 8
    run = run_of(tmp_path / "run", job("a x=1", fits, 30.0), job("a x=2", fits + 1, 40.0), job("a x=3", 10, 20.0))
    assert (picks(run, Budget(BYTES, 16)), picks(run, Budget(BYTES, 32))) == ({"a": "x=1"}, {"a": "x=2"})


def test_a_model_of_a_scene_answers_for_that_scene_alone_and_is_never_chosen(tmp_path):
    of_scene = job("a scene", 5, 40.0, settings={"scene": True})
    run = run_of(tmp_path / "run", job("a x=1", 10, 10.0), of_scene)
    assert picks(run, Budget(BYTES, 16)) == {"a": "x=1"}
    assert budgets(run).without == []


def test_records_without_validation_are_never_chosen_and_are_told(tmp_path):
    run = run_of(tmp_path / "run", job("a x=1", 10, None, test=99.0), job("a x=2", 10, 10.0))
    assert picks(run, Budget(BYTES, 16)) == {"a": "x=2"}
    assert [each["label"] for each in budgets(run).without] == ["a x=1"]


def test_the_mean_over_slices_decides(tmp_path):
    pooled, steady = job("a pooled", 10, 30.0), job("a steady", 10, 31.0)
    pooled["scores"]["validation"]["metrics"][PSNR]["pooled"] = 50.0
    assert picks(run_of(tmp_path / "run", pooled, steady), Budget(BYTES, 16)) == {"a": "steady"}


def test_what_is_as_published_is_a_line_of_its_own(tmp_path):
    run = run_of(tmp_path / "run", job("a x=1", 10, 30.0), job("a recipe=paper x=1", 10, 40.0))
    assert picks(run, Budget(BYTES, 16)) == {"a": "x=1", "a, as published": "x=1"}
    assert line_of(job("a recipe=paper", 1, 1.0)) == "a, as published"
    assert setting_of(job("a recipe=paper", 1, 1.0)) == "default"


def test_equals_go_to_the_smaller_file_then_to_the_faster_then_to_the_first():
    several = [rung("large", 3, 30.0, time=1.0), rung("slow", 2, 30.0, time=9.0), rung("fast", 2, 30.0, time=5.0)]
    assert best_rung([*several, rung("unknown", 2, 30.0)], Limits(size=9)).of == "fast"
    assert best_rung([rung("first", 2, 30.0), rung("second", 2, 30.0)], Limits(size=9)).of == "first"


def test_a_score_is_missed_by_decibels_over_ten_and_sizes_by_shares():
    assert Limits(score=40.0, size=8).misses(rung("a", 12, 30.0)) == {"size": 0.5, "score": 1.0}


def test_choices_without_an_error_and_with_validation_pairs_are_rungs():
    good = {"material": "satin", "bytes": 9, "ns_per_sample": 5.0, "validation": {"mean": 30.0, "slices": 4}}
    good |= {"ratio_to_floor": 2.0, "ratio_interval95": [1.5, 2.4]}
    others = [good | {"error": "none"}, good | {"material": "brick"}, good | {"validation": {"slices": 0}}]
    assert usable_rungs([*others, good], "satin") == [Rung(9, 30.0, 6.0, good)]


def test_lines_are_ranked_by_their_means_the_least_flip_first(tmp_path):
    jobs = [job(label, 16 * SIDE * SIDE // 8, 30.0, test) for label, test in (("a", 20.0), ("b", 30.0))]
    for each, flip in zip(jobs, (0.2, 0.1), strict=True):
        each["scores"]["heldout"]["metrics"][FLIP] = {"pooled": flip, "mean": flip}
    found = budgets(run_of(tmp_path / "run", *jobs))
    budget = Budget(BYTES, 16)
    assert list(found.ranked(budget, ["satin"])) == list(found.ranked(budget, ["satin"], FLIP)) == ["b", "a"]


def test_seeds_make_one_rung_of_their_means_that_fits_where_their_mean_bytes_do(tmp_path):
    fits, at = 16 * SIDE * SIDE // 8, Budget(BYTES, 16)
    b = [job("b x=1", fits, 30.0), job("b x=1", fits + 2, 40.0, seed=1), job("b x=2", fits, 34.0)]
    run = run_of(tmp_path / "run", job("a x=1", fits - 1, 30.0, 20.0), job("a x=1", fits + 1, 40.0, 30.0, seed=1), *b)
    mean = mean_test_score(budgets(run).picks(at, ["satin"])["a"]["satin"], PSNR)
    assert (mean, picks(run, at)) == (25.0, {"a": "x=1", "b": "x=2"})


def test_told_apart_by_the_numbers_of_the_table_with_or_without_stored_slices(tmp_path):
    """Above what a display shows nothing counts: b is 5 dB ahead of the anchor there alone, and level with it below."""
    jobs = []
    for material, anchor in (("satin", 46.0), ("rock", 47.0), ("wool", 49.0), ("bark", 50.0)):
        jobs.append(job("neubtf-direct", 10, 40.0, anchor, material=material))
        jobs.append(job("a", 10, 40.0, anchor - 4.0, material=material))
        jobs.append(job("b", 10, 40.0, anchor + 5.0 if anchor > 48.13 else anchor, material=material))
    result = budgets(run_of(tmp_path / "run", *jobs))
    assert result.told_apart(Budget(BYTES, 16), ["satin", "rock", "wool", "bark"]) == {"a"}
    assert result.told_apart(Budget(BYTES, 16), ["satin", "rock"]) == set()


def test_other_test_scores_change_no_choice(tmp_path):
    def jobs(sign):
        return [job(f"a x={i}", 900 * i, 30.0 + i % 3, 30.0 + sign * i) for i in range(5)]

    runs = [run_of(tmp_path / str(sign), *jobs(sign)) for sign in (-1, 1)]
    first, second = ({budget: picks(run, budget) for budget in budgets(run).limits} for run in runs)
    assert first == second


def test_a_rung_fits_a_time_if_the_upper_end_of_its_interval_does(tmp_path):
    jobs = [job(f"a x={i}", 10, 30.0 + i) for i in range(3)]
    times = [timing(each["job"], 3.0 + i, ratio_interval95=[2.0, 3.9 + 0.2 * i]) for i, each in enumerate(jobs)]
    run = run_of(tmp_path / "run", *jobs, *times)
    assert (picks(run, Budget(EAGER, 4)), picks(run, Budget(EAGER, 8))) == ({"a": "x=0"}, {"a": "x=2"})
    assert budgets(run).times[EAGER]["satin/a x=1/0"] == 4.1


def test_fused_times_have_budgets_of_their_own(tmp_path):
    run = run_of(tmp_path / "run", job("a", 10, 30.0), timing("satin/a/0", 9.0))
    fused = {"material": "satin", "label": "a", "job": "satin/a/0", "execution": "fused", "precision": "float32"}
    fused |= {"device": "cpu", "batch": 1, "threads": 1, "ns_per_sample": 1.0}
    fused |= {"ratio_to_floor": 2.8, "ratio_interval95": [2.5, 3.0]}
    trade = {"format": TRADE_FORMAT, "choices": [fused], "profiles": [], "ceilings": [], "answers": []}
    (run.folder / TRADE).write_text(json.dumps(trade))
    assert (picks(run, Budget(FUSED, 4)), picks(run, Budget(EAGER, 8))) == ({"a": "default"}, {})


def test_rungs_over_several_surfaces_are_those_that_were_measured_on_each(tmp_path):
    both = [job("a x=1", 10, 30.0, 20.0, material) for material in ("satin", "brick")]
    found = budgets(run_of(tmp_path / "run", *both, job("a x=2", 10, 40.0, 30.0)))
    assert [found.ranked(Budget(BYTES, 16), on)["a"] for on in (["satin"], ["satin", "brick"])] == [30.0, 20.0]


def test_what_was_measured_on_other_data_than_last_is_left_out(tmp_path):
    old = job("a x=1", 10, 40.0)
    newest = job("a x=2", 10, 30.0, run="2")
    newest["score_key"] = newest["score_key"] | {"btf": "other"}
    run = run_of(tmp_path / "run", old, newest)
    assert picks(run, Budget(BYTES, 16)) == {"a": "x=2"}
    assert [each["label"] for each in budgets(run).unlike] == ["a x=1"]
