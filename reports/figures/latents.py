"""The channels of each codec's texture, as pictures of the texels.

A decoder looks up learned numbers, the *channels*, at each texel. They are found in the *steps* of a job's program.
Where a program looks up coarser levels of a texture as well, the levels are a *pyramid*: each halves both sides of the
one before.
"""

import math
from itertools import accumulate

import numpy as np

from bench.inputs.errors import InputError
from bench.program import Program
from bench.records import Job, Run
from reports.artefacts import program
from reports.figures.canvas import Figure, Sheet, enlarged, factor_to, of_each_material, short
from reports.rows import MaterialRows

# In pixels: about the side of a channel's picture, between pictures, the margin with the labels, and the head.
_CELL = 64
_GAP = 4
_LEFT = 250
_TOP = 52

_LINE = 16  # channels a line
_MOST = 48  # channels shown of a codec

Textures = list[np.ndarray]  # of one program, (H, W, channels) each


@of_each_material
def latent_channels(run: Run, material: MaterialRows) -> Figure | None:
    """The channels of the textures that the first seed's decoders read, a block a codec, at most `_MOST` of each.

    None if no codec has a texture.
    """
    blocks = []  # of each codec: its label, its channels in words, and their pictures (n, h, w)
    for row in material.shown:
        found = _textures_of_job(run, row.job)
        if found:
            blocks.append((row.label, _channels_in_words(found), _cells(np.concatenate(found, -1))))
    if not blocks:
        return None
    title = f"{material.name}: channels of each codec's texture"
    cell = max(max(cells.shape[1:]) for _, _, cells in blocks) + _GAP  # all have the room of the largest
    lines = sum(_line_count(cells) for _, _, cells in blocks)
    sheet = Sheet(_LEFT + _LINE * cell + _GAP, _TOP + lines * (cell + _GAP))
    sheet.text(_GAP, 14, f"{title} ({material.split_in_words})", fontsize=10)
    sheet.text(_GAP, 34, "each channel at mean 0 and variance 1, through a sigmoid: black to white", color="0.35")
    top = _TOP
    for label, channels_in_words, cells in blocks:
        sheet.text(_GAP, top + 12, short(label, 40))
        sheet.text(_GAP, top + 28, channels_in_words, color="0.35")
        for number, picture in enumerate(cells):
            line, column = divmod(number, _LINE)
            grey = picture[..., None].repeat(3, axis=-1)  # (h, w, 3)
            sheet.picture(_LEFT + column * cell, top + line * cell, grey)
        top += _line_count(cells) * (cell + _GAP)
    return Figure(material.name, "latents", title, sheet.png("L"), sheet)


def _line_count(cells: np.ndarray) -> int:
    """How many lines the pictures (n, h, w) of a codec's channels take."""
    return math.ceil(len(cells) / _LINE)


def _channels_in_words(textures: Textures) -> str:
    """The numbers of channels of some textures in words: "8 + 4 channels"; and how many are shown, if not all."""
    counts = [texture.shape[-1] for texture in textures]
    plural = "s" if sum(counts) > 1 else ""
    more = f", {_MOST} shown" if sum(counts) > _MOST else ""
    return f"{' + '.join(map(str, counts))} channel{plural}{more}"


def _textures_of_job(run: Run, job: Job) -> Textures:
    """The textures of the program that a job stored as its `drawing`; none if that is missing or unreadable."""
    try:
        return textures(program(run.folder / job["drawing"]))
    except (InputError, KeyError):  # the records of a run are useful without its large files
        return []


def textures(program: Program) -> Textures:
    """The textures (H, W, D) of a program: the tables that it looks up at places, of a pyramid the finest level.

    A table (rows, D) is a texture if it has a row for each texel of one level, or of several levels of a pyramid, the
    finest first, and if `uv` decides which rows are read. A table of directions may have as many rows by chance.
    """
    height, width = program.size
    # Each level of a pyramid halves both sides, down to a single texel.
    count = max(height, width).bit_length()
    levels = [max(1, height >> level) * max(1, width >> level) for level in range(count)]  # texels of each
    texels = list(accumulate(levels))  # of the finest level, of the two finest, and so on
    by_place = {"uv"}  # the names of values that depend on uv, so far
    different: Textures = []
    for step in program.steps:
        names = step.names()
        if by_place.isdisjoint(names):  # nothing that it takes depends on uv
            continue
        by_place.add(step.name)
        if "embedding" not in step.operation:  # only these look up rows of a table
            continue
        for name in names & program.constants.keys():
            table = program.constants[name]
            if table.ndim != 2 or len(table) not in texels:  # no texture, see above
                continue
            texture = table[: height * width].reshape(height, width, -1)
            # Several steps may look up one texture.
            if not any(np.array_equal(texture, other) for other in different):
                different.append(texture)
    return different


def _grey_levels(texture: np.ndarray) -> np.ndarray:
    """A texture (H, W, D) as grey levels, uint8: each channel at mean 0 and variance 1, through a sigmoid."""
    flat = texture.reshape(-1, texture.shape[-1]).astype(np.float64)
    deviation = flat.std(0)
    deviation[deviation <= 1e-6 * abs(flat).max(0)] = np.inf  # a channel that is constant, but for rounding, is grey
    standardised = (flat - flat.mean(0)) / deviation
    grey = 255 / (1 + np.exp(-standardised))
    return np.round(grey).astype(np.uint8).reshape(texture.shape)


def _cells(texture: np.ndarray) -> np.ndarray:
    """The first `_MOST` channels of a texture (H, W, D) as pictures (n, h, w), uint8, of about `_CELL` pixels a side.

    A large texture is averaged over squares of texels, without a rest at its edges, and a small one is enlarged.
    """
    grey = _grey_levels(texture[..., :_MOST])
    height, width, count = grey.shape
    factor = max(height, width) // _CELL
    if factor > 1:
        factor = min(factor, height, width)  # a long, narrow texture keeps at least one row and column
        rows, columns = height // factor, width // factor
        squares = grey[: rows * factor, : columns * factor].reshape(rows, factor, columns, factor, count)
        grey = squares.mean((1, 3)).astype(np.uint8)
    return enlarged(grey, factor_to(_CELL, grey.shape[:2])).transpose(2, 0, 1)
