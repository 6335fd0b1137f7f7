"""How good fits are and how long they take: scored on validation and on test pairs, each kept in a log.

    python benchmarks/fits.py LOG [--material NAME ...] [--seeds 0 1 2] [--splits validation test] [--beside CODEC]
        [CODEC[:SETTING=VALUE,...] ...]

`former/CODEC` is the fit of 10,000 steps that a codec had before it started at principal components, was stepped by
Muon and saw the half vector. `--beside` prints, too, how far that codec, one of them, lies above each of the others.

64² texels, 25 × 25 training pairs, one thread; a material is a name or a path, looked up under `$NEUBTF_DATA` too, and
measured data are shrunk to about 100 texels a side. What is in the log already is not fitted again, so a stopped run
goes on. Test pairs are drawn anew for each seed. Validation pairs of measured data are views and lights of those that
the test leaves for training, others for each seed; so each set of pairs has a fit of its own there. Seconds are the
processor's, of one fit alone. Prints Markdown tables: means ± standard deviations over the seeds.
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
from bench.codecs import container, loading, shared
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
    """A material with the sets of held-out pairs to score at."""

    def __init__(self, name: str, splits: list[Split]):
        self.name, self.spec, self.splits = name, named(name), splits
        self._scorers = dict[tuple[Split, int], tuple[Scorer, BTF, np.ndarray]]()

    def _open(self, split: Split, seed: int) -> BTF:
        data = Preparation(split=split)
        btf = open_material(self.spec, data, silent, draw_of(self.spec, data, seed))
        factor = round(max(btf.shape) / SIDE)
        return btf.downsample(factor) if factor > 1 else btf

    def _scorer(self, split: Split, seed: int) -> tuple[Scorer, BTF, np.ndarray]:
        """The scorer of a set of pairs, the training pairs that go with it, and the pairs that it scores."""
        if (split, seed) not in self._scorers:
            btf = self._open(split, seed)
            parted = btf.split(seed if split == "validation" else 0)  # where the data declare pairs, these
            training = btf.subset(parted.train)
            scorer = Scorer(btf, [METRIC], sampled=training, threads=1)
            self._scorers[split, seed] = scorer, training, next(iter(parted.heldout.values()))
        return self._scorers[split, seed]

    def measure(self, text: str, seed: int) -> dict[str, Any]:
        """Bytes, processor seconds, and of each set of pairs the pooled PSNR and that of every slice, in dB."""
        codec, fitted = parse(text), dict[str, Material]()
        network = shared.find_for(codec)
        found: dict[str, Any] = {"material": self.name, "codec": text, "seed": seed, "version": codec.version}
        found["settings"] = dataclasses.asdict(codec.settings)
        with torch_threads(1), tempfile.TemporaryDirectory() as folder:
            for split in self.splits:
                scorer, training, pairs = self._scorer(split, seed)
                if training.fingerprint not in fitted:
                    start = time.process_time()
                    parts = codec.encode(training, Fit(threads=1, seed=seed, network=network))
                    found["seconds"] = time.process_time() - start
                    header = container.save(Path(folder) / split, codec, parts)
                    found |= {"bytes": header.file_bytes, "height": "height" in parts.texture}
                    fitted[training.fingerprint] = loading.load(header.path)[1]
                raw = self._errors(scorer, pairs, fitted[training.fingerprint])
                found[split] = {"pooled": decibels(raw.mean()), "slices": [decibels(value) for value in raw]}
        return found

    @staticmethod
    def _errors(scorer: Scorer, pairs: np.ndarray, material: Material) -> np.ndarray:
        """The mean squared error (n,) in display space of the slices of some pairs."""
        wo, wi = scorer.btf.wo, scorer.btf.wi
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


def fill(log: Path, chosen: argparse.Namespace) -> None:
    """Fit, and append to the log, what it has not yet."""
    for name in chosen.material:
        cells = itertools.product(chosen.seeds, chosen.codecs)
        missing = [(text, seed) for seed, text in cells if (name, text, seed) not in read(log)]
        workbench = Workbench(name, chosen.splits) if missing else None
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
    parser.add_argument("--splits", nargs="+", choices=SPLITS, default=SPLITS, help="of a log all the same")
    parser.add_argument("--beside", metavar="CODEC", help="compares at test pairs")
    parser.add_argument("--read", action="store_true", help="print what the log holds, and fit nothing")
    chosen = parser.parse_intermixed_args()
    if not chosen.read:
        fill(chosen.log, chosen)
    cells = read(chosen.log)
    print("\n".join(rows(cells, chosen)))
    if chosen.beside:
        print("\n" + "\n".join(beside(cells, chosen)))


if __name__ == "__main__":
    main()
