"""write a codec file as a shader (GLSL, HLSL, WGSL, Slang), or with lobes to sample

The folder holds one function, `material(uv, wo, wi, footprint)`, two textures and a README of conventions and of
answers to check a copy by. For GLSL it also holds a whole fragment shader around the function, which compiles as it is;
for Slang the weights of the network, whose layers are cooperative vectors in 16-bit floats.

With --lobes it writes the codec file again, with lobes fitted to it that a renderer can draw light directions from: a
small extra part (8 × 8 cells of five halves, 640 bytes). No query reads them, so answers stay the same; renderers that
draw from them, such as the plug-in for Mitsuba, have less noise. The command prints the variance under a uniform
environment, relative to drawing by the cosine.

examples:
  neubtf-bench export satin.nbtf --format wgsl -o satin-wgsl
  neubtf-bench export satin.nbtf --lobes -o satin-lobes.nbtf
"""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

from bench.cli.commands import say_line
from bench.cli.console import Console
from bench.codecs import container
from bench.codecs.loading import Loaded, load
from bench.codecs.registry import make_codec
from bench.demand.mitsuba.lobes import NAME, fitted, noise
from bench.directions.hemisphere import uniform
from bench.inputs.errors import FINE, InputError
from bench.material import Material
from bench.program.recording import program_of
from reports.shaders.export import Vectors, export


def arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command to its parser."""
    parser.add_argument("file", type=Path, help="the codec file")
    kind = parser.add_mutually_exclusive_group()
    languages = ("glsl", "hlsl", "wgsl", "slang")
    kind.add_argument("--format", choices=languages, default="glsl", help="language (default: glsl)")
    kind.add_argument("--lobes", action="store_true", help="write a codec file with lobes to draw directions from")
    parser.add_argument("-o", "--out", type=Path, required=True, help="the folder to write, or with --lobes the file")


def run(options: argparse.Namespace) -> int:
    """Write the shader and its textures, or the file with lobes; returns the exit code."""
    if options.lobes:
        container.refuse_other_file(options.out)
    loaded = load(options.file)
    if options.lobes:
        return _with_lobes(options, loaded)
    header = loaded.header
    source = f"`{options.file.name}`: codec {header.codec}, version {header.version}, file format {container.FORMAT}"
    source += f", sha256 {header.sha256} (as `neubtf-bench info` prints it)"
    source += f"; fitted to lights up to {loaded.material.lowest_light_deg:.0f}°"
    if header.scene:
        source += f" and to the scene {header.scene['name']} alone, outside of which its answers mean nothing"
    try:
        program = program_of(loaded.material)
        checks = vectors(loaded.material)
        files, held = export(program, options.file.stem, options.format, options.out, source, checks)
    except InputError as error:
        raise InputError(f"{options.file}: {error}") from error
    for path in files:
        say_line(f"wrote {path}")
    what = "textures and weights" if options.format == "slang" else "textures"
    print(f"{held:,} bytes of {what} on a GPU; the file has {options.file.stat().st_size:,} bytes")
    return FINE


def _with_lobes(options: argparse.Namespace, loaded: Loaded) -> int:
    """Fit lobes, write a file with them, and print how much they reduce the noise; returns the exit code."""
    header, parts = container.read_parts(options.file)
    with Console() as console:
        lobes = fitted(loaded.material, show=console.show)
    ratios = noise(loaded.material, lobes.float())
    whole = replace(parts, sampling={NAME: lobes}, network=loaded.network, scene=header.scene)
    written = container.save(options.out, make_codec(header.codec, header.settings), whole, header.provenance)
    print(
        f"variance under a uniform environment: {ratios.total:.3f} × that of the cosine (median {ratios.median:.3f}); "
        f"largest albedo: {ratios.largest_albedo:.2f}"
    )
    say_line(f"wrote {options.out}: {written.file_bytes:,} bytes, {written.part_bytes()['sampling']:,} of them lobes")
    return FINE


def vectors(material: Material) -> Vectors:
    """Five queries and the answers of the material, by turns at a point and over an eighth of its side."""
    count = 5
    rng = np.random.default_rng(0)
    uv = rng.random((count, 2)).astype(np.float32)
    wo = uniform(rng, count, 75.0)
    wi = uniform(rng, count, 75.0)
    footprint = np.array([0, 0.125, 0, 0.125, 0], np.float32)
    return Vectors(uv, wo, wi, footprint, material.query(uv, wo, wi, footprint))
