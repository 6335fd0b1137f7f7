"""The pairs of a rendered material: a product to train on, and random held-out pairs for validation or test.

`validation` pairs are one fixed draw; defaults, recipes and stopping are chosen on them. `test` pairs are only for
tables; they use another random stream and are drawn anew for each repetition and each material.
"""

import hashlib
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from bench.errors import InputError
from bench.hemisphere import DIRECTION_SETS, thin, uniform

Array = np.ndarray
Split = Literal["test", "validation"]
SPLIT: Split = "test"  # the default, of suites and in Python


@dataclass(frozen=True)
class Sampling:
    """The pairs of a rendered material: `views` × `lights` of a direction set, and `heldout` ones of a draw."""

    directions: str = "ubo2003"
    views: int = 25
    lights: int = 25
    heldout: int = 150
    split: Split = SPLIT
    draw: int = 0  # of the test pairs: the repetition

    def __post_init__(self) -> None:
        if self.heldout < 0:
            raise InputError(f"heldout must be at least 0, not {self.heldout}")
        if self.split not in get_args(Split):
            raise InputError(f"split must be {' or '.join(get_args(Split))}, not {self.split!r}")

    def product(self) -> tuple[Array, Array]:
        """`wo` and `wi` (N, 3) float32 of the training pairs: every view with every light, view-major."""
        if self.directions not in DIRECTION_SETS:
            raise InputError(f"unknown direction set {self.directions!r}: there are {', '.join(DIRECTION_SETS)}")
        everything = DIRECTION_SETS[self.directions]()
        counts = (self.views, self.lights)
        if not all(1 <= count <= len(everything) for count in counts):
            raise InputError(
                f"views and lights must be between 1 and the {len(everything)} of {self.directions}, not {counts}"
            )
        views, lights = (everything[thin(everything, count)] for count in counts)
        return np.repeat(views, len(lights), 0), np.tile(lights, (len(views), 1))

    def drawn(self, material: str, seed: int) -> tuple[Array, Array]:
        """`wo` and `wi` (heldout, 3) float32, uniform in solid angle up to 75°."""
        stream = [seed, 0x5EED]
        if self.split == "test":
            named = int.from_bytes(hashlib.sha256(material.encode()).digest()[:4], "big")
            stream = [seed, 0x7E57, self.draw, named]
        rng = np.random.default_rng(stream)
        return uniform(rng, self.heldout), uniform(rng, self.heldout)

    def everything(self, material: str, seed: int) -> tuple[Array, Array]:
        """`wo` and `wi` of the training pairs, then of the held-out ones."""
        wo, wi = (np.concatenate(both) for both in zip(self.product(), self.drawn(material, seed), strict=True))
        return wo, wi

    def described(self) -> str:
        """The held-out pairs in words, for a provenance."""
        which = f"test pairs, draw {self.draw}" if self.split == "test" else "validation pairs"
        return f"{self.heldout} {which}, uniform in solid angle, theta_deg <= 75"
