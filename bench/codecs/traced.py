"""The program of a decoded material as Dr.Jit operations, so that the kernel of a renderer evaluates any codec's file.

A tensor of the program is a NumPy array of scalars, each a number or a Dr.Jit array over the queries. So NumPy does
what only moves numbers, and weights become literals of the kernel, or of functions that it calls if they are very many.
Tables are fetched from memory.
"""

import math
import operator
from collections.abc import Callable, Sequence
from types import ModuleType
from typing import Any

import drjit as dr
import numpy as np

from bench.codecs.called import MOST_LITERALS, called_product, products
from bench.codecs.program import INPUTS, Program
from bench.errors import InputError

Array = np.ndarray
Scalar = Any  # a number, or a Dr.Jit array over the queries
_END = 9_223_372_036_854_775_807  # the end of a slice without one


class Traced:
    """A program that Dr.Jit records; `kind` is its module of arrays, such as `drjit.llvm`.

    `more` computes operations that are the caller's own.
    """

    def __init__(self, program: Program, kind: ModuleType, more: "dict[str, Operation] | None" = None):
        self.operations = OPERATIONS | (more or {})
        absent = {step.operation for step in program.steps} - self.operations.keys()
        if absent:
            raise InputError(f"no kernel can do {min(absent)!r} yet, which this material's evaluate uses")
        self.program, self.kind = program, kind
        self.calls = products(program) > MOST_LITERALS
        self.tables: dict[tuple[int, int], tuple[Array, Scalar]] = {}  # by place and size in memory

    def __call__(self, uv: Sequence[Scalar], wo: Sequence[Scalar], wi: Sequence[Scalar], footprint: Scalar) -> Any:
        """The RGB of queries above the horizon: three Dr.Jit arrays, not yet clamped at 0."""
        given = ([list(uv)], [list(wo)], [list(wi)], [footprint])
        values = {name: as_array(value) for name, value in zip(INPUTS, given, strict=True)} | self.program.constants
        for step in self.program.steps:
            arguments = [_resolved(values, each) for each in step.arguments]
            found = self.operations[step.operation](_Call(self, step.shape, step.kind), *arguments)
            values[step.name] = found.reshape(step.shape)
        return list(values[self.program.result].reshape(-1))

    def row(self, rows: Array, index: Scalar, of: str) -> list[Scalar]:
        """One row of an array (rows, channels): of a constant from memory, of computed scalars by choices."""
        if isinstance(index, int | np.integer):
            return list(rows[int(index)])
        if rows.dtype == object:
            chosen = list(rows[0])
            for number in range(1, len(rows)):
                hit = index == number
                chosen = [dr.select(hit, other, known) for other, known in zip(rows[number], chosen, strict=True)]
            return chosen
        # An altered file must not read other memory.
        table, first = self._table(rows, of), dr.minimum(self.kind.UInt(index), len(rows) - 1) * rows.shape[1]
        return [dr.gather(type(table), table, first + channel) for channel in range(rows.shape[1])]

    def _table(self, rows: Array, of: str) -> Scalar:
        key = (rows.__array_interface__["data"][0], rows.size)
        if key not in self.tables:
            made = self.kind.Float if of == "float" else self.kind.Int
            self.tables[key] = rows, made(np.ascontiguousarray(rows).reshape(-1))  # holds its memory, and so its key
        return self.tables[key][1]

    def cast(self, value: Scalar, of: str) -> Scalar:
        """A scalar as a float or a whole number."""
        if isinstance(value, bool | int | float | np.generic):
            return {"float": float, "int": int, "bool": bool}[of](value)
        if dr.is_mask_v(value):
            return value if of == "bool" else dr.select(value, self.kind.Float(1), self.kind.Float(0))
        return self.kind.Float(value) if of == "float" else self.kind.Int(value)


class _Call:
    """What an operation knows besides its arguments: the shape and kind of its result."""

    def __init__(self, traced: Traced, shape: tuple[int, ...], kind: str):
        self.traced, self.shape, self.kind = traced, shape, kind


Operation = Callable[..., Array]
OPERATIONS: dict[str, Operation] = {}


def _operation(*names: str) -> Callable[[Operation], Operation]:
    def register(function: Operation) -> Operation:
        OPERATIONS.update(dict.fromkeys(names, function))
        return function

    return register


def _resolved(values: dict[str, Array], argument: Any) -> Any:
    if isinstance(argument, dict):
        return values[argument["of"]]
    return [_resolved(values, each) for each in argument] if isinstance(argument, list) else argument


def as_array(values: Any) -> Array:
    """An array of objects; Dr.Jit arrays are not looked into."""
    if not isinstance(values, list):
        found = np.empty((), object)
        found[()] = values
        return found
    inner = [as_array(each) for each in values]
    made = np.empty((len(inner), *(inner[0].shape if inner else ())), object)
    for number, each in enumerate(inner):
        made[number] = each[()] if each.ndim == 0 else each
    return made


def _each(function: Callable[..., Scalar], *arguments: Any) -> Array:
    """A function of scalars for each element, with NumPy's broadcasting."""
    with np.errstate(all="ignore"):  # which flags Dr.Jit leaves says nothing
        return np.asarray(np.frompyfunc(function, len(arguments), 1)(*arguments), object)


# What computes each number by itself.


def _modulo(a: Scalar, b: Scalar) -> Scalar:
    if isinstance(a, int) and isinstance(b, int):
        return a % b
    # A renderer fetches 0 for rays that it does not ask, and a division of whole numbers by 0 ends the process.
    b = b if isinstance(b, int) else dr.select(b == 0, 1, b)
    return (a % b + b) % b


_FUNCTIONS: dict[str, Callable[..., Scalar]] = {
    **{"neg": operator.neg, "abs": abs, "floor": dr.floor, "ceil": dr.ceil, "exp": dr.exp, "log": dr.log},
    **{"log2": dr.log2, "sin": dr.sin, "cos": dr.cos, "tanh": dr.tanh, "sqrt": dr.sqrt, "rsqrt": dr.rsqrt},
    **{"reciprocal": lambda x: 1 / x, "sigmoid": lambda x: 1 / (dr.exp(-x) + 1), "relu": lambda x: dr.maximum(x, 0)},
    **{"expm1": lambda x: dr.exp(x) - 1, "log1p": lambda x: dr.log(x + 1)},
    **{"add": operator.add, "sub": operator.sub, "mul": operator.mul, "div": operator.truediv},
    **{"minimum": dr.minimum, "maximum": dr.maximum},
}
_TRUTHS: dict[str, Callable[..., Scalar]] = {
    **{"eq": operator.eq, "ne": operator.ne, "lt": operator.lt, "le": operator.le, "gt": operator.gt},
    **{"ge": operator.ge, "logical_and": operator.and_, "bitwise_and": operator.and_, "logical_or": operator.or_},
    **{"bitwise_or": operator.or_, "logical_not": lambda x: not x if isinstance(x, bool) else ~x},
}
_TRUTHS["bitwise_not"] = _TRUTHS["logical_not"]


def _computes(function: Callable[..., Scalar]) -> Operation:
    def compute(call: _Call, *arguments: Any) -> Array:
        same = [_each(lambda x: call.traced.cast(x, call.kind), argument) for argument in arguments]
        return np.broadcast_to(_each(function, *same), call.shape)

    return compute


def _decides(function: Callable[..., Scalar]) -> Operation:
    return lambda call, *arguments: np.broadcast_to(_each(function, *arguments), call.shape)


OPERATIONS |= {name: _computes(function) for name, function in _FUNCTIONS.items()}
OPERATIONS |= {name: _decides(function) for name, function in _TRUTHS.items()}


@_operation("remainder")
def _remainder(call: _Call, left: Any, right: Any) -> Array:
    if call.kind == "int":
        return _each(_modulo, left, right)
    return _each(lambda a, b: a - b * dr.floor(a / b), left, right)


@_operation("leaky_relu")
def _leaky(call: _Call, source: Array, slope: float = 0.01) -> Array:
    return _each(lambda x: dr.maximum(x, slope * x), source)


@_operation("clamp", "clamp_min")
def _clamp(call: _Call, source: Array, low: Any = None, high: Any = None) -> Array:
    found = source if low is None else _each(dr.maximum, source, low)
    return found if high is None else _each(dr.minimum, found, high)


@_operation("clamp_max")
def _clamp_max(call: _Call, source: Array, high: Any) -> Array:
    return _each(dr.minimum, source, high)


@_operation("pow")
def _pow(call: _Call, base: Array, exponent: Any) -> Array:
    if exponent == 2:
        return _each(lambda x: x * x, base)
    return _each(dr.sqrt if exponent == 0.5 else lambda x: dr.power(x, exponent), base)


@_operation("where")
def _where(call: _Call, condition: Array, yes: Any, no: Any) -> Array:
    yes, no = (_each(lambda x: call.traced.cast(x, call.kind), each) for each in (yes, no))
    return np.broadcast_to(_each(dr.select, condition, yes, no), call.shape)


@_operation("to_copy")
def _to(call: _Call, source: Array) -> Array:
    return _each(lambda x: call.traced.cast(x, call.kind), source)


# What only moves numbers.


@_operation("view", "unsqueeze", "squeeze", "reshape", "_unsafe_view")
def _view(call: _Call, items: Array, *_: Any) -> Array:
    return items.reshape(call.shape)


@_operation("expand")
def _expand(call: _Call, items: Array, *_: Any) -> Array:
    return np.broadcast_to(items, call.shape)


@_operation("permute")
def _permute(call: _Call, items: Array, axes: list[int]) -> Array:
    return items.transpose(axes)


@_operation("cat")
def _cat(call: _Call, parts: list[Array], axis: int = 0) -> Array:
    return np.concatenate([np.asarray(part, object) for part in parts], axis)


@_operation("slice")
def _slice(
    call: _Call, items: Array, axis: int = 0, start: int | None = None, end: int | None = None, step: int = 1
) -> Array:
    where = [slice(None)] * items.ndim
    where[axis] = slice(start, None if end == _END else end, step)
    return items[tuple(where)]


@_operation("select")
def _select(call: _Call, items: Array, axis: int, number: int) -> Array:
    return items.take([number], axis)


@_operation("constant_pad_nd")
def _pad(call: _Call, items: Array, pads: list[int], value: float = 0.0) -> Array:
    sides = [(0, 0)] * items.ndim
    for k in range(len(pads) // 2):
        sides[-1 - k] = (pads[2 * k], pads[2 * k + 1])
    return np.pad(np.asarray(items, object), sides, constant_values=value)


# What combines several numbers.


def _dot(left: Sequence[Scalar], right: Sequence[Scalar], start: Scalar = 0.0) -> Scalar:
    total = start
    for a, b in zip(left, right, strict=True):
        total = dr.fma(a, b, total)
    return total


def _listed(items: Array) -> list[Scalar]:
    """Elements as Python numbers and Dr.Jit arrays."""
    return [x.item() if isinstance(x, np.generic) else x for x in items.reshape(-1)]


@_operation("mm", "addmm", "bmm")
def _product(call: _Call, *arguments: Array) -> Array:
    bias = arguments[0] if len(arguments) == 3 else None
    left, right = (each if each.ndim == 3 else each[None] for each in arguments[-2:])
    starts = iter([0.0] * math.prod(call.shape) if bias is None else _listed(np.broadcast_to(bias, call.shape)))
    found: list[Scalar] = []
    for row, matrix in ((row, matrix) for rows, matrix in zip(left, right, strict=True) for row in rows):
        if call.traced.calls and matrix.dtype != object:
            sums = called_product(call.traced.kind, _listed(row), matrix)
            found += [total + start for total, start in zip(sums, starts, strict=False)]
        else:
            found += [_dot(_listed(row), _listed(column), next(starts)) for column in matrix.T]
    return as_array(found)


def _groups(items: Array, axes: Any) -> list[list[Scalar]]:
    """The scalars of a tensor as (results, summands), for a reduction over some axes; None: over all."""
    if axes is None or axes == []:
        return [_listed(items)]
    reduced = [axis % items.ndim for axis in (axes if isinstance(axes, list) else [axes])]
    kept = [axis for axis in range(items.ndim) if axis not in reduced]
    count = math.prod(items.shape[axis] for axis in reduced)
    return [_listed(row) for row in items.transpose(*kept, *reduced).reshape(-1, count)]


def _reduced(combine: Callable[[list[Scalar]], Scalar]) -> Operation:
    return lambda call, items, axes=None, *_: as_array([combine(row) for row in _groups(items, axes)])


def _folded(function: Callable[[Scalar, Scalar], Scalar]) -> Callable[[list[Scalar]], Scalar]:
    def fold(row: list[Scalar]) -> Scalar:
        best = row[0]
        for other in row[1:]:
            best = function(best, other)
        return best

    return fold


def _place(better: Callable[[Scalar, Scalar], Scalar]) -> Callable[[list[Scalar]], Scalar]:
    def find(row: list[Scalar]) -> Scalar:
        best, place = row[0], 0
        for number, other in enumerate(row[1:], 1):
            wins = better(other, best)
            best, place = dr.select(wins, other, best), dr.select(wins, number, place)
        return place

    return find


_sum = _folded(operator.add)
OPERATIONS |= {
    **{
        "sum": _reduced(_sum),
        "mean": _reduced(lambda row: _sum(row) / len(row)),
        "any": _reduced(_folded(operator.or_)),
    },
    **{"amin": _reduced(_folded(dr.minimum)), "amax": _reduced(_folded(dr.maximum))},
    **{"argmax": _reduced(_place(operator.gt)), "argmin": _reduced(_place(operator.lt))},
}


@_operation("linalg_vector_norm")
def _norm(call: _Call, items: Array, order: float, axes: Any = None, *_: Any) -> Array:
    if order != 2:
        raise InputError(f"no kernel can do a norm of order {order} yet")
    return as_array([dr.sqrt(_dot(row, row)) for row in _groups(items, axes)])


# Look-ups.


@_operation("index_select")
def _index_select(call: _Call, table: Array, axis: int, index: Array) -> Array:
    lead = np.moveaxis(table, axis, 0)
    rows = lead.reshape(len(lead), -1)
    found = as_array([call.traced.row(rows, i, call.kind) for i in _listed(index)])
    return np.moveaxis(found.reshape(index.size, *lead.shape[1:]), 0, axis)


@_operation("embedding")
def _embedding(call: _Call, table: Array, index: Array, *_: Any) -> Array:
    return _index_select(call, table, 0, index)


@_operation("index")
def _index(call: _Call, table: Array, indices: list[Array | None]) -> Array:
    given = [index for index in indices if index is not None]
    if len(given) != len(indices):
        raise InputError("no kernel can index some axes alone yet")
    lead = table.shape[: len(given)]
    rows = table.reshape(math.prod(lead), -1)
    results = []
    for place in zip(*(_listed(grid) for grid in np.broadcast_arrays(*given)), strict=True):
        flat: Scalar = 0
        for number, length in zip(place, lead, strict=True):
            flat = flat * length + (number if length > 1 else 0)
        results.append(call.traced.row(rows, flat, call.kind))
    return as_array(results)


@_operation("embedding_bag_forward_only")
def _bag(call: _Call, table: Array, index: Array, bags: int, shares: Array | None = None) -> Array:
    if bags != 1:
        raise InputError("no kernel can add up several bags yet")
    rows = [call.traced.row(table, i, call.kind) for i in _listed(index)]
    weights = [1.0] * len(rows) if shares is None else _listed(shares)
    return as_array([_dot(weights, channel) for channel in zip(*rows, strict=True)])


@_operation("gather")
def _gather(call: _Call, source: Array, axis: int, index: Array, *_: Any) -> Array:
    results = []
    for place in np.ndindex(*index.shape):
        where: list[Any] = list(place)
        where[axis % source.ndim] = slice(None)
        options = source[tuple(where)].reshape(-1, 1)
        results.append(call.traced.row(options, index[place], call.kind)[0])
    return as_array(results)
