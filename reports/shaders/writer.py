"""Statements of one shader: names, vectors, rows of tables, products with constant matrices."""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from bench.errors import InputError
from reports.shaders.dialects import Dialect
from reports.shaders.tables import Tables

Array = np.ndarray

TOO_LONG = 60_000  # statements: compilers take too long beyond
SWIZZLE = "xyzw"
Weights = Literal["literal", "uniform", "texture"]  # where a shader has the weights of its matrices


@dataclass(frozen=True)
class Value:
    """One tensor of the program: scalar expressions, or numbers, (1, ...), and its kind."""

    items: Array
    kind: str


class Writer:
    """Statements of one shader. `reports.shaders.operations` writes each operation with it."""

    def __init__(self, dialect: Dialect, tables: Tables, weights: Weights):
        self.dialect, self.tables, self.weights = dialect, tables, weights
        self.lines: list[str] = []
        self.uniforms: list[Array] = []  # vectors of four weights, where a uniform buffer has them
        self.count = 0

    def name(self, kind: str, value: str) -> str:
        """The name of a new constant of the shader that holds `value`."""
        self.count += 1
        if self.count > TOO_LONG:
            raise InputError(f"its shader has more than {TOO_LONG} statements")
        name = f"t{self.count}"
        self.lines.append(self.dialect.declare.format(type=self.dialect.types[kind], name=name, value=value))
        return name

    def scalar(self, value: Any, kind: str) -> str:
        """A number or an expression as text of some kind."""
        if isinstance(value, str):
            return value
        if kind == "bool":
            return "true" if value else "false"
        return str(int(value)) if kind == "int" else literal(float(value))

    def vector(self, four: list[Any]) -> str:
        """Up to four floats as one vector: a name where they stand together already."""
        head = str(four[0]).split(".")[0]
        # The unused part of a vector may be NaN.
        if head.isidentifier() and four == [f"{head}.{c}" for c in SWIZZLE]:
            return head
        texts = [self.scalar(x, "float") for x in four]
        texts += texts[-1:] * (4 - len(texts))  # not 0, since it may be a divisor
        if len(set(texts)) == 1 and self.dialect.name != "hlsl":
            texts = texts[:1]
        return f"{self.dialect.types['vec4']}({', '.join(texts)})"

    def floats(self, flat: list[str]) -> list[str]:
        """Vector expressions, four floats each, as named scalars."""
        names = [self.name("vec4", text) for text in flat]
        return [f"{name}.{c}" for name in names for c in SWIZZLE]

    def row(self, table: Array, index: str, exact: bool = False) -> list[str]:
        """The scalars of one row of a table (rows, channels), looked up by an int expression."""
        reader, start, stride = self.tables.place(table, exact)
        channels = table.shape[1]
        first = self.name("int", f"{index} * {stride} + {start}" if stride > 1 else f"{index} + {start}")
        packs = [f"{reader}({first} + {k})" if k else f"{reader}({first})" for k in range(stride)]
        return [self.name("float", packs[0])] if channels == 1 else self.floats(packs)[:channels]

    def product(self, weights: Array, inputs: list[Any], bias: list[Any] | None) -> list[str]:
        """weights (outputs, inputs) @ inputs + bias, as scalars; the weights are constants."""
        outputs, count = weights.shape
        padded = np.zeros((-(-outputs // 4) * 4, -(-count // 4) * 4), np.float32)
        padded[:outputs, :count] = weights
        packs = [self.vector(inputs[i : i + 4]) for i in range(0, count, 4)]
        # A vector that is written out would be written again for each block of outputs.
        packs = [text if text.isidentifier() else self.name("vec4", text) for text in packs]
        added = ["0.0"] * len(padded) if bias is None else [*bias, *[0.0] * (len(padded) - outputs)]
        starts = [self.vector(added[j : j + 4]) for j in range(0, len(padded), 4)]
        write = self._in_a_loop if self.weights == "texture" else self._line_by_line
        written = write(padded, packs, starts)
        return self.floats(written)[:outputs]

    def _line_by_line(self, weights: Array, packs: list[str], starts: list[str]) -> list[str]:
        """The product as straight-line code, the weights in its text or by their numbers in the uniform buffer."""
        results = []
        for j, start in enumerate(starts):
            terms = [start]
            for i, pack in enumerate(packs):
                block = weights[4 * j : 4 * j + 4, 4 * i : 4 * i + 4].T  # four columns of the matrix
                texts = [self._column(column) for column in block]
                terms.append(self.dialect.matrix.format(columns=", ".join(texts), vector=pack))
            results.append(" + ".join(terms))
        return results

    def _column(self, column: Array) -> str:
        if self.weights == "literal":
            return f"{self.dialect.types['vec4']}({', '.join(map(literal, column))})"
        self.uniforms.append(column)
        return f"weights[{len(self.uniforms) - 1}]"

    def _in_a_loop(self, weights: Array, packs: list[str], starts: list[str]) -> list[str]:
        """The product as two loops over weights in the texture: slower, but the text stays short."""
        # Row by row of blocks: the four columns of block (j, i) are rows 4 · (j · inputs + i) and on of the table.
        blocks = weights.reshape(len(starts), 4, len(packs), 4).transpose(0, 2, 3, 1).reshape(-1, 4)
        reader, first, _ = self.tables.place(np.ascontiguousarray(blocks), exact=True)
        self.count += 1
        name = f"t{self.count}"
        columns = ", ".join(f"{reader}(row + {k})" if k else f"{reader}(row)" for k in range(4))
        product = self.dialect.matrix.format(columns=columns, vector=f"{name}in[i]")
        self.lines += self.dialect.loops.format(
            vec4=self.dialect.types["vec4"], name=name, first=first, product=product, inputs=len(packs),
            outputs=len(starts), given=", ".join(packs), starts=", ".join(starts),
        ).splitlines()  # fmt: skip
        return [f"{name}out[{j}]" for j in range(len(starts))]


def literal(value: float) -> str:
    """A float32 as the shortest text that is a float in every dialect."""
    text = np.format_float_positional(np.float32(value), trim="0") if 1e-4 <= abs(value) < 1e7 or value == 0 else None
    return text or np.format_float_scientific(np.float32(value), trim="0")
