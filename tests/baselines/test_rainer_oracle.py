from itertools import pairwise

import numpy as np
import pytest
import torch

from baselines.rainer import Encoder
from baselines.rainer2019 import EncodedLatents, Rainer2019
from baselines.rainer2020 import Rainer2020, Rainer2020Network
from bench.codec import Fit
from bench.codecs import shared
from bench.conformance.check import others, tiny_btf
from bench.material import texel_centres
from bench.training import Samples
from bench.training.stored_network import to_vector
from tests.baselines.made import leaky, split

Array = np.ndarray
FLOAT32 = {"bits": 32, "weights": "float32"}


def encode(vector: Array, logs: Array, latents: int) -> Array:
    """Log ABRDF (N, 3) → latents: less its mean, over its deviation; three convolutions of stride 4; a linear layer."""
    x = ((logs - logs.mean(0)) / np.maximum(logs.std(0), 1e-3)).T
    sizes = [(16, 3, 7), (32, 16, 5), (64, 32, 5)]
    cells = len(logs)
    for _ in sizes:
        cells = -(-cells // 4)
    shapes = [shape for size in sizes for shape in (size, size[:1])]
    *convolutions, matrix, offset = split(vector, *shapes, (latents, 64 * cells), (latents,))
    for weight, bias in zip(convolutions[::2], convolutions[1::2], strict=True):
        out, _, kernel = weight.shape
        padded = np.pad(x, ((0, 0), (kernel // 2, kernel // 2)))
        starts = range(0, x.shape[1], 4)
        x = np.array([[(weight[o] * padded[:, s : s + kernel]).sum() + bias[o] for s in starts] for o in range(out)])
        x = leaky(x)
    return matrix @ x.ravel() + offset


def decode(vector: Array, channels: Array, wo: Array, wi: Array) -> Array:
    """gain · radiance of a texel: latents and two directions → four layers of 106 → mean + deviation · colour."""
    latents, mean, deviation = channels[:-6], channels[-6:-3], channels[-3:]
    x = np.concatenate([latents, wi[:2] / (1 + wi[2]), wo[:2] / (1 + wo[2])])
    sizes = [len(x), 106, 106, 106, 106, 3]
    shapes = [shape for a, b in pairwise(sizes) for shape in ((b, a), (b,))]
    *hidden, matrix, offset = split(vector, *shapes)
    for weight, bias in zip(hidden[::2], hidden[1::2], strict=True):
        x = leaky(weight @ x + bias)
    return np.expm1(mean + deviation * (matrix @ x + offset))


def compared(material: object, texture: Array, vector: Array, gain: float) -> None:
    """What a material answers at its texels, and what the equations do."""
    btf = tiny_btf()
    height, width = texture.shape[:2]
    some = np.arange(0, height * width, 7)
    uv = texel_centres(height, width)[some]
    pair = np.arange(len(some)) * 3 % len(btf)
    found = material.query(uv, torch.from_numpy(btf.wo[pair]), torch.from_numpy(btf.wi[pair]))  # type: ignore[attr-defined]
    channels = texture.reshape(height * width, -1)[some]
    each = zip(channels, btf.wo[pair], btf.wi[pair], strict=True)
    expected = np.maximum([decode(vector, *one) for one in each], 0) / gain
    np.testing.assert_allclose(found, expected, rtol=2e-4, atol=2e-5)


@pytest.mark.parametrize("pairs", [1, 25, 81])
def test_the_encoder_is_three_convolutions_and_a_linear_layer(pairs: int) -> None:
    encoder = Encoder(pairs, 8, torch.Generator().manual_seed(1))
    logs = np.random.default_rng(0).random((3, pairs, 3)).astype(np.float32)
    normalised = (logs - logs.mean(1, keepdims=True)) / np.maximum(logs.std(1, keepdims=True), 1e-3)
    with torch.no_grad():
        found = encoder(torch.from_numpy(normalised))
    expected = [encode(to_vector(encoder).numpy(), one.astype(np.float64), 8) for one in logs]
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-5)


def test_rainer2019_is_its_equations() -> None:
    btf, fit = tiny_btf(), Fit()
    codec = Rainer2019(recipe="paper", steps=20, texels=8, pairs=8, **FLOAT32)
    parts = codec.encode(btf, fit)
    material = codec.decode(parts, torch.device("cpu"))
    gain = float(parts.other["gain"])
    compared(material, parts.texture["latents"].numpy(), parts.decoder["weights"].numpy(), gain)
    # The latents of a fit that did no step are those of the encoder that it starts with.
    fitting = EncodedLatents(Samples(btf, gain, fit), codec.settings, fit)
    logs = np.log1p(gain * btf.texels([0, 3], [1, 5]).astype(np.float64))
    expected = [encode(to_vector(fitting.encoder).numpy(), one, 8) for one in logs]
    # The fit holds its data as halves.
    np.testing.assert_allclose(fitting.encode(torch.tensor([1, 3 * 8 + 5])), expected, rtol=0.02, atol=0.01)


def test_rainer2020_is_its_equations(tmp_path_factory: pytest.TempPathFactory) -> None:
    path = tmp_path_factory.mktemp("shared") / "rainer2020.nbtf"
    maker = Rainer2020Network(steps=60, texels=8, rate=1e-2, weights="float32")
    trained = shared.read(shared.make(maker, others(tiny_btf()), Fit(), path).path)
    btf = tiny_btf(views=25, lights=25)  # the canonical pairs: nothing is resampled
    codec = Rainer2020(bits=32)
    parts = codec.encode(btf, Fit(network=trained))
    texture, gain = parts.texture["latents"].numpy(), float(parts.other["gain"])
    compared(codec.decode(parts, torch.device("cpu")), texture, trained.parts.decoder["weights"].numpy(), gain)
    logs = np.log1p(gain * btf.texels([2], [6])[0].astype(np.float64))
    expected = encode(trained.parts.encoder["weights"].numpy(), logs, 32)
    np.testing.assert_allclose(texture[2, 6, :32], expected, rtol=0.02, atol=0.02)
