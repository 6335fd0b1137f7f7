"""The coefficients of `pca` as one AVIF picture: a bound on bytes without random access, as papers quote it.

A renderer cannot fetch a texel of the file: all coefficients are decoded before the first query. The picture has the k
coefficients of each texel as k grey pictures of 8 bits, one below the other. Their steps differ so that one code more
changes answers equally in each: a component that adds little spans few codes.
"""

import io
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated

import numpy as np
import torch
from PIL import Image
from torch import Tensor

from baselines.pca import PCA, PCAMaterial
from bench.btf import BTF
from bench.codec import Fit, Parts
from bench.inputs.errors import InputError
from bench.inputs.settings import Range
from bench.material import Material
from bench.training import load_texture
from bench.training.quantise import pack

MOST_SIDE = 65_535  # pixels of a side of an AVIF picture
MOST_CODE = 255
TINY = 1e-12  # least importance of a component, as a share of the largest; and the least spread, so that no step is 0


class PCAAvif(PCA):
    """Principal components whose coefficients are one AVIF picture: fewer bytes, but no access to a single texel.

    @misc{av1image2024,
      title = {{AV1} Image File Format ({AVIF})},
      author = {{Alliance for Open Media}},
      year = {2024},
      url = {https://aomediacodec.github.io/av1-avif/}
    }
    """

    name, version = "pca-avif", 1

    @dataclass(frozen=True)
    class Settings(PCA.Settings):
        quality: Annotated[int, Range(1, 100)] = 80  # of the picture, as its encoder counts it

    def encode(self, btf: BTF, fit: Fit) -> Parts:
        """The parts of `pca`, with the coefficients (H, W, k) as the bytes of a picture (k · H, W).

        `InputError` if the picture would be too large.
        """
        fitted = super().encode(btf, fit)
        parts = Parts(decoder=_on_cpu(fitted.decoder), texture=_on_cpu(fitted.texture), other=_on_cpu(fitted.other))
        values = load_texture("coefficients", parts.texture)  # (H, W, k)
        height, width, components = values.shape
        if not components:  # all texels are alike
            return parts
        if max(height * components, width) > MOST_SIDE:
            raise InputError(
                f"{components} components of {height} × {width} texels are a picture of more than {MOST_SIDE:,} pixels "
                "a side: take fewer components"
            )
        low = values.amin((0, 1))
        importance = self._importance(parts)
        spread = (values.amax((0, 1)) - low) * importance  # how much each component changes answers over the texels
        # One code more changes answers equally in each component, and all codes together cover the widest spread.
        step = spread.max().clamp_min(TINY) / MOST_CODE / importance
        codes = ((values - low) / step).round().clamp(0, MOST_CODE).to(torch.uint8)
        picture = codes.permute(2, 0, 1).flatten(0, 1).numpy()  # (k · H, W)
        texture = {
            "coefficients": torch.frombuffer(bytearray(_as_avif(picture, self.settings.quality)), dtype=torch.uint8),
            "coefficients.low": low,
            "coefficients.step": step,
            "coefficients.size": torch.tensor([height, width], dtype=torch.int32),
        }
        return Parts(decoder=parts.decoder, texture=texture, other=parts.other)

    def _importance(self, parts: Parts) -> Tensor:
        """How much a coefficient's change by 1 changes answers, (k,): the root mean square of its component."""
        material = super().decode(parts, torch.device("cpu"))
        assert isinstance(material, PCAMaterial)
        components = material.table.unflatten(1, (3, -1))[..., 1:]  # (N, 3, k): without the mean
        importance = components.square().mean((0, 1)).sqrt()
        return importance.clamp_min(TINY * float(importance.max())).clamp_min(torch.finfo(torch.float32).tiny)

    def decode(self, parts: Parts, device: torch.device) -> Material:
        """The material of a file's parts, on a device. `ValueError` if the picture is not of this size."""
        if "coefficients.low" not in parts.texture:  # without components there is no picture
            return super().decode(parts, device)
        low, step = parts.texture["coefficients.low"], parts.texture["coefficients.step"]
        height, width = parts.texture["coefficients.size"].tolist()
        data = parts.texture["coefficients"].numpy().tobytes()
        codes = torch.from_numpy(_of_avif(data, (len(low) * height, width)))
        values = codes.unflatten(0, (len(low), height)).permute(1, 2, 0) * step + low  # (H, W, k)
        texture = pack("coefficients", values, "float32")
        return super().decode(Parts(decoder=parts.decoder, texture=texture, other=parts.other), device)


def _on_cpu(tensors: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """The tensors in the memory of the processor, which makes pictures."""
    return {name: tensor.cpu() for name, tensor in tensors.items()}


def _as_avif(picture: np.ndarray, quality: int) -> bytes:
    """A grey picture (H, W) of bytes as an AVIF file, by one thread, so that machines agree."""
    file = io.BytesIO()
    grey = {"subsampling": "4:0:0", "range": "full"}
    Image.fromarray(picture).save(file, "AVIF", quality=quality, speed=2, max_threads=1, **grey)
    return file.getvalue()


def _of_avif(data: bytes, size: tuple[int, int]) -> np.ndarray:
    """The grey picture (H, W), float32, of an AVIF file. `ValueError` if it is none of this size."""
    try:
        with Image.open(io.BytesIO(data), formats=["AVIF"]) as picture:
            width, height = picture.size
            if (height, width) != size:
                raise ValueError(f"a picture of {height} × {width} pixels, not {size[0]} × {size[1]}")
            return np.asarray(picture.convert("L"), np.float32)
    except (OSError, SyntaxError, RuntimeError, Image.DecompressionBombError) as error:
        raise ValueError(f"the coefficients are no AVIF picture: {error}") from error
