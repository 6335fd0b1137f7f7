"""The tables of a board that a run's page does not have: where rows come from, and where a codec stands.

A codec's *place* is one comparison: its best entry against that of the others. For the other words of a board see
`reports.board.sources`.
"""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from operator import attrgetter
from statistics import fmean
from typing import Any, NamedTuple

import pandas as pd

from bench.records import codec_of
from reports import by_material
from reports.board.sources import STATES, Publication
from reports.numbers import EXACT, NONE, fixed, integer, signed
from reports.of_rungs import in_words
from reports.rows import CodecRows, MaterialRows, Row
from reports.rungs import BYTES, rungs_of
from reports.table import Table

# Of where a row is from: whose word it is, seed, hash of the codec file, revisions of the code, machine, and day.
_ORIGIN_WORDS = ("state", "seed", "file", "fitted by", "scored by", "processor", "scored on")
_ORIGIN_HEADERS = [(words, "") for words in _ORIGIN_WORDS]


class Entry(NamedTuple):
    """A setting of a codec in a comparison."""

    codec: str  # its name
    label: str  # the codec with its settings or, with budgets, the line
    size: int  # bytes of the file, a mean over seeds
    psnr: float  # of test pairs, in dB; infinite if exact


class Comparison(NamedTuple):
    """The entries of one source on one material, and at one budget if the source has budgets."""

    material: str
    results: str  # see `Place`
    entries: list[Entry]


@dataclass(frozen=True)
class Place:
    """A codec against the best of the other codecs on a material, each by the entry of one of its settings."""

    material: str
    results: str  # the name of its source and, if a budget chose the entries, the budget in words
    mine: Entry
    best: Entry  # of the others

    @property
    def gap(self) -> float:
        """By how many dB the codec is better, below 0 where it is worse. It is infinite where one is exact, and 0 where
        both are, because infinity less infinity is no number."""
        if self.mine.psnr == self.best.psnr:
            return 0.0
        return self.mine.psnr - self.best.psnr


def origins(source: Publication, material: MaterialRows, name: str) -> Table:
    """Where each row of a material is from: whose word, seed, hash, revisions, processor.

    `name` is that of the material on the page.
    """
    rows = [[row.label, *_origin_cells(source, row)] for row in material.rows]
    headers = [("codec", ""), *_ORIGIN_HEADERS]
    return Table("origins", f"{name}: where each row is from", headers, rows, [STATES], material=name)


def _origin_cells(source: Publication, row: Row) -> list[str]:
    """The cells below `_ORIGIN_HEADERS`; a dash where the record does not say."""
    job = row.job
    # A record may lack these fields, or hold null.
    fitted = job.get("fitted") or {}
    scored = job.get("scored") or {}
    machine = job.get("machine") or {}
    digest = str(job.get("score_key", {}).get("sha256", ""))[:12]  # the first digits of the hash
    day = str(scored.get("at") or "")[:10]  # of a date and time, 2025-11-23T…
    facts = (
        source.state(job),
        job["seed"],
        digest,
        fitted.get("git"),
        scored.get("git"),
        machine.get("processor"),
        day,
    )
    return [NONE if fact in (None, "") else str(fact) for fact in facts]


def all_rows(name: str, sources: Sequence[Publication]) -> Table | None:
    """Every row of a codec, of every source and material, with its numbers and where they are from; None without any.

    `name` is that of the codec.
    """
    rows = []
    headers_of_numbers: list[tuple[str, str]] = []  # the same of each material
    for source in sources:
        for material in source.materials:
            measures = by_material.in_short(material)
            headers_of_numbers = [(measure.name, measure.unit) for measure in measures]
            of_codec = [row for row in material.rows if codec_of(row.label) == name]
            for row, numbers in zip(of_codec, _number_cells(of_codec, measures), strict=True):
                rows.append([material.name, source.title, row.label, *numbers, *_origin_cells(source, row)])
    if not rows:
        return None
    headers = [("material", ""), ("results", ""), ("row", ""), *headers_of_numbers, *_ORIGIN_HEADERS]
    return Table("rows", f"{name}: every row", headers, rows, [STATES], words=3)


def _number_cells(rows: Sequence[Row], measures: Sequence[by_material.Measure]) -> Iterator[list[str]]:
    """The cells of the measures of each row alone; of one without numbers that may be compared, dashes."""
    alone = [CodecRows(row.label, [row] if row.measured else []) for row in rows]
    values = pd.DataFrame(by_material.rows_of(alone, measures), dtype=object)
    for shown in values.to_dict("records"):
        yield [measure.column(values).cell(shown) for measure in measures]


def places(names: Iterable[str], sources: Sequence[Publication]) -> dict[str, list[Place]]:
    """By name of a codec: where it stands against the best of the others, its best place first.

    Claimed results do not count.
    """
    comparisons: list[Comparison] = []
    for source in sources:
        if source.claimed:  # nobody here has scored them
            continue
        comparisons += _compared_at_budgets(source) if source.has_budgets else _compared_at_any_size(source)
    places_of_codecs = {}
    for name in names:
        of_codec = filter(None, (_place(comparison, name) for comparison in comparisons))
        places_of_codecs[name] = sorted(of_codec, key=attrgetter("gap"), reverse=True)
    return places_of_codecs


def _compared_at_any_size(source: Publication) -> Iterator[Comparison]:
    """The comparison on each material of a source without budgets: of all settings, whatever their bytes."""
    for material in source.materials:
        entries = []
        psnr_of = by_material.psnr_of(material)
        for codec in material.codecs:
            psnr = psnr_of.get(codec.label, math.nan)  # NaN without a number that may be compared
            if not math.isnan(psnr):
                size = round(fmean(row.job["bytes"]["total"] for row in codec.measured))
                entries.append(Entry(codec_of(codec.rows[0].label), codec.label, size, psnr))
        yield Comparison(material.name, source.name, entries)


def _place(comparison: Comparison, name: str) -> Place | None:
    """The best entry of the codec of that name beside the best of the others; None if either is missing."""
    mine = [entry for entry in comparison.entries if entry.codec == name]
    others = [entry for entry in comparison.entries if entry.codec != name]
    if not mine or not others:
        return None
    by_psnr = attrgetter("psnr")
    return Place(comparison.material, comparison.results, max(mine, key=by_psnr), max(others, key=by_psnr))


def _compared_at_budgets(source: Publication) -> Iterator[Comparison]:
    """The comparison on each surface at each budget, by what each line reaches within it at test pairs."""
    rungs = rungs_of(source.run)
    codecs = rungs.codecs
    bits_of_rung = rungs.frame["bits"].tolist()
    for budget in rungs.limits:
        for material in rungs.surfaces:
            height, width = rungs.shapes[material]
            entries = []
            picks: Any = rungs.picks(budget, [material])[material].to_dict()
            psnr_of_line: Any = rungs.reached(budget, [material])[material].to_dict()
            for line, psnr in psnr_of_line.items():
                hull = rungs.hulls.get(line, {}).get(material)
                if budget.kind == BYTES and hull:  # read off the curve: at the budget, or where the curve ends before
                    bits = min(budget.most, 2 ** hull.sizes[-1])
                else:
                    bits = bits_of_rung[picks[line]]
                entries.append(Entry(codecs[line], line, round(bits * height * width / 8), psnr))
            yield Comparison(material, f"{source.name}, {in_words(budget)}", entries)


def standing(name: str, places: Sequence[Place]) -> Table | None:
    """The table of where a codec stands, a row a place; None without any. `name` is that of the codec."""
    rows = []
    for place in places:
        mine, best = place.mine, place.best
        cells = [place.material, place.results, mine.label, best.label]
        cells += [integer(mine.size), integer(best.size), _decibels(mine.psnr), _decibels(best.psnr)]
        rows.append([*cells, _gap_in_words(place.gap)])
    if not rows:
        return None
    headers = [("material", ""), ("results", ""), (name, ""), ("best of the others", "")]
    headers += [
        ("total", "bytes"),
        ("its total", "bytes"),
        ("PSNR", "dB ↑"),
        ("its PSNR", "dB ↑"),
        ("difference", "dB ↑"),
    ]
    note = (
        "Test PSNR, mean over slices. Within a size: read off the curve of the settings that validation pairs choose, "
        "at its end if it ends before; within a time, and without a curve: of the setting that they choose. "
        "Without budgets: of the setting of each codec with the highest test PSNR, whatever its bytes."
    )
    title = "Where it wins and loses, against the best of the others"
    return Table("standing", title, headers, rows, [note], words=4)


def _decibels(psnr: float) -> str:
    """A PSNR as a cell; “exact” where it is infinite."""
    return EXACT if psnr == math.inf else fixed(psnr, 2)


def _gap_in_words(gap: float) -> str:
    """A gap in dB; “exact” where only the codec is, and a dash where only the best of the others is."""
    if math.isfinite(gap):
        return signed(gap)
    return EXACT if gap > 0 else NONE
