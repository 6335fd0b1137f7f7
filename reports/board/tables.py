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
    """A codec against the best of the other codecs on a material, each by the entry of one of its settings."""

    material: str
    results: str  # the name of its source, and the budget where that chose
    mine: Entry
    best: Entry

    @property
    def gap(self) -> float:
        """By how many dB the codec is better; 0 where both are exact, because infinity less infinity is no number."""
        mine = _quality(self.mine)
        best = _quality(self.best)
        return 0.0 if mine == best else mine - best


def origins(source: Publication, material: MaterialRows, name: str) -> Table:
    """Where each row of a material is from: whose word, seed, hash, revisions, processor."""
    rows = [[row.label, *_from(source, row)] for row in material.rows]
    headers = [("codec", ""), *((header, "") for header in _FROM)]
    return Table("origins", f"{name}: where each row is from", headers, rows, [STATES], material=name)


def _from(source: Publication, row: Row) -> list[str]:
    """The cells of `_FROM`."""
    job = row.job
    fitted = job.get("fitted") or {}
    scored = job.get("scored") or {}
    machine = job.get("machine") or {}
    digest = str(job.get("score_key", {}).get("sha256", ""))[:12]
    day = str(scored.get("at") or "")[:10]
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
    """Every row of a codec, of every source and material, with its numbers and where they are from."""
    times = [column for column in columns.time() if not column.sparse]
    wanted = [columns.TOTAL, columns.BITS, columns.HELDOUT, *times]
    rows = []
    for source in sources:
        for material in source.materials:
            for row in material.rows:
                if codec_of(row) == name:
                    measured = [row] if row.measured else []
                    numbers = [column.cell(measured) for column in wanted]
                    rows.append([material.name, source.title, row.label, *numbers, *_from(source, row)])
    if not rows:
        return None
    headers = [("material", ""), ("results", ""), ("row", ""), *((each.name, each.unit) for each in wanted)]
    headers += [(header, "") for header in _FROM]
    return Table("rows", f"{name}: every row", headers, rows, [STATES], words=3)


def codec_of(row: Row) -> str:
    """The name of a row's codec, the first word of its label; of an external program this is the program's own name."""
    return row.label.split(maxsplit=1)[0]


def places(name: str, sources: Sequence[Publication]) -> list[Place]:
    """Where a codec stands against the best of the others, its best place first; claimed results do not count."""
    found: list[Place] = []
    for source in sources:
        if not source.claimed:
            found += _places(name, source)
    return sorted(found, key=lambda place: -place.gap)


def _places(name: str, source: Publication) -> Iterator[Place]:
    """Where a codec stands in one source, on each material: at each budget or, if the source has no budgets, by the
    best of all its settings, whatever their bytes."""
    if source.has_budgets:
        yield from _at_budgets(name, source)
        return
    for material in source.materials:
        known = []
        for codec in material.codecs:
            if not codec.measured:
                continue
            quality = math.inf if codec.exact else columns.HELDOUT.mean(codec.measured)
            if quality is not None:
                size = mean_bytes([row.job for row in codec.measured])
                known.append((codec_of(codec.rows[0]), (codec.label, size, quality)))
        yield from _place(material.name, source.name, name, known)


def _place(material: str, results: str, name: str, known: Sequence[tuple[str, Entry]]) -> Iterator[Place]:
    """The best entry of a codec beside the best of the others; nothing if either is missing.

    `known` has the entries of one comparison, each after the name of its codec.
    """
    mine = [entry for codec, entry in known if codec == name]
    others = [entry for codec, entry in known if codec != name]
    if mine and others:
        yield Place(material, results, max(mine, key=_quality), max(others, key=_quality))


def _quality(entry: Entry) -> float:
    """The test PSNR of an entry, by which the best is found."""
    return entry[2]


def _at_budgets(name: str, source: Publication) -> Iterator[Place]:
    """Where a codec stands on each surface at each budget, among the rungs that validation pairs choose."""
    result = budgets(source.run)
    for budget in result.limits:
        for material in result.surfaces:
            known = []
            for line, rungs in result.picks(budget, [material]).items():
                rung = rungs[material]
                quality = shown(rung, PSNR)
                if quality is not None:
                    codec = line.partition(",")[0]
                    known.append((codec, (line, mean_bytes(rung.of), quality)))
            yield from _place(material, f"{source.name}, {in_words(budget)}", name, known)


def standing(name: str, found: Sequence[Place]) -> Table | None:
    """The table of where a codec stands, a row a place; None without any."""
    rows = []
    for place in found:
        (mine, size, quality), (best, its_size, its_quality) = place.mine, place.best
        decibels = [_decibels(quality), _decibels(its_quality)]
        gap = _gap_in_words(place.gap)
        rows.append([place.material, place.results, mine, best, integer(size), integer(its_size), *decibels, gap])
    if not rows:
        return None
    headers = [("material", ""), ("results", ""), (name, ""), ("best of the others", "")]
    headers += [("total", "bytes"), ("its total", "bytes"), ("PSNR", "dB ↑"), ("its PSNR", "dB ↑")]
    note = (
        "Test PSNR, mean over slices. With a budget: of the settings that validation pairs choose; else of those of "
        "each codec with the highest test PSNR, whatever their bytes."
    )
    title = "Where it wins and loses, against the best of the others"
    return Table("standing", title, [*headers, ("difference", "dB ↑")], rows, [note], words=4)


def _decibels(psnr: float) -> str:
    return EXACT if psnr == math.inf else fixed(psnr, 2)


def _gap_in_words(gap: float) -> str:
    """A gap in dB; “exact” where only the codec is, and a dash where only the best of the others is."""
    if math.isfinite(gap):
        return signed(gap)
    return EXACT if gap > 0 else NONE
