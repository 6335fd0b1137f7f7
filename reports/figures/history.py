"""Quality, bytes and time of each codec over the revisions of several runs: one figure a material."""

import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from statistics import fmean

from bench.records import PSNR, Record, Records, Run, shown_label, stats_of
from reports.figures.canvas import Figure, legend, log_ticks, new, png, style
from reports.styles import Styles

Measured = tuple[Record, Record]  # a job and its timing, empty without one
Codecs = dict[tuple[str, str], dict[str, list[Measured]]]  # by label and kind of held-out pairs, then by start
_QUANTITIES: dict[str, Callable[[Record, Record], float | None]] = {  # of a job and its timing, if any
    "display PSNR, dB": lambda job, timing: stats_of(job, PSNR).get("mean"),
    "bytes of the file": lambda job, timing: float(job["bytes"]["total"]),
    "time a sample, × floor": lambda job, timing: timing.get("ratio_to_floor"),
}


def history_figures(runs: Sequence[Run]) -> Iterator[Figure]:
    """One figure for each material with results. Starts stand in the order of their times, named by revision.

    A point is the mean over seeds; a codec without an error, a size or a time has no point.
    """
    jobs = Records({(number, job["job"]): job for number, run in enumerate(runs) for job in run.jobs})
    styles = Styles(Run(Path(), jobs=jobs))
    starts = {start["run"]: start for run in runs for start in run.starts}
    for material, codecs in _materials(runs).items():
        order = sorted({when for by_start in codecs.values() for when in by_start})
        with style():
            title = f"{material}: from revision to revision"
            drawing = new(8.2, 7.5)
            for axes, (name, quantity) in zip(drawing.subplots(3, 1, sharex=True), _QUANTITIES.items(), strict=True):
                handles = []
                for (label, pairs), by_start in codecs.items():
                    values = [_mean(quantity, by_start.get(when, [])) for when in order]
                    drawn = styles.of_codec(label) | ({"linestyle": ":"} if pairs == "validation" else {})
                    handles += axes.plot(range(len(order)), values, **drawn, markersize=4, linewidth=1)
                axes.set_ylabel(name, fontsize=8)
                if axes.get_subplotspec().is_first_row():
                    axes.set_title(title, loc="left")
                    several = len({pairs for _, pairs in codecs}) > 1
                    legend(
                        axes,
                        handles,
                        [f"{label}, {pairs} pairs" if several and pairs else label for label, pairs in codecs],
                    )
                else:
                    axes.set_yscale("log")
                    log_ticks(axes.yaxis, "B" if name.startswith("bytes") else "")
            axes.set_xticks(range(len(order)), _ticks(order, starts), rotation=30, ha="right")
            yield Figure(material, "history", title, png(drawing), drawing)


def _materials(runs: Sequence[Run]) -> dict[str, Codecs]:
    by_material: dict[str, Codecs] = {}
    for run in runs:
        for job in run.jobs:
            if job["status"] == "ok":
                codecs = by_material.setdefault(job["material"], {})
                codec = codecs.setdefault((shown_label(job), str(job.get("split", ""))), {})
                codec.setdefault(str(job.get("run", "")), []).append((job, run.timing(job) or {}))
    return by_material


def _mean(quantity: Callable[[Record, Record], float | None], jobs: Sequence[Measured]) -> float:
    """The mean of a quantity over the seeds that have it; NaN, which is not drawn, if none has it."""
    known = [value for job, timing in jobs if (value := quantity(job, timing)) is not None]
    return fmean(known) if known else math.nan


def _ticks(order: Sequence[str], starts: dict[str, Record]) -> list[str]:
    """The names of starts on an axis: the revision, or the day, with the time of day if several are equal."""
    names = [str(starts.get(when, {}).get("git") or when[:8])[:12] for when in order]
    return [
        f"{name}, {_time(when)}" if names.count(name) > 1 else name for name, when in zip(names, order, strict=True)
    ]


def _time(when: str) -> str:
    """The day and time of a start's name: 11-23 09:31 of 20251123T093106."""
    digits = "".join(filter(str.isdigit, when[:16]))
    return f"{digits[4:6]}-{digits[6:8]} {digits[8:10]}:{digits[10:12]}" if len(digits) >= 12 else when
