"""Held-out quality of codecs over built-in materials and seeds, from the files they write.

    python benchmarks/learned.py [--material satin ...] [--seeds 3] [--threads 1] CODEC[:SETTING=VALUE,...] ...

For instance `python benchmarks/learned.py --material cable-knit svbrdf/rock neumip neumip:offset=false`; a material is
a name or a path, looked up under `$NEUBTF_DATA` too. The data are 64² texels, 25 × 25 pairs to train on and 150 between
them to score. Prints a Markdown table: display-space PSNR pooled over training pairs (75 of them) and held-out pairs,
SSIM of the latter, each as mean ± standard deviation over the seeds, bytes of the file, how far the held-out PSNR lies
above that of the best PCA of at most 1.05 × the bytes (logarithms or RGB, every number of components, eight bits), and
processor seconds of the fit, which a busy machine stretches less than the clock.
"""

import argparse
import itertools
import statistics
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from bench.btf import BTF
from bench.codec import Codec, Fit, silent
from bench.codecs import container, loading
from bench.codecs.registry import load_codec
from bench.data.open import open_material
from bench.data.spec import Preparation, named
from bench.metrics import default_names
from bench.metrics.scoring import Scorer, summarise
from bench.records import SSIM, metric_of
from bench.threads import torch_threads

TRAINING_PAIRS = 75  # scored of all
LEEWAY = 1.05  # bytes that a PCA may have over the codec it is compared with


def parse(text: str) -> Codec:
    """A codec from `name` or `name:key=value,key=value`."""
    name, _, rest = text.partition(":")
    return load_codec(name)(**dict(pair.split("=", 1) for pair in rest.split(",") if pair))


class Bench:
    """One material, and what its codecs are scored on."""

    def __init__(self, btf: BTF, threads: int):
        split = btf.split()
        self.btf, self.threads, self.training = btf, threads, btf.subset(split.train)
        some = np.sort(np.random.default_rng(0).choice(split.train, TRAINING_PAIRS, replace=False))
        self.groups = {"train": some, "heldout": split.heldout["heldout"]}
        self.ssim = metric_of(default_names(btf.periodic), SSIM)
        self.scorer = Scorer(btf, ["psnr_display", self.ssim], threads=threads)
        self.pca: dict[str, tuple[float, int]] = {}  # held-out PSNR and bytes by setting

    def measure(self, codec: Codec, seed: int) -> tuple[float, float, float, int, float]:
        """PSNR of training and held-out pairs, SSIM of the latter, bytes, processor seconds."""
        with torch_threads(self.threads), tempfile.TemporaryDirectory() as folder:
            start = time.process_time()
            parts = codec.encode(self.training, Fit(threads=self.threads, seed=seed))
            seconds = time.process_time() - start
            header = container.save(Path(folder) / "file", codec, parts)
            material = loading.load(header.path)[1]
            wo, wi = self.btf.wo, self.btf.wi
            scores = self.scorer.score(
                np.concatenate([*self.groups.values()]),
                lambda i: material.slice(wo[i].tolist(), wi[i].tolist()).numpy(),
            )
        found = summarise(scores, wo, wi, self.groups)
        train, held = (found[group]["metrics"] for group in ("train", "heldout"))
        psnr = (train["psnr_display"]["pooled"], held["psnr_display"]["pooled"])
        return *psnr, held[self.ssim]["mean"], header.file_bytes, seconds

    def best_pca(self, limit: float) -> tuple[float, str]:
        """The held-out PSNR, and the settings, of the best PCA whose file has at most `limit` bytes."""
        found = []
        for domain in ("log", "rgb"):
            for components in itertools.count(1):
                text = f"pca:domain={domain},components={components}"
                if text not in self.pca:
                    _, psnr, _, size, _ = self.measure(parse(text), 0)
                    self.pca[text] = (psnr, size)
                if self.pca[text][1] > limit:
                    break
                found.append((self.pca[text][0], text))
        return max(found)


def rows(names: list[str], codecs: list[str], seeds: int, threads: int) -> Iterator[str]:
    """The lines of the table, each as soon as its last seed is done."""
    for name in names:
        bench = Bench(open_material(named(name), Preparation(split="validation"), silent), threads)
        for text in codecs:
            train, held, ssim, size, seconds = zip(*(bench.measure(parse(text), s) for s in range(seeds)), strict=True)
            cells = [name, text, *(_spread(values, 2) for values in (train, held)), _spread(ssim, 3)]
            psnr, pca = bench.best_pca(LEEWAY * size[0])
            margin = f"{statistics.mean(held) - psnr:+.2f} ({pca.removeprefix('pca:')})"
            yield "| " + " | ".join([*cells, f"{size[0]:,}", margin, f"{statistics.mean(seconds):.0f}"]) + " |"


def _spread(values: tuple[float, ...], digits: int) -> str:
    deviation = f" ± {statistics.stdev(values):.{digits}f}" if len(values) > 1 else ""
    return f"{statistics.mean(values):.{digits}f}{deviation}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("codecs", nargs="+", metavar="CODEC[:SETTING=VALUE,...]")
    parser.add_argument("--material", nargs="+", default=["satin", "cable-knit", "brick"])
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--threads", type=int, default=1)
    chosen = parser.parse_args()
    heads = ["material", "codec", "train dB", "held-out dB", "SSIM", "bytes", "over PCA, dB", "CPU s"]
    print("| " + " | ".join(heads) + " |\n|" + " --- |" * len(heads))
    for row in rows(chosen.material, chosen.codecs, chosen.seeds, chosen.threads):
        print(row, flush=True)


if __name__ == "__main__":
    main()
