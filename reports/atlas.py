"""The stored slices of a run as pictures of a page: the truth of each material, each codec's answers and FLIP maps."""

import base64
import io
import math
from collections.abc import Sequence
from typing import Any

import matplotlib
import numpy as np
from PIL import Image

from bench.metrics.psnr import psnr
from bench.records import FLIP, PSNR, Run
from reports.artefacts import Arrays, arrays, of_shown
from reports.rows import MaterialRows, Row

BUDGET = 8_000_000  # characters of all pictures in a page, about
FLIP_QUALITY = 80  # of FLIP maps stored as grey levels: half the error of colours at quality 92, in half the bytes
MAGMA = np.round(matplotlib.colormaps["magma"](np.arange(256))[:, :3] * 255).astype(np.uint8)  # the colours of maps
# Qualities of WebP, the best first, each with about how many characters of a page a pixel takes; None: without loss.
QUALITIES: tuple[tuple[int | None, float], ...] = ((None, 2.6), (92, 0.9), (80, 0.5), (60, 0.3))


class Atlases:
    """The slices of all materials of a run. All have the one quality at which they fit into this `share` of `BUDGET`.

    If they do not fit even at the worst quality, only every `step`-th pair is shown.
    """

    def __init__(self, run: Run, materials: Sequence[MaterialRows], share: float = 1):
        self.run = run
        budget = share * BUDGET
        pixels = sum(self._pixels(material) for material in materials)
        fitting = [(quality, size) for quality, size in QUALITIES if size * pixels <= budget]
        self.quality, per_pixel = fitting[0] if fitting else QUALITIES[-1]
        self.step = max(1, -int(-per_pixel * pixels // budget))  # their size over the budget, rounded up

    def _pixels(self, material: MaterialRows) -> int:
        """The pixels of all pictures of a material: the truth once, and the answers and FLIP maps of each codec."""
        sizes = []
        for row in material.shown:
            found = arrays(self.run.folder, row.job, "pictures", ("truth",))
            if found:  # of rows of several runs, some may have none
                sizes.append(found["truth"].shape[:3])  # (n, H, W)
        if not sizes:
            return 0
        pixels_of_truth = int(np.prod(sizes[0]))
        pictures = 1 + 2 * len(sizes)
        return pixels_of_truth * pictures

    def slices_of(self, material: MaterialRows) -> dict[str, Any]:
        """The data of a material for the slice viewer; `codecs` is empty if nothing is stored.

        Pictures are data URLs, each of all shown pairs in a grid. FLIP maps hold levels of `MAGMA` as grey. `wo` and
        `wi` are (θ, φ) in degrees by pair. `left_out` has the codecs without pictures of the same pairs as the first.
        """
        stored = of_shown(self.run, material, "pictures")
        known = [(row, pictures) for row, pictures in stored if "pairs" in pictures]
        if not known:
            return {"codecs": [], "left_out": [row.label for row in material.shown]}
        _, first = known[0]
        same = [(row, pictures) for row, pictures in known if np.array_equal(pictures["pairs"], first["pairs"])]
        labels = {row.label for row, _ in same}
        count, height, width = first["truth"][:: self.step].shape[:3]
        return {
            "width": width,
            "height": height,
            "columns": math.ceil(math.sqrt(count)),
            "wo": np.round(first["wo_deg"][:: self.step], 1).tolist(),
            "wi": np.round(first["wi_deg"][:: self.step], 1).tolist(),
            "truth": self._encoded(first["truth"]),
            "codecs": [self._codec(row, pictures) for row, pictures in same],
            "left_out": [row.label for row in material.shown if row.label not in labels],
            "quality": self.quality,
        }

    def _codec(self, row: Row, pictures: Arrays) -> dict[str, Any]:
        """A codec for the slice viewer: its pictures as data URLs. Where the run stored scores, it also has two lists
        with a number for each picture: `psnr` in dB (None without error), and `flips`, the mean FLIP."""
        data: dict[str, Any] = {"label": row.label, "decoded": self._encoded(pictures["decoded"])}
        if "flip" in pictures:
            data["flip"] = self._encoded(_levels(pictures["flip"]), FLIP_QUALITY)
        name = row.metric(FLIP)
        scores = arrays(self.run.folder, row.job, "slices", ("pairs", PSNR, name))
        if scores:
            # Scores are of all pairs, pictures of a few: find the scores of those that are shown.
            place_of = {int(pair): place for place, pair in enumerate(scores["pairs"])}
            places = [place_of[int(pair)] for pair in pictures["pairs"][:: self.step]]
            data["psnr"] = [_decibels(value) for value in psnr(scores[PSNR][places])]
            if name in scores:
                data["flips"] = np.round(scores[name][places], 4).tolist()
        return data

    def _encoded(self, pictures: np.ndarray, most: int = 100) -> str:
        """Pictures (n, H, W, 3), uint8, in a grid as one WebP. `most` limits its quality, unless it is without loss."""
        pictures = pictures[:: self.step]
        count, height, width = pictures.shape[:3]
        columns = math.ceil(math.sqrt(count))
        rows = math.ceil(count / columns)
        sheet = np.zeros((rows * height, columns * width, 3), np.uint8)
        for i, picture in enumerate(pictures):
            top = i // columns * height
            left = i % columns * width
            sheet[top : top + height, left : left + width] = picture
        if self.quality is None:
            return webp(Image.fromarray(sheet), lossless=True, quality=0, method=0)
        return webp(Image.fromarray(sheet), lossless=False, quality=min(most, self.quality), method=4)


def _decibels(value: float) -> float | None:
    """PSNR in dB as JSON can hold it: None, so null, where it is infinite because there is no error."""
    return round(float(value), 2) if np.isfinite(value) else None


def webp(picture: Image.Image, **how: Any) -> str:
    """A picture as the data URL of a WebP."""
    out = io.BytesIO()
    picture.save(out, "webp", **how)
    return "data:image/webp;base64," + base64.b64encode(out.getvalue()).decode()


def _levels(maps: np.ndarray) -> np.ndarray:
    """Maps drawn in the colours of magma, (n, H, W, 3) uint8, as grey pictures of the levels 0 to 255 of their colours.

    Magma grows brighter with its level, so the brightness of a colour tells its level.
    """
    luma = np.array([0.299, 0.587, 0.114])
    # Rounded to 8 bits, a colour of magma is a little darker than the one before it: a search needs ascending values.
    brightness = np.maximum.accumulate(MAGMA @ luma)
    levels = np.searchsorted(brightness, maps @ luma - 1e-6)  # less a margin for rounding, so that equal ones are found
    grey = np.minimum(levels, 255).astype(np.uint8)
    return grey[..., None].repeat(3, -1)
