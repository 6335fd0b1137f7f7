"""Writes a run as input of github-action-benchmark, which plots a history.

The tool takes one direction per file (`customBiggerIsBetter`, `customSmallerIsBetter`), so there are two files.
"""

import json
import math
from typing import Any

from bench.compare.quantities import deciding, undeciding
from bench.compare.rows import multiples
from bench.records import Run, by_row

FILES = {"higher": "bigger-is-better.json", "lower": "smaller-is-better.json"}


def tracker(run: Run) -> dict[str, str]:
    """The text of each file by its name: means over the seeds of every finished job, and the times of decoders."""
    entries: dict[str, list[dict[str, Any]]] = {name: [] for name in FILES.values()}
    rows = by_row(job for job in run.jobs if job["status"] == "ok")
    timed = multiples([job for jobs in rows.values() for job in jobs], list(run.timings))
    for row, jobs in rows.items():
        for quantity in [*deciding(jobs[0]), *undeciding(jobs[0])]:
            values = [value for job in jobs if (value := quantity.value(job)) is not None and math.isfinite(value)]
            if len(values) == len(jobs):
                unit = quantity.unit or quantity.name
                entries[FILES[quantity.better]].append(_entry("/".join((*row, quantity.name)), unit, values))
        if row in timed:
            entry = _entry("/".join((*row, "time")), "× mean-colour", [timed[row].mean])
            entries[FILES["lower"]].append(entry | {"range": "{:.3g} to {:.3g}".format(*timed[row].interval)})
    return {name: json.dumps(listed, indent=1, ensure_ascii=False) + "\n" for name, listed in entries.items()}


def _entry(name: str, unit: str, values: list[float]) -> dict[str, Any]:
    mean = math.fsum(values) / len(values)
    half = (max(values) - min(values)) / 2
    entry: dict[str, Any] = {"name": name, "unit": unit, "value": float(f"{mean:.7g}")}
    return entry | ({"range": f"± {half:.2g}", "extra": f"{len(values)} seeds"} if len(values) > 1 else {})
