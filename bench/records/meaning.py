"""The meaning of a record's fields: which pairs decide, which numbers are alike.

Scores are of *groups* of pairs: `train`, `heldout`, `all` and parts of these.
"""

import json
import math
from collections.abc import Callable, Container, Iterable, Iterator, Mapping, Sequence
from statistics import mode
from typing import Any, NamedTuple, TypeVar

from bench.records.fields import field_names
from bench.records.schema import APART, Job, RunStart, ScoreKey, Statistics, Timing

PSNR, SSIM, FLIP, RMSE = "psnr_display", "ssim", "flip_ldr", "rmse_linear"  # families of metrics

# The PSNR of a slice counts as no more: an error of one step of an 8-bit display, 20 log10(255). Above it nobody sees a
# difference, and a few exact or black slices would decide a mean.
MOST_DB = 48.13

VALIDATION = "validation"  # the group of pairs by which settings are chosen
LOW_LIGHT = "low light"  # the group of pairs lit lower than any training pair, which decide nothing
SCENE_HELDOUT = "scene, held out"  # the held-out pairs that lie in a scene, weighted by its demand
OUTSIDE = "outside the scene"  # the group of pairs that the demand of a scene does not touch
SAME_EXPOSURE = 1e-4  # relative, a gain of 0.0004 dB: published records are rounded, machines differ in the last bit

# Two timings are compared only if these fields agree.
CONDITIONS = ("batch", "dtype", "threads", "device", "execution", "queries")

Item = TypeVar("Item")
Key = TypeVar("Key")
_NAMING_FIELDS = ("material", "label", "codec", "seed", "job", "status")
_LONGEST = 8  # a longer list does not become fields


def scored_unlike(key: ScoreKey, other: ScoreKey) -> list[str]:
    """Why no numbers of two jobs may be compared, by their score keys; empty if they may."""
    reasons = []
    if key.get("btf") != other.get("btf"):
        reasons.append("other data (their fingerprint differs)")
    if key.get("deciding") != other.get("deciding"):
        reasons.append("other held-out pairs")
    if not math.isclose(key.get("exposure", 0.0), other.get("exposure", 0.0), rel_tol=SAME_EXPOSURE):
        reasons.append("another exposure")
    return reasons


class PlannedJob(NamedTuple):
    """A job that a start of a run planned; `seed` is None if its name has none, so that it is of no job."""

    name: str
    material: str
    method: str  # as `method_of` says it of a record
    label: str
    seed: int | None


def planned_jobs(start: RunStart) -> Iterator[PlannedJob]:
    """The jobs that a start planned, taken apart from their names, `MATERIAL/LABEL/SEED`, which are all it keeps."""
    for name in start.get("jobs", []):
        material, _, rest = name.partition("/")
        label, _, seed = rest.rpartition("/")
        method, *_ = label.split() or [""]
        yield PlannedJob(name, material, method, label, int(seed) if seed.isdecimal() else None)


def method_of(job: Job) -> str:
    """The name by which tables know the method of a job: its codec's, or what the suite calls the codec `command`."""
    return job.get("called", job["codec"])


MEASURED, PATH_TRACED, RENDERED = "measured", "path-traced", "rendered"
KINDS = (MEASURED, PATH_TRACED, RENDERED)  # of surfaces, in the order of what a claim on them is worth


def kind_of(job: Job) -> str:
    """The kind of a job's surface: what its data call it, or else one of `KINDS`: measured, path-traced with
    inter-reflections, or rendered by the suite itself."""
    provenance = job.get("provenance", {})
    if "surface" in provenance:
        return str(provenance["surface"])
    if "path_version" in provenance:
        return PATH_TRACED
    if "renderer_version" in provenance:
        return RENDERED
    return MEASURED


def kind_order(kind: str) -> int:
    """The place of a kind in tables; others come after `KINDS`."""
    return KINDS.index(kind) if kind in KINDS else len(KINDS)


def pictures_are_free(job: Job) -> bool:
    """Whether pictures of a job's surface may be published: what its data say, or else of all but measured ones."""
    return bool(job.get("provenance", {}).get("free", kind_of(job) != MEASURED))


def as_published(job: Job) -> bool:
    """Whether a job was fitted by the recipe of its codec's paper, where that is not the default."""
    return bool(job.get("settings", {}).get("recipe") == "paper")


def counted(psnr: float | None) -> float:
    """A PSNR in dB as it counts in a mean or an order; None, which stands for no error, counts as `MOST_DB`."""
    return MOST_DB if psnr is None else psnr


def rounded(value: Any, digits: int = 7) -> Any:
    """A value of JSON whose floats, also nested ones, are rounded to so many significant digits.

    Seven are more than any tolerance needs.
    """
    if isinstance(value, float):
        return float(f"{value:.{digits}g}")
    if isinstance(value, dict):
        return {key: rounded(item, digits) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [rounded(item, digits) for item in value]
    return value


def deciding_group(groups: Container[str]) -> str:
    """The group of pairs that decides a comparison: `heldout`, or `all` if none are held out."""
    return "heldout" if "heldout" in groups else "all"


def grouped(items: Iterable[Item], key: Callable[[Item], Key]) -> dict[Key, list[Item]]:
    """The items by key, in the order of first appearance."""
    groups: dict[Key, list[Item]] = {}
    for item in items:
        groups.setdefault(key(item), []).append(item)
    return groups


def by_row(jobs: Iterable[Job]) -> dict[tuple[str, str], list[Job]]:
    """The jobs of each row of a table, by material and label."""
    return grouped(jobs, lambda job: (job["material"], job["label"]))


def fitted_to_scene(job: Job) -> bool:
    """Whether a job's file was fitted to a scene. It answers for that scene alone, so its scores over the whole
    material rank it nowhere."""
    return bool(job.get("settings", {}).get("scene"))


def metrics_of(job: Job, group: str = "") -> dict[str, Statistics]:
    """The statistics of each metric over a group, by default the deciding one; empty if there are none."""
    scored = job["scores"].get(group or deciding_group(job["scores"]))
    return scored["metrics"] if scored else {}


def timed_on(timing: Timing, processor: str = "") -> str:
    """Where a timing was measured: the name of a GPU, or “AMD EPYC, 1 thread”; without the processor's name its kind,
    "cpu". Threads of the processor do not matter to a GPU's time."""
    if timing.get("gpu"):
        return timing["gpu"]
    threads = timing.get("threads", 1)
    return f"{processor or timing.get('device')}, {threads} thread{'s' if threads != 1 else ''}"


def conditions_in_words(timing: Timing, processor: str = "", variant: str = "") -> str:
    """Where and how a timing was measured: “AMD EPYC, 1 thread, eager float32, batches of 65,536”.

    `variant` stands in the place of its execution and precision, if given.
    """
    variant = variant or variant_of(timing)
    return f"{timed_on(timing, processor)}, {variant}, batches of {timing.get('batch', 0):,}"


def variant_of(timing: Timing) -> str:
    """The execution and precision of a timing: “fused float32”."""
    return f"{timing.get('execution')} {timing.get('dtype')}"


def usual_batch(variants: Sequence[Timing]) -> int:
    """The size of batches in which most variants were timed: a few settings are timed in others, too."""
    return mode(timing["batch"] for timing in variants)


def flattened(job: Job, timing: Timing | None) -> dict[str, Any]:
    """Every number of a job and of its timing, by the path of its field: `bytes/total`, `timing/ns_per_sample`.

    Nothing is rounded. The fields that name the job (material, label, codec, seed, job, status) come first, settings as
    JSON. Short lists of numbers become fields `…/0`, `…/1`; longer lists are left out.
    """
    fields: dict[str, Any] = {name: job.get(name) for name in _NAMING_FIELDS}
    settings = job.get("settings", job.get("fit_key", {}).get("settings"))  # a reference stores them only in its key
    fields["settings"] = None if settings is None else json.dumps(settings, sort_keys=True)
    score = job.get("score_key", {})
    for name in ("btf", "exposure", "sha256"):
        fields[name] = score.get(name)
    versions = {name: metric["version"] for name, metric in job.get("metrics", {}).items()}
    versions |= score.get("metrics", {})  # where the scores were computed by other versions, those count
    fields.update(_flat_fields("metric_version/", versions))
    fields.update(zip(("height", "width"), job.get("shape", ()), strict=False))
    # Fields apart name the job, and came first, or have a form of their own.
    apart, apart_of_timing = field_names(APART), field_names(APART, Timing)
    fields.update(_flat_fields("", {name: value for name, value in job.items() if name not in apart}))
    times = {name: value for name, value in (timing or {}).items() if name not in apart_of_timing}
    fields.update(_flat_fields("timing/", times))
    return fields


def _flat_fields(prefix: str, values: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """The path of each field of `values`, after a prefix, with its value: see `flattened`."""
    for name, value in values.items():
        path = prefix + name
        if isinstance(value, dict):
            yield from _flat_fields(f"{path}/", value)
        elif not isinstance(value, list):
            yield path, value
        elif len(value) <= _LONGEST and all(isinstance(item, int | float) for item in value):
            yield from ((f"{path}/{number}", item) for number, item in enumerate(value))
