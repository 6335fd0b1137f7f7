"""write a BTF as .npz or EXR pictures, if wanted cut, shrunk or thinned

examples:
  neubtf-bench convert material.btf --thin 1000 -o thinned.npz
  neubtf-bench convert material.btf --crop 0,0,128,128 --downsample 2 -o small
"""

import argparse
from pathlib import Path

from bench.cli.commands import read_as, reading_options
from bench.cli.console import Console
from bench.data.convert import changed, check_place, write_btf
from bench.data.open import open_named
from bench.inputs.errors import FINE


def arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command to its parser."""
    add = parser.add_argument
    add("btf", help="a built-in material or the path of a BTF")
    add("--thin", type=int, default=0, metavar="COUNT", help="keep about COUNT pairs, spread evenly in angle")
    add("--crop", type=_window, metavar="ROW,COL,HEIGHT,WIDTH", help="keep this window of texels")
    add("--downsample", type=int, default=1, metavar="FACTOR", help="average FACTOR² texels into one")
    reading_options(parser)
    add("-o", "--out", type=Path, required=True, help="the .npz file, or the folder of EXR pictures, to write")


def run(options: argparse.Namespace) -> int:
    """Read a BTF, cut it as the options say, and write it; returns the exit code."""
    check_place(options.out)
    with Console() as console:
        opened = open_named(options.btf, read_as(options), console.show)
        btf = changed(opened, options.crop, options.downsample, options.thin)
        write_btf(btf, options.out, console.show)
    console.say(f"{len(btf)} slices of {btf.shape[0]} × {btf.shape[1]} in {options.out}")
    return FINE


def _window(text: str) -> tuple[int, int, int, int]:
    """Row, column, height and width of `--crop`, in texels."""
    try:
        row, col, height, width = (int(number) for number in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text}: write four whole numbers with commas, as 0,0,128,128") from None
    return row, col, height, width
