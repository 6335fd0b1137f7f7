"""Picks the measured choice that meets given wishes, or the nearest one. `bench.runs.trade` measures the choices.

Imports no PyTorch, so that an answer from stored measurements comes at once.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from bench.errors import InputError

Choice = dict[str, Any]
PLAIN = "eager float32"  # the default execution and precision
NEAR_DB = 0.5  # a choice within this many dB of the best counts as equally good
_SUFFIXES = {"": 1, "k": 1_000, "M": 1_000_000}


@dataclass(frozen=True)
class Wishes:
    """Limits that a choice must meet; None: no limit."""

    min_psnr: float | None = None  # dB, held-out
    max_bytes: int | None = None
    max_ns: float | None = None  # a sample, whole query

    def met(self, row: Choice) -> bool:
        """Whether a choice meets every wish."""
        return all(miss <= 0 for miss in self.misses(row).values())

    def misses(self, row: Choice) -> dict[str, float]:
        """By how much a choice misses each wish, as a share of it (of PSNR: dB / 10); ≤ 0 where it is met."""
        misses = {}
        if self.min_psnr is not None:
            misses["psnr"] = (self.min_psnr - psnr(row)) / 10
        if self.max_bytes is not None:
            misses["bytes"] = row["bytes"] / self.max_bytes - 1
        if self.max_ns is not None:
            misses["ns"] = row["ns_per_sample"] / self.max_ns - 1
        return misses


def psnr(row: Choice) -> float:
    """dB; infinite without any error."""
    return float("inf") if row["psnr"] is None else float(row["psnr"])


def usable(choices: list[Choice], material: str) -> list[Choice]:
    """The choices of a material that were measured."""
    return [row for row in choices if row["material"] == material and "bytes" in row and "error" not in row]


def choose(rows: list[Choice], wishes: Wishes) -> Choice | None:
    """The best choice that meets the wishes: the smallest file if they name a PSNR, else the highest PSNR."""
    met = [row for row in rows if wishes.met(row)]
    if not met:
        return None
    if wishes.min_psnr is not None:
        return min(met, key=lambda row: (row["bytes"], row["ns_per_sample"]))
    return max(met, key=lambda row: (psnr(row), -row["ns_per_sample"]))


def nearest(rows: list[Choice], wishes: Wishes) -> Choice:
    """The choice that misses the wishes least."""
    return min(rows, key=lambda row: sum(max(0.0, miss) for miss in wishes.misses(row).values()))


def parse_bytes(text: str) -> int:
    """A size: `300k`, `1.5M`, `20000`."""
    match = re.fullmatch(r"(\d+(?:\.\d+)?)([kM]?)(?:B)?", text)
    if not match or float(match[1]) <= 0:
        raise InputError(f"--max-bytes {text}: write a number, or one with k or M, as 300k")
    return round(float(match[1]) * _SUFFIXES[match[2]])


def answers(material: str, choices: list[Choice]) -> Iterator[str]:
    """Sentences that name the best choice, and the fastest and the smallest one within `NEAR_DB` of it."""
    rows = usable(choices, material)
    if not rows:
        return
    best = max(rows, key=psnr)
    near = [row for row in rows if psnr(row) >= psnr(best) - NEAR_DB]
    yield f"{material}: the best is {described(best)}."
    for word, key in (("faster", "ns_per_sample"), ("smaller", "bytes")):
        least = min(near, key=lambda row: (row[key], row["ns_per_sample"]))
        within = f"{material}: within {NEAR_DB} dB of it,"
        if least[key] == best[key]:
            yield f"{within} none is {word}."
        else:
            yield f"{within} the {word[:-1]}st is {described(least)}."


def named(row: Choice) -> str:
    """A choice by name: the codec's label, and how it is computed where that is not the default."""
    how = f"{row['execution']} {row['precision']}" + (", emulated" if row.get("emulated") else "")
    return str(row["label"]) + ("" if how == PLAIN else f" [{how}]")


def described(row: Choice) -> str:
    """A choice with its figures, in words."""
    quality = "exact" if row["psnr"] is None else f"{row['psnr']:.2f} dB"
    return f"{named(row)}: {quality}, {row['bytes']:,} bytes, {row['ns_per_sample']:,.0f} ns a sample"
