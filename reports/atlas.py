"""The stored slices of a run as pictures of a page: the truth of each material, each codec's answers and FLIP maps."""

import base64
import io
from collections.abc import Sequence
from typing import Any

import numpy as np
from PIL import Image

from bench.metrics.psnr import psnr
from bench.records import FLIP, PSNR, Run
from reports.artefacts import Arrays, arrays, of_shown
from reports.rows import MaterialRows, Row

BUDGET = 8_000_000  # about how many characters all pictures of a page take
# Qualities of WebP, and about how many characters a pixel then takes; None is lossless.
QUALITIES: tuple[tuple[int | None, float], ...] = ((None, 2.6), (92, 0.9), (80, 0.5), (60, 0.3))


class Atlases:
    """The slices of all materials of a run, all of one quality, chosen by the number of pixels."""

    def __init__(self, run: Run, materials: Sequence[MaterialRows]):
        self.run = run
        self.quality, self.step = None, 1
        pixels = sum(self._pixels(material) for material in materials)
        self.quality, per_pixel = next((q for q in QUALITIES if q[1] * pixels <= BUDGET), QUALITIES[-1])
        self.step = max(1, -int(-per_pixel * pixels // BUDGET))  # show every n-th pair

    def _pixels(self, material: MaterialRows) -> int:
        if not material.shown or not (first := arrays(self.run.folder, material.shown[0].job, "pictures", ("truth",))):
            return 0
        return int(np.prod(first["truth"].shape[:3])) * (2 * len(material.shown) + 1)

    def slices_of(self, material: MaterialRows) -> dict[str, Any]:
        """The data of a material for the slice viewer; `codecs` is empty if nothing is stored.

        Pictures are data URLs of all pairs in a grid, `columns` wide. `left_out` lists codecs without the same pairs.
        """
        known = [each for each in of_shown(self.run, material, "pictures") if "pairs" in each[1]]
        if not known:
            return {"codecs": [], "left_out": [row.label for row in material.shown]}
        first = known[0][1]
        same = [(row, pictures) for row, pictures in known if np.array_equal(pictures["pairs"], first["pairs"])]
        labels = {row.label for row, _ in same}
        count, height, width = first["truth"][:: self.step].shape[:3]
        return {
            "width": width,
            "height": height,
            "columns": _columns(count),
            "wo": np.round(first["wo_deg"][:: self.step], 1).tolist(),
            "wi": np.round(first["wi_deg"][:: self.step], 1).tolist(),
            "truth": self._encoded(first["truth"]),
            "codecs": [self._codec(row, pictures) for row, pictures in same],
            "left_out": [row.label for row in material.shown if row.label not in labels],
            "quality": self.quality,
        }

    def _codec(self, row: Row, pictures: Arrays) -> dict[str, Any]:
        data = {"label": row.label, "decoded": self._encoded(pictures["decoded"])}
        if "flip" in pictures:
            data["flip"] = self._encoded(pictures["flip"])
        return data | self._numbers(row, pictures)

    def _numbers(self, row: Row, pictures: Arrays) -> dict[str, Any]:
        """PSNR and FLIP of each shown slice, from the stored numbers; null without error."""
        name = row.metric(FLIP)
        scores = arrays(self.run.folder, row.job, "slices", ("pairs", PSNR, name))
        if not scores:
            return {}
        place = {int(pair): i for i, pair in enumerate(scores["pairs"])}
        rows = [place[int(pair)] for pair in pictures["pairs"][:: self.step]]
        error = scores[PSNR][rows]
        numbers = {"psnr": [round(float(each), 2) if np.isfinite(each) else None for each in psnr(error)]}
        return numbers | ({"flips": np.round(scores[name][rows], 4).tolist()} if name in scores else {})

    def _encoded(self, pictures: np.ndarray) -> str:
        """Pictures (n, H, W, 3) as one WebP in a grid."""
        pictures = pictures[:: self.step]
        count, height, width = pictures.shape[:3]
        columns = _columns(count)
        sheet = np.zeros((-(-count // columns) * height, columns * width, 3), np.uint8)
        for i, picture in enumerate(pictures):
            top, left = i // columns * height, i % columns * width
            sheet[top : top + height, left : left + width] = picture
        out = io.BytesIO()
        how: dict[str, Any] = {"lossless": True, "quality": 0} if self.quality is None else {"quality": self.quality}
        Image.fromarray(sheet).save(out, "webp", method=0, **how)
        return "data:image/webp;base64," + base64.b64encode(out.getvalue()).decode()


def _columns(count: int) -> int:
    return int(np.ceil(np.sqrt(count)))
