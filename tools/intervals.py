"""How often the rule of the tables tells equal codecs apart, and how often it sees a difference of 1 dB.

    python tools/intervals.py [--trials 2000] [--fits 0.3] [--between 0.5]

Codecs are simulated slice by slice with the scatter that published records had (decision 82): how each codec's gain
differs between materials, how fits differ between seeds, and how slices differ beside that. A trial is a table of equal
codecs; the first, named beforehand, is compared with the others.
"""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from bench.compare.paired import Cell, interval, told_apart

Array = np.ndarray
MATERIALS, SEEDS, CODECS = (3, 9, 20), (1, 3), 20
FITS = 0.3  # dB between two seeds of a codec on one material: docs/decisions/0041
GAIN = 1.0  # dB that one codec is better, where the power is measured
DRAWN = 2  # slices that stand for all those of a record, with a mean that scatters as theirs


@dataclass(frozen=True)
class Scatter:
    """Standard deviations in dB: of each codec's gain between materials, of its fits, and of its mean over slices."""

    materials: Array = field(default_factory=lambda: np.geomspace(0.71, 6.29, 15))  # of 15 codecs on nine materials
    fits: float = FITS
    slices: float = 0.11

    def table(self, codecs: int, materials: int, seeds: int, rng: np.random.Generator) -> Array:
        """Slices (codecs, materials, seeds, DRAWN) in dB of equal codecs."""
        each = np.quantile(self.materials, (np.arange(codecs) + 0.5) / codecs)
        levels = rng.normal(size=(codecs, materials, 1, 1)) * each[:, None, None, None]
        fits = self.fits * rng.normal(size=(codecs, materials, seeds, 1))
        return levels + fits + np.sqrt(DRAWN) * self.slices * rng.normal(size=(codecs, materials, seeds, DRAWN))


def told(table: Array) -> Array:
    """Mask (codecs,) of the codecs of a table that are told apart from its first, by the rule of the tables."""
    rows = {}
    for label, codec in enumerate(table[1:], 1):
        both = zip(codec.reshape(-1, DRAWN), table[0].reshape(-1, DRAWN), strict=True)
        cells = (ours - theirs for ours, theirs in both)
        seeds = table.shape[2]
        made = [Cell(f"m{at // seeds}", at % seeds, f"{at}", each) for at, each in enumerate(cells)]
        rows[str(label)] = interval(made)
    found = told_apart({label: each for label, each in rows.items() if each})
    return np.array([str(label) in found and found[str(label)].apart for label in range(len(table))])


def chances(scatter: Scatter, codecs: int, materials: int, seeds: int, trials: int) -> tuple[float, float]:
    """The share of tables of equal codecs that tell any apart, and of codecs told from a first one 1 dB better."""
    rng = np.random.default_rng([codecs, materials, seeds])
    wrong, seen = 0, 0.0
    for _ in range(trials):
        table = scatter.table(codecs, materials, seeds, rng)
        wrong += bool(told(table).any())
        table[0] += GAIN
        seen += told(table)[1:].mean() / trials
    return wrong / trials, seen


def main(words: Sequence[str] | None = None) -> None:
    """See the module."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--trials", type=int, default=2000)
    parser.add_argument("--fits", type=float, default=FITS, help=f"dB between seeds (default: {FITS})")
    parser.add_argument(
        "--between", type=float, help="dB of gain between materials, of every codec (default: measured)"
    )
    options = parser.parse_args(words)
    scatter = Scatter(fits=options.fits)
    if options.between is not None:
        scatter = replace(scatter, materials=np.full(CODECS, options.between))
    low, middle, high = np.percentile(scatter.materials, [0, 50, 100])
    print(
        f"Standard deviations: of a codec's gain between materials {low:.2f} to {high:.2f} dB (median {middle:.2f}), "
        f"of fits {scatter.fits:.2f}, of the mean over slices {scatter.slices:.2f}; {options.trials} trials.\n"
    )
    print(f"| materials | seeds | any of {CODECS} % | power % | one of 2 % | power % |\n| ---: " + "| ---: " * 5 + "|")
    for materials in MATERIALS:
        for seeds in SEEDS:
            both = [chances(scatter, codecs, materials, seeds, options.trials) for codecs in (CODECS, 2)]
            figures = " | ".join(f"{100 * share:.1f}" for pair in both for share in pair)
            print(f"| {materials} | {seeds} | {figures} |", flush=True)


if __name__ == "__main__":
    main()
