"""Quality, bytes and time of each codec over the revisions of several runs: one figure a material.

A start has one *revision* of the code (of git), and is named after its time, `20251123T093106`. Times are multiples of
the floor.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from statistics import fmean
from typing import Any

from bench.metrics import stats_of
from bench.records import PSNR, Job, Run, RunStart, Timing, shown_label
from reports.figures.canvas import Figure, legend, log_ticks, new, png, style
from reports.styles import Styles

Measured = tuple[Job, Timing]  # a job and its timing, empty without one
# By label and kind of held-out pairs ("test", "validation", or "" where the record does not say), then by start: the
# jobs of one material, one a seed.
Codecs = dict[tuple[str, str], dict[str, list[Measured]]]
# By the label of an axis: what it shows of a job and its timing; None where that is not known.
_QUANTITIES: dict[str, Callable[[Job, Timing], float | None]] = {
    "display PSNR, dB": lambda job, timing: stats_of(job, PSNR).get("mean"),
    "bytes of the file": lambda job, timing: float(job["bytes"]["total"]),
    "time a sample, × floor": lambda job, timing: timing.get("ratio_to_floor"),
}


def history_figures(runs: Sequence[Run]) -> Iterator[Figure]:
    """One figure a material, its starts in the order of their times; a point is a mean over seeds."""
    jobs: list[Job] = []  # of all runs together, so that a codec looks alike in every figure
    starts: dict[str, RunStart] = {}  # by name
    for run in runs:
        jobs += run.jobs
        for start in run.starts:
            starts[start.get("run", "")] = start  # a reference names no start, nor do its jobs
    styles = Styles(jobs)
    for material, codecs in _materials(runs).items():
        with style():
            yield _figure(material, codecs, starts, styles)


def _figure(material: str, codecs: Codecs, starts: Mapping[str, RunStart], styles: Styles) -> Figure:
    """The figure of one material: a panel for each of `_QUANTITIES`, one below the other. `starts` are by name."""
    order = sorted(set().union(*codecs.values()))  # names of starts; each is named after its time
    title = f"{material}: from revision to revision"
    drawing = new(8.2, 7.5)
    panels = drawing.subplots(3, 1, sharex=True)
    for axes, (name, quantity) in zip(panels, _QUANTITIES.items(), strict=True):
        handles = _draw_lines(axes, quantity, codecs, order, styles)
        axes.set_ylabel(name, fontsize=8)
        # The first panel, of PSNR, has the title and the legend of all; bytes and times have logarithmic axes.
        if axes.get_subplotspec().is_first_row():
            axes.set_title(title, loc="left")
            legend(axes, handles, _legend_words(codecs))
        else:
            axes.set_yscale("log")
            log_ticks(axes.yaxis, "B" if name.startswith("bytes") else "")
    panels[-1].set_xticks(range(len(order)), _ticks(order, starts), rotation=30, ha="right")
    return Figure(material, "history", title, png(drawing), drawing)


def _legend_words(codecs: Codecs) -> list[str]:
    """The words of the legend: labels, with the kind of held-out pairs where codecs differ in it."""
    if len({pairs for _, pairs in codecs}) == 1:
        return [label for label, _ in codecs]
    return [f"{label}, {pairs} pairs" if pairs else label for label, pairs in codecs]


def _draw_lines(
    axes: Any,
    quantity: Callable[[Job, Timing], float | None],
    codecs: Codecs,
    order: Sequence[str],
    styles: Styles,
) -> list[Any]:
    """Draw a quantity of each codec, one of `_QUANTITIES`, over the starts, whose names are in `order`.

    Returns Matplotlib's lines, one for each key of `codecs`. Those of validation pairs are dotted.
    """
    handles = []
    for (label, pairs), by_start in codecs.items():
        values = [_mean(quantity, by_start.get(when, [])) for when in order]
        look = styles.of_codec(label)
        if pairs == "validation":
            look |= {"linestyle": ":"}
        handles += axes.plot(range(len(order)), values, **look, markersize=4, linewidth=1)
    return handles


def _mean(quantity: Callable[[Job, Timing], float | None], seeds: Sequence[Measured]) -> float:
    """The mean of a quantity over the seeds of a start; NaN, which is not drawn, if none has it."""
    values = [quantity(job, timing) for job, timing in seeds]
    known = [value for value in values if value is not None]
    return fmean(known) if known else math.nan


def _materials(runs: Sequence[Run]) -> dict[str, Codecs]:
    """The measured jobs of some runs by material, then as `Codecs` has them."""
    by_material: dict[str, Codecs] = {}
    for run in runs:
        for job in run.jobs:
            if job["status"] == "ok":  # others have no numbers
                codecs = by_material.setdefault(job["material"], {})
                by_start = codecs.setdefault((shown_label(job), str(job.get("split", ""))), {})
                by_start.setdefault(str(job.get("run", "")), []).append((job, run.timing(job) or Timing()))
    return by_material


def _ticks(order: Sequence[str], starts: Mapping[str, RunStart]) -> list[str]:
    """The words on an axis for starts of these names: the revision, or the day where it is not known. Equal words are
    followed by the time of the start."""
    names = []
    for when in order:
        revision = starts.get(when, RunStart()).get("git")
        names.append(str(revision or when[:8])[:12])  # the name of a start begins with the day, 20251123
    ticks = []
    for name, when in zip(names, order, strict=True):
        ticks.append(f"{name}, {_time_in_words(when)}" if names.count(name) > 1 else name)
    return ticks


def _time_in_words(start: str) -> str:
    """The day and time of a start by its name: "11-23 09:31" of 20251123T093106; a name of another form as it is."""
    digits = "".join(filter(str.isdigit, start[:16]))
    if len(digits) < 12:
        return start
    month, day, hour, minute = digits[4:6], digits[6:8], digits[8:10], digits[10:12]
    return f"{month}-{day} {hour}:{minute}"
