"""What the fields of a record mean: which pairs decide, which metric is of a family, under which conditions time holds.

Whoever reads records asks here: tables, comparisons, histories. Imports neither PyTorch, pandas nor NumPy.
"""

import json
from collections.abc import Container, Iterable, Iterator
from typing import Any

from bench.records import Record

PSNR, LOG_PSNR, SSIM, FLIP, RMSE = "psnr_display", "psnr_log1p", "ssim", "flip_ldr", "rmse_linear"

# What two timings must share to be compared.
CONDITIONS = ("batch", "dtype", "threads", "device", "execution", "queries", "texture_fetch")

_HEAD = ("material", "label", "codec", "seed", "job", "status")
_NO_NUMBERS = {"kind", "run", "fit_key", "score_key", "provenance", "traceback", "metrics", "settings", "shape"}
_RAW_TIMING = {"kind", "job", "run", "samples_ns", "floor_ratios"}
_LONGEST = 8  # numbers of a list that are fields; a longer one is left to the record


def shown_label(job: Record) -> str:
    """The label of a job as tables print it: of a codec that has recipes, the default is "(our recipe)"."""
    label = str(job.get("label", job["job"]))
    ours = job.get("settings", {}).get("recipe") == "ours" and "recipe=" not in label
    return " ".join([*label.split()[:1], "(our recipe)", *label.split()[1:]]) if ours else label


def gate(groups: Container[str]) -> str:
    """The group of pairs that decides: held-out ones, or all where none are held out."""
    return "heldout" if "heldout" in groups else "all"


def metric_of(names: Iterable[str], family: str) -> str:
    """The first of some names of metrics that is of a family (`ssim` → `ssim_periodic`), or ""."""
    return next((name for name in names if name == family or name.startswith(f"{family}_")), "")


def metrics_of(job: Record, group: str = "") -> Record:
    """The statistics of each metric over a group, by default the one that decides; empty where there are none."""
    found: Record = job["scores"].get(group or gate(job["scores"]), {}).get("metrics", {})
    return found


def stats_of(job: Record, family: str, group: str = "") -> Record:
    """The statistics of a family's metric over a group, by default the one that decides; empty where there are none."""
    metrics = metrics_of(job, group)
    found: Record = metrics.get(metric_of(metrics, family), {})
    return found


def flattened(job: Record, timing: Record | None) -> Iterator[tuple[str, Any]]:
    """Every number of a job and of its timing, by the path of its field: `bytes/total`, `timing/ns_per_sample`.

    Nothing is rounded. What names the job (material, label, codec, seed, job, status) comes first, settings as JSON.
    Of lists only short ones of numbers are given, `…/0`, `…/1`; longer ones are left to the record.
    """
    yield from ((name, job.get(name)) for name in _HEAD)
    settings = job.get("settings", job.get("fit_key", {}).get("settings"))  # a reference has them in its key alone
    yield "settings", None if settings is None else json.dumps(settings, sort_keys=True)
    score = job.get("score_key", {})
    yield from ((name, score.get(name)) for name in ("btf", "exposure", "sha256"))
    versions = {name: metric["version"] for name, metric in job.get("metrics", {}).items()} | score.get("metrics", {})
    yield from _flat("metric_version/", versions)
    yield from zip(("height", "width"), job.get("shape", ()), strict=False)
    yield from _flat("", {name: value for name, value in job.items() if name not in {*_HEAD, *_NO_NUMBERS}})
    yield from _flat("timing/", {name: value for name, value in (timing or {}).items() if name not in _RAW_TIMING})


def _flat(prefix: str, values: Record) -> Iterator[tuple[str, Any]]:
    for name, value in values.items():
        if isinstance(value, dict):
            yield from _flat(f"{prefix}{name}/", value)
        elif not isinstance(value, list):
            yield prefix + name, value
        elif len(value) <= _LONGEST and all(isinstance(item, int | float) for item in value):
            yield from ((f"{prefix}{name}/{i}", item) for i, item in enumerate(value))
