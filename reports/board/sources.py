"""What a board is made of: files of records, archives and runs at hand, and which pictures may be published.

A *source* is a `Publication`: the records of one file (`*.jsonl`), archive (`*.zip`) or run. A file of records has no
other files beside it. A run *at hand* is a folder of this machine, which also stores a job's *artefacts*: pictures,
arrays and the codec file, whose paths stand in fields of the job. An archive is a run that somebody handed in with its
codec files: its results are *claimed* until they are scored anew here, then *verified*. The provenance of a job says
whether its pictures are free.
"""

import hashlib
import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain, count
from pathlib import Path
from typing import cast

from bench.btf import BAKED, RENDERED
from bench.compare.choosing import has_validation
from bench.compare.publishing import published_job
from bench.records import ARTEFACT, Job, Records, Run, field_names
from reports.rows import MaterialRows, materials

# By the key of a measured file, see `_key`: the run and the job whose files are at hand.
_AtHand = dict[tuple[str, ...], tuple[Run, Job]]
VERIFIED, CLAIMED, OWN = "verified", "claimed", "own run"
STATES = (
    f"“{OWN}”: measured by those who keep these records. “{VERIFIED}”: handed in with its files, which were decoded "
    f"and scored anew here. “{CLAIMED}”: handed in, and scored by nobody else."
)


@dataclass(frozen=True)
class Codec:
    """What is known of an installed codec; "" where it does not say."""

    about: str  # a line about it
    origin: str  # the package and version that it is from
    bibtex: str = ""  # what to cite
    paper: str = ""  # address
    code: str = ""  # address
    # Name, meaning, and default in our recipe and as published; the last is "" where the codec has but one recipe.
    settings: Sequence[tuple[str, str, str, str]] = ()


@dataclass(frozen=True, eq=False)
class Publication:
    """Records of one file, archive or run: a source of a board."""

    name: str
    run: Run
    claimed: bool = False  # scored only by those who handed it in

    @cached_property
    def materials(self) -> list[MaterialRows]:
        """Its rows by material."""
        return materials(self.run)

    @cached_property
    def has_budgets(self) -> bool:
        """Whether validation pairs can choose among its settings, and it is not claimed."""
        return not self.claimed and any(map(has_validation, self.run.jobs))

    @property
    def title(self) -> str:
        """Its name; and, if it is claimed, that it is."""
        return f"{self.name}, {CLAIMED}" if self.claimed else self.name

    def state(self, job: Job) -> str:
        """Whose word a job's numbers are, see `STATES`; the status of a job without numbers."""
        if job["status"] != "ok":
            return str(job["status"])
        if self.claimed:
            return CLAIMED
        return VERIFIED if job.get("verified") else OWN


def may_be_shown(job: Job, run: Run) -> bool:
    """Whether pictures of a job's material may be published: it is rendered by this suite, it is baked from maps whose
    suite states CC0, or its provenance says that it is free.

    `run` is that of the job: its starts record what suites state.
    """
    provenance = job.get("provenance", {})
    source = provenance.get("source")
    if source == RENDERED:
        return True
    if job.get("verified"):  # it comes from an archive, which may claim any licence
        return False
    return bool(provenance.get("free")) or (source == BAKED and _is_stated_cc0(job["material"], run))


def _is_stated_cc0(name: str, run: Run) -> bool:
    """Whether a suite of a run states CC0 where it says what a material is from."""
    for start in run.starts:
        for material in start.get("materials") or ():  # a record may hold null, or materials that are no dicts
            if isinstance(material, dict) and material.get("name") == name and "CC0" in str(material.get("where")):
                return True
    return False


def with_files(records: Sequence[Publication], runs: Sequence[Publication]) -> list[Publication]:
    """The sources, each job with the paths of those files of runs at hand that may be shown, and with no other path.

    A run at hand follows as a source of its own, unless all its jobs are in records that are not claimed. A name that
    several sources have is followed by a number.
    """
    at_hand = {_key(job): (source.run, job) for source in runs for job in source.run.jobs if job["status"] == "ok"}
    # Of records that are not claimed: only these may stand for a run at hand.
    keys_in_records = {_key(job) for source in records if not source.claimed for job in source.run.jobs}
    runs_beside_records = []
    for source in runs:
        if any(_key(job) not in keys_in_records for job in source.run.jobs):
            # Only what may be published of a job: nothing of this machine.
            jobs = Records({job["job"]: published_job(job, source.run.folder) for job in source.run.jobs})
            runs_beside_records.append(replace(source, run=replace(source.run, jobs=jobs)))
    sources: dict[str, Publication] = {}  # by name
    for source in (*records, *runs_beside_records):
        name = _free_name(source.name, sources)
        sources[name] = replace(source, name=name, run=_with_paths(source.run, at_hand))
    return list(sources.values())


def _free_name(name: str, taken: Collection[str]) -> str:
    """The name, if it is not taken; else followed by the first number with which it is not."""
    numbered = (f"{name} ({number})" for number in count(2))
    return next(each for each in chain([name], numbered) if each not in taken)


def _with_paths(run: Run, at_hand: _AtHand) -> Run:
    """The run, each job with the absolute paths of files at hand that may be shown, and no other paths.

    Codec files are never shown.
    """
    jobs: Records[Job] = Records()
    for job in run.jobs:
        paths = _paths(job)
        fields: dict[str, object] = {name: value for name, value in job.items() if name not in paths}
        local_run, local_job = at_hand.get(_key(job), (run, None))  # no job where its files are not at hand
        if local_job and may_be_shown(local_job, local_run):
            shown = {name: path for name, path in _paths(local_job).items() if name != "file"}
            fields |= {name: str(local_run.folder.absolute() / path) for name, path in shown.items()}
        jobs.put(job["job"], cast(Job, fields))
    return replace(run, jobs=jobs)


def _paths(job: Job) -> dict[str, str]:
    """The paths of a job's artefacts, by field; the same fields may hold packed arrays, which are no paths."""
    names = field_names(ARTEFACT)
    return {name: value for name, value in job.items() if name in names and isinstance(value, str)}


def _key(job: Job) -> tuple[str, ...]:
    """The key of a measured codec file: the name of its job, its hash, and the hash of its data.

    A job at hand with the key of a record is of the same file, so its pictures are the record's.
    """
    score_key = job.get("score_key", {})
    return job["job"], str(score_key.get("sha256")), str(score_key.get("btf"))


def joined(parts: Sequence[tuple[str, Publication, str]]) -> Run:
    """One run of materials from several sources.

    A part is a material: its name in the joined run, its source, and its name in the source. Jobs and their timings get
    new names too, so that those of two sources stay apart.
    """
    run = Run(Path())  # its files lie in no one folder
    for name, source, name_in_source in parts:
        for job in source.run.jobs:
            if job["material"] == name_in_source:
                new_job_name = f"{name}/{job['job']}"
                run.jobs.put(new_job_name, job | {"job": new_job_name, "material": name})
                timing = source.run.timing(job)
                if timing:
                    run.timings.put(new_job_name, timing | {"job": new_job_name})
    return run


def page_name(kind: str, name: str) -> str:
    """The file of a page, of a `kind` such as "material": plain letters, whatever the name, and a different file for
    each name: "material-satin.html". The front takes such names as ids, too.

    A name that is not plain is told from others by a hash: "material-my-satin-1a2b3c4d.html".
    """
    plain = re.sub(r"[^a-z0-9]+", "-", name.lower())[:60].strip("-")  # a name that is cut is not plain
    if plain == name:
        return f"{kind}-{plain}.html"
    digest = hashlib.sha256(name.encode(errors="replace")).hexdigest()[:8]  # `replace`: UTF-8 has no halves of letters
    return f"{kind}-{plain}-{digest}.html"


def by_material(sources: Sequence[Publication]) -> dict[str, list[Publication]]:
    """By name of each material that has a row: the sources that have it, in their order."""
    sources_of_material: dict[str, list[Publication]] = {}
    for source in sources:
        for material in source.materials:
            sources_of_material.setdefault(material.name, []).append(source)
    return sources_of_material
