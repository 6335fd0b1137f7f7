"""How good fits are and how long they take: what codecs reach on held-out pairs, each fit kept in a log.

    python tools/fits.py LOG [--material NAME ...] [--seeds 0 1 2] [--splits validation test] [--size 64]
        [--beside CODEC] [CODEC[:SETTING=VALUE,...] ...]

`former/CODEC` is the fit of 10,000 steps that a codec had before it started at principal components, was stepped by
Muon and saw the half vector. `--beside` prints, too, how far that codec, one of them, lies above each of the others.

64² texels, 25 × 25 training pairs, one thread; a material is a name or a path, looked up under `$NEUBTF_DATA` too, and
measured data are shrunk to about 100 texels a side. What is in the log already is not fitted again, so a stopped run
goes on. Test pairs are drawn anew for each seed. Validation pairs of measured data are views and lights of those that
the test leaves for training, others for each seed; so each set of pairs has a fit of its own there. `training` scores
75 of the pairs that were fitted. Seconds are the processor's, of one fit alone. Prints Markdown tables: means ±
standard deviations over the seeds; SSIM, and how far a codec lies above the best `pca:` in the log of at most 1.05 ×
its bytes, are of the first held-out pairs that were scored.
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
from bench.metrics import default_names
from bench.metrics.scoring import Scorer
from bench.records import SSIM, metric_of
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
Split = Literal["validation", "test", "training"]
SPLITS: list[Split] = ["validation", "test", "training"]
SIDE = 100  # texels a side that measured data are shrunk to
TRAINING_PAIRS = 75  # scored of all
LEEWAY = 1.05  # bytes that a PCA may have over the codec it is compared with
Cells = dict[tuple[str, str, int], dict[str, Any]]


class Workbench:
    """A material with the sets of pairs to score at."""

    def __init__(self, name: str, splits: list[Split], size: int):
        self.name, self.spec, self.splits, self.size = name, named(name), splits, size
        self._scorers = dict[tuple[Split, int], tuple[Scorer, BTF, np.ndarray]]()

    def _open(self, split: Split, seed: int) -> BTF:
        data = Preparation(size=self.size, split="test" if split == "test" else "validation")
        btf = open_material(self.spec, data, silent, draw_of(self.spec, data, seed))
        factor = round(max(btf.shape) / SIDE) if self.spec.path else 1
        return btf.downsample(factor) if factor > 1 else btf

    def _scorer(self, split: Split, seed: int) -> tuple[Scorer, BTF, np.ndarray]:
        """The scorer of a set of pairs, the training pairs that go with it, and the pairs that it scores."""
        if (split, seed) not in self._scorers:
            btf = self._open(split, seed)
            parted = btf.split(0 if split == "test" else seed)  # where the data declare pairs, these
            training, pairs = btf.subset(parted.train), next(iter(parted.heldout.values()))
            if split == "training" and len(parted.train) > TRAINING_PAIRS:
                pairs = np.sort(np.random.default_rng(0).choice(parted.train, TRAINING_PAIRS, replace=False))
            scorer = Scorer(btf, [METRIC, ssim_of(btf)], sampled=training, threads=1)
            self._scorers[split, seed] = scorer, training, pairs
        return self._scorers[split, seed]

    def measure(self, text: str, seed: int) -> dict[str, Any]:
        """Bytes, processor seconds, and of each set of pairs PSNR of every slice and their mean, in dB, and SSIM."""
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
                found[split] = self._scored(scorer, pairs, fitted[training.fingerprint])
        return found

    @staticmethod
    def _scored(scorer: Scorer, pairs: np.ndarray, material: Material) -> dict[str, Any]:
        """What a material reaches at some pairs."""
        wo, wi = scorer.btf.wo, scorer.btf.wi
        raw = scorer.score(pairs, lambda i: material.slice(wo[i].tolist(), wi[i].tolist()).numpy()).raw
        errors = raw[METRIC]
        slices = [decibels(value) for value in errors]
        return {"mean": statistics.mean(slices), "slices": slices, "ssim": float(raw[ssim_of(scorer.btf)].mean())}


def ssim_of(btf: BTF) -> str:
    return metric_of(default_names(btf.periodic), SSIM)


def parse(text: str) -> Codec:
    """A codec from `name`, `name:key=value,key=value` or `former/name`."""
    if text.startswith("former/"):
        name = text.removeprefix("former/")
        text = f"{name}:{FORMER[name]},steps=10000"
    name, _, rest = text.partition(":")
    return load_codec(name)(**dict(pair.split("=", 1) for pair in rest.split(",") if pair))


def decibels(squared: float) -> float:
    return round(float(-10 * np.log10(squared)), 4)


def read(log: Path) -> Cells:
    """The fits of a log by material, codec and seed."""
    lines = log.read_text().splitlines() if log.exists() else []
    return {(cell["material"], cell["codec"], cell["seed"]): cell for cell in map(json.loads, lines)}


def fill(log: Path, chosen: argparse.Namespace) -> None:
    """Fit, and append to the log, what it has not yet."""
    for name in chosen.material:
        cells = itertools.product(chosen.seeds, chosen.codecs)
        missing = [(text, seed) for seed, text in cells if (name, text, seed) not in read(log)]
        workbench = Workbench(name, chosen.splits, chosen.size) if missing else None
        for text, seed in missing:
            assert workbench
            cell = workbench.measure(text, seed)
            with log.open("a") as file:
                file.write(json.dumps(cell) + "\n")


def chosen_cells(cells: Cells, chosen: argparse.Namespace) -> Iterator[tuple[str, str, list[dict[str, Any]]]]:
    """Of each material and codec that was fitted, the fits of all seeds."""
    for name, text in itertools.product(chosen.material, chosen.codecs):
        if found := [cells[name, text, seed] for seed in chosen.seeds if (name, text, seed) in cells]:
            yield name, text, found


def rows(cells: Cells, chosen: argparse.Namespace) -> Iterator[str]:
    """The table of what was fitted."""
    heads = ["material", "codec", "seeds", *(f"{split}, dB" for split in SPLITS), "SSIM", "bytes", "over PCA, dB"]
    yield "| " + " | ".join([*heads, "CPU s"]) + " |\n|" + " --- |" * (len(heads) + 1)
    for name, text, found in chosen_cells(cells, chosen):
        quality = [spread([cell[split]["mean"] for cell in found if split in cell], 2) for split in SPLITS]
        split = next(split for split in SPLITS if split in found[0])
        alike = spread([cell[split]["ssim"] for cell in found if "ssim" in cell[split]], 3)
        size, seconds = mean_bytes(found), spread([cell["seconds"] for cell in found], 0)
        line = [name, text, str(len(found)), *quality, alike, f"{size:,.0f}", over_pca(cells, name, found, split)]
        yield "| " + " | ".join([*line, seconds]) + " |"


def over_pca(cells: Cells, name: str, found: list[dict[str, Any]], split: Split) -> str:
    """How far a codec lies above the best PCA of the log that has no more bytes."""
    limit, ours = LEEWAY * mean_bytes(found), statistics.mean(cell[split]["mean"] for cell in found)
    of_pca = [cell for (material, text, _), cell in cells.items() if material == name and text.startswith("pca:")]
    theirs = [(cell[split]["mean"], cell["codec"]) for cell in of_pca if split in cell and cell["bytes"] <= limit]
    return "{:+.2f} ({})".format(ours - max(theirs)[0], max(theirs)[1].removeprefix("pca:")) if theirs else ""


def mean_bytes(found: list[dict[str, Any]]) -> float:
    return statistics.mean(cell["bytes"] for cell in found)


def beside(cells: Cells, chosen: argparse.Namespace) -> Iterator[str]:
    """How far one codec lies above each of the others: mean over seeds and slices of the paired difference."""
    yield f"| material | {chosen.beside} over | seeds | a slice, dB | 95 % interval |\n|" + " --- |" * 5
    for name, text in itertools.product(chosen.material, chosen.codecs):
        keys = [((name, chosen.beside, seed), (name, text, seed)) for seed in chosen.seeds]
        both = [(cells[ours], cells[theirs]) for ours, theirs in keys if ours in cells and theirs in cells]
        if text == chosen.beside or not both:
            continue
        apart = [np.subtract(ours["test"]["slices"], theirs["test"]["slices"]) for ours, theirs in both]
        seeds = [ours["seed"] for ours, _ in both]
        found = interval([Cell(name, seed, str(seed), each) for seed, each in zip(seeds, apart, strict=True)])
        assert found
        yield f"| {name} | {text} | {len(both)} | {found.mean:+.2f} | {found.low:+.2f} … {found.high:+.2f} |"


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
    parser.add_argument("--splits", nargs="+", choices=SPLITS, default=SPLITS[:2], help="of a log all the same")
    parser.add_argument(
        "--size", type=int, default=64, help="texels a side of rendered materials, of a log all the same"
    )
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
