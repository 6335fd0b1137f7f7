"""render a folder of PBR maps (ambientCG, Poly Haven, glTF, Substance) as a BTF

examples:
  neubtf-bench bake Bricks076_2K -o bricks.npz
  neubtf-bench bake scan --map albedo=photo.png --map roughness=grey.png -o scan.npz
  neubtf-bench bake Bricks076_2K --size 128 --views 49 --lights 49 --depth 0.05 -o bricks.npz
"""

import argparse
import time
from pathlib import Path

from bench.cli.commands import assignments, seed_option
from bench.cli.console import Console
from bench.data.bake import bake, read_surface, recognise, size_note, table
from bench.data.spec import Preparation
from bench.demand.mitsuba import load_path_tracer
from bench.inputs.errors import FINE, InputError


def arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command to its parser."""
    add = parser.add_argument
    add("folder", type=Path)
    add("--size", type=int, default=64, help="texels of the longer side (default: 64)")
    add("--directions", default="ubo2003", help="the published set of directions (default: ubo2003)")
    add("--views", type=int, default=25, help="how many views of the set to use (default: 25)")
    add("--lights", type=int, default=25, help="how many lights of the set to use (default: 25)")
    add("--heldout", type=int, default=150, help="how many random pairs to hold out (default: 150)")
    add("--depth", type=float, help="height of white over black in the displacement, in picture widths")
    help_of_map = "say which file a map is, whatever its name: albedo, normal_gl, roughness, … (repeatable)"
    add("--map", action="append", default=[], metavar="MAP=FILE", help=help_of_map)
    add("--seed", type=seed_option, default=0, help="seed of the held-out pairs and of Mitsuba's paths (default: 0)")
    help_of_renderer = "builtin: direct light (default); mitsuba: paths with inter-reflections"
    add("--renderer", default="builtin", choices=["builtin", "mitsuba"], help=help_of_renderer)
    add("-o", "--out", type=Path, required=True, help="the .npz file, or the folder of EXR pictures, to write")


def run(options: argparse.Namespace) -> int:
    """Bake the maps and write the BTF; returns the exit code."""
    path_tracer = load_path_tracer() if options.renderer == "mitsuba" else None
    data = Preparation(options.size, options.directions, options.views, options.lights, options.heldout)
    with Console() as console:
        maps = recognise(options.folder, _files_of_maps(options.map))
        surface = read_surface(maps, data.size, options.depth)
        console.say(f"{options.folder}, baked at {size_note(surface)}:\n{table(surface)}")
        start = time.perf_counter()
        bake(surface, data, options.out, console.show, options.seed, path_tracer)
        seconds = time.perf_counter() - start
    pairs = data.views * data.lights + data.heldout
    console.say(f"{pairs} slices of {surface.shape[0]} × {surface.shape[1]} in {options.out}, in {seconds:.0f} s")
    texels = max(surface.full_shape)
    if texels > max(surface.shape):
        times = (texels / max(surface.shape)) ** 2
        console.say(f"--size {texels} would keep all texels of the maps, and take {times:.0f} times as long")
    return FINE


def _files_of_maps(words: list[str]) -> dict[str, str]:
    """The files of `--map MAP=FILE` by map."""
    form = "MAP=FILE, such as albedo=photo.png"
    file_of_map = assignments(words, "--map", form)
    for role, file in file_of_map.items():
        if not file:
            raise InputError(f"--map {role}=: write {form}")
    return file_of_map
