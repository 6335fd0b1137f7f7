"""Large matrix products in a kernel of Dr.Jit: functions that the kernel calls, with the weights as their literals.

In line, LLVM takes minutes for tens of thousands of literals, and a kernel that asks a network several times holds all
of them as often. Functions of some outputs each are compiled in seconds, once. Their sums stay in registers.
"""

import math
from collections.abc import Sequence
from types import ModuleType
from typing import Any

import drjit as dr
import numpy as np

from bench.codecs.program import Program

MOST_LITERALS = 10_000  # products that a program has in line
BLOCK = 24  # outputs of a function

Scalar = Any  # a number, or a Dr.Jit array over the queries


def products(program: Program) -> int:
    """Multiply-adds of the matrix products of a program."""
    shapes = {step.name: step.shape for step in program.steps}
    shapes |= {name: each.shape for name, each in program.constants.items()}
    return sum(
        math.prod(step.shape) * shapes[step.arguments[-1]["of"]][-2]
        for step in program.steps
        if step.operation in ("mm", "addmm", "bmm")
    )


def called_product(kind: ModuleType, inputs: Sequence[Scalar], matrix: np.ndarray) -> list[Scalar]:
    """inputs · matrix, of a matrix of numbers (inputs, outputs)."""
    given, backend = [kind.Float(value) for value in inputs], dr.backend_v(kind.Float)
    # A switch of one case; its number, 0, must not be known before, else the function would be put in line.
    zero = dr.select(given[0] > 0, kind.UInt32(1), kind.UInt32(0)) >> 1
    found: list[Scalar] = []
    for first in range(0, matrix.shape[1], BLOCK):
        weights = matrix[:, first : first + BLOCK].tolist()

        def block(*values: Scalar, weights: list[list[float]] = weights) -> tuple[Scalar, ...]:
            sums = [kind.Float(0)] * len(weights[0])
            for value, row in zip(values, weights, strict=True):
                dr.detail.new_scope(backend)  # else Dr.Jit sorts output by output, and reads each input again
                sums = [dr.fma(value, weight, total) for weight, total in zip(row, sums, strict=True)]
            return tuple(sums)

        found += dr.switch(zero, [block], *given)
    return found
