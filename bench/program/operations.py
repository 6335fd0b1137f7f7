"""Defines each operation of a program once for all back ends; operations have PyTorch's names (ATen).

A program is a list of steps, each an operation on the results of earlier ones. Its tensors are NumPy arrays of scalars:
NumPy moves them, and they are computed by the methods of a `Backend`. A *kind* is "float", "int" or "bool".
"""

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from bench.program import Step
from bench.program.backend import Array, Backend, Operation, Rows, Scalar, Value, as_array, is_number, listed

MOST_FACTORS = 8  # of a power that is written as a product
INFINITE = 9_223_372_036_854_775_807  # the end of a slice without an end

OPERATIONS: dict[str, Operation] = {}


def operation(*names: str) -> Callable[[Operation], Operation]:
    """Register a function under the names of its operations."""

    def register(function: Operation) -> Operation:
        """Note the function under each name, and return it unchanged."""
        OPERATIONS.update(dict.fromkeys(names, function))
        return function

    return register


# Elementwise operations.

FORMULAS = {
    "neg": "-({0})",
    "abs": "abs({0})",
    "floor": "floor({0})",
    "ceil": "ceil({0})",
    "exp": "exp({0})",
    "expm1": "exp({0}) - 1.0",
    "log": "log({0})",
    "log2": "log2({0})",
    "log1p": "log({0} + 1.0)",
    "sin": "sin({0})",
    "cos": "cos({0})",
    "tanh": "tanh({0})",
    "sqrt": "sqrt({0})",
    "rsqrt": "inversesqrt({0})",
    "reciprocal": "1.0 / ({0})",
    "sigmoid": "1.0 / (exp(-({0})) + 1.0)",
    "add": "{0} + {1}",
    "sub": "{0} - {1}",
    "mul": "{0} * {1}",
    "div": "{0} / {1}",
    "minimum": "min({0}, {1})",
    "maximum": "max({0}, {1})",
    "remainder": "{0} - {1} * floor({0} / {1})",
}
# For integers. PyTorch's remainder has the divisor's sign. `%` may have the dividend's, which this formula mends.
WHOLE = {name: FORMULAS[name] for name in ("neg", "abs", "add", "sub", "mul", "minimum", "maximum")}
WHOLE["remainder"] = "({0} % {1} + {1}) % {1}"
# GLSL and HLSL do not define `%` of a negative number. By a positive divisor this formula asks for none.
REMAINDER_BY_POSITIVE = "(max({0}, 0) + {1} - max(-({0}), 0) % {1}) % {1}"
TRUTHS = {
    "eq": "{0} == {1}",
    "ne": "{0} != {1}",
    "lt": "{0} < {1}",
    "le": "{0} <= {1}",
    "gt": "{0} > {1}",
    "ge": "{0} >= {1}",
    "logical_and": "{0} && {1}",
    "bitwise_and": "{0} && {1}",
    "logical_or": "{0} || {1}",
    "bitwise_or": "{0} || {1}",
    "logical_not": "!({0})",
    "bitwise_not": "!({0})",
}
# Of truths a product is “and”, a sum “or”.
OF_TRUTHS = {"mul": TRUTHS["logical_and"], "minimum": TRUTHS["logical_and"]}
OF_TRUTHS |= {"add": TRUTHS["logical_or"], "maximum": TRUTHS["logical_or"]}
KINDS = {"bool": bool, "int": int, "float": float}  # each contains those before it


def _as_kind(backend: Backend, argument: Any, kind: str) -> Array:
    """The scalars of an argument, which is a tensor or a plain number, converted to some kind."""
    if not isinstance(argument, Value):
        return as_array(KINDS[kind](argument))
    if argument.kind == kind:
        return argument.items
    scalars = [backend.as_kind(x, argument.kind, kind) for x in listed(argument.items)]
    return as_array(scalars).reshape(argument.items.shape)


def _flat(backend: Backend, argument: Any, kind: str, shape: tuple[int, ...]) -> list[Scalar]:
    """The scalars of an argument, converted to some kind and broadcast to a shape, as one list."""
    return listed(np.broadcast_to(_as_kind(backend, argument, kind), shape))


def _each(backend: Backend, step: Step, formula: str, *arguments: Any, from_kind: str | None = None) -> Value:
    """A formula for each element of a result, with NumPy's broadcasting."""
    from_kind = from_kind or step.kind
    rows = [_flat(backend, argument, from_kind, step.shape) for argument in arguments]
    results = as_array(backend.each(formula, rows, from_kind, step.kind))
    return Value(results.reshape(step.shape), step.kind)


def _computes(name: str) -> Operation:
    """The operation that applies the formula of a name to each element, by the kind of the result."""

    def compute(backend: Backend, step: Step, *arguments: Any) -> Array:
        """Compute the step element by element, by the formula for floats, for whole numbers or for truths."""
        formulas = {"float": FORMULAS, "int": WHOLE, "bool": OF_TRUTHS}[step.kind]
        if name not in formulas:
            elements = {"int": "whole numbers", "bool": "truths"}[step.kind]
            raise backend.cannot(f"do {name!r} of {elements}")
        return _each(backend, step, formulas[name], *arguments).items

    return compute


def _kind_of(argument: Any) -> str:
    """The kind of a tensor, or of a plain number: `float`, `int` or `bool`."""
    return argument.kind if isinstance(argument, Value) else type(argument).__name__


def _decides(formula: str) -> Operation:
    """The operation that applies a formula with a truth as its result; arguments are compared as the widest kind."""

    def decide(backend: Backend, step: Step, *arguments: Any) -> Array:
        """Compute the step element by element, with truths as results."""
        kinds = {_kind_of(argument) for argument in arguments}
        widest = max(kinds, key=list(KINDS).index)
        return _each(backend, step, formula, *arguments, from_kind=widest).items

    return decide


OPERATIONS |= {name: _computes(name) for name in FORMULAS}
OPERATIONS |= {name: _decides(formula) for name, formula in TRUTHS.items()}


@operation("remainder")
def _remainder(backend: Backend, step: Step, number: Any, divisor: Any) -> Array:
    """The remainder with the divisor's sign."""
    if step.kind == "float":
        return _each(backend, step, FORMULAS["remainder"], number, divisor).items
    divisors = _flat(backend, divisor, step.kind, step.shape)
    positive = all(is_number(each) and each > 0 for each in divisors)
    formula = REMAINDER_BY_POSITIVE if positive else WHOLE["remainder"]
    return _each(backend, step, formula, number, divisor).items


@operation("relu", "leaky_relu")
def _relu(backend: Backend, step: Step, source: Value, slope: float = 0.01) -> Array:
    """Numbers below 0 times a slope, or 0 for `relu`; others unchanged."""
    # The larger of x and slope · x (of x and 0 for `relu`): x where it is positive, for a slope of at most 1.
    if slope > 1:
        raise backend.cannot(f"do a leaky_relu of slope {slope:g}")
    lower = _each(backend, step, FORMULAS["mul"], source, slope) if step.operation == "leaky_relu" else 0
    return _each(backend, step, FORMULAS["maximum"], source, lower).items


@operation("clamp", "clamp_min")
def _clamp(backend: Backend, step: Step, source: Value, low: Any = None, high: Any = None) -> Array:
    """A tensor within limits, which are numbers or tensors; None is no limit."""
    if low is not None:
        source = _each(backend, step, FORMULAS["maximum"], source, low)
    if high is not None:
        source = _each(backend, step, FORMULAS["minimum"], source, high)
    return source.items


OPERATIONS["clamp_max"] = lambda backend, step, source, high: _clamp(backend, step, source, None, high)


@operation("pow")
def _pow(backend: Backend, step: Step, base: Value, exponent: Any) -> Array:
    """Powers; square roots and small whole powers without `pow`, which GLSL does not define for a negative base."""
    if isinstance(exponent, float | int):
        if exponent == 0.5:
            return _each(backend, step, FORMULAS["sqrt"], base).items
        if float(exponent).is_integer() and 1 <= abs(exponent) <= MOST_FACTORS:
            product = " * ".join(["{0}"] * int(abs(exponent)))
            formula = product if exponent > 0 else f"1.0 / ({product})"
            return _each(backend, step, formula, base).items
    return _each(backend, step, "pow({0}, {1})", base, exponent).items


@operation("where")
def _where(backend: Backend, step: Step, condition: Value, yes: Any, no: Any) -> list[Scalar]:
    """`yes` where the condition holds, else `no`; each is a tensor or a number, and all are broadcast."""
    conditions = _flat(backend, condition, "bool", step.shape)
    if_true = _flat(backend, yes, step.kind, step.shape)
    if_false = _flat(backend, no, step.kind, step.shape)
    choices = zip(conditions, if_true, if_false, strict=True)
    return [backend.choose(holds, true, false, step.kind) for holds, true, false in choices]


@operation("to_copy")
def _converted(backend: Backend, step: Step, source: Value) -> Any:
    """A tensor as the kind of the step."""
    if source.kind == step.kind:
        return source.items
    return [backend.convert(x, source.kind, step.kind) for x in listed(source.items)]


# Operations that only move numbers.

OPERATIONS |= dict.fromkeys(("view", "unsqueeze", "squeeze", "reshape"), lambda backend, step, source, *_: source.items)
OPERATIONS |= {
    "expand": lambda backend, step, source, *_: np.broadcast_to(source.items, step.shape),
    "permute": lambda backend, step, source, axes: source.items.transpose(axes),
    "cat": lambda backend, step, parts, axis=0: np.concatenate([part.items.astype(object) for part in parts], axis),
    "select": lambda backend, step, source, axis, number: source.items.take([number], axis),
}


@operation("slice")
def _slice(
    backend: Backend,
    step: Step,
    source: Value,
    axis: int = 0,
    start: int | None = None,
    end: int | None = None,
    stride: int = 1,
) -> Array:
    """Every `stride`-th element along one axis, from `start` to before `end`; the defaults are PyTorch's."""
    where = [slice(None)] * source.items.ndim
    where[axis] = slice(start, None if end == INFINITE else end, stride)
    return source.items[tuple(where)]


@operation("constant_pad_nd")
def _pad(backend: Backend, step: Step, source: Value, pads: list[int], value: float = 0.0) -> Array:
    """A tensor with constants around it; `pads` has the counts before and after it, for the last axis first."""
    sides = [(0, 0)] * source.items.ndim
    for k in range(len(pads) // 2):  # counted from the last axis on
        sides[-1 - k] = (pads[2 * k], pads[2 * k + 1])
    return np.pad(source.items.astype(object), sides, constant_values=value)


# Operations that combine several numbers.


@operation("mm", "addmm", "bmm")
def _product(backend: Backend, step: Step, *arguments: Value) -> list[Scalar]:
    """Matrix products; of `addmm`, a bias comes before the two factors."""
    *before, left, right = arguments
    bias = _flat(backend, before[0], "float", step.shape) if before else None
    return backend.product(left.items, right.items, bias)


def _rows(items: Array, axes: Any) -> Rows:
    """The scalars of a tensor as (results, summands), for a reduction over some axes; None: over all."""
    if axes is None or axes == []:
        return [listed(items)]
    all_axes = axes if isinstance(axes, list) else [axes]
    reduced = [axis % items.ndim for axis in all_axes]  # negative ones count from the end
    others = [axis for axis in range(items.ndim) if axis not in reduced]
    count = math.prod(items.shape[axis] for axis in reduced)
    results = math.prod(items.shape[axis] for axis in others)  # not -1, which is unknown if there are no summands
    rows = items.transpose(*others, *reduced).reshape(results, count)
    return [listed(row) for row in rows]


def _folded(backend: Backend, formula: str, row: list[Scalar], kind: str) -> Scalar:
    """A row reduced by a formula of two numbers: of the first two, then of that result and the third, and so on."""
    result = row[0]
    for other in row[1:]:
        (result,) = backend.each(formula, [[result], [other]], kind, kind)
    return result


@operation("sum")
def _sum(backend: Backend, step: Step, source: Value, axes: Any = None, *_: Any) -> list[Scalar]:
    """Sums over some axes, or over all; a truth counts as 1."""
    rows = _rows(_as_kind(backend, source, step.kind), axes)
    if step.kind == "float":
        return [backend.total(row, "{0}") for row in rows]
    return [_folded(backend, WHOLE["add"], row, step.kind) for row in rows]


@operation("mean")
def _mean(backend: Backend, step: Step, source: Value, axes: Any = None, *_: Any) -> list[Scalar]:
    """Means over some axes, or over all."""
    # The formula is "({0}) / COUNT": doubled braces stand for single ones here.
    return [backend.total(row, f"({{0}}) / {float(len(row))}") for row in _rows(source.items, axes)]


@operation("linalg_vector_norm")
def _norm(backend: Backend, step: Step, source: Value, order: float, axes: Any = None, *_: Any) -> list[Scalar]:
    """Euclidean lengths over some axes, or over all."""
    if order != 2:
        raise backend.cannot(f"do a norm of order {order}")
    return backend.lengths(source.items, lambda items: _rows(items, axes))


@operation("amin", "amax")
def _extreme(backend: Backend, step: Step, source: Value, axes: Any = None, *_: Any) -> list[Scalar]:
    """The smallest or the largest number over some axes, or over all."""
    formula = FORMULAS["minimum" if step.operation == "amin" else "maximum"]
    return [_folded(backend, formula, row, step.kind) for row in _rows(source.items, axes)]


@operation("any", "all")
def _any_or_all(backend: Backend, step: Step, source: Value, axes: Any = None, *_: Any) -> list[Scalar]:
    """Whether any, or all, of the truths along some axes hold."""
    if source.kind != "bool":
        raise backend.cannot("ask whether any or all of some numbers are other than 0")
    rows = _rows(source.items, axes)
    sign = " || " if step.operation == "any" else " && "
    # "{0} || {1} || {2} …", with as many arguments as a row has numbers.
    formula = sign.join(f"{{{k}}}" for k in range(len(rows[0])))
    # `each` takes all first arguments, then all second ones.
    columns = [list(column) for column in zip(*rows, strict=True)]
    return backend.each(formula, columns, "bool", "bool")


@operation("argmax", "argmin")
def _index_of_extreme(backend: Backend, step: Step, source: Value, axis: Any = None, *_: Any) -> list[Scalar]:
    """The index of the largest, or smallest, number along an axis; the first of equal ones."""
    formula = TRUTHS["gt" if step.operation == "argmax" else "lt"]
    results = []
    for row in _rows(source.items, axis):
        best, place = row[0], 0
        for number, other in enumerate(row[1:], 1):
            (better,) = backend.each(formula, [[other], [best]], source.kind, "bool")
            place = backend.choose(better, number, place, "int")
            best = backend.choose(better, other, best, source.kind)
        results.append(place)
    return results


# Look-ups.


def looked_up(backend: Backend, rows: Array, index: Scalar, kind: str) -> list[Scalar]:
    """One row of an array (rows, channels): by a number here, of a constant by the back end, else by choices."""
    if is_number(index):
        return listed(rows[int(index)])
    if rows.dtype != object:
        return backend.look_up(rows, index, kind)
    chosen = list(rows[0])
    for number in range(1, len(rows)):
        (hit,) = backend.each(TRUTHS["eq"], [[index], [number]], "int", "bool")
        chosen = [backend.choose(hit, new, old, kind) for new, old in zip(rows[number], chosen, strict=True)]
    return chosen


@operation("index_select")
def _index_select(backend: Backend, step: Step, table: Value, axis: int, index: Value) -> Array:
    """The parts of a tensor at some indices along one axis."""
    items = np.moveaxis(table.items, axis, 0)  # the indexed axis first
    rows = items.reshape(len(items), -1)
    chosen = as_array([looked_up(backend, rows, i, step.kind) for i in listed(index.items)])
    return np.moveaxis(chosen.reshape(index.items.size, *items.shape[1:]), 0, axis)


OPERATIONS["embedding"] = lambda backend, step, table, index, *_: _index_select(backend, step, table, 0, index)


@operation("index")
def _index(backend: Backend, step: Step, table: Value, indices: list[Value | None]) -> Array:
    """The elements, or rows, of a tensor at indices for its first axes, which broadcast; none of them may be None."""
    index_arrays = [index.items for index in indices if index is not None]
    if len(index_arrays) != len(indices):
        raise backend.cannot("index some axes alone")
    lengths = table.items.shape[: len(index_arrays)]  # of the indexed axes
    rows = table.items.reshape(math.prod(lengths), -1)
    grids = [listed(grid) for grid in np.broadcast_arrays(*index_arrays)]
    chosen = []
    for place in zip(*grids, strict=True):
        from_front = [_from_front(backend, number, length) for number, length in zip(place, lengths, strict=True)]
        row = _row_of(backend, from_front, lengths)
        chosen.append(looked_up(backend, rows, row, step.kind))
    return as_array(chosen)


def _from_front(backend: Backend, number: Scalar, length: int) -> Scalar:
    """An index of an axis, counted from its front: PyTorch counts a negative one from the end."""
    if length == 1:
        return 0
    if is_number(number):
        return number % length
    (is_negative,) = backend.each(TRUTHS["lt"], [[number], [0]], "int", "bool")
    (wrapped,) = backend.each("{0} + {1}", [[number], [length]], "int", "int")
    return backend.choose(is_negative, wrapped, number, "int")


def _row_of(backend: Backend, place: Sequence[Scalar], lengths: Sequence[int]) -> Scalar:
    """The number of a row in a table whose leading axes, of some `lengths`, were made one; `place` is an index of each.

    Axis by axis, the number so far is multiplied by the axis' length, and the index is added.
    """
    row: Scalar = 0
    for number, length in zip(place, lengths, strict=True):
        if length == 1:  # its only index is 0
            continue
        # Python computes with numbers, and where the number so far is 0; only the rest becomes a formula.
        if is_number(row) and row == 0:
            row = number
        elif is_number(row) and is_number(number):
            row = row * length + number
        else:
            (row,) = backend.each("{0} * {1} + {2}", [[row], [length], [number]], "int", "int")
    return row


@operation("embedding_bag_forward_only")
def _bag(
    backend: Backend, step: Step, table: Value, index: Value, bags: int, shares: Value | None = None
) -> list[Scalar]:
    """The sum of some rows of a table, each times its share, or once without shares; only of one bag."""
    if bags != 1:
        raise backend.cannot("add up several bags")
    indices = listed(index.items)
    weights = [1.0] * len(indices) if shares is None else listed(shares.items)
    return backend.blend(table.items, indices, weights)


@operation("gather")
def _gather(backend: Backend, step: Step, source: Value, axis: int, index: Value, *_: Any) -> list[Scalar]:
    """For each place in `index`, the element of `source` at the same place, but along the axis at the index there."""
    results = []
    for place in np.ndindex(*index.items.shape):
        where: list[Any] = list(place)
        where[axis % source.items.ndim] = slice(None)
        # All elements along the axis, as rows of one channel.
        options = source.items[tuple(where)].reshape(-1, 1)
        results += looked_up(backend, options, index.items[place], step.kind)
    return results
