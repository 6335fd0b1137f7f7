import numpy as np
import pytest

from bench.data.materials.renderer import render
from bench.data.materials.variations import variation


def test_a_number_always_gives_the_same_surface_and_no_two_are_alike():
    kinds, recipes = zip(*(variation(number) for number in range(48)), strict=True)
    assert set(kinds) == {"satin", "brushed-metal", "leather", "cable-knit", "patchwork"}
    assert [variation(number)[1] for number in range(48)] == list(recipes)
    assert len(set(recipes)) == 48


@pytest.mark.parametrize("number", range(16))
def test_each_is_a_sound_surface_that_wraps_around(number):
    maps = variation(number)[1].maps(number)
    steps = np.abs(maps.height - np.roll(maps.height, 1, 1)).mean(0)
    assert steps[0] <= 1.05 * steps[1:].max() + 1e-9
    zenith = np.array([[0, 0, 1]])
    assert render(maps, zenith, zenith, (8, 8)).std() > 0
