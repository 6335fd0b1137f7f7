"""The table of a search for the smallest model of a scene: the full model beside the scene's, with gains and losses."""

from collections.abc import Sequence

from bench.records import Record
from reports.numbers import fixed, integer, significant
from reports.table import Table
from reports.text import plain


def scene_models_text(rows: Sequence[Record]) -> str:
    """The rows of `bench.demand.fitting.rows` for a terminal."""
    headers = [("model", ""), ("total", "bytes ↓"), ("time", "ns ↓"), ("fit", "steps"), ("fit", "s")]
    headers += [("scene PSNR", "dB ↑"), ("scene FLIP", "↓"), ("outside PSNR", "dB ↑")]
    cells = []
    for row in rows:
        cost = [integer(row["bytes"]), significant(row["ns"]), integer(row["steps"]), fixed(row["seconds"], 1)]
        cells.append([row["model"], *cost, fixed(row["psnr"], 2), fixed(row["flip"], 4), fixed(row["outside"], 2)])
    note = "Scene: in the frames. Outside: at pairs that the scene does not use. —: no error, or no such pair."
    return plain([Table("scene", "the model of the scene beside the full one", headers, cells, [note])])
