"""The stored slices of a run as pictures of a page: the truth of each material, each codec's answers and FLIP maps.

A run stores some 16 slices for each codec. FLIP maps are in the colours of magma. The page's slice viewer shows one
pair at a time; all pairs of a codec lie in one picture, as a grid, because that is smaller.
"""

import base64
import io
import math
from collections.abc import Sequence
from itertools import chain
from typing import Any

import matplotlib
import numpy as np
from PIL import Image

from bench.metrics.psnr import psnr
from bench.records import FLIP, PSNR, Run
from reports.artefacts import Arrays, arrays, of_same_pairs, of_shown
from reports.rows import MaterialRows, Row

BUDGET = 8_000_000  # about how many characters all pictures of a page may take, as base64
WEBP_SIDE = 16_383  # pixels, the most that a side of a WebP may have
FLIP_QUALITY = 80  # of FLIP maps stored as grey levels: half the error of colours at quality 92, in half the bytes
# The colours of FLIP maps by level, (256, 3): what a run drew them in, without alpha.
MAGMA = np.round(matplotlib.colormaps["magma"](np.arange(256))[:, :3] * 255).astype(np.uint8)
# Qualities of WebP, the best first, each with about how many characters of a page a pixel takes. Quality None is
# without loss.
QUALITIES: tuple[tuple[int | None, float], ...] = ((None, 2.6), (92, 0.9), (80, 0.5), (60, 0.3))
_WORST = QUALITIES[-1][0]


class Atlases:
    """The slices of all materials of a run, as pictures of one quality: the best at which they all fit into the page.

    They may take the `share` of `BUDGET`: less than 1 for a page of a board with many pages. If they do not fit even at
    the worst quality, or a grid were larger than a WebP can be, only every `step`-th pair is shown. To choose the
    quality, the constructor reads the stored truths.
    """

    def __init__(self, run: Run, materials: Sequence[MaterialRows], share: float = 1):
        self.run = run
        budget = share * BUDGET
        shapes_by_material = [self._truth_shapes(material) for material in materials]
        pixels = sum(map(_pixels, shapes_by_material))
        characters = {quality: per_pixel * pixels for quality, per_pixel in QUALITIES}  # the best first
        self.quality = next((quality for quality in characters if characters[quality] <= budget), _WORST)
        # At the worst quality they may still be several times too large: then only some pairs are shown.
        times_too_large = math.ceil(characters[self.quality] / budget)
        self.step = max(1, times_too_large)  # 1: all pairs are shown
        # A grid of many large pictures may be larger than a WebP can be, whatever its quality.
        for count, height, width in chain.from_iterable(shapes_by_material):
            while self.step < count and not _fits(math.ceil(count / self.step), height, width):
                self.step += 1

    def _truth_shapes(self, material: MaterialRows) -> list[tuple[int, int, int]]:
        """The (n, H, W) of the truth's pictures, of each shown row of a material whose pictures a WebP can hold."""
        truth_shapes = []
        for row in material.shown:
            stored = arrays(self.run.folder, row.job, "pictures", names=("truth",))
            if stored:  # of rows of several runs, some may have none
                count, height, width = stored["truth"].shape[:3]
                if _fits(1, height, width):
                    truth_shapes.append((count, height, width))
        return truth_shapes

    def slices_of(self, material: MaterialRows) -> dict[str, Any]:
        """The data of a material for the slice viewer, to be written as JSON; `codecs` is empty if nothing is stored.

        Pictures are data URLs, each of all shown pairs in a grid of so many `columns`; a pair takes `width` × `height`
        pixels. FLIP maps hold levels of `MAGMA` as grey. `wo` and `wi` have (θ, φ) in degrees of each shown pair. All
        pictures are of the same pairs as those of the first codec that has any, because one truth stands beside all;
        `left_out` has the labels of the codecs without such pictures, or with pictures that no WebP can hold.
        """
        rows_with_pictures = []
        for row, pictures in of_shown(self.run, material, "pictures"):
            # A single picture may be larger than a WebP can be.
            if "pairs" in pictures and _fits(1, *pictures["truth"].shape[1:3]):
                rows_with_pictures.append((row, pictures))
        if not rows_with_pictures:
            return {"codecs": [], "left_out": [row.label for row in material.shown]}
        rows_alike, _ = of_same_pairs(rows_with_pictures)
        _, first = rows_alike[0]
        labels = {row.label for row, _ in rows_alike}
        count, height, width = first["truth"][:: self.step].shape[:3]
        return {
            "width": width,
            "height": height,
            "columns": _grid(count)[1],
            "wo": np.round(first["wo_deg"][:: self.step], 1).tolist(),
            "wi": np.round(first["wi_deg"][:: self.step], 1).tolist(),
            "truth": self._encoded(first["truth"]),
            "codecs": [self._codec_data(row, pictures) for row, pictures in rows_alike],
            "left_out": [row.label for row in material.shown if row.label not in labels],
            "quality": self.quality,
        }

    def _codec_data(self, row: Row, pictures: Arrays) -> dict[str, Any]:
        """A codec for the slice viewer: its label, and its pictures `decoded` and `flip` as data URLs.

        `flip` is absent where no map was stored. Where the run stored scores, there are also two lists with a number
        for each picture: `psnr` in dB (None without error), and `flips`, the mean FLIP.
        """
        data: dict[str, Any] = {"label": row.label, "decoded": self._encoded(pictures["decoded"])}
        if "flip" in pictures:
            data["flip"] = self._encoded(_magma_levels(pictures["flip"]), most_quality=FLIP_QUALITY)
        flip = row.metric(FLIP)  # the full name of the variant that scored this job
        scores = arrays(self.run.folder, row.job, "slices", names=("pairs", PSNR, flip))  # a number a scored pair
        if scores and scores.keys() >= {"pairs", PSNR}:  # a file may lack some arrays
            # Scores are of all pairs, pictures of a few: find the scores of those that are shown.
            place_of_pair = {int(pair): place for place, pair in enumerate(scores["pairs"])}
            places = [place_of_pair[int(pair)] for pair in pictures["pairs"][:: self.step]]
            squared_errors = scores[PSNR][places]  # of PSNR a run stores the mean squared error of each slice
            data["psnr"] = [_decibels(value) for value in psnr(squared_errors)]
            if flip in scores:
                data["flips"] = np.round(scores[flip][places], 4).tolist()
        return data

    def _encoded(self, pictures: np.ndarray, most_quality: int = 100) -> str:
        """Every `step`-th of the pictures (n, H, W, 3), uint8, in a grid as the data URL of one WebP.

        Its quality is that of this atlas, but at most `most_quality` unless it is without loss.
        """
        shown = pictures[:: self.step]
        count, height, width = shown.shape[:3]
        rows, columns = _grid(count)  # as `slices_of` tells the viewer
        sheet = np.zeros((rows * height, columns * width, 3), np.uint8)
        for number, picture in enumerate(shown):
            row, column = divmod(number, columns)
            top, left = row * height, column * width
            sheet[top : top + height, left : left + width] = picture
        if self.quality is None:
            # Without loss, `quality` and `method` are the effort to make the file small: here the least.
            return webp(Image.fromarray(sheet), lossless=True, quality=0, method=0)
        # Here `quality` is that of the picture, and `method` 4 is Pillow's usual effort.
        return webp(Image.fromarray(sheet), lossless=False, quality=min(most_quality, self.quality), method=4)


def _pixels(truth_shapes: Sequence[tuple[int, int, int]]) -> int:
    """The pixels of all pictures of a material: the truth once, and the answers and FLIP maps of each codec.

    `truth_shapes` has (n, H, W) of each codec's truth.
    """
    if not truth_shapes:
        return 0
    pixels_of_truth = math.prod(truth_shapes[0])  # of its n pictures together, the same for all codecs
    sets_of_pictures = 1 + 2 * len(truth_shapes)  # each codec has its answers and its FLIP maps
    return pixels_of_truth * sets_of_pictures


def _grid(count: int) -> tuple[int, int]:
    """The (rows, columns) of the grid of so many pictures, about as many of both."""
    columns = math.ceil(math.sqrt(count))
    return math.ceil(count / columns), columns


def _fits(count: int, height: int, width: int) -> bool:
    """Whether a WebP can hold the grid of so many pictures of this size."""
    rows, columns = _grid(count)
    return max(rows * height, columns * width) <= WEBP_SIDE


def _decibels(value: float) -> float | None:
    """PSNR in dB as JSON can hold it: None, so null, where it is infinite because there is no error."""
    return round(float(value), 2) if np.isfinite(value) else None


def webp(picture: Image.Image, **options: Any) -> str:
    """A picture as the data URL of a WebP; `options` are those of Pillow's encoder."""
    file = io.BytesIO()
    picture.save(file, "webp", **options)
    return "data:image/webp;base64," + base64.b64encode(file.getvalue()).decode()


def _magma_levels(maps: np.ndarray) -> np.ndarray:
    """Maps drawn in the colours of magma, (n, H, W, 3) uint8, as grey pictures of the levels 0 to 255 of their colours.

    Grey is the same in all channels, (n, H, W, 3) uint8, and compresses better; the viewer colours it again. Magma
    grows brighter with its level, so the brightness of a colour tells its level.
    """
    luma = np.array([0.299, 0.587, 0.114])  # brightness of R, G and B, by Rec. 601
    # Because colours are rounded to 8 bits, one of magma may be a little darker than the one before it, but a search
    # needs ascending values.
    brightness_of_level = np.maximum.accumulate(MAGMA @ luma)
    brightness = maps @ luma - 1e-6  # less a margin for rounding, so that a colour finds its own level, not the next
    levels = np.searchsorted(brightness_of_level, brightness)
    grey = np.minimum(levels, 255).astype(np.uint8)  # a colour brighter than all of magma would be level 256
    return grey[..., None].repeat(3, -1)
