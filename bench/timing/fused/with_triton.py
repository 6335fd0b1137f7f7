"""The folded network as one kernel on a GPU, by Triton, that fetches the texture too: one launch a batch.

A block of samples goes through all layers in registers; weights come from the innermost cache. Products are of float32
(in three parts, or rounded as tf32) or bfloat16 numbers and are summed in float32; everything else is float32 too.
"""

from itertools import pairwise
from typing import Any

import numpy as np
import torch
import triton
import triton.language as tl
from torch import Tensor

from bench.inputs.errors import InputError
from bench.machine.devices import is_gpu
from bench.timing.fused.layers import Array, Layer, layers_of, sine_coefficients
from bench.training.decoder import BEND, LEAK, PARABOLA, Architecture, Decoder, Network

BLOCK = 128  # samples of one Triton program
MOST_SHARED = 227 << 10  # bytes of shared memory of one program, of the GPU with the most (H100)
MOST_SHORT_INPUTS = 64  # of a network in bfloat16
SMALLEST = 16  # a side of the smallest matrix that the GPU multiplies


@triton.jit
def _texel(texture, row, col, height, width, channel, wanted, CHANNELS: tl.constexpr):  # type: ignore[no-untyped-def]
    """Values (BLOCK, columns) of one corner, periodic; 0 where a column or a sample is not wanted."""
    # Here a remainder has the sign of the dividend, which may be −1: a side more makes it positive.
    row = (row % height + height) % height
    col = (col % width + width) % width
    place = (row * width + col)[:, None] * CHANNELS + channel[None, :]
    return tl.load(texture + place, mask=wanted, other=0.0).to(tl.float32)


@triton.jit
def _fetched(texture, uv, sample, there, height, width, column, CHANNELS: tl.constexpr):  # type: ignore[no-untyped-def]
    """The texture (BLOCK, columns) at uv, bilinear; 0 in columns beyond its channels."""
    u = tl.load(uv + 2 * sample, mask=there, other=0.0).to(tl.float32) * width - 0.5
    v = (1.0 - tl.load(uv + 2 * sample + 1, mask=there, other=0.0).to(tl.float32)) * height - 0.5
    left, top = tl.floor(u), tl.floor(v)
    right, below = (u - left)[:, None], (v - top)[:, None]
    col, row = left.to(tl.int32), top.to(tl.int32)
    wanted = there[:, None] & (column < CHANNELS)[None, :]
    upper = _texel(texture, row, col, height, width, column, wanted, CHANNELS) * (1 - right)
    upper += _texel(texture, row, col + 1, height, width, column, wanted, CHANNELS) * right
    lower = _texel(texture, row + 1, col, height, width, column, wanted, CHANNELS) * (1 - right)
    lower += _texel(texture, row + 1, col + 1, height, width, column, wanted, CHANNELS) * right
    return upper * (1 - below) + lower * below


@triton.jit
def _product(x, matrix, PRECISION: tl.constexpr, WIDEN: tl.constexpr):  # type: ignore[no-untyped-def]
    """x · matrix, of numbers of the matrix's type, summed in float32."""
    x = x.to(matrix.dtype)
    if WIDEN:  # the same numbers, because Triton's interpreter cannot multiply bfloat16
        x = x.to(tl.float32)
        matrix = matrix.to(tl.float32)
    return tl.dot(x, matrix, input_precision=PRECISION)


@triton.jit
def _rectified(  # type: ignore[no-untyped-def]
    x, ACTIVATION: tl.constexpr, SLOPE: tl.constexpr, BEND: tl.constexpr, PARABOLA: tl.constexpr
):  # fmt: skip
    """SiLU; or slope 1 above 0 and SLOPE below, and with a PARABOLA the kink rounded from −BEND to BEND."""
    if ACTIVATION == "silu":
        return x * tl.sigmoid(x)
    y = tl.where(x > 0, x, x * SLOPE)
    if PARABOLA > 0:
        inside = BEND - tl.abs(x)
        y += tl.where(inside > 0, inside * inside * PARABOLA, 0.0)
    return y


@triton.jit
def _network(  # type: ignore[no-untyped-def]
    out, texture, uv, first, second, weights, scalars, n, height, width, first_stride, second_stride, eps,
    CHANNELS: tl.constexpr, FIRST: tl.constexpr, SECOND: tl.constexpr, INPUTS: tl.constexpr, WIDTH: tl.constexpr,
    USED: tl.constexpr, LAYERS: tl.constexpr, OUTPUTS: tl.constexpr, LAST: tl.constexpr, NORM: tl.constexpr,
    ACTIVATION: tl.constexpr, RESIDUAL: tl.constexpr, SLOPE: tl.constexpr, BEND: tl.constexpr, PARABOLA: tl.constexpr,
    PRECISION: tl.constexpr, WIDEN: tl.constexpr,
    C0: tl.constexpr, C1: tl.constexpr, C2: tl.constexpr, C3: tl.constexpr, C4: tl.constexpr, C5: tl.constexpr,
    BLOCK: tl.constexpr,
):  # fmt: skip
    """The outputs (n, OUTPUTS) of the network for the texture at uv, followed by the numbers `first` and `second`.

    `weights` holds one matrix (inputs, outputs) after the other, row by row: (INPUTS, WIDTH), hidden (WIDTH, WIDTH) and
    last (WIDTH, LAST). `scalars` holds WIDTH biases, gains and offsets of each hidden layer, then LAST biases. All
    sides are powers of two, filled up with zeros; a norm is over the USED channels.
    """
    # The inputs (BLOCK, INPUTS) of this program's samples: channels of the texture, `first`, `second`, then zeros.
    sample = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    there = sample < n  # the last block may be longer than what is left
    column = tl.arange(0, INPUTS)
    x = tl.zeros((BLOCK, INPUTS), tl.float32)
    if CHANNELS > 0:
        x += _fetched(texture, uv, sample, there, height, width, column, CHANNELS)
    place = column - CHANNELS  # within `first`; later within `second`
    wanted = there[:, None] & ((place >= 0) & (place < FIRST))[None, :]
    x += tl.load(first + sample[:, None] * first_stride + place[None, :], mask=wanted, other=0.0).to(tl.float32)
    if SECOND > 0:
        place = place - FIRST
        wanted = there[:, None] & ((place >= 0) & (place < SECOND))[None, :]
        x += tl.load(second + sample[:, None] * second_stride + place[None, :], mask=wanted, other=0.0).to(tl.float32)

    # The hidden layers, whose numbers x are (BLOCK, WIDTH).
    channel = tl.arange(0, WIDTH)
    for layer in tl.static_range(LAYERS):
        if layer == 0:
            matrix = tl.load(weights + column[:, None] * WIDTH + channel[None, :])
        else:
            start = INPUTS * WIDTH + (layer - 1) * WIDTH * WIDTH
            matrix = tl.load(weights + start + channel[:, None] * WIDTH + channel[None, :])
        here = scalars + layer * 3 * WIDTH + channel  # the biases; the gains and offsets follow
        hidden = _product(x, matrix, PRECISION, WIDEN) + tl.load(here)[None, :]
        if NORM:
            scale = tl.rsqrt(tl.sum(hidden * hidden, 1) / USED + eps)
            hidden = hidden * scale[:, None] * tl.load(here + WIDTH)[None, :] + tl.load(here + 2 * WIDTH)[None, :]
        if ACTIVATION == "sine":
            # In turns, less the nearest whole turn; then the polynomial of `sine_coefficients`.
            turn = hidden - tl.floor(hidden + 0.5)
            s = turn * turn
            hidden = (((((C5 * s + C4) * s + C3) * s + C2) * s + C1) * s + C0) * turn
        else:
            hidden = _rectified(hidden, ACTIVATION, SLOPE, BEND, PARABOLA)
        if RESIDUAL and layer > 0:
            hidden += x
        x = hidden
    # The last layer, whose outputs are stored without the padding.
    answer = tl.arange(0, LAST)
    start = INPUTS * WIDTH + (LAYERS - 1) * WIDTH * WIDTH
    matrix = tl.load(weights + start + channel[:, None] * LAST + answer[None, :])
    y = _product(x, matrix, PRECISION, WIDEN) + tl.load(scalars + LAYERS * 3 * WIDTH + answer)[None, :]
    wanted = there[:, None] & (answer < OUTPUTS)[None, :]
    tl.store(out + sample[:, None] * OUTPUTS + answer[None, :], y, mask=wanted)


def _refuse_unsuited(architecture: Architecture, parameter: Tensor) -> None:
    """Raise `InputError` for a network that the kernel cannot compute; `parameter` has the type and device of all."""
    width, *others = set(architecture.widths)
    if others:
        raise InputError("network on a GPU needs hidden layers of one width: use compiled")
    if architecture.residual and architecture.inputs == width:  # the kernel adds no inputs to the first layer
        raise InputError("network on a GPU with residuals needs layers not as wide as the inputs: use compiled")
    if parameter.dtype not in (torch.float32, torch.bfloat16):
        raise InputError(f"network on a GPU computes in float32 or bfloat16, not {parameter.dtype}: use compiled")
    # At least the numbers that one layer passes to the next go through shared memory: 514 kB for 512 channels.
    if is_gpu(parameter.device) and BLOCK * _padded(width) * parameter.itemsize > MOST_SHARED:
        raise InputError(f"network on a GPU has no room for {width} channels of {parameter.dtype}: use compiled")
    # With 67 inputs, padded to 128, Triton 3.6 read where it may not, on an H100 in batches of 65,536.
    if parameter.itemsize < 4 and architecture.inputs > MOST_SHORT_INPUTS:
        raise InputError(
            f"network on a GPU in {parameter.dtype} takes up to {MOST_SHORT_INPUTS} inputs, not "
            f"{architecture.inputs}: use float32, tf32 or compiled"
        )


class TritonNetwork(Network):
    """Computes a `Decoder` on its device and in its dtype, float32 or bfloat16; `tf32` rounds float32 products."""

    def __init__(self, decoder: Decoder, tf32: bool = False):
        """Take the layers of a decoder. `InputError` if the kernel cannot compute such a network."""
        super().__init__()
        architecture = decoder.architecture
        parameter = next(decoder.parameters())  # its type and device are those of all
        _refuse_unsuited(architecture, parameter)
        # Sides of matrices are padded with zeros to what Triton multiplies.
        layers = layers_of(decoder)
        inputs = _padded(architecture.inputs)
        width = _padded(architecture.widths[0])  # all hidden layers have one width
        last = _padded(architecture.outputs)
        sides = [inputs, *[width] * len(architecture.widths), last]
        weights = []
        for layer, (rows, columns) in zip(layers, pairwise(sides), strict=True):
            weights.append(_matrix(layer.weight.T, rows, columns))
        *hidden, end = layers
        scalars = [_scalars(layer, width) for layer in hidden]  # of each layer biases, gains and offsets
        scalars.append(_matrix(end.bias[None], 1, last))
        self.weights = torch.nn.Parameter(torch.cat(weights).to(parameter), requires_grad=False)
        self.scalars = torch.nn.Parameter(torch.cat(scalars).to(parameter.device), requires_grad=False)
        self.outputs = architecture.outputs
        self.shape = (inputs, width, last)  # with padding
        norm = layers[0].norm  # all hidden layers have one, with one `eps`, or none has
        used = len(layers[0].bias)  # the width without padding
        activation = architecture.activation
        # What the kernel is compiled for; see `_network`.
        self.options: dict[str, Any] = {
            "USED": used,
            "LAYERS": len(hidden),
            "NORM": norm is not None,
            "ACTIVATION": activation,
            "RESIDUAL": architecture.residual,
            # Of an activation with a kink, see `_rectified`.
            "SLOPE": 0.0 if activation == "relu" else LEAK,
            "BEND": BEND,
            "PARABOLA": PARABOLA if activation == "smelu" else 0.0,
            "PRECISION": "tf32" if tf32 else _exact(parameter),
            "WIDEN": not is_gpu(parameter.device),  # on a processor the kernel is interpreted, see `_product`
        }
        for number, coefficient in enumerate(sine_coefficients()):  # of the polynomial in place of the sine
            self.options[f"C{number}"] = coefficient
        self.eps = norm.eps if norm else 0.0

    def forward(self, inputs: Tensor) -> Tensor:
        """Outputs (n, outputs) for inputs (n, inputs), in their dtype."""
        return self._run(None, inputs, inputs, None).to(inputs.dtype)

    def at(self, texture: Tensor, uv: Tensor, first: Tensor, second: Tensor) -> Tensor:
        return self._run(texture.contiguous(), uv.contiguous(), first, second).to(uv.dtype)

    def _run(self, texture: Tensor | None, uv: Tensor, first: Tensor, second: Tensor | None) -> Tensor:
        """The outputs (n, outputs), float32, for what the texture (H, W, C) has at uv (n, 2), then `first` and `second`
        (n, …). Without a texture `first` is all the inputs."""
        n = len(first)
        inputs, width, last = self.shape
        first = _with_rows(first)
        # A kernel needs a pointer for each input, also for one of no channels, of which it reads nothing.
        texels = uv if texture is None else texture
        height, across, channels = (1, 1, 0) if texture is None else texture.shape
        other = first if second is None else _with_rows(second)
        others = 0 if second is None else second.shape[1]
        out = first.new_empty(n, self.outputs, dtype=torch.float32)
        if n:
            _network[(triton.cdiv(n, BLOCK),)](
                out, texels, uv, first, other, self.weights, self.scalars,
                n, height, across, first.stride(0), other.stride(0), self.eps,
                CHANNELS=channels, FIRST=first.shape[1], SECOND=others,
                INPUTS=inputs, WIDTH=width, OUTPUTS=self.outputs, LAST=last, BLOCK=BLOCK, **self.options,
            )  # fmt: skip
        return out


def _with_rows(inputs: Tensor) -> Tensor:
    """Inputs (n, D) whose rows are contiguous, as the kernel reads them."""
    return inputs if inputs.stride(1) == 1 else inputs.contiguous()


def _exact(parameter: Tensor) -> str:
    """Triton's word for products as exact as those of float32."""
    # Three products of tf32 numbers, which NVIDIA's matrix units compute. A single float32 product they cannot compute:
    # "ieee" is 3 times slower at 64 channels, and at 106 it did not compile within five minutes.
    return "tf32x3" if parameter.device.type == "cuda" and not torch.version.hip else "ieee"


def _padded(count: int) -> int:
    """The smallest power of two that is at least this number, and at least `SMALLEST`."""
    return max(SMALLEST, triton.next_power_of_2(count))


def _matrix(values: Array, rows: int, columns: int) -> Tensor:
    """A matrix filled up with zeros to (rows, columns), as one vector, row by row."""
    matrix = torch.zeros(rows, columns)
    matrix[: values.shape[0], : values.shape[1]] = torch.from_numpy(values)
    return matrix.reshape(-1)


def _scalars(layer: Layer, width: int) -> Tensor:
    """Bias, gain and offset (3 · width,) of one layer, one after the other; zeros for those of no norm."""
    rows = [layer.bias]
    if layer.norm:
        rows += [layer.norm.gain, layer.norm.offset]
    return _matrix(np.stack(rows), 3, width)
