"""Models of a scene beside whole ones: the table of a search for the smallest, and what they save and gain in a run."""

import json
from collections.abc import Iterator, Sequence
from statistics import fmean

from bench.metrics import stats_of
from bench.records import MOST_DB, PSNR, SCENE_HELDOUT, SceneModel, fitted_to_scene
from reports.numbers import fixed, integer, significant
from reports.rows import CodecRows, MaterialRows, Row
from reports.table import Table
from reports.text import plain


def scene_models_text(rows: Sequence[SceneModel]) -> str:
    """The rows of `bench.demand.fitting.rows` for a terminal."""
    headers = [("model", ""), ("total", "bytes ↓"), ("time", "ns ↓"), ("fit", "steps"), ("fit", "s")]
    headers += [("held-out PSNR", "dB ↑"), ("scene PSNR", "dB ↑"), ("scene FLIP", "↓"), ("outside PSNR", "dB ↑")]
    cells = []
    for row in rows:
        cost = [integer(row["bytes"]), significant(row["ns"]), integer(row["steps"]), fixed(row["seconds"], 1)]
        quality = [fixed(row["held_out"], 2), fixed(row["psnr"], 2), fixed(row["flip"], 4), fixed(row["outside"], 2)]
        cells.append([row["model"], *cost, *quality])
    note = (
        "Held-out: at pairs that no fit saw and that lie in the scene, between pairs that it uses. Scene: in the "
        "frames, whose reference is interpolated between the training pairs. Outside: at pairs that the scene does not "
        "use. —: no error, or no such pair."
    )
    return plain([Table("scene", "the model of the scene beside the full one", headers, cells, [*gains(rows), note])])


def gains(rows: Sequence[SceneModel]) -> list[str]:
    """One line on what a model of the scene saves and gains against the full one; none without such a model."""
    by_model = {row["model"]: row for row in rows}
    if len(by_model) < 2:
        return []
    full, scene = by_model["full"], by_model["scene"]
    qualities = [
        ("held-out pairs", full["held_out"], scene["held_out"]),
        ("the pixels of its frames", full["psnr"], scene["psnr"]),
    ]
    return [gain(full["bytes"], scene["bytes"], qualities)]


def gain(full_bytes: int, scene_bytes: int, qualities: Sequence[tuple[str, float | None, float | None]]) -> str:
    """What a model of a scene saves in bytes, and gains in PSNR.

    Each of `qualities` is where PSNR was measured, in words, that of the full model, and that of the scene's model.
    """
    words = [f"{scene_bytes:,} instead of {full_bytes:,} bytes ({scene_bytes / full_bytes:.0%})"]
    for name, full, scene in qualities:
        if full is not None and scene is not None:
            words.append(f"{scene - full:+.2f} dB at {name}")
    return f"The model of the scene takes {', '.join(words)}."


def in_pairs(material: MaterialRows) -> Iterator[tuple[Row, Row]]:
    """Each model of the scene, after the whole model at the same codec, settings and seed."""
    whole = {_but_scene(row): row for row in material.measured if not fitted_to_scene(row.job)}
    for row in material.measured:
        full = whole.get(_but_scene(row))
        if full is not None and fitted_to_scene(row.job):
            yield full, row


def scene_gains(material: MaterialRows) -> Iterator[str]:
    """What each model of the scene saves in bytes and gains in PSNR against the whole model at the same settings."""
    for full, row in in_pairs(material):
        full_held, scene_held = (stats_of(each.job, PSNR, SCENE_HELDOUT).get("mean") for each in (full, row))
        full_frames, scene_frames = (each.job["scene"]["metrics"].get(PSNR) for each in (full, row))
        qualities = [
            ("held-out pairs", full_held, scene_held),
            ("the pixels of its frames", full_frames, scene_frames),
        ]
        yield f"{row.name}: {gain(full.job['bytes']['total'], row.job['bytes']['total'], qualities)}"


def scene_quality(codec: CodecRows) -> float:
    """The mean PSNR of a codec's seeds in a scene, by which its table is sorted: at the held-out pairs that lie in the
    scene or, without any, in its frames; the least of all if nothing was measured."""
    values = []
    for row in codec.measured:
        held = stats_of(row.job, PSNR, SCENE_HELDOUT)
        in_frames = row.job["scene"]["metrics"].get(PSNR) if "scene" in row.job else None
        value = held.get("mean") if held else in_frames
        values.append(MOST_DB if value is None else value)  # None: there is no error
    return fmean(values) if values else float("-inf")


def _but_scene(row: Row) -> str:
    """A key of a row's codec, settings and seed that leaves out whether it was fitted to the scene."""
    settings = {key: value for key, value in row.job["settings"].items() if key != "scene"}
    return json.dumps([row.job.get("codec"), settings, row.job.get("seed")], sort_keys=True)
