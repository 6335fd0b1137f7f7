"""Writes the records of a run as a reference: a file small enough to commit, with what a comparison needs.

The same records give the same bytes. It contains no folder, host or time, but the processor and the versions of
packages, because a comparison notes when they differ; and the scores of slices, packed, so that paired intervals can be
computed.
"""

import json
import tempfile
import tomllib
from collections.abc import Iterable, Iterator
from contextlib import suppress
from importlib.resources import files
from pathlib import Path
from typing import NamedTuple

from bench import records
from bench.compare.comparison import check_whole
from bench.compare.publishing import published_job
from bench.compare.quantities import MAIN, deciding
from bench.compare.verdicts import FEW_SEEDS, is_random, smallest_loss, why_unlike
from bench.files.atomic import write
from bench.inputs.errors import InputError, writable
from bench.metrics import stats_of
from bench.records import (
    FILE,
    PSNR,
    Job,
    Run,
    Timing,
    by_row,
    deciding_group,
    kept,
    load_run,
    metrics_of,
    rounded,
)

WIDEST = 1.0  # dB of PSNR: a reference that cannot tell such a loss from chance is refused


def committed(suite: str) -> Path:
    """The path of a suite's reference in this package."""
    return Path(str(files("bench.compare"))) / "references" / f"{suite}.jsonl"


def names_its_runs(run: Run) -> bool:
    """Whether records are results, which name the starts that measured them; a reference names none."""
    return any("run" in line for line in (*run.starts, *run.jobs))


class Update(NamedTuple):
    """A reference that was written again."""

    before: Run | None  # what the file held; None without one
    after: Run
    losses: dict[str, dict[str, float]]  # `smallest_losses` that a run shows


def update(run: Run, path: Path, wide: bool) -> Update:
    """Write the `reference` of a run to the file `path`, which keeps further seeds of what it held.

    `InputError`, before anything is written, for a name that no reference has, for a damaged file, for a run that
    `reference` refuses, and, unless `wide`, for a reference with a row that hides a loss of PSNR above `WIDEST`; also
    if the file cannot be written.
    """
    if path.suffix != ".jsonl":
        raise InputError(f"{path}: the name of a reference ends in .jsonl")
    if path.name == FILE:  # of this run or of another: its measurements would be lost
        raise InputError(f"{path}: the records of a run have this name: give --out another one")
    before = load_run(path) if path.is_file() else None
    if before:
        check_whole(before)
        if names_its_runs(before):
            raise InputError(f"{path}: it holds results, not a reference: give --out another name")
    text = reference(run, before)
    with tempfile.TemporaryDirectory() as folder:  # judged before it replaces the one that is there
        trial = Path(folder) / path.name
        trial.write_text(text, encoding="utf-8")
        losses = smallest_losses(load_run(trial), seeds_of(run))
    if not wide:
        _refuse_wide(losses, path)
    with writable(path, "give --out FILE"):
        write(path, text.encode())
    return Update(before, load_run(path), losses)


def _refuse_wide(losses: dict[str, dict[str, float]], path: Path) -> None:
    """Raise `InputError` for rows whose loss of PSNR must exceed `WIDEST` to be told from chance."""
    wide = {name: loss_of[MAIN] for name, loss_of in losses.items() if loss_of.get(MAIN, 0.0) > WIDEST}
    if wide:
        listed = ", ".join(f"{name} {loss:.1f} dB" for name, loss in wide.items())
        raise InputError(
            f"{path}: not written: smaller losses of PSNR could not be told from chance: {listed}: fit with "
            "more steps, add seeds, or give --wide"
        )


def reference(run: Run, before: Run | None = None) -> str:
    """The text of a run's reference. Raises `InputError` if the run is empty or has jobs without a result, or if slices
    cannot be read.

    A row of a reference is one setting of a codec on one material, with a job for each seed. If the seeds of a row gave
    the same numbers as in the reference `before`, its further seeds in `before` are kept: the codec did not change, so
    they still measure its scatter.
    """
    jobs = _in_order(run.jobs)
    if not jobs:
        raise InputError(f"{run.folder}: the run has no results: a reference needs a complete run")
    unfinished = [job for job in jobs if job["status"] != "ok"]
    if unfinished:
        job = unfinished[0]
        raise InputError(
            f"{run.folder}: {len(unfinished)} job(s) without a result, the first {job['job']} ({job['error']}): "
            "a reference needs a complete run"
        )
    reduced = [_reduced_job(job, run.folder) for job in jobs]
    kept_seeds = _seeds_to_keep(reduced, before.jobs) if before else []
    starts = [kept(start, records.REFERENCE) for start in run.starts[-1:]]  # the last, if there is one
    for start in starts:  # of the packages only those on which numbers depend
        packages = start.get("packages", {})
        start["packages"] = {name: packages[name] for name in ("neubtf-bench", "torch", "numpy") if name in packages}
    lines = [*starts, *_in_order([*reduced, *kept_seeds]), *_timings(run, jobs)]
    return "".join(json.dumps(line, sort_keys=True, allow_nan=False, separators=(",", ":")) + "\n" for line in lines)


def few_seeds(run: Run) -> list[str]:
    """The names, material/label, of rows whose seeds differ in PSNR and are too few to estimate their scatter."""
    few = [(row, jobs) for row, jobs in by_row(run.jobs).items() if len(jobs) < FEW_SEEDS]
    return ["/".join(row) for row, jobs in few if len({stats_of(job, PSNR).get("mean") for job in jobs}) != 1]


def smallest_losses(run: Run, count: int) -> dict[str, dict[str, float]]:
    """By row and quantity, the smallest loss of PSNR in dB that `count` new seeds show, at held-out pairs (`MAIN`) and
    at training pairs (`train`)."""
    losses_of_row = {}
    for row, jobs in by_row(run.jobs).items():
        quantities = deciding(jobs[0])
        draws = is_random(quantities, jobs)
        of_psnr = [quantity for quantity in quantities if quantity.name in (MAIN, "train")]
        losses_of_row["/".join(row)] = {each.name: smallest_loss(each, jobs, count, draws) for each in of_psnr}
    return losses_of_row


def seeds_of(run: Run) -> int:
    """The number of seeds that a run of the suite will have; that of the run itself if its suite is unknown, or if it
    has none because each codec has its own."""
    seeds = []
    with suppress(IndexError, KeyError, tomllib.TOMLDecodeError):  # no start; one without its suite; a damaged one
        suite = tomllib.loads(run.starts[-1]["text"])
        seeds = suite.get("seeds", [0])  # as a suite that says nothing of seeds has it
    return len(set(seeds) or {job["seed"] for job in run.jobs})


def limits(update: Update) -> list[str]:
    """Lines that say what a reference cannot tell: losses within chance, and codecs whose scatter is not known."""
    lines = []
    if update.losses:
        lines.append("losses below these cannot be told from chance on these materials:")
        width = max(map(len, update.losses))
        for name, loss_of in update.losses.items():
            listed = ", ".join(f"{word} {value:.2f} dB" for word, value in loss_of.items())
            lines.append(f"  {name:<{width}}  {listed}")
    few = few_seeds(update.after)
    if few:
        lines.append(f"too few seeds to tell a spread; add some with `run --seed N --out RUN`: {', '.join(few)}")
    return lines


def _timings(run: Run, jobs: list[Job]) -> Iterator[Timing]:
    """The timings of jobs for a reference; starts are numbered, so that their times change nothing in it."""
    numbers = {start.get("run", ""): str(number) for number, start in enumerate(run.starts, 1)}
    for job in jobs:
        timing = run.timing(job)
        if timing is not None:  # the job was timed
            start = numbers.get(timing["run"], timing["run"])
            yield rounded(kept(timing, records.REFERENCE)) | {"run": start}


def _seeds_to_keep(jobs: Iterable[Job], before: Iterable[Job]) -> Iterator[Job]:
    """The jobs of `before` whose seeds are missing now, from rows whose other seeds have the same numbers in both."""
    now = {job["job"]: job for job in jobs}
    for earlier in by_row(before).values():
        unchanged = [_is_unchanged(job, now[job["job"]]) for job in earlier if job["job"] in now]
        if unchanged and all(unchanged):  # else the codec changed, or nothing says that it did not
            yield from (job for job in earlier if job["job"] not in now)


def _is_unchanged(before: Job, now: Job) -> bool:
    """Whether a job is comparable with an earlier one, and each number that decides a comparison is the same."""

    def numbers(job: Job) -> list[tuple[object, ...]]:
        """The version and the value of each of these numbers of a job."""
        return [(quantity.version(job), quantity.value(job)) for quantity in deciding(before)]

    return not why_unlike(before, now) and numbers(before) == numbers(now)


def _in_order(every: Iterable[Job]) -> list[Job]:
    """The jobs by material and label, both in the order of first appearance, then by seed."""
    jobs = list(every)
    materials = list(dict.fromkeys(job["material"] for job in jobs))
    labels = list(dict.fromkeys(job["label"] for job in jobs))
    return sorted(jobs, key=lambda job: (materials.index(job["material"]), labels.index(job["label"]), job["seed"]))


def _reduced_job(job: Job, folder: Path) -> Job:
    """The record of a job as it is published, without what no comparison reads.

    Of the scores those stay of the deciding pairs (held out, or all if none are), of its parts at grazing directions,
    and of training pairs.
    """
    line = published_job(job, folder, records.REFERENCE)
    decides = deciding_group(line["scores"])
    compared = (decides, f"{decides}, grazing view", f"{decides}, grazing light", "train")
    line["scores"] = {name: {"metrics": metrics_of(line, name)} for name in compared if name in line["scores"]}
    for group in line["scores"].values():
        for stats in group["metrics"].values():
            for unread in ("std", "worst", "relative"):
                stats.pop(unread, None)
    return rounded(line)
