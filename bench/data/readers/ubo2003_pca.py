"""UBO2003 materials as a local PCA in PNGs: blocks of adjacent views, each a sum of eight products of texels and pairs.

In a block, the picture of a pair is the sum of eight components (pictures that all its pairs share), each times a
weight of the pair and colour, and times the component's singular value in the block.

A folder holds `meta.json`, `0.png` … `7.png` and `R.png`, all RGBA of 8 bits with their bytes in order. Picture j has
component j of each block: the texels of block 0 row by row, then those of block 1. The first pixels of R.png have, for
each column ((view in block · lights + light) · 3 + colour) of a block, its eight weights; then come the singular values
of all blocks, two a pixel. Byte b is b / 255 · 2 − 1, a singular value 10 · b + 0.1 · c of two bytes.

Format: server/SplitVersions of https://github.com/sotnychenko/xml3d-btf, and the shaders there that read it.
"""

import json
import re
import warnings
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from bench.btf import BTF, Array, Source
from bench.data.readers.checks import PHOTOGRAPHED
from bench.data.readers.files import HEAD, Candidate, FolderFiles
from bench.data.readers.orientation import pillow_image
from bench.data.readers.pictures import picture_size
from bench.directions.hemisphere import product, ubo2003
from bench.inputs.errors import InputError, readable
from bench.metrics.display import decode_srgb

NOTES, WEIGHTS = "meta.json", "R.png"
COMPONENTS, VIEWS, LIGHTS = 8, 81, 81  # components of a block; views and lights of the whole
TOGETHER = 3  # adjacent views of a block
BLOCKS = VIEWS // TOGETHER
COLUMNS = TOGETHER * LIGHTS * 3  # of a block: a red, a green and a blue one for each of its pairs
BYTES_A_PIXEL = 4  # RGBA
# The pixels of R.png that hold data: a byte for each weight, and two for each singular value.
PIXELS = BLOCKS * COLUMNS * COMPONENTS // BYTES_A_PIXEL + BLOCKS * COMPONENTS * 2 // BYTES_A_PIXEL
KNOWN = {"numComp": COMPONENTS, "numDirections": VIEWS, "blockSize": TOGETHER}  # the values that `meta.json` must have
# Bytes 24 and 25 of a PNG, in its first chunk, are the bits a channel and the type of colour; type 6 is RGBA.
PNG_FORMAT = slice(24, 26)
RGBA_OF_8_BITS = b"\x08\x06"
FIELD = b'"numComp"'  # the field that tells this format's `meta.json` from others
MAX_NOTES = 1 << 16  # bytes of `meta.json`
MAX_SIZE = 1024  # texels a side
AT_ONCE = 1 << 16  # scattered values that are computed at once, so that their weights need little memory
# A clone of the repository has folders NAME/3_8, named by block size and components.
SPLIT = re.compile(r"\d{1,3}_\d{1,3}")


def opened(seen: Candidate) -> BTF | None:
    """The BTF of a folder with such a `meta.json`, of one around it (`3_8`), or of that `meta.json`, or None.

    81 views × 81 lights in the order of UBO2003, by view, then light. Opening reads `meta.json` and the headers of the
    pictures. Codes are clipped to [0, 1] and decoded as sRGB to linear Rec. 709; radiance as photographed. Raises
    `InputError` that names the file and the field.
    """
    folder = _folder_of(seen)
    if folder is None:
        return None
    files = FolderFiles(folder)
    source = LocalPCA(files, _image_size(files))
    provenance = {
        "format": "UBO2003 as local PCA",
        "source": "measured, re-coded by local PCA",
        "colour": "sRGB codes decoded to linear Rec. 709",
        "cosine": PHOTOGRAPHED,
        "clamp": "codes of the PCA clipped to [0, 1]; the photographs had 8 bits, so highlights end at 1",
        "blocks": f"{TOGETHER} adjacent views share a block of {COMPONENTS} components, and so its noise",
        "border": "not periodic: opposite borders do not meet",
        "native": {"bytes": sum(map(files.size, source.names)), "rank": COMPONENTS, "name": "local PCA"},
    }
    named_folder = folder.resolve()
    # `3_8` lies in the folder that is named after the material.
    if SPLIT.fullmatch(named_folder.name):
        named_folder = named_folder.parent
    wo, wi = product(ubo2003(), ubo2003())
    return BTF(named_folder.name, wo, wi, source, provenance=provenance)


def _folder_of(seen: Candidate) -> Path | None:
    """The folder of this format that a folder is or holds, or in which a `meta.json` lies; None for anything else."""
    if not seen.is_folder:
        is_notes = FIELD in seen.head and seen.path.name == NOTES  # the pictures lie beside it
        return seen.path.parent if is_notes else None
    inner_folders = [inner for inner in sorted(seen.path.iterdir()) if SPLIT.fullmatch(inner.name)]
    inner_folders = [inner for inner in inner_folders if (inner / NOTES).is_file()]
    for folder in [seen.path, *inner_folders[:1]]:
        files = FolderFiles(folder)
        # Other formats may have a `meta.json`, too: the weights beside it, or the field in it, show this one.
        if files.has(NOTES) and (files.has(WEIGHTS) or FIELD in files.head(NOTES, HEAD)):
            return folder
    return None


def _image_size(files: FolderFiles) -> int:
    """The side of the square picture of a pair, in texels, from `meta.json`.

    `InputError` if the file is damaged or its other fields do not have the values of `KNOWN`.
    """
    label = files.label(NOTES)
    if files.size(NOTES) > MAX_NOTES:
        raise InputError(f"{label}: it is larger than {MAX_NOTES >> 10} KiB, too large for this format: get it again")
    with readable(label):
        notes = json.loads(files.read(NOTES))
    if not isinstance(notes, dict):
        raise InputError(f"{label}: it must hold an object: get it again")
    for key, known in KNOWN.items():
        if _number(notes, key, label) != known:
            raise InputError(f"{label}: {key} = {notes[key]!r}: only {known} is read")
    size = _number(notes, "imageSize", label)
    if not 1 <= size <= MAX_SIZE:
        raise InputError(f"{label}: imageSize = {size}: it must be 1 to {MAX_SIZE}; get the file again")
    return size


def _number(notes: dict[str, Any], key: str, label: str) -> int:
    """A field of `meta.json` that is a whole number or the text of one; `InputError` for anything else."""
    text = str(notes.get(key))[:40]
    if not re.fullmatch(r"\d{1,9}", text, re.ASCII):
        raise InputError(f"{label}: {key} = {text}: it must be a whole number; get the file again")
    return int(text)


class LocalPCA(Source):
    """The components and weights of a folder, decoded at the first read and kept, and multiplied on demand.

    Slices and scattered reads are both cheap.
    """

    def __init__(self, files: FolderFiles, size: int):
        """Check by headers that every PNG exists and has the pixels that pictures of `size` texels a side need.

        `InputError` if one does not.
        """
        self.files = files
        self.shape = (size, size)
        self.count = VIEWS * LIGHTS
        self.component_names = [f"{j}.png" for j in range(COMPONENTS)]
        self.names = [*self.component_names, WEIGHTS]
        for name in self.component_names:
            height, width = self._checked_size(name)
            texels = BYTES_A_PIXEL * height * width  # each texel of a component is one byte
            if texels != BLOCKS * size * size:
                fault = f"{width} x {height} pixels are not {BLOCKS} blocks of {size} x {size} texels"
                sources = f"imageSize in {NOTES} and blocks of {TOGETHER} views"
                raise InputError(f"{files.label(name)}: {fault}, as {sources} say: get both again")
        height, width = self._checked_size(WEIGHTS)
        if height * width < PIXELS:  # it may have more: only the first ones are read
            fault = f"{width} x {height} pixels are too few: {PIXELS} hold the weights"
            raise InputError(f"{files.label(WEIGHTS)}: {fault}: get it again")

    def _checked_size(self, name: str) -> tuple[int, int]:
        """(H, W) of a picture from its header; `InputError` if it is missing, or no PNG of this format."""
        label = self.files.label(name)
        if not self.files.has(name):
            raise InputError(f"{label}: it is missing: the material has {', '.join(self.names)}; get it again")
        size = picture_size(self.files, name)
        if self.files.head(name, PNG_FORMAT.stop)[PNG_FORMAT] != RGBA_OF_8_BITS:
            raise InputError(f"{label}: it is not a PNG of 8 bits with red, green, blue and alpha: get it again")
        return size

    @cached_property
    def components(self) -> Array:
        """The components' values in bytes (blocks, texels, components) uint8; `_signed` makes numbers of them."""
        return np.stack([self._bytes(name).reshape(BLOCKS, -1) for name in self.component_names], -1)

    @cached_property
    def weights(self) -> Array:
        """Weights times singular values, float32 (blocks, pairs of a block, components, colours).

        The pairs of a block are its views · lights, the light fastest.
        """
        data = self._bytes(WEIGHTS)
        weights_end = BLOCKS * COLUMNS * COMPONENTS  # a byte each
        data_end = BYTES_A_PIXEL * PIXELS
        columns = _signed(data[:weights_end]).reshape(BLOCKS, TOGETHER * LIGHTS, 3, COMPONENTS)
        # The singular values follow, a coarse and a fine byte each.
        stored = data[weights_end:data_end].reshape(BLOCKS, COMPONENTS, 2).astype(np.float32)
        coarse, fine = stored[..., 0], stored[..., 1]
        singular = 10 * coarse + np.float32(0.1) * fine
        scaled = columns * singular[:, None, None]  # (blocks, pairs of a block, colours, components)
        return np.ascontiguousarray(scaled.swapaxes(2, 3))

    def _bytes(self, name: str) -> Array:
        """The bytes (4 · H · W,) of a PNG's pixels, row by row, R G B A; `InputError` if it is damaged or changed."""
        import png

        height, width = picture_size(self.files, name)
        with readable(self.files.label(name), "the picture is damaged; get it again"), warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of Pillow: what is wrong is an error here
            data = self.files.read(name)
            list(png.Reader(bytes=data).chunks())  # checks all checksums and the end, which Pillow passes over
            pixels = np.asarray(pillow_image(data))
            if pixels.size != BYTES_A_PIXEL * height * width:
                raise ValueError(f"{pixels.shape} pixels")
            return pixels.reshape(-1)

    def codes(self, pair: int) -> Array:
        """The sRGB codes of a pair (H, W, 3) float32, divided by 255 and not yet clipped to [0, 1]."""
        # Pairs are view-major, so those of a block's views follow each other.
        block, pair_in_block = divmod(pair, TOGETHER * LIGHTS)
        codes = _signed(self.components[block]) @ self.weights[block, pair_in_block]
        return codes.reshape(*self.shape, 3)

    def slice(self, pair: int) -> Array:
        return _linear(self.codes(pair))

    def texels(self, rows: Array, cols: Array, pairs: Array) -> Array:
        """As `Source.texels`: one matrix product for all pairs of a block."""
        out = np.empty((len(rows), len(pairs), 3), np.float32)
        block_of, pair_in_block = np.divmod(pairs, TOGETHER * LIGHTS)
        texel = rows * self.shape[1] + cols
        for block in np.unique(block_of):
            places = np.flatnonzero(block_of == block)  # where the pairs of this block stand in `pairs`
            weights = self.weights[block, pair_in_block[places]]  # (pairs, components, 3)
            # (components, pairs · 3), so that one product gives all pairs of the block.
            weights = weights.swapaxes(0, 1).reshape(COMPONENTS, -1)
            codes = _signed(self.components[block, texel]) @ weights
            out[:, places] = _linear(codes).reshape(len(texel), -1, 3)
        return out

    def gather(self, pair: Array, row: Array, col: Array) -> Array:
        """As `Source.gather`, `AT_ONCE` values at once."""
        out = np.empty((len(pair), 3), np.float32)
        for start in range(0, len(pair), AT_ONCE):
            part = slice(start, start + AT_ONCE)
            block, pair_in_block = np.divmod(pair[part], TOGETHER * LIGHTS)
            texel = row[part] * self.shape[1] + col[part]
            components = _signed(self.components[block, texel])
            out[part] = np.einsum("nk,nkc->nc", components, self.weights[block, pair_in_block])
        return _linear(out)

    def fingerprint(self) -> str:
        return self.files.digest(self.names)


def _signed(codes: Array) -> Array:
    """Numbers in [−1, 1] float32 from bytes of any shape: 0 is −1, and 255 is 1."""
    return codes.astype(np.float32) * np.float32(2 / 255) - 1


def _linear(codes: Array) -> Array:
    """Linear radiance float32 from sRGB codes divided by 255, clipped to [0, 1]."""
    return np.asarray(decode_srgb(np.clip(codes, 0, 1)), np.float32)
