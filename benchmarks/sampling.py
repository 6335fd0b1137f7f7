"""Measures how much less noise a renderer has that draws from fitted lobes than one that draws by the cosine.

    python benchmarks/sampling.py [--material satin …] [--codec pca …] [--out runs/sampling]

Encodes each material with each codec, fits lobes, and prints the ratio of variances under a uniform environment, with
drawing from the lobes and nothing else; and the largest albedo, of the decoded material as it is.
"""

import argparse
from pathlib import Path

from tabulate import tabulate

import bench
from bench.data import materials
from bench.demand.lobes import fitted, noise

CODECS = {
    "mean-colour": {},
    "pca": {},
    "neubtf-direct": {"steps": 650},
    "neumip": {"steps": 650},
    "relief": {"steps": 650},
    "bcf": {"steps": 650},
}


def main() -> None:
    """See the module."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--material", nargs="+", default=sorted(materials.names()))
    parser.add_argument("--codec", nargs="+", default=list(CODECS))
    parser.add_argument("--size", type=int, default=32)
    parser.add_argument("--out", type=Path, default=Path("runs/sampling"))
    options = parser.parse_args()
    rows = []
    for material in options.material:
        btf = bench.open(material, size=options.size)
        for codec in options.codec:
            file = options.out / f"{material}-{codec}.nbtf"
            if not file.exists():
                bench.encode(btf, codec, file, **CODECS.get(codec, {}))
            decoded = bench.load(file)
            found = noise(decoded, fitted(decoded).float())
            rows.append([material, codec, found.total, found.median, found.largest_albedo])
            print(*rows[-1], flush=True)
    headers = ["material", "codec", "variance × cosine's", "median over views", "largest albedo"]
    print(tabulate(rows, headers, "github", floatfmt=".3f"))


if __name__ == "__main__":
    main()
