"""What each stored precision costs: BD-rate of a codec's ladder of rates against the same ladder at half precision.

    python benchmarks/precisions.py [--material satin brick cable-knit] [--seed 1] [CODEC ...]

Each rung is stored at each precision of its texture and of its weights; the fit is the same, so nothing differs but the
rounding. The data are 64² texels, 25 × 25 pairs to train on and 150 validation pairs, of the draw `--seed`. Prints a
Markdown table: bytes and display PSNR of each rung, and BD-rate against halves.
"""

import argparse
import itertools
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import get_args, get_type_hints

import numpy as np
import torch

from bench.btf import BTF
from bench.codec import Codec, Fit, Parts
from bench.codecs import container, loading
from bench.codecs.registry import load_codec
from bench.data.materials import load
from bench.material import Material
from bench.metrics.bd import bd_rate
from bench.metrics.scoring import Scorer
from bench.quantise import Precision, WeightPrecision, pack

LADDERS: dict[str, list[dict[str, int]]] = {
    "pca": [{"components": n} for n in (4, 8, 16, 32, 64)],
    "vq": [{"codes": n} for n in (8, 16, 32, 64, 128)],
    "rainer2019": [{"latents": n, "steps": 600} for n in (2, 4, 8, 12)],
    "neumip": [{"channels": n, "steps": 600} for n in (2, 4, 7, 10)],
    "neubtf-direct": [{"latents": n, "steps": 600} for n in (4, 8, 14, 20)],
}


def variants(kind: type[Codec]) -> list[tuple[str, str]]:
    """Precisions of texture and weights that a codec stores; "" where it has no such choice."""
    hints = get_type_hints(kind.Settings)
    both = (get_args(hints.get(name)) or ("",) for name in ("precision", "weights"))
    return list(itertools.product(*both))


def stored(codec: Codec, precision: str, weights: str) -> Codec:
    """The codec with these precisions where it has them."""
    chosen = {name: value for name, value in (("precision", precision), ("weights", weights)) if value}
    return type(codec)(**vars(replace(codec.settings, **chosen)))


def points(
    kind: type[Codec], rung: dict[str, int], btf: BTF, scorer: Scorer
) -> dict[tuple[str, str], tuple[int, float]]:
    """Bytes and PSNR of one rung at each choice of precisions. The fit is the same each time."""
    split = btf.split()
    training, held = btf.subset(split.train), split.heldout["heldout"]
    found = {}
    fitted = kind(**rung, precision="float32", weights="float32").encode(training, Fit()) if "steps" in rung else None
    with tempfile.TemporaryDirectory() as folder:
        for choice in variants(kind):
            codec = stored(kind(**rung), *choice)
            parts = rounded(fitted, *choice) if fitted else codec.encode(training, Fit())
            header = container.save(Path(folder) / "file", codec, parts)
            found[choice] = (header.file_bytes, psnr(loading.load(header.path)[1], btf, held, scorer))
    return found


def rounded(parts: Parts, precision: Precision, weights: WeightPrecision) -> Parts:
    """What a network's fit stored in float32, at other precisions."""
    texture, decoder = (
        {key: value for name, tensor in found.items() for key, value in pack(name, tensor, kind).items()}
        for found, kind in ((parts.texture, precision), (parts.decoder, weights))
    )
    return replace(parts, texture=texture, decoder=decoder)


def psnr(material: Material, btf: BTF, pairs: np.ndarray, scorer: Scorer) -> float:
    """Display PSNR in dB, pooled over some pairs."""
    scores = scorer.score(pairs, lambda i: material.slice(btf.wo[i].tolist(), btf.wi[i].tolist()).numpy())
    return float(-10 * np.log10(scores.raw["psnr_display"].mean()))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("codecs", nargs="*", metavar="CODEC", help=", ".join(LADDERS))
    parser.add_argument("--material", nargs="+", default=["satin", "brick", "cable-knit"])
    parser.add_argument("--seed", type=int, default=1)
    chosen = parser.parse_args()
    torch.set_num_threads(1)
    print("| material | codec | texture, weights | bytes · dB of each rung | BD-rate |\n|" + " --- |" * 5)
    for name in chosen.material:
        btf = load(name, seed=chosen.seed, split="validation")
        scorer = Scorer(btf, ["psnr_display"], threads=1)
        for codec in chosen.codecs or ["pca", "vq"]:
            kind = load_codec(codec)
            rungs = [points(kind, rung, btf, scorer) for rung in LADDERS[codec]]
            anchor = next(choice for choice in rungs[0] if set(choice) <= {"half", ""})
            for choice in rungs[0]:
                curve = np.array([rung[choice] for rung in rungs])
                delta = bd_rate(np.array([rung[anchor] for rung in rungs]), curve).value
                shown = ", ".join(f"{size:,.0f} · {psnr:.3f}" for size, psnr in curve)
                print(
                    f"| {name} | {codec} | {', '.join(filter(None, choice))} | {shown} | {delta:+.1f} % |", flush=True
                )


if __name__ == "__main__":
    main()
