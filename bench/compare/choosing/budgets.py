"""Chooses each codec's best rung within budgets of bytes and time by validation pairs, and gives its test scores.

A *line* is a codec, or a codec as published (`recipe=paper`); its rungs are all its settings that were measured. One is
chosen for each budget and material. Test pairs are only shown.
"""

import json
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from statistics import fmean
from typing import NamedTuple

from bench.codecs.alike import obstacles
from bench.compare.choosing import NEAR_DB, Limits, Rung, chosen, fused_times, has_validation, validation_of
from bench.compare.paired import AGAINST, against_jobs
from bench.compare.quantities import average
from bench.compare.ranks import Ranks, ranks
from bench.records import FLIP, PSNR, Record, Run, grouped, stats_of

BITS = (4, 8, 16, 32, 64, 128)  # bits of the whole file a texel
TIMES = (2, 4, 8, 16, 32)  # time of a query, × floor
SECONDS = (10, 100, 1000)  # of a processor, of a fit
BYTES, EAGER, FUSED, FIT = "bytes", "eager", "fused", "fit"

Times = dict[str, float]  # by job: what a query takes at most, × floor, or processor seconds of a fit


class Budget(NamedTuple):
    """A limit: bits a texel (`bytes`), a query's time, × floor (`eager`, `fused`), or processor seconds of a `fit`."""

    kind: str
    most: float

    @property
    def limits(self) -> Limits:
        return Limits(size=self.most) if self.kind == BYTES else Limits(time=self.most)


ENOUGH = Budget(BYTES, 32)  # the budget of ranks, and for questions about a single material or metric


@dataclass(frozen=True)
class Budgets:
    """The rungs of a run that were chosen by budget, line and material; `without` and `unlike` are excluded jobs."""

    surfaces: dict[str, Record]  # a job of each material that has a rung at some budget
    picks: dict[Budget, dict[str, dict[str, Rung]]]
    times: dict[str, Times]  # by kind
    without: list[Record]  # jobs without a score of validation pairs
    unlike: list[Record]  # jobs not comparable with the newest of their material

    def ranked(self, budget: Budget, materials: Collection[str], family: str = PSNR) -> dict[str, float]:
        """The lines with a rung on each of some materials, with their mean of a metric over these, the best first."""
        means = {
            line: average([shown(rungs[name], family) for name in materials])
            for line, rungs in self.picks.get(budget, {}).items()
            if rungs.keys() >= set(materials)
        }
        known = [(line, value) for line, value in means.items() if value is not None]
        return dict(sorted(known, key=lambda each: each[1] if family == FLIP else -each[1]))

    def fewest_bytes(self) -> tuple[Budget, dict[str, float]] | None:
        """The smallest budget of bytes within `NEAR_DB` of the best of all, and its lines that are as near."""
        ranked = {budget: self.ranked(budget, self.surfaces) for budget in self.picks if budget.kind == BYTES}
        best = max((value for lines in ranked.values() for value in lines.values()), default=0.0)
        for budget, lines in ranked.items():
            if near := {line: value for line, value in lines.items() if value >= best - NEAR_DB}:
                return budget, near
        return None

    def told_apart(self, run: Run, budget: Budget, materials: Collection[str]) -> set[str]:
        """The lines with a rung on each material whose paired differences tell them apart from `AGAINST`."""
        picked = {line: self.picks[budget][line] for line in self.ranked(budget, materials)}
        jobs = {
            line: {(job["material"], job["seed"]): job for name in materials for job in rungs[name].of}
            for line, rungs in picked.items()
        }
        over = against_jobs(run.folder, AGAINST, jobs).over if AGAINST in jobs else {}
        return {line for line, each in over.items() if each.apart}

    def ranks(self) -> Ranks | None:
        """The mean ranks at `ENOUGH` of the lines with a rung on every material."""
        lines = [(line, rungs) for line, rungs in self.picks[ENOUGH].items() if rungs.keys() >= self.surfaces.keys()]
        return ranks({line: [shown(rungs[name], PSNR) or 0.0 for name in self.surfaces] for line, rungs in lines})


@lru_cache(maxsize=1)
def budgets(run: Run, bits: Sequence[float] = BITS) -> Budgets:
    """The rung of each line for each budget, of so many bits a texel and of time, and material."""
    done = [job for job in run.jobs if job["status"] == "ok"]
    judged = [job for job in done if has_validation(job)]
    obstacle = obstacles(judged)
    alike = [job for job in judged if job["job"] not in obstacle]
    times = _times(run, alike)
    limits = {BYTES: bits} | dict.fromkeys(times, TIMES) | ({FIT: SECONDS} if FIT in times else {})
    rungs = grouped(alike, lambda job: (job["material"], line_of(job), json.dumps(job["settings"], sort_keys=True)))
    ladders = grouped(rungs, lambda rung: rung[:2])
    picks: dict[Budget, dict[str, dict[str, Rung]]] = {}
    for budget in (Budget(kind, most) for kind in limits for most in limits[kind]):
        lines = picks.setdefault(budget, {})
        for (material, line), ladder in ladders.items():
            if rung := chosen([rung_of(rungs[key], times.get(budget.kind, {})) for key in ladder], budget.limits):
                lines.setdefault(line, {})[material] = rung
    there = {material for lines in picks.values() for by_material in lines.values() for material in by_material}
    surfaces = {job["material"]: job for job in alike if job["material"] in there}
    without = [job for job in done if not has_validation(job)]
    unlike = [job for job in judged if job["job"] in obstacle]
    return Budgets(surfaces, picks, times, without, unlike)


def _times(run: Run, jobs: Sequence[Record]) -> dict[str, Times]:
    """The times of some jobs by kind, without kinds that none has; of a query the upper end of its interval."""
    names = {job["job"] for job in jobs}

    def upper(records: Iterable[Record]) -> Times:
        known = (each for each in records if each["job"] in names and "ratio_interval95" in each)
        return {each["job"]: float(each["ratio_interval95"][1]) for each in known}

    fits = {job["job"]: float(job["fit_seconds"]) for job in jobs if job.get("fit_seconds")}
    times = {EAGER: upper(run.timings), FUSED: upper(fused_times(run).values()), FIT: fits}
    return {kind: each for kind, each in times.items() if each}


def rung_of(seeds: Sequence[Record], times: Times) -> Rung:
    """The rung of several seeds: mean scores, bits a texel of the largest file, and the mean time."""
    height, width = seeds[0]["shape"]
    known = [times[job["job"]] for job in seeds if job["job"] in times]
    score = fmean(validation_of(job)["mean"] for job in seeds)
    return Rung(8 * most_bytes(seeds) / (height * width), score, fmean(known) if known else None, seeds)


def most_bytes(seeds: Sequence[Record]) -> int:
    """The bytes of the largest file."""
    return max(job["bytes"]["total"] for job in seeds)


def line_of(job: Record) -> str:
    """The line of a job: its codec's name; a codec as published has its own line."""
    published = job.get("settings", {}).get("recipe") == "paper"
    return str(job["label"]).split()[0] + (", as published" if published else "")


def setting_of(job: Record) -> str:
    """The settings of a job in words, without those of its line."""
    return " ".join(word for word in str(job["label"]).split()[1:] if word != "recipe=paper") or "default"


def shown(rung: Rung, family: str) -> float | None:
    """The mean of a metric's family over test slices, then over seeds; None without a score."""
    return average([stats_of(job, family).get("mean") for job in rung.of])
