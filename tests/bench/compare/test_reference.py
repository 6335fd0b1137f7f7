import json
import math
import re
import statistics

import pytest
from scipy import stats

from bench import cli
from bench.compare.comparison import compare
from bench.compare.reference import few_seeds, reference, seeds_of
from bench.compare.verdicts import Verdict
from bench.inputs.errors import InputError
from bench.records import load_run

PSNRS = [30.0, 30.1234567891, 29.9]


@pytest.fixture
def run(make):
    jobs = [*make.seeds(PSNRS), *make.seeds([28.0] * 3, "pca"), make.job("table", psnr=100.0), make.job("mean-colour")]
    timings = [make.timing("mean-colour", ns=100), make.timing("vq", ns=250)]
    return make.run("run", *jobs, *timings, git="abc", text="a suite", python="3.11")


def written(run, path, before=None):
    path.write_text(reference(run, before))
    return load_run(path)


def test_a_reference_stands_for_its_run(run, tmp_path):
    comparison = compare(written(run, tmp_path / "reference.jsonl"), run)
    assert {row.verdict for row in comparison.rows} == {Verdict.SAME}
    assert comparison.exit_code == 0
    changes = [change for row in comparison.rows for change in (*row.deciding, *row.shown)]
    assert max(abs(change.difference) for change in changes) < 1e-4  # seven digits are kept
    names = {"PSNR", "FLIP", "bytes", "parameters", "train", "PSNR pooled", "ssim", "2 texels"}
    assert names <= {change.quantity.name for change in changes}
    assert comparison.rows[0].timing.base.mean == pytest.approx(2.5)


def test_the_same_records_give_the_same_bytes_in_whatever_order_they_were_written(make, run):
    other = make.run("other", *reversed(list(run.jobs)), *run.timings, git="abc")
    lines = [set(reference(each).splitlines()) for each in (run, other)]
    assert lines[0] == lines[1]
    again = make.run("again", *run.jobs, *run.timings, git="def")
    assert reference(again) == reference(run)


def test_the_times_of_a_reference_are_written_again_as_they_are(run, tmp_path):
    again = written(written(run, tmp_path / "a.jsonl"), tmp_path / "b.jsonl")
    assert sorted(timing["ns_per_sample"] for timing in again.timings) == [100, 250]


def test_a_suite_whose_codecs_have_seeds_of_their_own_has_those_of_its_jobs(make):
    run = make.run("run", *make.seeds(PSNRS), text='seeds = []\nmaterials = ["satin"]')
    assert seeds_of(run) == len(PSNRS)


def test_a_suite_that_names_no_seeds_has_the_seed_0(make):
    run = make.run("run", *make.seeds(PSNRS), text='materials = ["satin"]')
    assert seeds_of(run) == 1


def test_rows_of_few_seeds_that_differ_are_named(make):
    jobs = [
        *make.seeds([30.0, 31.0], "a"),
        *make.seeds([30.0, 30.0], "b"),
        *make.seeds([30.0 + i for i in range(9)], "c"),
    ]
    assert few_seeds(make.run("run", *jobs)) == ["satin/a"]


def test_a_reference_names_no_place_host_or_time(run):
    text = reference(run)
    assert str(run.folder) not in text
    assert "Linux-host" not in text
    assert "samples_ns" not in text
    assert json.loads(text.splitlines()[0])["machine"] == {"processor": "P"}


@pytest.mark.parametrize("status", ["failed", "unavailable"])
def test_a_run_that_is_not_whole_makes_no_reference(make, status):
    run = make.run("run", make.job(), make.unfinished(status, "vq"))
    with pytest.raises(InputError, match=r"1 job.*satin/vq/0"):
        reference(run)
    with pytest.raises(InputError, match="empty: "):
        reference(make.run("empty"))


def test_further_seeds_are_kept_while_the_others_give_the_same(make, tmp_path):
    four = make.run("four", *make.seeds([*PSNRS, 30.3]), *make.seeds([28.0] * 4, "pca"))
    before = written(four, tmp_path / "a.jsonl")
    now = make.run("three", *make.seeds(PSNRS), *make.seeds([28.5] * 3, "pca"))
    after = written(now, tmp_path / "b.jsonl", before)
    kept = [f"satin/vq/{seed}" for seed in range(4)]
    assert [job["job"] for job in after.jobs] == kept + [f"satin/pca/{seed}" for seed in range(3)]  # which changed


def test_update_prints_what_losses_it_can_tell_from_chance(make, tmp_path, capsys):
    def train(job, material):
        numbers = {"mean": 40.0 + 0.005 * job["seed"] * (material == "satin"), "pooled": 40.0, "exact": 0, "slices": 4}
        scores = job["scores"] | {"train": {"metrics": {"psnr_display": numbers}}}
        return job | {"scores": scores, "footprints": {}}

    psnrs = {"satin": [30.0, 31.0, 29.0, 30.5, 28.5, 30.2], "knit": [25.0] * 6}
    jobs = [train(job, each) for each, values in psnrs.items() for job in make.seeds(values, material=each)]
    run = make.run("six", *jobs, text="seeds = [0, 1, 2]")
    path = tmp_path / "a.jsonl"
    words = ["compare", "--update", str(run.folder), "--out", str(path)]
    assert cli.main(words) == 2  # of a decibel and more on satin
    assert "satin/vq" in capsys.readouterr().err
    assert not path.exists()
    assert cli.main([*words, "--wide"]) == 0
    out = capsys.readouterr().out
    limit = stats.t.isf(0.001, 5) * statistics.stdev(psnrs["satin"]) * math.sqrt(1 / 6 + 1 / 3)
    assert re.search(rf"satin/vq +PSNR {limit:.2f}.*0\.10", out)
    assert re.search(r"knit/vq +PSNR.*0\.02.*0\.02", out)


def test_a_reference_is_made_from_a_run_alone(run, tmp_path, capsys):
    path = tmp_path / "a.jsonl"
    written(run, path)
    assert cli.main(["compare", "--update", str(path), "--out", str(tmp_path / "b.jsonl")]) == 2
    assert "a.jsonl: " in capsys.readouterr().err
    assert not (tmp_path / "b.jsonl").exists()


def test_a_damaged_reference_is_not_updated(run, tmp_path, capsys):
    path = tmp_path / "a.jsonl"
    written(run, path)
    path.write_text(damaged := path.read_text()[:-40])
    assert cli.main(["compare", "--update", str(run.folder), "--out", str(path)]) == 2
    assert f"{path}: line(s) 11" in capsys.readouterr().err
    assert path.read_text() == damaged


def test_update_writes_the_file_and_prints_what_changed(make, run, tmp_path, capsys):
    path = tmp_path / "kept" / "ours.jsonl"
    assert cli.main(["compare", "--update", str(run.folder), "--out", str(path)]) == 0
    out = capsys.readouterr().out
    assert all(words in out for words in (f"wrote {path}: 8 jobs", "few seeds", "margin"))
    changed = make.run("changed", *make.seeds(PSNRS), *make.seeds([27.0] * 3, "pca"))
    assert cli.main(["compare", "--update", str(changed.folder), "--out", str(path)]) == 0
    out = capsys.readouterr().out
    assert re.search(r"PSNR 28\.00.*27\.00", out)
    assert "GONE" in out
    assert cli.main(["compare", str(path), str(changed.folder)]) == 0


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["{run}"], "--out FILE"),
        (["{run}", "-o", "{tmp}/a.json"], ".jsonl"),
        (["{run}", "-o", "{run}/records.jsonl"], "records.jsonl: "),
        (["{run}", "-o", "/proc/no/a.jsonl"], "/proc/no"),
        (["{tmp}/none"], "none: "),
    ],
)
def test_bad_usage_is_one_line_and_2(run, tmp_path, words, message, capsys):
    assert cli.main(["compare", "--update", *(word.format(run=run.folder, tmp=tmp_path) for word in words)]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
