"""Stores a demand: the queries that the pictures of a scene make of one material, weighted by their contribution."""

import hashlib
import json
import zipfile
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from bench.atomic import replacing
from bench.errors import InputError
from bench.metrics.display import LUMA

FORMAT = 1
SNORM = 32767  # directions are stored as signed 16-bit numbers; 1.5e-5 off at most


@dataclass(frozen=True)
class Demand:
    """Queries of a material, in the frame and units of `bench.btf`, and the pixel that each adds to.

    The linear RGB of a pixel is the sum over its queries of `weight` × the material's answer, since that is the
    radiance under unit irradiance and `weight` the irradiance that the query stands for.
    """

    uv: np.ndarray  # (n, 2) float32
    footprint: np.ndarray  # (n,) float32, in texture units
    wo: np.ndarray  # (n, 3) float32, unit
    wi: np.ndarray  # (n, 3) float32, unit
    weight: np.ndarray  # (n, 3) float32, RGB irradiance
    pixel: np.ndarray  # (n,) int32 into the frames, row by row
    frames: tuple[int, int, int]  # how many, and the height and width of each
    provenance: dict[str, Any] = field(default_factory=dict)
    fingerprint: str = ""  # of the file it was read from: a hex digest of its content

    def __len__(self) -> int:
        return len(self.pixel)

    @property
    def importance(self) -> np.ndarray:
        """(n,) float64 that sum to 1: the luminance that each query would add if the material were a white diffuser."""
        share = (self.weight.astype(np.float64) @ LUMA) * self.wi[:, 2]
        return share / share.sum()

    @property
    def name(self) -> str:
        """The name of the scene, as tables show it."""
        return str(self.provenance.get("scene", "scene"))

    def pictures(self, answers: np.ndarray) -> np.ndarray:
        """The frames (frames, H, W, 3), float64 linear RGB, that answers (n, 3) of a material add up to."""
        flat = np.zeros((int(np.prod(self.frames)), 3))
        np.add.at(flat, self.pixel, self.weight * answers)
        return flat.reshape(*self.frames, 3)

    def thinned(self, count: int, rng: np.random.Generator) -> "Demand":
        """A random subset of the queries, with weights scaled to keep the sum."""
        kept = np.sort(rng.permutation(len(self))[:count])
        columns = {name: getattr(self, name)[kept] for name in ("uv", "footprint", "wo", "wi", "weight", "pixel")}
        columns["weight"] = columns["weight"] * np.float32(len(self) / count)
        return Demand(**columns, frames=self.frames, provenance=self.provenance)

    def save(self, path: Path) -> None:
        """Write an `.npz`, whole or not at all."""
        text = json.dumps({"format": FORMAT, "frames": self.frames, "provenance": self.provenance}, sort_keys=True)
        with replacing(path) as partial, open(partial, "wb") as file:
            np.savez_compressed(
                file,
                about=np.frombuffer(text.encode(), np.uint8),
                uv=self.uv,
                footprint=self.footprint,
                wo=np.round(self.wo * SNORM).astype(np.int16),
                wi=np.round(self.wi * SNORM).astype(np.int16),
                weight=self.weight,
                pixel=self.pixel,
            )


def load(path: Path) -> Demand:
    """Read a file of `Demand.save`. `InputError` if it is not a demand, or is empty."""
    try:
        with np.load(path, allow_pickle=False) as arrays:
            about = json.loads(arrays["about"].tobytes())
            named = {name: arrays[name] for name in ("uv", "footprint", "wo", "wi", "weight", "pixel")}
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from error
    except (KeyError, ValueError, zipfile.BadZipFile) as error:
        raise InputError(f"{path}: not a demand: make one with `neubtf-bench demand` ({error})") from error
    if about["format"] > FORMAT:
        raise InputError(f"{path}: format {about['format']} is newer than this version reads ({FORMAT}): upgrade")
    if not len(named["pixel"]):
        raise InputError(f"{path}: asks for nothing: make it again with `neubtf-bench demand`")
    fingerprint = _digest(about["frames"], named)
    for name in ("wo", "wi"):
        named[name] = unit(named[name].astype(np.float32))
    return Demand(**named, frames=tuple(about["frames"]), provenance=about["provenance"], fingerprint=fingerprint)


def _digest(frames: list[int], arrays: dict[str, np.ndarray]) -> str:
    digest = hashlib.sha256(json.dumps(frames).encode())
    for name in sorted(arrays):
        digest.update(name.encode() + np.ascontiguousarray(arrays[name]).tobytes())
    return digest.hexdigest()


def unit(vectors: np.ndarray) -> np.ndarray:
    """Vectors (…, 3) scaled to length 1."""
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
