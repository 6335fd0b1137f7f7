"""Which records may stand in one table: those of one version of a codec, at the same pairs, of the same metrics.

A codec's `version` names its file and its fit; the store of textures has a version of its own, which is part of it. A
record of another version than the installed one is *stale*: tables mark it, since its numbers cannot be made again.
"""

from collections.abc import Collection, Iterable, Mapping
from typing import Any

from bench.codecs.registry import current_versions, from_outside
from bench.records import FitKey, Job, ScoreKey, scored_unlike, shown_label


def stale(job: Job) -> str:
    """How a job's versions differ from the installed ones, in words; "" if they agree or are not known."""
    return _version_differences(job.get("fit_key", FitKey()), current_versions(*_recipe_of(job)))


def obstacles(jobs: Iterable[Job], published: Collection[str] = ()) -> dict[str, str]:
    """By name of job, why its numbers cannot stand beside those of newer jobs; jobs that can are left out.

    Where some jobs are `published`, they say which data and pairs a material has, whatever newer jobs have.
    """
    # The runs' names begin with their time, so the newest job comes last.
    finished = sorted((job for job in jobs if job["status"] == "ok"), key=lambda job: str(job["run"]))
    # Published jobs after all others; among themselves both stay in order of time.
    ordered = sorted(finished, key=lambda job: job["job"] in published)
    # Of jobs with the same key, the last one stays in these dictionaries, and says what the others must agree with.
    # Scores are kept by seed too, because the scored pairs differ by seed.
    newest_score_key = {(job["material"], job.get("seed")): job["score_key"] for job in ordered}
    newest_shape = {job["material"]: job.get("shape") for job in ordered}
    newest_fit_key = {_recipe_of(job): job.get("fit_key", {}) for job in finished}
    newest_code = {row_of(job): job.get("fit_key", {}).get("code") for job in finished}
    reasons_by_job = {}
    for job in finished:
        key = job.get("fit_key", {})
        code = newest_code[row_of(job)]
        reasons = _score_differences(job["score_key"], newest_score_key[job["material"], job.get("seed")])
        shape = job.get("shape")
        expected_shape = newest_shape[job["material"]]
        # If no other job has this seed, the scores above were compared with themselves: the size still tells.
        if not reasons and shape and expected_shape and shape != expected_shape:
            reasons.append(
                f"other data ({shape[0]} × {shape[1]} texels instead of {expected_shape[0]} × {expected_shape[1]})"
            )
        other_version = _version_differences(key, newest_fit_key[_recipe_of(job)])
        if other_version:
            reasons.append(other_version)
        # The suite's own codecs get a new version if their files change; one's own may change without.
        if code and key.get("code") != code and from_outside(str(job.get("codec"))):
            reasons.append("fitted by other code of the codec than its newest seed")
        if reasons:
            reasons_by_job[job["job"]] = ", ".join(reasons)
    return reasons_by_job


def _recipe_of(job: Job) -> tuple[str, str]:
    """The codec of a job and its recipe, which may have a version of its own; "" without recipes."""
    return str(job.get("codec", "")), str(job.get("settings", {}).get("recipe", ""))


def row_of(job: Job) -> tuple[Any, ...]:
    """The row that a job and its other seeds share."""
    return job["material"], shown_label(job)


def _version_differences(mine: Mapping[str, Any], theirs: Mapping[str, Any]) -> str:
    """Which versions in `mine` differ from those in `theirs`, in words; "" if none does, or if `mine` is empty."""
    differ = [key for key in ("version", "store") if mine and key in theirs and mine.get(key) != theirs[key]]
    names = {"version": "codec", "store": "store"}
    return ", ".join(f"{names[key]} version {mine.get(key)} instead of {theirs[key]}" for key in differ)


def _score_differences(key: ScoreKey, newest: ScoreKey) -> list[str]:
    """The conditions in which two scores differ although they must agree."""
    reasons = scored_unlike(key, newest)
    if key.get("demand") != newest.get("demand"):
        reasons.append("another demand")
    mine = key.get("metrics", {})
    theirs = newest.get("metrics", {})
    both = sorted(mine.keys() & theirs.keys())  # if only one has a metric, they are still comparable
    differ = [name for name in both if mine[name] != theirs[name]]
    return reasons + [f"{name} version {mine[name]} instead of version {theirs[name]}" for name in differ]
