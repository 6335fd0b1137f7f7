"""Writes the results of `neubtf-bench trade`, timings among the records of a run, as tables.

A *choice* is a codec with its settings, an *execution* ("eager": PyTorch's operations one by one; "fused": one kernel)
and a precision; one of each material is the *floor*, a bilinear fetch of a colour, which has times alone.
*ratio_to_floor* is a time as a multiple of it. A *ceiling* is a measured rate of the machine, of arithmetic or of
copying. The *limit* of a choice is its least time by these. A
*profile* is the times of the parts of a decoder. A choice is *on the front* of speed (or of rate) if no other is at
least as good in both PSNR and time (or bytes), and better in one. A *slice* is one picture of the material: all texels
at one pair of view and light directions.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from operator import itemgetter
from typing import Any, cast

from bench.compare.choosing import answers, name_of_choice, on_front
from bench.records import Run, Timing, conditions_in_words, grouped
from reports.numbers import EXACT, NONE, fixed, integer, signed, significant
from reports.table import Table
from reports.text import fields_csv


def trade_tables(run: Run) -> Iterator[Table]:
    """Choices and profiles of each material, the ceilings last; none if no trade was measured."""
    profiles_of = grouped(run.profiles, itemgetter("material"))
    for material, rows in grouped(run.choices, itemgetter("material")).items():
        rows.sort(key=lambda row: "of" not in row)  # the floor last
        yield _choices(material, rows, list(answers(material, rows)))
        if any("from_float32" in row for row in rows):  # without other executions there is nothing to compare
            yield _stability(material, rows)
        if material in profiles_of:
            yield _profile(material, profiles_of[material])
    floors = [row for row in run.choices if "of" not in row]
    if floors:
        yield _ceilings(floors)


def choices_csv(run: Run) -> str:
    """As CSV one row a choice, every figure in full precision; "" if no trade was measured."""
    rows = []
    for choice in run.choices:
        fields: dict[str, Any] = {}
        for name, value in choice.items():
            fields[name] = json.dumps(value) if isinstance(value, dict | list) else value  # a cell holds one value
        rows.append(fields)
    return fields_csv(rows) if rows else ""


# The headers of `_choices`, name and unit; those of noise only where it was measured.
_CHOICES = [("choice", ""), ("PSNR", "dB ↑"), ("worst", "slice, dB ↑"), ("FLIP", "↓"), ("total", "bytes ↓")]
_CHOICES += [("time", "ns ↓"), ("time", "× floor"), ("95 % interval", "× floor")]
_CHOICES += [("of the", "limit, %"), ("on the front", "of")]
_NOISE = [("1 % noise", "samples, cosine ↓"), ("1 % noise", "samples, lobes ↓")]
_NOISE += [("equal error", "s, cosine ↓"), ("equal error", "s, lobes ↓")]


_ABOVE = (
    "* A share above 100 %: the machine was disturbed while its ceilings were measured, or the data stay in a cache, "
    "which reads faster than the copy that sets the ceiling."
)


def _choices(material: str, rows: Sequence[Timing], sentences: list[str]) -> Table:
    """A row a choice: quality, bytes, time, and the noise of a path tracer where it was measured.

    `sentences` are about the material, such as which choice is the fastest: they are its first notes.
    """
    has_noise = any("noise" in row or "noise_error" in row for row in rows)
    headers = list(_CHOICES)
    measured = [row for row in rows if "of" in row and "error" not in row]
    fronts = {"speed": on_front(measured, "ns_per_sample"), "rate": on_front(measured, "bytes")}
    cells = [_choice_cells(row, fronts) for row in rows]
    notes = [*sentences, _conditions(rows)]
    notes += [f"{name_of_choice(row)}: {row['error']}." for row in rows if "error" in row]  # why it could not be timed
    if any(row["limit_ns"] > row["ns_per_sample"] for row in measured):
        notes.append(_ABOVE)
    if has_noise:
        headers += _NOISE
        for row, cells_of_row in zip(rows, cells, strict=True):
            cells_of_row += _noise_cells(row)
        notes += _noise_notes(rows)
    title = f"{material}: gains and losses of each setting"
    jobs = [[row.get("job", "")] for row in rows]
    return Table("trade", title, headers, cells, notes, material=material, jobs=jobs)


def _noise_cells(row: Timing) -> list[str]:
    """The cells below `_NOISE`: samples to equal noise, then seconds to equal error, each for light directions by the
    cosine and from lobes; dashes if noise was not measured."""
    noise = row.get("noise")
    if not noise:
        return [NONE] * len(_NOISE)
    return [significant(value) for value in (*noise["samples"], *noise["seconds"])]


def _choice_cells(row: Timing, fronts: Mapping[str, set[str]]) -> list[str]:
    """The cells of a choice, in the order of `_CHOICES`; the floor has times alone, and a failed choice dashes.

    A choice whose time cannot be measured has its quality and bytes, and dashes after them.
    """
    if "error" in row:
        known = _quality_cells(row) if "psnr" in row else []
        dashes = [NONE] * (len(_CHOICES) - 1 - len(known))
        return [name_of_choice(row), *known, *dashes]
    time = [significant(row["ns_per_sample"]), significant(row["ratio_to_floor"])]
    time.append(" to ".join(map(significant, row["ratio_interval95"])))
    if "bytes" not in row:  # it is the floor
        return [name_of_choice(row), NONE, NONE, NONE, NONE, *time, NONE, NONE]
    of_limit = row["limit_ns"] / row["ns_per_sample"]
    limit = fixed(100 * of_limit, 1)  # per cent
    if of_limit > 1:
        limit += " *"
    on_fronts = ", ".join(word for word, names in fronts.items() if row["job"] in names)
    return [name_of_choice(row), *_quality_cells(row), *time, limit, on_fronts or NONE]


def _quality_cells(row: Timing) -> list[str]:
    """PSNR, worst slice, FLIP and bytes of a choice that was scored."""
    psnr = row["psnr"]
    mean = fixed(psnr, 2)
    worst = EXACT if row["worst"] is None else fixed(row["worst"], 2)
    return [mean, worst, fixed(row["flip"], 3), integer(row["bytes"])]


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


def _conditions(rows: Sequence[Timing]) -> str:
    """A note on quality and times, with the conditions of the first choice that was timed."""
    timed = next((row for row in rows if "ns_per_sample" in row), None)
    if timed is None:
        return "Nothing could be timed."
    return (
        "Quality: held-out pairs, from the file. Time: a whole query of random samples, in turns with all others, on "
        f"{conditions_in_words(timed, variant='eager float32 unless a row says otherwise')}. Floor: one bilinear "
        "fetch of a colour. Limit: by this machine's measured rates."
    )


def _stability(material: str, rows: Sequence[Timing]) -> Table:
    """A row for each choice of another execution or precision than eager float32: its time, and how far its answers are
    from those of eager float32 with the same label. `rows` are all choices of the material."""
    psnr_of_eager_float32 = {}  # by label
    for row in rows:
        is_eager_float32 = name_of_choice(row) == row["label"]  # only its choices are named by their label alone
        if is_eager_float32 and "psnr" in row:
            psnr_of_eager_float32[row["label"]] = row["psnr"]
    cells = []
    jobs = []
    for row in rows:
        if "from_float32" in row:  # PSNR in dB, None without any difference
            worst = EXACT if row["from_float32"] is None else fixed(row["from_float32"], 1)
            eager_psnr = psnr_of_eager_float32.get(row["label"])  # None if its slices could not be read
            gained = NONE
            if eager_psnr is not None:
                gained = signed(cast(float, row["psnr"]) - eager_psnr)
            time = significant(row["ratio_to_floor"])
            cells.append([name_of_choice(row), time, worst, gained, fixed(row["flip"], 3)])
            jobs.append([row.get("job", "")])
    note = (
        "Worst slice: PSNR of the held-out slice that differs most from the answers of eager float32. Gained: of the "
        "mean PSNR against the truth."
    )
    title = f"{material}: stability of executions and precisions"
    headers = [("choice", ""), ("time", "× floor"), ("worst slice", "from float32, dB ↑")]
    headers += [("gained", "dB"), ("FLIP", "↓")]
    return Table("trade", title, headers, cells, [note], material=material, jobs=jobs)


_CONDITION = ("part", "batch", "coherent", "footprint", "threads")  # fields that tell the rows of a profile apart


def _profile(material: str, records: Sequence[Timing]) -> Table:
    """ns a sample: a row for each condition, the values of the fields `_CONDITION`; a column a codec."""
    codecs = list(dict.fromkeys(record["label"] for record in records))
    records_of_condition = grouped(records, itemgetter(*_CONDITION))
    rows = []
    for (part, batch, coherent, footprint, threads), same_condition in records_of_condition.items():
        queries = "slice" if coherent else "random"
        condition_cells = [part, integer(batch), queries, significant(footprint), str(threads)]
        ns_of_codec = {record["label"]: record["ns_per_sample"] for record in same_condition}
        time_cells = [significant(ns_of_codec.get(codec)) for codec in codecs]
        rows.append([*condition_cells, *time_cells])
    headers = [("part", ""), ("batch", ""), ("queries", ""), ("footprint", "texels"), ("threads", "")]
    headers += [(codec, "ns ↓") for codec in codecs]
    note = (
        "Eager, float32. decoder: its networks alone; evaluate: with the texture's fetch; query: with all checks. "
        "slice: all texels of one pair; random: random places, and directions up to 75°."
    )
    title = f"{material}: time by part, batch, order and threads"
    return Table("trade", title, headers, rows, [note], material=material)


def _ceilings(floors: Sequence[Timing]) -> Table:
    """A row for each device, number of threads and type of numbers, as measured last with a floor; a note names the
    variants that were left out."""
    ceiling_of = {}
    for floor in floors:
        for ceiling in floor["ceilings"]:
            ceiling_of[ceiling["device"], ceiling["threads"], ceiling["dtype"]] = ceiling
    left_out = floors[-1].get("left_out", [])
    headers = [("device", ""), ("threads", ""), ("numbers", ""), ("multiply-add", "Gflop/s"), ("copy", "GB/s")]
    rows = []
    for ceiling in ceiling_of.values():
        # A flop a ns is a Gflop/s, and a byte a ns is a GB/s.
        rates = [significant(ceiling["flops_per_ns"]), significant(ceiling["bytes_per_ns"])]
        rows.append([ceiling["device"], str(ceiling["threads"]), ceiling["dtype"], *rates])
    note = (
        f"Left out, because this processor only emulates their precision: {', '.join(left_out)}. "
        "`neubtf-bench trade --emulated` measures them too."
    )
    notes = [note] if left_out else []
    return Table("trade", "ceilings: measured rates of this machine", headers, rows, notes)
