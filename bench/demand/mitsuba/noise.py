"""Measures the noise of a path tracer with a codec file as material, for each way to draw light directions.

Noise is the standard deviation of a pixel about its own mean, root mean square over the picture, as a share of the
picture's mean. More samples reduce it; they do not reduce the codec's error, the distance of the mean from the truth.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
from torch import Tensor

from bench.demand.mitsuba.bsdf import NAME, register
from bench.demand.mitsuba.scene import set_variant
from bench.inputs.errors import InputError

NOISE = 0.01  # share of the picture's mean
REPEAT = 3.0  # periods of the texture
EVEN = "ball, even sky"  # the scene, in words


@dataclass(frozen=True)
class Picture:
    """The settings of a measurement: the picture and its repetitions."""

    side: int = 24  # pixels
    samples: int = 64  # a pixel, in each repetition
    repetitions: int = 16
    timed: int = 1024  # further samples a pixel, which are timed


@dataclass(frozen=True)
class Reached:
    """The samples and the time that bring the noise of the scene's picture down to `NOISE`."""

    samples: float  # a pixel
    seconds: float  # CPU time of all cores for the whole picture, without the fixed cost of a render


@dataclass
class _Way:
    """A way to draw directions, with what was measured of it."""

    lobes: Tensor | None  # None: by the cosine
    pictures: list[np.ndarray] = field(default_factory=list)  # (H, W, 3) of each repetition
    seconds: list[float] = field(default_factory=list)  # of one sample of all pixels, as timed again and again


def reached(file: Path, lobes: Sequence[Tensor | None], picture: Picture = Picture()) -> list[Reached]:
    """The figures of a codec file for each of several lobes (cells, cells, 5); None draws by the cosine. All take
    turns. Raises `InputError` if Mitsuba cannot run here, the file cannot be recorded, or the picture is black."""
    set_variant()
    properties = mi.Properties(NAME)
    properties["filename"], properties["repeat"] = str(file), REPEAT
    bsdf = register()(properties)
    scene = _ball(bsdf, picture.side)
    ways = [_Way(each) for each in lobes]

    def render(way: _Way, samples: int, seed: int) -> tuple[np.ndarray, float]:
        """A picture (H, W, 3) drawn in one way, and the processor time that it took, in s."""
        bsdf.draw_from(way.lobes)
        start = time.process_time()
        colours = np.asarray(mi.render(scene, spp=samples, seed=seed))[..., :3]
        return colours, time.process_time() - start

    long = picture.samples + picture.timed
    for way in ways:  # compile: once for each number of samples
        render(way, picture.samples, 0)
        render(way, long, 0)
    for seed in range(1, picture.repetitions + 1):
        for way in ways:
            colours, short = render(way, picture.samples, seed)
            way.pictures.append(colours)
            if seed % 4 == 1:  # a few timings are enough for a median
                # Two renders have the same fixed cost, so their difference is the time of the further samples.
                _, seconds = render(way, long, seed)
                way.seconds.append((seconds - short) / picture.timed)
    return [_figures(np.stack(way.pictures), float(np.median(way.seconds)), picture.samples) for way in ways]


def _figures(pictures: np.ndarray, seconds: float, samples: int) -> Reached:
    """The figures of pictures (n, H, W, 3) with `samples` a pixel; one sample of all pixels takes `seconds`.

    `InputError` for black pictures.
    """
    if not pictures.mean() > 0:
        raise InputError("the picture is black: it has no noise to measure")
    variance = pictures.mean(3).var(0, ddof=1).mean() * samples
    needed = float(variance / (NOISE * pictures.mean()) ** 2)
    return Reached(needed, needed * max(seconds, 0.0))


def _ball(bsdf: Any, side: int) -> Any:
    """A ball with a BSDF under an even sky, as Mitsuba renders it; the picture has `side`² pixels."""
    place = mi.ScalarTransform4f().look_at([0, -2.4, 1.8], [0, 0, 0], [0, 0, 1])  # from, to, up
    film = {"type": "hdrfilm", "width": side, "height": side, "rfilter": {"type": "box"}}
    description = {
        "type": "scene",
        "integrator": {"type": "direct", "bsdf_samples": 1, "emitter_samples": 0, "hide_emitters": True},
        "shape": {"type": "sphere", "radius": 0.5, "bsdf": bsdf},
        "light": {"type": "constant"},
        "camera": {"type": "perspective", "fov": 22.0, "to_world": place, "film": film},
    }
    return mi.load_dict(description)
