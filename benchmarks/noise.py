"""Measures how much less noise there is where light directions are drawn from fitted lobes, not by the cosine.

    python benchmarks/noise.py [--material satin …] [--codec pca …] [--scene "ball, even sky" …] [--out runs/sampling]

Encodes each material with each codec, and renders scenes with Mitsuba many times: a ball under an even sky, by drawing
from the material alone; a plane under a low sun, and a ball under a dim sky with small lamps, by drawing from material
and light. Light directions are drawn by the cosine, from lobes fitted to the decoded material, and from lobes fitted
to the BTF itself, which stand for the true reflectance. Prints the samples a pixel that reach a noise of 1 % of the
picture's mean, and the processor's seconds that they take. Needs the extra [mitsuba].
"""

import argparse
from pathlib import Path

from tabulate import tabulate

import bench
from bench.demand.mitsuba.lobes import fitted
from bench.demand.mitsuba.noise import EVEN, SCENES, reached

STEPS = {"steps": 650}  # of learned codecs
LEARNED = ("neubtf-direct", "neumip", "relief", "bcf")
DRAWN = ("cosine", "lobes", "lobes of the BTF")


def encoded(material: str, codec: str, options: argparse.Namespace) -> Path:
    """The codec file of a material, which is kept."""
    file: Path = options.out / f"{material}-{codec}.nbtf"
    if not file.exists():
        bench.encode(bench.open(material, size=options.size), codec, file, **(STEPS if codec in LEARNED else {}))
    return file


def main() -> None:
    """See the module."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--material", nargs="+", default=["satin", "brushed-metal", "leather"])
    parser.add_argument("--codec", nargs="+", default=["pca", *LEARNED])
    parser.add_argument("--scene", nargs="+", default=[EVEN], choices=SCENES)
    parser.add_argument("--size", type=int, default=32)
    parser.add_argument("--out", type=Path, default=Path("runs/sampling"))
    options = parser.parse_args()
    rows = []
    for material in options.material:
        of_btf = fitted(bench.load(encoded(material, "table", options)))
        for codec in options.codec:
            file = encoded(material, codec, options)
            lobes = fitted(bench.load(file))
            for scene in options.scene:
                found = reached(file, [None, lobes, of_btf], scene)
                rows.append([material, codec, scene, *(x.samples for x in found), *(x.seconds for x in found)])
                print(*rows[-1], flush=True)
    headers = ["material", "codec", "scene", *(f"samples, {x}" for x in DRAWN), *(f"s, {x}" for x in DRAWN)]
    print(tabulate(rows, headers, "github", floatfmt=("", "", "", *[".0f"] * 3, *[".2f"] * 3)))


if __name__ == "__main__":
    main()
