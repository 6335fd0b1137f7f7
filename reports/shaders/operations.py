"""Operations that move numbers, bring several together or look them up; `reports.shaders.arithmetic` has the rest."""

from collections.abc import Callable
from typing import Any

import numpy as np

from bench.errors import InputError
from reports.shaders.arithmetic import OPERATIONS, Operation, Shape, flattened, floats, operation
from reports.shaders.writer import Value, Writer

Array = np.ndarray

INFINITE = 9_223_372_036_854_775_807  # what a slice without an end has as its end


# Operations that only move numbers: NumPy performs them.


def moves(*names: str) -> Callable[[Callable[..., Array]], Callable[..., Array]]:
    """Register a function of arrays and numbers that moves scalars."""

    def register(function: Callable[..., Array]) -> Callable[..., Array]:
        def write(_: Writer, shape: Shape, kind: str, arguments: list[Any]) -> Array:
            plain = [
                [x.items for x in a] if isinstance(a, list) and a and isinstance(a[0], Value) else a for a in arguments
            ]
            return function(shape, *(a.items if isinstance(a, Value) else a for a in plain))

        OPERATIONS.update(dict.fromkeys(names, write))
        return function

    return register


@moves("view", "unsqueeze", "squeeze", "reshape", "_unsafe_view")
def _view(shape: Shape, items: Array, *_: Any) -> Array:
    return items.reshape(shape)


@moves("expand")
def _expand(shape: Shape, items: Array, *_: Any) -> Array:
    return np.broadcast_to(items, shape)


@moves("permute")
def _permute(shape: Shape, items: Array, axes: list[int]) -> Array:
    return items.transpose(axes)


@moves("cat")
def _cat(shape: Shape, parts: list[Array], axis: int = 0) -> Array:
    return np.concatenate([np.asarray(part, object) for part in parts], axis)


@moves("slice")
def _slice(
    shape: Shape, items: Array, axis: int = 0, start: int | None = None, end: int | None = None, step: int = 1
) -> Array:
    where = [slice(None)] * items.ndim
    where[axis] = slice(start, None if end == INFINITE else end, step)
    return items[tuple(where)]


@moves("select")
def _select(shape: Shape, items: Array, axis: int, number: int) -> Array:
    return items.take(number, axis)


@moves("constant_pad_nd")
def _pad(shape: Shape, items: Array, pads: list[int], value: float = 0.0) -> Array:
    sides = [(0, 0)] * items.ndim
    for k in range(len(pads) // 2):
        sides[-1 - k] = (pads[2 * k], pads[2 * k + 1])
    return np.pad(np.asarray(items, object), sides, constant_values=value)


# Operations that combine several numbers.


@operation("mm", "addmm")
def _product(writer: Writer, shape: Shape, kind: str, arguments: list[Any]) -> list[str]:
    bias, left, right = arguments if len(arguments) == 3 else (None, *arguments)
    if left.items.shape[0] != 1:
        raise InputError("no shader can multiply these matrices yet")
    start = None if bias is None else flattened(bias, shape)
    if right.items.dtype.kind == "f":
        return writer.product(right.items.T, list(left.items.reshape(-1)), start)
    total = _dots(writer, left.items, right.items)
    return (
        total
        if start is None
        else [writer.name("float", f"{a} + {writer.scalar(b, 'float')}") for a, b in zip(total, start, strict=True)]
    )


@operation("bmm")
def _products(writer: Writer, shape: Shape, kind: str, arguments: list[Any]) -> list[str]:
    left, right = arguments
    pairs = zip(left.items, right.items, strict=True)
    return [text for a, b in pairs for text in _dots(writer, a, b)]


def _dots(writer: Writer, left: Array, right: Array) -> list[str]:
    """The product of two matrices of scalars, row by row."""

    def term(a: Any, b: Any) -> str:
        return f"{writer.scalar(a, 'float')} * {writer.scalar(b, 'float')}"

    return [
        writer.name("float", " + ".join(term(a, b) for a, b in zip(row, column, strict=True)))
        for row in left
        for column in right.T
    ]


def _groups(source: Value, axes: Any) -> Array:
    """The scalars of a tensor as (results, summands), for a reduction over some axes; None: over all."""
    items = source.items
    if axes is None or axes == []:
        return items.reshape(1, -1)
    reduced = [axis % items.ndim for axis in (axes if isinstance(axes, list) else [axes])]
    kept = [axis for axis in range(items.ndim) if axis not in reduced]
    count = int(np.prod([items.shape[axis] for axis in reduced]))
    return items.transpose(*kept, *reduced).reshape(-1, count)


def _total(writer: Writer, row: list[Any]) -> str:
    """The sum of some floats: dot products of four at a time, where they stand in vectors."""
    ones = f"{writer.dialect.types['vec4']}(1.0)" if writer.dialect.name != "hlsl" else "float4(1.0, 1.0, 1.0, 1.0)"
    whole = [writer.vector(row[i : i + 4]) for i in range(0, len(row) - len(row) % 4, 4)]
    parts = [f"dot({text}, {ones})" if text.isidentifier() else None for text in whole]
    terms = []
    for i, text in enumerate(parts):
        terms += [text] if text else [writer.scalar(x, "float") for x in row[4 * i : 4 * i + 4]]
    terms += [writer.scalar(x, "float") for x in row[4 * len(whole) :]]
    return " + ".join(terms)


@operation("sum", "mean")
def _sum(writer: Writer, shape: Shape, kind: str, arguments: list[Any]) -> list[str]:
    if kind != "float":
        raise InputError("no shader can add up whole numbers yet")
    return [writer.name("float", _total(writer, list(row))) for row in _groups(arguments[0], (*arguments, None)[1])]


@operation("mean")
def _mean(writer: Writer, shape: Shape, kind: str, arguments: list[Any]) -> list[str]:
    rows = _groups(arguments[0], (*arguments, None)[1])
    return [writer.name("float", f"({_total(writer, list(row))}) / {float(len(row))}") for row in rows]


@operation("linalg_vector_norm")
def _norm(writer: Writer, shape: Shape, kind: str, arguments: list[Any]) -> list[str]:
    source, order, axes = (*arguments, None)[:3]
    if order != 2:
        raise InputError(f"no shader can do a norm of order {order} yet")
    square = floats(writer, "{0} * {0}", [source], source.items.shape)
    squared = Value(np.array(square, object).reshape(source.items.shape), "float")
    return [writer.name("float", f"sqrt({_total(writer, list(row))})") for row in _groups(squared, axes)]


def _extreme(function: str) -> Operation:
    def write(writer: Writer, shape: Shape, kind: str, arguments: list[Any]) -> list[str]:
        results = []
        for row in _groups(arguments[0], (*arguments, None)[1]):
            best = writer.scalar(row[0], kind)
            for other in row[1:]:
                best = writer.name(kind, f"{function}({best}, {writer.scalar(other, kind)})")
            results.append(best)
        return results

    return write


def _joined(sign: str) -> Operation:
    def write(writer: Writer, shape: Shape, kind: str, arguments: list[Any]) -> list[str]:
        source, axes = arguments[0], (*arguments, None)[1]
        if source.kind != "bool":
            raise InputError("no shader can ask whether any or all of some numbers are other than 0 yet")
        return [writer.name("bool", sign.join(writer.scalar(x, "bool") for x in row)) for row in _groups(source, axes)]

    return write


def _place(sign: str) -> Operation:
    def write(writer: Writer, shape: Shape, kind: str, arguments: list[Any]) -> list[str]:
        source, axis = arguments[0], (*arguments, None)[1]
        results = []
        for row in _groups(source, axis):
            best, place = writer.scalar(row[0], source.kind), "0"
            for number, other in enumerate(row[1:], 1):
                text = writer.scalar(other, source.kind)
                better = writer.name("bool", f"{text} {sign} {best}")
                place = writer.name("int", writer.dialect.choose.format(condition=better, yes=str(number), no=place))
                best = writer.name(source.kind, writer.dialect.choose.format(condition=better, yes=text, no=best))
            results.append(place)
        return results

    return write


OPERATIONS.update(amin=_extreme("min"), amax=_extreme("max"), argmax=_place(">"), argmin=_place("<"),
                  any=_joined(" || "), all=_joined(" && "))  # fmt: skip


# Look-ups.


def _looked_up(writer: Writer, rows: Array, index: Any, kind: str) -> list[Any]:
    """One row of an array (rows, channels): by a number here, of a constant by the texture, else by choices."""
    if not isinstance(index, str):
        return list(rows[int(index)])
    if rows.dtype.kind in "fi":
        found = writer.row(rows, index)
        if rows.dtype.kind == "f":
            return found
        return [writer.name("int", f"{writer.dialect.types['int']}({x})") for x in found]
    chosen = list(rows[0])
    for number in range(1, len(rows)):
        hit = writer.name("bool", f"{index} == {number}")
        for channel, other in enumerate(rows[number]):
            texts = {"yes": writer.scalar(other, kind), "no": writer.scalar(chosen[channel], kind)}
            chosen[channel] = writer.name(kind, writer.dialect.choose.format(condition=hit, **texts))
    return chosen


@operation("index_select")
def _index_select(writer: Writer, shape: Shape, kind: str, arguments: list[Any]) -> Array:
    table, axis, index = arguments
    items = np.moveaxis(table.items, axis, 0)
    rows = items.reshape(len(items), -1)
    found = [_looked_up(writer, rows, i, kind) for i in index.items.reshape(-1)]
    return np.moveaxis(np.array(found, object).reshape(-1, *items.shape[1:]), 0, axis)


@operation("index")
def _index(writer: Writer, shape: Shape, kind: str, arguments: list[Any]) -> list[Any]:
    table, indices = arguments
    if any(index is None for index in indices):
        raise InputError("no shader can index some axes alone yet")
    lead = table.items.shape[: len(indices)]
    rows = table.items.reshape(int(np.prod(lead)), -1)
    grids = np.broadcast_arrays(*(index.items for index in indices))
    results = []
    for place in zip(*(grid.reshape(-1) for grid in grids), strict=True):
        flat: Any = 0
        for number, length in zip(place, lead, strict=True):
            if length == 1:
                continue
            if isinstance(number, str) or isinstance(flat, str):
                flat = f"{number}" if flat == 0 else writer.name("int", f"{flat} * {length} + {number}")
            else:
                flat = flat * length + int(number)
        results += _looked_up(writer, rows, flat, kind)
    return results


@operation("embedding")
def _embedding(writer: Writer, shape: Shape, kind: str, arguments: list[Any]) -> Array:
    return _index_select(writer, shape, kind, [arguments[0], 0, arguments[1]])


@operation("embedding_bag_forward_only")
def _bag(writer: Writer, shape: Shape, kind: str, arguments: list[Any]) -> list[str]:
    table, index, bags, *rest = arguments
    if bags != 1:
        raise InputError("no shader can add up several bags yet")
    numbers = index.items.reshape(-1)
    shares = rest[0].items.reshape(-1) if rest and rest[0] is not None else [1.0] * len(numbers)
    channels = table.items.shape[1]
    reader, start, stride = writer.tables.place(table.items)
    firsts = [writer.name("int", f"{writer.scalar(i, 'int')} * {stride} + {start}") for i in numbers]
    texts = []
    for pack in range(stride):
        terms = [
            f"{writer.scalar(share, 'float')} * {reader}({first} + {pack})"
            for share, first in zip(shares, firsts, strict=True)
        ]
        texts.append(" + ".join(terms))
    return [writer.name("float", texts[0])] if channels == 1 else writer.floats(texts)[:channels]


@operation("gather")
def _gather(writer: Writer, shape: Shape, kind: str, arguments: list[Any]) -> list[Any]:
    source, axis, index = arguments
    results = []
    for place in np.ndindex(*index.items.shape):
        where: list[Any] = list(place)
        where[axis % source.items.ndim] = slice(None)
        options = source.items[tuple(where)].reshape(-1, 1)
        results += _looked_up(writer, options, index.items[place], kind)
    return results
