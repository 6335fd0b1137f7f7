"""Which records may stand in one table: those of one version of a codec, at the same pairs, of the same metrics.

A codec's `version` names its file and its fit; the store of textures has a version of its own, which is part of it. A
record of another version than the installed one is *stale*: tables mark it, since its numbers cannot be made again.
"""

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from functools import cache
from typing import Any, NamedTuple

from bench.codecs.registry import codec_entries, current_versions, from_outside
from bench.records import FitKey, Job, ScoreKey, scored_unlike


def stale(jobs: Iterable[Job]) -> dict[str, str]:
    """By name of job, how its versions differ from the installed ones, in words.

    Jobs whose versions agree, or are not known, are left out.
    """
    entries = codec_entries()  # once, because that reads what every installed package says of itself
    installed: dict[tuple[str, str], dict[str, int]] = {}  # by codec and recipe
    differences_by_job = {}
    for job in jobs:
        codec, recipe = _recipe_of(job)
        if (codec, recipe) not in installed:
            installed[codec, recipe] = current_versions(codec, recipe, entries)
        differences = _version_differences(job.get("fit_key", FitKey()), installed[codec, recipe])
        if differences:
            differences_by_job[job["job"]] = differences
    return differences_by_job


class _Newest(NamedTuple):
    """What the newest of some jobs say, with which all others must agree."""

    score_keys: dict[tuple[str, Any], ScoreKey]  # by material and seed, because the scored pairs differ by seed
    shapes: dict[str, Any]  # by material: height and width of its texels
    trainings: dict[str, str]  # by material: the fingerprint of the training pairs, which seeds share; "" if unknown
    fit_keys: dict[tuple[str, str], Mapping[str, Any]]  # by codec and recipe
    codes: dict[tuple[Any, ...], str | None]  # by row: the hash of the code that fitted it

    @classmethod
    def of(cls, finished: Sequence[Job], published: Collection[str]) -> "_Newest":
        """What the newest of jobs, in order of time, say; data and pairs of those in `published` count as newest."""
        newest = cls(score_keys={}, shapes={}, trainings={}, fit_keys={}, codes={})
        others = [job for job in finished if job["job"] not in published]
        of_published = [job for job in finished if job["job"] in published]
        # A later job of the same key takes the place of an earlier one.
        for job in [*others, *of_published]:
            newest.score_keys[job["material"], job.get("seed")] = job["score_key"]
            newest.shapes[job["material"]] = job.get("shape")
            newest.trainings[job["material"]] = job.get("fit_key", {}).get("training", "")
        for job in finished:
            newest.fit_keys[_recipe_of(job)] = job.get("fit_key", {})
            newest.codes[row_of(job)] = job.get("fit_key", {}).get("code")
        return newest

    def obstacles(self, job: Job, outside: Callable[[str], bool]) -> list[str]:
        """Why the numbers of a job cannot stand beside those of the newest, in words.

        `outside` tells of a codec's name whether another package has it.
        """
        reasons = _score_differences(job["score_key"], self.score_keys[job["material"], job.get("seed")])
        # If no other job has this seed, the scores above were compared with themselves: the size still tells.
        shape = job.get("shape")
        expected = self.shapes[job["material"]]
        if not reasons and shape and expected and shape != expected:
            reasons.append(f"other data ({shape[0]} × {shape[1]} texels instead of {expected[0]} × {expected[1]})")
        fit_key = job.get("fit_key", {})
        training = fit_key.get("training", "")
        expected_training = self.trainings[job["material"]]
        if not reasons and training and expected_training and training != expected_training:
            reasons.append("fitted to other training pairs")
        other_version = _version_differences(fit_key, self.fit_keys[_recipe_of(job)])
        if other_version:
            reasons.append(other_version)
        # The suite's own codecs get a new version if their files change; one's own may change without.
        code = self.codes[row_of(job)]
        if code and fit_key.get("code") != code and outside(job["codec"]):
            reasons.append("fitted by other code of the codec than its newest seed")
        return reasons


def obstacles(jobs: Iterable[Job], published: Collection[str] = ()) -> dict[str, str]:
    """By name of job, why its numbers cannot stand beside those of newer jobs; jobs that can are left out.

    Where some jobs are `published`, they say which data and pairs a material has, whatever newer jobs have.
    """
    finished = [job for job in jobs if job["status"] == "ok"]
    # The names of runs begin with their time, so the newest is last. Jobs of a reference do not name theirs.
    finished.sort(key=lambda job: str(job.get("run", "")))
    newest = _Newest.of(finished, published)
    outside = cache(from_outside)  # which reads what every installed package says of itself
    reasons_by_job = {}
    for job in finished:
        reasons = newest.obstacles(job, outside)
        if reasons:
            reasons_by_job[job["job"]] = ", ".join(reasons)
    return reasons_by_job


def _recipe_of(job: Job) -> tuple[str, str]:
    """The codec of a job and its recipe, which may have a version of its own; "" without recipes."""
    return job["codec"], str(job.get("settings", {}).get("recipe", ""))


def row_of(job: Job) -> tuple[Any, ...]:
    """The row of a table that a job and its other seeds share: material and label."""
    return job["material"], job["label"]


def _version_differences(mine: Mapping[str, Any], theirs: Mapping[str, Any]) -> str:
    """Which versions in `mine` differ from those in `theirs`, in words; "" if none does, or if `mine` is empty."""
    if not mine:  # a record without the key of its fit
        return ""
    differences = []
    for key, name in (("version", "codec"), ("store", "store")):
        if key in theirs and mine.get(key) != theirs[key]:
            differences.append(f"{name} version {mine.get(key)} instead of {theirs[key]}")
    return ", ".join(differences)


def _score_differences(key: ScoreKey, newest: ScoreKey) -> list[str]:
    """The conditions in which two scores differ although they must agree, in words; empty if they agree."""
    reasons = scored_unlike(key, newest)
    if key.get("demand") != newest.get("demand"):
        reasons.append("another demand")
    mine = key.get("metrics", {})
    theirs = newest.get("metrics", {})
    both = sorted(mine.keys() & theirs.keys())  # if only one has a metric, they are still comparable
    for name in both:
        if mine[name] != theirs[name]:
            reasons.append(f"{name} version {mine[name]} instead of version {theirs[name]}")
    return reasons
