"""A program as statements of one shader: names, vectors, rows of tables, products with constant matrices.

The constants that a shader looks up by number are rows of four floats in two textures.
"""

import hashlib
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from bench.inputs.errors import InputError
from bench.program.backend import Array, Backend, Rows, Scalar, as_array, listed
from bench.program.operations import KINDS, OPERATIONS
from reports.shaders.dialects import Dialect

TOO_LONG = 60_000  # with more statements, compilers take too long
SWIZZLE = "xyzw"
WeightStore = Literal["literal", "uniform", "texture"]  # the place of a shader's weights
WIDTH = 1024  # texels a row of both textures; WebGL 2 guarantees 2,048 rows, most GPUs allow 16,384
HALF_FROM = 4_096  # tables with at least this many floats are stored in halves
HALF_MOST = 6e4


@dataclass
class Tables:
    """Two textures that grow: `exact`, RGBA32F, for places and small tables; `half`, RGBA16F, for large ones."""

    exact: list[Array] = field(default_factory=list)
    half: list[Array] = field(default_factory=list)
    _placed: dict[tuple[bytes, tuple[int, ...], bool], tuple[str, int]] = field(default_factory=dict)

    def place(self, table: Array, exact: bool = False) -> tuple[str, int, int]:
        """Store a table (rows, channels). Returns the function that reads it, the number that this function takes for
        the first row, and how many numbers a row takes.

        `exactRow` and `halfRow` read four floats. `exactOne` reads one float of a table with one channel, which stores
        four rows in a texel; such tables hold positions such as heights, which need more precision than halves. An
        equal table is stored once.
        """
        rows, channels = table.shape
        single = channels == 1
        stride = math.ceil(channels / 4)
        needs_floats = exact or single or table.dtype.kind != "f"
        small = needs_floats or table.size < HALF_FROM or np.abs(table).max() > HALF_MOST
        key = (hashlib.sha256(table.tobytes()).digest(), table.shape, small)
        blocks = self.exact if small else self.half
        if key not in self._placed:
            start = sum(map(len, blocks))  # texels so far
            if single:
                padded = np.zeros((math.ceil(rows / 4) * 4, 1), np.float32)
                place = "exactOne", 4 * start
            else:
                padded = np.zeros((rows, 4 * stride), np.float32)
                place = "exactRow" if small else "halfRow", start
            padded[:rows, :channels] = table
            blocks.append(padded.reshape(-1, 4))
            self._placed[key] = place
        return (*self._placed[key], stride)

    def texture(self, half: bool) -> Array:
        """One of the textures, (height, WIDTH, 4), with at least one row."""
        blocks = self.half if half else self.exact
        values = np.concatenate([np.zeros((0, 4), np.float32), *blocks])
        height = max(1, math.ceil(len(values) / WIDTH))
        padded = np.zeros((height * WIDTH, 4), np.float16 if half else np.float32)
        padded[: len(values)] = values
        return padded.reshape(height, WIDTH, 4)


class Writer(Backend):
    """Statements of one shader. A scalar is a number or an expression."""

    what = "shader"
    operations = OPERATIONS

    def __init__(self, dialect: Dialect, tables: Tables, weights: WeightStore):
        self.dialect = dialect
        self.tables = tables
        self.weights = weights
        self.lines: list[str] = []
        self.uniforms: list[Array] = []  # vectors of four weights for a uniform buffer
        self.count = 0

    def name(self, kind: str, value: str) -> str:
        """The name of a new constant of the shader that holds `value`."""
        self.count += 1
        if self.count > TOO_LONG:
            raise InputError(f"its shader has more than {TOO_LONG} statements")
        name = f"t{self.count}"
        self.lines.append(self.dialect.declare.format(type=self.dialect.type(kind), name=name, value=value))
        return name

    def scalar(self, value: Any, kind: str) -> str:
        """A number or an expression as text of some kind."""
        if isinstance(value, str):
            return value
        if kind == "bool":
            return "true" if value else "false"
        return str(int(value)) if kind == "int" else literal(float(value))

    def vector(self, four: list[Any]) -> str:
        """Up to four floats as one vector; its name if they already form one, as `t7.x`, `t7.y`, `t7.z`, `t7.w` do."""
        head = str(four[0]).split(".")[0]
        # Fewer than all four of its floats do not stand for a vector: the others may be NaN.
        if head.isidentifier() and four == [f"{head}.{c}" for c in SWIZZLE]:
            return head
        texts = [self.scalar(x, "float") for x in four]
        texts += texts[-1:] * (4 - len(texts))  # repeat the last float: 0 would not do, because it may be a divisor
        if len(set(texts)) == 1 and self.dialect.name != "hlsl":  # one float makes a vector of four equal ones
            texts = texts[:1]
        return f"{self.dialect.vec4}({', '.join(texts)})"

    def floats(self, vectors: list[str]) -> list[str]:
        """Name vectors, given as expressions of four floats each, and return the names of all their floats in order."""
        scalars = []
        for text in vectors:
            name = self.name("vec4", text)
            scalars += [f"{name}.{c}" for c in SWIZZLE]
        return scalars

    def each(self, formula: str, arguments: Rows, from_kind: str, kind: str) -> list[str]:
        """Compute floats four at once, if there are several."""
        count = len(arguments[0])
        if from_kind == kind == "float" and count > 1:
            packs = []
            for start in range(0, count, 4):
                vectors = [self.vector(argument[start : start + 4]) for argument in arguments]
                packs.append(formula.format(*vectors))
            return self.floats(packs)[:count]
        names = []
        for element in zip(*arguments, strict=True):
            scalars = [self.scalar(x, from_kind) for x in element]
            names.append(self.name(kind, formula.format(*scalars)))
        return names

    def as_kind(self, scalar: Scalar, from_kind: str, kind: str) -> Any:
        if isinstance(scalar, str):
            return f"{self.dialect.type(kind)}({scalar})"
        return KINDS[kind](scalar)

    def convert(self, scalar: Scalar, from_kind: str, kind: str) -> str:
        return self.name(kind, f"{self.dialect.type(kind)}({self.scalar(scalar, from_kind)})")

    def choose(self, condition: Scalar, yes: Scalar, no: Scalar, kind: str) -> str:
        text = self.dialect.choose
        yes, no = self.scalar(yes, kind), self.scalar(no, kind)
        return self.name(kind, text.format(condition=self.scalar(condition, "bool"), yes=yes, no=no))

    def total(self, row: list[Scalar], formula: str) -> str:
        """The sum of a row, put into a formula. Four floats that form a vector are added by a dot product with ones."""
        ones = f"{self.dialect.vec4}(1.0)" if self.dialect.name != "hlsl" else "float4(1.0, 1.0, 1.0, 1.0)"
        terms = []
        in_fours = len(row) - len(row) % 4
        for i in range(0, in_fours, 4):
            four = row[i : i + 4]
            text = self.vector(four)
            if text.isidentifier():
                terms.append(f"dot({text}, {ones})")
            else:
                terms += [self._float(x) for x in four]
        terms += [self._float(x) for x in row[in_fours:]]
        return self.name("float", formula.format(" + ".join(terms or ["0.0"])))

    def lengths(self, items: Array, rows: Callable[[Array], Rows]) -> list[str]:
        """Roots of the sums of squares of rows, the squares computed four at once."""
        squares = self.each("{0} * {0}", [listed(items)], "float", "float")
        return [self.total(row, "sqrt({0})") for row in rows(as_array(squares).reshape(items.shape))]

    def product(self, left: Array, right: Array, bias: list[Scalar] | None) -> list[str]:
        """left (n, k) @ right (k, m) + bias (m,), or for each of several such pairs, as scalars.

        One row times a constant matrix is computed by blocks of four, anything else number by number.
        """
        if left.ndim == 2:
            if len(left) != 1:
                raise self.cannot("multiply these matrices")
            if right.dtype != object:  # a matrix of numbers, not of expressions
                return self._weighted(right.T, listed(left), bias)
            left, right = left[None], right[None]
        totals = []
        for rows, matrix in zip(left, right, strict=True):
            for row in rows:
                for column in matrix.T:
                    terms = [f"{self._float(a)} * {self._float(b)}" for a, b in zip(row, column, strict=True)]
                    totals.append(self.name("float", " + ".join(terms) or "0.0"))
        if bias is None:
            return totals
        return [self.name("float", f"{a} + {self._float(b)}") for a, b in zip(totals, bias, strict=True)]

    def _float(self, value: Scalar) -> str:
        return self.scalar(value, "float")

    def look_up(self, table: Array, index: Scalar, kind: str) -> list[str]:
        """The channels of one row of a table in a texture; converted, because textures hold floats alone."""
        channels = table.shape[1]
        if channels == 0:  # such as the scores of a constant material, which has no component
            return []
        reader, start, stride = self.tables.place(table)
        first = self.name("int", f"{index} * {stride} + {start}" if stride > 1 else f"{index} + {start}")
        packs = [f"{reader}({first})", *(f"{reader}({first} + {k})" for k in range(1, stride))]
        scalars = self._channels(packs, channels)
        if kind == "float":
            return scalars
        return [self.convert(x, "float", kind) for x in scalars]

    def _channels(self, packs: list[str], count: int) -> list[str]:
        """The channels of a row, read four at a time, or alone if it has but one."""
        if count == 1:
            return [self.name("float", packs[0])]
        return self.floats(packs)[:count]

    def blend(self, table: Array, indices: list[Scalar], shares: list[Scalar]) -> list[str]:
        """The channels of the sum of share · table[index] over all indices, each with its share."""
        channels = table.shape[1]
        if channels == 0:
            return []
        reader, start, stride = self.tables.place(table)
        firsts = [self.name("int", f"{self.scalar(i, 'int')} * {stride} + {start}") for i in indices]
        sums = []  # of each of the `stride` vectors of a row
        for k in range(stride):
            rows = zip(shares, firsts, strict=True)
            terms = [f"{self._float(share)} * {reader}({first} + {k})" for share, first in rows]
            sums.append(" + ".join(terms))
        return self._channels(sums, channels)

    def _weighted(self, weights: Array, inputs: list[Scalar], bias: list[Scalar] | None) -> list[str]:
        """weights (outputs, inputs) @ inputs + bias, as scalars; the weights are constants."""
        outputs, count = weights.shape
        padded = np.zeros((math.ceil(outputs / 4) * 4, math.ceil(count / 4) * 4), np.float32)
        padded[:outputs, :count] = weights
        packs = []
        for i in range(0, count, 4):
            text = self.vector(inputs[i : i + 4])
            # Name the vectors; otherwise each block of outputs would write them again.
            packs.append(text if text.isidentifier() else self.name("vec4", text))
        added: list[Scalar] = ["0.0"] * len(padded)
        if bias is not None:
            added = [*bias, *[0.0] * (len(padded) - outputs)]
        starts = [self.vector(added[j : j + 4]) for j in range(0, len(padded), 4)]
        write = self._in_a_loop if self.weights == "texture" else self._line_by_line
        written = write(padded, packs, starts)
        return self.floats(written)[:outputs]

    def _line_by_line(self, weights: Array, packs: list[str], starts: list[str]) -> list[str]:
        """The product as straight-line code, the weights in its text or read from the uniform buffer.

        `weights` is (4 · outputs, 4 · inputs), `packs` are the inputs as vectors of four, `starts` what is added to the
        outputs. Returns the outputs as vectors of four.
        """
        results = []
        for j, start in enumerate(starts):
            terms = [start]
            for i, pack in enumerate(packs):
                block = weights[4 * j : 4 * j + 4, 4 * i : 4 * i + 4].T  # four columns of the matrix
                if self.weights == "uniform":
                    texts = [f"weights[{len(self.uniforms) + k}]" for k in range(4)]
                    self.uniforms += list(block)
                else:
                    texts = [f"{self.dialect.vec4}({', '.join(map(literal, column))})" for column in block]
                terms.append(self.dialect.matrix.format(columns=", ".join(texts), vector=pack))
            results.append(" + ".join(terms))
        return results

    def _in_a_loop(self, weights: Array, packs: list[str], starts: list[str]) -> list[str]:
        """As `_line_by_line`, as two loops over weights in the texture: slower, but the text stays short."""
        # Row by row of blocks: the four columns of block (j, i) are rows 4 · (j · inputs + i) and on of the table.
        blocks = weights.reshape(len(starts), 4, len(packs), 4).transpose(0, 2, 3, 1).reshape(-1, 4)
        reader, first, _ = self.tables.place(np.ascontiguousarray(blocks), exact=True)
        self.count += 1
        name = f"t{self.count}"
        columns = ", ".join([f"{reader}(row)", *(f"{reader}(row + {k})" for k in range(1, 4))])
        product = self.dialect.matrix.format(columns=columns, vector=f"{name}in[i]")
        self.lines += self.dialect.loops(name, first, product, packs, starts)
        return [f"{name}out[{j}]" for j in range(len(starts))]


def literal(value: float) -> str:
    """A float32 as the shortest text that is a float in every dialect."""
    if value == 0 or 1e-4 <= abs(value) < 1e7:
        return np.format_float_positional(np.float32(value), trim="0")
    return np.format_float_scientific(np.float32(value), trim="0")
