"""decode a codec file into slices: a folder of EXR pictures with pairs.csv

examples:
  neubtf-bench decode satin.nbtf -o slices
  neubtf-bench decode satin.nbtf --like satin -o slices
"""

import argparse
from pathlib import Path

from bench.cli.commands import usable_device
from bench.errors import FINE, InputError


def arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("file", type=Path)
    parser.add_argument("--like", help="decode the pairs of this BTF (a built-in material or a path)")
    parser.add_argument("--directions", default="ubo2003", help="else the product of this set's directions …")
    parser.add_argument("--count", type=int, default=9, help="… thinned to this many a side (default: 9)")
    parser.add_argument("--device", default="cpu")
    parser.add_argument("-o", "--out", type=Path, required=True, help="the folder to write")


def run(options: argparse.Namespace) -> int:
    from bench.btf import BTF
    from bench.cli.console import Console
    from bench.codecs.loading import DecodedSource, load
    from bench.data.convert import write_btf
    from bench.data.open import open_named
    from bench.errors import did_you_mean
    from bench.hemisphere import DIRECTION_SETS, thinned_product

    header, material, _ = load(options.file, usable_device(options.device))
    with Console() as console:
        if options.like:
            like = open_named(options.like, {}, console.show)
            wo, wi = like.wo, like.wi
        else:
            if options.directions not in DIRECTION_SETS:
                hint = did_you_mean(options.directions, DIRECTION_SETS)
                raise InputError(f"--directions {options.directions}: no such set{hint}")
            directions = DIRECTION_SETS[options.directions]()
            if not 1 <= options.count <= len(directions):
                raise InputError(f"--count {options.count}: must be between 1 and {len(directions)}")
            wo, wi = thinned_product(directions, options.count, options.count)
        source = DecodedSource(material, wo, wi, header.sha256)
        write_btf(BTF(options.file.stem, wo, wi, source), options.out)
    console.say(f"{len(wo)} slices of {material.size[0]} × {material.size[1]} in {options.out}")
    return FINE
