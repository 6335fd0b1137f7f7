"""The folded network in PyTorch operations that a compiler fuses: no library's layer norm, no library's sine."""

import math
import os
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional

from bench.material import HALF_MAX, at_least_float32
from bench.timing.fused.layers import Array, Layer, Norm, layers_of, sine_coefficients
from bench.training.decoder import LEAK, Decoder, Network, smelu

_BITS = {"default": 1, "avx2": 256, "avx512": 512}  # of a vector, by ATEN_CPU_CAPABILITY
_SINE = sine_coefficients()[::-1]  # from the highest power down


class Lean(Network):
    """Computes a `Decoder`, (n, inputs) → (n, outputs). Products have the weights' dtype, all else is float32."""

    def __init__(self, decoder: Decoder):
        super().__init__()
        first = next(decoder.parameters())
        self.layers = nn.ModuleList(_Layer(layer, first.dtype) for layer in layers_of(decoder)).to(first.device)

    def forward(self, inputs: Tensor) -> Tensor:
        """Outputs (n, outputs) for inputs (n, inputs), in their dtype."""
        x = inputs
        for layer in self.layers:
            x = layer(x)
        return x.to(inputs.dtype)


def compiled(call: Callable[..., Tensor], dynamic: bool) -> Callable[..., Tensor]:
    """`call` through torch.compile with fused multiply-adds: a tenth faster, and rounded once instead of twice.

    `dynamic`: one kernel for batches of any size, instead of one for each size.
    """
    from torch._inductor import config

    # The option is a word in newer versions of PyTorch, and a bool in older ones.
    contract = "fast" if isinstance(config.cpp.enable_floating_point_contract_flag, str) else True
    options: dict[str, Any] = {"cpp.enable_floating_point_contract_flag": contract}
    # PyTorch's cache of compiled code depends on options, not on the capability. Without this option, a process
    # restricted to AVX2 could load cached AVX-512 code.
    capability = os.environ.get("ATEN_CPU_CAPABILITY", "").lower()
    if capability in _BITS:
        options["cpp.simdlen"] = _BITS[capability]
    return torch.compile(call, dynamic=dynamic, options=options)


class _Layer(nn.Module):
    """One folded layer with products in `dtype`, (n, inputs) → (n, outputs) in float32 or longer."""

    def __init__(self, layer: Layer, dtype: torch.dtype):
        """Keep the numbers of a layer as constants of a type."""
        super().__init__()
        self.activation = layer.activation
        self.residual = layer.residual
        self.weight = _constant(layer.weight, dtype)
        self.bias = _constant(layer.bias, dtype)
        self.norm = None if layer.norm is None else _Norm(layer.norm, at_least_float32(dtype))

    def forward(self, x: Tensor) -> Tensor:
        """The layer's answer (n, outputs) to x (n, inputs)."""
        dtype = self.weight.dtype
        hidden = functional.linear(x.to(dtype), self.weight, self.bias)
        hidden = hidden.to(at_least_float32(dtype))
        if dtype == torch.float16:  # the sums may have overflowed to infinity
            hidden = hidden.clamp(-HALF_MAX, HALF_MAX)
        if self.norm is not None:
            hidden = self.norm(hidden)
        match self.activation:
            case "sine":
                hidden = _sine(hidden)
            case "relu":
                hidden = functional.relu(hidden)
            case "leaky-relu":
                hidden = functional.leaky_relu(hidden, LEAK)
            case "smelu":
                hidden = smelu(hidden)
            case "silu":
                hidden = functional.silu(hidden)
        return x + hidden if self.residual else hidden


class _Norm(nn.Module):
    """The norm by the sum of squares instead of their mean: the gain is larger by √width, eps by the width."""

    def __init__(self, norm: Norm, dtype: torch.dtype):
        """Keep the numbers of a norm as constants of a type, scaled for the length in place of the deviation."""
        super().__init__()
        width = len(norm.gain)
        self.gain = _constant(norm.gain * math.sqrt(width), dtype)
        self.offset = _constant(norm.offset, dtype)
        self.eps = norm.eps * width

    def forward(self, x: Tensor) -> Tensor:
        """The norm (n, width) of numbers (n, width), whose mean over the width the layer before has made 0."""
        scale = (x.square().sum(1, keepdim=True) + self.eps).rsqrt()
        # `as_strided` forces the scale into memory; otherwise the root is computed again for every vector of a sample.
        scale = scale.as_strided(scale.shape, scale.stride())
        return x * scale * self.gain + self.offset


def _constant(values: Array, dtype: torch.dtype) -> nn.Parameter:
    """Numbers of the folded network as a parameter, so that they count, move and convert as its own did."""
    return nn.Parameter(torch.as_tensor(values, dtype=dtype), requires_grad=False)


def _sine(turns: Tensor) -> Tensor:
    """sin(2π · turns), any shape: the polynomial of `sine_coefficients` after rounding to the nearest whole turn."""
    t = turns - turns.round()  # from −½ to ½
    square = t * t
    # Horner's scheme, from the highest power down.
    value = torch.full_like(square, _SINE[0])
    for coefficient in _SINE[1:]:
        value = value * square + coefficient
    return value * t
