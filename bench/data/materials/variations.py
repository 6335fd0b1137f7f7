"""Any number of training surfaces for shared networks, which are then measured on the built-in materials.

Half are four of the built-in recipes (satin, brushed metal, leather, cable-knit) with every parameter drawn at random.
The photographs (brick, gravel, grass) are left out, because another colour would not change their relief; hammered
copper and wicker are kept apart.
The other half are patchworks: two substances over a random relief. Number n is the same surface everywhere.

A *recipe* is a class of parameters that makes a material's maps; heights are in units of the tile's width.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from bench.btf import BTF
from bench.data.materials.maps import Maps, Recipe
from bench.data.materials.procedural import (
    BrushedMetal,
    CableKnit,
    Colour,
    Leather,
    Satin,
    mix,
    normalised,
    smooth,
    srgb,
)

SIZE = 32  # texels a side of a BTF
HELDOUT = 375  # random pairs of it
RESOLUTION = 128  # of the maps: at 32² texels, the relief is as coarse in texels as in the suites
Pair = tuple[float, float]  # of the first and the second substance, or along u and v


@dataclass(frozen=True)
class Patchwork:
    """Two substances, one of them in low places or scattered, over noise that is partly flattened to plateaus."""

    resolution: int
    height: float
    grain: Pair  # size of the hills along u and v, as shares of the tile's side
    detail: float  # how high are further hills of a quarter of that size, as a share of the first ones' height
    plateau: float  # 0: hills; 1: almost two levels
    low: float  # share of the mask that follows the height; the rest of it is noise
    cover: float  # the value of the mixed height and noise, from 0 to 1, about which the substances change
    srgb: tuple[Colour, Colour]
    roughness: Pair
    metalness: Pair
    specular: float
    anisotropy: float
    angle_deg: float

    def maps(self, seed: int) -> Maps:
        """The relief, and a mask (H, W) of the second substance, by which colour, roughness and metalness mix."""
        rng = np.random.default_rng(seed)
        n = self.resolution
        u, v = self.grain
        hills = smooth(rng, n, v, u) + self.detail * smooth(rng, n, v / 4, u / 4)
        plateaus = np.tanh(4 * hills)  # nearly −1 or 1 almost everywhere
        relief = normalised((1 - self.plateau) * hills + 2 * self.plateau * plateaus)
        scattered = normalised(smooth(rng, n, v, u))
        # 1/2 where the mix of height and noise is `cover`, from 0 to 1 within 0.15 about it.
        mask = np.clip((self.low * relief + (1 - self.low) * scattered - self.cover) / 0.15 + 0.5, 0, 1)
        tone = smooth(rng, n, 0.03, 0.03)
        scratch = smooth(rng, n, 0.01, 0.01)
        colour = mix(srgb(*self.srgb[0]), srgb(*self.srgb[1]), mask)
        return Maps(
            height=self.height * (relief + 0.02 * scratch),
            base_colour=np.clip(colour * (1 + 0.12 * tone + 0.05 * scratch)[..., None], 0, 1),
            roughness=np.clip(_between(self.roughness, mask) + 0.04 * scratch, 0.15, 1),
            metalness=_between(self.metalness, mask),
            specular=self.specular,
            anisotropy=self.anisotropy,
            angle=np.radians(self.angle_deg) + 0.2 * tone,
        )


def _between(pair: Pair, mask: np.ndarray) -> np.ndarray:
    """The first number where the mask (H, W) is 0, the second where it is 1, and a mix between."""
    return pair[0] + (pair[1] - pair[0]) * mask


def variation(number: int) -> tuple[str, Recipe]:
    """The kind and the recipe of surface `number`: four built-in ones and four patchworks in turn."""
    kinds = list(_KINDS.items())
    kinds += [("patchwork", _patchwork)] * len(kinds)  # as many patchworks as built-in kinds
    kind, draw_recipe = kinds[number % len(kinds)]
    # The second number is arbitrary; it keeps these draws apart from generators that are seeded by a number alone.
    return kind, draw_recipe(np.random.default_rng([number, 0x7A12]))


def load_variation(number: int) -> BTF:
    """Surface `number` as a periodic BTF of `SIZE`² texels, rendered once and then mapped from the cache.

    Pairs are 25 views × 25 lights of the UBO2003 directions, then `HELDOUT` random ones, as for built-in materials.
    """
    from bench.data.materials.store import load_or_render
    from bench.data.spec import Preparation

    kind, recipe = variation(number)
    data = Preparation(SIZE, heldout=HELDOUT, split="validation")
    # The built-in materials use seed 0, and their random structure must not be trained on.
    return load_or_render(f"variation-{number}-{kind}", recipe, data, seed=number + 1)


def _patchwork(rng: np.random.Generator) -> Patchwork:
    """A patchwork with every parameter drawn.

    `choice([0, x])` leaves some feature out of half of the surfaces. Metalness is 0 or 1, for each substance.
    """
    grain = _log_uniform(rng, 0.02, 0.12)
    return Patchwork(
        resolution=RESOLUTION,
        height=_log_uniform(rng, 0.004, 0.25),
        grain=(grain, grain * _log_uniform(rng, 0.5, 2)),
        detail=rng.uniform(0, 0.5),
        plateau=rng.choice([0, rng.uniform()]),
        low=rng.choice([1, rng.uniform()]),
        cover=rng.uniform(0.2, 0.8),
        srgb=(_colour(rng), _colour(rng)),
        roughness=(rng.uniform(0.25, 1), rng.uniform(0.25, 1)),
        metalness=(float(rng.random() < 0.2), float(rng.random() < 0.2)),
        specular=rng.choice([0, 0.5, 1]),
        anisotropy=rng.choice([0, rng.uniform()]),
        angle_deg=rng.uniform(0, 180),
    )


# Four built-in recipes, with every parameter drawn: name → a function of the generator that draws one.
_KINDS: dict[str, Callable[[np.random.Generator], Recipe]] = {
    "satin": lambda rng: Satin(
        resolution=RESOLUTION,
        threads=5 * int(rng.integers(1, 3)),
        height=_log_uniform(rng, 0.008, 0.05),
        twist_deg=rng.uniform(-25, 25),
        roughness=rng.uniform(0.25, 0.7),
        anisotropy=rng.uniform(0.4, 0.95),
        warp_srgb=_colour(rng),
        weft_srgb=_colour(rng),
    ),
    "brushed-metal": lambda rng: BrushedMetal(
        resolution=RESOLUTION,
        height=_log_uniform(rng, 0.0005, 0.006),
        roughness=rng.uniform(0.2, 0.6),
        anisotropy=rng.uniform(0.2, 0.95),
        metal_srgb=_colour(rng, darkest=120),
    ),
    "leather": lambda rng: Leather(
        resolution=RESOLUTION,
        height=_log_uniform(rng, 0.01, 0.08),
        cells=int(rng.integers(3, 9)),
        crease=rng.uniform(0.5, 1.4),
        roughness=rng.uniform(0.25, 0.7),
        skin_srgb=_colour(rng),
        crease_srgb=_colour(rng),
    ),
    "cable-knit": lambda rng: CableKnit(
        resolution=RESOLUTION,
        height=_log_uniform(rng, 0.05, 0.25),
        stitches=2 * int(rng.integers(2, 6)),
        bumps=int(rng.integers(3, 8)),
        sway=rng.uniform(0.05, 0.2),
        radius=rng.uniform(0.1, 0.25),
        yarn=rng.uniform(0.15, 0.5),
        roughness=rng.uniform(0.4, 0.95),
        colour_srgb=_colour(rng),
    ),
}


def _log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    """A number whose logarithm is drawn uniformly between those of `low` and `high`."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _colour(rng: np.random.Generator, darkest: float = 25) -> Colour:
    """Random sRGB codes from `darkest` to 245, mixed of a grey and a random colour by a random share."""
    grey = rng.uniform(darkest, 245)
    random_colour = rng.uniform(darkest, 245, 3)
    share = rng.uniform()
    red, green, blue = grey + share * (random_colour - grey)
    return float(red), float(green), float(blue)
