"""Turns the measured choices of a trade into rungs: `bench.runs.trade` measures, `bench.records.choosing` chooses.

Imports no PyTorch, so an answer from stored measurements comes at once.
"""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from bench.devices import is_gpu
from bench.errors import InputError
from bench.records import MOST_DB, load_run
from bench.records.choosing import Rung, validated

Choice = dict[str, Any]
PLAIN = "eager float32"  # the default execution and precision
FLOAT_BYTES = 4
NEAR_DB = 0.5  # a choice within this many dB of the best counts as equally good
_SUFFIXES = {"": 1, "k": 1_000, "M": 1_000_000}


def psnr(row: Choice) -> float:
    """dB; mean over slices."""
    return float(row["psnr"])


def usable(choices: list[Choice], material: str) -> list[Rung]:
    """The choices of a material that have scores of validation pairs, as rungs with bytes and ns a sample."""
    rungs = (
        validated(row["validation"], name=named(row), size=row["bytes"], time=row["ns_per_sample"], of=row)
        for row in choices
        if row["material"] == material and "validation" in row and "error" not in row
    )
    return [rung for rung in rungs if rung]


def parse_bytes(text: str) -> int:
    """A size in bytes from its text: `300k`, `1.5M`, `20000`."""
    match = re.fullmatch(r"(\d+(?:\.\d+)?)([kM]?)(?:B)?", text)
    if not match or float(match[1]) <= 0:
        raise InputError(f"--max-bytes {text}: write a number, or a number with k or M, such as 300k")
    return round(float(match[1]) * _SUFFIXES[match[2]])


def answers(material: str, choices: list[Choice]) -> Iterator[str]:
    """Sentences that name the best choice, and the fastest and the smallest one within `NEAR_DB` of it.

    Validation pairs choose them; the figures are of test pairs.
    """
    rungs = usable(choices, material)
    if not rungs:
        return
    best = max(rungs, key=lambda rung: rung.score)
    near = [rung for rung in rungs if rung.score >= best.score - NEAR_DB]
    yield f"{material}: the best is {described(best.of)}."
    for word, key in (("faster", "time"), ("smaller", "size")):
        least = min(near, key=lambda rung: (getattr(rung, key), rung.time))
        within = f"{material}: within {NEAR_DB} dB of it,"
        if getattr(least, key) == getattr(best, key):
            yield f"{within} no other is {word}."
        else:
            yield f"{within} the {word[:-1]}st is {described(least.of)}."


def named(row: Choice) -> str:
    """The name of a choice: the codec's label, and its execution and precision if they are not the default."""
    how = f"{row['execution']} {row['precision']}" + (", emulated" if row.get("emulated") else "")
    return str(row["label"]) + ("" if how == PLAIN else f" [{how}]")


def described(row: Choice) -> str:
    """A choice with its figures, in words."""
    quality = "exact" if row["psnr"] >= MOST_DB else f"{row['psnr']:.2f} dB"
    return f"{named(row)}: {quality}, {row['bytes']:,} bytes, {row['ns_per_sample']:,.0f} ns a sample"


def held(folder: Path, row: Choice) -> str:
    """Which device a choice was timed on, and the size of its textures on a GPU, by the record of its job."""
    threads = row.get("threads", 1)
    whose = "the GPU's" if is_gpu(row["device"]) else f"the CPU's, {threads} thread{'s' * (threads != 1)}"
    job = load_run(folder).job(row.get("job", "")) or {}
    floats = job.get("cost", {}).get("texture_floats", 0)
    textures = f"{FLOAT_BYTES * floats:,} bytes of textures at {FLOAT_BYTES} bytes a float" if floats else "no textures"
    whole = f", {job['resident']:,} with tables and networks" if job.get("resident") else ""
    return f"time: {whose}; on a GPU: {textures}{whole}, of a file of {row['bytes']:,}"
