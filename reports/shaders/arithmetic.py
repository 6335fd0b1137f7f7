"""Elementwise operations, and the registry of all operations of a program by PyTorch's names (ATen).

Each writer takes the shader's writer, the shape and kind of the result, and the arguments; it gives the scalars.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from bench.errors import InputError
from reports.shaders.writer import Value, Writer

Array = np.ndarray
Shape = tuple[int, ...]
Operation = Callable[[Writer, Shape, str, list[Any]], Any]

OPERATIONS: dict[str, Operation] = {}


def operation(*names: str) -> Callable[[Operation], Operation]:
    """Register a writer under the names of its operations."""

    def register(function: Operation) -> Operation:
        OPERATIONS.update(dict.fromkeys(names, function))
        return function

    return register


# What computes each number by itself.

FLOATS = {
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
}
# Functions of two vectors, which no dialect mixes with a plain number.
PAIRS = {"minimum": "min({0}, {1})", "maximum": "max({0}, {1})"}
INTS = {"add": "{0} + {1}", "sub": "{0} - {1}", "mul": "{0} * {1}", "neg": "-({0})", "minimum": "min({0}, {1})",
        "maximum": "max({0}, {1})", "remainder": "({0} % {1} + {1}) % {1}"}  # fmt: skip
COMPARISONS = {"eq": "==", "ne": "!=", "lt": "<", "le": "<=", "gt": ">", "ge": ">="}
LOGIC = {"logical_and": "{0} && {1}", "bitwise_and": "{0} && {1}", "logical_or": "{0} || {1}",
         "bitwise_or": "{0} || {1}", "logical_not": "!({0})", "bitwise_not": "!({0})"}  # fmt: skip


def flattened(argument: Any, shape: Shape) -> list[Any]:
    """An argument's scalars, broadcast to a shape."""
    items = argument.items if isinstance(argument, Value) else np.asarray(argument, object)
    return list(np.broadcast_to(items, shape).reshape(-1))


def _kind_of(argument: Any) -> str:
    if isinstance(argument, Value):
        return argument.kind
    return "bool" if isinstance(argument, bool) else "int" if isinstance(argument, int) else "float"


def as_float(writer: Writer, argument: Any) -> Any:
    """An argument as floats: an int tensor among floats is converted."""
    if not isinstance(argument, Value) or argument.kind == "float":
        return argument
    convert = writer.dialect.types["float"]
    items = [f"{convert}({x})" if isinstance(x, str) else float(x) for x in argument.items.reshape(-1)]
    return Value(np.array(items, object).reshape(argument.items.shape), "float")


def floats(writer: Writer, template: str, arguments: list[Any], shape: Shape) -> list[str]:
    """A template of floats for each element, four at once."""
    flat = [flattened(as_float(writer, argument), shape) for argument in arguments]
    count, texts = int(np.prod(shape)), []
    if count == 1:
        return [writer.name("float", template.format(*(f"{writer.scalar(x[0], 'float')}" for x in flat)))]
    for start in range(0, count, 4):
        texts.append(template.format(*(writer.vector(each[start : start + 4]) for each in flat)))
    return writer.floats(texts)[:count]


def singly(writer: Writer, template: str, arguments: list[Any], shape: Shape, kind: str) -> list[str]:
    """A template for each element alone; the arguments are of one kind, floats where one of them is."""
    kinds = {_kind_of(argument) for argument in arguments}
    common = "float" if "float" in kinds else "int" if "int" in kinds else "bool"
    ready = [as_float(writer, a) for a in arguments] if common == "float" else arguments
    flat = zip(*(flattened(argument, shape) for argument in ready), strict=True)
    return [writer.name(kind, template.format(*(writer.scalar(x, common) for x in each))) for each in flat]


def _computes(name: str) -> Operation:
    def write(writer: Writer, shape: Shape, kind: str, arguments: list[Any]) -> list[str]:
        if kind == "float":
            if name == "remainder":
                return floats(writer, "{0} - {1} * floor({0} / {1})", arguments, shape)
            return floats(writer, PAIRS.get(name) or FLOATS[name], arguments, shape)
        if name not in INTS:
            raise InputError(f"no shader can do {name!r} of whole numbers yet")
        return singly(writer, INTS[name], arguments, shape, "int")

    return write


OPERATIONS.update({name: _computes(name) for name in (*FLOATS, *PAIRS, "remainder")})
OPERATIONS.update({name: (lambda t: lambda w, s, k, a: singly(w, t, a, s, "bool"))(f"{{0}} {sign} {{1}}")
                   for name, sign in COMPARISONS.items()})  # fmt: skip
OPERATIONS.update({name: (lambda t: lambda w, s, k, a: singly(w, t, a, s, "bool"))(text)
                   for name, text in LOGIC.items()})  # fmt: skip


@operation("relu")
def _relu(writer: Writer, shape: Shape, kind: str, arguments: list[Any]) -> list[str]:
    return OPERATIONS["maximum"](writer, shape, kind, [*arguments, 0.0 if kind == "float" else 0])


@operation("leaky_relu")
def _leaky_relu(writer: Writer, shape: Shape, kind: str, arguments: list[Any]) -> list[str]:
    source, slope = arguments[0], arguments[1] if len(arguments) > 1 else 0.01
    lower = Value(np.array(floats(writer, "{0} * {1}", [source, slope], shape), object).reshape(shape), "float")
    return floats(writer, "max({0}, {1})", [source, lower], shape)


@operation("clamp", "clamp_min", "clamp_max")
def _clamp(writer: Writer, shape: Shape, kind: str, arguments: list[Any]) -> Any:
    source, low, high = (*arguments, None, None)[:3]
    for limit, name in ((low, "maximum"), (high, "minimum")):
        if limit is not None:
            items = OPERATIONS[name](writer, shape, kind, [source, limit])
            source = Value(np.array(items, object).reshape(shape), kind)
    return source.items


OPERATIONS["clamp_max"] = lambda w, s, k, a: _clamp(w, s, k, [a[0], None, a[1]])


@operation("pow")
def _pow(writer: Writer, shape: Shape, kind: str, arguments: list[Any]) -> list[str]:
    base, exponent = arguments
    if exponent == 2:
        return floats(writer, "{0} * {0}", [base], shape)
    if exponent == 0.5:
        return floats(writer, "sqrt({0})", [base], shape)
    return floats(writer, "pow({0}, {1})", [base, exponent], shape)


@operation("where")
def _where(writer: Writer, shape: Shape, kind: str, arguments: list[Any]) -> list[str]:
    condition, yes, no = arguments
    if kind == "float":
        yes, no = as_float(writer, yes), as_float(writer, no)
    template = writer.dialect.choose
    return [
        writer.name(
            kind,
            template.format(condition=writer.scalar(c, "bool"), yes=writer.scalar(y, kind), no=writer.scalar(n, kind)),
        )
        for c, y, n in zip(*(flattened(argument, shape) for argument in (condition, yes, no)), strict=True)
    ]


@operation("to_copy")
def _to(writer: Writer, shape: Shape, kind: str, arguments: list[Any]) -> Any:
    (source,) = arguments
    if source.kind == kind:
        return source.items
    convert = writer.dialect.types[kind]
    return [writer.name(kind, f"{convert}({writer.scalar(x, source.kind)})") for x in source.items.reshape(-1)]
