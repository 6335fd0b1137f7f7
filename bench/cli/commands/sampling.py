"""fit lobes to a codec file, so that a renderer can draw light directions from them

The lobes are a small extra part of the file (8 × 8 cells of five halves, 640 bytes). No query reads them, so answers
stay the same; renderers that draw from them, such as the plug-in for Mitsuba, have less noise. The command prints the
variance under a uniform environment, relative to drawing by the cosine.

examples:
  neubtf-bench sampling satin.nbtf -o satin-sampled.nbtf
"""

import argparse
from dataclasses import replace
from pathlib import Path

from bench.cli.commands import say_line, seed_option
from bench.cli.console import Console
from bench.codecs import container, loading
from bench.codecs.registry import make_codec
from bench.demand.mitsuba.lobes import NAME, fitted, noise
from bench.inputs.errors import FINE, InputError


def arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command to its parser."""
    add = parser.add_argument
    add("file", type=Path, help="the codec file")
    add("--cells", type=int, default=8, help="cells along each side of the texture, each with a lobe (default: 8)")
    add("--seed", type=seed_option, default=0)
    add("-o", "--out", type=Path, required=True, metavar="FILE", help="the codec file to write")


def run(options: argparse.Namespace) -> int:
    """Fit the lobes, write a file with them, and print how much they reduce the noise; returns the exit code."""
    if not 1 <= options.cells <= 64:
        raise InputError(f"--cells {options.cells}: must be from 1 to 64")
    container.refuse_other_file(options.out)
    loaded = loading.load(options.file)
    header, parts = container.read_parts(options.file)
    with Console() as console:
        lobes = fitted(loaded.material, options.cells, seed=options.seed, show=console.show)
    ratios = noise(loaded.material, lobes.float())
    whole = replace(parts, sampling={NAME: lobes}, network=loaded.network, scene=header.scene)
    written = container.save(options.out, make_codec(header.codec, header.settings), whole, header.provenance)
    print(
        f"variance under a uniform environment: {ratios.total:.3f} × that of the cosine (median {ratios.median:.3f}); "
        f"largest albedo: {ratios.largest_albedo:.2f}"
    )
    say_line(f"wrote {options.out}: {written.file_bytes:,} bytes, {written.part_bytes()['sampling']:,} of them lobes")
    return FINE
