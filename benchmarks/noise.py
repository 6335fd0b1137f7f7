"""Measures the noise of a path tracer that draws from fitted lobes, beside one that draws by the cosine.

    python benchmarks/noise.py [--material satin …] [--codec pca …] [--out runs/sampling]

Encodes each material with each codec, fits lobes, and renders three scenes with Mitsuba many times: a ball under an
even sky, by drawing from the material alone; a plane under a low sun, and a ball under a dim sky with small lamps, by
drawing from material and light. Prints the samples a pixel that reach a noise of 1 % of the picture's mean, and the
processor's seconds that they take. Needs the extra [mitsuba].
"""

import argparse
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
from sampling import CODECS
from tabulate import tabulate

import bench
from bench.codecs import container
from bench.codecs.registry import make_codec
from bench.demand.lobes import NAME, fitted
from bench.demand.mitsuba_bsdf import register
from bench.demand.mitsuba_scene import set_variant

SIDE, SAMPLES, REPEATS = 24, 64, 16
NOISE = 0.01  # of the mean of the picture
BALL = {"type": "sphere", "radius": 0.5}
PLANE = {"type": "rectangle"}


def low_sun() -> dict[str, Any]:
    """A disc of 3° half angle, 12° above the plane."""
    far, height = 40 * np.cos(np.radians(12)), 40 * np.sin(np.radians(12))
    radius = 40 * np.sin(np.radians(3))
    light = {"type": "area", "radiance": {"type": "rgb", "value": 400.0}}
    return {"type": "sphere", "center": [float(far), 0.0, float(height)], "radius": float(radius), "light": light}


def lamps() -> dict[str, Any]:
    """A dim sky with six lamps of about 6° each, a hundred times as bright."""
    picture = np.full((32, 64, 3), 0.1, np.float32)
    for k in range(6):
        picture[6 + 2 * (k % 3), 5 + 10 * k] = 30.0
    return {"type": "envmap", "bitmap": mi.Bitmap(picture)}


SCENES: dict[str, tuple[dict[str, Any], Callable[[], dict[str, Any]], int]] = {
    "ball, even sky": (BALL, lambda: {"type": "constant"}, 0),  # the last: light samples beside one of the material
    "plane, low sun": (PLANE, low_sun, 1),
    "ball, small lamps": (BALL, lamps, 1),
}


def noise(file: Path, scene: str) -> tuple[float, float]:
    """Samples a pixel to the noise, and processor seconds of as many."""
    shape, light, of_lights = SCENES[scene]
    loaded = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "direct", "bsdf_samples": 1, "emitter_samples": of_lights, "hide_emitters": True},
            "shape": shape | {"bsdf": {"type": "neubtf", "filename": str(file), "repeat": 3.0}},
            "light": light(),
            "camera": {
                "type": "perspective",
                "fov": 22.0,
                "to_world": mi.ScalarTransform4f().look_at([0, -2.4, 1.8], [0, 0, 0], [0, 0, 1]),
                "film": {"type": "hdrfilm", "width": SIDE, "height": SIDE, "rfilter": {"type": "box"}},
            },
        }
    )
    np.asarray(mi.render(loaded, spp=SAMPLES))  # compiles
    start = time.process_time()
    pictures = np.stack([np.asarray(mi.render(loaded, spp=SAMPLES, seed=k + 1))[..., :3] for k in range(REPEATS)])
    each = (time.process_time() - start) / (REPEATS * SAMPLES)
    variance = pictures.mean(3).var(0, ddof=1).mean() * SAMPLES
    samples = float(variance / (NOISE * pictures.mean()) ** 2)
    return samples, samples * each


def with_lobes(file: Path) -> Path:
    """The same file with lobes."""
    header, parts = container.read_parts(file)
    out = file.with_name(f"{file.stem}-lobes.nbtf")
    lobes = fitted(bench.load(file))
    container.save(out, make_codec(header.codec, header.settings), replace(parts, sampling={NAME: lobes}))
    return out


def main() -> None:
    """See the module."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--material", nargs="+", default=["satin", "brushed-metal", "leather", "wicker"])
    parser.add_argument("--codec", nargs="+", default=["pca", "neubtf-direct"])
    parser.add_argument("--size", type=int, default=32)
    parser.add_argument("--out", type=Path, default=Path("runs/sampling"))
    options = parser.parse_args()
    set_variant()
    register()
    rows = []
    for material in options.material:
        for codec in options.codec:
            file = options.out / f"{material}-{codec}.nbtf"
            if not file.exists():
                bench.encode(bench.open(material, size=options.size), codec, file, **CODECS.get(codec, {}))
            sampled = with_lobes(file)
            for scene in SCENES:
                plain, lobes = noise(file, scene), noise(sampled, scene)
                ratios = (lobes[0] / plain[0], lobes[1] / plain[1])
                rows.append([material, codec, scene, plain[0], lobes[0], ratios[0], plain[1], lobes[1], ratios[1]])
                print(*rows[-1], flush=True)
    headers = [
        "material",
        "codec",
        "scene",
        "samples to 1 %, cosine",
        "lobes",
        "ratio",
        "s to 1 %, cosine",
        "lobes",
        "ratio",
    ]
    print(tabulate(rows, headers, "github", floatfmt=("", "", "", ".0f", ".0f", ".2f", ".2f", ".2f", ".2f")))


if __name__ == "__main__":
    main()
