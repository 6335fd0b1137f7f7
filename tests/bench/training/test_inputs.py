import numpy as np
import pytest
import torch

from bench.hemisphere import uniform
from bench.training.inputs import COUNTS, Directions, direction_inputs


@pytest.mark.parametrize("kind", COUNTS)
def test_inputs_are_as_many_as_they_are_said_to_be(kind: Directions) -> None:
    wo = torch.tensor([[0.6, 0.0, 0.8], [0.0, 0.0, 1.0]])
    wi = torch.tensor([[0.0, 0.6, 0.8], [0.0, -0.8, 0.6]])
    seen = torch.cat(direction_inputs(wo, wi, kind), 1)
    assert seen.shape == (2, COUNTS[kind])
    assert seen[0, :2].tolist() == wo[0, :2].tolist()


def test_the_half_vector_lies_between_both() -> None:
    rng = np.random.default_rng(1)
    wo, wi = (torch.from_numpy(uniform(rng, 50)).float() for _ in range(2))
    half = direction_inputs(wo, wi, "xyzh")[1][:, 3:]
    torch.testing.assert_close(half.norm(dim=1), torch.ones(50))
    torch.testing.assert_close((half * wo).sum(1), (half * wi).sum(1))


def test_directions_that_cancel_have_some_finite_half_vector() -> None:
    wo = torch.tensor([[1.0, 0.0, 1e-20]])
    assert torch.cat(direction_inputs(wo, -wo, "xyzh"), 1).isfinite().all()
