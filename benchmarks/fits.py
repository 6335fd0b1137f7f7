"""How soon each learned codec is as good as it was by the former fit, from the files it writes.

    python benchmarks/fits.py [--material NAME ...] [--seeds 3] [--steps N ...] [--former N] [CODEC ...]

64² texels, 25 × 25 training pairs, 150 validation pairs, one thread; a material is a name or a path, looked up under
`$NEUBTF_DATA` too. *Former* is the fit that a codec had before it started at principal components, was stepped by Muon
and saw the half vector. Prints a Markdown table, mean ± standard deviation over the seeds: held-out display PSNR,
processor seconds of the fit, and both beside the former fit's of the same run. Seconds are of a fit alone, without
reading or rendering the material; `--former 0` leaves the former fit out.
"""

import argparse
import statistics
from collections.abc import Iterator

from learned import Bench, parse

from bench.codec import silent
from bench.data.open import open_material
from bench.data.spec import Preparation, named

FORMER = {
    "neubtf-direct": "recipe=paper",
    "neumip": "directions=xy,start=random,optimiser=adam",
    "rainer2019": "recipe=paper",
    "neubtf": "directions=xy,start=encoder,optimiser=adam,direct=0.5,taught=0.1",
}
MATERIALS = ["satin", "brick", "cable-knit", "svbrdf/rock"]


def measured(bench: Bench, codec: str, seeds: int) -> tuple[list[float], list[float]]:
    """Held-out PSNR and processor seconds of each seed."""
    found = [bench.measure(parse(codec), seed) for seed in range(seeds)]
    return [psnr for _, psnr, *_ in found], [seconds for *_, seconds in found]


def spread(values: list[float], digits: int) -> str:
    deviation = f" ± {statistics.stdev(values):.{digits}f}" if len(values) > 1 else ""
    return f"{statistics.mean(values):.{digits}f}{deviation}"


def rows(bench: Bench, codec: str, chosen: argparse.Namespace) -> Iterator[str]:
    """The rows of one codec on one material: the former fit, and ours at each number of steps."""
    former: tuple[list[float], list[float]] | None = None
    if chosen.former:
        former = measured(bench, f"{codec}:{FORMER[codec]},steps={chosen.former}", chosen.seeds)
        yield f"{codec}, former | {chosen.former:,} | {spread(former[0], 2)} | | {spread(former[1], 0)} | |"
    for steps in chosen.steps:
        psnr, seconds = measured(bench, f"{codec}:steps={steps}", chosen.seeds)
        gain = share = ""
        if former:
            gain = f"{statistics.mean(psnr) - statistics.mean(former[0]):+.2f}"
            share = f"1/{statistics.mean(former[1]) / statistics.mean(seconds):.1f}"
        yield f"{codec} | {steps:,} | {spread(psnr, 2)} | {gain} | {spread(seconds, 0)} | {share} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("codecs", nargs="*", default=list(FORMER), metavar="CODEC", choices=[*FORMER, []])
    parser.add_argument("--material", nargs="+", default=MATERIALS)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--steps", type=int, nargs="+", default=[1_000, 2_500, 10_000], help="of our fits")
    parser.add_argument("--former", type=int, default=10_000, help="steps of the former fit")
    chosen = parser.parse_args()
    print("| material | codec | steps | held-out dB | over former | CPU s | of former |\n|" + " --- |" * 7)
    for name in chosen.material:
        bench = Bench(open_material(named(name), Preparation(split="validation"), silent), 1)
        for codec in chosen.codecs or FORMER:
            for row in rows(bench, codec, chosen):
                print(f"| {name} | {row}", flush=True)


if __name__ == "__main__":
    main()
