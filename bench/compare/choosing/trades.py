"""The choices of a trade as rungs and in words: `bench.runs.trade` measures them.

Imports no PyTorch, so an answer from stored measurements comes at once.
"""

from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path

from bench.compare.choosing import NEAR_DB, Rung
from bench.machine.devices import is_gpu
from bench.records import MOST_DB, Record, Run, load_run, load_trade

FLOAT_BYTES = 4


def usable(choices: list[Record], material: str) -> list[Rung]:
    """The choices of a material that have scores of validation pairs, as rungs with bytes and ns a sample."""
    return [
        Rung(row["bytes"], float(row["validation"]["mean"]), row["ns_per_sample"], row)
        for row in choices
        if row["material"] == material and "error" not in row and row.get("validation", {}).get("slices")
    ]


@lru_cache(maxsize=1)
def fused_times(run: Run) -> dict[str, Record]:
    """The time of each job as one fused kernel in float32."""
    choices = (load_trade(run.folder) or {"choices": []})["choices"]
    fused = (row for row in choices if (row["execution"], row["precision"]) == ("fused", "float32"))
    return {row["job"]: row for row in fused if "job" in row and "ratio_to_floor" in row}


def answers(material: str, choices: list[Record]) -> Iterator[str]:
    """Sentences that name the best choice, and the fastest and the smallest one within `NEAR_DB` of it.

    Validation pairs choose them; the figures are of test pairs.
    """
    rungs = usable(choices, material)
    if not rungs:
        return
    best = max(rungs, key=lambda rung: rung.score)
    near = [rung for rung in rungs if rung.score >= best.score - NEAR_DB]
    yield f"{material}: the best is {described(best.of)}."
    for word, key in (("fast", "time"), ("small", "size")):
        least = min(near, key=lambda rung: (getattr(rung, key), rung.time))
        better = getattr(least, key) != getattr(best, key)
        answer = f"the {word}est is {described(least.of)}" if better else f"no other is {word}er"
        yield f"{material}: within {NEAR_DB} dB of it, {answer}."


def named(row: Record) -> str:
    """The name of a choice: the codec's label, and its execution and precision if they are not the default."""
    how = f"{row['execution']} {row['precision']}" + (", emulated" if row.get("emulated") else "")
    return str(row["label"]) + ("" if how == "eager float32" else f" [{how}]")


def described(row: Record) -> str:
    """A choice with its figures, in words."""
    quality = "exact" if row["psnr"] >= MOST_DB else f"{row['psnr']:.2f} dB"
    return f"{named(row)}: {quality}, {row['bytes']:,} bytes, {row['ns_per_sample']:,.0f} ns a sample"


def held(folder: Path, row: Record) -> str:
    """Which device a choice was timed on, and the size of its textures on a GPU, by the record of its job."""
    threads = row.get("threads", 1)
    whose = "the GPU's" if is_gpu(row["device"]) else f"the CPU's, {threads} thread{'s' * (threads != 1)}"
    job = load_run(folder).job(row.get("job", "")) or {}
    floats = job.get("cost", {}).get("texture_floats", 0)
    textures = f"{FLOAT_BYTES * floats:,} bytes of textures at {FLOAT_BYTES} bytes a float" if floats else "no textures"
    whole = f", {job['resident']:,} with tables and networks" if job.get("resident") else ""
    return f"time: {whose}; on a GPU: {textures}{whole}, of a file of {row['bytes']:,}"
