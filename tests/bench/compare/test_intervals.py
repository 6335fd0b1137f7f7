"""The rule of the tables, simulated: how often it tells equal codecs apart, and how often it sees a difference of 1 dB.

Codecs are simulated slice by slice with the scatter that published records had (decision 82): how each codec's gain
differs between materials, how fits differ between seeds, and how slices differ beside that. A trial is a table of equal
codecs; the first, named beforehand, is compared with the others.
"""

from dataclasses import dataclass, field

import numpy as np
import pytest

from bench.compare.paired import over_materials, told_apart

Array = np.ndarray
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
        differences = (codec - table[0]).mean((1, 2))  # (materials,)
        rows[str(label)] = over_materials(differences, seeds=table.shape[2])
    found = told_apart(rows)
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


@pytest.mark.parametrize(("codecs", "materials", "seeds"), [(20, 2, 1), (20, 3, 3), (20, 9, 1), (2, 3, 3), (2, 9, 1)])
def test_equal_codecs_are_told_apart_in_eight_of_a_hundred_tables_at_most(codecs, materials, seeds):
    wrong, _ = chances(Scatter(), codecs, materials, seeds, 2000 // codecs)
    assert wrong <= 0.08


def test_a_decibel_is_seen_where_all_materials_agree_on_it():
    _, seen = chances(Scatter(materials=[0.1], fits=0.1, slices=0.1), 2, 9, 1, 50)
    assert seen > 0.8
