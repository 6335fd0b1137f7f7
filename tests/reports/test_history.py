import numpy as np

from bench.compare.frame import load_runs
from bench.compare.reference import reference
from bench.records import append, load_run
from reports.figures import history


def test_test_and_validation_pairs_are_two_lines_and_starts_of_one_revision_are_told_apart(made, monkeypatch):
    for run, split in (("20250101T093000", "test"), ("20250102T101500", "validation"), ("20250103T111500", "test")):
        append(made.folder, {"kind": "run", "run": run, "suite": "made", "git": "abc"})
        made.job(f"pca components={run[7]}", psnr=30.0, run=run, split=split)
        made.job("vq", psnr=20.0 + int(run[7]), run=run, split=split, seed=int(run[7]))
    drawn, plain = {}, history.new
    monkeypatch.setattr(history, "new", lambda *size: drawn.setdefault("figure", plain(*size)))
    list(history.history_figures(load_runs(made.folder)))
    quality, *_, time = drawn["figure"].axes
    lines = dict(zip([text.get_text() for text in quality.get_legend().get_texts()], quality.lines, strict=True))
    assert {"vq, test pairs", "vq, validation pairs"} <= set(lines)
    np.testing.assert_array_equal(lines["vq, test pairs"].get_ydata(), [21, np.nan, 23])
    np.testing.assert_array_equal(lines["vq, validation pairs"].get_ydata(), [np.nan, 22, np.nan])
    assert lines["vq, validation pairs"].get_linestyle() != lines["vq, test pairs"].get_linestyle()
    ticks = [text.get_text() for text in time.get_xticklabels()]
    assert ticks == ["abc, 01-01 09:30", "abc, 01-02 10:15", "abc, 01-03 11:15"]


def test_a_reference_whose_starts_have_no_names_is_drawn_as_one_of_them(made, tmp_path, monkeypatch):
    append(made.folder, {"kind": "run", "run": "1", "suite": "made", "git": "abc"})
    made.job("vq", fit_key={"version": 1}, score_key={"btf": "b"})
    path = tmp_path / "reference.jsonl"
    path.write_text(reference(load_run(made.folder)))
    drawn, plain = {}, history.new
    monkeypatch.setattr(history, "new", lambda *size: drawn.setdefault("figure", plain(*size)))
    assert len(list(history.history_figures(load_runs(path)))) == 1
    quality = drawn["figure"].axes[0]
    assert [list(line.get_ydata()) for line in quality.lines] == [[30.0]]
