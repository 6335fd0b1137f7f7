"""write a codec file as a shader: GLSL, HLSL or WGSL with its textures

The folder holds one function, `material(uv, wo, wi, footprint)`, two textures and a README of conventions and of
answers to check a copy by. For GLSL it also holds a whole fragment shader around the function, which compiles as it is.

examples:
  neubtf-bench export satin.nbtf --format wgsl -o satin-wgsl
"""

import argparse
from pathlib import Path

import numpy as np
import torch

from bench.cli.commands import say_line
from bench.codecs.container import FORMAT
from bench.codecs.loading import load
from bench.directions.hemisphere import uniform
from bench.inputs.errors import FINE, InputError
from bench.material import Material
from bench.runs.drawing import drawable
from reports.shaders.export import Vectors, export


def arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("file", type=Path, help="the codec file")
    parser.add_argument("--format", choices=("glsl", "hlsl", "wgsl"), default="glsl", help="language (default: glsl)")
    parser.add_argument("-o", "--out", type=Path, required=True, help="the folder to write")


def run(options: argparse.Namespace) -> int:
    """Write the shader and its textures; returns the exit code."""
    loaded = load(options.file)
    header = loaded.header
    source = f"`{options.file.name}`: codec {header.codec}, version {header.version}, file format {FORMAT}"
    source += f", sha256 {header.sha256}; fitted to lights up to {loaded.material.lowest_light_deg:.0f}°"
    try:
        program, _ = drawable(loaded.material)  # without the exposure
        checks = vectors(loaded.material)
        files, held = export(program, options.file.stem, options.format, options.out, source, checks)
    except InputError as error:
        raise InputError(f"{options.file}: {error}") from error
    for path in files:
        say_line(f"wrote {path}")
    print(f"{held:,} bytes of textures on a GPU; the file has {options.file.stat().st_size:,} bytes")
    return FINE


def vectors(material: Material) -> Vectors:
    """Five queries and the answers of the material, by turns at a point and over an eighth of its side."""
    count = 5
    rng = np.random.default_rng(0)
    uv = rng.random((count, 2)).astype(np.float32)
    wo, wi = (uniform(rng, count, 75.0).astype(np.float32) for _ in range(2))
    footprint = np.array([0, 0.125, 0, 0.125, 0], np.float32)
    rgb = material.query(*(torch.from_numpy(each) for each in (uv, wo, wi, footprint)))
    return Vectors(uv, wo, wi, footprint, rgb.numpy())
