"""Extremes that a codec must survive: the catalogue as data, and the code that tries it for `neubtf-bench stress`.

Each case has a name, a function that makes it, and one sentence that says what must hold. There are cases of materials
(`data`), queries (`queries`), numbers inside a decoder (`networks`) and rules for all queries (`invariants`), and of
pictures for metrics and losses (`metrics`). Most start from the *ordinary* material: a small smooth BTF in closed form
(`bench.conformance.check.tiny_btf`). The cheap ones are part of `neubtf-bench check`.
"""

from bench.conformance.stress import data, invariants, networks, queries
from bench.conformance.stress.case import Case, CaseVerdict, Subject, judge, subject_of

CASES: tuple[Case, ...] = (*data.CASES, *queries.CASES, *networks.CASES, *invariants.CASES)

__all__ = ["CASES", "Case", "CaseVerdict", "Subject", "judge", "subject_of"]
