"""encode the training pairs of one BTF into a codec file

With --demand the file is the smallest one that reaches a target in the pictures of a scene: see docs/scenes.md.

examples:
  neubtf-bench encode satin --codec pca --set components=8 -o satin.nbtf
  neubtf-bench encode cable-knit --codec pca --demand table-top.npz -o cable-knit.nbtf
"""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from bench.cli.commands import assignments, read_as, reading_options, seed_option, threads, usable_device
from bench.inputs.errors import FINE, NO, ContainerError, EncodeError, InputError

if TYPE_CHECKING:
    from bench.btf import BTF
    from bench.cli.console import Console
    from bench.codec import Codec, TrainedNetwork
    from bench.demand.demand import Demand


def arguments(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("btf", help="a built-in material or the path of a BTF")
    add("--codec", required=True)
    add("--set", action="append", default=[], metavar="KEY=VALUE", help="a codec setting, or data.KEY")
    reading_options(parser)
    add("--demand", type=Path, help="fit the smallest file for a scene, an .npz of `demand`")
    add("--target-psnr", type=float, metavar="DB", help="with --demand: the PSNR that frames reach …")
    add("--target-flip", type=float, metavar="FLIP", help="… or their FLIP (default: that of the full model)")
    add("--uniform", type=float, help="with --demand: the share of samples spread evenly (default: 0.1)")
    add("--seed", type=seed_option, default=0, help="the repetition, as in the seeds of a suite (default: 0)")
    add("--threads", type=threads, default=1)
    add("--device", default="cpu")
    add("-o", "--out", type=Path, required=True, help="the codec file to write")


def run(options: argparse.Namespace) -> int:
    from bench.cli.console import Console, file_lines
    from bench.codecs import container, shared
    from bench.codecs.encoding import raised
    from bench.codecs.registry import make_codec
    from bench.data.open import open_named
    from bench.demand import demand, require_demand
    from bench.runs.library import encode

    if not options.out.parent.is_dir():
        raise InputError(f"{options.out}: there is no such folder: make it first")
    for word in ("target_psnr", "target_flip", "uniform"):
        if getattr(options, word) is not None and not options.demand:
            raise InputError(f"--{word.replace('_', '-')}: only for a fit to a scene: give its --demand")
    if options.uniform is not None and not 0 <= options.uniform <= 1:
        raise InputError(f"--uniform {options.uniform}: must be between 0 and 1")
    container.refuse_other_file(options.out)
    changes = assignments(options.set) | read_as(options)
    settings = {k: v for k, v in changes.items() if not k.startswith("data.")}
    codec = make_codec(options.codec, settings)
    scene_demand = demand.load(options.demand) if options.demand else None
    require_demand(codec, scene_demand)
    device = usable_device(options.device)
    network, code = shared.find_for(codec), FINE  # a missing one is said before anything is rendered
    with Console() as console:
        btf = open_named(options.btf, changes, console.show)
        if scene_demand:
            code = _encode_for_scene(options, codec, btf, scene_demand, network, console)
        else:
            how = {"seed": options.seed, "threads": options.threads, "device": device}
            encode(btf, codec, options.out, show=console.show, **how)
    try:
        console.say(file_lines(container.read_header(options.out)))
    except ContainerError as error:
        if error.__cause__ is None or isinstance(error.__cause__, InputError):
            raise
        raise EncodeError(
            f"codec {codec.name} cannot decode {options.out}, its own file: {raised(error, codec)}"
        ) from error
    return code


def _encode_for_scene(
    options: argparse.Namespace,
    codec: "Codec",
    btf: "BTF",
    scene_demand: "Demand",
    network: "TrainedNetwork | None",
    console: "Console",
) -> int:
    """Write the smallest model that reaches the target in a scene, or the full one, and show gains and losses."""
    import tempfile
    from functools import partial

    import numpy as np

    from bench.codecs import shared
    from bench.codecs.encoding import new_fit
    from bench.demand import UNIFORM, fitting
    from bench.demand.frame_scorer import FrameScorer, table_of
    from bench.files import atomic
    from bench.machine.threads import torch_threads
    from reports.scene_models import scene_models_text

    shared.refuse(network, btf)  # `new_fit` refuses it, too, but only after the frames are rendered
    scorer = FrameScorer(table_of(btf), scene_demand, console.show)
    uniform = UNIFORM if options.uniform is None else options.uniform
    how = {"device": options.device, "threads": options.threads, "show": console.show}
    fit = partial(new_fit, codec, btf, options.seed, network, **how)
    wanted = fitting.Goal(options.target_psnr, options.target_flip)
    with tempfile.TemporaryDirectory() as folder, torch_threads(options.threads):
        search = fitting.Search(codec, btf.subset(btf.split().train), scorer, fit, Path(folder), uniform)
        result = search.run(None if wanted == fitting.Goal() else wanted)
        held = btf.subset(np.setdiff1d(np.arange(len(btf)), btf.split().train))
        console.say(scene_models_text(fitting.rows(result, scorer, options.threads, held)))
        atomic.write(options.out, result.chosen.header.path.read_bytes())
    if not result.met:
        verdict = f"The target is not reached; this is the {'scene' if result.scene else 'full'} model"
    elif result.scene is None:
        verdict = f"This is the full model: {result.why}"
    else:
        share = result.scene.header.file_bytes / result.full.header.file_bytes
        verdict = f"The scene model takes {share:.0%} of the bytes: {result.why}"
    console.say(f"{verdict}. {result.fits} fits to the scene took {result.seconds:.1f} s of processor time.")
    return FINE if result.met else NO
