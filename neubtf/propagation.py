"""Makes new neural textures of a fitted material: any guidance image in, a codec file out.

The texture is made in tiles with halos, so working memory does not grow with the picture: one pass gathers what CBAM
pools over the whole picture, and the next makes the texture.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from torch import Tensor

from bench.codec import Parts, Progress, followed, silent
from bench.codecs import container, loading
from bench.codecs.container import Header
from bench.inputs.errors import InputError
from bench.metrics.display import LOG_SCALE
from bench.training.stored_texture import store_alike
from neubtf.autoencoder import HALO, STRIDE, Encoder, Pooled, read_encoder, rounded_up, surrounded
from neubtf.codec import NeuBTF
from neubtf.guidance import Treatment, read_guidance
from neubtf.renderer import on_grids

TILE = 384  # texels a side, without the halo; a multiple of the stride


@dataclass(frozen=True)
class FittedMaterial:
    """A fitted material of which new textures can be made: its file, its encoder, and its own guidance.

    The guidance has bytes (H, W, 3).
    """

    header: Header
    parts: Parts
    encoder: Encoder
    guidance: Tensor

    @classmethod
    def read(cls, path: Path) -> "FittedMaterial":
        """The material of a file of codec neubtf.

        Raises `InputError` for a file without autoencoder, `ContainerError` if it is damaged or of another version.
        """
        header = loading.load(path).header  # refuse a file that does not decode
        encoder, guidance = read_encoder(path)
        _, parts = container.read_parts(path)
        return cls(header, parts, encoder, guidance)

    @property
    def exposure(self) -> float:
        """The factor from radiance to linear values of the display."""
        return self.parts.other["gain"].item() / LOG_SCALE

    def guided(self, texture: Tensor) -> tuple[NeuBTF, Parts]:
        """The codec and the parts of a file of this material with another neural texture (H, W, C).

        The file has no encoder, and is of no scene: the new texture is fitted to none.
        """
        codec = NeuBTF(**self.header.settings | {"keep_encoder": False, "scene": False})
        stored_texture: dict[str, Tensor] = {}
        for name, grid in on_grids(texture, codec.settings.latents).items():
            stored_texture |= store_alike(name, grid, self.parts.texture)
        return codec, replace(self.parts, texture=stored_texture, encoder={})


def propagate(
    path: Path, picture: Path, out: Path, treatment: Treatment, show: Progress = silent, device: str = "cpu"
) -> Header:
    """Write the material of a file with a new neural texture, made from a picture, to `out`; its header names both.

    `device` is where the texture is made. Raises `InputError`, and writes nothing, if `out` is the file itself, if that
    holds no autoencoder, or if the picture cannot be read; `ContainerError` if the file is damaged.
    """
    source = FittedMaterial.read(path)
    if out.exists() and out.samefile(path):
        raise InputError(f"{out}: it would replace the file that it is made from: give another name")
    guidance, provenance = read_guidance(picture, treatment, source.guidance, source.exposure)
    texture = textured(source.encoder.to(device), guidance.to(device), show)
    codec, parts = source.guided(texture)
    del texture  # up to a gigabyte, of which `parts` has the codes
    return container.save(out, codec, parts, {"file_sha256": source.header.sha256} | provenance)


@torch.no_grad()
def textured(encoder: Encoder, guidance: Tensor, show: Progress = silent, tile: int = TILE) -> Tensor:
    """The neural texture (H, W, C) of a guidance image (1, 3, H, W), made in tiles of `tile` texels a side.

    Within rounding it is that of `encoder(guidance)`.
    """
    height, width = guidance.shape[2:]
    network = encoder.autoencoder
    tiles = list(_tiles(height, width, tile))
    inner_cells = slice(HALO // STRIDE, -(HALO // STRIDE))  # without the halo
    pooled: Pooled | None = None
    for corner, size in followed(show, tiles, "pooling", len(tiles)):
        window = encoder.prepared(surrounded(guidance, corner, size))
        pooled_tile = Pooled.of_cells(network.encode(window).deep[..., inner_cells, inner_cells])
        pooled = pooled_tile if pooled is None else pooled.joined(pooled_tile)
    assert pooled is not None
    texture = torch.empty(height, width, network.head.out_channels)
    for (row, col), size in followed(show, tiles, "making the texture", len(tiles)):
        window = encoder.prepared(surrounded(guidance, (row, col), size))
        with_halo = network.decode(network.encode(window), pooled)[0]  # (D, h, w)
        tile_texture = with_halo[:, HALO:-HALO, HALO:-HALO].movedim(0, -1)  # (h, w, D)
        # If a side is not a multiple of the stride, texels beyond the far border are cut off.
        target = texture[row : row + size[0], col : col + size[1]]
        target.copy_(tile_texture[: target.shape[0], : target.shape[1]])
    return texture


def _tiles(height: int, width: int, tile: int) -> Iterator[tuple[tuple[int, int], tuple[int, int]]]:
    """The corner (row, column) and the size (rows, columns) of tiles that cover a picture, all multiples of the stride.

    `tile` is the side of a whole one, in texels. The last tiles may be smaller, and reach beyond the picture.
    """
    rows, cols = rounded_up(height), rounded_up(width)
    for row in range(0, rows, tile):
        for col in range(0, cols, tile):
            yield (row, col), (min(tile, rows - row), min(tile, cols - col))
