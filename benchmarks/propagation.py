"""Propagation to what was never seen: fitted to a part of a material, guided by a slice of the whole.

    python benchmarks/propagation.py [--material NAME ...] [--quarter] [--size 128] [--set steps=3600 ...]
        [--keep FOLDER] [--pictures FOLDER]

NeuBTF is fitted to the left half of each material's texels, or with `--quarter` to the upper left quarter, which does
not wrap around. Its encoder is then shown the most frontal slice of all texels. A material is built in (25 × 25 pairs),
or a path, looked up under `$NEUBTF_DATA` too: about 1,000 pairs of measured data, averaged to about `--size` texels a
side. Prints a Markdown table of display-space PSNR, pooled over at most 150 validation pairs: of the part that it was
fitted to, of the rest, and of what must be beaten there by 3 dB, the seen part's mean ABRDF in every texel. `--keep`
names a folder for the fitted files, which are then not fitted again; `--pictures` one for a picture of each material.
Exit code 1 where a margin is missed.
"""

import argparse
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from PIL import Image

from bench.btf import BTF
from bench.codec import Fit, silent
from bench.codecs import container
from bench.data.open import open_material
from bench.data.spec import Preparation, named
from bench.metrics.display import exposure, to_display
from bench.threads import torch_threads
from neubtf import propagation
from neubtf.codec import NeuBTF
from neubtf.guidance import RADIANCE, Treatment, guidance_of
from neubtf.renderer import NeuBTFMaterial

Array = np.ndarray
AIM = 3.0  # dB above the mean ABRDF
# End to end from the first step, on single samples alone: the way to a useful encoder in a minute of one core.
BRIEF = {
    "steps": 1800,
    "direct": 0.0,
    "taught": 0.0,
    "explore": 0.1,
    "slices": 0,
    "smallest": 1.0,
    "style": 0.0,
    "frequency": 0.0,
    "crop": 48,
}


def opened(name: str, size: int) -> BTF:
    """A material with validation pairs."""
    return open_material(named(name), Preparation(size=size, texels=size, pairs=1_000, split="validation"), silent)


def heldout(btf: BTF) -> Array:
    """At most 150 of the validation pairs, evenly spread."""
    pairs = np.sort(np.concatenate(list(btf.split().heldout.values())))
    return pairs[:: -(-len(pairs) // 150)]


def part_of(btf: BTF, quarter: bool = False) -> BTF:
    """The training pairs of the left half of a BTF, or of its upper left quarter, which is not periodic."""
    height, width = btf.shape
    return btf.subset(btf.split().train).crop(0, 0, height // 2 if quarter else height, width // 2)


def fitted(btf: BTF, codec: NeuBTF, path: Path, seed: int = 0) -> Path:
    """The file of a fit, from `path` where it was kept."""
    if not path.exists() or container.read_header(path).settings != vars(codec.settings):
        container.save(path, codec, codec.encode(btf, Fit(seed=seed)))
    return path


def guided(source: propagation.FittedMaterial, picture: Array, treatment: Treatment) -> NeuBTFMaterial:
    """The material of a fit with the texture that a linear picture (H, W, 3) gives."""
    image, _ = guidance_of(picture, treatment, source.guidance, source.exposure)
    codec, parts = source.guided(propagation.textured(source.encoder, image))
    material = codec.decode(parts, torch.device("cpu"))
    assert isinstance(material, NeuBTFMaterial)
    return material


@dataclass(frozen=True)
class Errors:
    """Mean squared errors in display space: of the part that was seen, of the rest, and of the mean ABRDF there."""

    seen: float
    rest: float
    mean_abrdf: float


def compared(btf: BTF, material: NeuBTFMaterial, part: tuple[int, int]) -> Errors:
    """A material of the whole, guided from its upper left part (h, w), against the truth at validation pairs."""
    shown, seen = exposure(btf), np.zeros(btf.shape, bool)
    seen[: part[0], : part[1]] = True
    found = []
    for pair in heldout(btf):
        linear = btf[pair]
        truth = to_display(linear, shown)
        ours = to_display(material.slice(btf.wo[pair].tolist(), btf.wi[pair].tolist()).numpy(), shown)
        mean = to_display(linear[seen].mean(0), shown)
        error = np.square(ours - truth)
        found.append([error[seen].mean(), error[~seen].mean(), np.square(truth[~seen] - mean).mean()])
    return Errors(*np.mean(found, 0).tolist())


def frontal(btf: BTF) -> Array:
    """What a photograph with a flash shows, linear (H, W, 3)."""
    trained = btf.subset(btf.split().train)
    return btf[int((trained.wo[:, 2] + trained.wi[:, 2]).argmax())]


def row(name: str, chosen: argparse.Namespace, folder: Path) -> tuple[str, float]:
    """The line of a material in the table, and its margin."""
    settings = dict(word.split("=", 1) for word in chosen.set)
    btf, codec = opened(name, chosen.size), NeuBTF(keep_encoder=True, **BRIEF | settings)
    part, short = part_of(btf, chosen.quarter), Path(name).name
    path = folder / f"{short}-{chosen.size}-{'quarter' if chosen.quarter else 'left'}-{chosen.seed}.nbtf"
    start = time.process_time()
    source = propagation.FittedMaterial.read(fitted(part, codec, path, chosen.seed))
    seconds = time.process_time() - start
    material = guided(source, frontal(btf), Treatment(exposure=RADIANCE))
    if chosen.pictures:
        picture = np.concatenate([to_display(each, exposure(btf)) for each in at_heldout(btf, material)], 1)
        Image.fromarray((picture * 255).round().astype(np.uint8)).save(chosen.pictures / f"{short}.png")
    errors = compared(btf, material, part.shape)
    seen, rest, mean = (-10 * np.log10(error) for error in (errors.seen, errors.rest, errors.mean_abrdf))
    cells = [short, *(f"{x:.2f}" for x in (seen, rest, mean)), f"{rest - mean:+.2f}", f"{seconds:.0f}"]
    return "| " + " | ".join(cells) + " |", rest - mean


def at_heldout(btf: BTF, material: NeuBTFMaterial) -> list[Array]:
    """Guidance, and truth and answer at the middle of the validation pairs, linear."""
    pair = heldout(btf)[len(heldout(btf)) // 2]
    return [frontal(btf), btf[pair], material.slice(btf.wo[pair].tolist(), btf.wi[pair].tolist()).numpy()]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--material", nargs="+", default=["brick", "gravel", "satin"])
    parser.add_argument("--quarter", action="store_true", help="fit to a quarter of the texels, not to half of them")
    parser.add_argument("--size", type=int, default=128)
    parser.add_argument(
        "--set", nargs="*", default=[], metavar="KEY=VALUE", help="settings of codec neubtf, besides BRIEF"
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--keep", type=Path, help="a folder for the fitted files")
    parser.add_argument("--pictures", type=Path, help="a folder for guidance, truth and answer of each material")
    chosen = parser.parse_args()
    if chosen.pictures:
        chosen.pictures.mkdir(parents=True, exist_ok=True)
    print("| material | seen, dB | not seen, dB | mean ABRDF there, dB | above it, dB | CPU s of the fit |")
    print("| --- | --- | --- | --- | --- | --- |")
    margins = []
    with tempfile.TemporaryDirectory() as scratch, torch_threads(1):
        folder = chosen.keep or Path(scratch)
        folder.mkdir(parents=True, exist_ok=True)
        for name in chosen.material:
            line, margin = row(name, chosen, folder)
            print(line, flush=True)
            margins.append(margin)
    return 0 if min(margins) >= AIM else 1


if __name__ == "__main__":
    sys.exit(main())
