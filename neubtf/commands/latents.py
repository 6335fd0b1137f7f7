"""draw the channels of a neural texture: a contact sheet PNG

Each channel is brought to mean 0 and variance 1, and goes through 1 / (e^(1 - c) + 1); three channels are the red, the
green and the blue of a picture, as in the NeuBTF paper.

examples:
  neubtf-bench latents brick.nbtf
  neubtf-bench latents brick.nbtf -o channels.png
"""

import argparse
from pathlib import Path

from bench.codec import Terminal
from bench.codecs import loading
from bench.codecs.scene_material import SceneMaterial
from bench.inputs.errors import FINE, InputError
from neubtf.codec import NeuBTF
from neubtf.direct import NeuBTFDirect
from neubtf.latents import draw
from neubtf.renderer import NeuBTFMaterial


def arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command to its parser."""
    parser.add_argument("file", type=Path, help="a codec file of neubtf or neubtf-direct")
    parser.add_argument("-o", "--out", type=Path, help="the PNG to write (default: the file's name with .latents.png)")


def run(options: argparse.Namespace, terminal: Terminal) -> int:
    """Draw the picture, and return the exit code. `InputError` for a file of another codec, or of several grids."""
    header, material, _ = loading.load(options.file)
    if isinstance(material, SceneMaterial):
        material = material.inner
    if header.codec not in (NeuBTF.name, NeuBTFDirect.name):
        raise InputError(f"{options.file}: it is a file of codec {header.codec}: give one of neubtf or neubtf-direct")
    if not isinstance(material, NeuBTFMaterial):
        raise InputError(f"{options.file}: its latents lie on several grids: give a file without half, quarter, offset")
    out = options.out or options.file.with_suffix(".latents.png")
    draw(material.texture, out)
    terminal.say(f"wrote {out}: {material.texture.shape[2]} channels of {material.size[0]} × {material.size[1]} texels")
    return FINE
