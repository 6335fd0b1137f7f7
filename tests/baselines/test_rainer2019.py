from typing import Any

import numpy as np
import pytest
import torch

from baselines.rainer import Encoder
from baselines.rainer2019 import Encoded, Rainer2019
from bench.codec import Fit
from bench.conformance.check import tiny_btf
from bench.material import parameters
from bench.training import Samples, load_texture
from tests.baselines.made import coded


def codec(**settings: Any) -> Rainer2019:
    return Rainer2019(**{"steps": 10, "texels": 8, "pairs": 8} | settings)


@pytest.mark.parametrize(("recipe", "count"), [("paper", 35_725), ("ours", 35_725 + 5 * 106)])  # five inputs more
def test_the_decoder_is_the_published_one(recipe: str, count: int) -> None:
    parts, material = coded(codec(recipe=recipe))
    assert parts.decoder["weights"].shape == (count,)
    assert load_texture("latents", parts.texture).shape == (8, 8, 8 + 6)
    assert parameters(material) == material.cost.parameters == count
    assert material.cost.texture_channels == 14


def test_the_further_channels_are_mean_and_deviation_of_each_texel() -> None:
    btf = tiny_btf()
    parts = codec(bits=32).encode(btf, Fit())
    logs = np.log1p(parts.other["gain"].numpy() * np.stack(list(btf)))
    # The fit holds the data as half floats: 5e-4 of each value.
    np.testing.assert_allclose(parts.texture["latents"][..., 8:11], logs.mean(0), rtol=1e-3)
    np.testing.assert_allclose(parts.texture["latents"][..., 11:], logs.std(0), rtol=2e-3)


@pytest.mark.parametrize("pairs", [1, 2, 81, 625, 1000])
def test_the_encoder_takes_any_number_of_pairs(pairs: int) -> None:
    assert Encoder(pairs, 8, torch.Generator())(torch.zeros(3, pairs, 3)).shape == (3, 8)


def test_blocks_of_texels_encode_as_single_ones() -> None:
    btf, fit = tiny_btf(20), Fit()
    fitting = Encoded(Samples(btf, 1.0, fit), codec().settings, fit)
    texels = torch.arange(400)
    together = fitting.encode(texels)
    single = torch.cat([fitting.encode(texel[None]) for texel in texels[250:260]])
    torch.testing.assert_close(together[250:260], single, rtol=1e-5, atol=1e-5)
