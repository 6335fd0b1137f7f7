"""Extremes that a codec must survive: the catalogue as data, and what tries it. `neubtf-bench stress` prints it.

Each case has a name, how it is made, and what must hold, in one sentence: materials (`data`), queries (`queries`),
numbers inside a decoder (`networks`), what must hold anywhere (`invariants`); for metrics and losses, pictures
(`metrics`). The cheap ones are part of `neubtf-bench check`.
"""

from bench.conformance.stress import data, invariants, networks, queries
from bench.conformance.stress.case import Case, CaseVerdict, Subject, judge, subject_of

CASES: tuple[Case, ...] = (*data.CASES, *queries.CASES, *networks.CASES, *invariants.CASES)

__all__ = ["CASES", "Case", "CaseVerdict", "Subject", "judge", "subject_of"]
