"""The layers of a network as cooperative vectors, which Slang has: they run on the matrix units of a GPU.

A *layer* is a matrix product with a bias, both constant. It is computed in halves, with its weights in a buffer. ReLU
and leaky ReLU are computed in halves too, on the cooperative vector; everything else is `Writer`'s, in floats. So are
products without a bias: they turn colours, rotate frames or sum tables, which halves are too coarse for.

Source: SPV_NV_cooperative_vector. Halves are what each device with it supports (VkCooperativeVectorPropertiesNV).
"""

import math
import re
from typing import Any

import numpy as np

from bench.program.backend import Array, Rows, Scalar, is_number
from bench.program.operations import FORMULAS
from reports.shaders.dialects import Dialect
from reports.shaders.writer import HALF_MOST, Tables, WeightStore, Writer, literal

BUFFER = """// The network's layers: 16-bit floats, little-endian. Each matrix is stored row by row, a row for each
// output, padded to a multiple of 16 bytes; its bias follows it. Matrices and biases start at multiples of 64 bytes.
[[vk::binding(2)]] ByteAddressBuffer weights : register(t2);
"""
ALIGNED = 32  # halves: a matrix starts at a multiple of 64 bytes
ROW = 8  # halves: a row takes a multiple of 16 bytes
# Those of `relu` and `leaky_relu`. Cooperative vectors have no sine, the other activation of hidden layers.
ACTIVATIONS = (FORMULAS["maximum"], FORMULAS["mul"])
LAYER = (
    "coopVecMatMulAdd<half, {outputs}>({inputs}, CoopVecComponentType.Float16, "
    "weights, {matrix}, CoopVecComponentType.Float16, weights, {bias}, CoopVecComponentType.Float16, "
    "CoopVecMatrixLayout.RowMajor, false, {stride})"
)


class CooperativeWriter(Writer):
    """Statements of one Slang shader, with layers as cooperative vectors."""

    def __init__(self, dialect: Dialect, tables: Tables, weights: WeightStore):
        """Start without statements, as `Writer` does."""
        super().__init__(dialect, tables, weights)
        self.sizes: dict[str, int] = {}  # of the cooperative vectors, by their names

    def weighted(self, weights: Array, inputs: list[Scalar], bias: list[Scalar] | None) -> list[str]:
        """As `Writer.weighted`; a layer's outputs are the elements of a cooperative vector."""
        if bias is None or not all(map(is_number, bias)):
            return super().weighted(weights, inputs, bias)
        added = np.array(bias, np.float32)
        largest = max(np.abs(weights).max(initial=0), np.abs(added).max(initial=0))
        if weights.size == 0 or largest > HALF_MOST:
            return super().weighted(weights, inputs, bias)
        outputs, count = weights.shape
        stride = math.ceil(count / ROW) * ROW
        matrix = self._stored(np.pad(weights, ((0, 0), (0, stride - count))))
        places = {"matrix": matrix, "bias": self._stored(added), "stride": 2 * stride}
        vector = self._vector_of(inputs) or self._cooperative(count, self._made(inputs))
        return self._elements(outputs, LAYER.format(outputs=outputs, inputs=vector, **places))

    def each(self, formula: str, arguments: Rows, from_kind: str, kind: str) -> list[str]:
        """As `Writer.each`; activations of a layer stay on its cooperative vector."""
        vectors = [self._vector_of(argument) for argument in arguments]
        texts = [vector or self._same(argument) for vector, argument in zip(vectors, arguments, strict=True)]
        # The range of halves may not hold the product of two layers.
        is_product_of_layers = formula == FORMULAS["mul"] and all(vectors)
        if formula in ACTIVATIONS and any(vectors) and all(texts) and not is_product_of_layers:
            return self._elements(len(arguments[0]), formula.format(*texts))
        return super().each(formula, arguments, from_kind, kind)

    def _stored(self, numbers: Array) -> int:
        """Put numbers into the buffer, as halves; returns the byte at which they start."""
        start = sum(map(len, self.layers))
        padded = np.zeros(math.ceil(numbers.size / ALIGNED) * ALIGNED, np.float16)
        padded[: numbers.size] = numbers.ravel()
        self.layers.append(padded)
        return 2 * start

    def _cooperative(self, count: int, value: str) -> str:
        """The name of a new cooperative vector."""
        name = self.declare(f"CoopVec<half, {count}>", value)
        self.sizes[name] = count
        return name

    def _elements(self, count: int, value: str) -> list[str]:
        """The elements, as floats, of a new cooperative vector."""
        name = self._cooperative(count, value)
        return [f"float({name}[{i}])" for i in range(count)]

    def _made(self, scalars: list[Scalar]) -> str:
        """A cooperative vector of some floats, as an expression."""
        texts = [f"half({self.scalar(x, 'float')})" for x in scalars]
        return f"CoopVec<half, {len(texts)}>({', '.join(texts)})"

    def _vector_of(self, scalars: list[Any]) -> str | None:
        """The name of the cooperative vector whose elements these are: all of them, in order. None if there is none."""
        first = re.match(r"float\((\w+)\[0\]\)$", str(scalars[0])) if scalars else None
        if not first:
            return None
        name = first[1]
        elements = [f"float({name}[{i}])" for i in range(self.sizes[name])]
        return name if list(scalars) == elements else None

    def _same(self, scalars: list[Scalar]) -> str | None:
        """A cooperative vector of one number many times; None if these are no numbers, or not equal, or above 1: the
        range of halves may not hold its product. None for no scalars, too."""
        if not scalars or not all(is_number(x) and x == scalars[0] and abs(x) <= 1 for x in scalars):
            return None
        return f"CoopVec<half, {len(scalars)}>(half({literal(float(scalars[0]))}))"
