"""What was measured, as one pandas frame: a row a job, from which tables are made by choosing and grouping rows.

Failed jobs have a row, too. Values are numbers, not rounded, with NaN where nothing was measured, and texts. Columns
that name or judge the job come first:

- `material`, and `surface`, its kind: measured, path-traced, rendered, or what its data call it; "" if not known
- `codec`, `recipe`, and `line`: the codec, or "neumip, as published" by the recipe of its paper
- `label`, `setting` (what the label says besides the line, or "default"), `seed`, `job`, `status`
- `why`: why it must stand in no table: its error on one line, or why it is not comparable with newer jobs; or ""
- `stale`: how its versions differ from the installed ones, so that it cannot be made again; or ""
- `fitted_to_scene`: whether its file answers for one scene alone, so that it is ranked nowhere
- `bits`: of the whole file, a texel
- `eager`, `fused`, `gpu`: the time of a sample, × floor, a median, by the rules of tables of budgets
- `fit_seconds`: the processor time of the fit
- `codec_version`, `training`, `device`, `threads`: of its fit; `started`, `suite`, `git`, `processor`, `package/…`: of
  its run

Then follows the record, with columns named after its fields, as in a run's `tables/results.csv`: `settings` (JSON),
`bytes/total`, `scores/heldout/metrics/psnr_display/mean`, `footprints/2/mean`, `timing/ns_per_sample`. Jobs of
different runs are comparable only if `codec_version`, `training`, `btf` and `metric_version/…` agree.

`frame.attrs` has `units` and `directions` ("higher" or "lower" is better), both by column, where they are known.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import chain
from math import nan
from operator import itemgetter
from os import PathLike
from typing import TYPE_CHECKING, Any

from bench.codecs.alike import obstacles, stale
from bench.machine.devices import is_gpu
from bench.records import (
    PSNR,
    FitKey,
    Job,
    MetricFacts,
    Run,
    RunStart,
    Timing,
    as_published,
    fitted_to_scene,
    flattened,
    grouped,
    kind_of,
    load_warned,
    method_of,
    usual_batch,
    view,
)

if TYPE_CHECKING:
    import pandas as pd

EAGER, FUSED, GPU = "eager", "fused", "gpu"  # kinds of times of a query
_NEEDED = ("run", "score_key")  # fields of a finished job without which nothing says whether it is comparable
_COSTS = {  # columns that are no metrics: unit; lower is better
    "bits": "bits a texel",
    "bytes/total": "bytes",
    "eager": "× floor",
    "fused": "× floor",
    "gpu": "× floor",
    "fit_seconds": "s",
    "timing/ns_per_sample": "ns",
    "timing/ratio_to_floor": "× floor",
}
_VALUES = ("mean", "pooled", "worst")  # statistics of a metric that have its unit, and its better end

_Row = dict[str, Any]  # by column


def load_runs(paths: str | PathLike[str] | Iterable[str | PathLike[str]]) -> "pd.DataFrame":
    """The jobs of one or several runs, given their folders or files of records (`.jsonl`), which `folder` names.

    The columns `why` and `stale` are of each run by itself; times on a GPU count for the settings of all of them.
    `InputError` if a path holds no run; warns of lines that cannot be read.
    """
    if isinstance(paths, str | PathLike):
        paths = [paths]
    runs = {str(path): load_warned(str(path)) for path in paths}
    on_gpu: dict[str, Timing] = {}
    for run in runs.values():
        on_gpu |= gpu_times(run)
    rows = [{"folder": path} | row for path, run in runs.items() for row in values_of(run, on_gpu)]
    return _framed(rows, [job for run in runs.values() for job in run.jobs])


def frame_of(run: Run, records: bool = True) -> "pd.DataFrame":
    """The jobs of a run, or of several that were loaded as one, in its order.

    Without `records`, only with the columns that name or judge the job.
    """
    return _framed(list(values_of(run, records=records)), run.jobs)


def line_of(job: Job) -> str:
    """The line of a job: its codec's name; a codec as published has its own line."""
    method = method_of(job)
    return f"{method}, as published" if as_published(job) else method


def settings_in(label: str) -> list[str]:
    """The settings that a label names after its codec, without the one that makes a line of its own."""
    return [word for word in label.split()[1:] if word != "recipe=paper"]


def setting_of(job: Job) -> str:
    """The settings of a job in words, without those of its line."""
    return " ".join(settings_in(job["label"])) or "default"


def _framed(rows: Sequence[_Row], jobs: Iterable[Job]) -> "pd.DataFrame":
    """The rows as a frame, with the units and directions that the records of `jobs` know; no columns without rows."""
    import pandas as pd  # slow to import, and the values alone do not need it

    columns: dict[str, pd.Series] = {}
    for name in dict.fromkeys(chain.from_iterable(rows)):
        values = [nan if row.get(name) is None else row[name] for row in rows]
        has_text = any(isinstance(value, str) for value in values)
        # Texts stay objects, as they are with every version of pandas.
        columns[name] = pd.Series(values, dtype=object if has_text else None)
    frame = pd.DataFrame(columns)
    if rows:
        frame["started"] = pd.to_datetime(frame["started"], format="ISO8601", utc=True, errors="coerce")
    facts: dict[str, MetricFacts] = {}
    for job in jobs:
        facts |= job.get("metrics", {})
    units, directions = _units_and_directions(columns, facts)
    frame.attrs = {"units": units, "directions": directions}
    return frame


def _units_and_directions(
    columns: Iterable[str], facts: Mapping[str, MetricFacts]
) -> tuple[dict[str, str], dict[str, str]]:
    """The units and the directions of columns, where they are known; `facts` has those of metrics by name."""
    units = {}
    directions = {}
    for column in columns:
        if column in _COSTS:
            units[column], directions[column] = _COSTS[column], "lower"
            continue
        match column.split("/"):
            case ["scores", *_, "metrics", metric, statistic]:
                pass
            case ["footprints", _, "mean" as statistic] | ["between", "mean" | "centres" as statistic]:
                metric = PSNR  # of means over squares, and between texels
            case _:
                continue
        if metric not in facts:
            continue
        if statistic in (*_VALUES, "centres", "std"):
            units[column] = facts[metric]["unit"]
        if statistic in (*_VALUES, "centres"):
            directions[column] = facts[metric]["direction"]
    return units, directions


def values_of(run: Run, on_gpu: Mapping[str, Timing] | None = None, records: bool = True) -> Iterator[_Row]:
    """The row of each job of a run: values by column of the frame, None or absent where it has none.

    `on_gpu` has the timing of settings on a GPU, by label; by default those of the run. `records` is as in `frame_of`.
    """
    starts = {start.get("run"): start for start in reversed(run.starts)}  # files of published records may have none
    surfaces = {job["material"]: kind_of(job) for job in run.jobs if job["status"] == "ok"}
    reasons = _reasons(run)
    versions = stale(run.jobs)
    comparable = [job for job in run.jobs if job["job"] not in reasons]
    fused = fused_times(run)
    if on_gpu is None:
        on_gpu = gpu_times(run)
    times = _times_of(run, comparable, fused, on_gpu)
    for job in run.jobs:
        name = job["job"]
        fit = job.get("fit_key", FitKey())
        start = starts.get(job.get("run"), RunStart())
        of_job: _Row = {
            "material": job["material"],
            "surface": surfaces.get(job["material"], ""),
            "codec": method_of(job),
            "recipe": str(job.get("settings", {}).get("recipe", "")),
            "line": line_of(job),
            "label": job["label"],
            "setting": setting_of(job),
            "seed": job.get("seed"),  # scores of a file that was not fitted in a run have none
            "job": name,
            "status": job["status"],
            "why": reasons.get(name, ""),
            "stale": versions.get(name, ""),
            "fitted_to_scene": fitted_to_scene(job),
            "bits": _bits(job),
            "eager": times[EAGER].get(name),
            "fused": times[FUSED].get(name),
            "gpu": times[GPU].get(name),
            "fit_seconds": job.get("fit_seconds"),
            "codec_version": fit.get("version"),
            "training": fit.get("training"),
            "device": fit.get("device"),
            "threads": fit.get("threads"),
            "started": job.get("run"),
            "suite": start.get("suite"),
            "git": start.get("git"),
            "processor": start.get("machine", {}).get("processor"),
            **{f"package/{package}": version for package, version in start.get("packages", {}).items()},
        }
        # Twice: its columns come first, and its values last, so that they replace a record's fields of the same names.
        yield {**of_job, **flattened(job, run.timing(job)), **of_job} if records else of_job


@view
def fused_times(run: Run) -> dict[str, Timing]:
    """By job: the choice of the run's trade that was timed as one fused kernel in float32, with its time."""
    fused = [row for row in run.choices if (row["execution"], row["dtype"]) == ("fused", "float32")]
    return {row["of"]: row for row in fused if "ratio_to_floor" in row}


def gpu_times(run: Run) -> dict[str, Timing]:
    """By label: the timing of each setting on a GPU in float32, in the usual batches, by its quickest execution."""
    # Only timings of a setting's variants, by `bench.runs.setting_variants`, have the field `of_tolerance`.
    variants = [timing for timing in run.timings if "of_tolerance" in timing and is_gpu(timing["device"])]
    if not variants:
        return {}
    usual = usual_batch(variants)
    in_float32 = [timing for timing in variants if timing["dtype"] == "float32" and timing["batch"] == usual]
    by_label = grouped(in_float32, itemgetter("label"))
    return {label: min(timings, key=itemgetter("ns_per_sample")) for label, timings in by_label.items()}


def _times_of(
    run: Run, jobs: Sequence[Job], fused: Mapping[str, Timing], on_gpu: Mapping[str, Timing]
) -> dict[str, dict[str, float]]:
    """By kind of time, then by name of job: the median time of a query, × floor.

    `fused` has the timings of fused decoders, by name of job; `on_gpu` is as in `values_of`.

    Where settings were timed apart from surfaces, on one machine, no other eager times count.
    """
    names = {job["job"] for job in jobs}

    def over_floor(timing_of: Mapping[str, Timing]) -> dict[str, float]:
        """The stored median of each of the jobs that was timed; `timing_of` has timings by name of job."""
        timed = [(name, timing) for name, timing in timing_of.items() if "ratio_to_floor" in timing]
        return {name: float(timing["ratio_to_floor"]) for name, timing in timed if name in names}

    of_settings = {job["job"]: timing for job in jobs if (timing := run.setting_timing(job)) is not None}
    of_settings_on_gpu = {job["job"]: on_gpu[job["label"]] for job in jobs if job["label"] in on_gpu}
    of_jobs = {timing["job"]: timing for timing in run.timings}
    return {
        EAGER: over_floor(of_settings) or over_floor(of_jobs),
        FUSED: over_floor(fused),
        GPU: over_floor(of_settings_on_gpu),
    }


def _reasons(run: Run) -> dict[str, str]:
    """By name of job: why it must stand in no table; those that may are left out."""
    reasons = {}
    complete = []
    for job in run.jobs:
        lacking = [field for field in _NEEDED if field not in job]
        if job["status"] != "ok":
            # A hand-written error may be blank, but a reason is not.
            reasons[job["job"]] = " ".join(job.get("error", "").split()) or job["status"]
        elif lacking:
            reasons[job["job"]] = f"its record has no {' and no '.join(lacking)}"
        else:
            complete.append(job)
    return reasons | obstacles(complete, run.published)


def _bits(job: Job) -> float | None:
    """The bits of a job's whole file a texel; None if it has no file or no texels."""
    height, width = job.get("shape", (0, 0))
    if "total" not in job.get("bytes", {}) or not height * width:
        return None
    return 8 * job["bytes"]["total"] / (height * width)
