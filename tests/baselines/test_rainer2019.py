from typing import Any

import numpy as np
import pytest
import torch

from baselines.rainer import LEAST_DEVIATION
from baselines.rainer2019 import Free, Rainer2019
from bench.btf import BTF
from bench.codec import Fit, Parts
from bench.conformance.check import tiny_btf
from bench.training import Samples, gain_of
from tests.baselines.made import at_tiny_pairs, table


def codec(**settings: Any) -> Rainer2019:
    return Rainer2019(**{"steps": 10, "texels": 8, "pairs": 8} | settings)


def logs_of(btf: BTF, parts: Parts) -> np.ndarray:
    logs: np.ndarray = np.log1p(parts.other["gain"].numpy() * table(btf))
    return logs


@pytest.mark.parametrize("settings", [{"start": "encoder"}, {"statistics_rate": 0.0}], ids=str)
def test_the_further_channels_are_mean_and_deviation_of_each_texel(settings: Any) -> None:
    btf = tiny_btf()
    parts = codec(bits=32, **settings).encode(btf, Fit())
    logs = logs_of(btf, parts)
    # The fit holds the data as half floats: 5e-4 of each value.
    np.testing.assert_allclose(parts.texture["latents"][..., 8:11], logs.mean(0), rtol=1e-3)
    np.testing.assert_allclose(parts.texture["latents"][..., 11:], logs.std(0), rtol=2e-3)


def test_our_recipe_fits_them_from_there_on() -> None:
    btf = tiny_btf()
    parts = codec(bits=32, statistics_rate=1e-3).encode(btf, Fit())
    logs = logs_of(btf, parts)
    for channels, measured in ((slice(8, 11), logs.mean(0)), (slice(11, 14), logs.std(0))):
        away = np.abs(parts.texture["latents"][..., channels].numpy() - measured)
        # Ten steps of at most 1e-3 each, but for Adam's first ones and the halves in which the fit holds the data.
        assert 1e-4 < away.max() < 0.02


def test_a_deviation_that_falls_below_the_least_is_stored_as_the_least_and_can_rise() -> None:
    btf, fit = at_tiny_pairs(np.full((81, 8, 8, 3), 0.5)), Fit()
    fitting = Free(Samples(btf, gain_of(btf, fit), fit), codec().settings, fit)
    torch.testing.assert_close(fitting.whole()[:, 11:], torch.full((64, 3), LEAST_DEVIATION))
    with torch.no_grad():
        fitting.statistics[:, 1] = -0.1
    deviation = fitting.whole()[:, 11:]
    torch.testing.assert_close(deviation, torch.full((64, 3), LEAST_DEVIATION))
    deviation.sum().backward()  # type: ignore[no-untyped-call]
    assert fitting.statistics.grad is not None
    assert (fitting.statistics.grad[:, 1] == 1).all()


def test_a_step_of_ours_draws_as_many_samples_as_that_of_other_codecs() -> None:
    ours, paper = Rainer2019().settings, Rainer2019(recipe="paper").settings
    assert ours.texels * ours.pairs == 4_096
    assert (paper.texels, paper.pairs) == (64, 32)
