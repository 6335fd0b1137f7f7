"""Writes a measured BTF of full size, as UBO2014 and UBO2003 publish them, to try the suite on without the data.

    python benchmarks/fullsize.py ubo2014 FILE.btf [--side 400] [--views 151 --lights 151]
    python benchmarks/fullsize.py ubo2003 FILE.zip [--side 256] [--views 81 --lights 81]

The reflectance is that of a built-in material (texture, gloss, shadows and parallax), rendered small, repeated over the
picture and multiplied by a pattern that repeats nowhere. A `.btf` holds its factors, `--rank` a channel; a zip holds a
JPEG for each pair. Neither is ever held in memory as a whole. Then, for instance:

    neubtf-bench run budgets --material FILE --codec pca --codec neubtf --codec relief --out runs/full
"""

import argparse
import io
import sys
import time
import zipfile
from pathlib import Path

import numpy as np
import torch

from bench.btf import BTF
from bench.data.materials import load
from bench.hemisphere import to_degrees
from bench.metrics.display import encode_srgb, exposure
from bench.training.svd import truncated_svd

sys.path.append(str(Path(__file__).parents[1] / "tests" / "fuzz"))  # where tests have their writer of UBO2014

Array = np.ndarray
FULL = {"ubo2014": (400, 151), "ubo2003": (256, 81)}  # side, views and lights as published
PASSES, BLOCK = 4, 256
QUALITY = 92  # of the JPEGs


def pattern(side: int, seed: int = 0) -> Array:
    """Factors (side, side) around 1 on the reflectance of each texel: coarse stains and fine grain."""
    rng = np.random.default_rng(seed)
    grain = rng.standard_normal((side, side))
    rows, cols = np.meshgrid(*[np.linspace(0, 2 * np.pi, side, endpoint=False)] * 2, indexing="ij")
    stains = sum(
        np.sin(rng.integers(1, 6) * rows + rng.uniform(0, 6)) * np.sin(rng.integers(1, 6) * cols + rng.uniform(0, 6))
        for _ in range(6)
    )
    return np.exp(0.12 * stains + 0.06 * grain).astype(np.float32)


def repeated(side: int, tile: int) -> Array:
    """The texel (side · side,) of a tile that each texel of the picture repeats, row by row."""
    place = np.arange(side) % tile
    return (place[:, None] * tile + place).reshape(-1)


def write_btf(path: Path, tile: BTF, side: int, rank: int) -> None:
    """A DFMF of colour model 11 in half floats."""
    from ubo2014_write import decorrelated, radians, write_ubo2014

    stained = np.log(pattern(side))[::-1].reshape(-1, 1)
    place = repeated(side, tile.shape[0]).reshape(side, side)[::-1].reshape(-1)
    factors = []
    for channel in range(3):
        matrix = np.stack([decorrelated(picture.reshape(-1, 3))[:, channel] for picture in tile])
        mean, basis, coefficients = _decomposed(matrix, rank - 2)
        u = np.concatenate([mean[:, None], basis, np.full((len(tile), 1), float(channel == 0))], 1)
        sv = np.concatenate([np.ones((len(place), 1)), coefficients.T[place], stained], 1)
        factors.append((u, sv))
    write_ubo2014(path, radians(tile.layout.views), radians(tile.layout.lights), (side, side), factors)


def _decomposed(matrix: Array, rank: int) -> tuple[Array, Array, Array]:
    """Mean (pairs,), basis (pairs, rank) and coefficients (rank, texels) of a matrix (pairs, texels)."""

    blocks = lambda _: (torch.from_numpy(matrix[i : i + BLOCK].copy()) for i in range(0, len(matrix), BLOCK))  # noqa: E731
    shape = (matrix.shape[0], matrix.shape[1])
    found = truncated_svd(blocks, shape, rank, PASSES, torch.Generator().manual_seed(0), torch.device("cpu"))
    return found.mean.numpy(), found.basis.numpy(), found.coefficients.numpy()


def write_zip(path: Path, tile: BTF, side: int) -> None:
    """A JPEG a pair, its angles in whole degrees in its name."""
    from PIL import Image

    stained = pattern(side)[..., None] * np.float32(exposure(tile))
    place = repeated(side, tile.shape[0])
    degrees = [np.round(np.stack(to_degrees(w), -1)).astype(int) for w in (tile.wi, tile.wo)]
    with zipfile.ZipFile(path, "w", zipfile.ZIP_STORED) as archive:
        for pair, picture in enumerate(tile):
            whole = picture.reshape(-1, 3)[place].reshape(side, side, 3) * stained
            codes = np.round(encode_srgb(np.clip(whole, 0, 1)) * 255).astype(np.uint8)
            (theta_i, phi_i), (theta_o, phi_o) = (each[pair].tolist() for each in degrees)
            angles = f"tl{theta_i:03d} pl{phi_i % 360:03d} tv{theta_o:03d} pv{phi_o % 360:03d}"
            packed = io.BytesIO()
            Image.fromarray(codes).save(packed, "JPEG", quality=QUALITY)
            folder = f"generated/tv{theta_o:03d}_pv{phi_o % 360:03d}"
            archive.writestr(f"{folder}/{pair:05d} {angles}.jpg", packed.getvalue())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("format", choices=FULL)
    parser.add_argument("path", type=Path)
    parser.add_argument("--side", type=int, help="texels a side (default: 400; 256 of ubo2003)")
    parser.add_argument("--directions", choices=FULL, help="the set that is thinned (default: that of the format)")
    for name in ("--views", "--lights"):
        parser.add_argument(name, type=int, help="default: all, 151; 81 of ubo2003")
    parser.add_argument("--material", default="leather", help="the built-in material")
    parser.add_argument("--tile", type=int, default=48, help="texels a side at which it is rendered")
    parser.add_argument("--rank", type=int, default=100, help="factors a channel of a .btf")
    options = parser.parse_args()
    start = time.process_time()
    side, directions = options.side or FULL[options.format][0], options.directions or options.format
    views, lights = (each or FULL[directions][1] for each in (options.views, options.lights))
    tile = load(options.material, options.tile, directions=directions, views=views, lights=lights, heldout=0)
    if options.format == "ubo2014":
        write_btf(options.path, tile, side, options.rank)
    else:
        write_zip(options.path, tile, side)
    size = options.path.stat().st_size
    print(f"{options.path}: {len(tile):,} pairs, {size / 1e6:,.0f} MB, {time.process_time() - start:.0f} processor s")


if __name__ == "__main__":
    main()
