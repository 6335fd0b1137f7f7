"""The figures of a history: what stands where."""

import math

import numpy as np

from bench.records import load_run
from reports.figures import history


def test_points_are_means_over_seeds_by_start(made, tmp_path, monkeypatch):
    made.start("20250101T0").job("pca", psnr=30.0, run="20250101T0").job("pca", psnr=32.0, seed=1, run="20250101T0")
    made.timing("pca", run="20250101T0").job("table", psnr=None, run="20250101T0")
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
    assert any(all(map(math.isnan, values)) for values in lines.values())  # the table, which is exact
    assert any(np.array_equal(line.get_ydata(), [36110.0, 36110.0]) for line in size.lines)
    assert any(np.array_equal(line.get_ydata(), [1.75, np.nan], equal_nan=True) for line in time.lines)
    assert [text.get_text() for text in time.get_xticklabels()] == ["20250101", "20250301"]
    assert (figure.name, figure.kind) == ("history-satin.png", "history")
