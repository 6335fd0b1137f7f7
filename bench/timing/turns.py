"""Keeps the turns of a long timing in a file, so that an interrupted one goes on where it stopped.

Ratios of turns may be mixed, because each turn has its own floors beside it.
"""

import io
from pathlib import Path
from typing import Any

import numpy as np

from bench.files import atomic
from bench.files.archive import MAX_FILE, read_arrays


class KeptTurns:
    """The turns of one timing; `key` names contestants and conditions: turns of another timing are not used."""

    def __init__(self, path: Path, key: str):
        self.path = path
        self.key = np.frombuffer(key.encode(), np.uint8)  # an array, since a `.npz` holds nothing else

    def read(self, arrays: dict[str, np.ndarray]) -> int:
        """Fill arrays (turns, …) with the turns of an earlier process; returns how many these are."""
        try:
            stored = read_arrays(self.path, MAX_FILE)
            if not np.array_equal(stored["key"], self.key):
                return 0
            done = min(len(stored["samples"]), len(arrays["samples"]))
            for name, array in arrays.items():
                array[:done] = stored[name][:done]
        except (OSError, KeyError, ValueError, TypeError):
            return 0  # none, or a damaged file: these turns are timed again
        return done

    def write(self, arrays: dict[str, np.ndarray], done: int) -> None:
        """Keep the first `done` turns of arrays (turns, …)."""
        file = io.BytesIO()
        turns: dict[str, Any] = {name: array[:done] for name, array in arrays.items()}
        np.savez(file, key=self.key, **turns)
        atomic.write(self.path, file.getvalue())
