"""The small network of most learned codecs, in one class, so that counting, timing and export are written once."""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Literal

import torch
from torch import Tensor, nn
from torch.nn import functional

from bench.material import sample_texture, saturated

Activation = Literal["relu", "leaky-relu", "smelu", "silu", "sine"]

FREE_WEIGHTS = 1 << 22  # weights that any network may have, even if its file holds fewer numbers
# The most weights of a network while a file is decoded: see `decoding`. None at other times.
_most_weights: ContextVar[int | None] = ContextVar("_most_weights", default=None)
LEAK = 0.01  # slope of the leaky ReLU below 0
BEND = 0.5  # SmeLU is the leaky ReLU, its kink rounded by a parabola from −BEND to BEND
PARABOLA = (1 - LEAK) / (4 * BEND)  # SmeLU adds PARABOLA · (BEND − |x|)² there


@dataclass(frozen=True)
class Architecture:
    """The shape of a network: `inputs` numbers → hidden layers of `widths` → `outputs` numbers, the last layer linear.

    A hidden layer is linear → layer norm with gain and offset, if `norm` → activation.
    """

    inputs: int
    widths: tuple[int, ...]
    outputs: int = 3
    activation: Activation = "relu"
    omega: float = 1.0  # frequency of the sine
    norm: bool = False
    residual: bool = False  # a hidden layer adds its input, if that has its own width

    @property
    def sizes(self) -> tuple[int, ...]:
        """The widths of all layers, from the inputs to the outputs."""
        return (self.inputs, *self.widths, self.outputs)

    @property
    def parameters(self) -> int:
        """Trainable numbers: weights and biases, and two a channel of each layer norm."""
        linear = sum(inputs * outputs + outputs for inputs, outputs in pairwise(self.sizes))  # weights, biases
        norms = 2 * sum(self.widths) if self.norm else 0  # gain and offset of each channel
        return linear + norms

    @property
    def flops(self) -> int:
        """Operations of one sample: a fused multiply-add counts as two, an activation as one a channel, a layer norm as
        eight."""
        linear = sum(2 * inputs * outputs for inputs, outputs in pairwise(self.sizes))
        additions = 0  # of residual layers
        if self.residual:
            for inputs, width in pairwise(self.sizes[:-1]):  # of each hidden layer
                if inputs == width:
                    additions += width
        norm = 8 if self.norm else 0
        activation = 1
        return linear + additions + sum(self.widths) * (norm + activation)


class Network(nn.Module):
    """The protocol of a network (n, inputs) → (n, outputs): a `Decoder`, or an execution's replacement of it."""

    def at(self, texture: Tensor, uv: Tensor, first: Tensor, second: Tensor) -> Tensor:
        """The outputs for a texture (H, W, C) at uv (n, 2), bilinear, then `first` and `second`, both (n, …)."""
        return self(torch.cat([sample_texture(texture, uv), first, second], 1))


class Decoder(Network):
    """The network of an architecture: (n, inputs) → (n, outputs). Initialised from a generator, in float32.

    Sine layers start as in SIREN (Sitzmann et al., "Implicit neural representations with periodic activation
    functions", 2020, section 3.2), the others after He et al. 2015; the last like a hidden one, but its bias is 0.
    """

    def __init__(self, architecture: Architecture, generator: torch.Generator | None = None):
        """Make the layers, and draw their weights. `ValueError` if a file that is being decoded could not hold them."""
        super().__init__()
        most_weights = _most_weights.get()
        # While a file is decoded, its settings may not ask for more weights than its bytes can hold.
        if most_weights is not None and architecture.parameters > most_weights:
            raise ValueError(f"it has a network of {architecture.parameters:,} weights, but fewer numbers")
        self.architecture = architecture
        self.layers: Any = nn.ModuleList(nn.Linear(inputs, outputs) for inputs, outputs in pairwise(architecture.sizes))
        self.norms: Any = None
        if architecture.norm:
            self.norms = nn.ModuleList(nn.LayerNorm(width) for width in architecture.widths)
        with torch.no_grad():
            for depth, layer in enumerate(self.layers):
                _initialise(layer, architecture, depth, generator)

    @torch.no_grad()
    def start_at(self, outputs: Tensor, everywhere: bool = True) -> None:
        """Set the last layer's bias to `outputs` (outputs,).

        With `everywhere` its weights become 0, so that any input gives these outputs.
        """
        if everywhere:
            self.layers[-1].weight.zero_()
        self.layers[-1].bias.copy_(outputs)

    def hidden_matrices(self) -> list[Tensor]:
        """The weights between hidden layers: see `bench.training.optimiser`."""
        return [layer.weight for layer in self.layers[1:-1]]

    def forward(self, inputs: Tensor) -> Tensor:
        """Outputs (n, outputs) for inputs (n, inputs), in their dtype; intermediates have the dtype of the weights."""
        x = inputs.to(next(self.parameters()).dtype)
        for depth, layer in enumerate(self.layers[:-1]):
            linear = saturated(layer(x)) if self.norms is None else self._normed(x, depth)
            hidden = self._activate(linear)
            if self.architecture.residual and x.shape == hidden.shape:
                if hidden.requires_grad:  # a gradient may need what an addition in place would overwrite
                    hidden = x + hidden
                else:
                    hidden.add_(x)
                hidden = saturated(hidden)
            x = hidden
        return saturated(self.layers[-1](x)).to(inputs.dtype)

    def _normed(self, x: Tensor, depth: int) -> Tensor:
        """Apply a linear layer and its norm to x (n, inputs).

        Without gradients, from float32 on, this takes fewer passes: the mean over the outputs, which a norm subtracts,
        is subtracted from weights and bias instead. So they give centred outputs, and the norm needs only their length.
        """
        layer, norm = self.layers[depth], self.norms[depth]
        if torch.is_grad_enabled() or x.dtype.itemsize < 4:
            return saturated(norm(saturated(layer(x))))
        hidden = functional.linear(x, layer.weight - layer.weight.mean(0), layer.bias - layer.bias.mean())
        length = torch.linalg.vector_norm(hidden, dim=1, keepdim=True)
        variance = length.square_().div_(hidden.shape[1])  # (n, 1)
        hidden *= variance.add_(norm.eps).rsqrt_()
        return torch.addcmul(norm.bias, hidden, norm.weight, out=hidden)

    def _activate(self, x: Tensor) -> Tensor:
        """Apply the activation to a layer's outputs; in place if no gradient needs them, to save memory."""
        in_place = not x.requires_grad
        match self.architecture.activation:
            case "sine":
                omega = self.architecture.omega
                if omega != 1:
                    x = x.mul_(omega) if in_place else x * omega
                    x = saturated(x)  # halves may overflow by the factor
                return x.sin_() if in_place else x.sin()
            case "leaky-relu":
                return functional.leaky_relu(x, LEAK, inplace=in_place)
            case "smelu":
                return smelu(x)
            case "silu":
                return functional.silu(x, inplace=in_place)
            case "relu":
                return functional.relu(x, inplace=in_place)


def smelu(x: Tensor) -> Tensor:
    """Smooth leaky ReLU: slope `LEAK` below −`BEND`, 1 above `BEND`, a parabola between (Shamir and Lin 2022)."""
    return functional.leaky_relu(x, LEAK) + PARABOLA * functional.relu(BEND - x.abs()).square()


def _initialise(layer: Any, architecture: Architecture, depth: int, generator: torch.Generator | None) -> None:
    """Draw a linear layer's weights, then its biases; `depth` 0 is the first layer, and the last one's biases are 0."""
    bound = math.sqrt(6 / layer.in_features)  # He et al.
    if architecture.activation == "sine" and depth == 0:
        bound = 1 / layer.in_features
    elif architecture.activation == "sine":
        bound = bound / architecture.omega
    layer.weight.uniform_(-bound, bound, generator=generator)
    layer.bias.zero_()
    if depth < len(architecture.widths):
        # Random biases spread the kinks, or the phases, of a layer over its inputs.
        spread = 1 / math.sqrt(layer.in_features)
        layer.bias.uniform_(-spread, spread, generator=generator)


@contextmanager
def decoding(numbers: int) -> Iterator[None]:
    """Raise a `ValueError` for any `Decoder` with more weights than a file of so many `numbers` can hold.

    `FREE_WEIGHTS` are allowed in any case. Otherwise the settings in a file's header, which cost no bytes, could ask
    for any size.
    """
    token = _most_weights.set(max(FREE_WEIGHTS, numbers))
    try:
        yield
    finally:
        _most_weights.reset(token)
