"""A rendered surface whose height is known, so that `relief` finds one."""

import numpy as np

from bench.btf import BTF, ArraySource
from bench.data.materials.maps import Maps
from bench.data.materials.renderer import render
from bench.directions.hemisphere import thin, ubo2003

SIZE = 16


def bumps(amplitude: float = 0.06, views: int = 13, lights: int = 9, size: int = SIZE) -> tuple[BTF, np.ndarray]:
    """A rendered waves-and-spots surface and its true height (H, W), of which the mean is 0."""
    rng = np.random.default_rng(3)
    v, u = 2 * np.pi * (np.mgrid[: 8 * size, : 8 * size] + 0.5) / (8 * size)
    height = amplitude * (np.sin(u) * np.sin(v))
    colour = np.kron(rng.uniform(0.1, 0.9, (size, size, 3)), np.ones((8, 8, 1)))
    maps = Maps(height=height, base_colour=colour, roughness=0.8, specular=0.3)
    directions = ubo2003()
    wo, wi = directions[thin(directions, views)], directions[thin(directions, lights)]
    wo, wi = np.repeat(wo, lights, 0), np.tile(wi, (views, 1))
    values = render(maps, wo, wi, (size, size))
    truth = height.reshape(size, 8, size, 8).mean((1, 3))
    return BTF("bumps", wo, wi, ArraySource(values), periodic=True), truth - truth.mean()
