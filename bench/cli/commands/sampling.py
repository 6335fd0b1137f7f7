"""fit lobes to a codec file, from which a renderer draws light directions

The lobes are a small part of their own (8 × 8 cells of five halves, 640 bytes). No query reads them, so quality and
answers stay the same; renderers that draw from them, as the plug-in for Mitsuba, have less noise. Prints the variance
beside that of drawing by the cosine, under a uniform environment.

examples:
  neubtf-bench sampling satin.nbtf -o satin-sampled.nbtf
"""

import argparse
from pathlib import Path

from bench.errors import FINE, InputError


def arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("file", type=Path, help="the codec file")
    parser.add_argument(
        "--cells", type=int, default=8, help="cells a side of the texture, each with a lobe (default: 8)"
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("-o", "--out", type=Path, required=True, metavar="FILE", help="the codec file to write")


def run(options: argparse.Namespace) -> int:
    from dataclasses import replace

    from bench.cli.console import Console
    from bench.codecs import container, loading
    from bench.codecs.registry import make_codec
    from bench.demand.mitsuba.lobes import NAME, fitted, noise

    if not 1 <= options.cells <= 64:
        raise InputError(f"--cells {options.cells}: must be from 1 to 64")
    loaded = loading.load(options.file)
    header, parts = container.read_parts(options.file)
    with Console() as console:
        lobes = fitted(loaded.material, options.cells, seed=options.seed, show=console.show)
    ratios = noise(loaded.material, lobes.float())
    whole = replace(parts, sampling={NAME: lobes}, network=loaded.network, scene=header.scene)
    written = container.save(options.out, make_codec(header.codec, header.settings), whole, header.provenance)
    print(
        f"variance under a uniform environment: {ratios.total:.3f} × that of the cosine (median {ratios.median:.3f}); "
        f"most reflected: {ratios.largest_albedo:.2f} of what arrives"
    )
    print(f"wrote {options.out}: {written.file_bytes:,} bytes, {written.part_bytes()['sampling']:,} of them lobes")
    return FINE
