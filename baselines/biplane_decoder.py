"""The decoder that `biplane` shares over all materials, and the colours that a material gives to its answers."""

from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn import functional

from bench.material import HALF_MAX
from bench.training.decoder import LEAK

FEATURES = 6  # of each plane
MATRIX, COLOURS = 9, 12  # numbers of a texel's matrix, and of matrix and offset
WIDTHS = (2 + 2 * FEATURES, 256, 128, 256, 128, 256, 3)


class BiplaneDecoder(nn.Module):
    """Numbers (n, 14) → (n, 3) from 0 to 1: 14 → 256, two residual blocks 256 → 128 → 256, 256 → 3 and a sigmoid.

    All but the last layer have a leaky ReLU, which in a block follows the sum.
    """

    def __init__(self, generator: torch.Generator | None = None):
        super().__init__()
        layers = [nn.Linear(a, b) for a, b in pairwise(WIDTHS)]
        with torch.no_grad():
            for layer in layers:
                bound = layer.in_features**-0.5
                layer.weight.uniform_(-bound, bound, generator=generator)
                layer.bias.uniform_(-bound, bound, generator=generator)
        self.layers = nn.ModuleList(layers)

    @property
    def flops(self) -> int:
        """Operations of one sample, a fused multiply-add counted as two."""
        return sum(2 * a * b for a, b in pairwise(WIDTHS)) + sum(WIDTHS[1:]) + 2 * 256

    def forward(self, inputs: Tensor) -> Tensor:
        first, *inner, last = self.layers
        x = _leaky(first(inputs.to(next(self.parameters()).dtype)))
        for narrow, wide in zip(inner[::2], inner[1::2], strict=True):
            x = _leaky(x + wide(_leaky(narrow(x))))
        return last(x).to(inputs.dtype).sigmoid()


def _leaky(x: Tensor) -> Tensor:
    """Leaky ReLU, within the range of halves, so later layers stay finite in any precision."""
    return functional.leaky_relu(x, LEAK).clamp(-HALF_MAX, HALF_MAX)


def coloured(answer: Tensor, colours: Tensor) -> Tensor:
    """Log radiance (n, 3) of the decoder's answers (n, 3): times a matrix, and plus an offset, of (n, 12)."""
    matrix, offset = colours.tensor_split([MATRIX], dim=1)
    return (answer[:, :, None] * matrix.unflatten(1, (3, 3))).sum(1) + offset
