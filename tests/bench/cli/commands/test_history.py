import re

import pandas as pd
import pytest

import bench
from bench import cli
from bench.inputs.errors import InputError
from bench.records import FILE, append, load_run

PSNR = "scores/heldout/metrics/psnr_display/pooled"


@pytest.fixture
def runs(tmp_path):
    for day, psnr in ((20, 30.25), (21, 1 / 3)):
        run = f"202511{day}T080000.000000"
        folder = tmp_path / f"run{day}"
        folder.mkdir()
        start = {"kind": "run", "run": run, "suite": "made", "git": f"rev{day}", "packages": {"torch": "2.13.0"}}
        append(folder, start | {"machine": {"processor": "P"}})
        job = {"kind": "job", "job": "satin/pca k=8/0", "run": run, "material": "satin", "label": "pca k=8"}
        job |= {"codec": "pca", "seed": 0, "status": "ok", "parameters": 7, "bytes": {"total": 1000 + day}}
        job["fit_key"] = {"version": 1, "settings": {"k": 8}, "training": "t", "device": "cpu", "threads": 1}
        job |= {"score_key": {"btf": "b", "exposure": 1.5, "sha256": "0"}, "shape": [8, 9], "history": [{"step": 1}]}
        job["metrics"] = {"psnr_display": {"unit": "dB", "direction": "higher", "space": "display", "version": 3}}
        job["scores"] = {"heldout": {"metrics": {"psnr_display": {"pooled": psnr, "exact": 0, "slices": 4}}}}
        append(folder, job)
        timing = {"kind": "timing", "job": job["job"], "run": run, "ns_per_sample": 12.5}
        append(folder, timing | {"interval95_ns": [12.0, 13.0], "samples_ns": [1.0]})
    failed = {"kind": "job", "job": "satin/vq/0", "run": run, "material": "satin", "label": "vq", "codec": "vq"}
    failed |= {"seed": 0}
    append(folder, failed | {"status": "failed", "error": "no luck"})
    return [tmp_path / "run20", tmp_path / "run21"]


def test_many_runs_are_one_frame(runs):
    frame = bench.load_runs(runs)
    assert list(frame["job"]) == ["satin/pca k=8/0", "satin/pca k=8/0", "satin/vq/0"]
    assert list(frame["folder"]) == [str(runs[0]), str(runs[1]), str(runs[1])]
    assert (list(frame["git"]), frame["started"].diff()[1]) == (["rev20", "rev21", "rev21"], pd.Timedelta(days=1))
    assert list(frame[PSNR][:2]) == [30.25, 1 / 3]
    first = frame.iloc[0]
    assert (first["bytes/total"], first["parameters"], first["codec_version"], first["height"]) == (1020, 7, 1, 8)
    assert (first["settings"], first["metric_version/psnr_display"]) == ('{"k": 8}', 3)
    assert (first["timing/ns_per_sample"], first["timing/interval95_ns/1"]) == (12.5, 13.0)
    assert (frame["status"][2], frame["error"][2]) == ("failed", "no luck")


def test_a_start_is_named_after_its_time_with_or_without_a_fraction_of_a_second(tmp_path):
    for number, run in enumerate(("20251123T093106", "20251123T093106.500000", "1")):
        job = {"kind": "job", "job": f"satin/vq/{number}", "run": run, "material": "satin", "label": "vq"}
        append(tmp_path, job | {"codec": "vq", "seed": number, "status": "failed", "error": "no luck"})
    start = pd.Timestamp("2025-11-23 09:31:06", tz="UTC")
    assert list(bench.load_runs(tmp_path)["started"]) == [start, start + pd.Timedelta(seconds=0.5), pd.NaT]


def test_nothing_measured_is_an_empty_frame(tmp_path):
    append(tmp_path, {"kind": "run", "run": "1"})
    assert bench.load_runs(tmp_path).empty
    assert cli.main(["history", str(tmp_path)]) == 4
    with pytest.raises(InputError, match=str(tmp_path / "none")):
        bench.load_runs([tmp_path, tmp_path / "none"])


def test_a_line_that_cannot_be_read_is_warned_of(runs, caplog):
    with open(runs[0] / FILE, "a") as file:
        file.write('{"kind": "jo')
    assert len(bench.load_runs(runs)) == 3
    assert re.search("run20: .*4$", caplog.text, re.M)
    caplog.clear()
    assert cli.main(["history", *map(str, runs)]) == 0
    assert re.search("run20: .*4$", caplog.text, re.M)


def test_a_folder_that_cannot_be_written_is_bad_usage(runs, capsys):
    assert cli.main(["history", *map(str, runs), "--plot", "/proc/no"]) == 2
    assert "/proc/no" in capsys.readouterr().err


def test_plots_show_quality_bytes_and_time_over_the_revisions(runs, tmp_path, capsys):
    assert cli.main(["history", *map(str, runs), "--plot", str(tmp_path / "plots")]) == 0
    names = ["history-satin.png", "history-satin.svg", "history-satin.pdf", "history.html"]
    assert capsys.readouterr().out.splitlines() == [f"wrote {tmp_path / 'plots' / name}" for name in names]
    first = {name: (tmp_path / "plots" / name).read_bytes() for name in names}
    assert first["history-satin.png"].startswith(b"\x89PNG")
    page = first["history.html"].decode()
    assert page.count("<svg") == page.count("</svg>") == 1
    assert cli.main(["history", *map(str, reversed(runs)), "--plot", str(tmp_path / "plots")]) == 0
    assert {name: (tmp_path / "plots" / name).read_bytes() for name in names} == first


def test_the_table_names_the_revision_of_a_codec_of_another_repository(runs, capsys):
    assert cli.main(["history", *map(str, runs)]) == 0
    assert "codec's revision" not in capsys.readouterr().out
    job = next(job for job in load_run(runs[1]).jobs if job["label"] == "pca k=8")
    append(runs[1], job | {"fitted": {"git": "rev21", "codec": "abc123"}})
    assert cli.main(["history", *map(str, runs)]) == 0
    header, _, *rows = capsys.readouterr().out.splitlines()
    place = header.index("codec's revision")
    assert [row[place:].split()[0] for row in rows if " pca" in row] == ["—", "abc123"]
