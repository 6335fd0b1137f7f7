import math
import re
import statistics

import numpy as np
import pytest
from scipy import integrate, stats

from bench.compare.comparison import compare
from bench.compare.paired import packed
from bench.compare.verdicts import quantile
from bench.inputs.errors import InputError
from bench.records import load_run

PSNR, FLIP = "psnr_display", "flip_ldr_67ppd_periodic"


def change(comparison, name, row=0):
    return next(change for change in comparison.rows[row].deciding if change.quantity.name == name)


@pytest.mark.parametrize(
    ("name", "changes", "verdict", "code"),
    [
        ("PSNR", {}, "same", 0),
        ("PSNR", {"psnr": 29.985}, "same", 0),
        ("PSNR", {"psnr": 29.975}, "WORSE", 1),
        ("PSNR", {"psnr": 30.025}, "better", 0),
        ("PSNR", {"psnr": None}, "better", 0),
        ("FLIP", {"flip": 0.1004}, "same", 0),
        ("FLIP", {"flip": 0.1006}, "WORSE", 1),
        ("FLIP", {"flip": 0.0994}, "better", 0),
        ("bytes", {"size": 64_001}, "WORSE", 1),
        ("bytes", {"size": 63_999}, "better", 0),
        ("parameters", {"parameters": 3012}, "WORSE", 1),
        ("parameters", {"parameters": 3010}, "better", 0),
    ],
)
def test_a_codec_whose_seeds_agree_is_held_to_a_small_tolerance(make, name, changes, verdict, code):
    comparison = compare(make.run("base", *make.three()), make.run("new", *make.three(**changes)))
    assert (change(comparison, name).verdict, comparison.exit_code) == (verdict, code)


def test_what_was_exact_must_stay_so(make):
    base = make.run("base", *make.seeds([None, None, None]))
    assert change(compare(base, base), "PSNR").verdict == "same"
    new = make.run("new", *make.seeds([None, 130.0, None]))
    comparison = compare(base, new)
    assert (change(comparison, "PSNR").verdict, comparison.exit_code) == ("WORSE", 1)


SPREAD = [30.0, 30.3, 29.8, 30.1, 29.7, 30.2, 29.9, 30.4, 29.6]
STUDENT_8 = 4.5008  # exceeded once in 1,000 times, with eight degrees of freedom
OTHERS_8 = 5.6174  # once in 4,000


@pytest.mark.parametrize(("share", "verdict"), [(0.98, "same"), (1.02, "WORSE"), (-0.98, "same"), (-1.02, "better")])
def test_the_margin_of_a_codec_that_draws_is_what_chance_hardly_exceeds(make, share, verdict):
    base = make.run("base", *make.seeds(SPREAD))
    limit = STUDENT_8 * statistics.stdev(SPREAD) * math.sqrt(1 / 9 + 1 / 3)
    mean = statistics.fmean(SPREAD)
    new = make.run("new", *make.seeds([mean - share * limit + wobble for wobble in (-0.01, 0, 0.01)]))
    psnr = change(compare(base, new), "PSNR")
    assert psnr.margin == pytest.approx(limit, rel=1e-3)
    assert change(compare(base, new), "train").margin == pytest.approx(limit * OTHERS_8 / STUDENT_8, rel=1e-3)
    assert psnr.verdict == verdict
    assert psnr.base == pytest.approx(mean)  # all nine are of the same pairs, so all of them count


def test_seeds_that_give_the_same_again_have_not_changed_whatever_the_others_gave(make):
    base = make.run("base", *make.seeds(SPREAD))
    psnr = change(compare(base, make.run("new", *make.seeds([30.0000001, *SPREAD[1:3]]))), "PSNR")
    assert psnr.base == pytest.approx(statistics.fmean(SPREAD[:3]))
    assert abs(psnr.difference) < 1e-6


def test_seeds_with_pairs_of_their_own_are_left_out_of_a_base(make):
    """As earlier versions drew them: their scores differ by decibels because of the pairs."""
    psnr_of_pairs = enumerate((30.0, 33.0, 27.0))
    base = make.run("base", *(make.job("vq", seed=seed, psnr=psnr, btf=str(seed)) for seed, psnr in psnr_of_pairs))
    psnr = change(compare(base, make.run("new", *make.seeds([29.7, 29.8, 29.9], btf="0"))), "PSNR")
    assert (psnr.base, psnr.new, psnr.margin, psnr.verdict) == (30.0, 29.7, 0.25, "WORSE")
    assert (
        compare(base, make.run("other", *make.seeds([30.0, 30.0, 30.0], btf="9"))).rows[0].verdict == "not comparable"
    )


@pytest.mark.parametrize(("loss", "said"), [(0.01, "same"), (0.03, "WORSE")])
def test_a_decoder_that_changed_alone_is_judged_without_chance(make, loss, said):
    """The files are those of the base: no fit scattered, although seeds differ by decibels."""

    def jobs(loss):
        return [make.job("vq", seed=seed, psnr=psnr - loss, sha256=str(seed)) for seed, psnr in enumerate(SPREAD)]

    base = make.run("base", *jobs(0.0))
    psnr = change(compare(base, make.run("two", *jobs(loss)[:2], seeds=(0, 1))), "PSNR")
    assert (psnr.verdict, psnr.margin) == (said, 0.02)
    assert psnr.difference == pytest.approx(-loss)
    one_refitted = [*jobs(loss)[:1], make.job("vq", seed=1, psnr=SPREAD[1] - loss, sha256="other")]
    assert change(compare(base, make.run("refitted", *one_refitted, seeds=(0, 1))), "PSNR").margin > 0.1


@pytest.mark.parametrize("freedom", [*range(1, 30), 1.4, 1.6, 2.4, 3.7, 17.3])
@pytest.mark.parametrize("probability", [0.001, 0.00025])
def test_student_exceeds_its_quantile_as_seldom_as_asked(freedom, probability):
    density = stats.t(freedom).pdf
    beyond, _ = integrate.quad(density, quantile(freedom, probability), math.inf, epsrel=1e-9)
    assert beyond == pytest.approx(probability, rel=1e-6)


def test_a_small_spread_does_not_make_a_trifle_a_regression(make):
    base = make.run("base", *make.seeds([30.00, 30.03, 30.06]))
    assert change(compare(base, make.run("same", *make.seeds([29.95] * 3))), "PSNR").verdict == "same"
    assert change(compare(base, make.run("new", *make.seeds([29.7] * 3))), "PSNR").verdict == "WORSE"


def test_with_one_seed_the_margin_is_a_guess_and_says_so(make):
    base, worse = make.run("base", make.job(), seeds=[0]), make.run("new", make.job(psnr=29.7), seeds=[0])
    comparison = compare(base, worse)
    assert change(comparison, "PSNR").verdict == "WORSE"
    assert any("one seed" in note and "satin/pca" in note for note in comparison.notes)
    assert change(compare(base, make.run("bytes", make.job(size=64_001), seeds=[0])), "bytes").verdict == "WORSE"


def test_other_seeds_are_compared_by_the_means_of_all(make):
    base = make.run("base", *make.seeds([30.0, 31.0, 32.0]))
    new = make.run("new", *(make.job("vq", seed=seed, psnr=31.0) for seed in (7, 8, 9)), seeds=[7, 8, 9])
    psnr = change(compare(base, new), "PSNR")
    assert (psnr.base, psnr.new, psnr.verdict) == (31.0, 31.0, "same")


@pytest.mark.parametrize(("size", "verdict"), [(64_400, "same"), (65_900, "WORSE"), (62_000, "better")])
def test_sizes_that_differ_by_seed_are_of_compressed_payloads_and_have_one_per_cent(make, size, verdict):
    base = make.run("base", *(make.job(seed=seed, size=64_000 + seed) for seed in range(3)))
    new = make.run("new", *(make.job(seed=seed, size=size + seed) for seed in range(3)))
    assert change(compare(base, new), "bytes").verdict == verdict


@pytest.mark.parametrize(
    ("key", "value", "reason"),
    [
        ("version", 2, "version 2"),
        ("training", "other", "training"),
        ("btf", "other", "other data"),
        ("exposure", 1.6, "another exposure"),
        ("deciding", "other", "held-out"),
    ],
)
def test_another_codec_version_or_other_data_cannot_be_compared(make, key, value, reason):
    comparison = compare(make.run("base", *make.three()), make.run("new", *make.three(psnr=10.0, **{key: value})))
    assert (comparison.rows[0].verdict, comparison.exit_code) == ("not comparable", 4)
    assert reason in comparison.rows[0].why


def test_seeds_of_other_code_of_an_outside_codec_are_not_averaged(make, monkeypatch):
    monkeypatch.setattr("bench.codecs.alike.from_outside", lambda name: True)
    base = make.run("base", *make.three())
    new = make.three(psnr=29.0, run="2")
    for job, code in zip(new, ("old", "new", "new"), strict=True):
        job["fit_key"]["code"] = code
    (row,) = compare(base, make.run("new", *new)).rows
    assert (row.verdict, row.forbids) == ("not comparable", True)
    assert row.why.startswith("seed 0: fitted by other code of the codec than its newest seed")


def test_a_job_without_the_version_of_its_codec_is_named(make):
    job = make.job()
    del job["fit_key"]["version"]
    with pytest.raises(InputError, match="satin/pca/0 has no 'fit_key/version'"):
        compare(make.run("base", make.job()), make.run("new", job))


def test_a_number_that_the_base_lacks_has_no_version_to_name(make):
    base = make.run("base", *make.three(footprints={"2": {"mean": None, "exact": 0, "slices": 4}}))
    comparison = compare(base, make.run("new", *make.three()))
    assert change(comparison, "footprints").why == "footprints was not measured before"


def test_another_metric_version_spares_the_other_numbers(make):
    base = make.run("base", *make.three())
    new = make.run("new", *make.three(flip=0.9, versions={FLIP: 2}))
    comparison = compare(base, new)
    assert change(comparison, "FLIP").verdict == "not comparable"
    assert re.search("version 2 .*1$", change(comparison, "FLIP").why)
    assert change(comparison, "PSNR").verdict == "same"
    assert (comparison.rows[0].verdict, comparison.exit_code) == ("not comparable", 1)
    assert compare(base, new, allow=["pca"]).exit_code == 0


def test_what_is_allowed_to_be_gone_does_not_hide_what_got_worse(make):
    base = make.run("base", *make.three())
    new = make.run("new", *(make.job(seed=seed, psnr=20.0) for seed in range(2)))
    assert (compare(base, new).rows[0].verdict, compare(base, new, allow=["*"]).exit_code) == ("GONE", 1)


def test_training_pairs_show_a_worse_fit_where_held_out_pairs_are_too_hard_to_tell(make):
    def jobs(lost):
        for job in make.seeds([26.0, 30.0, 28.0, 31.0, 25.0, 29.0]):
            stats = {PSNR: {"mean": 40.0 - lost + 0.01 * job["seed"], "exact": 0, "slices": 4}}
            yield job | {"scores": job["scores"] | {"train": {"metrics": stats}}}

    comparison = compare(make.run("base", *jobs(0.0)), make.run("new", *jobs(0.2)))
    assert (change(comparison, "train").verdict, comparison.exit_code) == ("WORSE", 1)
    assert change(comparison, "PSNR").verdict == "same"


def test_a_row_is_found_again_under_another_spelling(make):
    base = make.run("base", *make.three("vq components=16"))
    new = make.run("new", *make.three("vq"))
    assert [(row.label, row.verdict) for row in compare(base, new).rows] == [("vq", "same")]
    other = make.run("other", *make.three("vq", settings={"components": 4}))
    assert [row.verdict for row in compare(base, other).rows] == ["GONE", "new"]


def test_a_seed_that_failed_in_the_base_follows_its_row_to_another_spelling(make):
    first, second, _ = make.three("vq components=16")
    base = make.run("base", first, second, make.unfinished("failed", "vq components=16", seed=2))
    assert [(row.label, row.verdict) for row in compare(base, make.run("new", *make.three("vq"))).rows] == [
        ("vq", "same")
    ]


def test_jobs_that_vanished_are_regressions(make):
    base = make.run("base", *(make.job(label, seed=seed) for label in ("pca", "vq") for seed in range(3)))
    row = make.run("row", *make.three("pca"))
    seed = make.run("seed", *list(base.jobs)[:-1])
    away = make.run("away", *make.three(), make.unfinished("unavailable", "vq"))
    for new, why in ((row, "no such job in the run"), (seed, "seed 2 has no result"), (away, "not available: Runtime")):
        comparison = compare(base, new)
        assert [row.verdict for row in comparison.rows] == ["same", "GONE"]
        assert why in comparison.rows[1].why
        assert comparison.exit_code == 1


def test_seeds_that_a_codec_has_of_its_own_may_not_vanish(make):
    base = make.run("base", *make.three())
    planned = [job["job"] for job in base.jobs]
    new = make.run("new", make.job(seed=0), seeds=[0], jobs=planned)
    assert [row.verdict for row in compare(base, new).rows] == ["GONE"]
    assert compare(base, make.run("less", make.job(seed=0), seeds=[0], jobs=planned[:1])).exit_code == 0


def test_a_run_of_one_seed_by_choice_has_lost_nothing(make):
    base = make.run("base", *make.three())
    assert compare(base, make.run("new", make.job(seed=1), seeds=[1])).exit_code == 0


def test_an_empty_run_is_4_and_an_all_failed_one_3(make):
    base = make.run("base", make.job(), make.job("vq"))
    assert compare(base, make.run("empty")).exit_code == 4
    failed = make.run("failed", make.unfinished("failed"), make.unfinished("failed", "vq"))
    assert compare(base, failed).exit_code == 3
    assert compare(base, make.run("other", make.job(material="brick"))).exit_code == 4


def test_a_row_that_never_finished_and_is_gone_is_not_new(make):
    base = make.run("base", make.job(), make.unfinished("failed", "vq"))
    comparison = compare(base, make.run("new", make.job()))
    assert {row.label: row.verdict for row in comparison.rows}["vq"] == "GONE"


def test_jobs_without_a_score_are_not_compared(make):
    job = make.job() | {"scores": {}, "footprints": {}, "metrics": {}}
    empty = make.run("empty", job)
    comparison = compare(empty, empty)
    assert (comparison.rows[0].verdict, comparison.exit_code) == ("not comparable", 4)
    void = make.job() | {"footprints": {}}
    void["scores"] = {"heldout": {"metrics": {name: {"pooled": None, "slices": 0} for name in void["metrics"]}}}
    nothing = make.run("void", void)
    assert compare(nothing, nothing).exit_code == 4
    whole = [make.run(name, job, make.job("vq")) for name in ("a", "b")]
    assert compare(*whole).exit_code == 1


def test_a_damaged_line_of_the_base_is_an_error(make):
    base, worse = make.run("base", *make.seeds([30.0] * 3)), make.run("new", *make.seeds([29.0] * 3))
    path = base.folder / "records.jsonl"
    path.write_text(path.read_text().replace('"job"', '"jbo"'))
    with pytest.raises(InputError, match=r"line\(s\) 2,.*3,.*4"):
        compare(load_run(base.folder), worse)


def test_a_failure_outweighs_a_regression(make):
    base = make.run("base", make.job(), make.job("vq"))
    comparison = compare(base, make.run("new", make.job(psnr=20.0), make.unfinished("failed", "vq")))
    assert [row.verdict for row in comparison.rows] == ["WORSE", "FAILED"]
    assert comparison.rows[1].why.endswith("no luck")
    assert comparison.exit_code == 3


def test_changed_settings_are_compared_and_said(make):
    base, new = make.run("base", make.job()), make.run("new", make.job(settings={"components": 6}, size=50_000))
    (row,) = compare(base, new).rows
    (note,) = row.notes
    assert row.verdict == "better"
    assert re.search("components 8.*6", note)


def test_times_advise_as_multiples_of_the_floor(make):
    base = make.run("base", make.job(), make.timing(ns=500))

    def advice(name, *timings):
        comparison = compare(base, make.run(name, make.job(), *timings))
        assert comparison.exit_code == 0
        return comparison.rows[0].timing

    slow_machine = advice("a", make.timing(ns=1500, floor=300))
    assert (slow_machine.new.mean, slow_machine.words) == (pytest.approx(5), "")
    assert advice("b", make.timing(ns=700)).words == "slower"
    assert advice("c", make.timing(ns=300)).words == "faster"
    for ns in (480, 520):  # too little to matter, though the intervals are apart
        assert advice(str(ns), make.timing(ns=ns, spread=1)).words == ""
    assert advice("d", make.timing(ns=700, spread=300)).words == ""
    assert advice("e") is None
    assert advice("f", make.timing(ns=700, batch=1)) is None


def test_what_the_runs_do_not_share_is_said(make):
    base, new = make.run("base", make.job()), make.run("new", make.job(), packages={"torch": "3.0"}, threads=2)
    with open(new.folder / "records.jsonl", "a") as file:
        file.write('{"kind": "jo')
    notes = compare(base, load_run(new.folder)).notes
    assert any(re.search(r"torch.*3\.0.*threads.*2", note) for note in notes)
    assert any(re.search("1 line.*NEW", note) for note in notes)


def test_a_record_of_another_layout_is_an_error_that_names_it(make):
    job = make.job()
    del job["fit_key"]
    with pytest.raises(InputError, match=r"satin/pca/0.*'fit_key'"):
        compare(make.run("base", job), make.run("new", make.job()))


def test_a_row_that_a_new_default_renames_does_not_join_another_row_of_the_base(make):
    four, eight = {"components": 4}, {"components": 8}
    base = make.run("base", make.job("pca", settings=four), make.job("pca components=8", settings=eight))
    new = make.run("new", make.job("pca", settings=eight), make.job("pca components=4", settings=four))
    verdicts = {row.label: row.verdict.lower() for row in compare(base, new).rows}
    assert verdicts == {"pca": "same", "pca components=8": "gone", "pca components=4": "new"}


def test_an_interval_is_shown_only_where_it_is_over_the_seeds_of_the_means(make):
    def jobs(shift, count):
        hard = np.linspace(28, 32, 9)
        slices = [hard + shift + 0.1 * seed for seed in range(count)]
        return [
            make.job("vq", seed=seed, psnr=float(values.mean()), slices={PSNR: packed(values)})
            for seed, values in enumerate(slices)
        ]

    base = make.run("base", *jobs(0, 3))
    for count, is_shown in ((3, True), (1, False)):
        (row,) = compare(base, make.run(f"new {count}", *jobs(-1, count), seeds=range(count))).rows
        (reason,) = [reason for reason in row.reasons() if reason.startswith("PSNR ")]
        assert ("95 %" in reason) == is_shown


def test_a_group_that_is_empty_in_both_runs_is_no_obstacle_to_other_numbers_of_seeds(make):
    def jobs(seeds):
        records = [make.job("vq", seed=seed, psnr=30.0 + 0.01 * seed) for seed in seeds]
        for record in records:
            record["scores"]["train"] = {"slices": 0, "metrics": {}}
        return records

    base, new = make.run("base", *jobs(range(3))), make.run("new", *jobs((7,)), seeds=(7,))
    assert [str(row.verdict) for row in compare(base, new).rows] == ["same"]
