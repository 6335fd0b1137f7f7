"""Makes guidance images from pictures: reads, shrinks, makes tileable, and matches the brightness of the training.

Everything up to the last step is linear Rec. 709, float32 (H, W, 3), and treated as periodic. The encoder sees the
result of the display transform: sRGB in [0, 1]. A periodic guidance image gives a tileable texture, because the
encoder is periodic, too.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from bench.data.materials.maps import make_periodic, resize
from bench.data.readers.files import FolderFiles, file_digest
from bench.data.readers.pictures import colour_note, picture_size, read_picture
from bench.inputs.errors import InputError
from bench.metrics.display import LUMA, decode_srgb, to_display
from neubtf.autoencoder import STRIDE

Array = np.ndarray
LARGEST = 1 << 24  # texels of a texture: 14 channels of them are 940 MB while it is made
MATCH, RADIANCE = "match", "radiance"


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
        """Raise `InputError`, which names the option, for a value out of its range."""
        if not 0 < self.scale <= LARGEST:
            raise InputError(f"--scale {self.scale:g}: must be above 0, and at most {LARGEST:,}")
        if not 0 <= self.margin <= 0.5:
            raise InputError(f"--make-tileable {self.margin:g}: must be from 0 to 0.5, at most half of a side")
        is_factor = 0 < _number(self.exposure) < np.inf
        if self.exposure not in (MATCH, RADIANCE) and not is_factor:
            raise InputError(f"--exposure {self.exposure}: give {MATCH}, {RADIANCE}, or a finite factor above 0")

    def size(self, height: int, width: int) -> tuple[int, int]:
        """The size (H, W) of a picture of some height and width after its scaling, at least 1."""
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
    picture_height, picture_width = picture_size(files, path.name)
    height, width = treatment.size(picture_height, picture_width)
    if height * width > LARGEST:
        largest_scale = np.sqrt(LARGEST / (picture_height * picture_width))
        scale = np.floor(largest_scale * 1000) / 1000  # rounded down to three digits
        raise InputError(
            f"{path}: it gives a texture of {width} × {height} texels, but the limit is {LARGEST:,}: "
            f"cut it, or give --scale {scale:g}"
        )
    image, factor = guidance_of(read_picture(files, path.name), treatment, own, exposure)
    provenance = {
        "guidance": path.name,
        "guidance_sha256": file_digest(path),
        "guidance_pixels": f"{picture_width} x {picture_height}",
        "guidance_factor": round(factor, 6),
        "scale": treatment.scale,
        "blended": treatment.margin,
    }
    if note := colour_note(files, path.name):
        provenance["guidance_colour"] = note
    return image, provenance


def guidance_of(picture: Array, treatment: Treatment, own: Tensor, exposure: float) -> tuple[Tensor, float]:
    """The guidance image (1, 3, H, W) of a linear picture (H, W, 3), and the factor that it was exposed with.

    `own` and `exposure` are of the material, as in `read_guidance`.
    """
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


def _factor(picture: Array, method: str, own: Tensor, exposure: float) -> float:
    """The factor on linear values of a picture (H, W, 3); 1 for a black one to be matched.

    `method` is `Treatment.exposure`; `own` and `exposure` are of the material, as in `read_guidance`.
    """
    if method == RADIANCE:
        return exposure
    if method != MATCH:
        return _number(method)
    # The mean luminance of the picture, and of the material's own guidance.
    luminance = float(np.maximum(picture, 0).mean((0, 1), dtype=np.float64) @ LUMA)
    own_luminance = float(decode_srgb(own.numpy() / 255).mean((0, 1)) @ LUMA)
    return own_luminance / luminance if luminance > 0 else 1.0


def _number(text: str) -> float:
    """The number that a text gives, or 0, which no factor can be."""
    try:
        return float(text)
    except ValueError:
        return 0.0


def blended(picture: Array, margin: float) -> Array:
    """A linear picture (H, W, 3) with its far margins blended into its near ones: (h, w, 3), ≥ 0.

    A margin is a share of a side. The picture loses the margins, and up to three more texels, so that the autoencoder's
    cells fit the period. Without a margin it is returned as it is.
    """
    overlap = (_overlap(picture.shape[0], margin), _overlap(picture.shape[1], margin))
    if not any(overlap):
        return picture
    return np.maximum(make_periodic(picture, overlap), 0).astype(np.float32)


def _overlap(side: int, margin: float) -> int:
    """Texels of a side to blend away: the margin's, and up to three more for which the rest fits the stride, unless
    these would make it more than half of the side."""
    least = min(round(side * margin), side // 2)
    fitting = least + (side - least) % STRIDE
    if least > 0 and 2 * fitting <= side:  # an overlap is at most half of the side
        return fitting
    return least
