"""The stored frames of a scene as pictures of a page: the truth, models of the scene, whole models.

A *frame* is a picture of the scene, rendered once from each model's file and once from the reference table, which is
the truth. A *whole* model was fitted to the whole material. Frames are arrays (n, H, W, 3) of 8 bits.
"""

from collections.abc import Iterator

import numpy as np
from PIL import Image

from bench.records import Run, counted
from reports.artefacts import of_shown
from reports.atlas import webp
from reports.numbers import EXACT, fixed, integer
from reports.rows import MaterialRows, Row
from reports.scene_models import frames_psnr, in_pairs

PAIRS = 2  # models of a scene that are shown, each beside the whole one
WHOLE = 3  # whole models that are shown in a run without models of its scene
QUALITY = 90  # of WebP, up to 100
METHOD = 4  # of WebP: the effort to pack it, 0 to 6


def scene_strips(run: Run, material: MaterialRows) -> Iterator[list[tuple[str, str]]]:
    """For each stored frame its pictures: the words below one, and its data URL. Nothing if the run stored no frame.

    The truth comes first, then the models in the order of `_labels_of_models`. Reads the run's files of frames.
    """
    stored = {row.label: (row, frames) for row, frames in of_shown(run, material, "frames", ("truth", "decoded"))}
    models = [stored[label] for label in _labels_of_models(material) if label in stored]
    if not models:
        return
    _, first_frames = models[0]
    truth = first_frames["truth"]  # (n, H, W, 3), the same for all
    # A model whose frames differ in number or size from the truth's, as of another version of the scene, is left out.
    with_all_frames = [(row, frames) for row, frames in models if frames["decoded"].shape == truth.shape]
    for number, picture in enumerate(truth):
        pictures = [("the reference table", _webp(picture))]
        for row, frames in with_all_frames:
            pictures.append((_caption(row), _webp(frames["decoded"][number])))
        yield pictures


def _labels_of_models(material: MaterialRows) -> list[str]:
    """The labels of the models to show: the best models of the scene, each after the whole model beside it.

    In a run without models of a scene, they are those of the best whole models.
    """
    # By label of the scene's model: the rows of the whole model and of it. Pictures show the first seed.
    first_pairs: dict[str, tuple[Row, Row]] = {}
    for whole, scene in in_pairs(material):
        first_pairs.setdefault(scene.label, (whole, scene))
    pairs = sorted(first_pairs.values(), key=lambda pair: _frames_quality(pair[1]), reverse=True)
    if pairs:
        return [row.label for pair in pairs[:PAIRS] for row in pair]
    best_first = sorted(material.shown, key=_frames_quality, reverse=True)
    return [row.label for row in best_first[:WHOLE]]


def _frames_quality(row: Row) -> float:
    """The PSNR of a row's frames in dB, to sort by."""
    return counted(frames_psnr(row.job))


def _caption(row: Row) -> str:
    """The words below a picture: the label, the PSNR of all frames, and the bytes of the file."""
    psnr = frames_psnr(row.job)
    psnr_in_words = EXACT if psnr is None else f"{fixed(psnr, 2)} dB"
    return f"{row.label}: {psnr_in_words}, {integer(row.job['bytes']['total'])} bytes"


def _webp(picture: np.ndarray) -> str:
    """A picture, (H, W, 3) of 8 bits, as the data URL of a WebP."""
    return webp(Image.fromarray(picture), quality=QUALITY, method=METHOD)
