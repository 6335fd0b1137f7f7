"""Runs a program with Dr.Jit, so that the kernel of a renderer can evaluate any codec's file.

A scalar is a number or a Dr.Jit array over the queries. Weights become literals of the kernel or, if they are very
many, of functions that it calls. Tables are fetched from memory.
"""

import operator
from collections.abc import Callable, Sequence
from functools import cache, reduce
from types import ModuleType
from typing import Any

import drjit as dr
import numpy as np

from bench.program import INPUTS, Program
from bench.program.backend import Array, Backend, Operation, Rows, Scalar, listed
from bench.program.operations import KINDS, OPERATIONS, looked_up

# The most products that a kernel has in line. 36,000 of them in line take minutes to compile; as functions of `BLOCK`
# outputs each they take 4 s, as one function for each layer 13 s. If weights were read from memory instead, a sample of
# a render would take eleven times as long.
MOST_LITERALS = 10_000
BLOCK = 24


def _power(base: Scalar, exponent: Scalar) -> Scalar:
    """Powers; whole exponents are products, so the base may be negative."""
    if isinstance(exponent, float) and exponent.is_integer():
        exponent = int(exponent)
    return dr.power(base, exponent)


def _not(x: Scalar) -> Scalar:
    """The opposite of a truth: Python's own, or a Dr.Jit mask."""
    return not x if isinstance(x, bool) else ~x


# What the words of a formula mean to Dr.Jit.
_NAMES: dict[str, Any] = {
    "abs": abs,
    "ceil": dr.ceil,
    "cos": dr.cos,
    "exp": dr.exp,
    "floor": dr.floor,
    "inverse": _not,
    "inversesqrt": dr.rsqrt,
    "log": dr.log,
    "log2": dr.log2,
    "max": dr.maximum,
    "min": dr.minimum,
    "pow": _power,
    "sin": dr.sin,
    "sqrt": dr.sqrt,
    "tanh": dr.tanh,
}


@cache
def _function(formula: str, count: int) -> Callable[..., Scalar]:
    """A formula of operations as a function of Dr.Jit arrays; only three signs differ from Python.

    Formulas are those of `bench.program.operations`, never text of a file, so that evaluating one is safe.
    """
    python = formula.replace("&&", "&").replace("||", "|").replace("!(", "inverse(")
    arguments = [f"x[{k}]" for k in range(count)]
    return eval("lambda *x: " + python.format(*arguments), _NAMES)


class Kernel(Backend):
    """A program that Dr.Jit records."""

    what = "kernel"

    def __init__(self, program: Program, arrays: ModuleType, more: dict[str, Operation] | None = None):
        """`arrays` is Dr.Jit's module of arrays, such as `drjit.llvm`; `more` are operations of the caller beside the
        usual ones. `InputError` if the program has an operation that is among neither."""
        self.operations = OPERATIONS | (more or {})
        self.check(program)
        self.program = program
        self.arrays = arrays
        # Whether products become functions that the kernel calls.
        self.calls = program.products() > MOST_LITERALS
        self.tables: dict[tuple[Any, ...], tuple[Array, Scalar]] = {}  # by place in memory, shape and strides

    def __call__(self, uv: Sequence[Scalar], wo: Sequence[Scalar], wi: Sequence[Scalar], footprint: Scalar) -> Any:
        """The RGB of queries above the horizon: three Dr.Jit arrays, not yet clamped at 0."""
        inputs = (list(uv), list(wo), list(wi), [footprint])
        return self.run(self.program, dict(zip(INPUTS, inputs, strict=True)))

    def each(self, formula: str, arguments: Rows, from_kind: str, kind: str) -> list[Scalar]:
        """As `Backend.each`: one row of scalars for each argument, the results in their order."""
        if "%" in formula:
            # A renderer fetches 0 for inactive rays, and an integer division by 0 ends the process.
            left, right = arguments
            arguments = [left, [_without_zero(divisor) for divisor in right]]
        function = _function(formula, len(arguments))
        return [function(*scalars) for scalars in zip(*arguments, strict=True)]  # one of each argument

    def as_kind(self, scalar: Scalar, from_kind: str, kind: str) -> Scalar:
        """As `Backend.as_kind`: a number of Python stays one; as a number, a mask is 1 or 0."""
        if isinstance(scalar, bool | int | float):
            return KINDS[kind](scalar)
        if kind == "bool":
            return scalar if dr.is_mask_v(scalar) else scalar != 0
        array_type = self.arrays.Float if kind == "float" else self.arrays.Int
        if dr.is_mask_v(scalar):
            return dr.select(scalar, array_type(1), array_type(0))
        return array_type(scalar)

    convert = as_kind

    def choose(self, condition: Scalar, yes: Scalar, no: Scalar, kind: str) -> Scalar:
        return dr.select(condition, yes, no)

    def total(self, row: list[Scalar], formula: str) -> Scalar:
        return _function(formula, 1)(reduce(operator.add, row) if row else 0.0)

    def lengths(self, items: Array, rows: Callable[[Array], Rows]) -> list[Scalar]:
        return [dr.sqrt(_dot(row, row)) for row in rows(items)]

    def product(self, left: Array, right: Array, bias: list[Scalar] | None) -> list[Scalar]:
        """As `Backend.product`, row by row; very many weights go into functions that the kernel calls."""
        left = left if left.ndim == 3 else left[None]  # a batch of one
        right = right if right.ndim == 3 else right[None]
        width = right.shape[2]
        bias = bias or [0.0] * (left.shape[0] * left.shape[1] * width)
        elements: list[Scalar] = []
        for rows, matrix in zip(left, right, strict=True):
            for row in rows:
                # The bias of this row: as many floats, after those of the elements that are done.
                starts = bias[len(elements) : len(elements) + width]
                if self.calls and matrix.dtype != object:
                    sums = called_product(self.arrays, listed(row), matrix)
                    elements += [total + start for total, start in zip(sums, starts, strict=True)]
                else:
                    columns = zip(matrix.T, starts, strict=True)
                    elements += [_dot(listed(row), listed(column), start) for column, start in columns]
        return elements

    def look_up(self, table: Array, index: Scalar, kind: str) -> list[Scalar]:
        """As `Backend.look_up`: the table lies in memory, and an index beyond its end gives the last row."""
        # Steps that read the same table give views of the same memory: it is stored once. Its transpose is another one.
        key = (table.__array_interface__["data"][0], table.shape, table.strides)
        if key not in self.tables:
            array_type = self.arrays.Float if kind == "float" else self.arrays.Int
            flat = array_type(np.ascontiguousarray(table).reshape(-1))
            # The table is kept too, so that its memory stays alive and no other table gets the same key.
            self.tables[key] = table, flat
        _, stored = self.tables[key]  # row by row
        rows, channels = table.shape
        row = dr.minimum(self.arrays.UInt(index), rows - 1)  # an altered file must not read other memory
        first = row * channels
        return [dr.gather(type(stored), stored, first + channel) for channel in range(channels)]

    def blend(self, table: Array, indices: list[Scalar], shares: list[Scalar]) -> list[Scalar]:
        rows = [looked_up(self, table, index, "float") for index in indices]
        return [_dot(shares, channel) for channel in zip(*rows, strict=True)]


def _without_zero(divisor: Scalar) -> Scalar:
    """An integer divisor with 1 in place of 0; a plain number is taken as it is."""
    return divisor if isinstance(divisor, int) else dr.select(divisor == 0, 1, divisor)


def _dot(left: Sequence[Scalar], right: Sequence[Scalar], start: Scalar = 0.0) -> Scalar:
    """`start` plus the sum of the products of two rows, added in their order."""
    total = start
    for a, b in zip(left, right, strict=True):
        total = dr.fma(a, b, total)
    return total


def called_product(arrays: ModuleType, inputs: Sequence[Scalar], matrix: Array) -> list[Scalar]:
    """inputs · matrix, for a matrix of numbers (inputs, outputs), by functions with the weights as literals.

    In line, LLVM takes minutes for tens of thousands of literals, and a kernel that evaluates a network several times
    contains them several times. Functions of a few outputs each compile in seconds, once; their sums stay in registers.
    """
    values_of_inputs = [arrays.Float(value) for value in inputs]
    backend = dr.backend_v(arrays.Float)
    # A switch with one case, number 0. That number must not be a constant, else LLVM would inline the function. So it
    # depends on an input: 1 or 0, shifted right by one bit, is 0.
    zero = dr.select(values_of_inputs[0] > 0, arrays.UInt32(1), arrays.UInt32(0)) >> 1
    outputs: list[Scalar] = []
    for first in range(0, matrix.shape[1], BLOCK):
        weights = matrix[:, first : first + BLOCK].tolist()

        # A default binds the weights of this block; the loop's variable would be those of the last.
        def block(*values: Scalar, weights: list[list[float]] = weights) -> tuple[Scalar, ...]:
            """The sums of up to `BLOCK` outputs."""
            sums = [arrays.Float(0)] * len(weights[0])
            for value, row in zip(values, weights, strict=True):
                dr.detail.new_scope(backend)  # otherwise Dr.Jit orders output by output, and reads each input again
                sums = [dr.fma(value, weight, total) for weight, total in zip(row, sums, strict=True)]
            return tuple(sums)

        outputs += dr.switch(zero, [block], *values_of_inputs)
    return outputs
