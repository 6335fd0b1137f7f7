"""Packs the records and codec files of a run into one archive, and scores an archive's files again on this machine.

A run writes one record, a dictionary, for each job (a codec with its settings on a material, with a seed) and one for
each start. The archive is a zip: `records.jsonl`, these records as `bench.compare.reference` shortens them, and the
codec files in `files/`, with the networks that they share. Whoever submits an archive claims that its records are true.
Whoever verifies it decodes and scores the files again, and compares the claims with these measurements. Nothing in an
archive is run: jobs of a codec that is not installed here are listed but not verified.
"""

import dataclasses
import json
import math
import os
import shlex
import zipfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, cast

from bench import records
from bench.codec import Progress, settings_dict, silent
from bench.codecs import container, loading, shared
from bench.codecs.container import Header
from bench.codecs.registry import COMMAND, UNLABELLED, codec_entries, make_codec
from bench.data.kinds import kind_of
from bench.data.spec import MaterialSpec, Preparation
from bench.files import atomic
from bench.files.archive import ZipFiles, inside
from bench.inputs.errors import InputError, said_by
from bench.inputs.settings import table
from bench.records import (
    CLAIM,
    FILE,
    NAMES,
    OUTSIDE,
    PSNR,
    SCENE_HELDOUT,
    FitKey,
    Job,
    Records,
    Run,
    RunStart,
    kept,
    method_of,
    metrics_of,
)
from bench.records.schema import job_name
from bench.runs.evaluation import evaluate, score_key
from bench.runs.job import store_content
from bench.runs.provenance import machine, provenance, revision_and_time
from bench.runs.workbench import Opening, Workbench, open_workbench

# An archive may unpack to `RATIO` times its own bytes, or to `LEAST_BYTES` if that is more, but not over `MOST_BYTES`.
MOST_BYTES = 4 << 30
LEAST_BYTES = 256 << 20
RATIO = 64
MOST_RENDERED = 4 << 30  # bytes of radiance that an archive may make us render, of each material
# The largest change by rounding on another processor: of PSNR in dB, and of other numbers as a share.
DECIBELS = 0.01
RELATIVE = 1e-3
MOST_REASONS = 4  # that a verdict lists
_STARTED = ("kind", "run", "suite", "data", "materials", "jobs")  # fields taken from the start of a submitted run
AGREES, DIFFERS, NOT_VERIFIED = "agrees", "differs", "not verified"


def jobs_with_results(run: Run, codecs: list[str]) -> Run:
    """A run reduced to its jobs with a result, and their timings; of some `codecs`, or of all if none are named.

    `InputError` if no job is left, if no start says how materials were prepared, or if a job lacks a field by which it
    is verified.
    """
    with_results = [job for job in run.jobs if job["status"] == "ok"]
    chosen = {job["job"]: job for job in with_results if not codecs or job["codec"] in codecs}
    if not chosen:
        of_codecs = f" of {' or '.join(codecs)}" if codecs else ""
        codecs_with_results = ", ".join(sorted({job["codec"] for job in with_results})) or "none"
        raise InputError(f"{run.folder}: no job{of_codecs} has a result; codecs with results: {codecs_with_results}")
    # Whoever verifies the jobs prepares the same data, and needs the preparation for it.
    if not any("materials" in start for start in run.starts):
        raise InputError(f"{run.folder}: its records do not say how materials were prepared: run the suite again")
    for job in chosen.values():
        records.require(job, "verification", run.folder)
    timings = {timing["job"]: timing for timing in map(run.timing, chosen.values()) if timing}
    return dataclasses.replace(run, jobs=Records(chosen), timings=Records(timings))


def pack(run: Run, lines: str, path: Path) -> None:
    """Write the archive of a run's jobs. `lines` becomes its `records.jsonl`. `InputError` if a codec file is gone,
    or is not the one that its job recorded."""
    files = [_checked_file(run, job["file"], str(job["score_key"].get("sha256"))) for job in run.jobs]
    for job in run.jobs:  # the networks that these files need
        digest = job["fit_key"].get("shared")  # the hash of the network's file; absent if the codec shares none
        if digest:
            files.append(_checked_file(run, f"files/{shared.hashed_name(job['codec'], digest)}", digest))
    with atomic.replacing(path) as unfinished, zipfile.ZipFile(unfinished, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(FILE, lines)
        for file in dict.fromkeys(files):  # each once: several jobs may have one file, or share one network
            archive.write(file, f"files/{file.name}")


def _checked_file(run: Run, name: str, digest: str) -> Path:
    """The path of a codec file of this run, given its name and hash.

    `InputError` for any other file, because a record could name any file of this machine.
    """
    file = run.folder / name
    if not file.resolve().is_relative_to(run.folder.resolve()):
        raise InputError(
            f"{run.folder}: a record names the file {name!r}, which does not belong to this run: run the suite again"
        )
    if not file.is_file():
        raise InputError(f"{file}: the file of a recorded job is missing: run the suite again")
    if container.read_header(file).sha256 != digest:
        raise InputError(f"{file}: not the file that its job recorded: run the suite again")
    return file


def unpack(path: Path, folder: Path) -> Run:
    """Unpack an archive into an empty folder, and return its run.

    Raises `InputError` for a file that does not belong in an archive, for one that unpacks to too much, and for records
    that cannot be read or have no job.
    """
    try:
        files = ZipFiles(path)
        for name in files.entries:
            if not _belongs(name):
                raise InputError(f"{path}: {name!r} does not belong in an archive of results: pack the run again")
        # A small zip can unpack to terabytes, so its sizes are checked before anything is unpacked.
        most = min(MOST_BYTES, max(LEAST_BYTES, RATIO * files.length))
        if sum(map(files.size, files.entries)) > most:
            raise InputError(f"{path}: it unpacks to more than {most >> 20:,} MiB: pack and verify it in parts")
        atomic.make_folder(folder / "files")
        for name in files.entries:
            (folder / name).write_bytes(files.read(name))
    except OSError as error:
        remedy = f"see that it can be read, and that {folder} has room and can be written"
        raise InputError(f"{path}: cannot be unpacked ({error.strerror}): {remedy}") from error
    run = records.load_run(folder)
    if run.unreadable:  # numbers of lines
        raise InputError(f"{path}: its records cannot be read (lines {run.unreadable[:5]}): pack the run again")
    if not run.jobs:
        raise InputError(f"{path}: its records have no job: pack the run again")
    return run


def _belongs(name: str) -> bool:
    """Whether an archive may hold a file of this name: the records, or a file directly in `files/`."""
    if name == FILE:
        return True
    folder, _, inside_folder = name.partition("/")
    return folder == "files" and "/" not in inside_folder and inside_folder not in ("", ".", "..")


@dataclass(frozen=True)
class Verified:
    """The verdict on one job: `AGREES`, `DIFFERS` or `NOT_VERIFIED`, and why."""

    job: str
    verdict: str
    why: str = ""


def verify(run: Run, out: Path, show: Progress = silent, places: Mapping[str, str] | None = None) -> Iterator[Verified]:
    """Decode and score the files of an unpacked archive, write the measurements here as the folder `out` of a run, and
    yield the verdict on each job.

    Measured data must lie under `NEUBTF_DATA`, or at the path that `places` has by name of material: an archive may not
    choose which paths of this machine are opened.
    """
    # Who measured, and with what, is said of this machine; only what the jobs are comes from the archive.
    here = {"text": "", "device": "cpu", "threads": 1, **provenance()}
    last_starts = {start["run"]: start for start in run.starts if "run" in start}  # the last of each name
    for start in last_starts.values():
        submitted = {key: value for key, value in start.items() if key in _STARTED}
        records.append(out, cast(RunStart, submitted | here))
    for job in run.jobs:
        name = job["job"]
        try:
            yield _verdict_on_job(job, run.start_of(job), run.folder, out, show, places or {})
        except InputError as error:
            yield Verified(name, NOT_VERIFIED, str(error))
        except OSError:  # such as a full disk: it says nothing of the job
            raise
        except Exception as error:  # records and codec files of others may raise any error
            yield Verified(name, NOT_VERIFIED, f"cannot be scored here ({said_by(error)})")


def _verdict_on_job(
    job: Job, start: RunStart, folder: Path, out: Path, show: Progress, places: Mapping[str, str]
) -> Verified:
    """The verdict on one job of an archive that is unpacked in `folder`; `start` is the one that measured it.

    A job is scored only if it has a result, its codec is installed, and its data are the submitted data. Otherwise it
    is `NOT_VERIFIED`, and its file is not decoded.
    """
    name = job["job"]
    if job["status"] != "ok":
        return Verified(name, NOT_VERIFIED, f"no result was submitted: {job.get('error', '')}")
    records.require(job, "verification", folder)
    if job["codec"] not in (*codec_entries(), COMMAND):
        short_hash = str(job["fit_key"]["code"])[:12]
        codec = f"codec {job['codec']} version {job['fit_key']['version']}, code {short_hash}"
        return Verified(name, NOT_VERIFIED, f"{codec} is not installed here")
    if "pooled" not in metrics_of(job).get(PSNR, {}):
        return Verified(name, NOT_VERIFIED, "its record has no scores to compare")
    spec = _material_here(job, start, places)
    data = table(f"data of {name}", Preparation, start.get("data"))
    if kind_of(spec).rendered and data.bytes_rendered > MOST_RENDERED:
        size = f"{data.bytes_rendered >> 30} GiB of {spec.name}, and an archive may ask for {MOST_RENDERED >> 30}"
        return Verified(name, NOT_VERIFIED, f"it would render {size}: run its suite here, and compare both")
    metrics = tuple(job["score_key"]["metrics"])
    with open_workbench(Opening(job["run"], spec, data, metrics), show) as workbench:
        if workbench.btf.fingerprint != job["score_key"]["btf"]:
            return Verified(name, NOT_VERIFIED, f"the data of {spec.name} here differ from the submitted data")
        return _verdict_by_scoring(job, workbench, folder, out, show, data.split)


def _material_here(job: Job, start: RunStart, places: Mapping[str, str]) -> MaterialSpec:
    """How the material of a job was prepared, with its path on this machine.

    `places` maps names of materials to paths that the user of this machine gave. `InputError` if the start does not
    list the material, or if the archive would choose the path itself.
    """
    stated = start.get("materials") or []  # absent, or null in the record
    materials = [table("materials of its run", MaterialSpec, each) for each in stated]
    spec = next((each for each in materials if each.name == job["material"]), None)
    if spec is None:
        raise InputError(f"its run does not say how {job['material']} was prepared: pack the run again")
    if spec.name in places:
        return dataclasses.replace(spec, path=places[spec.name])
    if not spec.path:  # a built-in material, which has no file
        return spec
    remedy = f"say where it is with --material {shlex.quote(spec.name)}=PATH"
    root = os.environ.get("NEUBTF_DATA")
    if root is None or Path(spec.path).is_absolute():
        raise InputError(f"the archive may not choose the path {spec.path} of {spec.name}: {remedy}")
    return dataclasses.replace(spec, path=str(Path(root) / inside(spec.path, f"the data of {spec.name}")))


def _verdict_by_scoring(
    job: Job, workbench: Workbench, folder: Path, out: Path, show: Progress, split: str
) -> Verified:
    """Score the file of a job here, and compare with what the job claims; writes the record and the file into `out`.

    `folder` is that of the unpacked archive; `split` says what pairs were held out for, such as "test".
    """
    file = folder / "files" / Path(job["file"]).name  # the name alone: a claimed path could lead out of the archive
    loaded = loading.load(file)
    header = loaded.header
    if header.codec != job["codec"]:
        return Verified(job["job"], DIFFERS, f"the file is of codec {header.codec}")
    misfits = list(misnamed(job, header))
    if misfits:
        return Verified(job["job"], DIFFERS, "; ".join(misfits))
    record = _measured_here(job, workbench, loaded, out, show) | {"split": split}
    atomic.write(out / record["file"], file.read_bytes())
    reasons = list(differences(job, record))
    records.append(out, record)
    if not reasons:
        return Verified(job["job"], AGREES)
    why = "; ".join(reasons[:MOST_REASONS])
    if len(reasons) > MOST_REASONS:
        why += f" and {len(reasons) - MOST_REASONS} more"
    return Verified(job["job"], DIFFERS, why)


def _measured_here(job: Job, workbench: Workbench, loaded: loading.Loaded, out: Path, show: Progress) -> Job:
    """The record of a decoded file as it is measured here, with the names of the claimed job, such as its material and
    seed. Large arrays, such as pictures of slices, go into files below `out`."""
    header = loaded.header
    record: Job = {**kept(job, NAMES), "fit_key": _key_of_fit(job, header, workbench)}
    record |= evaluate(workbench, loaded, threads=1, keep=partial(store_content, out), show=show)
    record |= {"score_key": score_key(workbench, header), "scored": revision_and_time(), "machine": machine()}
    return record | {"status": "ok", "verified": True, "file": f"files/{header.path.name}"}


def _key_of_fit(job: Job, header: Header, workbench: Workbench) -> FitKey:
    """What a file says of its fit; the version of the store of textures, which no file holds, is the claimed one."""
    key: FitKey = {"codec": header.codec, "version": header.version, "settings": header.settings}
    key |= {"store": job["fit_key"]["store"], "training": workbench.training.fingerprint}
    if header.network:
        key["shared"] = header.network
    return key


def differences(claimed: Job, here: Job) -> Iterator[str]:
    """The claims that differ from the measurements here by more than rounding on another processor, in words."""
    measured = json.loads(json.dumps(here))  # with lists for tuples, as the claims were read from JSON, too
    for name, value in kept(claimed, CLAIM).items():
        yield from _differences_of_values(name, value, measured.get(name))


def _differences_of_values(place: str, claimed: Any, measured: Any) -> Iterator[str]:
    """Where a measured value differs from the claimed one by more than machines differ, in words.

    Both are values as in JSON, dictionaries of dictionaries included. `place` is the path of the value in the record,
    such as `scores/heldout/metrics/psnr_display/mean`.
    """
    if isinstance(claimed, dict) and isinstance(measured, dict):
        for name, value in claimed.items():
            if place in ("scores", "pairs") and name in ("scene", SCENE_HELDOUT, OUTSIDE):
                continue  # scores in a scene: archives hold no demand, and these are not published
            yield from _differences_of_values(f"{place}/{name}", value, measured.get(name))
        return
    if not _agree(place, claimed, measured):
        yield f"{place} is {measured}, not {claimed}"


def _agree(place: str, claimed: Any, measured: Any) -> bool:
    """Whether two values agree: floats within rounding, counts, texts and missing values (None) only if equal."""
    are_numbers = isinstance(claimed, int | float) and isinstance(measured, int | float)
    if not (are_numbers and float in (type(claimed), type(measured))):
        return bool(claimed == measured)
    in_decibels = "/psnr" in place or place.startswith(("footprints/", "between/"))
    return math.isclose(claimed, measured, rel_tol=0, abs_tol=DECIBELS if in_decibels else RELATIVE * abs(measured))


def misnamed(claimed: Job, header: Header) -> Iterator[str]:
    """Why the names of a job do not fit its file, in words; nothing if they do.

    A label is the codec and the settings that are not defaults, such as `pca components=4`. A curve is the settings
    that the rungs of one curve share, such as `pca`: a part of the label's words. A job is material/label/seed.
    """
    label = str(claimed["label"])
    curve = str(claimed["curve"])
    unlabelled: dict[str, Any] = {}
    if header.codec == COMMAND:
        unlabelled = {key: value for key, value in header.settings.items() if key in UNLABELLED}
    called = str(unlabelled.get("called", header.codec))
    words = label.removeprefix(called).split()  # each is KEY=VALUE
    if label != " ".join([called, *words]) or not _are_settings_of(header, words, unlabelled):
        yield f"label is {label!r}, but the file's codec and settings have another label"
    if method_of(claimed) != called:
        yield f"it is called {method_of(claimed)!r}, but the file's codec {called!r}"
    words_of_curve = curve.removeprefix(called).split()
    if curve != " ".join([called, *words_of_curve]) or not set(words_of_curve) <= set(words):
        yield f"curve is {curve!r}, which does not belong to the label"
    name = job_name(claimed["material"], label, claimed["seed"])
    if name != claimed["job"]:
        yield f"job is {claimed['job']!r}, not {name!r}"


def _are_settings_of(header: Header, words: list[str], unlabelled: dict[str, Any]) -> bool:
    """Whether the words KEY=VALUE of a label, with the settings that it leaves out, give all settings of a file."""
    try:
        of_label = dict(word.split("=", 1) for word in words)
        codec = make_codec(header.codec, unlabelled | of_label)
        return settings_dict(codec) == settings_dict(make_codec(header.codec, header.settings))
    except (InputError, ValueError):  # the label names no codec and settings
        return False
