"""The program of a decoded material: plain operations on NumPy constants, for renderers without PyTorch.

`recording` makes it from a material, with PyTorch. `operations` defines each operation once for all back ends: `kernel`
runs a program with Dr.Jit, `reports.shaders` writes it as text.
"""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.btf import periods

INPUTS = ("uv", "wo", "wi", "footprint")


@dataclass(frozen=True)
class Step:
    """One operation of PyTorch's core set (ATen): its name without overload, its arguments, its result. An argument is
    a number, a string, None, a list of arguments, or {"of": NAME}: an input, a constant or a result."""

    name: str
    operation: str
    arguments: list[Any]
    shape: tuple[int, ...]  # the first axis is the batch, of size 1
    kind: str  # "float", "int" or "bool"

    def names(self) -> set[str]:
        """The inputs, constants and results that its arguments name."""
        names = set()
        waiting = list(self.arguments)
        while waiting:
            match waiting.pop():
                case {"of": name}:
                    names.add(name)
                case [*inner]:
                    waiting += inner
        return names


@dataclass(frozen=True)
class Program:
    """The steps of one query, in order; the last gives RGB (1, 3), not yet masked below the horizon or clamped at 0."""

    steps: tuple[Step, ...]
    constants: dict[str, np.ndarray]  # float32 or int32
    result: str
    size: tuple[int, int]  # texels, (H, W)

    @property
    def periods(self) -> tuple[float, float]:
        """The length of the longer side in periods of the texture along u and v, because texels are square."""
        return periods(self.size)

    def products(self) -> int:
        """The number of multiply-adds in its matrix products, for one query."""
        shapes = {step.name: step.shape for step in self.steps}
        shapes |= {name: constant.shape for name, constant in self.constants.items()}
        count = 0
        for step in self.steps:
            if step.operation in ("mm", "addmm", "bmm"):
                # The last argument is the right factor (..., summands, columns). Each element of the result is a sum
                # of as many products as that factor has rows.
                right = step.arguments[-1]["of"]
                summands = shapes[right][-2]
                count += math.prod(step.shape) * summands
        return count

    def arrays(self) -> dict[str, np.ndarray]:
        """The content of its `.npz`: the steps as JSON, one array per constant. Nothing is pickled."""
        header = {"result": self.result, "size": list(self.size), "steps": [vars(step) for step in self.steps]}
        return {"program": np.frombuffer(json.dumps(header).encode(), np.uint8), **self.constants}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, np.ndarray]) -> "Program":
        """The program from its `arrays`. Raises `KeyError`, `TypeError` or `ValueError` if they are invalid."""
        header = json.loads(arrays["program"].tobytes())
        steps = []
        for step in header["steps"]:
            shape = tuple(step["shape"])  # JSON knows lists alone
            fields = step | {"shape": shape}
            steps.append(Step(**fields))
        constants = {name: array for name, array in arrays.items() if name != "program"}
        height, width = header["size"]
        return cls(tuple(steps), constants, header["result"], (height, width))
