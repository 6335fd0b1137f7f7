"""The live materials of a page: each codec's program as a packed shader, until the page is full.

From a program a shader of the browser is made: a reader turns the light, and the material answers. A *model* is what
the page needs to draw it: the shader's text and the bytes of its textures. *Packed*, it is one text. A run stores a
program as a *drawing*, a file that the record names. The *truth* is a model, too, made of a few pairs of the measured
data.
"""

import io
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain, zip_longest
from typing import cast

import numpy as np
from PIL import Image

from bench.inputs.errors import InputError
from bench.records import Run, fitted_to_scene
from reports.artefacts import program
from reports.atlas import WEBP_SIDE
from reports.rows import MaterialRows, Row
from reports.viewer.page import Shown, model_data, pack

BUDGET = 11_000_000  # characters of all models in a page
LARGEST = 2_500_000  # of one model: more than a network with its latents takes, less than most tables of all pairs
# The least that a packed model takes, in characters of a page for each byte of its stored drawing: of 20 drawings of 10
# codecs it is 0.90 to 2.68. By it a model that is surely too large is left out without being packed, because packing
# takes long: of ten codecs on ten materials, half the time of a report.
PACKED = 0.75
GAMMA = 2.2  # of the levels of a truth's picture: dark values get more of the 256 levels; the viewer undoes it
# The line about the truth that the viewer shows.
_TRUTH = "truth: few of its training pairs, 8 bit, interpolated between directions"
_TOO_LARGE = "it is too large for this page: `neubtf-bench view` shows it"


@dataclass(frozen=True)
class Live:
    """The packed models of one material, and why the others are missing."""

    models: dict[str, str]  # by label, or "truth": the text that `pack` makes
    missing: dict[str, str]  # by label: the reason, in words for a reader of the page


def live(run: Run, materials: Sequence[MaterialRows], share: float = 1) -> dict[str, Live]:
    """By name of a material: its models, until this `share` of `BUDGET` is spent. Reads the drawings of the run.

    The truths come first, then codecs, the best first. Of each codec only one setting is live, that of the highest PSNR
    whose model there is and fits. Settings fitted to the whole material and those fitted to its scene are chosen apart.
    """
    by_material = {material.name: Live({}, {}) for material in materials}
    room = int(share * BUDGET)  # characters that are left

    # The truths take their room before all codecs.
    for material in materials:
        packed = _packed_truth(run, material)
        if packed:
            by_material[material.name].models["truth"] = packed
            room -= len(packed)

    # By codec, whether it is of a scene, and material: the label of the setting that is live.
    live_settings: dict[tuple[str, bool, str], str] = {}
    best_first = [sorted(material.shown, key=by_psnr, reverse=True) for material in materials]
    # In turn the best row of each material, then the second of each, …: so each material gets its share of the room.
    in_turn = chain.from_iterable(zip_longest(*best_first))
    for row in filter(None, in_turn):  # None: this material has fewer rows than another
        name = row.job["material"]
        # A model of a scene answers for its scene alone: the PSNR of the whole material does not rank it.
        key = row.job["codec"], fitted_to_scene(row.job), name
        if key in live_settings:
            why = f"each codec is live at its highest PSNR alone, {live_settings[key]}"
            by_material[name].missing[row.label] = f"{why}: `neubtf-bench view` shows the file of this one"
            continue
        try:
            packed = _packed(run, row, min(room, LARGEST))
        except InputError as error:  # then a worse setting of the codec may still be live
            by_material[name].missing[row.label] = str(error)
            continue
        by_material[name].models[row.label] = packed
        live_settings[key] = row.label
        room -= len(packed)
    return by_material


def _packed_truth(run: Run, material: MaterialRows) -> str:
    """The truth that a run stored to be drawn live, packed; "" where it stored none, or one that is too large.

    Its slices, pictures of the material at a few pairs of directions, are stored as 16-bit floats. As one WebP of 8
    bits they take a tenth; the viewer makes floats of it.
    """
    job = next((row.job for row in material.shown if "drawing" in row.job), None)
    if not job:
        return ""
    # The truth stands beside the drawings of codecs, named after the first digits of the digest of the material's data.
    path = (run.folder / job["drawing"]).parent / f"truth-{job['score_key']['btf'][:16]}.npz"
    if not path.is_file():
        return ""
    try:
        truth = Shown("truth", program(path), job["score_key"]["exposure"], _TRUTH)
        data = model_data(truth)
    except InputError:
        return ""  # a run's records are worth reading without its bulky parts
    # `half` is the texture of 16-bit floats, here the slices. The WebP takes its place; `white` tells the viewer so.
    sheet = _slices_as_webp(cast(bytes, data["half"]), job["shape"])
    if sheet is None:
        return ""
    data["white"], data["half"] = sheet
    packed = pack(data)
    return packed if len(packed) <= LARGEST else ""


def _slices_as_webp(half: bytes, shape: Sequence[int]) -> tuple[float, bytes] | None:
    """The radiance that is white in the picture, and the slices as one WebP, one below the other, (n · H, W); None if
    a WebP cannot be so large.

    `half` are the bytes of rows of four 16-bit floats, linear RGB and one that is not used, texel after texel and slice
    after slice; rows that pad the texture follow. `shape` is (H, W).
    """
    rgb_and_unused = np.frombuffer(half, np.float16).reshape(-1, 4)
    values = rgb_and_unused[:, :3].astype(np.float32)
    height, width = shape
    slices = len(values) // (height * width)  # rounded down, because padding follows the last one
    if max(slices * height, width) > WEBP_SIDE:
        return None
    # The quantile, not the largest value: a few highlights would leave few levels to the rest. At least a little above
    # 0, because black slices are divided by it, too.
    white = max(float(np.quantile(values, 0.999)), 1e-6)
    levels = 255 * np.clip(values[: slices * height * width] / white, 0, 1) ** (1 / GAMMA)
    file = io.BytesIO()
    sheet = np.round(levels).astype(np.uint8).reshape(slices * height, width, 3)
    Image.fromarray(sheet).save(file, "webp", quality=92, method=4)
    return white, file.getvalue()


def _packed(run: Run, row: Row, room: int) -> str:
    """The packed model of a row. `InputError` says why there is none: it takes more than `room` characters, the run
    stored no drawing, or no shader can compute its program."""
    if "drawing" not in row.job:
        why = row.job.get("not_drawn", "the run stored no drawing of it: `neubtf-bench view` shows its file")
        raise InputError(str(why))
    path = run.folder / row.job["drawing"]
    if path.is_file() and PACKED * path.stat().st_size > room:
        raise InputError(_TOO_LARGE)
    note = f"{row.label}: {row.job['bytes']['total']:,} bytes"
    model = Shown(row.label, program(path), row.job["score_key"]["exposure"], note)
    packed = pack(model_data(model))
    if len(packed) > room:
        raise InputError(_TOO_LARGE)
    return packed


def by_psnr(row: Row) -> float:
    """The PSNR of a row in dB, to sort by; infinite where it has no error."""
    return float("inf") if row.psnr is None else row.psnr
