"""The live materials of a page: each codec's program as a packed shader, as far as there is room."""

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
LARGEST = 2_500_000  # of one model: more than a network with its latents takes, less than most tables of all pairs
# Characters of a packed model a byte of its stored drawing, at least: 0.93 to 1.68 of 41 drawings of 16 codecs. What
# is surely too large is not packed to be thrown away, which of ten codecs on ten materials took half of a report.
PACKED = 0.75
_TOO_LARGE = "it takes more room than this page has: `neubtf-bench view` shows it"


@dataclass(frozen=True)
class Live:
    """The models of one material, each packed, by label; and why the others are missing."""

    models: dict[str, str]
    missing: dict[str, str]


def live(run: Run, materials: Sequence[MaterialRows], share: float = 1) -> dict[str, Live]:
    """The models of each material, codecs at their best settings, the best first, until the page's share is spent."""
    by_material = {material.name: Live({}, {}) for material in materials}
    left, done = int(share * BUDGET), set[tuple[str, str]]()
    for turn in zip_longest(*(sorted(material.shown, key=by_psnr, reverse=True) for material in materials)):
        for material, row in zip(materials, turn, strict=True):
            if row is None:
                continue
            here, codec = by_material[material.name], str(row.job.get("codec"))
            if (codec, material.name) in done:
                here.missing[row.label] = "its codec is, at better settings: `neubtf-bench view` shows it"
                continue
            try:
                packed = _packed(run, row, min(left, LARGEST))
            except InputError as error:
                here.missing[row.label] = str(error)
                continue
            here.models[row.label] = packed
            done.add((codec, material.name))
            left -= len(packed)
    return by_material


def _packed(run: Run, row: Row, room: int) -> str:
    """The packed model of a row. `InputError` where there is none, or where it takes more than `room` characters."""
    if "drawing" not in row.job:
        why = row.job.get("not_drawn", "the run stored no drawing of it: `neubtf-bench view` shows its file")
        raise InputError(str(why))
    path = run.folder / row.job["drawing"]
    if path.is_file() and PACKED * path.stat().st_size > room:
        raise InputError(_TOO_LARGE)
    note = f"{row.label}: {row.job['bytes']['total']:,} bytes"
    packed = _pack_model(Model(row.label, program(path), row.job["score_key"]["exposure"], note))
    if len(packed) > room:
        raise InputError(_TOO_LARGE)
    return packed


def by_psnr(row: Row) -> float:
    """The PSNR of a row to sort by; infinite where it has no error."""
    return float("inf") if row.psnr is None else row.psnr


def _pack_model(model: Model) -> str:
    """A model whose arrays stand as bytes behind its JSON, which says where: they deflate better than in base64."""
    places: dict[bytes, list[int]] = {}

    def place(raw: bytes) -> object:
        return {"raw": places.setdefault(raw, [sum(map(len, places)), len(raw)])}

    data = model_data(model, place)
    return pack(data, b"".join(places))


def pack(data: object, arrays: bytes = b"") -> str:
    """The length of the JSON, the JSON, then arrays: deflated, in base64, as the page's `unpacked` reads it."""
    text = json.dumps(data).encode()
    return base64.b64encode(zlib.compress(len(text).to_bytes(4, "little") + text + arrays, 9)).decode()
