"""The live materials of a page: each codec's program as a packed shader, until the page is full."""

import base64
import io
import json
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import zip_longest
from typing import cast

import numpy as np
from PIL import Image

from bench.inputs.errors import InputError
from bench.records import Run, fitted_to_scene
from reports.artefacts import program
from reports.rows import MaterialRows, Row
from reports.viewer.page import Shown, model_data

BUDGET = 11_000_000  # characters of all models in a page
LARGEST = 2_500_000  # of one model: more than a network with its latents takes, less than most tables of all pairs
# The least that a packed model takes, in characters for each byte of its stored drawing: of 20 drawings of 10 codecs it
# is 0.90 to 2.68. By it a model that is surely too large is left out without being packed, because packing takes long:
# of ten codecs on ten materials, half the time of a report.
PACKED = 0.75
GAMMA = 2.2  # of the levels of a truth; the viewer undoes it
_TRUTH = "truth: few of its training pairs, 8 bit, interpolated between directions"
_TOO_LARGE = "it is too large for this page: `neubtf-bench view` shows it"


@dataclass(frozen=True)
class Live:
    """The packed models of one material by label, and why the others are missing."""

    models: dict[str, str]
    missing: dict[str, str]


def live(run: Run, materials: Sequence[MaterialRows], share: float = 1) -> dict[str, Live]:
    """The models of each material, until this share of `BUDGET` is spent: the truths, then codecs, the best first.

    A codec is live at the setting of its highest PSNR alone, once for the whole material and once for its scene.
    """
    by_material = {material.name: Live({}, {}) for material in materials}
    room = int(share * BUDGET)  # characters that are left
    # By codec, whether it is of a scene, and material: the label of the setting that is live.
    live_settings: dict[tuple[str, bool, str], str] = {}
    for material in materials:
        packed = _packed_truth(run, material)
        if packed:
            by_material[material.name].models["truth"] = packed
            room -= len(packed)
    best_first = [sorted(material.shown, key=by_psnr, reverse=True) for material in materials]
    for rows_of_turn in zip_longest(*best_first):  # the best row of each material, then the second of each, …
        for material, row in zip(materials, rows_of_turn, strict=True):
            if row is None:  # this material has fewer rows than another
                continue
            live_of_material = by_material[material.name]
            codec = str(row.job.get("codec"))
            # A model of a scene answers for its scene alone: the PSNR of the whole material does not rank it.
            key = codec, fitted_to_scene(row.job), material.name
            if key in live_settings:
                why = f"each codec is live at its highest PSNR alone, {live_settings[key]}"
                live_of_material.missing[row.label] = f"{why}: `neubtf-bench view` shows the file of this one"
                continue
            try:
                packed = _packed(run, row, min(room, LARGEST))
            except InputError as error:
                live_of_material.missing[row.label] = str(error)
                continue
            live_of_material.models[row.label] = packed
            live_settings[key] = row.label
            room -= len(packed)
    return by_material


def _packed_truth(run: Run, material: MaterialRows) -> str:
    """The truth that a run stored to be drawn live, packed; "" where it stored none, or one that is too large.

    Its slices are stored as 16-bit floats. As one WebP of 8 bits they take a tenth; the viewer makes floats of it.
    """
    job = next((row.job for row in material.shown if "drawing" in row.job), None)
    if not job:
        return ""
    # The truth stands beside the drawings of codecs; the digest of the material's data names it.
    path = (run.folder / job["drawing"]).parent / f"truth-{job['score_key']['btf'][:16]}.npz"
    if not path.is_file():
        return ""
    try:
        truth = Shown("truth", program(path), job["score_key"]["exposure"], _TRUTH)
        data = model_data(truth, bytes)
    except InputError:
        return ""  # a run's records are worth reading without its bulky parts
    # In place of the bytes of floats stands the WebP; `white` tells the viewer that it is one.
    data["white"], data["half"] = _slices_as_webp(cast(bytes, data["half"]), job["shape"])
    packed = pack(data)
    return packed if len(packed) <= LARGEST else ""


def _slices_as_webp(half: bytes, shape: Sequence[int]) -> tuple[float, bytes]:
    """The value that is white in the picture, and the slices as one WebP, one below the other, (n · H, W).

    `half` are the bytes of rows of four 16-bit floats, linear RGB and one that is not used, texel after texel and slice
    after slice; rows that pad the texture follow. `shape` is (H, W).
    """
    values = np.frombuffer(half, np.float16).reshape(-1, 4)[:, :3].astype(np.float32)
    height, width = shape
    slices = len(values) // (height * width)  # rounded down, because padding follows the last one
    # Not the largest value: a few highlights would leave few levels to the rest. Nor 0, by which black slices cannot be
    # divided.
    white = max(float(np.quantile(values, 0.999)), 1e-6)
    levels = 255 * np.clip(values[: slices * height * width] / white, 0, 1) ** (1 / GAMMA)
    file = io.BytesIO()
    sheet = np.round(levels).astype(np.uint8).reshape(slices * height, width, 3)
    Image.fromarray(sheet).save(file, "webp", quality=92, method=4)
    return white, file.getvalue()


def _packed(run: Run, row: Row, room: int) -> str:
    """The packed model of a row. `InputError` if there is none, or if it takes more than `room` characters."""
    if "drawing" not in row.job:
        why = row.job.get("not_drawn", "the run stored no drawing of it: `neubtf-bench view` shows its file")
        raise InputError(str(why))
    path = run.folder / row.job["drawing"]
    if path.is_file() and PACKED * path.stat().st_size > room:
        raise InputError(_TOO_LARGE)
    note = f"{row.label}: {row.job['bytes']['total']:,} bytes"
    model = Shown(row.label, program(path), row.job["score_key"]["exposure"], note)
    packed = pack(model_data(model, bytes))
    if len(packed) > room:
        raise InputError(_TOO_LARGE)
    return packed


def by_psnr(row: Row) -> float:
    """The PSNR of a row to sort by; infinite where it has no error."""
    return float("inf") if row.psnr is None else row.psnr


def pack(data: object) -> str:
    """Data with `bytes` objects in them as text for a page, whose function `unpacked` in JavaScript reads it.

    It is the length of the JSON in four bytes, the JSON, then all `bytes` one after the other, deflated and in base64.
    In the JSON, {raw: [start, length]} stands in place of a `bytes` object. With its base64 there the text would be
    larger.
    """
    places: dict[bytes, list[int]] = {}  # by `bytes` object, in order: where it starts after the JSON, and its length

    def placeholder(raw: bytes) -> object:
        """What stands for a `bytes` object in the JSON; equal ones are stored once."""
        start = sum(map(len, places))
        return {"raw": places.setdefault(raw, [start, len(raw)])}

    text = json.dumps(data, default=placeholder).encode()
    length = len(text).to_bytes(4, "little")
    packed = zlib.compress(length + text + b"".join(places), 9)  # 9: the smallest
    return base64.b64encode(packed).decode()
