"""What a run says of the jobs and the time that are left. No test depends on how long anything took."""

import json
from pathlib import Path

import pytest

from bench.data.spec import MaterialSpec, Preparation
from bench.errors import InputError
from bench.records import append
from bench.runs import estimate
from bench.runs.estimate import Estimate, duration
from bench.runs.provenance import processor
from bench.runs.suite import CodecSpec
from bench.runs.task import Task

DATA = Preparation(size=10, views=5, lights=4)
PCA = {"components": 16, "center": True}


@pytest.fixture
def clock(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(estimate.time, "monotonic", lambda: now[0])
    return now


def task(codec, material="satin", seed=0, **settings):
    return Task("r", Path(), MaterialSpec(material), DATA, CodecSpec(codec, settings), seed, 1)


def job(cell, seconds, pairs=20, **settings):
    """A record of a task whose fit took so long; its settings are the codec's own unless given."""
    from bench.codec import settings_dict
    from bench.codecs.registry import make_codec

    whole = settings_dict(make_codec(cell.codec.codec, cell.codec.settings)) | settings
    return cell.base | {
        "status": "ok", "shape": [10, 10], "pairs": {"all": pairs, "train": pairs}, "settings": whole,
        "fit_seconds": seconds, "machine": {"processor": processor()},
        "scores": {}, "metrics": {}, "bytes": {"total": 1}, "parameters": 0,
    }  # fmt: skip


def looked(folder, tasks, holds=(), at_once=1):
    return Estimate(tasks, set(holds), folder, lambda: at_once)


def test_without_records_there_is_no_estimate_and_it_says_so(tmp_path, clock):
    estimate = looked(tmp_path / "run", [task("pca"), task("vq"), task("vq", seed=1)])
    assert estimate.first == "3 jobs: 3 left, no estimate before the first fit of pca, vq on this machine"
    assert estimate.progress == "0 of 3 jobs"


def test_a_finished_job_tells_of_the_others_of_its_codec_and_of_what_a_job_takes_besides(tmp_path, clock):
    tasks = [task("pca", seed=seed) for seed in range(4)] + [task("vq")]
    estimate = looked(tmp_path / "run", tasks)
    clock[0] += 160
    estimate.ended(job(tasks[0], 100.0), "")
    assert estimate.progress == "1 of 5 jobs, about 8 min and 1 job of unknown time left"  # 3 · (100 + 60) s
    for each in tasks[1:4]:
        clock[0] += 160
        estimate.ended(job(each, 100.0), "")
    assert estimate.progress == "4 of 5 jobs"
    clock[0] += 20
    estimate.ended(job(tasks[4], 10.0), "")
    assert (estimate.progress, estimate.left) == ("5 of 5 jobs", "")


def test_jobs_are_divided_among_the_workers_that_are_there_and_no_more(tmp_path, clock):
    tasks, there = [task("pca", seed=seed) for seed in range(3)], [1]
    estimate = Estimate(tasks, set(), tmp_path / "run", lambda: there[0])
    clock[0] += 120
    estimate.ended(job(tasks[0], 20.0), "")
    assert estimate.left == "about 4 min left"
    there[0] = 2
    assert estimate.left == "about 4 min left"  # all that is known of the past is how long it took
    there[0] = 1000
    assert estimate.left == "about 6 min left"


def test_fits_on_record_are_scaled_by_steps_or_by_the_data(tmp_path, clock):
    append_all(tmp_path / "run", job(task("neubtf-direct", steps=500), 30.0), job(task("pca", "brick"), 60.0, pairs=10))
    assert looked(tmp_path / "run", [task("neubtf-direct", steps=4000)]).first.endswith("about 4 min of fits")
    assert looked(tmp_path / "run", [task("pca")]).first.endswith("about 2 min of fits")  # twice the pairs
    both = [task("neubtf-direct", steps=4000), task("pca")]
    assert looked(tmp_path / "run", both, at_once=2).first.endswith("2 jobs: 2 left, about 3 min of fits")


def test_the_fit_that_is_most_alike_counts(tmp_path, clock):
    one, other = task("pca", "satin"), task("pca", "brick")
    append_all(tmp_path / "beside", job(one, 60.0), job(other, 600.0))
    assert looked(tmp_path / "run", [task("pca", "satin", seed=1)]).first.endswith("about 1 min of fits")
    assert looked(tmp_path / "run", [task("pca", "brick", seed=1)]).first.endswith("about 10 min of fits")


def test_another_processor_and_a_folder_that_cannot_be_read_tell_nothing(tmp_path, clock):
    append_all(tmp_path / "far", job(task("pca"), 60.0) | {"machine": {"processor": "another"}})
    (tmp_path / "broken").mkdir()
    (tmp_path / "broken" / "records.jsonl").write_text(json.dumps({"kind": "job", "job": "x"}) + "\n")
    assert "no estimate" in looked(tmp_path / "run", [task("pca")]).first


def test_jobs_on_record_are_not_counted_until_one_is_fitted_anew(tmp_path, clock):
    tasks = [task("pca", seed=seed) for seed in range(4)]
    append_all(tmp_path / "run", *(job(each, 60.0) for each in tasks[:3]))
    names = {each.name for each in tasks[:3]}
    estimate = looked(tmp_path / "run", tasks, names)
    assert estimate.first == "4 jobs, 3 of them recorded: 1 left, about 1 min of fits"
    estimate.ended(job(tasks[0], 60.0), "record")
    assert estimate.left == "about 1 min left"
    clock[0] += 60
    estimate.ended(job(tasks[1], 60.0), "")  # its code has changed
    assert estimate.progress == "2 of 4 jobs, about 2 min left"
    assert looked(tmp_path / "run", tasks[:3], names).first == "3 jobs, all recorded; what changed since is done again"


def append_all(folder, *records):
    folder.mkdir()
    for record in records:
        append(folder, record)


@pytest.mark.parametrize(
    ("seconds", "words"),
    [(4, "half a minute"), (50, "1 min"), (40, "1 min"), (3600, "1 h"), (4200, "1 h 10 min"), (89, "1 min")],
)
def test_a_time_is_told_in_minutes_and_hours(seconds, words):
    assert duration(seconds) == words


def test_a_codec_that_cannot_be_made_takes_no_time(tmp_path, clock):
    wrong = task("pca", components=-1)
    with pytest.raises(InputError):
        job(wrong, 1.0)
    assert looked(tmp_path / "run", [wrong]).first == "1 job: 1 left, about half a minute of fits"
