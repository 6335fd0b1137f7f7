"""Writes the shader of a program: straight-line code in packs of four floats.

Each tensor of one query is an array of scalar expressions. NumPy performs the operations that only move numbers (view,
cat, slice, transpose, broadcast); arithmetic is written out, four floats a statement. Constants that are looked up by
number become rows of a texture. Matrices become literals, which compile and run fastest; with more than `LITERALS`
weights in all they are read from the texture. For compilers that cannot handle literals there is a uniform buffer.

A *query* is the place uv, the directions wo and wi and the footprint of one answer. A *scalar* is a number, or a text
that the shader computes. The *weights* are the floats of the constant matrices by which a program multiplies.
"""

from dataclasses import dataclass

import numpy as np

from bench.inputs.errors import InputError
from bench.program import Program
from reports.shaders.cooperative import BUFFER, CooperativeWriter
from reports.shaders.dialects import SLANG, Dialect
from reports.shaders.writer import WIDTH, Tables, WeightStore, Writer, literal

Array = np.ndarray

LITERALS = 10_000  # the most weights that a shader's text holds
UNIFORMS = 1_024  # vectors of a uniform buffer: 16 kB, which WebGL 2 guarantees
LEAST = 1e-12  # footprint, far below a texel: a level of detail is a logarithm, which 0 does not have


@dataclass(frozen=True)
class Shader:
    """The function `material` of a program, and the numbers that it reads."""

    text: str  # of the function, and of what it declares
    exact: Array  # a texture (h, WIDTH, 4), float32
    half: Array  # a texture (h, WIDTH, 4), float16
    uniforms: Array  # weights (n, 4), float32, of the uniform buffer; n is 0 without one
    layers: Array  # float16, the buffer of a Slang shader's layers; empty without layers

    @property
    def gpu_bytes(self) -> int:
        """The bytes of both textures, and of the buffer of layers, on a GPU."""
        return self.exact.nbytes + self.half.nbytes + self.layers.nbytes


def shader(program: Program, dialect: Dialect, weights: WeightStore | None = None) -> Shader:
    """The shader of a program; by default its weights are literals, or in a texture if there are many.

    `InputError` for an operation that no shader can do, too long a text, or too many weights for a uniform buffer.
    """
    tables = Tables()
    if weights is None:
        weights = "literal" if _weight_count(program) <= LITERALS else "texture"
    writer_class = CooperativeWriter if dialect is SLANG else Writer
    writer = writer_class(dialect, tables, weights)
    writer.check(program)
    inputs = {
        "uv": ["uv.x", "uv.y"],
        "wo": ["wo.x", "wo.y", "wo.z"],
        "wi": ["wi.x", "wi.y", "wi.z"],
        "footprint": ["footprint"],
    }
    # Only a program that uses the footprint gets a statement for it.
    if any("footprint" in step.names() for step in program.steps):
        inputs["footprint"] = [writer.name("float", f"max(footprint, {literal(LEAST)})")]
    rgb = [writer.scalar(x, "float") for x in writer.run(program, inputs)]
    three = dialect.vec4.replace("4", "3")  # the name of a vector of three
    body = [*writer.lines, f"return {three}({', '.join(rgb)});"]
    if len(writer.uniforms) > UNIFORMS:
        raise InputError(f"its weights need more than {16 * UNIFORMS:,} bytes of a uniform buffer")
    buffer = dialect.uniforms.format(count=len(writer.uniforms)) if writer.uniforms else ""
    if writer.layers:
        buffer += BUFFER
    statements = "\n  ".join(body)
    text = f"{dialect.prologue.format(width=WIDTH)}{buffer}{dialect.signature} {{\n  {statements}\n}}\n"
    for name_in_glsl, name in dialect.calls.items():
        text = text.replace(f"{name_in_glsl}(", f"{name}(")
    uniforms = np.array(writer.uniforms, np.float32).reshape(-1, 4)
    layers = np.concatenate([np.zeros(0, np.float16), *writer.layers])
    return Shader(text, tables.texture(half=False), tables.texture(half=True), uniforms, layers)


def fallback(program: Program, dialect: Dialect) -> Shader | None:
    """The shader for compilers that cannot handle literals: with its weights in a uniform buffer or, if they are too
    many for that, in the texture. None if the usual shader has no weights as literals."""
    if not 0 < _weight_count(program) <= LITERALS:
        return None
    try:
        return shader(program, dialect, "uniform")
    except InputError:  # too many weights for the buffer
        return shader(program, dialect, "texture")


def _weight_count(program: Program) -> int:
    """How many floats the constant matrices and biases of a program's matrix products have."""
    count = 0
    for step in program.steps:
        if step.operation in ("addmm", "mm"):  # a matrix product, with a bias and without one
            count += sum(program.constants[name].size for name in step.names() if name in program.constants)
    return count
