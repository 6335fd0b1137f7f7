"""Runs a program, by a back end: `Kernel` here, and the `Writer` of shaders in `reports`.

A tensor of one query is a NumPy array of scalars. A scalar is a number, or its form in a back end: an expression of a
shader, an array over the queries. `operations` builds each operation from the methods of `Backend`.

A formula is GLSL with arguments {0}, {1}, ..., which a back end writes out or reads.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.inputs.errors import InputError
from bench.program import Program

Array = np.ndarray
Scalar = Any  # a number, or its form in a back end
Rows = list[list[Scalar]]
Operation = Callable[..., Any]  # (back end, step, *arguments) → the scalars of the result, in an array or a list


@dataclass(frozen=True)
class Value:
    """One tensor of the program: an array of numbers if it is a constant, else of scalars; and its kind."""

    items: Array
    kind: str  # "float", "int" or "bool"


class Backend(ABC):
    """Computes scalars, and runs programs with them."""

    what: str  # the name of the back end in messages
    operations: dict[str, Operation]  # by name

    @abstractmethod
    def each(self, formula: str, arguments: Rows, from_kind: str, kind: str) -> list[Scalar]:
        """A formula for each element of its arguments; the results, in order, are of `kind`.

        `arguments` has one row for each argument of the formula: a list of n scalars of `from_kind`. n results.
        """

    @abstractmethod
    def as_kind(self, scalar: Scalar, from_kind: str, kind: str) -> Scalar:
        """A scalar of `from_kind` as an argument of another kind."""

    @abstractmethod
    def convert(self, scalar: Scalar, from_kind: str, kind: str) -> Scalar:
        """A scalar of `from_kind` as a result of another kind."""

    @abstractmethod
    def choose(self, condition: Scalar, yes: Scalar, no: Scalar, kind: str) -> Scalar:
        """`yes` where the condition holds, else `no`; both, and the result, are of `kind`."""

    @abstractmethod
    def total(self, row: list[Scalar], formula: str) -> Scalar:
        """The sum of some floats, put into a formula as its only argument {0}."""

    @abstractmethod
    def lengths(self, items: Array, rows: Callable[[Array], Rows]) -> list[Scalar]:
        """The Euclidean length of each row of some floats; `rows` divides such an array into its rows."""

    @abstractmethod
    def product(self, left: Array, right: Array, bias: list[Scalar] | None) -> list[Scalar]:
        """The elements, row by row, of the product of two matrices, or of each two of a batch, plus a bias.

        `left` is (rows, summands) or (batch, rows, summands), `right` (summands, columns) or (batch, summands,
        columns); the bias has one float for each element of the product.
        """

    @abstractmethod
    def look_up(self, table: Array, index: Scalar, kind: str) -> list[Scalar]:
        """Row `index` of a constant (rows, channels) of `kind`, as a scalar for each channel."""

    @abstractmethod
    def blend(self, table: Array, indices: list[Scalar], shares: list[Scalar]) -> list[Scalar]:
        """The sum of some rows of a constant (rows, channels), each times its share."""

    def cannot(self, what: str) -> InputError:
        """The error for an operation that this back end lacks."""
        return InputError(f"no {self.what} can {what} yet")

    def check(self, program: Program) -> None:
        """Raise `InputError` if the program has an operation that this back end does not know."""
        absent = {step.operation for step in program.steps} - self.operations.keys()
        if absent:
            raise self.cannot(f"do {min(absent)!r}")

    def run(self, program: Program, inputs: dict[str, list[Scalar]]) -> list[Scalar]:
        """The RGB of one query, or of what each scalar stands for, not yet clamped at 0; `inputs` has the scalars of
        each of `bench.program.INPUTS`."""
        values: dict[str, Value] = {}
        for name, array in program.constants.items():
            kind = "float" if array.dtype.kind == "f" else "int"
            values[name] = Value(array, kind)
        for name, scalars in inputs.items():
            shaped = scalars if name == "footprint" else [scalars]  # (1,), else (1, 2) or (1, 3)
            values[name] = Value(as_array(shaped), "float")
        for step in program.steps:
            arguments = [_resolved(each, values) for each in step.arguments]
            items = self.operations[step.operation](self, step, *arguments)
            values[step.name] = Value(as_array(items).reshape(step.shape), step.kind)
        return listed(values[program.result].items)


def _resolved(argument: Any, values: dict[str, Value]) -> Any:
    """An argument of a step, with what it names in place of each {"of": NAME}."""
    if isinstance(argument, dict):
        return values[argument["of"]]
    if isinstance(argument, list):
        return [_resolved(each, values) for each in argument]
    return argument


def as_array(values: Any) -> Array:
    """An array of objects, from a scalar, an array, or nested lists; scalars of a back end become elements unchanged.

    `np.array` cannot do this: it would take a back end's scalar, itself an array over the queries, apart.
    """
    if isinstance(values, np.ndarray):
        return values.astype(object)
    if not isinstance(values, list):
        single = np.empty((), object)
        single[()] = values
        return single
    inner = [as_array(each) for each in values]
    shape = inner[0].shape if inner else ()
    array = np.empty((len(inner), *shape), object)
    for number, each in enumerate(inner):
        # `each[()]` takes the scalar out of an array without axes, which would else be stored as an array.
        array[number] = each[()] if each.ndim == 0 else each
    return array


def is_number(scalar: Scalar) -> bool:
    """Whether a scalar is a number, and not a back end's form."""
    return isinstance(scalar, int | float | np.number)


def listed(items: Array) -> list[Scalar]:
    """The elements of an array in order, as a list; numbers become Python's own."""
    return list(items.astype(object).reshape(-1))
