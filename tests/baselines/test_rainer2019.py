from typing import Any

import numpy as np
import pytest

from baselines.rainer2019 import Rainer2019
from bench.codec import Fit
from bench.conformance.check import tiny_btf
from bench.inputs.errors import InputError


def codec(**settings: Any) -> Rainer2019:
    return Rainer2019(**{"steps": 10, "texels": 8, "pairs": 8} | settings)


def test_the_further_channels_are_mean_and_deviation_of_each_texel() -> None:
    btf = tiny_btf()
    parts = codec(bits=32).encode(btf, Fit())
    logs = np.log1p(parts.other["gain"].numpy() * np.stack(list(btf)))
    # The fit holds the data as half floats: 5e-4 of each value.
    np.testing.assert_allclose(parts.texture["latents"][..., 8:11], logs.mean(0), rtol=1e-3)
    np.testing.assert_allclose(parts.texture["latents"][..., 11:], logs.std(0), rtol=2e-3)


def test_errors_as_displayed_are_for_free_latents() -> None:
    shown = codec(loss="display").encode(tiny_btf(), Fit())
    plain = codec().encode(tiny_btf(), Fit())
    assert any(not shown.decoder[name].equal(plain.decoder[name]) for name in plain.decoder)
    with pytest.raises(InputError, match=r"start=encoder .*loss"):
        codec(start="encoder", loss="display")
