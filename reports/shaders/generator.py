"""Writes the shader of a program: straight-line code in packs of four floats.

Each tensor of one query is an array of scalar expressions. NumPy performs the operations that only move numbers (view,
cat, slice, transpose, broadcast); arithmetic is written out, four floats a statement. Constants that are looked up by
number become rows of a texture. Matrices become literals, which compile and run fastest; beyond `LITERALS` weights
in all they are read from the texture. For compilers that choke on literals there is a uniform buffer.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.errors import InputError
from reports.shaders.dialects import Dialect
from reports.shaders.operations import OPERATIONS
from reports.shaders.program import Program
from reports.shaders.tables import WIDTH, Tables
from reports.shaders.writer import Value, Weights, Writer

Array = np.ndarray

LITERALS = 10_000  # weights in a shader's text
UNIFORMS = 1_024  # vectors of a uniform buffer: 16 kB, which every machine has


@dataclass(frozen=True)
class Shader:
    """The text of a function `material` and the two textures it reads, (h, WIDTH, 4): float32 and float16.

    `uniforms` (n, 4) float32 are the weights of its uniform buffer, where it has one.
    """

    text: str
    exact: Array
    half: Array
    uniforms: Array


def shader(program: Program, dialect: Dialect, weights: Weights | None = None) -> Shader:
    """The shader of a program; by default its weights are literals, or in a texture where there are many.

    `InputError` where it uses what no shader can do, is too long, or has too many weights for a uniform buffer.
    """
    tables = Tables()
    writer = Writer(dialect, tables, weights or ("literal" if _weights(program) <= LITERALS else "texture"))
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
    if len(writer.uniforms) > UNIFORMS:
        raise InputError(f"its weights take more than {16 * UNIFORMS:,} bytes of a uniform buffer")
    buffer = dialect.uniforms.format(count=len(writer.uniforms)) if writer.uniforms else ""
    text = dialect.prologue.format(width=WIDTH) + buffer + dialect.signature + " {\n  " + "\n  ".join(body) + "\n}\n"
    for ours, theirs in dialect.calls.items():
        text = text.replace(f"{ours}(", f"{theirs}(")
    uniforms = np.array(writer.uniforms, np.float32).reshape(-1, 4)
    return Shader(text, tables.texture(half=False), tables.texture(half=True), uniforms)


def fallback(program: Program, dialect: Dialect) -> Shader | None:
    """The same shader with its weights in a uniform buffer, or else in the texture; None where they are there."""
    if not 0 < _weights(program) <= LITERALS:
        return None
    try:
        return shader(program, dialect, "uniform")
    except InputError:
        return shader(program, dialect, "texture")


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
