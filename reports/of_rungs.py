"""What the tables of rungs share: their columns, the cells of leads, and their notes."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from math import isnan
from typing import NamedTuple

import pandas as pd

from bench.compare.paired import AGAINST
from bench.records import MOST_DB, Job, Machine, Run
from reports.notes import standard_in_words
from reports.numbers import NONE, signed
from reports.rungs import BYTES, EAGER, FIT, LEAST_SURFACES, Budget, Rungs, Summary
from reports.table import Table
from reports.values import Column, Row, written

_NAMED = 5  # rows that a note on excluded records names
CODEC = Column("codec", "", "codec")
METRICS = [Column("PSNR", "dB", "psnr", 2), Column("SSIM", "", "ssim", 3), Column("FLIP", "", "flip", 3)]
CAP = f"A slice counts at most {MOST_DB} dB, an error of one step of an 8-bit display."
READ = (
    f"At a size: test pairs, read off a codec's curve (docs/metrics.md, “Curves”). {NONE}: it does not reach that size "
    f"on each surface. ≥: fewer than three rungs, the best within that size. {CAP}"
)


class Parts(NamedTuple):
    """What `reports.values.written` makes a table of."""

    title: str
    values: pd.DataFrame
    columns: list[Column]
    notes: list[str]


def written_together(kind: str, parts: Sequence[Parts], common: Sequence[str]) -> Iterator[Table]:
    """The tables of a kind; the `common` notes, which are on all of them, stand once, below the last."""
    for number, (title, values, columns, notes) in enumerate(parts, 1):
        yield written(kind, title, values, columns, [*notes, *common] if number == len(parts) else notes)


def frame_of_leads(leads: Mapping[str, Summary | None]) -> pd.DataFrame:
    """The fields of leads, whether they are told apart, and whether they are of `few` surfaces, fewer than others, so
    that they do not compare; by line, without lines that have no lead."""
    rows = {line: {**lead._asdict(), "apart": lead.apart} for line, lead in leads.items() if lead}
    frame = pd.DataFrame.from_dict(rows, orient="index", columns=[*Summary._fields, "apart"])
    return frame.assign(few=frame["surfaces"] < frame["surfaces"].max())


def lead_cell(row: Row) -> str:
    """The lead, with a ° if it comes from single rungs; and on how many surfaces, if others have it on more."""
    if isnan(row["median"]):
        # `AGAINST` has no lead over itself; any other line shares no bytes with it.
        return "" if row["codec"] == AGAINST else NONE
    where = f" on {row['surfaces']:.0f}" if row["few"] else ""
    return signed(row["median"], 1) + ("°" if row["single"] else "") + where


def interval_cell(row: Row) -> str:
    """The interval of a lead, with a star if it tells the two apart; "" without a lead."""
    if isnan(row["median"]):
        return ""
    return f"{signed(row['low'], 1)} to {signed(row['high'], 1)}{'*' if row['apart'] else ''}"


def won_cell(row: Row) -> str:
    """On how many surfaces a line is ahead, and of how many; "" without a lead."""
    return "" if isnan(row["median"]) else f"{row['won']:.0f} of {row['surfaces']:.0f}"


def lead_notes(values: pd.DataFrame) -> Iterator[str]:
    """Notes on the marks beside leads: what ° and * mean, or why no lead is told apart."""
    leads = values[values["median"].notna()]
    if leads["single"].any():
        yield "°: of fewer than three rungs, each at its own bytes."
    if leads["apart"].astype(bool).any():
        yield "*: told apart: the interval leaves out 0."
    elif len(leads):
        few = leads["surfaces"].max() < LEAST_SURFACES
        told = "No lead is told apart from 0"
        yield f"{told}: that takes {LEAST_SURFACES} surfaces." if few else f"{told}."


def why_absent(leader: str) -> str:
    """The end of a sentence: why no line is marked as the best where `leader` has a value on some surfaces alone."""
    return f"{leader} leads on the surfaces where it reaches that size"


def stale_of(rungs: Rungs, lines: Iterable[str], surfaces: Sequence[str] = ()) -> list[bool]:
    """Of each line, whether the installed version cannot make some numbers on these surfaces again; without any, on
    all surfaces."""
    stale = {line for line, surface in rungs.stale if surface in (surfaces or rungs.surfaces)}
    return [line in stale for line in lines]


def in_words(budget: Budget) -> str:
    """A budget in words, such as "64 bits a texel", "8 × floor, eager" or "10 s, fit"."""
    if budget.kind == BYTES:
        return f"{budget.most:g} bits a texel"
    return f"{budget.most:g} {unit_of(budget.kind)}, {budget.kind}"


def unit_of(kind: str) -> str:
    """The unit of a kind of time: seconds of a fit, or multiples of the floor, of a query."""
    return "s" if kind == FIT else "× floor"


def common_notes(run: Run, rungs: Rungs) -> Iterator[str]:
    """Notes common to all tables of budgets: on what machine times were measured, and which jobs are left out."""
    if set(rungs.times) - {FIT}:  # there are times of queries, and not of fits alone
        machines = "; ".join(_machines(run))
        yield f"Times: medians, × floor, one bilinear fetch; {machines}."
    yield from excluded_notes(run, rungs)


def excluded_notes(run: Run, rungs: Rungs) -> Iterator[str]:
    """The note on which jobs are left out, and why; none without such jobs."""
    excluded = []
    if rungs.without:
        excluded.append(f"{_counts_by_suite(run, rungs.without)}, without a score of validation pairs")
    if rungs.unlike:
        rows = list(dict.fromkeys(f"{job['material']}/{job['label']}" for job in rungs.unlike))
        first_rows = ", ".join(rows[:_NAMED])
        if len(rows) > _NAMED:
            first_rows += ", …"
        excluded.append(
            f"{_counts_by_suite(run, rungs.unlike)} ({first_rows}), not comparable with {standard_in_words(run)}"
        )
    if excluded:
        yield f"Left out: {'; '.join(excluded)}."


def untimed_settings(rungs: Rungs) -> list[str]:
    """The settings without a time of a query, of lines that have times of others."""
    timed = rungs.frame.groupby(["line", "label"], sort=False)[EAGER].count() > 0
    line_is_timed = timed.groupby(level="line").transform("any")
    return timed.index[line_is_timed & ~timed].get_level_values("label").tolist()


def _machines(run: Run) -> list[str]:
    """The processors and cores on which times were measured, each once: "AMD EPYC, 8 cores"."""
    timings = run.setting_timings or run.timings  # where settings were timed, budgets use no other times
    return list(dict.fromkeys(_machine_in_words(run.machine(timing)) for timing in timings))


def _machine_in_words(machine: Machine) -> str:
    """A machine as "AMD EPYC, 8 cores", with what is known of it."""
    processor = str(machine.get("processor") or "an unnamed processor")
    return f"{processor}, {machine['cores']} cores" if "cores" in machine else processor


def _counts_by_suite(run: Run, jobs: Sequence[Job]) -> str:
    """How many jobs are of which suite: "3 of budgets, 1 of no suite"."""
    suites = {start.get("run"): str(start.get("suite") or "no suite") for start in run.starts}  # by name of the start
    counts = Counter(suites.get(job.get("run"), "no suite") for job in jobs)
    return ", ".join(f"{count} of {suite}" for suite, count in counts.items())
