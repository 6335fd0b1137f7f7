"""decode a codec file into slices (EXR and pairs.csv), or one of svbrdf into its maps

examples:
  neubtf-bench decode satin.nbtf -o decoded
  neubtf-bench decode satin.nbtf --like satin -o slices
  neubtf-bench decode satin.nbtf --maps -o satin_maps
"""

import argparse
from pathlib import Path

from bench.btf import BTF, Array
from bench.cli.commands import read_as, reading_options, say_line, usable_device
from bench.cli.console import Console
from bench.codecs.loading import DecodedSource, load
from bench.data.convert import write_btf, write_maps
from bench.data.open import open_named
from bench.directions.hemisphere import DIRECTION_SETS, thinned_product
from bench.inputs.errors import FINE, InputError, did_you_mean
from bench.material import Material

# The pairs that are decoded if no option says which: so many views, and lights, of this set of directions.
DIRECTIONS = "ubo2003"
COUNT = 9


def arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command to its parser."""
    add = parser.add_argument
    add("file", type=Path)
    add("--like", help="decode at the pairs of this BTF (a built-in material or a path)")
    add("--directions", help=f"without --like and --maps: the set of directions (default: {DIRECTIONS})")
    add("--count", type=int, help=f"without --like and --maps: how many views, and lights, of it (default: {COUNT})")
    add("--maps", action="store_true", help="write its PBR maps as PNG instead (only files of svbrdf)")
    add("--device", default="cpu")
    reading_options(parser)
    add("-o", "--out", type=Path, required=True, help="the folder to write")


def run(options: argparse.Namespace) -> int:
    """Decode the file into slices, or into maps with --maps, and write them; returns the exit code."""
    if options.like or options.maps:
        for name in ("directions", "count"):
            if getattr(options, name) is not None:
                raise InputError(f"--{name}: not with --like or --maps: leave it out")
    if options.like and options.maps:
        raise InputError("--maps: not with --like: give only one of them")
    header, material, _ = load(options.file, usable_device(options.device))
    if options.maps:
        return _decode_maps(options, material, header.codec)
    with Console() as console:
        if options.like:
            like = open_named(options.like, read_as(options), console.show)
            wo, wi = like.wo, like.wi
        else:
            wo, wi = _pairs(options)
        source = DecodedSource(material, wo, wi, header.sha256)
        write_btf(BTF(options.file.stem, wo, wi, source), options.out)
    console.say(f"{len(wo)} slices of {material.size[0]} × {material.size[1]} in {options.out}")
    return FINE


def _decode_maps(options: argparse.Namespace, material: Material, codec: str) -> int:
    """Write the maps of a material of svbrdf as pictures; returns the exit code.

    `InputError` if the material, of the codec named `codec`, has none.
    """
    maps, factor = material.maps()
    if not maps:
        raise InputError(f"--maps: {options.file} is of codec {codec}, which has no maps: leave it out")
    write_maps({f"{options.file.stem}_{name}": picture for name, picture in maps.items()}, options.out)
    say_line(f"{', '.join(maps)} in {options.out}; the radiance of the file is {factor:.6g} times what they reflect")
    return FINE


def _pairs(options: argparse.Namespace) -> tuple[Array, Array]:
    """Directions wo and wi (N, 3) float32 of --count views × --count lights of the set --directions.

    `InputError` for an unknown set, or a count below 1 or above its directions.
    """
    name = DIRECTIONS if options.directions is None else options.directions
    count = COUNT if options.count is None else options.count
    if name not in DIRECTION_SETS:
        raise InputError(f"--directions {name}: no such set{did_you_mean(name, DIRECTION_SETS)}")
    directions = DIRECTION_SETS[name]()
    if not 1 <= count <= len(directions):
        raise InputError(f"--count {count}: must be between 1 and {len(directions)}")
    return thinned_product(directions, count, count)
