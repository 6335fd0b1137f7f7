"""The figures of a history: what stands where."""

import numpy as np

from bench.records import append, load_run
from reports.figures import history


def test_points_are_means_over_seeds_by_start(made, tmp_path, monkeypatch):
    made.start("20250101T0").job("pca", psnr=30.0, run="20250101T0").job("pca", psnr=32.0, seed=1, run="20250101T0")
    made.timing("pca", run="20250101T0").job("table", psnr=100.0, run="20250101T0")
    later = type(made)(tmp_path / "later").start("20250301T0").job("pca", psnr=35.0, run="20250301T0")
    drawn, plain = {}, history.new

    def watched(*size):
        drawn["figure"] = plain(*size)
        return drawn["figure"]

    monkeypatch.setattr(history, "new", watched)
    (figure,) = history.history_figures([load_run(later.folder), load_run(made.folder)])
    quality, size, time = drawn["figure"].axes
    lines = {line.get_color(): line.get_ydata() for line in quality.lines}
    assert any(np.array_equal(values, [31.0, 35.0]) for values in lines.values())
    assert any(100.0 in values for values in lines.values())  # the table, which is exact
    assert any(np.array_equal(line.get_ydata(), [36110.0, 36110.0]) for line in size.lines)
    assert any(np.array_equal(line.get_ydata(), [1.75, np.nan], equal_nan=True) for line in time.lines)
    assert [text.get_text() for text in time.get_xticklabels()] == ["20250101", "20250301"]
    assert (figure.name, figure.kind) == ("history-satin.png", "history")


def test_test_and_validation_pairs_are_two_lines_and_starts_of_one_revision_are_told_apart(made, monkeypatch):
    for run, split in (("20250101T093000", "test"), ("20250102T101500", "validation"), ("20250103T111500", "test")):
        append(made.folder, {"kind": "run", "run": run, "suite": "made", "git": "abc"})
        made.job(f"pca components={run[7]}", psnr=30.0, run=run, split=split)
        made.job("vq", psnr=20.0 + int(run[7]), run=run, split=split, seed=int(run[7]))
    drawn, plain = {}, history.new
    monkeypatch.setattr(history, "new", lambda *size: drawn.setdefault("figure", plain(*size)))
    list(history.history_figures([load_run(made.folder)]))
    quality, *_, time = drawn["figure"].axes
    lines = dict(zip([text.get_text() for text in quality.get_legend().get_texts()], quality.lines, strict=True))
    assert {"vq, test pairs", "vq, validation pairs"} <= set(lines)
    np.testing.assert_array_equal(lines["vq, test pairs"].get_ydata(), [21, np.nan, 23])
    np.testing.assert_array_equal(lines["vq, validation pairs"].get_ydata(), [np.nan, 22, np.nan])
    assert lines["vq, validation pairs"].get_linestyle() != lines["vq, test pairs"].get_linestyle()
    ticks = [text.get_text() for text in time.get_xticklabels()]
    assert ticks == ["abc, 01-01 09:30", "abc, 01-02 10:15", "abc, 01-03 11:15"]
