"""NeuBTF by our recipe and by the paper's, at equal steps and at equal seconds, and what each departure gains.

    python benchmarks/recipes.py [--steps N] [--material NAME ...] [--departures NAME --size N]

64² texels, 25 × 25 training pairs, 150 validation pairs, one seed. Prints Markdown tables: for each material our
recipe, the paper's with as many steps, and the paper's with as many processor seconds as ours took; then, on one
material, the paper's recipe with one departure at a time, and ours without one, each with as many steps.
"""

import argparse
from typing import Any

import torch
from learned import Bench

from bench.codecs.registry import load_codec
from bench.data.materials import load

PAPER = {"recipe": "paper"}
PUBLISHED = load_codec("neubtf").recipes["paper"]
# The departures of our recipe, each by itself; `STAGES` is the frozen renderer, too.
TRIALS = (5, 25)  # steps
STAGES = {"direct": 0.5, "taught": 0.1}
DEPARTURES: dict[str, dict[str, Any]] = {
    "as the paper states it": {},
    "single samples, not whole slices": {"pixels": "samples"},
    "both losses of a pixel": {"loss": "both"},
    "slices at their own brightness": {"levelled": True},
    "a faint start at the mean": {"init": "faint"},
    "random inputs a quarter, at a fifth": {"explore": 0.25, "explore_weight": 0.2},
    "half of the inputs keep their scale": {"keep_scale": 0.5},
    "Muon for the renderer": {"optimiser": "muon"},
    "all of both directions, and the half vector": {"directions": "xyzh"},
    "stages, and the renderer frozen": STAGES,
}


def measured(bench: Bench, **settings: Any) -> tuple[str, float]:
    """Cells of a row: steps, processor seconds, PSNR and SSIM of held-out pairs; and the seconds."""
    codec = load_codec("neubtf")(**settings)
    _, psnr, ssim, _, seconds = bench.measure(codec, 0)
    return f"{codec.settings.steps:,} | {seconds:.0f} | {psnr:.2f} | {ssim:.3f}", seconds


def steps_in(bench: Bench, seconds: float, **settings: Any) -> int:
    """The steps that a recipe does in so many processor seconds, by a trial of two lengths."""
    short, long = (measured(bench, steps=steps, **settings)[1] for steps in TRIALS)
    return max(TRIALS[0], round(TRIALS[0] + (seconds - short) * (TRIALS[1] - TRIALS[0]) / max(long - short, 1e-3)))


def compared(bench: Bench, name: str, steps: int) -> None:
    """Print the rows of one material."""
    cells, seconds = measured(bench, steps=steps)
    print(f"| {name} | ours | {cells} |", flush=True)
    print(f"| | paper, equal steps | {measured(bench, steps=steps, **PAPER)[0]} |", flush=True)
    equal = steps_in(bench, seconds, **PAPER)
    print(f"| | paper, equal seconds | {measured(bench, steps=equal, **PAPER)[0]} |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=1200)
    parser.add_argument("--material", nargs="*", default=["satin", "brick", "cable-knit"])
    parser.add_argument("--size", type=int, default=64, help="texels a side where departures are measured")
    parser.add_argument("--departures", default="satin", metavar="MATERIAL", help="'' for none")
    chosen = parser.parse_args()
    torch.set_num_threads(1)
    head = "steps | CPU s | PSNR, dB | SSIM |"
    print(f"| material | recipe | {head}\n|" + " --- |" * 6)
    for name in chosen.material:
        compared(Bench(load(name, split="validation"), 1), name, chosen.steps)
    if chosen.departures:
        print(f"\n| the paper's recipe, but | {head}\n|" + " --- |" * 5)
        bench = Bench(load(chosen.departures, chosen.size, split="validation"), 1)
        for what, departure in DEPARTURES.items():
            settings = PAPER | departure | {"steps": chosen.steps}
            print(f"| {what} | {measured(bench, **settings)[0]} |", flush=True)
        print(f"| all of them: our recipe | {measured(bench, steps=chosen.steps)[0]} |", flush=True)
        print(f"\n| our recipe, but | {head}\n|" + " --- |" * 5)
        for what, departure in DEPARTURES.items():
            if departure:
                back = {name: PUBLISHED[name] for name in departure}
                print(f"| without {what} | {measured(bench, steps=chosen.steps, **back)[0]} |", flush=True)


if __name__ == "__main__":
    main()
