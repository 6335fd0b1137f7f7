"""How good fits are and how long they take: scored on validation and on test pairs, each kept in a log.

    python benchmarks/fits.py LOG [--material NAME ...] [--seeds 0 1 2] [--beside CODEC] [CODEC[:SETTING=VALUE,...] ...]

`former/CODEC` is the fit of 10,000 steps that a codec had before it started at principal components, was stepped by
Muon and saw the half vector. `--beside` prints, too, how far that codec, one of them, lies above each of the others.

64² texels, 25 × 25 training pairs, one thread; a material is a name or a path, looked up under `$NEUBTF_DATA` too, and
measured data are shrunk to about 100 texels a side. What is in the log already is not fitted again, so a stopped run
goes on. Test pairs are drawn anew for each seed. Seconds are the processor's, of the fit alone. Prints Markdown
tables: means ± standard deviations over the seeds.
"""

import argparse
import dataclasses
import itertools
import json
import statistics
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

import numpy as np

from bench.btf import BTF
from bench.codec import Codec, Fit, silent
from bench.codecs import container, loading
from bench.codecs.registry import load_codec
from bench.compare.paired import Cell, interval
from bench.data.open import draw_of, open_material
from bench.data.spec import Preparation, named
from bench.material import Material
from bench.metrics.scoring import Scorer
from bench.threads import torch_threads

METRIC = "psnr_display"
FORMER = {
    "neubtf-direct": "recipe=paper",
    "neumip": "directions=xy,start=random,optimiser=adam",
    "rainer2019": "recipe=paper",
    "neubtf": "directions=xy,start=encoder,optimiser=adam,direct=0.5,taught=0.1",
}
CODECS = [text for name in FORMER for text in (f"former/{name}", f"{name}:steps=1000", name)] + ["relief"]
MATERIALS = ["satin", "brick", "cable-knit", "svbrdf/rock"]
Split = Literal["validation", "test"]
SPLITS: list[Split] = ["validation", "test"]
SIDE = 100  # texels a side that measured data are shrunk to


class Workbench:
    """A material with its two sets of held-out pairs; measured data have test pairs alone."""

    def __init__(self, name: str):
        self.name, self.spec, self._scorers = name, named(name), dict[tuple[Split, int], Scorer]()
        btf = self._open("test", 0)
        self.sets = SPLITS if draw_of(self.spec, Preparation(), 1) else SPLITS[1:]
        self.training = btf.subset(btf.split().train)

    def _open(self, split: Split, seed: int) -> BTF:
        data = Preparation(split=split)
        btf = open_material(self.spec, data, silent, draw_of(self.spec, data, seed))
        factor = round(max(btf.shape) / SIDE)
        return btf.downsample(factor) if factor > 1 else btf

    def _scorer(self, split: Split, seed: int) -> Scorer:
        draw = seed if split == "test" else 0
        key = split, draw
        if key not in self._scorers:
            btf = self._open(split, draw)
            training = btf.subset(btf.split().train)
            if training.fingerprint != self.training.fingerprint:
                raise AssertionError(f"{self.name}: the training pairs of {split} pairs are others")
            self._scorers[key] = Scorer(btf, [METRIC], sampled=training, threads=1)
        return self._scorers[key]

    def measure(self, text: str, seed: int) -> dict[str, Any]:
        """Bytes, processor seconds, and of each set of pairs the pooled PSNR and that of every slice, in dB."""
        codec = parse(text)
        with torch_threads(1), tempfile.TemporaryDirectory() as folder:
            start = time.process_time()
            parts = codec.encode(self.training, Fit(threads=1, seed=seed))
            seconds = time.process_time() - start
            header = container.save(Path(folder) / "file", codec, parts)
            material = loading.load(header.path)[1]
            found = {"material": self.name, "codec": text, "seed": seed, "version": codec.version}
            found |= {"settings": dataclasses.asdict(codec.settings), "bytes": header.file_bytes, "seconds": seconds}
            found["height"] = "height" in parts.texture
            for split in self.sets:
                raw = self._errors(self._scorer(split, seed), material)
                found[split] = {"pooled": decibels(raw.mean()), "slices": [decibels(value) for value in raw]}
        return found

    @staticmethod
    def _errors(scorer: Scorer, material: Material) -> np.ndarray:
        """The mean squared error (n,) of each held-out slice in display space."""
        wo, wi = scorer.btf.wo, scorer.btf.wi
        pairs = next(iter(scorer.btf.split().heldout.values()))
        return scorer.score(pairs, lambda i: material.slice(wo[i].tolist(), wi[i].tolist()).numpy()).raw[METRIC]


def parse(text: str) -> Codec:
    """A codec from `name`, `name:key=value,key=value` or `former/name`."""
    if text.startswith("former/"):
        name = text.removeprefix("former/")
        text = f"{name}:{FORMER[name]},steps=10000"
    name, _, rest = text.partition(":")
    return load_codec(name)(**dict(pair.split("=", 1) for pair in rest.split(",") if pair))


def decibels(squared: float) -> float:
    return round(float(-10 * np.log10(squared)), 4)


def read(log: Path) -> dict[tuple[str, str, int], dict[str, Any]]:
    """The fits of a log by material, codec and seed."""
    lines = log.read_text().splitlines() if log.exists() else []
    return {(cell["material"], cell["codec"], cell["seed"]): cell for cell in map(json.loads, lines)}


def fill(log: Path, materials: list[str], codecs: list[str], seeds: list[int]) -> None:
    """Fit, and append to the log, what it has not yet."""
    for name in materials:
        missing = [(text, seed) for seed in seeds for text in codecs if (name, text, seed) not in read(log)]
        workbench = Workbench(name) if missing else None
        for text, seed in missing:
            assert workbench
            cell = workbench.measure(text, seed)
            with log.open("a") as file:
                file.write(json.dumps(cell) + "\n")


def rows(cells: dict[tuple[str, str, int], dict[str, Any]], chosen: argparse.Namespace) -> Iterator[str]:
    """The table of what was fitted."""
    yield "| material | codec | seeds | validation, dB | test, dB | bytes | CPU s |\n|" + " --- |" * 7
    for name, text in itertools.product(chosen.material, chosen.codecs):
        if found := [cells[name, text, seed] for seed in chosen.seeds if (name, text, seed) in cells]:
            quality = [spread([cell[split]["pooled"] for cell in found if split in cell], 2) for split in SPLITS]
            size = f"{statistics.mean(cell['bytes'] for cell in found):,.0f}"
            seconds = spread([cell["seconds"] for cell in found], 0)
            yield f"| {name} | {text} | {len(found)} | {' | '.join(quality)} | {size} | {seconds} |"


def beside(cells: dict[tuple[str, str, int], dict[str, Any]], chosen: argparse.Namespace) -> Iterator[str]:
    """How far one codec lies above each of the others: mean over seeds and slices of the paired difference."""
    yield f"| material | {chosen.beside} over | seeds | pooled, dB | a slice, dB | 95 % interval |\n|" + " --- |" * 6
    for name, text in itertools.product(chosen.material, chosen.codecs):
        keys = [((name, chosen.beside, seed), (name, text, seed)) for seed in chosen.seeds]
        both = [(cells[ours], cells[theirs]) for ours, theirs in keys if ours in cells and theirs in cells]
        if text == chosen.beside or not both:
            continue
        pooled = spread([ours["test"]["pooled"] - theirs["test"]["pooled"] for ours, theirs in both], 2)
        apart = [np.subtract(ours["test"]["slices"], theirs["test"]["slices"]) for ours, theirs in both]
        seeds = [ours["seed"] for ours, _ in both]
        found = interval([Cell(name, seed, str(seed), each) for seed, each in zip(seeds, apart, strict=True)])
        assert found
        yield f"| {name} | {text} | {len(both)} | {pooled} | {found.mean:+.2f} | {found.low:+.2f} … {found.high:+.2f} |"


def spread(values: list[float], digits: int) -> str:
    if not values:
        return ""
    deviation = f" ± {statistics.stdev(values):.{digits}f}" if len(values) > 1 else ""
    return f"{statistics.mean(values):.{digits}f}{deviation}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("log", type=Path)
    parser.add_argument("codecs", nargs="*", default=CODECS, metavar="CODEC[:SETTING=VALUE,...]")
    parser.add_argument("--material", nargs="+", default=MATERIALS)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument("--beside", metavar="CODEC")
    parser.add_argument("--read", action="store_true", help="print what the log holds, and fit nothing")
    chosen = parser.parse_intermixed_args()
    if not chosen.read:
        fill(chosen.log, chosen.material, chosen.codecs, chosen.seeds)
    cells = read(chosen.log)
    print("\n".join(rows(cells, chosen)))
    if chosen.beside:
        print("\n" + "\n".join(beside(cells, chosen)))


if __name__ == "__main__":
    main()
