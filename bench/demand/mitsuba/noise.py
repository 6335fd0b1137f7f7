"""Measures the noise of a path tracer with a codec file as material, for each way to draw light directions.

Noise is the standard deviation of a pixel about its own mean, root mean square over the picture, as a share of the
picture's mean. More samples reduce it; they do not reduce the codec's error, the distance of the mean from the truth.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import mitsuba as mi
import numpy as np
from torch import Tensor

from bench.demand.mitsuba.bsdf import NAME, register
from bench.demand.mitsuba.scene import set_variant
from bench.inputs.errors import InputError

NOISE = 0.01  # share of the picture's mean
REPEAT = 3.0  # periods of the texture
BALL = {"type": "sphere", "radius": 0.5}
PLANE = {"type": "rectangle"}


def _low_sun() -> dict[str, Any]:
    """A disc of 3° half angle, 12° above the plane."""
    distance = 40  # in scene units: far compared with the plane, which is 2 wide
    far, height = distance * np.cos(np.radians(12)), distance * np.sin(np.radians(12))
    radius = distance * np.sin(np.radians(3))
    light = {"type": "area", "radiance": {"type": "rgb", "value": 400.0}}
    return {"type": "sphere", "center": [float(far), 0.0, float(height)], "radius": float(radius), "light": light}


def _lamps() -> dict[str, Any]:
    """A dim sky with six lamps of about 6° each, three hundred times as bright."""
    picture = np.full((32, 64, 3), 0.1, np.float32)
    for k in range(6):
        picture[6 + 2 * (k % 3), 5 + 10 * k] = 30.0
    return {"type": "envmap", "bitmap": mi.Bitmap(picture)}


class _Scene(NamedTuple):
    """A shape and a light, as Mitsuba describes them."""

    shape: dict[str, Any]
    light: Callable[[], dict[str, Any]]  # makes the description: it may need Mitsuba's variant to be set
    light_samples: int  # samples of the light for each sample of the material


EVEN = "ball, even sky"
SCENES = {
    EVEN: _Scene(BALL, lambda: {"type": "constant"}, light_samples=0),
    "plane, low sun": _Scene(PLANE, _low_sun, light_samples=1),
    "ball, small lamps": _Scene(BALL, _lamps, light_samples=1),
}


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


def reached(
    file: Path, drawn: Sequence[Tensor | None], scene: str = EVEN, picture: Picture = Picture()
) -> list[Reached]:
    """The figures of a codec file for each of several lobes (cells, cells, 5); None draws by the cosine. All take
    turns. Raises `InputError` if Mitsuba cannot run here, or the file cannot be recorded."""
    set_variant()
    properties = mi.Properties(NAME)
    properties["filename"], properties["repeat"] = str(file), REPEAT
    bsdf = register()(properties)
    loaded = _loaded(bsdf, scene, picture.side)
    pictures: list[list[np.ndarray]] = [[] for _ in drawn]
    slopes: list[list[float]] = [[] for _ in drawn]

    def render(number: int, samples: int, seed: int) -> tuple[np.ndarray, float]:
        """A picture (H, W, 3) drawn from one of the lobes, and the processor time that it took, in s."""
        bsdf.draw_from(drawn[number])
        start = time.process_time()
        colours = np.asarray(mi.render(loaded, spp=samples, seed=seed))[..., :3]
        return colours, time.process_time() - start

    long = picture.samples + picture.timed
    for number in range(len(drawn)):  # compile: once for each number of samples
        render(number, picture.samples, 0)
        render(number, long, 0)
    for seed in range(1, picture.repetitions + 1):
        for number in range(len(drawn)):
            colours, short = render(number, picture.samples, seed)
            pictures[number].append(colours)
            if seed % 4 == 1:  # a few timings are enough for a median
                # Two renders have the same fixed cost, so their difference is the time of the further samples.
                _, seconds = render(number, long, seed)
                slopes[number].append((seconds - short) / picture.timed)
    figures = []
    for of_lobes, seconds_each in zip(pictures, slopes, strict=True):
        figures.append(_figures(np.stack(of_lobes), float(np.median(seconds_each)), picture.samples))
    return figures


def _figures(pictures: np.ndarray, seconds: float, samples: int) -> Reached:
    """The figures of pictures (n, H, W, 3) with `samples` a pixel; one sample of all pixels takes `seconds`."""
    if not pictures.mean() > 0:
        raise InputError("the picture is black: it has no noise to measure")
    variance = pictures.mean(3).var(0, ddof=1).mean() * samples
    needed = float(variance / (NOISE * pictures.mean()) ** 2)
    return Reached(needed, needed * max(seconds, 0.0))


def _loaded(bsdf: Any, scene: str, side: int) -> Any:
    """One of the `SCENES` with a BSDF, as Mitsuba renders it; the picture has `side`² pixels."""
    chosen = SCENES[scene]
    place = mi.ScalarTransform4f().look_at([0, -2.4, 1.8], [0, 0, 0], [0, 0, 1])  # from, to, up
    film = {"type": "hdrfilm", "width": side, "height": side, "rfilter": {"type": "box"}}
    description = {
        "type": "scene",
        "integrator": {
            "type": "direct",
            "bsdf_samples": 1,
            "emitter_samples": chosen.light_samples,
            "hide_emitters": True,
        },
        "shape": chosen.shape | {"bsdf": bsdf},
        "light": chosen.light(),
        "camera": {"type": "perspective", "fov": 22.0, "to_world": place, "film": film},
    }
    return mi.load_dict(description)
