"""Quality, bytes and time of each codec over the revisions of several runs: one figure a material.

A start has one *revision* of the code (of git). Times are multiples of the floor.
"""

from collections.abc import Iterator
from typing import Any, cast

import pandas as pd

from bench.records import PSNR, Job
from reports.figures.canvas import Figure, legend, log_ticks, new, png, style
from reports.styles import Styles

_OF_HELDOUT, _OF_ALL = (f"scores/{group}/metrics/{PSNR}/mean" for group in ("heldout", "all"))
# By the label of an axis: the column that it shows; "psnr" is of the pairs that decide.
_QUANTITIES = {
    "display PSNR, dB": "psnr",
    "bytes of the file": "bytes/total",
    "time a sample, × floor": "timing/ratio_to_floor",
}
_COLUMNS = ("material", "codec", "label", "status", "split", "started", "git", "bytes/total", "timing/ratio_to_floor")


def history_figures(frame: pd.DataFrame) -> Iterator[Figure]:
    """One figure a material, its starts in the order of their times; a point is a mean over seeds.

    `frame` has the jobs of all runs, as `bench.load_runs` gives them.
    """
    jobs = frame.reindex(columns=[*_COLUMNS, _OF_HELDOUT, _OF_ALL])
    has_heldout = frame.filter(like="scores/heldout/").notna().any(axis=1)
    jobs["psnr"] = jobs[_OF_HELDOUT].where(has_heldout, jobs[_OF_ALL])
    jobs["split"] = jobs["split"].astype(object).fillna("")  # the kind of held-out pairs, where the record says it
    # Of all jobs, so that a codec looks alike in every figure.
    styles = Styles(cast(list[Job], jobs[["codec", "label"]].to_dict("records")))
    measured = jobs[jobs["status"] == "ok"]  # others have no numbers
    for material, of_material in measured.groupby("material", sort=False):
        with style():
            yield _figure(str(material), of_material, styles)


def _figure(material: str, jobs: pd.DataFrame, styles: Styles) -> Figure:
    """The figure of the jobs of one material: a panel for each of `_QUANTITIES`, one below the other."""
    starts = jobs.drop_duplicates("started").sort_values("started", na_position="first")
    title = f"{material}: from revision to revision"
    drawing = new(8.2, 7.5)
    panels = drawing.subplots(3, 1, sharex=True)
    for axes, (name, column) in zip(panels, _QUANTITIES.items(), strict=True):
        _draw_lines(axes, jobs, column, starts["started"], styles)
        axes.set_ylabel(name, fontsize=8)
        # The first panel, of PSNR, has the title and the legend of all; bytes and times have logarithmic axes.
        if axes is panels[0]:
            axes.set_title(title, loc="left")
            legend(axes, axes.lines, [line.get_label() for line in axes.lines])
        else:
            axes.set_yscale("log")
            log_ticks(axes.yaxis, "B" if name.startswith("bytes") else "")
    panels[-1].set_xticks(range(len(starts)), _ticks(starts), rotation=30, ha="right")
    return Figure(material, "history", title, png(drawing), drawing)


def _draw_lines(axes: Any, jobs: pd.DataFrame, column: str, order: "pd.Series[pd.Timestamp]", styles: Styles) -> None:
    """Draw a column of each codec over the starts, whose times are in `order`; lines of validation pairs are dotted.

    A line is labelled by its codec, with the kind of held-out pairs where codecs differ in it.
    """
    for (label, pairs), of_codec in jobs.groupby(["label", "split"], sort=False):
        by_start = of_codec.groupby("started", dropna=False)[column].mean()  # NaN, which is not drawn, without a number
        look = styles.of_codec(str(label))
        if pairs == "validation":
            look |= {"linestyle": ":"}
        words = f"{label}, {pairs} pairs" if pairs and jobs["split"].nunique() > 1 else label
        axes.plot(range(len(order)), by_start.reindex(order), label=words, **look, markersize=4, linewidth=1)


def _ticks(starts: pd.DataFrame) -> list[str]:
    """The words on an axis for starts: the revision, or the day where it is not known. Equal words are followed by the
    time of the start."""
    days = starts["started"].dt.strftime("%Y%m%d").fillna("")
    names = starts["git"].astype(object).fillna(days).str[:12]
    times = starts["started"].dt.strftime(", %m-%d %H:%M").fillna("")
    return list(names.where(~names.duplicated(keep=False), names + times))
