"""show what a codec file or a BTF holds

examples:
  neubtf-bench info satin.nbtf
  neubtf-bench info material.btf --picture material.png
"""

import argparse
from pathlib import Path

from bench.cli.commands import read_as, reading_options, say_line
from bench.cli.console import btf_lines, file_lines
from bench.codecs.container import read_header
from bench.data.open import open_named
from bench.data.portrait import draw, look
from bench.inputs.errors import FINE, InputError


def arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("path")
    reading_options(parser)
    parser.add_argument("--picture", type=Path, metavar="OUT.png", help="draw a BTF: directions, values, contact sheet")


def run(options: argparse.Namespace) -> int:
    path = Path(options.path)
    if path.is_file() and _is_codec_file(path):
        if options.picture:
            raise InputError(f"{path}: --picture draws a BTF, and this is a codec file: decode it and draw the result")

        print(file_lines(read_header(path)))
        return FINE

    portrait = look(open_named(options.path, read_as(options)))
    print(btf_lines(portrait))
    if options.picture:
        draw(portrait, options.picture)
        say_line(f"wrote {options.picture}")
    return FINE


def _is_codec_file(path: Path) -> bool:
    """A safetensors file begins with its header's length and an opening brace."""
    with open(path, "rb") as file:
        start = file.read(9)
    return path.suffix == ".nbtf" or (len(start) == 9 and start[8:] == b"{" and start[4:8] == b"\0" * 4)
