"""Chooses each codec's best rung within budgets of bytes and time by validation pairs, and gives its test scores.

A *line* is a codec, or a codec as published (`recipe=paper`); its rungs are all its settings that were measured.
`bench.records.choosing` chooses one for each budget and material. Test pairs are only shown.
"""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from statistics import fmean
from typing import NamedTuple

from bench.codecs.alike import obstacles
from bench.compare.paired import AGAINST, Interval, against_jobs
from bench.records import Record, Run, kind_of, stats_of
from bench.records.choosing import Limits, Rung, chosen, has_validation, over_seeds, validated, validation_of

BITS = (4, 8, 16, 32, 64, 128)  # bits of the whole file a texel
TIMES = (2, 4, 8, 16, 32)  # time of a query, × floor
SECONDS = (10, 100, 1000)  # of a processor, of a fit
BYTES, EAGER, FUSED, FIT = "bytes", "eager", "fused", "fit"
PUBLISHED = ", as published"

Times = dict[str, float]  # by job: what a query takes at most, × floor, or processor seconds of a fit
Ladders = dict[tuple[str, str], list[Rung]]  # by material and line; a rung holds its jobs, one a seed


class Budget(NamedTuple):
    """A limit: bits a texel (`bytes`), a query's time, × floor (`eager`, `fused`), or processor seconds of a `fit`."""

    kind: str
    most: float

    @property
    def limits(self) -> Limits:
        return Limits(size=self.most) if self.kind == BYTES else Limits(time=self.most)


@dataclass(frozen=True)
class Budgets:
    """The chosen rungs of a run by budget, line and material; `without` and `unlike` are excluded jobs."""

    materials: list[str]
    picks: dict[Budget, dict[str, dict[str, Rung]]]
    times: dict[str, Times] = field(default_factory=dict)  # by kind
    without: list[Record] = field(default_factory=list)  # jobs without a score of validation pairs
    unlike: list[Record] = field(default_factory=list)  # jobs not comparable with the newest of their material

    def of_kind(self, kind: str) -> "Budgets":
        """The same on the surfaces of one kind (`bench.records.kind_of`)."""
        kinds = {material: kind_of(rung.of[0]) for material, rung in self.rungs}
        mine = [material for material in self.materials if kinds.get(material) == kind]
        picks = {
            budget: {line: {m: rung for m, rung in rungs.items() if m in mine} for line, rungs in lines.items()}
            for budget, lines in self.picks.items()
        }
        return replace(self, materials=mine, picks=picks)

    @property
    def rungs(self) -> list[tuple[str, Rung]]:
        """Material and rung of every choice, each once."""
        every = (item for lines in self.picks.values() for rungs in lines.values() for item in rungs.items())
        return list({(material, rung.of[0]["job"]): (material, rung) for material, rung in every}.values())


def budgets(run: Run, fused: Mapping[str, Record]) -> Budgets:
    """The rung of each line for each budget and material; `fused` holds times as one kernel by job, if any."""
    done = [job for job in run.jobs if job["status"] == "ok"]
    judged = [job for job in done if has_validation(job)]
    unlike = obstacles(judged)
    alike = [job for job in judged if job["job"] not in unlike]
    names = {job["job"] for job in alike}
    fits = {job["job"]: float(job["fit_seconds"]) for job in alike if job.get("fit_seconds")}
    every_time = {EAGER: _upper(run.timings, names), FUSED: _upper(fused.values(), names), FIT: fits}
    times = {kind: each for kind, each in every_time.items() if each}
    limits = dict.fromkeys(times, TIMES) | {FIT: SECONDS}
    every = [Budget(BYTES, bits) for bits in BITS] + [Budget(kind, most) for kind in times for most in limits[kind]]
    ladders = {kind: _ladders(alike, times.get(kind, {})) for kind in dict.fromkeys(each.kind for each in every)}
    return Budgets(
        list(dict.fromkeys(job["material"] for job in alike)),
        {budget: _picked(ladders[budget.kind], budget) for budget in every},
        times,
        [job for job in done if not has_validation(job)],
        [job for job in judged if job["job"] not in names],
    )


def line_of(job: Record) -> str:
    """The line of a job: its codec's name; a codec as published has its own line."""
    published = job.get("settings", {}).get("recipe") == "paper"
    return str(job["label"]).split()[0] + PUBLISHED * published


def rung_of(job: Record) -> str:
    """The settings of a job in words, without those of its line."""
    words = [word for word in str(job["label"]).split()[1:] if word != "recipe=paper"]
    return " ".join(words) or "default"


def shown(rung: Rung, family: str) -> float | None:
    """The mean of a metric's family over test slices, then over seeds; None without a score."""
    return _mean([stats_of(job, family).get("mean") for job in rung.of])


def mean_over(materials: Sequence[str], rungs: Mapping[str, Rung], family: str) -> float | None:
    """The mean over materials of a line's number; None unless it has a rung on each of them."""
    return _mean([shown(rungs[name], family) if name in rungs else None for name in materials])


def _mean(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return fmean(known) if known and len(known) == len(values) else None


def apart(run: Run, lines: Mapping[str, Mapping[str, Rung]]) -> dict[str, Interval]:
    """The paired differences at a budget of lines to `AGAINST`, each with whether it is told apart from it."""
    if AGAINST not in lines:
        return {}
    jobs = {
        line: {(job["material"], job["seed"]): job for job in chain(*(rung.of for rung in rungs.values()))}
        for line, rungs in lines.items()
    }
    return against_jobs(run.folder, AGAINST, jobs).over


def _upper(times: Iterable[Record], names: set[str]) -> dict[str, float]:
    """The upper end of each interval of a time, in multiples of the floor, by job."""
    return {t["job"]: float(t["ratio_interval95"][1]) for t in times if t["job"] in names and "ratio_interval95" in t}


def _ladders(jobs: Sequence[Record], times: Times) -> Ladders:
    by_rung: dict[tuple[str, str, str], list[Rung]] = {}
    for job in jobs:
        name, (height, width) = (job["material"], line_of(job), _settings(job)), job["shape"]
        size, time = 8 * job["bytes"]["total"] / (height * width), times.get(job["job"])
        rung = validated(validation_of(job), name=rung_of(job), size=size, time=time, of=job)
        if rung:
            by_rung.setdefault(name, []).append(rung)
    ladders: Ladders = {}
    for (material, line, _), seeds in by_rung.items():
        ladders.setdefault((material, line), []).append(over_seeds(seeds))
    return ladders


def _settings(job: Record) -> str:
    return json.dumps(job["settings"], sort_keys=True)


def _picked(ladders: Ladders, budget: Budget) -> dict[str, dict[str, Rung]]:
    picks: dict[str, dict[str, Rung]] = {}
    for (material, line), rungs in ladders.items():
        rung = chosen(rungs, budget.limits)
        if rung:
            picks.setdefault(line, {})[material] = rung
    return picks
