from typing import Any

import numpy as np
import pytest
import torch

from baselines.triple_plane import TriplePlane, half_and_difference
from bench.directions import hemisphere
from tests.baselines.made import coded, dense, fetch, oracle_difference, split


def codec(**settings: Any) -> TriplePlane:
    return TriplePlane(**{"steps": 10, "batch": 256} | settings)


@pytest.mark.parametrize("kind", ["rusinkiewicz", "nearest"])
def test_a_half_vector_at_the_zenith_is_no_trouble(kind: Any) -> None:
    zenith = torch.tensor([[0.0, 0.0, 1.0]])
    h, d = half_and_difference(zenith, zenith, kind)
    torch.testing.assert_close(torch.cat([h, d]), zenith.expand(2, 3))


@pytest.mark.parametrize("kind", ["rusinkiewicz", "nearest"])
def test_a_decoded_file_answers_as_the_equations(kind: str) -> None:
    parts, material = coded(codec(steps=30, difference=kind, bits=32, weights="float32"))
    gain = float(parts.other["gain"])
    wo, wi = hemisphere.from_degrees(50.0, 20.0), hemisphere.from_degrees(35.0, 140.0)
    found = material.slice(wo.tolist(), wi.tolist())
    h, d = oracle_difference(wo.astype(float), wi.astype(float), kind)
    seen = [fetch(plane.double().numpy(), w[0], w[1]) for plane, w in zip(parts.decoder["planes"], (h, d), strict=True)]
    network = split(parts.decoder["weights"], *dense((32, 24), (32, 32), (32, 32), (3, 32)))
    for row, col in ((0, 0), (3, 5), (7, 2)):
        x = np.concatenate([parts.texture["latents"][row, col].double().numpy(), *seen])
        for depth in range(4):
            x = network[2 * depth] @ x + network[2 * depth + 1]
            x = x.clip(0) if depth < 3 else x
        # Float32 sums of some tens of terms.
        np.testing.assert_allclose(found[row, col], np.expm1(x).clip(0) / gain, rtol=2e-4, atol=1e-5)
