"""The tables of curves of quality over bytes: differences to `AGAINST`, metrics, footprints, bytes in memory."""

from collections.abc import Callable, Iterator
from math import isinf, isnan, nan
from statistics import median

import pandas as pd

from bench.compare.paired import AGAINST
from bench.compare.statistics import bd_rate
from bench.records import Run
from reports.numbers import NONE, fixed, signed
from reports.of_rungs import CAP, CODEC, METRICS, Parts, interval_cell, lead_cell, of_leads, stale_of, won_cell
from reports.rungs import ENOUGH, FOOTPRINTS, LEAST_RUNGS, LEAST_SURFACES, Rungs, median_over, rungs_of
from reports.table import Table
from reports.values import Column, Row, written

MEMORY = 256  # bits a texel of a decoder in memory, at which codecs are compared
_NEVER = "∞"  # a BD-rate: no number of bytes is enough


def curves_tables(run: Run) -> Iterator[Table]:
    """The tables of curves: differences to `AGAINST`, three metrics and PSNR by footprint at one size, bytes in memory.

    PSNR at several sizes stands in `table budgets`.
    """
    rungs = rungs_of(run)
    made = []
    if AGAINST in rungs.hulls:
        made.append(_differences(rungs))
    made += [_three_metrics(rungs), _footprints(rungs), _in_memory(rungs)]
    with_rows = [parts for parts in made if not parts.values.empty]
    if with_rows:  # notes on all of them stand once, below the last
        last_notes = with_rows[-1].notes
        reach = (
            f"{NONE}: a curve does not reach that size on each surface, or has fewer than {LEAST_RUNGS} rungs there."
        )
        last_notes.append(
            f"Read off the hull of rungs that validation pairs leave (docs/metrics.md, “Curves”). {reach} {CAP}"
        )
        if rungs.unlike:
            last_notes.append(f"Left out: {len(rungs.unlike)} jobs that are not comparable.")
    for title, values, columns, notes in with_rows:
        values["codec"] = values.index
        values["stale"] = stale_of(rungs, values.index)
        yield written("curves", title, values, [CODEC, *columns], notes)


def _differences(rungs: Rungs) -> Parts:
    """A row a codec: BD-PSNR by kind of surface and over all, each with its interval, and BD-rate."""
    lines = [line for line in rungs.hulls if line != AGAINST]
    values = of_leads({line: rungs.lead(line) for line in lines})
    for kind, surfaces in rungs.kinds.items():
        of_kind = of_leads({line: rungs.lead(line, surfaces) for line in values.index})
        of_kind = of_kind[of_kind["surfaces"] == len(surfaces)]  # a median over fewer surfaces would not compare
        values[[kind, f"{kind} low", f"{kind} high"]] = of_kind[["median", "low", "high"]].reindex(values.index)
    values["rate"] = [100 * _median_rate(rungs, line) for line in values.index]
    values = values.sort_values("median", ascending=False, kind="stable")
    told = f"None is told apart: that takes {LEAST_SURFACES} surfaces."
    if (values["surfaces"] >= LEAST_SURFACES).any():
        told = f"*: told apart: at least {LEAST_SURFACES} surfaces, and an interval without 0."
    notes = [
        "BD-PSNR: the mean gap in dB at equal bytes, over the bytes that both codecs reach. BD-rate: the mean gap in "
        f"bytes at equal dB; less than 0 takes fewer bytes; {_NEVER}: on half of the surfaces or more, no file of the "
        f"codec is as good as the smallest of {AGAINST}. {told}"
    ]
    columns = []
    for kind, on in rungs.kinds.items():
        columns.append(Column(f"{kind}, {len(on)}", "dB ↑", kind, write=_with_interval(kind, len(on) == 1)))
    columns += [
        Column("all", "dB ↑", "median", signed=True),
        Column("95 % interval", "of the median", "median", write=interval_cell),
        Column("ahead", "on ↑", "won", 0, write=won_cell),
        Column("BD-rate", "median ↓", "rate", 0, signed=True, write=_rate),
    ]
    return Parts(f"Curves against {AGAINST}: Bjøntegaard's differences, test PSNR", values, columns, notes)


def _with_interval(kind: str, single: bool) -> Callable[[Row], str]:
    """A function that writes the lead of a row on surfaces of a kind, or on a single one, with its interval."""

    def write(row: Row) -> str:
        """The lead and its interval: “+0.5 (+0.2 to +1.1)”; a dash without a lead. One surface and one seed do not tell
        what scatters, so there is no interval."""
        if isnan(row[kind]):
            return NONE
        lead, low, high = row[kind], row[f"{kind} low"], row[f"{kind} high"]
        if single and low == high:
            return signed(lead, 1)
        return f"{signed(lead, 1)} ({signed(low, 1)} to {signed(high, 1)})"

    return write


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


def _rate(row: Row) -> str:
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
        Column("PSNR", "dB ↑", "psnr", ranked=False, write=_with_place("psnr", 1)),
        Column("SSIM", "↑", "ssim", ranked=False, write=_with_place("ssim", 3)),
        Column("FLIP", "↓", "flip", ranked=False, write=_with_place("flip", 3)),
    ]
    return Parts(f"Curves {_where(rungs)}: three metrics, and the place by each", values, columns, [])


def _with_place(field: str, digits: int) -> Callable[[Row], str]:
    """A function that writes a number of the field with the place by it."""
    return lambda row: f"{fixed(row[field], digits)} ({row[f'{field} place']:.0f})"


def _footprints(rungs: Rungs) -> Parts:
    """A row a codec: PSNR at one size, a column a footprint. From further away a pixel covers more texels a side."""
    values = pd.DataFrame({side: median_over(rungs.read(ENOUGH.most, side)) for side in FOOTPRINTS}).dropna()
    values = values.sort_values(FOOTPRINTS[-1], ascending=False, kind="stable")
    columns = [Column("1 texel" if side == "1" else f"{side} texels", "dB ↑", side) for side in FOOTPRINTS]
    note = (
        "Footprint: texels a side of a pixel. The truth is averaged over it; a codec without levels of detail aliases."
    )
    return Parts(f"Curves {_where(rungs)}: PSNR by footprint", values, columns, [note])


def _where(rungs: Rungs) -> str:
    """The size and the number of surfaces, in words."""
    count = len(rungs.surfaces)
    return f"at {ENOUGH.most} bits a texel on {count} surface{'s' if count > 1 else ''}"


def _in_memory(rungs: Rungs) -> Parts:
    """A row a codec: PSNR by kind of surface, at one size in memory in place of one in the file, and the lead there."""
    resident = rungs.over_memory()
    values = pd.DataFrame({kind: median_over(resident.read(MEMORY)[on]) for kind, on in rungs.kinds.items()})
    values = values.dropna(how="all")
    values = values.join(of_leads({line: resident.lead(line) for line in values.index}))
    values["single"] = False
    values = values.sort_values([*rungs.kinds], ascending=False, kind="stable")
    columns = [
        *(Column(f"{kind}, {len(on)}", "dB ↑", kind) for kind, on in rungs.kinds.items()),
        Column("lead", "dB ↑", "median", signed=True, write=lead_cell),
        Column("95 % interval", "of the lead", "median", write=interval_cell),
    ]
    note = (
        "In memory: textures, tables and networks as this suite's decoders hold them to be asked, in float32. "
        f"A renderer may hold them in fewer bits. Lead: over {AGAINST} at equal bytes in memory."
    )
    return Parts(f"Curves over bytes in memory: test PSNR at {MEMORY} bits a texel", values, columns, [note])
