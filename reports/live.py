"""The live materials of a page: each codec's program as a packed shader, until the page is full."""

import base64
import json
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import zip_longest

from bench.errors import InputError
from bench.records import Run
from reports.artefacts import program
from reports.rows import MaterialRows, Row
from reports.viewer.page import Model, model_data

BUDGET = 11_000_000  # characters of all models in a page
LARGEST = 2_500_000  # characters of one model: enough for networks with latents, too few for most tables of all pairs
# The least characters of a packed model for each byte of its stored drawing (0.93 to 1.68 for 41 drawings of 16 #
# codecs). Models that cannot fit are skipped before packing, which took half of a report's time.
PACKED = 0.75
_TOO_LARGE = "it is too large for this page: `neubtf-bench view` shows it"


@dataclass(frozen=True)
class Live:
    """The packed models of one material by label, and why the others are missing."""

    models: dict[str, str]
    missing: dict[str, str]


def live(run: Run, materials: Sequence[MaterialRows]) -> dict[str, Live]:
    """The models of each material: its best codec, then its second, and so on until the budget is spent."""
    by_material = {material.name: Live({}, {}) for material in materials}
    left = BUDGET
    for turn in zip_longest(*(sorted(material.shown, key=_psnr, reverse=True) for material in materials)):
        for material, row in zip(materials, turn, strict=True):
            if row is None:
                continue
            here = by_material[material.name]
            try:
                packed = _packed(run, row, min(left, LARGEST))
            except InputError as error:
                here.missing[row.label] = str(error)
                continue
            here.models[row.label] = packed
            left -= len(packed)
    return by_material


def _packed(run: Run, row: Row, room: int) -> str:
    """The packed model of a row. `InputError` if there is none, or if it takes more than `room` characters."""
    if "drawing" not in row.job:
        why = row.job.get("not_drawn", "the run stored no drawing of it: `neubtf-bench view` shows its file")
        raise InputError(str(why))
    path = run.folder / row.job["drawing"]
    if path.is_file() and PACKED * path.stat().st_size > room:
        raise InputError(_TOO_LARGE)
    note = f"{row.label}: {row.job['bytes']['total']:,} bytes"
    packed = pack(model_data(Model(row.label, program(path), row.job["score_key"]["exposure"], note)))
    if len(packed) > room:
        raise InputError(_TOO_LARGE)
    return packed


def _psnr(row: Row) -> float:
    return float("inf") if row.psnr is None else row.psnr


def pack(data: object) -> str:
    """JSON, deflated, in base64: what the page's `unpacked` reads."""
    return base64.b64encode(zlib.compress(json.dumps(data).encode(), 6)).decode()
