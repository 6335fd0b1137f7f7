"""Makes guidance images from pictures: reads, shrinks, makes tileable, and matches the brightness of the training.

Everything up to the last step is linear Rec. 709, float32 (H, W, 3), and treated as periodic. The encoder sees the
result of the display transform: sRGB in [0, 1]. A periodic guidance image gives a tileable texture, because the
encoder is periodic, too.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from bench.data.materials.maps import make_periodic, resize
from bench.data.readers.files import FolderFiles, file_digest
from bench.data.readers.pictures import colour_note, picture_size, read_picture
from bench.inputs.errors import InputError
from bench.metrics.display import LOG_SCALE, LUMA, decode_srgb, to_display
from neubtf.autoencoder import STRIDE
from neubtf.renderer import NeuBTFMaterial

Array = np.ndarray
LARGEST = 1 << 24  # texels of a texture: 14 channels of them are 940 MB while it is made
MATCH, RADIANCE = "match", "radiance"
FRONTAL = np.array([[[0.0, 0, 1], [0, 0, 1]]])  # only the pair along the normal


@dataclass(frozen=True)
class Treatment:
    """The preparation of a picture as guidance.

    `exposure` is a factor on linear values, or `match`: the mean luminance becomes that of the material's own guidance;
    or `radiance`: the picture holds radiance in the units of the fitted BTF, like its slices.
    """

    scale: float = 1.0  # shrinks it (below 1) by area averages, or enlarges it linearly
    margin: float = 0.0  # share of each side that is blended away to make it tileable; 0: none
    exposure: str = MATCH

    def __post_init__(self) -> None:
        if not 0 < self.scale < np.inf:
            raise InputError(f"--scale {self.scale:g}: must be above 0")
        if not 0 <= self.margin <= 0.5:
            raise InputError(f"--make-tileable {self.margin:g}: must be from 0 to 0.5, at most half of a side")
        if self.exposure not in (MATCH, RADIANCE) and not 0 < _number(self.exposure) < np.inf:
            raise InputError(f"--exposure {self.exposure}: give {MATCH}, {RADIANCE}, or a factor above 0")

    def size(self, height: int, width: int) -> tuple[int, int]:
        """The size (H, W) of a shrunk picture, at least 1."""
        return max(1, round(height * self.scale)), max(1, round(width * self.scale))


def read_guidance(path: Path, treatment: Treatment, own: Tensor, exposure: float) -> tuple[Tensor, dict[str, Any]]:
    """The guidance image (1, 3, H, W), sRGB in [0, 1], of a picture file, and its provenance for a file.

    The material has a guidance image of its `own`, bytes (H, W, 3), and `exposure`, from radiance to the display. JPEG
    and PNG are decoded as sRGB; EXR and Radiance `.hdr` are linear. `InputError` if it cannot be read, and before
    reading if the texture would have more than `LARGEST` texels.
    """
    files = FolderFiles(path.parent)
    if not path.is_file():
        raise InputError(f"{path}: there is no such file: give a picture")
    size = picture_size(files, path.name)
    height, width = treatment.size(*size)
    if height * width > LARGEST:
        fits = np.floor(np.sqrt(LARGEST / (size[0] * size[1])) * 1000) / 1000
        raise InputError(
            f"{path}: it gives a texture of {width} × {height} texels, but the limit is {LARGEST:,}: "
            f"cut it, or give --scale {fits:g}"
        )
    image, factor = guidance_of(read_picture(files, path.name), treatment, own, exposure)
    provenance = {
        "guidance": path.name,
        "guidance_sha256": file_digest(path),
        "guidance_pixels": f"{size[1]} x {size[0]}",
        "guidance_factor": round(factor, 6),
        "scale": treatment.scale,
        "blended": treatment.margin,
    }
    if note := colour_note(files, path.name):
        provenance["guidance_colour"] = note
    return image, provenance


def guidance_of(picture: Array, treatment: Treatment, own: Tensor, exposure: float) -> tuple[Tensor, float]:
    """The guidance image (1, 3, H, W) of a linear picture (H, W, 3), and the factor that it was exposed with."""
    height, width = treatment.size(picture.shape[0], picture.shape[1])
    if (height, width) != picture.shape[:2]:
        # One channel at a time, because averages take double precision.
        picture = np.stack([resize(picture[..., channel], (height, width)) for channel in range(3)], -1)
    picture = blended(picture, treatment.margin)
    factor = _factor(picture, treatment.exposure, own, exposure)
    image = torch.empty(1, 3, *picture.shape[:2])
    for channel in range(3):
        image[0, channel] = torch.from_numpy(to_display(picture[..., channel], factor))
    return image, factor


def _factor(picture: Array, how: str, own: Tensor, exposure: float) -> float:
    """The factor on linear values of a picture (H, W, 3): see `Treatment.exposure`; 1 for a black one to be matched."""
    if how == RADIANCE:
        return exposure
    if how != MATCH:
        return _number(how)
    ours = float(np.maximum(picture, 0).mean((0, 1), dtype=np.float64) @ LUMA)
    theirs = float(decode_srgb(own.numpy() / 255).mean((0, 1)) @ LUMA)
    return theirs / ours if ours > 0 else 1.0


def _number(text: str) -> float:
    """The number that a text gives, or 0, which no factor can be."""
    try:
        return float(text)
    except ValueError:
        return 0.0


def blended(picture: Array, margin: float) -> Array:
    """A linear picture (H, W, 3), ≥ 0; its far margins, a share of each side, are blended into its near ones.

    The picture loses the margins, and up to three more texels, so that the autoencoder's cells fit the period.
    """
    overlap = (_overlap(picture.shape[0], margin), _overlap(picture.shape[1], margin))
    return np.maximum(make_periodic(picture, overlap), 0).astype(np.float32) if any(overlap) else picture


def _overlap(side: int, margin: float) -> int:
    """Texels of a side to blend away: the margin's, and up to three more if the rest then fits the stride."""
    least = round(side * margin)
    fitting = least + (side - least) % STRIDE
    return fitting if least and 2 * fitting <= side else least


class Seam(NamedTuple):
    """The mean gradient across a border, over the mean and over the largest of those inside."""

    of_mean: float
    of_largest: float


def seam_of(material: NeuBTFMaterial, pairs: Array) -> tuple[Seam, Seam]:
    """The seam at the left–right, and at the top–bottom border of a material, in displayed slices.

    `pairs` (n, 2, 3) are wo and wi; gradients are means over their slices. The border is compared with steps between
    two of the autoencoder's cells, larger than those within a cell; the ratios are infinite if there is no such step.
    """
    exposure = material.gain / LOG_SCALE
    slices = [to_display(material.slice(wo.tolist(), wi.tolist()).numpy(), exposure) for wo, wi in pairs]
    left_right = np.mean([_steps(each, 1) for each in slices], 0)
    top_bottom = np.mean([_steps(each, 0) for each in slices], 0)
    return _seam(left_right), _seam(top_bottom)


def _steps(picture: Array, axis: int) -> Array:
    """The mean |difference| between each column (or row) and the next, the last with the first."""
    along = np.moveaxis(picture, axis, 0)
    return np.abs(np.diff(along, axis=0, append=along[:1])).mean((1, 2))


def _seam(steps: Array) -> Seam:
    """The seam of a ring of steps, the last of which crosses the border; see `seam_of`."""
    inside = steps[STRIDE - 1 : -1 : STRIDE]  # from one cell to the next
    if not inside.any():
        return Seam(np.inf, np.inf)
    return Seam(float(steps[-1] / inside.mean()), float(steps[-1] / inside.max()))
