"""Kernels by Dr.Jit, and the folded network in one, with weights as literals.

Every intermediate stays in registers or the innermost cache. Dr.Jit comes with the extra `mitsuba`; LLVM is the
system's (`bench.program.llvm`). No minimum, maximum or arctangent is used: LLVM 16 and older cannot compile them.

If the network were inside the kernel's loop over samples, LLVM would treat each literal as an invariant of the loop: it
would store it as a vector before the loop, and read back 64 bytes a weight, 174 kB for every 16 samples. So the network
is a function that the loop calls; there a weight is 4 bytes, an operand of the multiply-add. This is 2.3 times as fast.

Dr.Jit would order the code output by output, and each multiply-add would read its input back from memory. So the sums
of a block of outputs grow together, one input after the other, which is a sixth faster with AVX2.
"""

from collections.abc import Callable, Sequence
from typing import Any

import drjit as dr
import torch
from torch import Tensor

from bench.inputs.errors import InputError
from bench.timing.fused.layers import Layer, layers_of, sine_coefficients
from bench.timing.fused.target import Target
from bench.timing.native import features
from bench.training.decoder import BEND, LEAK, PARABOLA, Decoder

MOST_PARAMETERS = 10_000  # with more, the code exceeds every cache, and compiling takes minutes
BLOCK = 12  # sums that grow together, for 16 registers
LARGE_BLOCK = 24  # for the 32 registers of AVX-512

RecordedCalls = dict[int, Callable[..., Any]]  # recorded calls by the size they hold for


def batched(
    target: Target,
    kernels: RecordedCalls,
    kernel: Callable[..., Sequence[Any]],
    queries: tuple[Tensor, ...],
    tables: Sequence[Any],
) -> Tensor:
    """The answers (n, outputs) of a kernel to queries (n, …), on the device of its target.

    `kernel(n, *flat)` returns an array (n,) for each output; `flat` are the queries, each as one row-major array, and
    `tables` the Dr.Jit arrays that the kernel reads besides. Each size is recorded once.
    """
    n = len(queries[0])
    # The next power of two from n on, at least 16, so that there are few recordings for all batches.
    size = 1 << max(n - 1, 15).bit_length()

    def recorded(*flat: Any) -> Any:
        """All answers of the kernel for `size` queries in one array (size · outputs,), row by row."""
        answer = kernel(size, *flat)
        out = dr.empty(target.arrays.Float, size * len(answer))
        # One packet: separate stores would compute the whole network again for each channel.
        dr.scatter(out, target.arrays.ArrayXf(answer), dr.arange(target.arrays.UInt32, size))
        return out

    if size not in kernels:
        kernels[size] = dr.freeze(recorded, state_fn=lambda *_: list(tables))
    padded = [_padded(column, size) for column in queries]
    flat = [target.arrays.Float(x.float().contiguous().reshape(-1)) for x in padded]
    target.ready()
    out = kernels[size](*flat)
    dr.eval(out)
    dr.sync_thread()
    return out.torch().reshape(size, -1)[:n].to(queries[0].dtype)


def _padded(column: Tensor, size: int) -> Tensor:
    """Rows (n, …) padded to (size, …) by the last row, because zeros are not directions; an empty batch by zeros."""
    missing = size - len(column)
    if not missing:
        return column
    last = column[-1:] if len(column) else column.new_zeros(1, *column.shape[1:])
    return torch.cat([column, last.expand(missing, -1)])


class DrJitNetwork:
    """A `Decoder` inside a kernel, in float32."""

    def __init__(self, decoder: Decoder, target: Target):
        """Take the layers of a decoder. `InputError` if it has too many weights."""
        self.target = target
        self.arrays = target.arrays
        count = decoder.architecture.parameters
        if count > MOST_PARAMETERS:
            limit = f"a network of up to {MOST_PARAMETERS:,} parameters"
            raise InputError(f"a kernel of Dr.Jit holds {limit}, but this one has {count:,}: use compiled")
        self.layers = layers_of(decoder)
        self.block = LARGE_BLOCK if "avx512f" in (features() or ()) else BLOCK

    def within(self, row: Any, inputs: Sequence[Any]) -> tuple[Any, ...]:
        """The outputs of the network for its inputs, inside a kernel over the samples numbered by `row` (n,)."""
        if not self.target.calls:
            return self._network(*inputs)
        # A switch with one case, number 0. That number must not be a constant, else LLVM would inline the function in
        # the loop. `row` is below 2³¹, so shifted right by 31 bits it is 0.
        return dr.switch(row >> 31, [self._network], *inputs)

    def _network(self, *inputs: Any) -> tuple[Any, ...]:
        """The outputs of the network, an array (n,) each, for its inputs."""
        x: Sequence[Any] = inputs
        for layer in self.layers:
            x = self._layer(layer, x)
        return tuple(x)

    def _layer(self, layer: Layer, x: Sequence[Any]) -> list[Any]:
        """One folded layer: see `Layer`. `x` has an array (n,) for each input, the answer one for each output."""
        hidden = self._dense(layer, x)
        norm = layer.norm
        if norm is not None:
            square = _sum([value * value for value in hidden])
            scale = dr.rsqrt(dr.fma(square, 1 / len(hidden), norm.eps))  # 1 / √(mean of squares + eps)
            affine = zip(hidden, norm.gain.tolist(), norm.offset.tolist(), strict=True)
            hidden = [dr.fma(value * scale, gain, offset) for value, gain, offset in affine]
        match layer.activation:
            case "sine":
                hidden = [self._sine(value) for value in hidden]
            case "relu" | "leaky-relu":
                leak = LEAK if layer.activation == "leaky-relu" else 0.0
                hidden = [dr.select(value > 0, value, value * leak) for value in hidden]
            case "smelu":
                hidden = [self._smelu(value) for value in hidden]
            case "silu":
                hidden = [value / (1 + dr.exp(-value)) for value in hidden]
        if layer.residual:
            return [a + b for a, b in zip(x, hidden, strict=True)]
        return hidden

    def _dense(self, layer: Layer, x: Sequence[Any]) -> list[Any]:
        """weight · x + bias: for a block of outputs one input after the other, so that sums stay in registers."""
        outputs: list[Any] = []
        for start in range(0, len(layer.bias), self.block):
            rows = slice(start, start + self.block)
            sums = [self.arrays.Float(bias) for bias in layer.bias[rows].tolist()]
            for value, weights in zip(x, layer.weight[rows].T.tolist(), strict=True):
                self._new_scope()
                sums = [dr.fma(value, weight, total) for weight, total in zip(weights, sums, strict=True)]
            outputs += sums
        self._new_scope()
        return outputs

    def _new_scope(self) -> None:
        """Start a new scope, because Dr.Jit orders the code by scope, and otherwise output by output."""
        dr.detail.new_scope(self.target.backend)

    def _smelu(self, x: Any) -> Any:
        """The smooth leaky ReLU, as `bench.training.decoder.smelu`, without a minimum or a maximum."""
        inside = BEND - dr.select(x > 0, x, -x)
        inside = dr.select(inside > 0, inside, 0)
        return dr.fma(inside * inside, PARABOLA, dr.select(x > 0, x, x * LEAK))

    def _sine(self, turns: Any) -> Any:
        """sin(2π · turns), by the polynomial of `sine_coefficients` from its highest power down."""
        t = turns - dr.round(turns)
        square = t * t
        first, *rest = sine_coefficients()[::-1]
        value = self.arrays.Float(first)
        for coefficient in rest:
            value = dr.fma(value, square, coefficient)
        return value * t


def _sum(values: list[Any]) -> Any:
    """The sum in pairs: a chain would wait for each addition."""
    while len(values) > 1:
        pairs = [a + b for a, b in zip(values[::2], values[1::2], strict=False)]
        unpaired = values[-1:] if len(values) % 2 else []
        values = pairs + unpaired
    return values[0]
