"""The jobs of a run as rows of tables, by material, with the reasons why a row cannot be compared with the others.

The *family* of a metric is its name without its variant.
"""

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from bench.compare.frame import FUSED, values_of
from bench.metrics import all_exact, mean_over, metric_of, stats_of
from bench.records import (
    CONDITIONS,
    PSNR,
    Job,
    MetricFacts,
    Run,
    Statistics,
    Timing,
    deciding_group,
    fitted_to_scene,
    grouped,
    method_of,
    metrics_of,
    require,
    view,
)

NEW_RUN = "timed in another start than the other rows"


@dataclass(frozen=True)
class Row:
    """One job of a material; `label` is the codec with its settings, `name` has the seed too if there are several.

    An obstacle is the reason, in words, why a number must not be compared; "" where it may be.
    """

    job: Job
    label: str
    name: str
    values: Mapping[str, Any]  # by column of `bench.compare.frame`
    timing: Timing | None = None
    obstacle: str = ""  # of all its numbers
    timing_obstacle: str = ""  # of its time alone

    @cached_property
    def measured(self) -> bool:
        """Whether there are numbers that may be compared."""
        return self.job["status"] == "ok" and not self.obstacle

    @property
    def fused(self) -> float | None:
        """Its time with all of a query in one kernel, × floor, if `neubtf-bench trade` measured it."""
        return self.values[FUSED]

    @property
    def timed_apart(self) -> bool:
        """Whether it was timed in another start than the other rows, so that its time is shown with a star."""
        return self.timing_obstacle == NEW_RUN

    @property
    def time_left_out(self) -> bool:
        """Whether it was timed under other conditions than the other rows, so that its time is not shown."""
        return bool(self.timing_obstacle) and not self.timed_apart

    @property
    def deciding_group(self) -> str:
        """The name in records of the pairs that decide: "heldout", or "all" if none are held out."""
        return deciding_group(self.job["scores"])

    @property
    def psnr(self) -> float | None:
        """The mean display PSNR of the slices that decide, in dB; None if they have no error."""
        stats = self.stats(self.deciding_group, PSNR)
        return None if all_exact(stats) else stats.get("mean")

    def metric(self, family: str) -> str:
        """The full name of the metric of a family that scored this job (`ssim` → `ssim_periodic`); "" if none did."""
        return metric_of(metrics_of(self.job), family)

    def stats(self, group: str, family: str) -> Statistics:
        """The statistics (mean, std, counts of slices) of a family's metric over a group of pairs, such as "heldout";
        empty if there are none."""
        return stats_of(self.job, family, group)


@dataclass(frozen=True)
class CodecRows:
    """The jobs of one codec with its settings on one material, one a seed."""

    label: str
    rows: list[Row]

    @cached_property
    def measured(self) -> list[Row]:
        """The rows whose numbers may be compared."""
        return [row for row in self.rows if row.measured]

    @property
    def codec(self) -> str:
        """The name of the codec, without settings."""
        return method_of(self.rows[0].job)

    @property
    def of_scene(self) -> bool:
        """Whether its files were fitted to a scene, so that its quality over the whole material is not ranked."""
        return any(fitted_to_scene(row.job) for row in self.measured)

    @property
    def psnr(self) -> float | None:
        """The mean over seeds of the mean display PSNR of the slices that decide, in dB; None without a number."""
        return mean_over([row.job for row in self.measured], PSNR)

    @property
    def exact(self) -> bool:
        """Whether no deciding slice has an error, for any seed; also true of a codec that was not measured."""
        return all(row.psnr is None for row in self.measured)

    @property
    def ladder(self) -> str:
        """The name of the curve that a figure draws through several settings of a codec, if its record says one; else
        the codec's name. The codec must have a measured row."""
        return str(self.measured[0].job.get("curve") or self.codec)


@dataclass(frozen=True)
class MaterialRows:
    """The rows of one material, in the order of the suite."""

    name: str
    rows: list[Row]
    # Labels without a result on any material of the run. Of all tables only that of unfinished jobs has them.
    without_results: frozenset[str] = frozenset()

    @cached_property
    def measured(self) -> list[Row]:
        """The rows whose numbers may be compared."""
        return [row for row in self.rows if row.measured]

    @cached_property
    def codecs(self) -> list[CodecRows]:
        """The rows by codec with its settings, without those that have no result on any material of the run."""
        rows_of_label = grouped(self.rows, lambda row: row.label)
        return [CodecRows(label, rows) for label, rows in rows_of_label.items() if label not in self.without_results]

    @property
    def seeds(self) -> list[int]:
        """The measured seeds, in order; a record without one counts as seed 0."""
        return sorted({int(row.job.get("seed") or 0) for row in self.measured})

    @property
    def shown(self) -> list[Row]:
        """One row a measured codec, for its first seed; pictures show only one seed."""
        return [codec.measured[0] for codec in self.codecs if codec.measured]

    @property
    def first(self) -> Job | None:
        """A record to read from what all comparable rows share: split, shape, metrics; None if nothing was measured."""
        return next((row.job for row in self.measured), None)

    @cached_property
    def metrics(self) -> dict[str, MetricFacts]:
        """By name: every metric that a comparable row was scored with, as the records describe it (unit, direction)."""
        return {name: facts_of(row.job, name) for row in self.measured for name in metrics_of(row.job)}

    @property
    def deciding_group(self) -> str:
        """The name in records of the pairs that decide for all comparable rows; "heldout" if nothing was measured."""
        return self.measured[0].deciding_group if self.measured else "heldout"

    @property
    def deciding_in_words(self) -> str:
        """The pairs that decide: "held-out pairs" or "all pairs"."""
        return "held-out pairs" if self.deciding_group == "heldout" else "all pairs"

    @property
    def split_in_words(self) -> str:
        """The size and the pairs: "64 × 64 texels, 625 training pairs, 150 held out"; "nothing measured" without a
        measured row."""
        if self.first is None:
            return "nothing measured"
        height, width = self.first["shape"]
        pairs = self.first["pairs"]
        if "heldout" in pairs:
            heldout = f"{pairs['heldout']:,} held out"
        else:
            heldout = "none held out, so scored at all pairs"
        words = f"{height} × {width} texels, {pairs['train']:,} training pairs, {heldout}"
        if self.first.get("views") == 1:
            words += "; one view: answers from other views are not measured"
        return words


def facts_of(job: Job, metric: str) -> MetricFacts:
    """The unit and direction of a metric as a record describes it or, if it does not, those of a variant of the metric.

    Frames, for example, are scored by SSIM, while slices are scored by the periodic variant.
    """
    described = job["metrics"]  # by name of metric
    if described.get(metric):
        return described[metric]
    variant = metric_of(described, metric)  # "" if there is none
    if described.get(variant):
        return described[variant]
    return MetricFacts(unit="1", direction="higher", version=0)  # an older record does not describe it


@view
def materials(run: Run) -> list[MaterialRows]:
    """The run's jobs by material, in the order of the suite; kept with the run.

    `InputError` if a finished job lacks a field that tables show.
    """
    finished = [job for job in run.jobs if job["status"] == "ok"]
    for job in finished:
        require(job, "tables", run.folder)
    without_results = frozenset(job["label"] for job in run.jobs) - {job["label"] for job in finished}
    values_by_job = {values["job"]: values for values in values_of(run)}
    by_material = grouped(run.jobs, lambda job: str(job["material"]))
    rows_of = {name: [*_rows_of_material(run, jobs, values_by_job)] for name, jobs in by_material.items()}
    return [MaterialRows(name, rows, without_results) for name, rows in rows_of.items()]


def _rows_of_material(run: Run, jobs: list[Job], values_by_job: Mapping[str, Mapping[str, Any]]) -> Iterator[Row]:
    """The jobs of one material as rows; `values_by_job` has by name of job its values by column of the frame."""
    timing_of = {job["job"]: run.timing(job) for job in jobs if job["status"] == "ok"}  # None for a job without one
    timings = [timing for timing in timing_of.values() if timing]
    counts = Counter(timing["run"] for timing in timings)  # of timings, by start
    # A timing of the start that timed most rows, against which the others are held; of several such starts, the last.
    # So a single codec that is timed again is the one with a star, and the times of all others stay as they are.
    common = max(timings, key=lambda timing: (counts[timing["run"]], timing["run"]), default=Timing())
    seeds = {job.get("seed") for job in jobs}
    for job in jobs:
        label = job["label"]
        timing = timing_of.get(job["job"])
        yield Row(
            job,
            label,
            name=f"{label} seed={job['seed']}" if len(seeds) > 1 else label,
            values=values_by_job[job["job"]],
            timing=timing,
            obstacle=values_by_job[job["job"]]["why"] if job["status"] == "ok" else "",
            timing_obstacle=_timing_obstacle(timing, common) if timing else "",
        )


def _timing_obstacle(timing: Timing, common: Timing) -> str:
    """Why a time is not comparable with `common`, one of the start that timed most rows; "" if it is."""
    other_conditions = [f"{name} {timing.get(name)}" for name in CONDITIONS if timing.get(name) != common.get(name)]
    if other_conditions:
        return "timed under other conditions: " + ", ".join(other_conditions)
    return NEW_RUN if timing["run"] != common["run"] else ""
