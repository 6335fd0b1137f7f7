import dataclasses

import numpy as np
import pytest
import torch

from bench.btf import BTF, ArraySource
from bench.codec import Fit
from bench.conformance.check import tiny_btf
from bench.training.initial_latents import COMPONENT_SPREAD, MIXED_SPREAD, RANDOM_SPREAD, components, first_latents
from bench.training.samples import Samples, gain_of


@pytest.fixture(scope="module")
def btf() -> BTF:
    return tiny_btf()


def whitened(btf: BTF, gain: float, count: int) -> np.ndarray:
    """The scores of the log ABRDFs on their components, by a singular value decomposition of all of them."""
    rows = np.log1p(gain * np.stack(list(btf))).transpose(1, 2, 0, 3).reshape(btf.shape[0] * btf.shape[1], -1)
    left = np.linalg.svd(rows - rows.mean(0), full_matrices=False)[0][:, :count]
    return left * len(left) ** 0.5


@pytest.mark.parametrize("memory_limit", [1 << 20, 0], ids=["kept", "streamed"])
def test_latents_start_at_whitened_principal_components(btf: BTF, memory_limit: int) -> None:
    gain = gain_of(btf, Fit())
    samples = Samples(btf, gain, Fit(), memory_limit)
    latents = first_latents(samples, 3, "components", Fit().generator())
    assert latents.shape == (64, 3)
    truth = whitened(btf, gain, 3)
    # The sign of a component is free; half floats of the samples turn components a little into each other.
    turn = latents.numpy().T @ truth / (COMPONENT_SPREAD * 64)
    np.testing.assert_allclose(np.abs(turn), np.eye(3), atol=0.02)
    torch.testing.assert_close(latents.mean(0), torch.zeros(3), atol=1e-5, rtol=0)
    mixed = first_latents(samples, 3, "mixed", Fit().generator()) / MIXED_SPREAD
    alone = first_latents(samples, 3, "components", Fit().generator()) / COMPONENT_SPREAD
    noise = first_latents(samples, 3, "random", Fit().generator()) / RANDOM_SPREAD
    torch.testing.assert_close(mixed, alone + noise)


def test_channels_beyond_the_rank_are_random(btf: BTF) -> None:
    shades = np.linspace(1, 2, len(btf), dtype=np.float32)[:, None, None, None]
    flat = BTF("flat", btf.wo, btf.wi, ArraySource(np.broadcast_to(shades, (len(btf), 8, 8, 3))))
    samples = Samples(flat, 1.0, Fit())
    assert components(samples, 4, Fit().generator()).shape == (64, 0)
    latents = first_latents(samples, 4, "mixed", Fit().generator())
    assert torch.equal(latents, first_latents(samples, 4, "random", Fit().generator()))
    assert 0.05 < latents.std() < 0.2


def test_a_scene_weighs_the_pairs(btf: BTF) -> None:
    @dataclasses.dataclass
    class OnePair:
        weights: torch.Tensor

    samples = Samples(btf, 4.0, Fit())
    weights = torch.full((len(btf),), 1e-6)
    weights[5] = 1.0
    samples.density = OnePair(weights)  # type: ignore[assignment]
    score = components(samples, 1, Fit().generator())[:, 0]
    shown = samples.slices(torch.tensor([5])).mean((1, 2))
    assert abs(np.corrcoef(score, shown)[0, 1]) > 0.9
