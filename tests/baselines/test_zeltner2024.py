from typing import Any

import numpy as np
import pytest
import torch

from baselines.zeltner2024 import Zeltner2024
from bench import hemisphere
from bench.btf import BTF, ArraySource
from bench.codec import Fit
from bench.conformance.check import tiny_btf
from bench.errors import InputError
from bench.material import parameters
from bench.training import load_texture


def codec(**settings: Any) -> Zeltner2024:
    return Zeltner2024(**{"steps": 10, "batch": 256} | settings)


# 20 → 32 → 32 → 3 with biases is 1,827 numbers, 8 → 12 without is 96. Our half vector adds 6 inputs; without frames the
# directions are 6 or 9 numbers, not 12 or 18.
@pytest.mark.parametrize(
    ("settings", "count"),
    [
        ({"recipe": "paper"}, 1_923),
        ({}, 2_115),
        ({"recipe": "paper", "frames": 0}, 1_635),
        ({"frames": 0}, 1_731),
        ({"recipe": "paper", "frames": 1}, 1_683),
    ],
)
def test_the_decoder_is_the_published_one(settings: dict[str, Any], count: int) -> None:
    ours = codec(**{"steps": 2} | settings)
    parts = ours.encode(tiny_btf(), Fit())
    material = ours.decode(parts, torch.device("cpu"))
    assert parts.decoder["weights"].shape == (count,)
    assert load_texture("latents", parts.texture).shape == (8, 8, 8)
    assert parameters(material) == material.cost.parameters == count


def oracle(weights: np.ndarray, latents: np.ndarray, wo: np.ndarray, wi: np.ndarray, halfway: bool) -> np.ndarray:
    """The equations of section 4 for one query, loop by loop: log radiance (3,)."""
    take = iter(weights.tolist())

    def matrix(rows: int, cols: int) -> np.ndarray:
        return np.array([[next(take) for _ in range(cols)] for _ in range(rows)])

    axes = matrix(12, 8) @ latents
    inputs = 8 + (18 if halfway else 12)
    layers = []
    for rows, cols in ((32, inputs), (32, 32), (3, 32)):
        layers.append((matrix(rows, cols), matrix(1, rows)[0]))
    h = (wo + wi) / np.linalg.norm(wo + wi)
    x = list(latents)
    for w in [wo, wi, h] if halfway else [wo, wi]:
        for frame in (axes[:6], axes[6:]):
            n, t = np.add(frame[:3], [0, 0, 1]), np.add(frame[3:], [1, 0, 0])
            n, t = n / np.sqrt(n @ n), t / np.sqrt(t @ t)
            x += [w @ t, w @ np.cross(n, t), w @ n]
    x = np.array(x)
    for depth, (weight, bias) in enumerate(layers):
        x = weight @ x + bias
        if depth < 2:
            x = np.where(x > 0, x, 0.01 * x)
    return x


@pytest.mark.parametrize("halfway", [True, False])
def test_a_decoded_file_answers_as_the_equations(halfway: bool) -> None:
    ours = codec(steps=30, halfway=halfway, bits=32, weights="float32")
    parts = ours.encode(tiny_btf(), Fit())
    material, gain = ours.decode(parts, torch.device("cpu")), float(parts.other["gain"])
    wo, wi = hemisphere.from_degrees(50.0, 20.0), hemisphere.from_degrees(35.0, 140.0)
    found = material.slice(wo.tolist(), wi.tolist())
    weights = parts.decoder["weights"].double().numpy()
    for row, col in ((0, 0), (3, 5), (7, 2)):
        latents = parts.texture["latents"][row, col].double().numpy()
        level = oracle(weights, latents, wo.astype(float), wi.astype(float), halfway)
        # Float32 sums of some tens of terms.
        np.testing.assert_allclose(found[row, col], np.expm1(level).clip(0) / gain, rtol=1e-4, atol=1e-5)


def test_the_first_frames_are_the_surface_s_own() -> None:
    """Latents of 0 leave the normal at z and the tangent at x, so that turned directions are the directions."""
    network = codec().decode(codec(steps=1).encode(tiny_btf(), Fit()), torch.device("cpu")).network
    directions = torch.tensor([[[0.6, 0.0, 0.8], [0.0, -0.6, 0.8]]])
    turned = network.frames.turned(torch.zeros(1, 8), directions)
    torch.testing.assert_close(turned.reshape(2, 2, 3), directions[0][:, None].expand(2, 2, 3))


def turned_lobes() -> BTF:
    """Texels with one lobe each, about a normal of its own: what frames are for."""
    like, rng = tiny_btf(), np.random.default_rng(0)
    normal = np.concatenate([rng.uniform(-0.4, 0.4, (8, 8, 2)), np.ones((8, 8, 1))], 2)
    normal /= np.linalg.norm(normal, axis=2, keepdims=True)
    h = like.wo + like.wi
    h /= np.linalg.norm(h, axis=1, keepdims=True)
    lobe = np.einsum("hwc,nc->nhw", normal, h).clip(0) ** 40
    return BTF("lobes", like.wo, like.wi, ArraySource(np.repeat(lobe[..., None], 3, 3).astype(np.float32)))


def test_frames_come_nearer_to_lobes_that_turn() -> None:
    errors = []
    for frames in (0, 2):
        fit = Fit()
        codec(steps=300, batch=512, frames=frames).encode(turned_lobes(), fit)
        errors.append(-fit.history[-1]["psnr"])
    assert errors[1] < errors[0] - 0.5


@pytest.mark.parametrize("recipe", ["ours", "paper"])
def test_it_comes_near_the_data(recipe: str) -> None:
    fit = Fit()
    codec(steps=300, batch=512, recipe=recipe).encode(tiny_btf(), fit)
    assert fit.history[-1]["psnr"] > 25


@pytest.mark.parametrize("setting", ["latents", "width", "layers", "batch"])
def test_settings_without_sense_are_refused(setting: str) -> None:
    with pytest.raises(InputError, match=r"a whole number (≥|from) 1"):
        codec(**{setting: 0})


def test_a_texture_that_does_not_fit_the_network_is_refused() -> None:
    ours = codec(steps=2, bits=32)
    parts = ours.encode(tiny_btf(), Fit())
    parts.texture["latents"] = parts.texture["latents"][..., :7]
    with pytest.raises(ValueError, match="7 channels"):
        ours.decode(parts, torch.device("cpu"))
