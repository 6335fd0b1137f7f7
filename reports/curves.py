"""Tables of curves of quality over bytes: against one codec, by three metrics, and by footprint.

A *rung* is one measured setting of a codec; a *line* is a codec, or a codec as its paper publishes it. The *curve* of a
line on a *surface* (a material) joins its rungs on the upper convex hull of quality over bytes: the hull is that of
validation pairs, the values shown are of test pairs. `AGAINST` names the line that others are compared with.
Differences of curves are Bjøntegaard's, from video coding. `bench.compare.choosing.curves` computes all numbers.

A *footprint* is the side of the square of texels that a pixel covers.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from statistics import median

from bench.compare.choosing.budgets import Budgets, budgets
from bench.compare.choosing.curves import (
    FEWEST,
    LEAST_RUNGS,
    Point,
    Points,
    Summary,
    curve_of,
    differences,
    hulls,
    mean_at,
    summarised,
)
from bench.compare.paired import AGAINST
from bench.compare.statistics import average, bd_rate
from bench.metrics import direction_of
from bench.records import FLIP, MOST_DB, PSNR, SSIM, Run, by_kind
from reports.numbers import NONE, fixed, signed
from reports.table import Table, best_cells

FOOTPRINTS = ("1", "2", "4", "8")  # texels a side of a pixel, as records name them
AGREE_AT = 32  # bits a texel at which three metrics are set beside each other
_NEVER = "∞"  # a BD-rate: no number of bytes is enough
_DIGITS = {PSNR: 1, SSIM: 3, FLIP: 3}  # decimals in cells, by metric


def curves_tables(run: Run) -> Iterator[Table]:
    """The tables of curves: differences to `AGAINST`, three metrics at one size, and PSNR by footprint at that size.

    PSNR at several sizes stands in `table budgets`.
    """
    result = budgets(run)
    points = hulls(result, result.surfaces)
    if not points:  # no line has enough rungs for a curve
        return
    kinds = by_kind(result.surfaces)
    tables = []
    if AGAINST in points:
        tables.append(_differences(points, kinds))
    tables += [_metrics(points, list(result.surfaces)), _footprints(points, list(result.surfaces))]
    with_rows = [table for table in tables if table.rows]
    if with_rows:  # notes on all of them stand once, below the last
        with_rows[-1].notes.extend(_notes(result))
    yield from with_rows


def _differences(points: Points, kinds: Mapping[str, Sequence[str]]) -> Table:
    """A row a codec: BD-PSNR by kind of surface and over all, with its interval, and BD-rate.

    `kinds` maps a kind of surface, such as measured, to the names of its surfaces.
    """
    # First the numbers of each line.
    anchor = points[AGAINST]  # the curves that all others are compared with
    summaries: dict[str, Summary] = {}
    kind_means: dict[str, list[float | None]] = {}  # by line, in the order of the kinds
    rates: dict[str, float | None] = {}  # by line: BD-rate as a share; None where no common values are reached
    for line, by_surface in points.items():
        gaps = differences(by_surface, anchor)  # by surface: the gap in dB, then those of draws of seeds
        if line == AGAINST or not gaps:  # without gaps, it shares no range of bytes with the other on any surface
            continue
        summaries[line] = summarised(gaps)
        rates[line] = _median_rate(by_surface, anchor)
        kind_means[line] = []
        for names in kinds.values():
            # A mean over fewer surfaces than the header says would not compare with the others.
            every_gap = [gaps[name][0] for name in names] if gaps.keys() >= set(names) else []
            kind_means[line].append(average(every_gap))

    # Then a row for each line. `scores` has a number for each cell, by which the best of a column is marked.
    rows: list[list[str]] = []
    scores: list[list[float | None]] = []
    for line in sorted(summaries, key=lambda line: -summaries[line].median):  # the best first
        summary = summaries[line]
        interval = f"{_signed(summary.low)} to {_signed(summary.high)}"
        if summary.apart:
            interval += "*"
        rate = rates[line]
        # Cells and their scores, column by column; a score of None is not compared.
        cells = [line, *map(_signed, kind_means[line])]
        values = [None, *kind_means[line]]
        cells += [_signed(summary.median), _signed(summary.mean), interval]
        values += [summary.median, summary.mean, None]
        cells += [f"{summary.won} of {summary.surfaces}", _rate_cell(rate)]
        values += [summary.won, None if rate is None else -rate]  # fewer bytes are better
        rows.append(cells)
        scores.append(values)
    headers = [("codec", "")]
    headers += [(f"{kind}, {len(names)}", "dB ↑") for kind, names in kinds.items()]
    headers += [("median", "dB ↑"), ("mean", "dB ↑"), ("95 % interval", "of the mean"), ("ahead", "on ↑")]
    headers += [("BD-rate", "median ↓")]
    if any(summary.surfaces >= FEWEST for summary in summaries.values()):
        told_apart = f"*: told apart: at least {FEWEST} surfaces, and an interval without 0."
    else:
        told_apart = f"None is told apart: that takes {FEWEST} surfaces."
    notes = [
        "BD-PSNR: the mean gap in dB at equal bytes, over the bytes that both codecs reach. BD-rate: the mean gap in "
        f"bytes at equal dB; less than 0 takes fewer bytes; {_NEVER}: on half of the surfaces or more, no file of the "
        f"codec is as good as the smallest of {AGAINST}. {told_apart}"
    ]
    title = f"Curves against {AGAINST}: Bjøntegaard's differences, test PSNR"
    return Table("curves", title, headers, rows, notes, marks=best_cells(rows, scores))


def _median_rate(points: Mapping[str, Sequence[Point]], anchor: Mapping[str, Sequence[Point]]) -> float | None:
    """The median of BD-rate over the surfaces where both lines have curves; None if there are none.

    Both lines are given as the points of their curves by surface. The rate is a share: −0.1 is 10 % fewer bytes. A
    surface on which one line is above all that the other reaches counts with −1 or infinity, and not at all if both
    lines are level there, at what a display shows.
    """
    rates = []
    # Only surfaces where both have a curve; the order does not matter to a median.
    for surface in points.keys() & anchor.keys():
        ours = curve_of(points[surface])
        theirs = curve_of(anchor[surface])
        if not ours or not theirs:  # too few points for a curve
            continue
        rate = bd_rate(ours, theirs)
        if rate is not None:
            rates.append(rate)
    return median(rates) if rates else None


def _rate_cell(rate: float | None) -> str:
    """A BD-rate, a share, as a cell in per cent."""
    if rate is None:
        return NONE
    if math.isinf(rate):
        return _NEVER
    return f"{signed(100 * rate, 0)} %"


def _metrics(points: Points, surfaces: Sequence[str]) -> Table:
    """A row a codec: three metrics at one size, `AGREE_AT`, each with the codec's place by it.

    So a reader sees whether the metrics agree on the order. Codecs that lack a metric, or whose curves do not reach
    that size on each surface, are left out: places among different codecs would not compare.
    """
    families = (PSNR, SSIM, FLIP)
    values: dict[str, dict[str, float]] = {}  # by line and family
    for line, by_surface in points.items():
        values_of_line: dict[str, float] = {}
        for family in families:
            mean = mean_at(by_surface, surfaces, AGREE_AT, family)
            if mean is not None:
                values_of_line[family] = mean
        if len(values_of_line) == len(families):
            values[line] = values_of_line
    places: dict[str, dict[str, int]] = {}  # by family and line; 1 is the best
    for family in families:
        higher_is_better = direction_of(family) == "higher"
        best_first = sorted(values, key=lambda line: values[line][family], reverse=higher_is_better)
        places[family] = {line: place for place, line in enumerate(best_first, 1)}
    rows = []
    for line in places[PSNR]:  # the best PSNR first
        cells = [f"{fixed(values[line][family], _DIGITS[family])} ({places[family][line]})" for family in families]
        rows.append([line, *cells])
    headers = [("codec", ""), ("PSNR", "dB ↑"), ("SSIM", "↑"), ("FLIP", "↓")]
    title = f"Curves at {AGREE_AT} bits a texel on {len(surfaces)} surfaces: three metrics, and the place by each"
    return Table("curves", title, headers, rows, [])


def _footprints(points: Points, surfaces: Sequence[str]) -> Table:
    """A row a codec: PSNR at one size, a column a footprint. From further away a pixel covers more texels a side."""
    # By line: its PSNR in dB in the order of `FOOTPRINTS`. Lines that lack one of them are left out.
    decibels: dict[str, list[float]] = {}
    for line, by_surface in points.items():
        means = [mean_at(by_surface, surfaces, AGREE_AT, footprint=side) for side in FOOTPRINTS]
        values = [value for value in means if value is not None]
        if len(values) == len(FOOTPRINTS):
            decibels[line] = values
    rows: list[list[str]] = []
    scores: list[list[float | None]] = []
    for line in sorted(decibels, key=lambda line: -decibels[line][-1]):  # the best at the largest footprint first
        rows.append([line, *(fixed(value, _DIGITS[PSNR]) for value in decibels[line])])
        scores.append([None, *decibels[line]])
    headers = [("codec", "")]
    for side in FOOTPRINTS:
        headers.append(("1 texel" if side == "1" else f"{side} texels", "dB ↑"))
    title = f"Curves at {AGREE_AT} bits a texel on {len(surfaces)} surfaces: PSNR by footprint"
    note = (
        "Footprint: texels a side of a pixel. The truth is averaged over it; a codec without levels of detail aliases."
    )
    return Table("curves", title, headers, rows, [note], marks=best_cells(rows, scores))


def _signed(value: float | None) -> str:
    """A difference in dB as a cell, with its sign; a dash for None."""
    return NONE if value is None else signed(value, _DIGITS[PSNR])


def _notes(result: Budgets) -> list[str]:
    """The notes below the last table: what is read off, what a dash means, and how many jobs are left out.

    `result.unlike` are jobs that cannot be compared with the others, because they were measured on other data, for
    example.
    """
    reach = f"{NONE}: a curve does not reach that size on each surface, or has fewer than {LEAST_RUNGS} rungs there."
    cap = f"A slice counts at most {MOST_DB} dB, an error of one step of an 8-bit display."
    notes = [f"Read off the hull of rungs that validation pairs leave (docs/metrics.md, “Curves”). {reach} {cap}"]
    if result.unlike:
        notes.append(f"Left out: {len(result.unlike)} jobs that are not comparable.")
    return notes
