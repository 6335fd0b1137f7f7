"""The tables of a board that a run's page does not have: where rows come from, and where a codec stands."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from bench.compare.choosing.budgets import budgets, mean_bytes, shown
from bench.records import PSNR
from reports import columns
from reports.board.sources import STATES, Publication
from reports.budgets import in_words
from reports.numbers import EXACT, NONE, fixed, integer, signed
from reports.rows import MaterialRows, Row
from reports.table import Table

_FROM = ("state", "seed", "file", "fitted by", "scored by", "processor", "scored on")
Entry = tuple[str, int, float]  # settings, bytes and test PSNR (dB; infinite if exact)


@dataclass(frozen=True)
class Place:
    """A codec against the best of the others on a material: both at some settings."""

    material: str
    results: str  # the name of its source, and the budget where that chose
    mine: Entry
    best: Entry

    @property
    def gap(self) -> float:
        """By how many dB the codec is better; 0 where both are exact."""
        return 0.0 if self.mine[2] == self.best[2] else self.mine[2] - self.best[2]


def origins(source: Publication, material: MaterialRows, name: str) -> Table:
    """Where each row of a material is from: whose word, seed, hash, revisions, processor."""
    rows = [[row.label, *_from(source, row)] for row in material.rows]
    headers = [("codec", ""), *((header, "") for header in _FROM)]
    return Table("origins", f"{name}: where each row is from", headers, rows, [STATES], material=name)


def _from(source: Publication, row: Row) -> list[str]:
    job = row.job
    scored = job.get("scored") or {}
    texts = [source.state(job), job["seed"], str(job.get("score_key", {}).get("sha256", ""))[:12]]
    texts += [(job.get("fitted") or {}).get("git"), scored.get("git"), (job.get("machine") or {}).get("processor")]
    return [str(NONE if text in (None, "") else text) for text in (*texts, str(scored.get("at") or "")[:10])]


def all_rows(name: str, sources: Sequence[Publication]) -> Table | None:
    """Every row of a codec, of every source and material, with its numbers and where they are from."""
    wanted = [columns.TOTAL, columns.BITS, columns.HELDOUT, *(each for each in columns.time() if not each.sparse)]
    rows = []
    for source in sources:
        for material in source.materials:
            for row in (row for row in material.rows if codec_of(row) == name):
                numbers = [column.cell([row] if row.measured else []) for column in wanted]
                rows.append([material.name, source.title, row.label, *numbers, *_from(source, row)])
    headers = [("material", ""), ("results", ""), ("row", ""), *((each.name, each.unit) for each in wanted)]
    headers += [(header, "") for header in _FROM]
    return Table("rows", f"{name}: every row", headers, rows, [STATES], words=3) if rows else None


def codec_of(row: Row) -> str:
    """The name of a row's codec: a program's is its own."""
    return row.label.split(maxsplit=1)[0]


def places(name: str, sources: Sequence[Publication]) -> list[Place]:
    """Where a codec stands against the best of the others, its best place first; claimed results do not count."""
    found = [place for source in sources if not source.claimed for place in _places(name, source)]
    return sorted(found, key=lambda place: -place.gap)


def _places(name: str, source: Publication) -> Iterator[Place]:
    if source.has_budgets:
        yield from _at_budgets(name, source)
        return
    for material in source.materials:
        known = []
        for codec in (codec for codec in material.codecs if codec.measured):
            quality = math.inf if codec.exact else columns.HELDOUT.mean(codec.measured)
            if quality is not None:
                size = mean_bytes([row.job for row in codec.measured])
                known.append((codec_of(codec.rows[0]), (codec.label, size, quality)))
        yield from _place(material.name, source.name, name, known)


def _place(material: str, results: str, name: str, known: Sequence[tuple[str, Entry]]) -> Iterator[Place]:
    """The best of a codec and the best of the others, given by codec; none if either is missing."""
    mine, others = ([each for codec, each in known if (codec == name) == own] for own in (True, False))
    if mine and others:
        yield Place(material, results, *(max(each, key=lambda item: item[2]) for each in (mine, others)))


def _at_budgets(name: str, source: Publication) -> Iterator[Place]:
    result = budgets(source.run)
    for budget in result.limits:
        for material in result.surfaces:
            known = [
                (line.partition(",")[0], (line, mean_bytes(rungs[material].of), quality))
                for line, rungs in result.picks(budget, [material]).items()
                if (quality := shown(rungs[material], PSNR)) is not None
            ]
            yield from _place(material, f"{source.name}, {in_words(budget)}", name, known)


def standing(name: str, found: Sequence[Place]) -> Table | None:
    """A row a place."""
    rows = []
    for place in found:
        (mine, size, quality), (best, its_size, its_quality) = place.mine, place.best
        decibels = [EXACT if psnr == math.inf else fixed(psnr, 2) for psnr in (quality, its_quality)]
        gap = signed(place.gap) if math.isfinite(place.gap) else EXACT if place.gap > 0 else NONE
        rows.append([place.material, place.results, mine, best, integer(size), integer(its_size), *decibels, gap])
    headers = [("material", ""), ("results", ""), (name, ""), ("best of the others", "")]
    headers += [("total", "bytes"), ("its total", "bytes"), ("PSNR", "dB ↑"), ("its PSNR", "dB ↑")]
    note = (
        "Test PSNR, mean over slices. With a budget: of the settings that validation pairs choose; else of those of "
        "each codec with the highest test PSNR, whatever their bytes."
    )
    title = "Where it wins and loses, against the best of the others"
    return Table("standing", title, [*headers, ("difference", "dB ↑")], rows, [note], words=4) if rows else None
