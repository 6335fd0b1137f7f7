"""The stored frames of a scene as pictures of a page: the truth, models of the scene, whole models."""

from collections.abc import Iterator

import numpy as np
from PIL import Image

from bench.records import PSNR, Run
from reports.artefacts import Arrays, of_shown
from reports.atlas import webp
from reports.numbers import EXACT, fixed, integer
from reports.rows import MaterialRows, Row
from reports.scene_models import in_pairs

PAIRS = 2  # models of a scene that are shown, each beside the whole one
WHOLE = 3  # whole models that are shown in a run without models of its scene
QUALITY = 90  # of WebP


def scene_strips(run: Run, material: MaterialRows) -> Iterator[list[tuple[str, str]]]:
    """A row of pictures, each with its words, for each stored frame; nothing if the run stored none."""
    stored = {row.label: (row, frames) for row, frames in of_shown(run, material, "frames", ("truth", "decoded"))}
    chosen = [stored[label] for label in _chosen(material) if label in stored]
    if not chosen:
        return
    _, first = chosen[0]
    truth = first["truth"]  # (n, H, W, 3), the same for all
    for number, picture in enumerate(truth):
        pictures = [("the reference table", _webp(picture))]
        pictures += [(_caption(row), _webp(frames["decoded"][number])) for row, frames in _alike(chosen, truth)]
        yield pictures


def _chosen(material: MaterialRows) -> list[str]:
    """The labels of the shown models: each model of the scene after its whole one, or else the best whole models."""
    pairs = sorted(in_pairs(material), key=lambda pair: _psnr(pair[1]), reverse=True)
    by_scene_model = {scene.label: [whole.label, scene.label] for whole, scene in pairs}  # the seeds of a model are one
    if by_scene_model:
        shown: list[str] = []
        for labels in list(by_scene_model.values())[:PAIRS]:
            shown += labels
        return shown
    return [row.label for row in sorted(material.shown, key=_psnr, reverse=True)[:WHOLE]]


def _alike(chosen: list[tuple[Row, Arrays]], truth: np.ndarray) -> list[tuple[Row, Arrays]]:
    """The models whose decoded frames are as many and as large as those of the truth, (n, H, W, 3)."""
    return [(row, frames) for row, frames in chosen if frames["decoded"].shape == truth.shape]


def _psnr(row: Row) -> float:
    """The PSNR of a row's frames to sort by; infinite where they have no error."""
    value = row.job.get("scene", {}).get("metrics", {}).get(PSNR)
    return float("inf") if value is None else float(value)


def _caption(row: Row) -> str:
    """The words below a picture: the label, the PSNR of all frames, and the bytes of the file."""
    psnr = _psnr(row)
    shown = EXACT if psnr == float("inf") else f"{fixed(psnr, 2)} dB"
    return f"{row.label}: {shown}, {integer(row.job['bytes']['total'])} bytes"


def _webp(picture: np.ndarray) -> str:
    return webp(Image.fromarray(picture), quality=QUALITY, method=4)
