"""Writes the shader of a program: straight-line code in packs of four floats.

Each tensor of one query is an array of scalar expressions. NumPy performs the operations that only move numbers (view,
cat, slice, transpose, broadcast); arithmetic is written out, four floats a statement. Constants that are looked up by
number become rows of a texture. Matrices become literals, which compile and run fastest; beyond `LITERALS` weights
in all they are read from the texture.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.errors import InputError
from reports.shaders.dialects import Dialect
from reports.shaders.operations import OPERATIONS
from reports.shaders.program import Program
from reports.shaders.tables import WIDTH, Tables
from reports.shaders.writer import Value, Writer

Array = np.ndarray

LITERALS = 10_000  # weights in a shader's text


@dataclass(frozen=True)
class Shader:
    """The text of a function `material` and the two textures it reads, (h, WIDTH, 4): float32 and float16."""

    text: str
    exact: Array
    half: Array


def shader(program: Program, dialect: Dialect) -> Shader:
    """The shader of a program. `InputError` where it uses what no shader can do, or is too long."""
    tables = Tables()
    writer = Writer(dialect, tables, _weights(program) <= LITERALS)
    values = {
        name: Value(array, "float" if array.dtype.kind == "f" else "int") for name, array in program.constants.items()
    }
    for name, axes in (("uv", "xy"), ("wo", "xyz"), ("wi", "xyz")):
        values[name] = Value(np.array([[f"{name}.{c}" for c in axes]], object), "float")
    values["footprint"] = Value(np.array(["footprint"], object), "float")
    for step in program.steps:
        operation = OPERATIONS.get(step["operation"])
        if operation is None:
            raise InputError(f"no shader can do {step['operation']!r} yet")
        arguments = [_resolved(each, values) for each in step["arguments"]]
        items = operation(writer, tuple(step["shape"]), step["kind"], arguments)
        values[step["name"]] = Value(np.asarray(items, object).reshape(step["shape"]), step["kind"])
    rgb = [writer.scalar(x, "float") for x in values[program.result].items.reshape(-1)]
    three = dialect.types["vec4"].replace("4", "3")
    body = [*writer.lines, f"return {three}({', '.join(rgb)});"]
    text = dialect.prologue.format(width=WIDTH) + dialect.signature + " {\n  " + "\n  ".join(body) + "\n}\n"
    for ours, theirs in dialect.calls.items():
        text = text.replace(f"{ours}(", f"{theirs}(")
    return Shader(text, tables.texture(half=False), tables.texture(half=True))


def _resolved(argument: Any, values: dict[str, Value]) -> Any:
    if isinstance(argument, dict):
        return values[argument["of"]]
    return [_resolved(each, values) for each in argument] if isinstance(argument, list) else argument


def _weights(program: Program) -> int:
    """Floats of the matrices that a program multiplies by."""
    count = 0
    for step in program.steps:
        if step["operation"] in ("addmm", "mm", "linear"):
            names = [a["of"] for a in step["arguments"] if isinstance(a, dict)]
            count += sum(program.constants[name].size for name in names if name in program.constants)
    return count
