from typing import Any

import numpy as np
import pytest

from baselines.rainer2019 import Rainer2019
from bench.codec import Fit
from bench.conformance.check import tiny_btf
from bench.material import parameters
from bench.training import load_texture
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
