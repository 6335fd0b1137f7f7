"""The heights that `relief` finds, beside the true ones of built-in materials, and where its slices fail.

    python benchmarks/heights.py [--out docs/images] [--material NAME ...] [--failing NAME] [--steps N]

64² texels, 25 × 25 pairs. Prints a Markdown table: correlation with the true height, root mean square error, its mean
and the deviation of the truth, in widths of the picture, and what decides whether a height is written. NAME-flat is a
material without its relief. Draws true and found heights, and of one material, fitted in N steps, the validation slice
of greatest error: truth, decoded, their difference.
"""

import argparse
import dataclasses
from pathlib import Path

import numpy as np
import torch
from matplotlib import colormaps
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from neubtf_pictures import grid

from baselines.relief import sweep
from bench.btf import BTF
from bench.codec import Fit
from bench.codecs.registry import load_codec
from bench.data.materials import load, recipe
from bench.data.materials.maps import resize
from bench.data.materials.store import load_or_render
from bench.data.spec import Preparation
from bench.hemisphere import to_degrees
from bench.metrics.display import exposure, to_display
from bench.threads import torch_threads
from bench.training import gain_of

Array = np.ndarray
SIZE = 64
MATERIALS = ["cable-knit", "brick", "satin", "leather", "hammered-copper", "wicker"]
FLAT = ["satin-flat", "leather-flat", "cable-knit-flat", "brick-flat", "brushed-metal-flat"]


def opened(name: str) -> tuple[BTF, Array]:
    """The training pairs of a material and its true height (H, W), of which the mean is 0."""
    material = recipe(name.removesuffix("-flat"))
    if name.endswith("-flat"):
        material = dataclasses.replace(material, height=0.0)
    btf = load_or_render(name, material, Preparation(SIZE, heldout=0))
    height = resize(material.maps(0).height, (SIZE, SIZE))
    return btf, height - height.mean()


def row(name: str, found: sweep.SweptHeight, truth: Array) -> str:
    """The row of one material."""
    cells = ["", "", "", f"{truth.std():.4f}", f"{found.gain:.2f}", f"{found.likeness:.2f}"]
    if truth.any():
        error = found.height.numpy() - truth
        likeness = np.corrcoef(found.height.numpy().ravel(), truth.ravel())[0, 1]
        cells[:3] = f"{likeness:.3f}", f"{np.sqrt(np.square(error).mean()):.4f}", f"{error.mean():+.4f}"
    return f"| {name} | {' | '.join(cells)} | {'yes' if found.stands else 'no'} |"


def drawn(heights: dict[str, tuple[Array, Array]]) -> Figure:
    """True and found heights (H, W), each pair on one scale."""
    scales = [np.percentile(truth, [0.5, 99.5]) for truth, _ in heights.values()]
    pairs = [
        [colormaps["viridis"](Normalize(*scale)(h)) for h in both]
        for both, scale in zip(heights.values(), scales, strict=True)
    ]
    return grid(list(zip(*pairs, strict=True)), list(heights), ["true", "found"])


def failing(name: str, steps: int) -> Figure:
    """The validation slice of greatest error of a fit: truth, decoded, their difference."""
    btf = load(name, SIZE, split="validation")
    split = btf.split()
    codec = load_codec("relief")(steps=steps)
    material = codec.decode(codec.encode(btf.subset(split.train), Fit(threads=1)), torch.device("cpu"))
    shown, scale = {}, exposure(btf)
    for pair in split.heldout["heldout"].tolist():
        decoded = material.slice(btf.wo[pair].tolist(), btf.wi[pair].tolist()).numpy()
        shown[pair] = [to_display(np.maximum(each, 0), scale) for each in (btf[pair], decoded)]
    worst = max(shown, key=lambda pair: float(np.square(np.subtract(*shown[pair])).mean()))
    truth, ours = shown[worst]
    print(
        f"{name}, {steps:,} steps, the worst of {len(shown)}: {-10 * np.log10(np.square(truth - ours).mean()):.1f} dB"
    )
    view, light = (float(to_degrees(each)[0]) for each in (btf.wo[worst], btf.wi[worst]))
    figure = grid([[truth, ours, np.clip(abs(truth - ours), 0, 1)]], ["truth", "decoded", "difference"], [""])
    figure.suptitle(f"{name}: view {view:.0f}° and light {light:.0f}° from the normal", fontsize=9)
    return figure


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, help="where the pictures go; none are drawn without it")
    parser.add_argument("--material", nargs="+", default=[*MATERIALS, *FLAT])
    parser.add_argument("--failing", default="cable-knit")
    parser.add_argument("--steps", type=int, default=650)
    chosen = parser.parse_args()
    heights = {}
    heads = ["material", "correlation", "RMS error", "mean error", "deviation of the truth", "least gain", "likeness"]
    print("| " + " | ".join([*heads, "written"]) + " |\n|" + " --- |" * (len(heads) + 1))
    with torch_threads(1):
        for name in chosen.material:
            btf, truth = opened(name)
            found = sweep.find(btf, gain_of(btf, Fit()), Fit())
            assert found is not None
            print(row(name, found, truth), flush=True)
            if truth.any():
                heights[name] = (truth, found.height.numpy())
        if chosen.out:
            drawn(heights).savefig(chosen.out / "relief-heights.png", dpi=80)
            failing(chosen.failing, chosen.steps).savefig(chosen.out / "relief-failure.png", dpi=80)


if __name__ == "__main__":
    main()
