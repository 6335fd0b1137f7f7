import numpy as np
import pytest
import torch

from bench.directions.hemisphere import uniform
from bench.training.inputs import COUNTS, Directions, direction_inputs


@pytest.mark.parametrize("kind", COUNTS)
def test_inputs_are_as_many_as_they_are_said_to_be_and_the_half_vector_lies_between_both(kind: Directions) -> None:
    wo, wi = (torch.from_numpy(uniform(np.random.default_rng(seed), 50)).float() for seed in (1, 2))
    parts = direction_inputs(wo, wi, kind)
    seen = torch.cat(parts, 1)
    assert seen.shape == (50, COUNTS[kind])
    assert torch.equal(seen[:, :2], wo[:, :2])
    if kind == "xyzh":
        half = parts[1][:, 3:]
        torch.testing.assert_close(half.norm(dim=1), torch.ones(50))
        torch.testing.assert_close((half * wo).sum(1), (half * wi).sum(1))
    wo = torch.tensor([[1.0, 0.0, 1e-20]])  # directions that cancel
    assert torch.cat(direction_inputs(wo, -wo, kind), 1).isfinite().all()
