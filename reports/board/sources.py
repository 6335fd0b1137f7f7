"""What a board is made of: files of records, archives and runs at hand, and which pictures may be published."""

import hashlib
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import cast

from bench.btf import BAKED, RENDERED
from bench.compare.choosing import has_validation
from bench.compare.reference import published_job
from bench.records import ARTEFACT, Job, Records, Run, field_names
from reports.rows import MaterialRows, materials

VERIFIED, CLAIMED, OWN = "verified", "claimed", "own run"
STATES = (
    f"“{OWN}”: measured by those who keep these records. “{VERIFIED}”: handed in with its files, which were decoded "
    f"and scored anew here. “{CLAIMED}”: handed in, and scored by nobody else."
)


@dataclass(frozen=True)
class Codec:
    """What is known of an installed codec: a line about it, where its code is, what to cite, and its settings.

    A setting is its name, its meaning, and its default in our recipe and as published, "" where the codec has but one.
    """

    about: str
    origin: str
    bibtex: str = ""
    paper: str = ""
    code: str = ""
    settings: Sequence[tuple[str, str, str, str]] = ()


@dataclass(frozen=True, eq=False)
class Publication:
    """Records of one file, archive or run. Nobody but who handed it in has scored what is `claimed`."""

    name: str
    run: Run
    claimed: bool = False

    @cached_property
    def materials(self) -> list[MaterialRows]:
        """Its rows by material."""
        return materials(self.run)

    @cached_property
    def has_budgets(self) -> bool:
        """Whether validation pairs chose among its settings, and its word counts."""
        return not self.claimed and any(map(has_validation, self.run.jobs))

    @property
    def title(self) -> str:
        """Its name, and that it is claimed."""
        return f"{self.name}, {CLAIMED}" if self.claimed else self.name

    def state(self, job: Job) -> str:
        """Whose word a number is; of a job without one, its status."""
        if job["status"] != "ok":
            return str(job["status"])
        if self.claimed:
            return CLAIMED
        return VERIFIED if job.get("verified") else OWN


def may_be_shown(job: Job, run: Run) -> bool:
    """Whether pictures of a job's material may be published: it is rendered by this suite, it is baked from maps whose
    suite states CC0, or its provenance says that it is free.

    A verified job comes from an archive, which may claim any licence: of those, only rendered materials are shown.
    """
    stated: list[str] = []  # by the suites, where the material is from
    for start in run.starts:
        materials = start.get("materials") or ()  # a record may hold null
        for material in materials:
            if isinstance(material, dict) and material.get("name") == job["material"]:
                stated.append(str(material.get("where")))
    where = " ".join(stated)
    provenance = job.get("provenance", {})
    source = provenance.get("source")
    stated_free = bool(provenance.get("free")) or (source == BAKED and "CC0" in where)
    return source == RENDERED or (stated_free and not job.get("verified"))


def with_files(records: Sequence[Publication], runs: Sequence[Publication]) -> list[Publication]:
    """The sources, each job with the paths of those files of runs at hand that may be shown, and with no other path.

    A run at hand follows as a source of its own, unless all its jobs are in records that are not claimed. A name that
    several sources have is followed by a number.
    """
    at_hand: dict[tuple[str, ...], tuple[Run, Job]] = {}
    for source in runs:
        for job in source.run.jobs:
            if job["status"] == "ok":
                at_hand[_key(job)] = source.run, job
    known: set[tuple[str, ...]] = set()
    for source in records:
        if not source.claimed:
            known.update(_key(job) for job in source.run.jobs)
    more = []
    for source in runs:
        if any(_key(job) not in known for job in source.run.jobs):
            jobs = Records({job["job"]: published_job(job, source.run.folder) for job in source.run.jobs})
            more.append(replace(source, run=replace(source.run, jobs=jobs)))
    taken = Counter[str]()
    named = []
    for source in (*records, *more):
        taken[source.name] += 1
        count = taken[source.name]
        name = source.name if count == 1 else f"{source.name} ({count})"
        named.append(replace(source, name=name, run=_placed(source.run, at_hand)))
    return named


def _placed(run: Run, at_hand: dict[tuple[str, ...], tuple[Run, Job]]) -> Run:
    """The run, each job with the absolute paths of files at hand that may be shown, and no other paths.

    `at_hand` has, by `_key`, the run and the job whose files are at hand. Codec files are never shown.
    """
    names = set(field_names(ARTEFACT))
    jobs: Records[Job] = Records()
    for job in run.jobs:
        placed = {name: value for name, value in job.items() if name not in names or not isinstance(value, str)}
        owner, local = at_hand.get(_key(job), (None, job))
        if owner and may_be_shown(local, owner):
            for name, path in local.items():
                if name in names - {"file"} and isinstance(path, str):
                    placed[name] = str(owner.folder.absolute() / path)
        jobs.put(job["job"], cast(Job, placed))
    return replace(run, jobs=jobs)


def _key(job: Job) -> tuple[str, ...]:
    """What names a measured file: its job, its hash, and that of its data."""
    key = job.get("score_key", {})
    return job["job"], str(key.get("sha256")), str(key.get("btf"))


def joined(parts: Sequence[tuple[str, Publication, str]]) -> Run:
    """One run of some materials. A part is the name that a material gets in it, its source, and its name there."""
    run = Run(Path())
    for name, source, material in parts:
        for job in source.run.jobs:
            if job["material"] == material:
                called = f"{name}/{job['job']}"
                run.jobs.put(called, job | {"job": called, "material": name})
                timing = source.run.timing(job)
                if timing:
                    run.timings.put(called, timing | {"job": called})
    return run


def page_name(kind: str, name: str) -> str:
    """The file of a page: plain letters, whatever the name, and another one for each name."""
    plain = re.sub(r"[^a-z0-9]+", "-", name.lower())[:60].strip("-")
    digest = hashlib.sha256(name.encode(errors="replace")).hexdigest()[:8]
    return f"{kind}-{plain}.html" if plain == name else f"{kind}-{plain}-{digest}.html"


def by_material(sources: Sequence[Publication]) -> Iterator[tuple[str, list[Publication]]]:
    """Every material that has a row, with its sources."""
    by_name: dict[str, list[Publication]] = {}
    for source in sources:
        for material in source.materials:
            by_name.setdefault(material.name, []).append(source)
    yield from by_name.items()
