"""What a trade has measured of one material before it ends: figures of choices, and turns of their timing.

A trade compares choices: a choice is a codec file with an execution and a precision. Scoring and timing all choices of
a material takes minutes. Both stand in files of the run's folder until `trade.json` is written, so that the same
command goes on where it was interrupted.
"""

import json
from collections.abc import Callable
from pathlib import Path

from bench.files import atomic
from bench.records import TradeChoice
from bench.timing.turns import KeptTurns

FIGURES, TURNS = "trade.figures.json", "trade.turns.npz"


class Unfinished:
    """The unfinished measurements in a folder."""

    def __init__(self, folder: Path):
        """Read the figures that an interrupted trade has left in a folder, if any."""
        self.folder = folder
        try:
            self.figures: dict[str, TradeChoice] = dict(json.loads((folder / FIGURES).read_text(encoding="utf-8")))
        except (OSError, ValueError, TypeError, RecursionError):  # no file, or not one of ours: measure again
            self.figures = {}

    def figures_of(self, key: str, measure: Callable[[], TradeChoice]) -> TradeChoice:
        """The figures under a key that names all they depend on: kept ones, else those that `measure` gives, now
        kept."""
        if key not in self.figures:
            self.figures[key] = measure()  # seconds to minutes, so it is written at once
            atomic.write(self.folder / FIGURES, json.dumps(self.figures, allow_nan=False).encode())
        return self.figures[key].copy()

    def turns(self, key: str) -> KeptTurns:
        """The turns that are kept of the timing which the key names, by all that it depends on."""
        return KeptTurns(self.folder / TURNS, key)


def forget(folder: Path) -> None:
    """Remove the unfinished measurements from a folder, once `trade.json` holds the finished ones."""
    for name in (FIGURES, TURNS):
        (folder / name).unlink(missing_ok=True)
