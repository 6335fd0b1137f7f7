"""The committed record of the stress test: how the built-in codecs met each extreme."""

from functools import cache
from importlib.resources import files
from pathlib import Path

from bench.records import Record, load_run

FILE = "stress.jsonl"


def place() -> Path:
    """The committed record."""
    return Path(str(files("bench") / "compare" / "references" / FILE))


@cache
def _records() -> tuple[Record, ...]:
    return tuple(load_run(place()).stress) if place().is_file() else ()


def met_by_others(extreme: str) -> str:
    """How the built-in codecs met an extreme, to be added to what is said of one that did not."""
    met = [record for record in _records() if record["extreme"] == extreme and record["verdict"] == "pass"]
    if not met:
        return ""
    return "; of the built-in codecs " + ", ".join(f"{record['subject']} {_how(record)}" for record in met)


def _how(record: Record) -> str:
    figure = record["figure"] or "passes"
    return figure if record["used"] is None else f"takes {record['used']:.2g} of the bound"
