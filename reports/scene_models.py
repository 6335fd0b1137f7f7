"""Models of a scene beside whole ones: the table of a search for the smallest, and what they save and gain in a run.

A *whole* (or *full*) model is fitted to the whole material. *Frames* are the pictures of the scene, rendered from a
file.
"""

import json
from collections.abc import Iterator, Sequence
from statistics import fmean

from bench.metrics import stats_of
from bench.records import PSNR, SCENE_HELDOUT, Job, SceneModel, counted, fitted_to_scene
from reports.numbers import fixed, integer, signed, significant
from reports.rows import CodecRows, MaterialRows, Row
from reports.table import Table
from reports.text import plain


def scene_models_text(rows: Sequence[SceneModel]) -> str:
    """The table of the rows of `bench.demand.fitting.rows`, one a model ("full", "scene"), as text for a terminal."""
    headers = [("model", ""), ("total", "bytes ↓"), ("time", "ns ↓"), ("fit", "steps"), ("fit", "s")]
    headers += [("held-out PSNR", "dB ↑"), ("scene PSNR", "dB ↑"), ("scene FLIP", "↓"), ("outside PSNR", "dB ↑")]
    cells = []
    for row in rows:
        cost = [integer(row["bytes"]), significant(row["ns"]), integer(row["steps"]), fixed(row["seconds"], 1)]
        quality = [fixed(row["held_out"], 2), fixed(row["psnr"], 2), fixed(row["flip"], 4), fixed(row["outside"], 2)]
        cells.append([row["model"], *cost, *quality])
    about_columns = (
        "Held-out: at pairs that no fit saw and that lie in the scene, between pairs that it uses. Scene: in the "
        "frames, whose reference is interpolated between the training pairs. Outside: at pairs that the scene does not "
        "use. —: no error, or no such pair."
    )
    notes = [*gains(rows), about_columns]
    return plain([Table("scene", "the model of the scene beside the full one", headers, cells, notes)])


def gains(rows: Sequence[SceneModel]) -> list[str]:
    """A list of one line, on what the model of the scene saves and gains against the full one; empty unless `rows` has
    both."""
    by_model = {row["model"]: row for row in rows}  # "full" and "scene"
    if len(by_model) < 2:
        return []
    full, scene = by_model["full"], by_model["scene"]
    qualities = [
        ("held-out pairs", full["held_out"], scene["held_out"]),
        ("the pixels of its frames", full["psnr"], scene["psnr"]),
    ]
    return [gain(full["bytes"], scene["bytes"], qualities)]


def gain(full_bytes: int, scene_bytes: int, qualities: Sequence[tuple[str, float | None, float | None]]) -> str:
    """What a model of a scene saves in bytes, and gains in PSNR: "The model of the scene takes 1,024 instead of 4,096
    bytes (25%), +1.50 dB at held-out pairs."

    `qualities` has three parts for each group of slices: its name in words, the full model's PSNR of it, and the scene
    model's. A PSNR that is None was not measured or has no error, so there is no difference.
    """
    words = [f"{scene_bytes:,} instead of {full_bytes:,} bytes ({scene_bytes / full_bytes:.0%})"]
    for name, full, scene in qualities:
        if full is not None and scene is not None:
            words.append(f"{signed(scene - full)} dB at {name}")
    return f"The model of the scene takes {', '.join(words)}."


def in_pairs(material: MaterialRows) -> Iterator[tuple[Row, Row]]:
    """Pairs of rows: a whole model, and the model of the scene by the same codec, with the same settings and seed.

    A model without such a counterpart is in no pair.
    """
    whole_rows = {_key_without_scene(row): row for row in material.measured if not fitted_to_scene(row.job)}
    for row in material.measured:
        whole_row = whole_rows.get(_key_without_scene(row))
        if whole_row is not None and fitted_to_scene(row.job):
            yield whole_row, row


def scene_gains(material: MaterialRows) -> Iterator[str]:
    """A sentence on each model of the scene that has a whole model beside it: the bytes that it saves, and the PSNR
    that it gains."""
    for whole_row, row in in_pairs(material):
        whole = whole_row.job
        scene = row.job
        heldout = "held-out pairs", _heldout_psnr(whole), _heldout_psnr(scene)
        frames = "the pixels of its frames", frames_psnr(whole), frames_psnr(scene)
        yield f"{row.name}: {gain(whole['bytes']['total'], scene['bytes']['total'], [heldout, frames])}"


def _heldout_psnr(job: Job) -> float | None:
    """The mean PSNR of the held-out pairs that lie in the scene, in dB; None if it was not measured."""
    return stats_of(job, PSNR, SCENE_HELDOUT).get("mean")


def frames_psnr(job: Job) -> float | None:
    """The PSNR of the frames of the scene, in dB; None if they have no error, or were not scored."""
    return job.get("scene", {}).get("metrics", {}).get(PSNR)


def scene_quality(codec: CodecRows) -> float:
    """The mean PSNR of a codec's seeds in a scene, by which its table is sorted: at the held-out pairs that lie in the
    scene or, without any, in its frames; minus infinity if nothing was measured."""
    values = []
    for row in codec.measured:
        in_scene = stats_of(row.job, PSNR, SCENE_HELDOUT)
        values.append(counted(_heldout_psnr(row.job) if in_scene else frames_psnr(row.job)))
    return fmean(values) if values else float("-inf")


def _key_without_scene(row: Row) -> str:
    """A text that is the same for rows of the same codec, settings and seed, whether fitted to the scene or not."""
    settings = {key: value for key, value in row.job["settings"].items() if key != "scene"}
    return json.dumps([row.job["codec"], settings, row.job.get("seed")], sort_keys=True)
