"""Compares two stress tests cell by cell, and finds cells that no longer hold or are gone; see `docs/stress.md`."""

from collections.abc import Sequence
from fnmatch import fnmatch

from bench.compare.comparison import check_names, check_whole
from bench.inputs.errors import FINE, NO, NOTHING
from bench.records import Run


def report(base: Run, new: Run, codecs: Sequence[str] = (), allow: Sequence[str] = ()) -> tuple[str, int]:
    """Each cell that got worse, `CODEC: EXTREME`, with its new verdict, as text; and the exit code.

    A codec's version does not matter: an extreme that held must still hold. The code is 1 if a cell that `allow` does
    not name got worse, 4 if the two have no cell in common. Raises `InputError` for a codec that neither has, and for
    a damaged base.
    """
    check_whole(base)
    subjects = [{record["subject"] for record in run.stress} for run in (base, new)]
    check_names("codec", codecs, set.union(*subjects))
    wanted = set(codecs) or subjects[0]
    ours, theirs = (
        {f"{each['subject']}: {each['extreme']}": each for each in run.stress if each["subject"] in wanted}
        for run in (base, new)
    )
    if not ours.keys() & theirs.keys():
        return "the two stress tests have no cell in common", NOTHING
    held = sum(record["verdict"] == "pass" for record in theirs.values())
    worse = []
    for name, before in ours.items():
        after = theirs.get(name)
        if before["verdict"] != "pass" or any(fnmatch(name, pattern) for pattern in allow):
            continue
        if after is None:
            worse.append(f"{name} is gone")
        elif after["verdict"] != "pass":
            worse.append(f"{name} held, and is now {after['verdict']}: {after['detail'] or after['figure']}")
    return "\n".join([*worse, f"{held} cells hold, {len(worse)} got worse"]), NO if worse else FINE
