"""The tables of a board that a run's page does not have: where rows come from, and all rows of a codec.

For the words of a board see `reports.board.sources`.
"""

from collections.abc import Iterator, Sequence

import pandas as pd

from bench.records import method_of
from reports import by_material
from reports.board.sources import STATES, Publication
from reports.numbers import NONE
from reports.rows import CodecRows, MaterialRows, Row
from reports.table import Table

# Of where a row is from: whose word it is, seed, hash of the codec file, revisions of the code, machine, and day.
_ORIGIN_WORDS = ("state", "seed", "file", "fitted by", "scored by", "processor", "scored on")
_ORIGIN_HEADERS = [(words, "") for words in _ORIGIN_WORDS]


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
            of_codec = [row for row in material.rows if method_of(row.job) == name]
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
