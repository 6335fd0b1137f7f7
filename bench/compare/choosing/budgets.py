"""Chooses each codec's best rung within budgets of bytes and time by validation pairs, and gives its test scores.

A *line* is a codec, or a codec as published (`recipe=paper`); its rungs over some materials are its settings that were
measured on each of them. A surface is a material. One rung is chosen for each budget and material. Test pairs are only
shown.
"""

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import compress
from statistics import fmean
from typing import NamedTuple, cast

import numpy as np

from bench.codecs.alike import obstacles
from bench.compare.choosing import Limits, Rung, best_rung, fused_times, has_validation, validation_of
from bench.compare.paired import AGAINST
from bench.compare.statistics import average, chance_if_equal, told_by_holm
from bench.metrics import direction_of, stats_of
from bench.records import PSNR, Job, Run, Timing, TradeChoice, fitted_to_scene, view

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
        """This budget as limits of a rung, whose time is that of a query or of a fit: see `rung_of`."""
        if self.kind == BYTES:
            return Limits(size=self.most)
        return Limits(time=self.most)


ENOUGH = Budget(BYTES, 32)  # the budget of ranks, and for questions about a single material or metric


@dataclass(frozen=True)
class Budgets:
    """The rungs of a run, with the limits to choose them by; `without` and `unlike` are excluded jobs."""

    surfaces: dict[str, Job]  # a job of each material that has a rung at some budget
    limits: list[Budget]
    rungs: dict[str, dict[str, dict[str, list[Job]]]]  # by line, label and material: jobs, one a seed
    times: dict[str, Times]  # by kind
    without: list[Job]  # jobs without a score of validation pairs
    unlike: list[Job]  # jobs not comparable with the published ones of their material, or else with the newest

    def picks(self, budget: Budget, materials: Iterable[str]) -> dict[str, dict[str, Rung]]:
        """By line and material: the best rung that fits the budget, of the settings measured on all of the materials.

        Lines without such a rung on each material are left out.
        """
        materials = list(materials)
        times = self.times.get(budget.kind, {})  # none for a budget of bytes
        picked: dict[str, dict[str, Rung]] = {}
        for line, by_label in self.rungs.items():
            common = [jobs for jobs in by_label.values() if jobs.keys() >= set(materials)]
            best: dict[str, Rung] = {}
            for name in materials:
                rung = best_rung([rung_of(jobs[name], times) for jobs in common], budget.limits)
                if rung is not None:  # None: no rung fits the budget on this material
                    best[name] = rung
            if best.keys() == set(materials):
                picked[line] = best
        return picked

    def ranked(self, budget: Budget, materials: Collection[str], family: str = PSNR) -> dict[str, float]:
        """The lines with a rung on each of some materials, with their mean of a metric over these, the best first."""
        means: dict[str, float] = {}  # by line
        for line, rungs in self.picks(budget, materials).items():
            mean = average([mean_test_score(rung, family) for rung in rungs.values()])
            if mean is not None:  # None: the metric was not measured on each of the materials
                means[line] = mean
        return best_first(means, family)

    def told_apart(self, budget: Budget, materials: Collection[str]) -> set[str]:
        """The lines with a rung on each material whose differences over these tell them apart from `AGAINST`.

        It tests the numbers whose mean the table shows, material by material.
        """
        scores: dict[str, np.ndarray] = {}  # by line: (materials,) in dB
        for line, rungs in self.picks(budget, materials).items():
            scores_of_line = [mean_test_score(rung, PSNR) for rung in rungs.values()]
            measured = [score for score in scores_of_line if score is not None]
            if len(measured) == len(scores_of_line):
                scores[line] = np.array(measured)
        if AGAINST not in scores:  # nothing to compare with
            return set()
        anchor = scores.pop(AGAINST)
        told = told_by_holm([chance_if_equal(values - anchor) for values in scores.values()])
        return set(compress(scores, told))


@view
def budgets(run: Run) -> Budgets:
    """The rungs of a run, and budgets of bytes and of time."""
    done = [job for job in run.jobs if job["status"] == "ok" and not fitted_to_scene(job)]
    with_validation = [job for job in done if has_validation(job)]
    obstacle = obstacles(with_validation, run.published)  # by name of a job, why it is not comparable
    alike = [job for job in with_validation if job["job"] not in obstacle]
    times = times_of(run, alike)
    limits = [Budget(BYTES, most) for most in BITS]
    for kind in times:
        steps = SECONDS if kind == FIT else TIMES
        limits += [Budget(kind, most) for most in steps]
    rungs: dict[str, dict[str, dict[str, list[Job]]]] = {}
    for job in alike:
        # By label, which names what differs from the defaults: a setting that is added later splits no rung.
        of_line = rungs.setdefault(line_of(job), {}).setdefault(job["label"], {})
        of_line.setdefault(job["material"], []).append(job)
    without = [job for job in done if not has_validation(job)]
    unlike = [job for job in with_validation if job["job"] in obstacle]
    # Surfaces are the materials on which some rung fits some budget, which takes `picks` of all to know.
    every_material = Budgets({}, limits, rungs, times, without, unlike)
    surfaces = {}
    job_of_material = {job["material"]: job for job in alike}
    for name, job in job_of_material.items():
        if any(every_material.picks(budget, [name]) for budget in limits):
            surfaces[name] = job
    return replace(every_material, surfaces=surfaces)


def times_of(run: Run, jobs: Sequence[Job]) -> dict[str, Times]:
    """The times of some jobs by kind, without kinds that none has; of a query the upper end of its interval.

    Where settings were timed apart from surfaces, on one machine, no other times of queries count.
    """
    names = {job["job"] for job in jobs}

    def upper(records: Iterable[Timing | TradeChoice]) -> Times:
        """The upper end of the 95 % interval of each job's time, × floor."""
        timed = [record for record in records if record["job"] in names and "ratio_interval95" in record]
        return {record["job"]: float(record["ratio_interval95"][1]) for record in timed}

    of_settings: Times = {}
    for job in jobs:
        timing = run.setting_timing(job)
        if timing and "ratio_interval95" in timing:
            of_settings[job["job"]] = float(timing["ratio_interval95"][1])

    seconds_of_fits = {job["job"]: float(job["fit_seconds"]) for job in jobs if job.get("fit_seconds")}
    if of_settings:
        eager = of_settings
    else:
        eager = upper(run.timings)
    times = {EAGER: eager, FUSED: upper(fused_times(run).values()), FIT: seconds_of_fits}
    return {kind: times_of_kind for kind, times_of_kind in times.items() if times_of_kind}


def rung_of(seeds: Sequence[Job], times: Times) -> Rung:
    """The rung of several seeds: the means of score, bits a texel and time."""
    height, width = seeds[0]["shape"]
    measured = [times[job["job"]] for job in seeds if job["job"] in times]
    time = None
    if measured:
        time = fmean(measured)
    score = fmean(cast(float, validation_of(job)["mean"]) for job in seeds)
    bits_a_texel = 8 * mean_bytes(seeds) / (height * width)
    return Rung(bits_a_texel, score, time, seeds)


def mean_bytes(seeds: Sequence[Job]) -> int:
    """The mean bytes of files; the largest would grow with the number of seeds."""
    return round(fmean(job["bytes"]["total"] for job in seeds))


def line_of(job: Job) -> str:
    """The line of a job: its codec's name; a codec as published has its own line."""
    codec, *_ = str(job["label"]).split()
    if job.get("settings", {}).get("recipe") == "paper":
        return f"{codec}, as published"
    return codec


def setting_of(job: Job) -> str:
    """The settings of a job in words, without those of its line."""
    _, *words = str(job["label"]).split()  # after the codec's name
    settings = [word for word in words if word != "recipe=paper"]
    if not settings:
        return "default"
    return " ".join(settings)


def mean_test_score(rung: Rung, family: str) -> float | None:
    """The mean of a metric's family over test slices, then over seeds; None if a job was not scored by it."""
    return average([stats_of(job, family).get("mean") for job in rung.of])


def best_first(values: dict[str, float], family: str) -> dict[str, float]:
    """Values of a metric's family, the best first."""
    sign = 1 if direction_of(family) == "lower" else -1  # ascending where lower is better, else descending
    return dict(sorted(values.items(), key=lambda item: sign * item[1]))
