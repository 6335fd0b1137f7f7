"""The table of a search for the smallest model of a scene: the full model beside the scene's, with gains and losses."""

from collections.abc import Sequence

from bench.records import Record
from reports.numbers import fixed, integer, significant
from reports.table import Table
from reports.text import plain


def scene_models_text(rows: Sequence[Record]) -> str:
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


def gains(rows: Sequence[Record]) -> list[str]:
    """One line on what a model of the scene saves and gains against the full one; none without such a model."""
    by_model = {row["model"]: row for row in rows}
    if len(by_model) < 2:
        return []
    full, scene = by_model["full"], by_model["scene"]
    held, frames = (("held-out pairs", "held_out"), ("the pixels of its frames", "psnr"))
    qualities = [(words, full[key], scene[key]) for words, key in (held, frames)]
    return [gain(full["bytes"], scene["bytes"], qualities)]


def gain(full_bytes: int, scene_bytes: int, qualities: Sequence[tuple[str, float | None, float | None]]) -> str:
    """What a model of a scene saves in bytes, and gains in PSNR: by name, of the full model and of the scene's."""
    words = [f"{scene_bytes:,} instead of {full_bytes:,} bytes ({scene_bytes / full_bytes:.0%})"]
    for name, full, scene in qualities:
        if full is not None and scene is not None:
            words.append(f"{scene - full:+.2f} dB at {name}")
    return f"The model of the scene takes {', '.join(words)}."
