"""Quality, bytes and time of each codec over the revisions of several runs: one figure a material."""

import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from statistics import fmean
from typing import Any

from bench.metrics import stats_of
from bench.records import PSNR, Job, Records, Run, RunStart, Timing, shown_label
from reports.figures.canvas import Figure, legend, log_ticks, new, png, style
from reports.styles import Styles

Measured = tuple[Job, Timing]  # a job and its timing, empty without one
Codecs = dict[tuple[str, str], dict[str, list[Measured]]]  # by label and kind of held-out pairs, then by start
_QUANTITIES: dict[str, Callable[[Job, Timing], float | None]] = {  # of a job and its timing, if any
    "display PSNR, dB": lambda job, timing: stats_of(job, PSNR).get("mean"),
    "bytes of the file": lambda job, timing: float(job["bytes"]["total"]),
    "time a sample, × floor": lambda job, timing: timing.get("ratio_to_floor"),
}


def history_figures(runs: Sequence[Run]) -> Iterator[Figure]:
    """One figure a material, its starts in the order of their times; a point is a mean over seeds."""
    jobs: dict[Any, Job] = {}  # of all runs together, so that a codec looks alike in every figure
    starts: dict[str, RunStart] = {}
    for number, run in enumerate(runs):
        for job in run.jobs:
            jobs[number, job["job"]] = job
        for start in run.starts:
            starts[start["run"]] = start
    styles = Styles(Run(Path(), jobs=Records(jobs)))
    for material, codecs in _materials(runs).items():
        order = sorted(set().union(*codecs.values()))  # a start is named after its time
        several_kinds = len({pairs for _, pairs in codecs}) > 1
        with style():
            title = f"{material}: from revision to revision"
            drawing = new(8.2, 7.5)
            panels = drawing.subplots(3, 1, sharex=True)
            for axes, (name, quantity) in zip(panels, _QUANTITIES.items(), strict=True):
                handles = _lines(axes, quantity, codecs, order, styles)
                axes.set_ylabel(name, fontsize=8)
                if axes.get_subplotspec().is_first_row():
                    axes.set_title(title, loc="left")
                    names = []
                    for label, pairs in codecs:
                        names.append(f"{label}, {pairs} pairs" if several_kinds and pairs else label)
                    legend(axes, handles, names)
                else:
                    axes.set_yscale("log")
                    log_ticks(axes.yaxis, "B" if name.startswith("bytes") else "")
            panels[-1].set_xticks(range(len(order)), _ticks(order, starts), rotation=30, ha="right")
            yield Figure(material, "history", title, png(drawing), drawing)


def _lines(
    axes: Any,
    quantity: Callable[[Job, Timing], float | None],
    codecs: Codecs,
    order: Sequence[str],
    styles: Styles,
) -> list[Any]:
    """Draw a quantity of each codec over the starts; returns the lines. Those of validation pairs are dotted."""
    handles = []
    for (label, pairs), by_start in codecs.items():
        values = [_mean(quantity, by_start.get(when, [])) for when in order]
        look = styles.of_codec(label)
        if pairs == "validation":
            look = look | {"linestyle": ":"}
        handles += axes.plot(range(len(order)), values, **look, markersize=4, linewidth=1)
    return handles


def _mean(quantity: Callable[[Job, Timing], float | None], seeds: Sequence[Measured]) -> float:
    """The mean of a quantity over the seeds of a start; NaN, which is not drawn, if none has it."""
    values = []
    for job, timing in seeds:
        value = quantity(job, timing)
        if value is not None:
            values.append(value)
    return fmean(values) if values else math.nan


def _materials(runs: Sequence[Run]) -> dict[str, Codecs]:
    """The measured jobs of some runs by material, then as `Codecs` has them."""
    by_material: dict[str, Codecs] = {}
    for run in runs:
        for job in run.jobs:
            if job["status"] == "ok":
                codecs = by_material.setdefault(job["material"], {})
                codec = codecs.setdefault((shown_label(job), str(job.get("split", ""))), {})
                codec.setdefault(str(job.get("run", "")), []).append((job, run.timing(job) or Timing()))
    return by_material


def _ticks(order: Sequence[str], starts: dict[str, RunStart]) -> list[str]:
    """The names of starts on an axis: the revision, or the day where it is not known. Equal names are followed by the
    time of the start."""
    names = []
    for when in order:
        revision = starts.get(when, RunStart()).get("git")
        names.append(str(revision or when[:8])[:12])
    times = []
    for when in order:  # 11-23 09:31 of a start named 20251123T093106
        digits = "".join(filter(str.isdigit, when[:16]))
        month, day, hour, minute = (digits[place : place + 2] for place in (4, 6, 8, 10))
        times.append(f"{month}-{day} {hour}:{minute}" if len(digits) >= 12 else when)
    ticks = []
    for name, time in zip(names, times, strict=True):
        ticks.append(f"{name}, {time}" if names.count(name) > 1 else name)
    return ticks
