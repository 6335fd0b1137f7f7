"""Collects the demand of a scene, with any ray caster, within a limit of queries."""

import math
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from bench.codec import Progress, followed, silent
from bench.demand.demand import CELLS, MOST, Demand
from bench.demand.points import Light, Points, queries_of
from bench.inputs.errors import InputError

PREVIEW = 96  # cells along the longer side of the first picture, which estimates how much of it shows the material
FRAME = 1 << 21  # cells of one frame: its rays are cast at once
SPARE = 0.97  # share of the limit to aim at, because the first picture is coarse


def checked(limit: int, out: Path) -> None:
    """Check the limit of queries and the path of the demand before any work starts."""
    if not 1 <= limit <= MOST:
        raise InputError(f"--queries {limit}: must be between 1 and {MOST}")
    if out.suffix != ".npz":
        raise InputError(f"{out}: a demand is an .npz file: give it that ending")
    if not out.parent.is_dir():
        raise InputError(f"{out}: there is no such folder: make it first")


class Caster(Protocol):
    """A scene that can cast camera rays and sample its lights."""

    name: str
    frames: int
    picture: tuple[int, int]  # height and width in pixels
    samples: int  # samples of the lights at each point

    def cast(self, frame: int, col: np.ndarray, row: np.ndarray) -> Points: ...  # through points (n,), in pixels

    def lights(self, points: Points, rng: np.random.Generator) -> list[Light]: ...


def collect(scene: Caster, limit: int, seed: int = 0, show: Progress = silent) -> Demand:
    """The queries of every frame of a scene, at most `limit`.

    If all pixels together need more, the picture is divided into larger cells, and one ray is cast through a random
    point of each. The frames are then smaller than the picture; footprints stay those of its pixels. `InputError` if
    no ray finds the material, or no light reaches the visible part.
    """
    size = _size(scene, limit)
    cells = size[0] * size[1]
    rng = np.random.default_rng(seed)
    parts = []
    for frame in followed(show, range(scene.frames), "casting rays", scene.frames):
        points = scene.cast(frame, *_places(scene.picture, size, rng))
        if len(points):
            queries = queries_of(points, scene.lights(points, rng))
            queries["pixel"] += frame * cells
            parts.append(queries)
    if not parts:
        raise InputError(f"{scene.name}: too few rays hit the material: move the camera, or raise --queries")
    columns: dict[str, Any] = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    if not len(columns["pixel"]):
        raise InputError(f"{scene.name}: no light reaches the side of the material that the camera sees: move a light")
    provenance = {"scene": scene.name, "picture": list(scene.picture), "limit": limit, "seed": seed}
    demand = Demand(**columns, frames=(scene.frames, *size), provenance=provenance)
    return demand if len(demand) <= limit else demand.thinned(limit, rng)


def _size(scene: Caster, limit: int) -> tuple[int, int]:
    """Height and width of the frames that make about `limit` queries, at most those of the picture."""
    height, width = scene.picture
    shrink = min(1.0, PREVIEW / max(height, width))
    preview = max(1, round(height * shrink)), max(1, round(width * shrink))
    rng = np.random.default_rng(0)
    shown = [len(scene.cast(frame, *_places(scene.picture, preview, rng))) for frame in range(scene.frames)]
    if not any(shown):
        where = "it is behind the camera, out of the picture, or hidden: move the camera or the material"
        raise InputError(f"{scene.name}: no ray of the camera finds the material: {where}")
    wanted = sum(shown) / (preview[0] * preview[1]) * height * width * scene.samples
    most = min(FRAME, CELLS // scene.frames) / (height * width)
    scale = min(1.0, math.sqrt(SPARE * limit / wanted), math.sqrt(most))
    return max(1, int(height * scale)), max(1, int(width * scale))


def _places(picture: tuple[int, int], size: tuple[int, int], rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Column and row (H · W,) in pixels of a point in each of (H, W) cells: the middle of a pixel, else a random one. A
    regular grid would hit the same texels of a regular texture again and again."""
    within = 0.5 if size == picture else rng.random((2, *size))
    row, col = (np.mgrid[: size[0], : size[1]] + within) * (np.array(picture) / np.array(size))[:, None, None]
    return col.ravel(), row.ravel()
