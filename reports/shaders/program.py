"""Reads the program of a decoded material, as `bench` stores it: steps and constants, without PyTorch."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bench.archive import MAX_FILE, read_arrays
from bench.errors import InputError


@dataclass(frozen=True)
class Program:
    """Operations of one query in order, each {name, operation, arguments, shape, kind}, and constants by name."""

    steps: list[dict[str, Any]]
    constants: dict[str, np.ndarray]
    result: str
    size: tuple[int, int]  # texels, (H, W)

    @property
    def periods(self) -> tuple[float, float]:
        """How many periods of the texture its longer side is along u and along v: texels are square on a surface."""
        height, width = self.size
        return max(self.size) / width, max(self.size) / height


def read(path: Path) -> Program:
    """The program in a `.npz`. `InputError` where the file is none."""
    try:
        arrays = read_arrays(path, MAX_FILE)
        says = json.loads(arrays.pop("program").tobytes())
        height, width = says["size"]
        return Program(says["steps"], arrays, says["result"], (height, width))
    except (OSError, KeyError, ValueError, TypeError) as error:
        raise InputError(f"{path}: no program of a material ({error}): make it anew") from error
