"""What one gives up for what one gains: every setting, execution and precision with its quality, bytes and time.

A *choice* is a codec file and how it is computed. Executions and precisions change no file: each is scored and timed
from the same one. What a run's records do not hold is written beside them, `trade.json`, anew each time.
"""

import json
import logging
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from bench import atomic, container, timing
from bench.codec import Progress, silent
from bench.errors import InputError
from bench.evaluation import Decoder as Slices
from bench.execution import Variant, networks, prepared
from bench.material import DecoderCost, Material
from bench.records import Record, Run
from bench.scoring import summarise
from bench.suite import MaterialSpec, Suite
from bench.timing.machine import unrest
from bench.timing.profile import profile
from bench.timing.queries import Queries
from bench.timing.roofline import limit_ns, roofline
from bench.workbench import Workbench, workbench

log = logging.getLogger(__name__)

FILE = "trade.json"
BATCH = 65_536  # whole chunks of every execution
NEAR_DB = 0.5  # a setting so near to the best is as good
GOALS_DB = (30, 35)  # of a fit
BATCHES = (1, 64, 1024, timing.BATCH, 1 << 18)
ALL_BATCHES = (*BATCHES, 1 << 20, 1 << 22)
PSNR, FLIP = "psnr_display", "flip_ldr"


def measure(suite: Suite, run: Run, device: str, full: bool = False, show: Progress = silent) -> dict[str, Any]:
    """Score and time every choice of a finished run of a suite; what `trade.json` holds.

    `full` profiles batches up to 2^22 instead of 2^18, which takes half an hour more.
    """
    import torch

    threads, cores = suite.threads, torch.get_num_threads()
    place = torch.device(device)
    ceilings = [roofline(place, count) for count in dict.fromkeys((threads, cores))]
    result: dict[str, Any] = {"suite": suite.name, "ceilings": ceilings, "choices": [], "profiles": [], "training": []}
    for spec in suite.materials:
        jobs = _jobs(suite, spec, run)
        if jobs:
            bench = workbench("trade", spec, suite.data, None, show)
            result["choices"] += _choices(bench, jobs, suite, run, device, ceilings[0], show)
            plain = {job["label"]: _load(run, job, device) for job in jobs if _plain(suite, job)}
            found = profile(plain or {jobs[0]["label"]: _load(run, jobs[0], device)}, cores, _batches(full))
            result["profiles"] += [{"material": spec.name, "unrest": unrest(record)} | record for record in found]
            result["training"] += [_training(job) for job in jobs if job.get("history")]
    result["answers"] = [text for spec in suite.materials for text in answers(spec.name, result["choices"])]
    return result


def write(folder: Path, result: dict[str, Any]) -> None:
    """Store the result beside the records, in one move."""
    atomic.write(folder / FILE, json.dumps(result, allow_nan=False).encode())


def load(folder: Path) -> dict[str, Any] | None:
    """What `write` stored, or None where there is nothing."""
    try:
        found: dict[str, Any] = json.loads((folder / FILE).read_text(encoding="utf-8"))
    except FileNotFoundError:
        return None
    except (OSError, ValueError) as error:
        raise InputError(f"{folder / FILE}: cannot be read ({error}): remove it, and run trade again") from error
    return found


def _batches(full: bool) -> tuple[int, ...]:
    return ALL_BATCHES if full else BATCHES


def _jobs(suite: Suite, spec: MaterialSpec, run: Run) -> list[Record]:
    """The finished jobs of a material, in the order of the suite; of several seeds the first."""
    names = [f"{spec.name}/{codec.label}/{suite.seeds[0]}" for codec in suite.codecs]
    found = (run.job(name) for name in names)
    return [job for job in found if job and job["status"] == "ok"]


def _load(run: Run, job: Record, device: str) -> Material:
    return container.load(run.folder / job["file"], device)[1]


def _plain(suite: Suite, job: Record) -> bool:
    """Whether a job is of a codec entry that sweeps nothing: those stand for their codec."""
    return any(spec.label == job["label"] and not spec.swept for spec in suite.codecs)


def _choices(
    bench: Workbench, jobs: list[Record], suite: Suite, run: Run, device: str, ceiling: dict[str, Any], show: Progress
) -> list[dict[str, Any]]:
    """Each choice of one material: quality, bytes, time in turns with all the others, place on the two fronts."""
    rows, timed = [], {}
    for job in jobs:
        material = _load(run, job, device)
        wanted = suite.variants if _plain(suite, job) and networks(material) else ()
        for variant in (Variant(), *map(Variant.parse, wanted)):
            row = {"material": bench.name, "job": job["job"], "label": job["label"], "codec": job["codec"]}
            row |= {"settings": job["settings"], "execution": variant.execution, "precision": variant.precision}
            row |= {"bytes": job["bytes"]["total"], "parameters": job["parameters"]}
            try:
                ready = prepared(material, variant)
                row |= _quality(bench, job, run) if variant == Variant() else _score(bench, ready, suite.threads, show)
            except InputError as error:
                rows.append(row | {"error": str(error)})
                continue
            rows.append(row)
            timed[len(rows) - 1] = ready
    measured = timing.compare({str(i): ready for i, ready in timed.items()}, suite.threads, Queries(BATCH))
    for i, ready in timed.items():
        summary = _summary(measured[str(i)])
        least = limit_ns(_cost(ready), ceiling)
        rows[i] |= summary | {"limit_ns": least, "of_limit": least / summary["ns_per_sample"], "batch": BATCH}
    floor = {"material": bench.name, "label": timing.FLOOR, "execution": "eager", "precision": "float32"}
    _mark([row for row in rows if "error" not in row])
    return [*rows, floor | _summary(measured[timing.FLOOR]) | {"batch": BATCH}]


def _summary(measured: timing.Timing) -> dict[str, Any]:
    summary = measured.summary()
    return summary | {"unrest": unrest(summary)}


def _cost(material: Material) -> DecoderCost:
    """What a sample costs in the precision of the material: shorter numbers are fewer bytes."""
    short = material.dtype.itemsize / 4
    return replace(material.cost, bytes_per_sample=round(material.cost.bytes_per_sample * short))


def _quality(bench: Workbench, job: Record, run: Run) -> dict[str, float | None]:
    """PSNR, FLIP and the PSNR of the worst slice, of the held-out pairs, from a job's record."""
    group = job["scores"].get("heldout") or job["scores"]["all"]
    with np.load(run.folder / job["slices"], allow_pickle=False) as slices:
        raw = slices[PSNR][slices["heldout"]] if "heldout" in job["scores"] else slices[PSNR]
    return _figures(group["metrics"], raw)


def _score(bench: Workbench, material: Material, threads: int, show: Progress) -> dict[str, float | None]:
    """The same figures, of a material that is computed otherwise."""
    gate = "heldout" if "heldout" in bench.groups else "all"
    with timing.torch_threads(threads):
        scores = bench.scorer.score(bench.groups[gate], Slices(bench, material, show).slice)
    metrics = summarise(scores, bench.btf.wo, bench.btf.wi, {gate: bench.groups[gate]})[gate]["metrics"]
    return _figures(metrics, scores.raw[PSNR])


def _figures(metrics: dict[str, Any], squared: np.ndarray) -> dict[str, float | None]:
    flip = next((name for name in metrics if name.startswith(FLIP)), "")
    worst = float(squared.max())
    return {
        "psnr": metrics[PSNR]["pooled"],
        "flip": metrics[flip]["mean"] if flip else None,
        "worst": -10 * float(np.log10(worst)) if worst > 0 else None,
    }


def _mark(rows: list[dict[str, Any]]) -> None:
    """Say of each choice whether it is on a front: no other is at least as good and as cheap, and better in one."""
    for cost, front in (("ns_per_sample", "fastest"), ("bytes", "smallest")):
        for row in rows:
            row[front] = not any(_beats(other, row, cost) for other in rows)


def _beats(other: dict[str, Any], row: dict[str, Any], cost: str) -> bool:
    ours, theirs = ((_db(x), -x[cost]) for x in (row, other))
    return theirs != ours and theirs[0] >= ours[0] and theirs[1] >= ours[1]


def _db(row: dict[str, Any]) -> float:
    """PSNR in dB; without any error, infinite."""
    return float("inf") if row["psnr"] is None else float(row["psnr"])


def _training(job: Record) -> dict[str, Any]:
    """The curve of a fit, and the first of its points at each goal."""
    curve = [[point["step"], point["seconds"], point["psnr"]] for point in job["history"] if "psnr" in point]
    reached = {}
    for goal in GOALS_DB:
        first = next((point for point in curve if point[2] >= goal), None)
        reached[str(goal)] = {"steps": first[0], "seconds": first[1]} if first else None
    return {"material": job["material"], "label": job["label"], "curve": curve, "reached": reached}


def answers(material: str, choices: list[dict[str, Any]]) -> Iterator[str]:
    """In words: the best, and what is as good within `NEAR_DB` for the least time and for the fewest bytes."""
    rows = [row for row in choices if row["material"] == material and row.get("psnr") is not None]
    if not rows:
        return
    best = max(rows, key=_db)
    near = [row for row in rows if row["psnr"] >= best["psnr"] - NEAR_DB]
    yield f"{material}: the best is {described(best)}."
    fast = min(near, key=lambda row: row["ns_per_sample"])
    small = min(near, key=lambda row: (row["bytes"], row["ns_per_sample"]))
    yield f"{material}: within {NEAR_DB} dB of it, the fastest is {described(fast)}."
    yield f"{material}: within {NEAR_DB} dB of it, the smallest is {described(small)}."


def named(row: dict[str, Any]) -> str:
    """A choice by name: the codec's label, and how it is computed where that is not the default."""
    variant = Variant(row["execution"], row["precision"])
    return row["label"] + ("" if variant == Variant() else f" [{variant}]")


def described(row: dict[str, Any]) -> str:
    """A choice with its figures, in words."""
    quality = "exact" if row["psnr"] is None else f"{row['psnr']:.2f} dB"
    return f"{named(row)}: {quality}, {row['bytes']:,} bytes, {row['ns_per_sample']:.0f} ns a sample"
