import numpy as np
import pytest
import torch

from bench.training.decoder import Decoder
from neubtf.renderer import NeuBTFMaterial, RendererSettings
from neubtf.seam import FRONTAL, Seam, seam_of

ONE = RendererSettings(latents=1, layers=1, width=1)


class Shown(NeuBTFMaterial):
    """A material that shows its only channel, whatever the directions."""

    def __init__(self, picture: np.ndarray):
        texture = torch.from_numpy(picture).float()[..., None]
        super().__init__(Decoder(ONE.architecture), texture, 8.0, ONE.directions)  # an exposure of 1

    def evaluate(self, uv, wo, wi, footprint):
        from bench.material import sample_texture

        return sample_texture(self.texture, uv).expand(-1, 3)


def ratios(picture: np.ndarray) -> tuple[Seam, Seam]:
    return seam_of(Shown(picture), FRONTAL)


def test_a_texture_in_periods_of_cells_has_no_seam() -> None:
    cell = np.random.default_rng(0).uniform(0, 1, (4, 4))
    for seam in ratios(np.tile(cell, (3, 5))):
        assert seam.of_mean == pytest.approx(1, abs=1e-4)
        assert seam.of_largest == pytest.approx(1, abs=1e-4)


def test_a_step_at_the_border_is_a_seam_at_that_border_alone() -> None:
    cell = np.random.default_rng(0).uniform(0.2, 0.3, (4, 4))
    beside, below = ratios(np.tile(cell, (3, 5)) + np.linspace(0, 0.5, 20))
    assert beside.of_largest > 3
    assert below.of_largest == pytest.approx(1, abs=0.01)
