"""render codec files in a scene, as still pictures

The scene is `sphere`, `plane`, `drape` or another one that ships with the suite, or a TOML file (see docs/scenes.md).
With the extra [mitsuba] it may be a Mitsuba 3 XML file: the codec files replace one of its BSDFs (see
docs/materials.md). Several files, and the BTF of --truth before them, stand side by side at one exposure, with
captions below in a PNG: codec, bytes, and the display PSNR in this frame where --truth is given.

examples:
  neubtf-bench render satin.nbtf -o satin.png
  neubtf-bench render satin.nbtf --truth satin --scene drape --lights environment -o satin.png
  neubtf-bench render satin.nbtf --scene kitchen.xml --bsdf cloth --samples 64 -o kitchen.exr
"""

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bench.cli.commands import assignments, say_line, several, usable_device
from bench.cli.commands._scene import is_mitsuba, refuse_mitsuba_options
from bench.cli.console import Console
from bench.codecs.container import Header, read_header
from bench.codecs.loading import load
from bench.data.open import open_named
from bench.demand import still
from bench.demand.frame_scorer import table_of
from bench.demand.scene import named_scene
from bench.inputs.errors import FINE, InputError, installed
from bench.runs.library import require_same_size

LIMITS: dict[str, tuple[float, float]] = {  # by option: the least and the largest value
    "tiling": (1e-3, 1e3),
    "exposure": (1e-12, 1e12),
    "width": (1, 16_384),
    "rays": (1, 16),
    "samples": (1, 1 << 20),
}
NOT_WITH_MITSUBA = {  # by option: why a Mitsuba scene does not take it
    "truth": "it shows codec files only",
    "set": "it has no --truth",
    "lights": "it has its own lights",
    "width": "its film gives it",
    "frame": "its first camera is rendered",
    "rays": "give --samples",
    "device": "Mitsuba's variant gives it",
}


def arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command to its parser."""
    add = parser.add_argument
    add("files", type=Path, nargs="*", metavar="FILE", help="codec files, from left to right")
    add("--truth", metavar="BTF", help="show this BTF, built-in or a path, at the left (not in a Mitsuba scene)")
    several(parser, "--set", "how --truth is prepared", "data.KEY=VALUE")
    add("--scene", default="sphere", help="a scene of the suite, a TOML file or Mitsuba's XML (default: sphere)")
    add("--bsdf", metavar="ID", help="the id of the BSDF that the files replace, in a Mitsuba scene")
    add("--samples", type=int, help="samples a pixel, in a Mitsuba scene (default: the scene's)")
    add("--frame", type=int, default=0, help="which frame of a scene with several cameras (default: 0)")
    add("--lights", choices=("sun", "environment"), help="use these lights instead of the scene's")
    add("--tiling", type=float, default=1.0, help="repeat the texture this many times as often (default: 1)")
    add("--width", type=int, help="width of each picture in pixels (default: the scene's)")
    add("--rays", type=int, help="rays along each side of a pixel (default: 2)")
    add("--exposure", type=float, help="factor on radiance (default: 0.8 divided by the picture's 99th percentile)")
    add("--device", help="the device that decodes (default: cpu)")
    add("-o", "--out", type=Path, required=True, help="the picture to write, .png or .exr (linear)")


def run(options: argparse.Namespace) -> int:
    """Render the files and write the picture; returns the exit code."""
    # Options that are wrong, or do not fit the kind of scene, are refused before anything is rendered.
    still.check_ending(options.out)
    for name, (low, high) in LIMITS.items():
        value = getattr(options, name)
        if value is not None and not low <= value <= high:
            raise InputError(f"--{name} {value:g}: must be between {low:g} and {high:g}")
    if is_mitsuba(options.scene):
        return _path_trace(options)
    refuse_mitsuba_options(options, "bsdf", "samples")
    return _draw(options)


def _draw(options: argparse.Namespace) -> int:
    """Render the truth, if it is asked for, and files in a scene of the suite, and write them side by side; returns the
    exit code."""
    scene = still.changed(named_scene(options.scene), options.lights, options.tiling, options.width)
    if not 0 <= options.frame < len(scene.cameras):
        raise InputError(f"--frame {options.frame}: {scene.name} has frames 0 to {len(scene.cameras) - 1}")
    if not (options.files or options.truth):
        raise InputError("nothing to render: name a codec file, or a BTF with --truth")
    if options.set and not options.truth:
        raise InputError("--set: it says how --truth is prepared: give --truth, too")
    device = usable_device(options.device or "cpu")
    with Console() as console:
        sides: list[_Side] = []
        if options.truth:
            truth = open_named(options.truth, assignments(options.set), console.show)
            sides.append(_Side(options.truth, "truth, interpolated", still.of_btf(table_of(truth))))
        for path in options.files:
            file = load(path, device)
            if options.truth:
                require_same_size(path.name, file.material.size, truth)
            sides.append(_Side(path.name, _caption(file.header), still.of_material(file.material)))
        rays = 2 if options.rays is None else options.rays
        pictures = still.render(scene, [side.answers for side in sides], options.frame, rays, show=console.show)
        exposure = still.exposure_for(pictures[0]) if options.exposure is None else options.exposure
        if options.truth:
            for side, picture in zip(sides[1:], pictures[1:], strict=True):
                side.caption += f"\n{still.psnr_in_frame(picture, pictures[0], exposure):.2f} dB in frame"
        captions = [side.caption for side in sides]
        still.write(options.out, np.concatenate(list(pictures), 1), exposure, captions)
        console.say(_result_in_words(options.out, [side.name for side in sides], captions, exposure))
    return FINE


@dataclass
class _Side:
    """One of the pictures that stand side by side."""

    name: str
    caption: str
    answers: still.Answers


def _path_trace(options: argparse.Namespace) -> int:
    """Render files with Mitsuba, and write them side by side; returns the exit code."""
    if not (options.files and options.bsdf):
        raise InputError("a Mitsuba scene needs codec files, and the BSDF that they replace: give --bsdf ID")
    # None of these has a useful value that counts as false: frame 0 is the default, and the least width is 1.
    for name, reason in NOT_WITH_MITSUBA.items():
        if getattr(options, name):
            raise InputError(f"--{name}: not with a Mitsuba scene: {reason}")
    with installed(f"--scene {options.scene}: needs Mitsuba 3: pip install 'neubtf-bench[mitsuba]'"):
        from bench.demand.mitsuba.picture import path_traced
    scene = Path(options.scene)
    captions = [_caption(read_header(file)) for file in options.files]
    pictures = [path_traced(scene, options.bsdf, file, options.tiling, options.samples) for file in options.files]
    exposure = still.exposure_for(pictures[0]) if options.exposure is None else options.exposure
    still.write(options.out, np.concatenate(pictures, 1), exposure, captions)
    say_line(_result_in_words(options.out, [file.name for file in options.files], captions, exposure))
    return FINE


def _caption(header: Header) -> str:
    """What stands below the picture of a codec file."""
    return f"{header.codec}, {header.file_bytes:,} bytes"


def _result_in_words(out: Path, names: list[str], captions: list[str], exposure: float) -> str:
    """What was written, and what the pictures are, from left to right."""
    pictures = []
    for name, caption in zip(names, captions, strict=True):
        pictures.append(f"{name} ({', '.join(caption.splitlines())})")
    applied = "" if out.suffix == ".exr" else f"; exposure {exposure:.6g}"  # EXR holds radiance
    return f"wrote {out}: {', '.join(pictures)}{applied}"
