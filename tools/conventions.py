"""Prints the PSNR of one codec file under four conventions that papers use, in dB, as means over test pairs.

    python tools/conventions.py FILE.nbtf MATERIAL

MATERIAL is one of the suite `budgets`, or a path. The conventions differ in what is compared: display values as
everywhere in this project; linear radiance × exposure; the same, clipped to [0, 1]; display values under an exposure
of each slice's own, 0.8 over its 99th percentile. A slice counts at most 48.13 dB in each.
"""

import argparse

import numpy as np
import pandas as pd

import bench
from bench.btf import BTF
from bench.codec import silent
from bench.data.open import open_material
from bench.material import Material
from bench.metrics.display import encode_srgb, exposure
from bench.metrics.psnr import psnr
from bench.records import MOST_DB
from bench.runs.suite import load_suite, with_changes

SLICES = 150
BRIGHT = 0.8  # what the 99th percentile of a slice becomes under its own exposure

Array = np.ndarray


def displayed(linear: Array) -> Array:
    """Display values, sRGB in [0, 1], of linear ones."""
    return encode_srgb(linear.clip(0, 1))


def conventions(truth: Array, answer: Array) -> dict[str, float]:
    """The PSNR of a slice, in dB, by convention; both (H, W, 3), linear radiance × exposure, not negative."""
    own = BRIGHT / max(float(np.percentile(truth, 99)), 1e-6)
    compared = {
        "display": (displayed(truth), displayed(answer)),
        "linear": (truth, answer),
        "linear, clipped": (truth.clip(0, 1), answer.clip(0, 1)),
        "display, each slice's own exposure": (displayed(own * truth), displayed(own * answer)),
    }
    found = {}
    for name, (true, ours) in compared.items():
        found[name] = min(MOST_DB, float(psnr(np.square(true - ours).mean())))
    return found


def table(material: Material, btf: BTF) -> dict[str, float]:
    """The mean PSNR over up to `SLICES` test pairs, by convention."""
    split = btf.split()
    scale = exposure(btf.subset(split.train))
    pairs = np.concatenate([*split.heldout.values()])
    rows = []
    for pair in np.random.default_rng(0).permutation(pairs)[:SLICES]:
        answer = material.slice(btf.wo[pair].tolist(), btf.wi[pair].tolist()).numpy()
        rows.append(conventions(scale * btf[pair].clip(0), scale * answer.clip(0)))
    return pd.DataFrame(rows).mean().to_dict()


def main() -> None:
    """Print the table of the file that the command line names."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("file")
    parser.add_argument("material")
    options = parser.parse_args()
    suite = with_changes(load_suite("budgets"), [options.material], codecs=[], changes={})
    btf = open_material(suite.materials[0], suite.data, silent)
    for name, value in table(bench.load(options.file), btf).items():
        print(f"{value:6.1f} dB  {name}")


if __name__ == "__main__":
    main()
