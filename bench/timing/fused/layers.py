"""A fitted network as the layers that a fast kernel computes, folded in float64.

Two things are folded: the mean that a layer norm subtracts, into the weights before it (Wx + b − mean = (W − mean of
W's rows) x + b − mean of b); and the sine's frequency, into the layer before it, so that the sine is of turns t:
sin(2π t).
"""

import math
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.polynomial import Polynomial
from numpy.polynomial.chebyshev import Chebyshev
from torch import Tensor, nn

from bench.btf import Array
from bench.training.decoder import Activation, Decoder

SINE_TERMS = 6  # of the polynomial in place of a sine: its error is 2e-7


@dataclass(frozen=True)
class Norm:
    """x → x · gain / √(mean of x² + eps) + offset, for x with mean 0."""

    gain: Array  # (width,)
    offset: Array  # (width,)
    eps: float


@dataclass(frozen=True)
class Layer:
    """x → weight · x + bias → norm → activation (a sine takes turns) → + x if `residual`. All float64."""

    weight: Array  # (outputs, inputs)
    bias: Array  # (outputs,)
    norm: Norm | None = None
    activation: Activation | None = None
    residual: bool = False


def layers_of(decoder: Decoder) -> list[Layer]:
    """The folded layers of a network, including the linear layer at its end."""
    architecture = decoder.architecture
    # The factor that turns radians into turns, times the sine's frequency; 1 for other activations.
    turn = architecture.omega / (2 * math.pi) if architecture.activation == "sine" else 1.0
    layers = []
    *hidden, last = [(_numbers(linear.weight), _numbers(linear.bias)) for linear in decoder.layers]
    for depth, (weight, bias) in enumerate(hidden):
        norm = None
        if decoder.norms is not None:
            layer_norm = decoder.norms[depth]
            assert isinstance(layer_norm, nn.LayerNorm)
            # A norm cancels a factor before it, so the factor goes into the norm's own gain and offset.
            norm = Norm(_numbers(layer_norm.weight) * turn, _numbers(layer_norm.bias) * turn, layer_norm.eps)
            weight = weight - weight.mean(0)
            bias = bias - bias.mean()
        else:
            weight = weight * turn
            bias = bias * turn
        residual = architecture.residual and weight.shape[0] == weight.shape[1]
        layers.append(Layer(weight, bias, norm, architecture.activation, residual))
    return [*layers, Layer(*last)]


def _numbers(tensor: Tensor | nn.Module) -> Array:
    """A parameter as float64 on the CPU; typed wider, because PyTorch types a network's attributes so."""
    assert isinstance(tensor, Tensor)
    return tensor.detach().cpu().double().numpy()


@cache
def sine_coefficients() -> tuple[float, ...]:
    """The `SINE_TERMS` coefficients c_0, c_1, … of sin(2π t) ≈ Σ c_i t^(2i + 1) for |t| ≤ ½, t in turns.

    They are a polynomial in s = t², fitted to sin(2π √s) / √s at Chebyshev's points of [0, ¼], which is nearly the best
    one.
    """
    s = (1 + np.cos((2 * np.arange(200) + 1) * np.pi / 400)) / 8  # 200 points of [0, ¼]
    t = np.sqrt(s)
    fitted = Chebyshev.fit(s, np.sin(2 * np.pi * t) / t, deg=SINE_TERMS - 1, domain=[0, 0.25])
    return tuple(map(float, fitted.convert(kind=Polynomial).coef))
