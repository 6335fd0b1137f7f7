"""A program as statements of one shader: names, vectors, rows of tables, products with constant matrices.

The constants that a shader looks up by number are rows of four floats in two textures.

A *scalar* is a number, or the text of an expression of the shader that has one value, such as `t7.x`; a *kind* is
"float", "int" or "bool". A *pack* is the text of an expression of four floats. A *table* is a constant (rows, channels)
of which a query reads some rows. A *formula* is GLSL with arguments {0}, {1}, …. The *weights* are the constant
matrices by which a program multiplies.
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
SWIZZLE = "xyzw"  # the names of a vector's four floats
# The place of a shader's weights: its text, the uniform buffer, or the texture `exact`.
WeightStore = Literal["literal", "uniform", "texture"]
WIDTH = 1024  # texels a row of both textures; WebGL 2 guarantees 2,048 rows, most GPUs allow 16,384
HALF_FROM = 4_096  # tables with at least this many floats are stored in halves
HALF_MOST = 6e4  # tables with larger numbers are not stored in halves, which end at 65,504


@dataclass
class Tables:
    """Two textures that grow: `exact`, RGBA32F, for places and small tables; `half`, RGBA16F, for large ones."""

    exact: list[Array] = field(default_factory=list)  # blocks (texels, 4), float32, in order
    half: list[Array] = field(default_factory=list)  # the same, rounded only in `texture`
    # By hash, shape, and whether it is in `exact`: the function that reads a table, and the number of its first row.
    _placed: dict[tuple[bytes, tuple[int, ...], bool], tuple[str, int]] = field(default_factory=dict)

    def place(self, table: Array, exact: bool = False) -> tuple[str, int, int]:
        """Store a table (rows, channels). Returns the function that reads it, the number that this function takes for
        the first row, and how many numbers a row takes.

        `exactRow` and `halfRow` read four floats. `exactOne` reads one float of a table with one channel, which stores
        four rows in a texel; such tables hold positions such as heights, which need more precision than halves. An
        equal table is stored once. With `exact` it is not stored in halves, whatever its size.
        """
        rows, channels = table.shape
        single = channels == 1
        needs_floats = exact or single or table.dtype.kind != "f"
        in_floats = needs_floats or table.size < HALF_FROM or np.abs(table).max() > HALF_MOST
        blocks = self.exact if in_floats else self.half
        texels_of_row = math.ceil(channels / 4)
        table = table.astype(np.float32)  # before the hash: whole numbers may have the bytes of other floats
        key = (hashlib.sha256(table.tobytes()).digest(), table.shape, in_floats)
        if key not in self._placed:
            texels_so_far = sum(map(len, blocks))
            # Zeros fill the last texel, of the whole column or of each row.
            if single:
                padded = np.zeros((math.ceil(rows / 4) * 4, 1), np.float32)
                place = "exactOne", 4 * texels_so_far  # it counts floats, four of them a texel
            else:
                padded = np.zeros((rows, 4 * texels_of_row), np.float32)
                place = "exactRow" if in_floats else "halfRow", texels_so_far
            padded[:rows, :channels] = table
            blocks.append(padded.reshape(-1, 4))
            self._placed[key] = place
        function, first = self._placed[key]
        numbers_of_row = 1 if single else texels_of_row
        return function, first, numbers_of_row

    def texture(self, half: bool) -> Array:
        """One of the textures, (height, WIDTH, 4), with at least one row."""
        blocks = self.half if half else self.exact
        values = np.concatenate([np.zeros((0, 4), np.float32), *blocks])  # of no block, too
        height = max(1, math.ceil(len(values) / WIDTH))
        padded = np.zeros((height * WIDTH, 4), np.float16 if half else np.float32)
        padded[: len(values)] = values
        return padded.reshape(height, WIDTH, 4)


class Writer(Backend):
    """Statements of one shader, to which each operation of a program adds some."""

    what = "shader"
    operations = OPERATIONS

    def __init__(self, dialect: Dialect, tables: Tables, weights: WeightStore):
        """Start without statements; tables that are looked up are put into `tables`, which grow."""
        self.dialect = dialect
        self.tables = tables
        self.weights = weights
        self.lines: list[str] = []  # the statements so far
        self.uniforms: list[Array] = []  # vectors of four weights for a uniform buffer
        self.layers: list[Array] = []  # halves of a buffer of layers, which only `CooperativeWriter` makes
        self.count = 0  # names given so far: t1, t2, …

    def name(self, kind: str, value: str) -> str:
        """The name of a new constant of the shader that holds `value`, an expression; adds the statement.

        `kind` is that of a scalar, or "vec4".
        """
        return self.declare(self.dialect.type(kind), value)

    def declare(self, type_name: str, value: str) -> str:
        """Declare a new constant of a type, in the dialect's own words, that holds `value`; returns its name.

        `InputError` after `TOO_LONG` names.
        """
        self.count += 1
        if self.count > TOO_LONG:
            raise InputError(f"its shader has more than {TOO_LONG} statements")
        name = f"t{self.count}"
        self.lines.append(self.dialect.declare.format(type=type_name, name=name, value=value))
        return name

    def scalar(self, value: Any, kind: str) -> str:
        """A number or an expression as text; a number is written as one of this kind."""
        if isinstance(value, str):  # an expression has its kind already
            return value
        if kind == "bool":
            return "true" if value else "false"
        return str(int(value)) if kind == "int" else literal(float(value))

    def vector(self, four: list[Any]) -> str:
        """Up to four floats, numbers or names, as one vector; missing ones are as the last.

        `t7.x`, `t7.y`, `t7.z`, `t7.w` already form a vector, and give its name, `t7`.
        """
        # Fewer than all four of its floats do not stand for a vector: the others may be NaN.
        before_dot = str(four[0]).split(".")[0]  # `t7` of `t7.x`; no name if the first float is a number
        is_name = before_dot.isidentifier()
        if is_name and four == [f"{before_dot}.{c}" for c in SWIZZLE]:
            return before_dot
        texts = [self.scalar(x, "float") for x in four]
        while len(texts) < 4:
            texts.append(texts[-1])  # not 0, because it may be a divisor
        all_equal = len(set(texts)) == 1
        if all_equal and self.dialect.name != "hlsl":  # elsewhere one float makes a vector of four equal ones
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
        """The names of the results, see `Backend.each`. Floats are computed four at once, if there are several."""
        count = len(arguments[0])
        # GLSL's formulas of floats hold for vectors of floats, too.
        if from_kind == kind == "float" and count > 1:
            packs = []
            for start in range(0, count, 4):
                vectors = [self.vector(argument[start : start + 4]) for argument in arguments]
                packs.append(formula.format(*vectors))
            return self.floats(packs)[:count]
        names = []
        for element in zip(*arguments, strict=True):  # one of each argument
            scalars = [self.scalar(x, from_kind) for x in element]
            names.append(self.name(kind, formula.format(*scalars)))
        return names

    def as_kind(self, scalar: Scalar, from_kind: str, kind: str) -> Any:
        """A scalar as an argument of another kind: an expression converted in place, a number by Python."""
        if isinstance(scalar, str):
            return f"{self.dialect.type(kind)}({scalar})"
        return KINDS[kind](scalar)

    def convert(self, scalar: Scalar, from_kind: str, kind: str) -> str:
        """The name of a scalar that was converted to another kind."""
        return self.name(kind, f"{self.dialect.type(kind)}({self.scalar(scalar, from_kind)})")

    def choose(self, condition: Scalar, yes: Scalar, no: Scalar, kind: str) -> str:
        """The name of what holds `yes` where the condition holds, else `no`, all of one kind."""
        texts = {
            "condition": self.scalar(condition, "bool"),
            "yes": self.scalar(yes, kind),
            "no": self.scalar(no, kind),
        }
        return self.name(kind, self.dialect.choose.format(**texts))

    def total(self, row: list[Scalar], formula: str) -> str:
        """The sum of a row of floats, put into a formula as {0}. Four floats that form a vector are added by a dot
        product with ones."""
        ones = self.vector([1.0] * 4)
        terms = []
        in_fours = len(row) - len(row) % 4
        for i in range(0, in_fours, 4):
            four = row[i : i + 4]
            text = self.vector(four)
            if text.isidentifier():  # the four form a vector that has a name
                terms.append(f"dot({text}, {ones})")
            else:
                terms += [self._float(x) for x in four]
        terms += [self._float(x) for x in row[in_fours:]]
        return self.name("float", formula.format(" + ".join(terms or ["0.0"])))

    def lengths(self, items: Array, rows: Callable[[Array], Rows]) -> list[str]:
        """Roots of the sums of squares of rows, the squares computed four at once; `rows` divides an array of the shape
        of `items` into rows."""
        squares = self.each("{0} * {0}", [listed(items)], "float", "float")
        return [self.total(row, "sqrt({0})") for row in rows(as_array(squares).reshape(items.shape))]

    def product(self, left: Array, right: Array, bias: list[Scalar] | None) -> list[str]:
        """left (n, k) @ right (k, m) + bias, or for each of several such pairs (batch, …), as scalars row by row.

        The bias has a float for each element. One row times a constant matrix is computed by blocks of four, anything
        else number by number. `InputError` for a single pair with n > 1.
        """
        if left.ndim == 2:
            if len(left) != 1:
                raise self.cannot("multiply these matrices")
            if right.dtype != object:  # a matrix of numbers, not of expressions
                return self.weighted(right.T, listed(left), bias)
            left, right = left[None], right[None]  # a batch of one
        totals = []
        for rows, matrix in zip(left, right, strict=True):
            for row in rows:
                for column in matrix.T:
                    terms = [f"{self._float(a)} * {self._float(b)}" for a, b in zip(row, column, strict=True)]
                    total = " + ".join(terms) if terms else "0.0"
                    totals.append(self.name("float", total))
        if bias is None:
            return totals
        return [self.name("float", f"{a} + {self._float(b)}") for a, b in zip(totals, bias, strict=True)]

    def _float(self, value: Scalar) -> str:
        """A number or an expression as the text of a float."""
        return self.scalar(value, "float")

    def look_up(self, table: Array, index: Scalar, kind: str) -> list[str]:
        """The channels of one row of a table, which is put into a texture; converted to `kind`, because textures hold
        floats alone. `index` is an expression."""
        channels = table.shape[1]
        if channels == 0:  # such as the scores of a constant material, which has no component
            return []
        reader, start, stride = self.tables.place(table)
        row = f"{index} * {stride}" if stride > 1 else index
        first = self.name("int", f"{row} + {start}")
        packs = [f"{reader}({first})", *(f"{reader}({first} + {k})" for k in range(1, stride))]
        scalars = self._channels(packs, channels)
        if kind == "float":
            return scalars
        return [self.convert(x, "float", kind) for x in scalars]

    def _channels(self, packs: list[str], count: int) -> list[str]:
        """The names of the first `count` channels of a row, given as expressions of four each, or of one if it has but
        one channel, which `exactOne` reads."""
        if count == 1:
            return [self.name("float", packs[0])]
        return self.floats(packs)[:count]

    def blend(self, table: Array, indices: list[Scalar], shares: list[Scalar]) -> list[str]:
        """The channels of the sum of share · table[index] over all indices, each with its share."""
        channels = table.shape[1]
        if channels == 0:  # as in `look_up`
            return []
        reader, start, stride = self.tables.place(table)
        firsts = [self.name("int", f"{self.scalar(i, 'int')} * {stride} + {start}") for i in indices]
        sums = []  # of each of the `stride` vectors of a row
        for k in range(stride):
            rows = zip(shares, firsts, strict=True)
            terms = [f"{self._float(share)} * {reader}({first} + {k})" for share, first in rows]
            sums.append(" + ".join(terms))
        return self._channels(sums, channels)

    def weighted(self, weights: Array, inputs: list[Scalar], bias: list[Scalar] | None) -> list[str]:
        """weights (outputs, inputs) @ inputs + bias (outputs,), as scalars; the weights are constants.

        It is computed by blocks of 4 × 4 weights, with zeros beyond the edges.
        """
        outputs, count = weights.shape
        padded = np.zeros((math.ceil(outputs / 4) * 4, math.ceil(count / 4) * 4), np.float32)
        padded[:outputs, :count] = weights
        packs = []
        for i in range(0, count, 4):
            text = self.vector(inputs[i : i + 4])
            # Name the vectors; otherwise each block of outputs would write them again.
            packs.append(text if text.isidentifier() else self.name("vec4", text))
        added: list[Scalar] = ["0.0"] * len(padded)  # to the outputs
        if bias is not None:
            added = [*bias, *[0.0] * (len(padded) - outputs)]
        starts = [self.vector(added[j : j + 4]) for j in range(0, len(padded), 4)]
        if self.weights == "texture":
            results = self._in_a_loop(padded, packs, starts)
        else:
            results = self._line_by_line(padded, packs, starts)
        return self.floats(results)[:outputs]

    def _line_by_line(self, weights: Array, packs: list[str], starts: list[str]) -> list[str]:
        """The product as straight-line code, the weights in its text or read from the uniform buffer.

        `packs` are the n inputs as vectors of four, `starts` are m vectors of four, which are added to the outputs;
        `weights` is (4 · m, 4 · n). Returns the outputs as m expressions of four floats.
        """
        results = []
        for j, start in enumerate(starts):
            terms = [start]
            for i, pack in enumerate(packs):
                block = weights[4 * j : 4 * j + 4, 4 * i : 4 * i + 4].T  # four columns of the matrix
                # The columns as expressions: of the buffer, to which the weights are added, or as literals.
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
        blocks = weights.reshape(len(starts), 4, len(packs), 4).transpose(0, 2, 3, 1)
        columns_in_order = np.ascontiguousarray(blocks).reshape(-1, 4)  # of 4 outputs each
        reader, first, _ = self.tables.place(columns_in_order, exact=True)
        self.count += 1
        name = f"t{self.count}"  # of no constant: two arrays, NAMEin and NAMEout, are named after it
        columns = ", ".join([f"{reader}(row)", *(f"{reader}(row + {k})" for k in range(1, 4))])
        product = self.dialect.matrix.format(columns=columns, vector=f"{name}in[i]")
        self.lines += self.dialect.loops(name, first, product, packs, starts)
        return [f"{name}out[{j}]" for j in range(len(starts))]


def literal(value: float) -> str:
    """A float32 as the shortest text that is a float in every dialect: "0.5", "1.0", "1.0e-05".

    `InputError` for infinity and NaN, for which no dialect has a text.
    """
    single = np.float32(value)
    if not np.isfinite(single):
        raise InputError(f"no shader can hold the number {single}")
    if value == 0 or 1e-4 <= abs(value) < 1e7:
        return np.format_float_positional(single, trim="0")
    return np.format_float_scientific(single, trim="0")
