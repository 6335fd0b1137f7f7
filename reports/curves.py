"""The tables of curves of quality over bytes: differences to `AGAINST`, metrics, footprints, bytes in memory."""

from collections.abc import Iterator
from functools import partial
from math import isinf, isnan, nan
from statistics import median

import pandas as pd

from bench.compare.paired import AGAINST
from bench.compare.statistics import bd_rate
from bench.records import Run
from reports.numbers import NONE, fixed, signed
from reports.of_rungs import (
    CAP,
    CODEC,
    METRICS,
    Parts,
    excluded_notes,
    frame_of_leads,
    interval_cell,
    lead_cell,
    stale_of,
    won_cell,
    written_together,
)
from reports.rungs import ENOUGH, FOOTPRINTS, LEAST_RUNGS, LEAST_SURFACES, Rungs, median_over, rungs_of
from reports.table import Table
from reports.values import Column, Row

MEMORY = 256  # bits a texel of a decoder in memory, at which codecs are compared
_NEVER = "∞"  # a BD-rate: no number of bytes is enough


def curves_tables(run: Run) -> Iterator[Table]:
    """The tables of curves: differences to `AGAINST`, three metrics and PSNR by footprint at one size, bytes in memory.

    PSNR at several sizes stands in `table budgets`.
    """
    rungs = rungs_of(run)
    makers = [_three_metrics, _by_footprint, _in_memory]
    if AGAINST in rungs.hulls:
        makers.insert(0, _differences_to_against)
    tables = []
    for title, values, columns, notes in (make(rungs) for make in makers):
        if not values.empty:
            named = values.assign(codec=values.index, stale=stale_of(rungs, values.index))
            tables.append(Parts(title, named, [CODEC, *columns], notes))
    common = [
        "Read off the hull of rungs that validation pairs leave (docs/metrics.md, “Curves”). "
        f"{NONE}: a curve does not reach that size on each surface, or has fewer than {LEAST_RUNGS} rungs there. {CAP}"
    ]
    return written_together("curves", tables, [*common, *excluded_notes(run, rungs)])


def _differences_to_against(rungs: Rungs) -> Parts:
    """A row a codec: BD-PSNR by kind of surface and over all, each with its interval, and BD-rate."""
    lines = [line for line in rungs.hulls if line != AGAINST]
    values = frame_of_leads({line: rungs.lead(line) for line in lines})
    for kind, surfaces in rungs.kinds.items():
        leads = frame_of_leads({line: rungs.lead(line, surfaces) for line in values.index})
        on_all = leads[leads["surfaces"] == len(surfaces)]  # a median over fewer surfaces would not compare
        values[[kind, f"{kind} low", f"{kind} high"]] = on_all[["median", "low", "high"]].reindex(values.index)
    values["rate"] = [100 * _median_rate(rungs, line) for line in values.index]
    values = values.sort_values(["few", "median"], ascending=[True, False], kind="stable")
    star = f"None is told apart from 0: that takes {LEAST_SURFACES} surfaces."
    if (values["surfaces"] >= LEAST_SURFACES).any():
        star = f"*: told apart: at least {LEAST_SURFACES} surfaces, and an interval without 0."
    notes = [
        "BD-PSNR: the mean gap in dB at equal bytes, over the bytes that both codecs reach. BD-rate: the mean gap in "
        f"bytes at equal dB; less than 0 takes fewer bytes; {_NEVER}: on half of the surfaces or more, no file of the "
        f"codec is as good as the smallest of {AGAINST}. {star}"
    ]
    columns = []
    for kind, surfaces in rungs.kinds.items():
        write = partial(_lead_with_interval, kind, len(surfaces) == 1)
        columns.append(Column(f"{kind}, {len(surfaces)}", "dB ↑", kind, write=write))
    columns += [
        Column("all", "dB ↑", "median", signed=True, unranked="few"),
        Column("95 % interval", "of the median", "median", write=interval_cell),
        Column("ahead", "on ↑", "won", 0, write=won_cell, unranked="few"),
        Column("BD-rate", "median ↓", "rate", 0, signed=True, write=_rate_cell, unranked="few"),
    ]
    return Parts(f"Curves against {AGAINST}: Bjøntegaard's differences, test PSNR", values, columns, notes)


def _lead_with_interval(kind: str, is_single: bool, row: Row) -> str:
    """The lead on surfaces of a kind, or on a single one, with its interval: “+0.5 (+0.2 to +1.1)”; a dash without a
    lead. One surface and one seed do not tell what scatters, so there is no interval."""
    if isnan(row[kind]):
        return NONE
    lead, low, high = row[kind], row[f"{kind} low"], row[f"{kind} high"]
    if is_single and low == high:
        return signed(lead, 1)
    return f"{signed(lead, 1)} ({signed(low, 1)} to {signed(high, 1)})"


def _median_rate(rungs: Rungs, line: str) -> float:
    """The median of BD-rate over the surfaces where a line and `AGAINST` have curves, as a share; NaN without any.

    A surface on which one line is above all that the other reaches counts with −1 or infinity, and not at all if both
    lines are level there, at what a display shows.
    """
    rates = []
    for surface, hull in rungs.hulls[line].items():
        other_hull = rungs.hulls[AGAINST].get(surface)
        if other_hull is None:
            continue
        ours = rungs.curve(hull)
        theirs = rungs.curve(other_hull)
        rate = bd_rate(ours, theirs) if ours and theirs else None
        if rate is not None:
            rates.append(rate)
    return median(rates) if rates else nan


def _rate_cell(row: Row) -> str:
    """A BD-rate in per cent as a cell."""
    if isnan(row["rate"]):
        return NONE
    return _NEVER if isinf(row["rate"]) else f"{signed(row['rate'], 0)} %"


def _three_metrics(rungs: Rungs) -> Parts:
    """A row a codec: three metrics at one size, `ENOUGH`, each with the codec's place by it.

    So a reader sees whether the metrics agree on the order. Codecs that lack a metric, or whose curves do not reach
    that size on each surface, are left out: places among different codecs would not compare.
    """
    values = pd.DataFrame({each.field: median_over(rungs.read(ENOUGH.most, each.field)) for each in METRICS}).dropna()
    for metric in METRICS:
        values[f"{metric.field} place"] = values[metric.field].rank(ascending=metric.field == "flip", method="first")
    values = values.sort_values("psnr", ascending=False, kind="stable")
    columns = [
        Column("PSNR", "dB ↑", "psnr", ranked=False, write=partial(_with_place, "psnr", 1)),
        Column("SSIM", "↑", "ssim", ranked=False, write=partial(_with_place, "ssim", 3)),
        Column("FLIP", "↓", "flip", ranked=False, write=partial(_with_place, "flip", 3)),
    ]
    return Parts(f"Curves {_size_and_surfaces(rungs)}: three metrics, and the place by each", values, columns, [])


def _with_place(field: str, digits: int, row: Row) -> str:
    """A number of the field, with the place by it: “28.6 (2)”."""
    return f"{fixed(row[field], digits)} ({row[f'{field} place']:.0f})"


def _by_footprint(rungs: Rungs) -> Parts:
    """A row a codec: PSNR at one size, a column a footprint. From further away a pixel covers more texels a side."""
    values = pd.DataFrame({side: median_over(rungs.read(ENOUGH.most, side)) for side in FOOTPRINTS}).dropna()
    values = values.sort_values(FOOTPRINTS[-1], ascending=False, kind="stable")
    columns = [Column("1 texel" if side == "1" else f"{side} texels", "dB ↑", side) for side in FOOTPRINTS]
    note = (
        "Footprint: texels a side of a pixel. The truth is averaged over it; a codec without levels of detail aliases."
    )
    return Parts(f"Curves {_size_and_surfaces(rungs)}: PSNR by footprint", values, columns, [note])


def _size_and_surfaces(rungs: Rungs) -> str:
    """The size and the number of surfaces, in words."""
    count = len(rungs.surfaces)
    return f"at {ENOUGH.most} bits a texel on {count} surface{'s' if count > 1 else ''}"


def _in_memory(rungs: Rungs) -> Parts:
    """A row a codec: PSNR by kind of surface, at one size in memory in place of one in the file, and the lead there."""
    resident = rungs.over_memory()
    psnr = resident.read(MEMORY)
    medians = pd.DataFrame({kind: median_over(psnr[surfaces]) for kind, surfaces in rungs.kinds.items()})
    medians = medians.dropna(how="all")
    values = medians.join(frame_of_leads({line: resident.lead(line) for line in medians.index})).assign(single=False)
    values["few"] = values["few"].eq(True)  # not NaN, as of lines without a lead
    values = values.sort_values([*rungs.kinds], ascending=False, kind="stable")
    columns = [
        *(Column(f"{kind}, {len(surfaces)}", "dB ↑", kind) for kind, surfaces in rungs.kinds.items()),
        Column("lead", "dB ↑", "median", signed=True, write=lead_cell, unranked="few"),
        Column("95 % interval", "of the lead", "median", write=interval_cell),
    ]
    note = (
        "In memory: textures, tables and networks as this suite's decoders hold them to be asked, in float32. "
        f"A renderer may hold them in fewer bits. Lead: over {AGAINST} at equal bytes in memory."
    )
    return Parts(f"Curves over bytes in memory: test PSNR at {MEMORY} bits a texel", values, columns, [note])
