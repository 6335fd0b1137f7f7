"""The folded network in PyTorch operations that a compiler fuses: no library's layer norm, no library's sine."""

from collections.abc import Callable

import torch
from torch import Tensor, nn
from torch.nn import functional

from bench.decoder import LEAK, Decoder, Network
from bench.fused.layers import Layer, Norm, layers_of, sine_of_turns
from bench.material import HALF_MAX

_CONTRACT = "cpp.enable_floating_point_contract_flag"
_SINE = sine_of_turns()[::-1]  # from the highest power down


class Lean(Network):
    """What a `Decoder` answers, (n, inputs) → (n, outputs). Products are in the weights' dtype, the rest in float32."""

    def __init__(self, decoder: Decoder):
        super().__init__()
        first = next(decoder.parameters())
        self.layers = nn.ModuleList(_Layer(layer) for layer in layers_of(decoder)).to(first.device, first.dtype)

    def forward(self, inputs: Tensor) -> Tensor:
        x = inputs
        for layer in self.layers:
            x = layer(x)
        return x.to(inputs.dtype)


def compiled(call: Callable[..., Tensor], dynamic: bool) -> Callable[..., Tensor]:
    """`call` through torch.compile, its products and sums contracted: a tenth faster, and rounded once, not twice."""
    from torch._inductor import config

    # A word in newer versions of PyTorch, a truth value in older ones.
    contract = "fast" if isinstance(config.cpp.enable_floating_point_contract_flag, str) else True
    found: Callable[..., Tensor] = torch.compile(call, dynamic=dynamic, options={_CONTRACT: contract})
    return found


class _Layer(nn.Module):
    def __init__(self, layer: Layer):
        super().__init__()
        self.activation, self.residual = layer.activation, layer.residual
        self.weight, self.bias = _constant(layer.weight), _constant(layer.bias)
        self.norm = None if layer.norm is None else _Norm(layer.norm)

    def forward(self, x: Tensor) -> Tensor:
        dtype = self.weight.dtype
        hidden = functional.linear(x.to(dtype), self.weight, self.bias)
        hidden = hidden.to(torch.promote_types(dtype, torch.float32))
        if dtype == torch.float16:
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
        return x + hidden if self.residual else hidden


class _Norm(nn.Module):
    def __init__(self, norm: Norm):
        super().__init__()
        self.gain, self.offset, self.eps = _constant(norm.gain), _constant(norm.offset), norm.eps

    def forward(self, x: Tensor) -> Tensor:
        return x * (x.square().mean(1, keepdim=True) + self.eps).rsqrt() * self.gain + self.offset


def _constant(values: object) -> nn.Parameter:
    return nn.Parameter(torch.as_tensor(values), requires_grad=False)


def _sine(turns: Tensor) -> Tensor:
    """sin(2π t) by its polynomial."""
    t = turns - turns.round()
    square = t * t
    value = torch.full_like(square, _SINE[0])
    for coefficient in _SINE[1:]:
        value = value * square + coefficient
    return value * t
