"""Compares two stress tests cell by cell, and finds cells that no longer hold or are gone; see `docs/stress.md`."""

from collections.abc import Iterator, Sequence
from fnmatch import fnmatch

from bench.compare.comparison import check_names, check_whole
from bench.inputs.errors import FINE, NO, NOTHING
from bench.records import Record, Run


def changes(base: Run, new: Run, codecs: Sequence[str] = ()) -> Iterator[tuple[str, str]]:
    """Each cell that got worse: its name, `CODEC: EXTREME`, and its new verdict.

    A codec's version does not matter: an extreme that held must still hold.
    """
    after_by_cell = {_cell(record): record for record in new.stress}
    for before in base.stress:
        if before["verdict"] != "pass" or (codecs and before["subject"] not in codecs):
            continue
        name = ": ".join(_cell(before))
        after = after_by_cell.get(_cell(before))
        if after is None:
            yield name, "is gone"
        elif after["verdict"] != "pass":
            yield name, f"held, and is now {after['verdict']}: {after['detail'] or after['figure']}"


def _cell(record: Record) -> tuple[str, str]:
    return record["subject"], record["extreme"]


def report(base: Run, new: Run, codecs: Sequence[str] = (), allow: Sequence[str] = ()) -> tuple[str, int]:
    """The changes as text, and the exit code.

    The code is 1 if a cell that `allow` does not name got worse, 4 if the two have no cell in common. Raises
    `InputError` for a codec that neither has, and for a damaged base.
    """
    check_whole(base)
    subjects = [{record["subject"] for record in run.stress} for run in (base, new)]
    check_names("codec", codecs, set.union(*subjects))
    wanted = set(codecs) or subjects[0]
    ours, theirs = ([record for record in run.stress if record["subject"] in wanted] for run in (base, new))
    if not {_cell(record) for record in ours} & {_cell(record) for record in theirs}:
        return "the two stress tests have no cell in common", NOTHING
    held = sum(record["verdict"] == "pass" for record in theirs)
    worse = [change for change in changes(base, new, codecs) if not any(fnmatch(change[0], name) for name in allow)]
    return "\n".join([*map(" ".join, worse), f"{held} cells hold, {len(worse)} got worse"]), NO if worse else FINE
