"""Measures where errors lie on measured surfaces: by how bright a pair or a texel is, and by the view's angle.

    python benchmarks/darks.py [--material ubo2003_local_pca/corduroy …] [--codec pca neubtf-direct]

Fits each codec at 64² texels and scores 300 training and 300 test pairs. Prints the shares of the squared display error
that lie in the darkest and the brightest tenth, and the PSNR of views below 40° and beyond 70°.
"""

import argparse
import tempfile
from pathlib import Path

import numpy as np
import torch
from tabulate import tabulate

import bench
from bench.metrics.display import encode_srgb, exposure

PAIRS = 300
STEPS = {"steps": 1_500}  # of learned codecs


def share(errors: np.ndarray, by: np.ndarray) -> list[str]:
    """The shares of all error in the darkest and in the brightest tenth."""
    tenths = np.array_split(errors.ravel()[by.ravel().argsort()], 10)
    return [f"{part.sum() / errors.sum():.0%}" for part in (tenths[0], tenths[-1])]


def main() -> None:
    """See the module."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    measured = [f"ubo2003_local_pca/{name}" for name in ("corduroy", "wool")]
    parser.add_argument("--material", nargs="+", default=measured)
    parser.add_argument("--codec", nargs="+", default=["pca", "neubtf-direct"])
    options = parser.parse_args()
    torch.set_num_threads(1)
    rows = []
    for name in options.material:
        btf, rng = bench.open(name, texels=64), np.random.default_rng(0)
        gain, split = exposure(btf, 0), btf.split()
        for codec in options.codec:
            with tempfile.TemporaryDirectory() as folder:
                file = Path(folder) / "fit.nbtf"
                bench.encode(btf, codec, file, threads=1, **({} if codec == "pca" else STEPS))
                material = bench.load(file)
            for part, pairs in (("training", split.train), ("test", np.concatenate([*split.heldout.values()]))):
                chosen = rng.permutation(pairs)[:PAIRS]
                truth = np.stack([encode_srgb(np.clip(btf[int(i)] * gain, 0, 1)) for i in chosen])
                made = [np.asarray(material.slice(*map(torch.from_numpy, (btf.wo[i], btf.wi[i])))) for i in chosen]
                error = (encode_srgb(np.clip(np.stack(made) * gain, 0, 1)) - truth) ** 2
                pair, angle = error.mean((1, 2, 3)), np.degrees(np.arccos(btf.wo[chosen, 2]))
                decibels = [f"{-10 * np.log10(pair[some].mean()):.1f}" for some in (angle < 40, angle > 70)]
                black = f"{(truth < 0.5 / 255).mean():.2%}"
                rows.append(
                    [
                        name.split("/")[-1],
                        codec,
                        part,
                        black,
                        *share(pair, truth.mean((1, 2, 3))),
                        *share(error, truth),
                        *decibels,
                    ]
                )
    headers = ["", "codec", "pairs", "black", "dark pairs", "bright pairs", "dark texels", "bright texels"]
    print(tabulate(rows, [*headers, "views < 40°, dB", "> 70°, dB"]))


if __name__ == "__main__":
    main()
