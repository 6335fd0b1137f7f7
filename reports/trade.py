"""Writes the results of `neubtf-bench trade`, timings among the records of a run, as tables.

One choice of each material is the floor, which has times alone. *ratio_to_floor* is a time as a multiple of it. A
*ceiling* is a measured rate of the machine, of arithmetic or of copying. The *limit* of a choice is its least time by
these. A choice is *on the front* of speed (or of rate) if no other is at least as good in both PSNR and time (or
bytes), and better in one.
"""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from itertools import chain
from math import inf, nan
from operator import itemgetter
from typing import Any

import pandas as pd

from bench.compare.choosing import best_choices_in_words, is_plain, name_of_choice, on_front
from bench.records import Run, Timing, conditions_in_words, counted, grouped
from reports.numbers import NONE
from reports.rows import MaterialRows
from reports.table import Table
from reports.values import Column, written


def trade_tables(run: Run, materials: Iterable[MaterialRows], whole: bool = False) -> Iterator[Table]:
    """The choices of each material that are on a front; none if no trade was measured. With `whole` all choices,
    their stability, and the ceilings last."""
    rows_of_run = chain.from_iterable(each.rows for each in materials)
    older = {row.job["job"] for row in rows_of_run if row.values["stale"]}
    by_device = grouped(run.choices, itemgetter("material", "device"))
    has_several_devices = len({device for _, device in by_device}) > 1
    for (material, device), choices in by_device.items():
        rows = sorted(choices, key=lambda row: "of" not in row)  # the floor last
        where = f", on {device}" if has_several_devices else ""
        yield _choices_table(material, where, rows, older, whole)
        if whole and any("from_float32" in row for row in rows):  # else there is no other execution to compare
            yield _stability_table(material, where, rows, older)
    floors = [row for row in run.choices if "of" not in row]
    if floors and whole:
        yield _ceilings_table(floors)


_COLUMNS = [
    Column("choice", "", "codec"),
    Column("PSNR", "dB ↑", "psnr", 2, ranked=False),
    Column("worst", "slice, dB ↑", "worst", 2, ranked=False),
    Column("FLIP", "↓", "flip", 3, ranked=False),
    Column("total", "bytes ↓", "bytes", 0, ranked=False),
    Column("time", "ns ↓", "ns_per_sample", -3, ranked=False),
    Column("time", "× floor", "ratio_to_floor", -3),
    Column("95 % interval", "× floor", "low", -3, beside="high", pair=" to {}"),
    Column("of the", "limit, %", "of limit", 1, after=(" *", "above limit")),
    Column("on the front", "of", "fronts"),
]
# Only where noise was measured: samples to equal noise, then seconds to equal error, each for light directions by the
# cosine and from lobes.
_NOISE = [
    Column("1 % noise", "samples, cosine ↓", "samples, cosine", -3, ranked=False),
    Column("1 % noise", "samples, lobes ↓", "samples, lobes", -3, ranked=False),
    Column("equal error", "s, cosine ↓", "seconds, cosine", -3, ranked=False),
    Column("equal error", "s, lobes ↓", "seconds, lobes", -3, ranked=False),
]
_EXACT = ("psnr", "worst")  # None in a record: no slice, or not that one, has an error
_NUMBERS = ("psnr", "worst", "flip", "bytes", "ns_per_sample", "ratio_to_floor", "limit_ns")
_ABOVE = (
    "* A share above 100 %: the machine was disturbed while its ceilings were measured, or the data stay in a cache, "
    "which reads faster than the copy that sets the ceiling."
)


def _choices_table(material: str, where: str, rows: list[Timing], older: Collection[str], whole: bool) -> Table:
    """A row a choice: quality, bytes, time, and the noise of a path tracer where it was measured.

    Without `whole`, choices on no front are left out; those of `older` jobs are stale. The first notes say which
    choices are the best and the fastest. `where` ends the title, to tell devices apart.
    """
    measured = [row for row in rows if "of" in row and "error" not in row]
    fronts = {"speed": on_front(measured, "ns_per_sample"), "rate": on_front(measured, "bytes")}
    beaten = {row["job"] for row in measured} - fronts["speed"] - fronts["rate"]
    notes = list(best_choices_in_words(rows, material))
    if beaten and not whole:
        notes.append(
            f"Left out, because others beat them at these pairs: {len(beaten)} choices. --all shows them, too."
        )
    shown = [row for row in rows if whole or row.get("job") not in beaten]
    values = pd.DataFrame([_values_of_choice(row, fronts) | {"stale": row.get("of") in older} for row in shown])
    notes.append(_note_on_conditions(shown))
    notes += [f"{name_of_choice(row)}: {row['error']}." for row in shown if "error" in row]  # why it could not be timed
    if values["above limit"].any():
        notes.append(_ABOVE)
    columns = [*_COLUMNS]
    if any("noise" in row or "noise_error" in row for row in shown):
        columns += _NOISE
        notes += _noise_notes(shown)
    title = f"{material}: gains and losses of each setting{where}"
    return written("trade", title, values, columns, notes, material=material)


def _values_of_choice(row: Timing, fronts: Mapping[str, set[str]]) -> dict[str, Any]:
    """The values of a choice; the floor has times alone, and one whose time cannot be measured its quality and bytes.

    NaN stands for what there is not, infinity for the PSNR of an exact slice.
    """
    values: dict[str, Any] = {"codec": name_of_choice(row), "of limit": nan, "above limit": False, "fronts": NONE}
    # A choice that failed before it was scored has no number to show.
    stored: Mapping[str, Any] = row if "psnr" in row or "error" not in row else {}
    for name in _NUMBERS:
        values[name] = stored.get(name, nan)
        if values[name] is None:
            values[name] = inf if name in _EXACT else nan
    values["low"], values["high"] = row.get("ratio_interval95", (nan, nan))
    if "bytes" in row and "error" not in row:  # not the floor
        of_limit = row["limit_ns"] / row["ns_per_sample"]
        values["of limit"], values["above limit"] = 100 * of_limit, of_limit > 1
        values["fronts"] = ", ".join(word for word, names in fronts.items() if row["job"] in names) or NONE
    noise = row.get("noise", {"samples": (nan, nan), "seconds": (nan, nan)})
    for quantity in ("samples", "seconds"):
        values[f"{quantity}, cosine"], values[f"{quantity}, lobes"] = noise[quantity]
    return values


def _noise_notes(rows: Sequence[Timing]) -> Iterator[str]:
    """Notes on the noise of a path tracer: what its columns mean, and why a choice has none."""
    for scene in dict.fromkeys(row["noise"]["scene"] for row in rows if "noise" in row):
        yield (
            f"1 % noise: samples a pixel in a picture by Mitsuba ({scene}), light directions drawn by the cosine, and "
            "from lobes fitted to the file. Equal error: the processor's seconds for these samples. See docs/trade.md."
        )
    for row in rows:
        if "noise_error" in row:
            yield f"{name_of_choice(row)}: noise was not measured: {row['noise_error']}."


def _note_on_conditions(rows: Sequence[Timing]) -> str:
    """A note on quality and times, with the conditions of the first choice that was timed."""
    timed = next((row for row in rows if "ns_per_sample" in row), None)
    if timed is None:
        return "Nothing could be timed."
    conditions = conditions_in_words(timed, variant="eager float32 unless a row says otherwise")
    return (
        "Quality: held-out pairs, or all if none are held out, from the file. Time: a whole query of random samples, "
        f"in turns with all others, on {conditions}. Floor: one bilinear fetch of a colour. Limit: by this machine's "
        "measured rates."
    )


def _stability_table(material: str, where: str, rows: Sequence[Timing], older: Collection[str]) -> Table:
    """A row for each choice of another execution or precision than eager float32: its time, and how far its answers are
    from those of eager float32 with the same label. `rows` are all choices of the material, `older` the names of
    stale jobs; `where` is as for `_choices_table`."""
    plain = [row for row in rows if is_plain(row) and "psnr" in row]
    psnr_of_plain = {row["label"]: counted(row["psnr"]) for row in plain}
    values = []
    for row in rows:
        if "from_float32" in row:  # PSNR in dB, None without any difference
            worst = inf if row["from_float32"] is None else row["from_float32"]
            # Without that of eager float32 its slices could not be read.
            gained = counted(row["psnr"]) - psnr_of_plain.get(row["label"], nan)
            numbers = {"time": row["ratio_to_floor"], "worst": worst, "gained": gained, "flip": row.get("flip")}
            values.append({"codec": name_of_choice(row), **numbers, "stale": row.get("of") in older})
    note = (
        "Worst slice: PSNR of the slice, of the same pairs, that differs most from the answers of eager float32. "
        "Gained: of the mean PSNR against the truth."
    )
    title = f"{material}: stability of executions and precisions{where}"
    columns = [Column("choice", "", "codec"), Column("time", "× floor", "time", -3)]
    columns += [Column("worst slice", "from float32, dB ↑", "worst", ranked=False)]
    columns += [Column("gained", "dB", "gained", 2, signed=True), Column("FLIP", "↓", "flip", 3, ranked=False)]
    return written("trade", title, pd.DataFrame(values), columns, [note], material=material)


def _ceilings_table(floors: Sequence[Timing]) -> Table:
    """A row for each device, number of threads and type of numbers, as measured last with a floor; a note names the
    variants that were left out."""
    ceilings = chain.from_iterable(floor["ceilings"] for floor in floors)
    last_of = {(ceiling["device"], ceiling["threads"], ceiling["dtype"]): ceiling for ceiling in ceilings}
    left_out = floors[-1].get("left_out", [])
    columns = [Column("device", "", "device"), Column("threads", "", "threads", 0), Column("numbers", "", "dtype")]
    # A flop a ns is a Gflop/s, and a byte a ns is a GB/s.
    columns += [Column("multiply-add", "Gflop/s", "flops_per_ns", -3), Column("copy", "GB/s", "bytes_per_ns", -3)]
    note = (
        f"Left out, because this processor only emulates their precision: {', '.join(left_out)}. "
        "`neubtf-bench trade --emulated` measures them too."
    )
    notes = [note] if left_out else []
    title = "ceilings: measured rates of this machine"
    return written("trade", title, pd.DataFrame([*last_of.values()]), columns, notes)
