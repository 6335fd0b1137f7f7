from typing import Any

import numpy as np
import pytest
import torch
from scipy.ndimage import convolve1d

from baselines.hierarchical import Hierarchical, HierarchicalMaterial, HierarchicalObjective, gradients
from baselines.neumip import YUV_TO_RGB, level_count
from bench.btf import BTF, ArraySource
from bench.codec import Fit, Parts
from bench.conformance.check import tiny_btf
from bench.directions import hemisphere
from bench.training import Samples, gain_of
from bench.training import fitting as training
from tests.baselines.made import bilinear, coded

SMALL = {"steps": 10, "batch": 256}
EXACT = {"bits": 32, "weights": "float32"}


@pytest.fixture(autouse=True)
def few_samples(monkeypatch: pytest.MonkeyPatch) -> None:
    """An answer is computed from 81 places, so a curve and the choice of bits take seconds."""
    monkeypatch.setattr(training, "PROBE", 512)
    monkeypatch.setattr(training, "ROUNDING_SAMPLES", 256)


def fitted(btf: BTF | None = None, **settings: Any) -> tuple[HierarchicalMaterial, Parts]:
    parts, material = coded(Hierarchical(**SMALL | settings), btf or tiny_btf())
    assert isinstance(material, HierarchicalMaterial)
    return material, parts


class Oracle:
    """The equations in NumPy, of one query, from the tensors of a file."""

    def __init__(self, parts: Parts, settings: Any):
        self.settings, self.gain = settings, float(parts.other["gain"])
        self.size = height, width = tuple(parts.other["size"].tolist())
        self.flat = parts.decoder["weights"].double().numpy()
        self.at = 0
        directions = {"xy": 4, "xyzh": 9}[settings.directions] * max(1, 2 * settings.octaves)
        self.first = self._layer(directions + 4 * settings.places + 7, 25)
        shapes = (25, 7), (25, 12), (9 * 12, 12), (25, 3), (25 * 3, 3), (25, 3)
        self.modules = [[self._layer(*shape) for shape in shapes] for _ in range(2)]
        self.last = self._layer(25, 3)
        self.moving = [self._layer(*shape) for shape in ((9, 25), (25, 25), (25, 25), (25, 1))]
        assert self.at == len(self.flat)
        self.offset = parts.texture["offset"].double().numpy().reshape(height, width, 7)
        self.pyramid, table = [], parts.texture["pyramid"].double().numpy()
        for level in range(level_count(self.size)):
            h, w = height >> level, width >> level
            self.pyramid.append(table[: h * w].reshape(h, w, 7))
            table = table[h * w :]
        assert not len(table)

    def _layer(self, inputs: int, outputs: int) -> tuple[np.ndarray, np.ndarray]:
        weight = self.flat[self.at : self.at + inputs * outputs].reshape(outputs, inputs)
        bias = self.flat[self.at + inputs * outputs :][:outputs]
        self.at += (inputs + 1) * outputs
        return weight, bias

    def seen(self, u: float, v: float, wo: np.ndarray, level: float) -> np.ndarray:
        """The place and the latents at one point: sines of u, cosines of u … are in the order of the file."""
        octaves = np.arange(self.settings.places)
        share = np.clip(np.log2(max(self.size)) - level - octaves, 0, 1)
        angles = [np.pi * 2.0**octaves * (2 * x - 1) for x in (u, v)]
        place = np.concatenate([share * f(angle) for f in (np.sin, np.cos) for angle in angles])
        x = np.concatenate([bilinear(self.offset, u, v), wo[:2]])
        for i, (weight, bias) in enumerate(self.moving):
            x = weight @ x + bias
            x = x.clip(0) if i < 3 else x
        height, width = self.size  # the offset is a length on the surface, in its longer side
        du, dv = 0.05 * np.tanh(x[0]) * wo[:2] / max(wo[2], 0.6) * max(self.size) / np.array([width, height])
        low = int(level)
        upper = min(low + 1, len(self.pyramid) - 1)
        fine, coarse = (bilinear(self.pyramid[i], u + du, v + dv) for i in (low, upper))
        return np.concatenate([place, (1 - level + low) * fine + (level - low) * coarse])

    def answer(self, u: float, v: float, wo: np.ndarray, wi: np.ndarray, footprint: float) -> np.ndarray:
        half = (wo + wi) / np.linalg.norm(wo + wi)
        numbers = np.concatenate([wo, wi, half] if self.settings.directions == "xyzh" else [wo[:2], wi[:2]])
        if self.settings.octaves:
            angle = np.pi * np.outer(numbers, 2.0 ** np.arange(self.settings.octaves)).ravel()
            numbers = np.concatenate([np.sin(angle), np.cos(angle)])
        level = np.clip(np.log2(max(footprint * max(self.size), 1)), 0, len(self.pyramid) - 1)
        height, width = self.size
        x = np.empty((25, 9, 9))
        for i in range(9):
            for j in range(9):
                there = u + (j - 4) * 2**level / width, v - (i - 4) * 2**level / height
                x[:, i, j] = self.first[0] @ np.concatenate([numbers, self.seen(*there, wo, level)]) + self.first[1]
        for point, to_three, three, to_five, five, pooled in self.modules:
            inner = x[:, 1:-1, 1:-1]
            maxima = np.lib.stride_tricks.sliding_window_view(inner, (3, 3), (1, 2)).max((3, 4))
            x = np.concatenate(
                [
                    convolved(x[:, 2:-2, 2:-2], point, 1),
                    convolved(convolved(inner, to_three, 1), three, 3),
                    convolved(convolved(x, to_five, 1), five, 5),
                    convolved(maxima, pooled, 1),
                ]
            )
        log = np.array(YUV_TO_RGB) @ (self.last[0] @ x[:, 0, 0] + self.last[1])
        radiance: np.ndarray = np.expm1(log).clip(0) / self.gain
        return radiance


def convolved(x: np.ndarray, layer: tuple[np.ndarray, np.ndarray], side: int) -> np.ndarray:
    windows = np.lib.stride_tricks.sliding_window_view(x, (side, side), (1, 2))
    kernel = layer[0].reshape(-1, len(x), side, side)
    sums: np.ndarray = np.einsum("chwij,dcij->dhw", windows, kernel) + layer[1][:, None, None]
    return sums.clip(0)


@pytest.mark.parametrize("recipe", ["ours", "paper"])
@pytest.mark.parametrize("size", [(8, 8), (5, 12)])
def test_a_decoded_file_answers_as_the_equations(recipe: str, size: tuple[int, int]) -> None:
    settings = {"recipe": recipe, "patch": 4, "rate": 0.01, "steps": 30}
    like = tiny_btf()
    values = np.random.default_rng(0).uniform(0, 1, (len(like), *size, 3)).astype(np.float32)
    material, parts = fitted(BTF("noise", like.wo, like.wi, ArraySource(values)), **settings, **EXACT)
    oracle = Oracle(parts, Hierarchical(**SMALL | settings).settings)
    rng = np.random.default_rng(1)
    uv, footprint = rng.random((6, 2)), np.array([0.0, 0.0, 1 / 12, 0.2, 0.3, 2.0])
    wo, wi = (hemisphere.uniform(rng, 6, 80.0).astype(float) for _ in range(2))
    found = material.query(*(x.astype(np.float32) for x in (uv, wo, wi, footprint)))
    expected = [oracle.answer(*uv[i], wo[i], wi[i], footprint[i]) for i in range(6)]
    assert np.ptp(expected) > 0.01
    # Float32 sums of hundreds of terms; a place is some 1e-6 of a texel off, of a network that bends sharply.
    np.testing.assert_allclose(found, expected, rtol=2e-3, atol=2e-4)


@pytest.mark.parametrize("level", [0, 1])
def test_a_patch_of_the_fit_is_what_its_texels_answer_one_by_one(level: int) -> None:
    btf, fit = tiny_btf(), Fit()
    codec = Hierarchical(**SMALL, patch=3, **EXACT)
    levels = Samples.levels(btf, 3, gain_of(btf, fit), fit)
    fitting = codec.objective(levels, codec.settings, fit.generator())
    assert isinstance(fitting, HierarchicalObjective)
    training.train(fitting, fit, 10)
    middle, wo, wi, _, target, pairs = fitting._patches(level, 5, fit.generator())
    with torch.no_grad():
        textures = fitting.textures(1.0)
        whole = torch.full((5,), level)
        patches = fitting.networks.pictures(fitting.pyramid, textures, (middle, wo, wi, whole), 3)
        for row in range(3):
            for col in range(3):
                away = torch.tensor([col - 1, 1 - row]) * 2**level / 8
                queries = middle + away, wo, wi, whole.float()
                alone = fitting.networks.pictures(fitting.pyramid, textures, queries)[:, 0, 0]
                torch.testing.assert_close(patches[:, row, col], alone, rtol=1e-3, atol=1e-4)
    # The targets are those of the same texels.
    side = 8 >> level
    for each in range(5):
        pair = int(((fitting.samples.wo == wo[each]) & (fitting.samples.wi == wi[each])).all(1).nonzero()[0])
        assert pair == pairs[each]
        col, row = (middle[each, 0] * side - 0.5).round().long(), ((1 - middle[each, 1]) * side - 0.5).round().long()
        truth = levels[level].slices(torch.tensor([pair]))[:, 0].unflatten(0, (side, side))
        wanted = truth.roll((1 - int(row), 1 - int(col)), (0, 1))[:3, :3]
        torch.testing.assert_close(target[each], wanted)


def test_gradients_are_sobels() -> None:
    picture = np.random.default_rng(0).standard_normal((2, 6, 6, 3))
    found = gradients(torch.from_numpy(picture)).unflatten(0, (2, 3)).numpy()
    for axis, direction in ((2, 0), (1, 1)):  # differences along columns, then rows
        smooth, along = [1.0, 2.0, 1.0], [-1.0, 0.0, 1.0]
        expected = convolve1d(convolve1d(picture, along, axis), smooth, 3 - axis)[:, 1:-1, 1:-1]
        np.testing.assert_allclose(np.moveaxis(found[:, :, direction], 1, -1), expected, atol=1e-12)


def test_the_loss_as_displayed_weights_each_direction_by_its_error() -> None:
    btf, fit = tiny_btf(), Fit()
    codec = Hierarchical(**SMALL, patch=3, loss="display", **EXACT)
    levels = Samples.levels(btf, 1, gain_of(btf, fit), fit)
    fitting = codec.objective(levels, codec.settings, fit.generator())
    assert fitting.display_loss is not None
    fitting.loss(fit.generator(), 1.0).backward()
    counted = fitting.display_loss.count  # texels that were drawn at each pair of directions
    assert counted.sum() == codec.settings.batch // 9 * 9
    assert all(texels % 9 == 0 for texels in counted)
    assert all(parameter.grad is not None for parameter in fitting.networks.parameters())
