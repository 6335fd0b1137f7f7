"""Packs the records and codec files of a run into one archive, and scores an archive's files anew on this machine.

The archive is a zip: `records.jsonl` as `bench.compare.results` keeps it, and the codec files in `files/`, with the
networks that they share. Nothing in it is run: a codec that is not installed here is named, and not verified.
"""

import dataclasses
import math
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bench import atomic, records
from bench.archive import ZipFiles
from bench.codec import Progress, silent
from bench.codecs import loading, shared
from bench.codecs.registry import COMMAND, codec_entries
from bench.data.spec import MaterialSpec, Preparation
from bench.errors import ContainerError, InputError, MissingDataError
from bench.records import CLAIM, FILE, Record, Run, gate, kept, metrics_of
from bench.runs.evaluation import evaluate, score_key
from bench.runs.job import machine, made
from bench.runs.place import Place
from bench.runs.suite import CodecSpec
from bench.runs.task import Task
from bench.runs.workbench import Workbench, workbench
from bench.settings import table

MOST_BYTES = 4 << 30  # of an archive's unpacked files
DECIBELS, RELATIVE = 0.01, 1e-3  # what rounding on another processor may change

AGREES, DIFFERS, NOT_VERIFIED = "agrees", "differs", "not verified"


def chosen(run: Run, codecs: list[str]) -> Run:
    """The jobs of a run that have a result, or those of some codecs, with their timings. `InputError` if none has."""
    part = dataclasses.replace(run, jobs=records.Records(), timings=records.Records())
    for job in run.jobs:
        if job["status"] == "ok" and (not codecs or job["codec"] in codecs):
            part.jobs.put(job["job"], job)
            if timing := run.timing(job):
                part.timings.put(job["job"], timing)
    if not part.jobs:
        raise InputError(f"{run.folder}: no job{' of ' + ' or '.join(codecs) if codecs else ''} has a result there")
    if not any("materials" in start for start in run.starts):
        raise InputError(f"{run.folder}: its records do not say how materials were prepared: run the suite again")
    return part


def pack(run: Run, lines: str, path: Path) -> None:
    """Write the archive of a run's jobs, whose records are these lines. `InputError` if a file is gone."""
    files = [run.folder / job["file"] for job in run.jobs]
    files += sorted({run.folder / "files" / name for job in run.jobs if (name := _network(job))})
    if missing := next((file for file in files if not file.is_file()), None):
        raise InputError(f"{missing}: gone, but its job is recorded: run the suite again")
    with atomic.replacing(path) as partial, zipfile.ZipFile(partial, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(FILE, lines)
        for file in files:
            archive.write(file, f"files/{file.name}")


def _network(job: Record) -> str:
    """The name of the network file that a job's codec file needs, or ""."""
    digest = job["fit_key"].get("shared")
    return shared.hashed_name(job["codec"], digest) if digest else ""


def unpack(path: Path, folder: Path) -> Run:
    """Unpack an archive into an empty folder. `InputError` says what is wrong with it."""
    try:
        files = ZipFiles(path)
        if foreign := next((name for name in files.entries if not _belongs(name)), ""):
            raise InputError(f"{path}: {foreign!r} does not belong into an archive of results")
        if sum(map(files.size, files.entries)) > MOST_BYTES:
            raise InputError(f"{path}: unpacks to more than {MOST_BYTES >> 30} GiB: verify it in parts")
        (folder / "files").mkdir(parents=True, exist_ok=True)
        for name in files.entries:
            (folder / name).write_bytes(files.read(name))
    except OSError as error:
        raise InputError(f"{path}: cannot be unpacked ({error.strerror})") from error
    run = records.load_run(folder)
    if run.unreadable or not run.jobs:
        raise InputError(f"{path}: its records cannot be read (lines {run.unreadable[:5]}): pack the run again")
    return run


def _belongs(name: str) -> bool:
    return name == FILE or (name.startswith("files/") and "/" not in name[6:] and name[6:] not in ("", ".", ".."))


@dataclass(frozen=True)
class Verdict:
    """What became of one job: `AGREES`, `DIFFERS` or `NOT_VERIFIED`, why, and the record of what was measured here."""

    job: str
    verdict: str
    why: str = ""
    record: Record | None = None


def verify(run: Run, out: Path, show: Progress = silent) -> Iterator[Verdict]:
    """Decode and score the files of an unpacked archive, and write a run's folder of what was measured here."""
    starts = {start["run"]: start for start in run.starts}
    for start in starts.values():
        records.append(out, start)
    for job in run.jobs:
        try:
            yield _verified(job, starts.get(job.get("run"), {}), run.folder, out, show)
        except (ContainerError, MissingDataError) as error:
            yield Verdict(str(job.get("job")), NOT_VERIFIED, str(error))
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            yield Verdict(
                str(job.get("job")), NOT_VERIFIED, f"its record is not whole ({type(error).__name__}: {error})"
            )


def _verified(job: Record, start: Record, folder: Path, out: Path, show: Progress) -> Verdict:
    name = job["job"]
    if job["status"] != "ok":
        return Verdict(name, NOT_VERIFIED, f"no result was submitted: {job.get('error', '')}")
    if job["codec"] not in (*codec_entries(), COMMAND):
        libraries = ", ".join(f"{each} {version}" for each, version in job["fit_key"].get("libraries", {}).items())
        says = f"codec {job['codec']} version {job['fit_key']['version']}, code {job['fit_key']['code'][:12]}"
        return Verdict(name, NOT_VERIFIED, f"{says} is not installed here ({libraries})")
    spec = next(MaterialSpec(**each) for each in start["materials"] if each["name"] == job["material"])
    data = table(f"data of {name}", Preparation, start["data"])
    metrics = tuple(job["score_key"]["metrics"])
    task = Task(job["run"], folder, spec, data, CodecSpec(job["codec"]), int(job["seed"]), 1, metrics=metrics)
    with workbench(task, show) as bench:
        if bench.btf.fingerprint != job["score_key"]["btf"]:
            return Verdict(name, NOT_VERIFIED, f"the data of {job['material']} here are others than those submitted")
        return _judged(job, bench, folder, out, show)


def _judged(job: Record, bench: Workbench, folder: Path, out: Path, show: Progress) -> Verdict:
    file = folder / "files" / Path(job["file"]).name
    loaded = loading.load(file)
    if loaded.header.codec != job["codec"]:
        return Verdict(job["job"], DIFFERS, f"the file is of codec {loaded.header.codec}")
    place = Place(out, of_run=True)
    found = evaluate(bench, loaded, 1, place.keep, show)
    found |= {"score_key": score_key(bench, loaded.header), "scored": made(), "machine": machine(), "status": "ok"}
    record = kept(job, CLAIM) | found
    record["file"] = f"files/{place.put(f'files/{file.name}', file.read_bytes()).name}"
    reasons = list(_differences(job, record))
    records.append(out, record)
    return Verdict(job["job"], DIFFERS if reasons else AGREES, "; ".join(reasons), record)


def _differences(claimed: Record, here: Record) -> Iterator[str]:
    """The numbers that differ by more than rounding on another processor, in words."""
    for part, said in claimed["bytes"].items():
        if here["bytes"].get(part) != said:
            yield f"{part} has {here['bytes'].get(part)} bytes, not {said}"
    if here["parameters"] != claimed["parameters"]:
        yield f"{here['parameters']} parameters, not {claimed['parameters']}"
    measured = metrics_of(here)
    for name, stats in metrics_of(claimed, gate(claimed["scores"])).items():
        mine = measured.get(name, {}).get("pooled")
        if not _close(name, stats.get("pooled"), mine):
            yield f"{name} is {mine}, not {stats.get('pooled')}"


def _close(name: str, said: Any, mine: Any) -> bool:
    if said is None or mine is None:
        return said is mine
    tolerance = DECIBELS if name.startswith("psnr") else RELATIVE * abs(mine)
    return math.isclose(float(said), float(mine), rel_tol=0, abs_tol=tolerance)
