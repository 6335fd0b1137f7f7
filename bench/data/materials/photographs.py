"""Reliefs from grey photographs in scikit-image; they are coloured and made periodic.

Each class is a recipe: its fields are parameters, and `maps` makes the surface of them. As in
`bench.data.materials.procedural`, whose noise is used, heights are in units of the tile's width, and a small factor
before noise is the deviation that it adds.
"""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates
from skimage import data

from bench.btf import Array
from bench.data.materials.maps import Maps, make_periodic, resize
from bench.data.materials.procedural import mix, normalised, smooth, srgb


def _detail(photograph: Array, margin: int, resolution: int, sigma: float) -> Array:
    """The fine structure of a photograph (H, W) of 8-bit codes, periodic (resolution, resolution).

    It is smoothed by a Gaussian of `sigma` texels, without its low frequencies, with zero mean and unit deviation, and
    clipped at ±2.5. `margin` is the overlap that makes it periodic, in pixels of the photograph.
    """
    periodic = make_periodic(photograph / 255.0, (margin, margin))
    grey = resize(periodic, (resolution, resolution))
    smoothed = gaussian_filter(grey, sigma, mode="wrap")
    detail = smoothed - gaussian_filter(smoothed, 30, mode="wrap")
    return np.clip((detail - detail.mean()) / detail.std(), -2.5, 2.5)


@dataclass(frozen=True)
class Brick:
    """Brickwork: recessed bright mortar, rough fired clay; the photograph's perspective is undone first."""

    resolution: int = 256
    height: float = 0.022
    roughness: float = 0.85
    clay_srgb: tuple[float, float, float] = (156, 78, 58)
    mortar_srgb: tuple[float, float, float] = (176, 168, 156)

    def maps(self, seed: int) -> Maps:
        """Bright texels of the photograph are mortar, which lies lower; noise varies the colour of both."""
        rng = np.random.default_rng(seed)
        wall = make_periodic(_rectified(data.brick() / 255.0), overlap=(16, 24))
        grey = resize(wall, (self.resolution, self.resolution))
        mortar = np.clip((grey - 0.45) / 0.12, 0, 1)  # clay is darker than 0.45, mortar brighter than 0.57
        mortar = mortar * mortar * (3 - 2 * mortar)  # a smooth step from clay, 0, to mortar, 1
        grain = smooth(rng, self.resolution, 0.004, 0.004)
        tone = smooth(rng, self.resolution, 0.06, 0.1)
        # The height: bricks stand out of the mortar, and a Gaussian of 1.2 texels rounds their edges.
        face = gaussian_filter(1 - mortar, 1.2, mode="wrap") + 0.025 * grain + 0.04 * tone
        colour = mix(srgb(*self.clay_srgb), srgb(*self.mortar_srgb), mortar)
        colour = colour * (1 + 0.15 * tone + 0.06 * grain)[..., None]
        return Maps(self.height * normalised(face), np.clip(colour, 0, 1), self.roughness, specular=0.5)


def _rectified(picture: Array) -> Array:
    """The wall (324, 400) with its long joints made parallel and level, cut at two joints that lie eight courses (rows
    of bricks) apart.

    `picture` is the photograph (512, 512). The numbers were found by trying: with these, the mean along the courses
    varies most from course to joint.
    """
    y, x = np.mgrid[0:400, 0:400] / 399.0  # from 0 to 1 over a result of 400 × 400
    row = 30 + 475 * y
    column = 223.4 + (x - 0.5) * 440 * (0.706 + 0.294 * row / 511)  # the photograph widens downwards
    wall = map_coordinates(picture, [row, column], order=1, mode="nearest")
    level = wall.T  # the long joints run down the photograph
    return level[33:357]


@dataclass(frozen=True)
class Gravel:
    """Loose gravel: the photograph's brightness as height, and as its shading."""

    resolution: int = 256
    height: float = 0.06
    roughness: float = 0.9
    stone_srgb: tuple[float, float, float] = (168, 160, 150)

    def maps(self, seed: int) -> Maps:
        """Bright stones lie high; the photograph also shades their colour."""
        rng = np.random.default_rng(seed)
        part = data.gravel()[200:450, 200:450]  # a part of 512 × 512 pixels, so that stones are large
        detail = _detail(part, margin=40, resolution=self.resolution, sigma=2)
        warm = 0.06 * smooth(rng, self.resolution, 0.02, 0.02)
        shade = 0.75 + 0.2 * detail  # dark between the stones
        tint = 1 + warm[..., None] * [1, 0, -1]  # redder where warm, else bluer
        colour = srgb(*self.stone_srgb) * shade[..., None] * tint
        return Maps(self.height * normalised(detail), np.clip(colour, 0.02, 1), self.roughness, specular=0.5)


@dataclass(frozen=True)
class Grass:
    """A lawn: bright blades stand over dark gaps."""

    resolution: int = 256
    height: float = 0.06
    roughness: float = 0.6
    blade_srgb: tuple[float, float, float] = (112, 148, 62)
    soil_srgb: tuple[float, float, float] = (58, 50, 30)

    def maps(self, seed: int) -> Maps:
        """Bright blades stand high, of a colour that turns to that of the soil below."""
        rng = np.random.default_rng(seed)
        part = data.grass()[20:276, 200:456]  # a part of 512 × 512 pixels, so that blades are large
        height = normalised(_detail(part, margin=48, resolution=self.resolution, sigma=1.5))
        dry = 0.12 * smooth(rng, self.resolution, 0.05, 0.05)
        colour = mix(srgb(*self.soil_srgb), srgb(*self.blade_srgb), np.clip(1.6 * height, 0, 1))
        colour = colour * (1 + dry[..., None] * [1, 0.2, -0.5])  # yellower where dry
        return Maps(self.height * height, np.clip(colour, 0, 1), self.roughness, specular=0.3)
