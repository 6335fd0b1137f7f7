"""The records of a run: one JSON object per line, appended and synced as soon as it is known.

`RUN/records.jsonl` holds four kinds of line: `run` (provenance, once a start), `job` (the result of a job: what
was encoded, its bytes, its errors, or why it failed), `timing` (one codec, setting or choice of a trade, timed in turns
with others) and `stress` (one extreme tried on one codec or metric). Paths in records are relative to the run's folder.
Imports neither PyTorch nor pandas.

A line begins with a checksum of the rest, so that cut or altered lines are detected, its kind, and, for jobs and
timings, the job's name. A line without a checksum, written by hand, is valid too.
"""

import json
import logging
import os
import re
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import wraps
from pathlib import Path
from typing import Any, TypeVar, cast, overload

from bench.inputs.errors import InputError, writable
from bench.records import fields
from bench.records.schema import (
    ARTEFACT,
    Job,
    Machine,
    Record,
    RunStart,
    ScoreKey,
    Stress,
    Timing,
    setting_name,
)

Item = TypeVar("Item")

log = logging.getLogger(__name__)

FILE = "records.jsonl"
STRESS = "stress"  # the folder that `neubtf-bench stress` writes to, beside those of runs

_SEALED = re.compile(rb'\{"crc32": "([0-9a-f]{8})", ')

_LONGEST_LINE = 16 << 20  # bytes; a record has a few thousand


def append(folder: Path, record: Record) -> None:
    """Append one record to a run and sync it to disk. `InputError` if it cannot be written."""
    remedy = "make room, then give the same command again: finished work is kept"
    with writable(folder / FILE, remedy), open(folder / FILE, "a+b", buffering=0) as file:
        end = file.tell()  # 0 if the file is new
        file.seek(max(0, end - 1))
        is_cut = file.read(1) not in (b"", b"\n")  # an earlier process was killed while writing its line
        rest = memoryview((b"\n" if is_cut else b"") + _sealed_line(record))
        # Whole or not at all: a write may take only a part of the bytes, and what a failed one left is cut off.
        try:
            while rest:
                rest = rest[os.write(file.fileno(), rest) :]
            os.fsync(file.fileno())
        except OSError:
            os.truncate(file.fileno(), end)
            raise


def _sealed_line(record: Record) -> bytes:
    """The line of a record: a checksum of the rest, its kind and the job's name, then all fields by name."""
    content = dict(record)
    head = {key: content[key] for key in ("kind", "job") if key in content}
    text = json.dumps(head | dict(sorted(content.items())), allow_nan=False)[1:].encode()  # after the opening brace
    return b'{"crc32": "%08x", %b\n' % (zlib.crc32(text), text)


class Records(Sequence[Item]):
    """Records of one kind: the latest of each name, in the order in which the names were planned or appeared."""

    def __init__(self, by_name: Mapping[Any, Item] | None = None) -> None:
        self._by_name: dict[object, Item] = dict(by_name or {})

    def put(self, name: object, record: Item) -> None:
        """Add a record; it replaces an earlier one of that name."""
        self._by_name[name] = record

    def drop(self, name: object) -> None:
        """Remove the record of a name, if there is one."""
        self._by_name.pop(name, None)

    def only(self, wanted: Callable[[Item], bool]) -> "Records[Item]":
        """The wanted records, under the same names."""
        return Records({name: record for name, record in self._by_name.items() if wanted(record)})

    def arrange(self, names: Iterable[object]) -> None:
        """Sort the records into this order; those it does not name follow."""
        ordered = {name: self._by_name[name] for name in names if name in self._by_name}
        self._by_name = ordered | self._by_name

    def latest(self, name: object) -> Item | None:
        """The latest record of a name, or None."""
        return self._by_name.get(name)

    def __len__(self) -> int:
        return len(self._by_name)

    def __iter__(self) -> Iterator[Item]:
        return iter(self._by_name.values())

    @overload
    def __getitem__(self, index: int) -> Item: ...
    @overload
    def __getitem__(self, index: slice) -> list[Item]: ...
    def __getitem__(self, index: int | slice) -> Item | list[Item]:
        """A record by its number, or a list of records by a slice."""
        return list(self._by_name.values())[index]


@dataclass(frozen=True, eq=False)
class Run:
    """A run's folder: the latest record of each job and timing; jobs in the order of their suite."""

    folder: Path
    file: str = FILE  # with the records, in the folder
    starts: list[RunStart] = field(default_factory=list)
    jobs: Records[Job] = field(default_factory=Records)
    timings: Records[Timing] = field(default_factory=Records)
    stress: Records[Stress] = field(default_factory=Records)
    unreadable: list[int] = field(default_factory=list)  # line numbers, from 1
    published: set[str] = field(default_factory=set)  # of several runs: the jobs that stand in files of records
    views: dict[Any, Any] = field(default_factory=dict, init=False, repr=False)  # what `view` keeps

    def job(self, name: str) -> Job | None:
        """The latest record of the job of that name."""
        return self.jobs.latest(name)

    def timing(self, job: Job) -> Timing | None:
        """The timing of a job's decoder; None if it was not timed."""
        return self.timings.latest(job["job"])

    def setting_timing(self, job: Job) -> Timing | None:
        """The timing of a job's setting, apart from its surface; None if it was not measured."""
        cost = job.get("cost", {})
        return self.timings.latest(setting_name(job["label"], cost.get("flops_per_sample", 0)))

    @property
    def setting_timings(self) -> list[Timing]:
        """The timings of settings, apart from surfaces: only they are pooled over rounds. Of each setting and device
        those of the run that timed it last, since a codec may have needed other operations before."""
        timings = [timing for timing in self.timings if "rounds" in timing]
        last_run: dict[tuple[str, str], str] = {}
        for timing in timings:
            place = timing["label"], timing["device"]
            last_run[place] = max(timing["run"], last_run.get(place, ""))
        return [each for each in timings if each["run"] == last_run[each["label"], each["device"]]]

    def start_of(self, record: Mapping[str, Any]) -> RunStart:
        """The start that measured a job or a timing: the last one, if it names none; empty if it is not here."""
        name = record.get("run", "")
        for start in reversed(self.starts):
            if not name or start.get("run") == name:
                return start
        return RunStart()

    def machine(self, timing: Timing) -> Machine:
        """The machine on which a timing was taken; empty if it is not known."""
        return self.start_of(timing).get("machine", Machine())

    @property
    def choices(self) -> list[Timing]:
        """The choices that `neubtf-bench trade` timed, or why it did not, and the floor of each material and device;
        without those of jobs that are not here or whose files were fitted again since."""
        of_trade = [timing for timing in self.timings if "material" in timing]
        ended = [timing for timing in of_trade if "ns_per_sample" in timing or "error" in timing]
        current = [timing for timing in ended if "of" not in timing or self._is_current(timing)]  # and floors
        timed = {(timing["material"], timing.get("device")) for timing in current if "of" in timing}
        return [each for each in current if (each["material"], each.get("device")) in timed]  # no floor alone

    def _is_current(self, timing: Timing) -> bool:
        """Whether the job that was timed is here, with the file that was timed; a job that failed has no file, and
        neither has its choice."""
        job = self.job(timing["of"])
        return job is not None and _file_of(job) == _file_of(timing)


def _file_of(record: Job | Timing) -> str | None:
    """The hash of the file that a record is of; None if there is none."""
    return record.get("score_key", ScoreKey()).get("sha256")


def view(function: Callable[..., Item]) -> Callable[..., Item]:
    """Decorate a function of a run, and of words: its result is kept in `Run.views`, since many tables ask for it."""

    @wraps(function)
    def answer(run: Run, *words: str) -> Item:
        """The function's answer for this run and these words, from before if it was asked for then."""
        key = (function, *words)
        if key not in run.views:
            run.views[key] = function(run, *words)
        return cast(Item, run.views[key])

    return answer


def load_run(folder: str | Path) -> Run:
    """Read the records of a run, given its folder or a file of records, `.jsonl`.

    Raises `InputError` if the file is missing or cannot be read, and for a wrong field, which it names with file and
    line. Lines that are not records (cut, altered, of another kind) are listed by number in `unreadable`.
    """
    path = Path(folder) if str(folder).endswith(".jsonl") else Path(folder) / FILE
    if not path.is_file():
        if Path(folder).exists():
            what = f"no run here (no {FILE})"
        elif path == Path(folder):
            what = "no such file"
        else:
            what = "no such folder"
        raise InputError(f"{folder}: {what}: give the folder that `neubtf-bench run` wrote, or a file of its records")
    run = Run(path.parent, path.name)
    try:
        with open(path, "rb") as file:
            # Line by line up to the end, where `readline` gives b"".
            for number, line in enumerate(iter(lambda: file.readline(_LONGEST_LINE), b""), 1):
                if line.strip() and not _add_line(run, line, f"{path}, line {number}"):
                    run.unreadable.append(number)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}): give a file that can be read") from error
    planned: list[str] = []
    for start in run.starts:
        planned += start.get("jobs", [])
    run.jobs.arrange(planned)
    return run


def run_so_far(folder: Path) -> Run:
    """The records of a run's folder, as `load_warned`; a run without any if nothing was recorded there yet."""
    return load_warned(folder) if (folder / FILE).exists() else Run(folder)


def load_together(
    sources: Sequence[str | Path], wanted: Callable[[Job], bool] = lambda job: True, beside: bool = False
) -> Run:
    """Read several runs as one: folders of runs, files of records, and folders of such files (`*.jsonl`).

    The paths in the records of several runs become absolute. Warns of lines that cannot be read, which are left out. If
    two runs measured the same job, the later one counts; `InputError` without any source, and if two used different
    data. Jobs that failed replace none with a result, and jobs with a result that are not `wanted` replace no other
    job. With `beside`, files of records come first, and a job of a folder that used other data than theirs stands
    beside theirs under another name, without its timing.
    """
    paths = [path for source in sources for path in _files_of(Path(source))]
    if not paths:
        raise InputError("no run is given: give folders of runs, or files of records")
    if beside:
        paths.sort(key=lambda path: path.suffix != ".jsonl")
    runs = [load_warned(path) for path in paths]
    if len(runs) == 1:
        return runs[0]
    together = Run(runs[-1].folder)
    for number, (path, run) in enumerate(zip(paths, runs, strict=True)):
        is_file = path.suffix == ".jsonl"  # of records, not the folder of a run
        together.starts.extend(run.starts)
        together.unreadable.extend(run.unreadable)
        # The names of this run's jobs that replace none of another run; nor do their timings.
        aside: set[str] = set()
        for job in (_with_whole_paths(each, run.folder.absolute()) for each in run.jobs):
            name = job["job"]
            if job["status"] == "ok" and not wanted(job):
                aside.add(name)
                together.jobs.put((number, name), job)  # under a key that no other job has
                continue
            known = together.job(name)
            has_result = known is not None and known["status"] == "ok"
            if has_result and job["status"] != "ok":  # what failed has no number to put in place of one
                aside.add(name)
                continue
            if not _of_other_data(job, known):
                if known and _file_of(known) != _file_of(job):
                    together.timings.drop(name)  # that of another file
                together.jobs.put(name, job)
                if is_file:
                    together.published.add(name)
                continue
            if is_file or not beside or name not in together.published:
                remedy = "was measured on other data in an earlier run: give fewer runs, or name the material otherwise"
                raise InputError(f"{run.folder}: {name} {remedy}")
            aside.add(name)
            other_name = f"{name}, other data of {run.folder.name}"
            together.jobs.put(other_name, {**job, "job": other_name})
        for timing in run.timings:
            if not aside & {timing["job"], timing.get("of")}:  # of a job, or of a choice of its file
                together.timings.put(timing["job"], timing)
    return together


def load_warned(path: str | Path) -> Run:
    """As `load_run`, with a warning of lines that cannot be read."""
    run = load_run(path)
    if run.unreadable:
        lines = ", ".join(map(str, run.unreadable))
        log.warning("%s: cut or altered, and left out: line(s) %s", path, lines)
    return run


def refuse_damaged(sources: Sequence[str | Path]) -> None:
    """Raise an `InputError` if a line of what `load_together` reads is cut or altered: what is missing may stand there.

    For a caller that finds nothing in the other lines.
    """
    for source in sources:
        for path in _files_of(Path(source)):
            run = load_run(path)
            if run.unreadable:
                lines = ", ".join(map(str, run.unreadable))
                why = "damaged (cut or altered), and the rest has nothing to show: mend or remove the damaged"
                raise InputError(f"{run.folder / run.file}, line(s) {lines}: {why}")


def _of_other_data(job: Job, known: Job | None) -> bool:
    """Whether a job and the known one of its name were measured on different data; False if either does not say."""
    mine = job.get("score_key", {}).get("btf")
    theirs = known.get("score_key", {}).get("btf") if known else None
    return bool(mine and theirs and mine != theirs)


def _with_whole_paths(job: Job, folder: Path) -> Job:
    """A job whose paths of files are absolute, since the runs of several folders are read as one."""
    whole = dict(job)
    for name in fields.field_names(ARTEFACT):
        place = whole.get(name)
        if isinstance(place, str):
            whole[name] = str(folder / place)
    return cast(Job, whole)


def _files_of(source: Path) -> list[Path]:
    """What `load_run` reads of a source: the source itself, or the files of records in a folder that is no run."""
    if source.suffix == ".jsonl" or (source / FILE).is_file():
        return [source]
    return sorted(source.glob("*.jsonl")) or [source]


def _whole_job(job: dict[str, Any], start: RunStart) -> dict[str, Any]:
    """A job of published records with what these say once: the settings of its fit; the facts and versions of metrics,
    which its start has; the names in the points of a curve. What is of another form stays as it is."""
    whole = dict(job)
    fit_key, score_key, history = (job.get(name) for name in ("fit_key", "score_key", "history"))
    if isinstance(fit_key, dict) and fit_key and "settings" in job:
        whole["fit_key"] = fit_key | {"settings": fit_key.get("settings", job["settings"])}
    if isinstance(history, dict) and all(isinstance(column, list) for column in history.values()):
        with suppress(ValueError):  # columns of different lengths
            points = zip(*history.values(), strict=True)
            whole["history"] = [dict(zip(history, point, strict=True)) for point in points]
    facts = start.get("metrics")
    if facts and isinstance(score_key, dict) and "metrics" not in job and job.get("status") == "ok":
        versions = {name: each["version"] for name, each in facts.items()}
        whole["metrics"] = facts
        whole["score_key"] = score_key | {"metrics": score_key.get("metrics", versions)}
    return whole


def _parsed(line: bytes) -> dict[str, Any] | None:
    """The record of a line; None if it is cut, altered, or no record of a known kind."""
    sealed = _SEALED.match(line)
    if sealed and int(sealed[1], 16) != zlib.crc32(line[sealed.end() :].rstrip(b"\n")):
        return None
    from pydantic_core import from_json  # only where something is read; it takes two thirds of the time of `json`

    try:
        record = from_json(line)
    except ValueError:
        return None
    kind = record.get("kind") if isinstance(record, dict) else None
    if not isinstance(kind, str) or kind not in fields.FIELDS or (kind in ("job", "timing") and "job" not in record):
        return None
    return {name: value for name, value in record.items() if name != "crc32"}


def _add_line(run: Run, line: bytes, place: str) -> bool:
    """Add the record of a line to the run; return False if the line is not a record.

    `InputError` for a wrong field, which it names with the line's `place`, its file and number.
    """
    record = _parsed(line)
    if record is None:
        return False
    if record["kind"] == "job":
        record = _whole_job(record, run.start_of(record))
    fault = fields.fault_of_record(record)
    if fault:
        raise InputError(f"{place}: {fault}: mend the line or remove it")
    match record["kind"]:
        case "run":
            run.starts.append(cast(RunStart, record))
        case "stress":
            run.stress.put((record["subject"], record["extreme"]), cast(Stress, record))
        case "job":
            job = cast(Job, record)
            before = run.job(job["job"])
            if before and job["status"] == "ok" and _file_of(before) != _file_of(job):
                run.timings.drop(job["job"])  # the time is that of another file
            run.jobs.put(job["job"], job)
        case "timing":
            run.timings.put(record["job"], cast(Timing, record))
    return True
