"""encode the training pairs of one BTF into a codec file

With --scene the file is the smallest one that reaches a target in the pictures of a scene: see docs/scenes.md. The
queries of these pictures, the demand of the scene, are written beside the file as `demand-SCENE.npz`, which is another
--scene, and drawn.

examples:
  neubtf-bench encode satin --codec pca --set components=8 -o satin.nbtf
  neubtf-bench encode cable-knit --codec pca --scene table-top -o cable-knit.nbtf
  neubtf-bench encode cable-knit --codec pca --scene room.xml --bsdf sofa -o sofa.nbtf
"""

import argparse
import math
from pathlib import Path

from bench.cli.commands import assignments, read_as, reading_options, seed_option, threads, usable_device
from bench.cli.commands._scene import demand_file, scene_options
from bench.cli.console import Console
from bench.codecs import container, shared
from bench.codecs.encoding import error_in_words
from bench.codecs.registry import make_codec
from bench.data.open import open_named
from bench.demand import UNIFORM, require_demand
from bench.inputs.errors import FINE, NO, ContainerError, EncodeError, InputError
from bench.records import MOST_DB
from bench.runs.library import SceneGoal, encode, encode_for_scene
from reports.scene_models import scene_models_text


def arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command to its parser."""
    add = parser.add_argument
    add("btf", help="a built-in material or the path of a BTF")
    add("--codec", required=True)
    add("--set", action="append", default=[], metavar="KEY=VALUE", help="a codec setting, or data.KEY")
    reading_options(parser)
    scene_options(parser, "fit the smallest file for a scene")
    flip = "with --scene: the largest FLIP of the frames "
    flip += "(default without a target: a PSNR 0.2 dB below the full model's)"
    add("--target-psnr", type=float, metavar="DB", help="with --scene: the least PSNR of the frames")
    add("--target-flip", type=float, metavar="FLIP", help=flip)
    add("--uniform", type=float, help="with --scene: the share of samples spread evenly (default: 0.1)")
    add("--seed", type=seed_option, default=0, help="the repetition, as in the seeds of a suite (default: 0)")
    add("--threads", type=threads, default=1)
    add("--device", default="cpu")
    add("-o", "--out", type=Path, required=True, help="the codec file to write")


def run(options: argparse.Namespace) -> int:
    """Fit a codec and write its file; returns `FINE`, or `NO` if the frames of a scene miss the target."""
    # Everything that can be wrong with the words is found before anything is rendered or fitted.
    _check(options)
    changes = assignments(options.set) | read_as(options)
    settings = {key: value for key, value in changes.items() if not key.startswith("data.")}
    codec = make_codec(options.codec, settings)
    require_demand(codec, options.scene)
    device = usable_device(options.device)
    shared.find_for(codec)  # a missing one is said before anything is rendered
    how = {"seed": options.seed, "threads": options.threads, "device": device}
    code = FINE
    with Console() as console:
        demand = demand_file(options, options.out.parent, console)
        btf = open_named(options.btf, changes, console.show)
        if demand:
            uniform = UNIFORM if options.uniform is None else options.uniform
            goal = SceneGoal(demand, options.target_psnr, options.target_flip, uniform)
            scene_fit = encode_for_scene(btf, codec, options.out, goal, show=console.show, **how)
            console.say(scene_models_text(scene_fit.rows))
            console.say(scene_fit.described())
            code = FINE if scene_fit.search.met else NO
        else:
            encode(btf, codec, options.out, show=console.show, **how)
    # Decoding the new file shows a fault of the codec at once, not when the file is used.
    try:
        console.say_file(container.read_header(options.out))
    except ContainerError as error:
        # An exception that is no `InputError` comes from the codec's own code.
        if error.__cause__ is None or isinstance(error.__cause__, InputError):
            raise
        raise EncodeError(
            f"codec {codec.name} cannot decode {options.out}, its own file: {error_in_words(error, codec)}"
        ) from error
    return code


def _check(options: argparse.Namespace) -> None:
    """Raise an `InputError` for options that do not fit together, and for a place without its folder, or with a file of
    another kind."""
    if not options.out.parent.is_dir():
        raise InputError(f"{options.out}: there is no folder {options.out.parent}: make it first")
    for word in ("target_psnr", "target_flip", "uniform"):
        if getattr(options, word) is not None and not options.scene:
            raise InputError(f"--{word.replace('_', '-')}: only for a fit to a scene: give its --scene")
    if options.uniform is not None and not 0 <= options.uniform <= 1:
        raise InputError(f"--uniform {options.uniform}: must be between 0 and 1")
    if options.target_psnr is not None and not -math.inf < options.target_psnr <= MOST_DB:
        raise InputError(f"--target-psnr {options.target_psnr:g}: must be at most {MOST_DB}, the PSNR of exact frames")
    container.refuse_other_file(options.out)
