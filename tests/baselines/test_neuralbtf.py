from typing import Any

import numpy as np
import pytest
import torch

from baselines.neuralbtf import NeuralBTF, NeuralBTFObjective
from bench.codec import Fit, Parts
from bench.conformance.check import tiny_btf
from bench.directions import hemisphere
from bench.training import Samples, gain_of
from tests.baselines.made import bilinear, coded, cropped, dense, split


def codec(**settings: Any) -> NeuralBTF:
    return NeuralBTF(**{"steps": 10, "batch": 256, "width": 32} | settings)


def basis(x: float, y: float, z: float) -> list[float]:
    """The harmonics of degrees 0 to 2 in the order and with the signs of tiny-cuda-nn, its constants in decimals."""
    first = [0.28209479, -0.48860251 * y, 0.48860251 * z, -0.48860251 * x]
    second = [1.09254843 * x * y, -1.09254843 * y * z, 0.9461747 * z * z - 0.31539157, -1.09254843 * x * z]
    return [*first, *second, 0.54627422 * (x * x - y * y)]


def answer(parts: Parts, recipe: str, uv: np.ndarray, wo: np.ndarray, wi: np.ndarray) -> np.ndarray:
    """Radiance (3,) of one query of a file with networks of width 32, from its floats."""
    count = 24 + (18 if recipe == "paper" else 9)
    shapes = dense((32, count), (32, 32), (32, 32), (3, 32), (32, 11), (2, 32))
    (gate,), *network, w1, b1, w2, b2 = split(parts.decoder["weights"], (1,), *shapes)  # a module's own come first
    assert gate != 0
    textures = {name: parts.texture[name].double().numpy() for name in ("level0", "level1", "level2", "offset")}
    features = np.concatenate([bilinear(textures["offset"], *uv), wo])
    u, v = uv + gate * np.tanh(w2 @ (w1 @ features + b1).clip(0) + b2)
    x = np.concatenate([bilinear(textures[f"level{level}"], u, v) for level in range(3)])
    h = (wo + wi) / np.linalg.norm(wo + wi)
    x = np.concatenate([x, *([basis(*(2 * w - 1)) for w in (wi, wo)] if recipe == "paper" else [wo, wi, h])])
    for depth in range(4):
        x = network[2 * depth] @ x + network[2 * depth + 1]
        x = x.clip(0) if depth < 3 else x
    gain = float(parts.other["gain"])
    return (8 * x if recipe == "paper" else np.expm1(x)).clip(0) / gain


@pytest.mark.parametrize("recipe", ["ours", "paper"])
def test_a_decoded_file_answers_as_the_equations(recipe: str) -> None:
    parts, material = coded(codec(steps=60, recipe=recipe, bits=32, weights="float32"), cropped(7, 5))
    rng = np.random.default_rng(0)
    uv = rng.uniform(0, 1, (20, 2)).astype(np.float32)
    wo, wi = (hemisphere.uniform(rng, 20, 80.0).astype(np.float32) for _ in range(2))
    expected = [
        answer(parts, recipe, *(each.astype(float) for each in query)) for query in zip(uv, wo, wi, strict=True)
    ]
    # Float32 sums of some tens of terms.
    np.testing.assert_allclose(material.query(uv, wo, wi), expected, rtol=1e-3, atol=3e-5)


def test_at_first_nothing_is_moved_and_as_published_the_textures_are_next_to_nothing() -> None:
    btf, fit = tiny_btf(), Fit()
    for recipe in ("ours", "paper"):
        fitting = NeuralBTFObjective(
            Samples(btf, gain_of(btf, fit), fit), codec(recipe=recipe).settings, fit.generator()
        )
        assert fitting.network.gate.item() == 0
        assert [fitting.rate(step, 100, 0) for step in (0, 50, 99)] == (
            [1.0] * 3 if recipe == "paper" else [pytest.approx(each, abs=1e-2) for each in (1 / 11, 0.5, 0.0)]
        )
        if recipe == "paper":
            assert 5e-5 < max(fitting.textures[f"level{level}"].abs().max().item() for level in range(3)) <= 1e-4
            assert not fitting.textures["offset"].any()


def test_the_published_loss_is_relative_to_the_answer() -> None:
    btf, fit = tiny_btf(), Fit()
    gain = gain_of(btf, fit)
    fitting = NeuralBTFObjective(Samples(btf, gain, fit), codec(recipe="paper", batch=64).settings, fit.generator())
    batch = fitting.samples.draw(64, torch.Generator().manual_seed(3))
    row, col = np.divmod(batch.texel.numpy(), 8)
    truth = btf.gather(batch.pair.numpy(), row, col).clip(0) * gain / 8
    found = fitting.network.decoder.layers[-1].bias.detach().numpy()  # what a network without weights answers
    expected = ((found - truth) ** 2 / (found**2 + 0.01)).mean()
    # The suite keeps log radiance in halves, of 11 bits.
    assert fitting.loss(torch.Generator().manual_seed(3), 0.0).item() == pytest.approx(expected, rel=5e-3)
