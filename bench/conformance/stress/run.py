"""Tries the catalogue on codecs, and the pictures on metrics and losses, as records.

The catalogue is the cases of `bench.conformance.stress`: extremes of data, queries, networks and rules. Each codec and
case gives a record, a dictionary with the verdict, that a report shows as a cell.
"""

import dataclasses
import logging
import tempfile
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, as_completed
from pathlib import Path
from typing import cast

from bench.codec import Progress, silent
from bench.codecs.registry import codec_entries, load_codec
from bench.conformance.stress import CASES, metrics
from bench.conformance.stress.case import Case, CaseVerdict, judge, subject_of
from bench.inputs.errors import InputError, did_you_mean
from bench.records import Stress
from bench.runs.executors import Workers


def chosen(codecs: Sequence[str], names: Sequence[str]) -> tuple[list[str], list[Case]]:
    """The chosen codecs (by default all installed ones) and cases (by default all). `InputError` for unknown names."""
    case_of = {case.name: case for case in CASES}
    for name in names:
        if name not in case_of:
            raise InputError(f"--case {name}: no such case{did_you_mean(name, case_of)} (see stress --list)")
    wanted = codecs or sorted(codec_entries())
    kinds = [load_codec(name) for name in wanted]
    cases = [case_of[name] for name in names] if names else list(CASES)
    return [kind.name for kind in kinds], cases


def run(codecs: Sequence[str], cases: Sequence[Case], workers: Workers, show: Progress = silent) -> Iterator[Stress]:
    """A record for each codec and case, as workers finish.

    The cases of data, each of which is a fit, are one task of a codec; its other cases, which share one fit, another.
    """
    names = {case.name for case in cases}
    wanted = [case for case in CASES if case.name in names]
    of_data = [case.name for case in wanted if case.group == "data"]
    others = [case.name for case in wanted if case.group != "data"]
    tasks: list[tuple[str, list[str]]] = []
    for group in (of_data, others):  # the longer ones first
        if group:
            tasks += [(codec, group) for codec in codecs]
    show("stress", 0, len(tasks))
    for ended, future in enumerate(_as_they_end(tasks, workers), 1):
        yield from future.result()
        show("stress", ended, len(tasks))


def _as_they_end(tasks: list[tuple[str, list[str]]], workers: Workers) -> Iterator[Future[list[Stress]]]:
    """The records of each task, a codec and some cases, as workers finish."""
    waiting: set[Future[list[Stress]]] = set()
    for codec, names in tasks:
        waiting.add(workers.executor.submit(attempt, codec, names))  # waits for a free worker
        ended = {future for future in waiting if future.done()}
        waiting -= ended
        yield from ended
    yield from as_completed(waiting)


def attempt(codec: str, names: Sequence[str]) -> list[Stress]:
    """The records of some cases of one codec, in a folder of their own; their log is not shown."""
    kind = load_codec(codec)
    before = logging.root.manager.disable
    logging.disable(logging.WARNING)  # cases provoke warnings, which the caller's terminal should not show
    try:
        with tempfile.TemporaryDirectory() as folder:
            subject = subject_of(kind, Path(folder))
            of_codec = []
            for order, case in enumerate(CASES):  # the place in the catalogue, by which reports sort
                if case.name in names:
                    record = _record(codec, case, judge(case, subject))
                    of_codec.append(cast(Stress, {**record, "version": kind.version, "order": order}))
            return of_codec
    finally:
        logging.disable(before)


def picture_records() -> Iterator[Stress]:
    """A record for each metric or loss and each pair of pictures."""
    for name, test in metrics.subjects().items():
        for order, case in enumerate(metrics.CASES, len(CASES)):
            yield {**_record(name, case, metrics.judge(test, case)), "order": order}


def _record(subject: str, case: Case | metrics.PictureCase, verdict: CaseVerdict) -> Stress:
    """A line of `records.jsonl`; `subject` is a codec or, in the group `pictures`, a metric or a loss."""
    about = {"kind": "stress", "subject": subject, "group": case.group, "extreme": case.name, "holds": case.holds}
    return cast(Stress, about | dataclasses.asdict(verdict))
