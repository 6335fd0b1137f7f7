"""Writes decoded materials as program files with an exposure, so that `reports` draws them without PyTorch."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from bench.btf import BTF, ArraySource
from bench.codec import Fit, Progress, silent
from bench.codecs.program import program_of
from bench.codecs.registry import load_codec
from bench.hemisphere import thin, ubo2003, uniform
from bench.material import Material
from bench.metrics.display import exposure, exposure_of

QUERIES = 65_536
BAKED = 13  # directions a side of a material that cannot be a program: 5.5 MB at 64² texels


@dataclass(frozen=True)
class Drawable:
    """The program of a material, stored in `path`, and the exposure that its picture needs."""

    path: Path
    exposure: float


def drawable(material: Material, path: Path) -> Drawable:
    """Write a material's program to `path`. The exposure is that of random queries up to 75°.

    `InputError` where the material cannot be recorded as a program.
    """
    program_of(material).save(path)
    rng = np.random.default_rng(0)
    uv = torch.from_numpy(rng.random((QUERIES, 2), np.float32))
    wo, wi = (torch.from_numpy(uniform(rng, QUERIES).astype(np.float32)) for _ in range(2))
    return Drawable(path, exposure_of(material.query(uv, wo, wi).numpy()))


def baked(material: Material, name: str, show: Progress = silent) -> BTF:
    """The slices of a material at `BAKED` × `BAKED` pairs: what stands in where there is no program."""
    directions = ubo2003()
    side = directions[thin(directions, BAKED)]
    wo, wi = np.repeat(side, BAKED, 0), np.tile(side, (BAKED, 1))
    slices = []
    for number, pair in enumerate(zip(wo.tolist(), wi.tolist(), strict=True)):
        show(f"baking {name}", number, len(wo))
        slices.append(material.slice(*pair).numpy())
    show(f"baking {name}", len(wo), len(wo))
    return BTF(name, wo, wi, ArraySource(np.stack(slices)))


def drawable_truth(btf: BTF, path: Path, show: Progress = silent) -> Drawable:
    """Write a BTF itself as a program: the interpolated table of its training pairs, at the BTF's own exposure."""
    table = load_codec("table")()
    device = torch.device("cpu")
    material = table.decode(table.encode(btf.subset(btf.split().train), Fit(show=show)), device)
    program_of(material).save(path)
    return Drawable(path, exposure(btf))
