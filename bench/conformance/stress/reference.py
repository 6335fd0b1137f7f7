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
    """Say how many built-in codecs meet an extreme, as the end of a message about one that does not."""
    met = [record["verdict"] for record in _records() if record["extreme"] == extreme and record["verdict"] != "n/a"]
    passed = met.count("pass")
    count = f"all {passed}" if passed == len(met) else f"{passed} of {len(met)}"
    return f"; {count} built-in codecs that it applies to pass" if passed else ""
