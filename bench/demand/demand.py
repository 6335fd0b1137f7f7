"""Stores a demand: the queries that the pictures of a scene make of one material, weighted by their contribution."""

import hashlib
import json
import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from bench.btf import periods
from bench.files.archive import read_arrays
from bench.files.atomic import replacing
from bench.inputs.errors import InputError, readable, shown
from bench.inputs.settings import Count, converted
from bench.metrics.display import LUMA

FORMAT = 2
MOST = 1_000_000  # the most queries of a demand
CELLS = 1 << 24  # the most cells of all frames together
MOST_BYTES = 64 << 20  # of a file, inflated: the most queries, frames and provenance
FARTHEST = 64.0  # limit of a footprint, in longer sides of the texture: at the horizon a pixel covers an infinite area
REACH = 1e12  # the largest distance from the texture's origin, in its sides
BRIGHTEST = 1e30  # largest weight: sums of a million stay finite in float32
SNORM = 32767  # directions are stored as signed 16-bit numbers; 1.5e-5 off at most
# The arrays of a file, in order: the type of their numbers, and the shape of what they hold for one query.
COLUMNS: dict[str, tuple[type, tuple[int, ...]]] = {
    "place": (np.float32, (2,)),
    "footprint": (np.float32, ()),
    "wo": (np.int16, (3,)),
    "wi": (np.int16, (3,)),
    "weight": (np.float32, (3,)),
    "pixel": (np.int32, ()),
}
NAMES = tuple(COLUMNS)


@dataclass(frozen=True)
class Demand:
    """Queries of a material, in the frame and units of `bench.btf`, and the pixel that each adds to.

    The linear RGB of a pixel is the sum over its queries of `weight` × the material's answer, because the answer is the
    radiance under unit irradiance, and `weight` is the irradiance of the query.
    """

    place: np.ndarray  # (n, 2) float32 on the surface, not wrapped, in units of the longer side of the texture
    footprint: np.ndarray  # (n,) float32, in the same units
    wo: np.ndarray  # (n, 3) float32, unit
    wi: np.ndarray  # (n, 3) float32, unit
    weight: np.ndarray  # (n, 3) float32, RGB irradiance
    pixel: np.ndarray  # (n,) int32 into the frames, row by row
    frames: tuple[int, int, int]  # the number of frames, and their height and width
    provenance: dict[str, Any] = field(default_factory=dict)
    fingerprint: str = ""  # a hex digest of the file that it was read from

    def __len__(self) -> int:
        return len(self.pixel)

    def uv(self, size: tuple[int, int]) -> np.ndarray:
        """uv (n, 2) float32 of the queries on a texture of `size` (H, W), which keeps its shape on the surface."""
        return np.mod(self.place * np.array(periods(size)), 1.0).astype(np.float32)

    def queries(self, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """uv (n, 2), ω_o and ω_i (n, 3) and footprint (n,), as inputs of a material with a texture of `size` (H, W)."""
        return self.uv(size), self.wo, self.wi, self.footprint

    @property
    def importance(self) -> np.ndarray:
        """Shares (n,) float64 with sum 1: the luminance of each query if the material were a white diffuser."""
        share = (self.weight.astype(np.float64) @ LUMA) * self.wi[:, 2]
        return share / share.sum()

    @property
    def name(self) -> str:
        """The name of the scene, as tables show it."""
        return str(self.provenance.get("scene", "scene"))

    def pictures(self, answers: np.ndarray) -> np.ndarray:
        """The frames (frames, H, W, 3), float64 linear RGB, as sums of a material's answers (n, 3)."""
        flat = np.zeros((int(np.prod(self.frames)), 3))  # a row for each pixel of all frames
        np.add.at(flat, self.pixel, self.weight * answers)  # unlike `+=`, it adds all queries of a pixel
        return flat.reshape(*self.frames, 3)

    def thinned(self, count: int, rng: np.random.Generator) -> "Demand":
        """A random subset of `count` queries, with weights scaled to keep the expected sum of all."""
        chosen = np.sort(rng.permutation(len(self))[:count])  # in the order that they had
        columns = {name: getattr(self, name)[chosen] for name in NAMES}
        columns["weight"] = columns["weight"] * np.float32(len(self) / count)
        return Demand(**columns, frames=self.frames, provenance=self.provenance)

    def save(self, path: Path) -> None:
        """Write an `.npz` file, completely or not at all. Directions are rounded to 16 bits a component."""
        text = json.dumps({"format": FORMAT, "frames": self.frames, "provenance": self.provenance}, sort_keys=True)
        stored = {name: getattr(self, name) for name in NAMES}
        for name in ("wo", "wi"):
            stored[name] = np.round(stored[name] * SNORM).astype(np.int16)
        with replacing(path) as partial, open(partial, "wb") as file:
            np.savez_compressed(file, about=np.frombuffer(text.encode(), np.uint8), **stored)


def load(path: str | Path) -> Demand:
    """Read a file of `Demand.save`. `InputError` if it is not a demand, is empty, or has values that no scene makes."""
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: there is no such file: check the path")
    try:
        arrays = read_arrays(path, MOST_BYTES)
        frames, provenance = _frames_and_provenance(arrays.pop("about", None))
        _refuse_impossible(arrays, frames)
    except InputError as error:
        reason = str(error).removeprefix(f"{path}: ")
        raise InputError(f"{path}: not a demand: {reason}: `encode --scene` makes one") from error
    # The fingerprint is of the numbers in the file, so it is taken before directions become floats.
    digest = hashlib.sha256(json.dumps(frames).encode())
    for name in sorted(arrays):
        digest.update(name.encode() + np.ascontiguousarray(arrays[name]).tobytes())
    for name in ("wo", "wi"):
        arrays[name] = unit(arrays[name].astype(np.float32))
    return Demand(**arrays, frames=frames, provenance=provenance, fingerprint=digest.hexdigest())


def _frames_and_provenance(stored: np.ndarray | None) -> tuple[tuple[int, int, int], dict[str, Any]]:
    """Both from the array `about` of a file. `InputError` if `save` cannot have written it."""
    with readable("about", "the file is damaged"):
        about = json.loads(np.asarray(stored, np.uint8).tobytes())
    if not isinstance(about, dict) or not isinstance(about.get("format"), int):
        raise InputError("about gives no format")
    if about["format"] != FORMAT:
        age, remedy = ("newer", ": upgrade") if about["format"] > FORMAT else ("older", "")
        raise InputError(f"format {shown(about['format'])} is {age} than this version reads ({FORMAT}){remedy}")
    frames = converted("frames", tuple[Count, Count, Count], about.get("frames"))
    if math.prod(frames) > CELLS:
        raise InputError(f"frames of {shown(frames)} cells are more than {CELLS:,}")
    provenance = about.get("provenance")
    if not isinstance(provenance, dict):
        raise InputError(f"provenance must be a table, not {shown(provenance)}")
    return frames, provenance | {"scene": converted("provenance: scene", str, provenance.get("scene", "scene"))}


def _refuse_impossible(arrays: dict[str, np.ndarray], frames: tuple[int, int, int]) -> None:
    """Raise `InputError` unless each column of a demand exists, of its type and shape, with possible values for 1 to
    `MOST` queries, and no other array."""
    for name in COLUMNS:
        if name not in arrays:
            raise InputError(f"no array {name!r}")
    count = len(arrays["pixel"]) if arrays["pixel"].ndim else 0  # a single number has no length
    for name, (kind, width) in COLUMNS.items():
        column = arrays[name]
        if column.dtype != kind or column.shape != (count, *width):
            raise InputError(f"{name} is {column.shape} {column.dtype}, not {(count, *width)} {np.dtype(kind)}")
    extra = arrays.keys() - COLUMNS.keys()
    if extra:
        raise InputError(f"it has an array {min(extra)!r}, which no demand has")
    if not count or count > MOST:
        raise InputError(f"it has {count:,} queries, but must have 1 to {MOST:,}")
    place, footprint, weight, pixel = (arrays[name] for name in ("place", "footprint", "weight", "pixel"))
    directions = np.concatenate([arrays["wo"], arrays["wi"]]).astype(np.float64)
    length = np.linalg.norm(directions, axis=1) / SNORM
    is_good = {
        "place": (np.abs(place) <= REACH).all(),
        "footprint": ((footprint > 0) & (footprint <= FARTHEST)).all(),
        # Directions stored as whole numbers have a length of 1 up to rounding.
        "wo or wi": (directions[:, 2] >= 0).all() and (np.abs(length - 1) < 0.01).all(),
        "weight": ((weight >= 0) & (weight <= BRIGHTEST)).all() and is_lit(weight, arrays["wi"]),
        "pixel": ((pixel >= 0) & (pixel < math.prod(frames))).all(),
    }
    for name, holds in is_good.items():
        if not holds:
            raise InputError(f"{name} holds values out of range")


def is_lit(weight: np.ndarray, wi: np.ndarray) -> bool:
    """Whether a white diffuser would send any light, under `weight` (n, 3) from directions `wi` (n, 3)."""
    return (weight.astype(np.float64) @ LUMA) @ wi[:, 2].astype(np.float64) > 0


def unit(vectors: np.ndarray) -> np.ndarray:
    """Vectors (…, 3) scaled to length 1."""
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
