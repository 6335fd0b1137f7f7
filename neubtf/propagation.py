"""Makes new neural textures of a fitted material: any guidance image in, a codec file out.

The texture is made in tiles with halos, so working memory does not grow with the picture: one pass gathers what CBAM
pools over the whole picture, and the next makes the texture.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from bench.codec import Parts, Progress, followed, silent
from bench.codecs import container, loading
from bench.codecs.container import Header
from bench.inputs.errors import InputError
from bench.metrics.display import LOG_SCALE
from bench.training.stored_texture import store_alike
from neubtf.autoencoder import HALO, STRIDE, Encoder, Pooled, read_encoder, surrounded
from neubtf.codec import NeuBTF
from neubtf.guidance import Treatment, read_guidance

TILE = 384  # texels a side, without the halo; a multiple of the stride


@dataclass(frozen=True)
class FittedMaterial:
    """A fitted material that can be guided: its file, its encoder, and its own guidance, bytes (H, W, 3)."""

    header: Header
    parts: Parts
    encoder: Encoder
    guidance: Tensor

    @classmethod
    def read(cls, path: Path) -> "FittedMaterial":
        """`InputError` for a file without autoencoder, `ContainerError` if it is damaged or of another version."""
        encoder, guidance = read_encoder(path)
        header = loading.load(path).header  # refuse a file that does not decode
        return cls(header, container.read_parts(path)[1], encoder, guidance)

    @property
    def exposure(self) -> float:
        """From radiance to the display."""
        return self.parts.other["gain"].item() / LOG_SCALE

    def guided(self, texture: Tensor) -> tuple[NeuBTF, Parts]:
        """The file of this material with another neural texture (H, W, D), and without the encoder."""
        codec = NeuBTF(**self.header.settings | {"keep_encoder": False, "scene": False})
        stored = store_alike("latents", texture, self.parts.texture)
        return codec, Parts(decoder=self.parts.decoder, texture=stored, other=self.parts.other)


def propagate(
    path: Path, picture: Path, out: Path, treatment: Treatment, show: Progress = silent, device: str = "cpu"
) -> Header:
    """Write the material of a file with a new neural texture, made from a picture; its provenance names both.

    Raises `InputError` for a file without autoencoder and a picture that cannot be read, and leaves nothing behind.
    """
    if out.exists() and out.samefile(path):
        raise InputError(f"{out}: it would replace the file that it is made from: give another name")
    source = FittedMaterial.read(path)
    guidance, provenance = read_guidance(picture, treatment, source.guidance, source.exposure)
    texture = textured(source.encoder.to(device), guidance.to(device), show)
    codec, parts = source.guided(texture)
    del texture
    return container.save(out, codec, parts, {"file_sha256": source.header.sha256} | provenance)


@torch.no_grad()
def textured(encoder: Encoder, guidance: Tensor, show: Progress = silent, tile: int = TILE) -> Tensor:
    """The neural texture (H, W, D) of a guidance image (1, 3, H, W), that of `encoder(guidance)` within rounding."""
    height, width = guidance.shape[2:]
    network = encoder.autoencoder
    windows = list(_windows(height, width, tile))
    inner = slice(HALO // STRIDE, -(HALO // STRIDE))  # cells without the halo
    pooled: Pooled | None = None
    for corner, size in followed(show, windows, "pooling", len(windows)):
        window = encoder.prepared(surrounded(guidance, corner, size))
        here = Pooled.of_cells(network.encode(window).deep[..., inner, inner])
        pooled = here if pooled is None else pooled.joined(here)
    assert pooled is not None
    texture = torch.empty(height, width, network.head.out_channels)
    for (row, col), size in followed(show, windows, "making the texture", len(windows)):
        window = encoder.prepared(surrounded(guidance, (row, col), size))
        # (h, w, D), without the halo.
        part = network.decode(network.encode(window), pooled)[0, :, HALO:-HALO, HALO:-HALO].movedim(0, -1)
        # If a side is not a multiple of the stride, texels beyond the far border are cut off.
        there = texture[row : row + size[0], col : col + size[1]]
        there.copy_(part[: there.shape[0], : there.shape[1]])
    return texture


def _windows(height: int, width: int, tile: int) -> Iterator[tuple[tuple[int, int], tuple[int, int]]]:
    """Corner and size of tiles that cover a picture, all multiples of the stride."""
    rows, cols = (-(-side // STRIDE) * STRIDE for side in (height, width))
    for row in range(0, rows, tile):
        for col in range(0, cols, tile):
            yield (row, col), (min(tile, rows - row), min(tile, cols - col))
