import json
from pathlib import Path

from bench.compare.reference import published
from bench.records import Run


def test_what_is_published_names_no_home_folder(tmp_path, monkeypatch):
    monkeypatch.setattr(Path, "home", lambda: Path("/home/somebody"))
    job = {"kind": "job", "job": "satin/pca/0", "run": "1", "status": "failed", "error": "/home/somebody/a.nbtf: short"}
    fine = {"kind": "job", "job": "satin/vq/0", "run": "1", "status": "ok"}
    fine["scores"] = {name: {"metrics": {}} for name in ("all", "heldout", "heldout, far", "grazing view", "low light")}
    fine |= {"fit_key": {}, "score_key": {}, "provenance": {}, "file": "files/a.nbtf"}
    fine["between"] = {"mean": 20.5, "centres": 30.25, "slices": 20}
    run = Run(tmp_path)
    for record in (fine, job):
        run.jobs.put(record["job"], record)
    lines = [json.loads(line) for line in published(run).splitlines()]
    assert [line.get("error") for line in lines] == [None, "~/a.nbtf: short"]
    assert lines[0]["between"] == fine["between"]
    assert list(lines[0]["scores"]) == ["all", "heldout", "heldout, far", "low light"]
