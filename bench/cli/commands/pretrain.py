"""train the network that a codec shares over materials, and write its file

The training set is procedural, so it needs no data: variations of the built-in materials and random surfaces, and no
suite contains any of them. The file goes where encoding and decoding look for it: into $NEUBTF_SHARED, else into
shared/ under the cache folder. There it takes precedence over the network that comes with the codec. A training that
was killed resumes. The curve that is printed at the end is measured on surfaces of the same kinds, kept out of
training.

examples:
  neubtf-bench pretrain rainer2020
  neubtf-bench pretrain rainer2020 --steps 1000 --materials 16 -o brief.nbtf
"""

import argparse
from pathlib import Path

import torch

from bench.cli.commands import assignments, seed_option, several, threads, usable_device
from bench.cli.console import Console
from bench.codec import Fit
from bench.codecs import shared
from bench.codecs.registry import load_codec
from bench.data.open import open_named
from bench.inputs.errors import FINE, InputError
from bench.runs.library import MATERIALS, pretrain


def arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command to its parser."""
    parser.add_argument("codec", help="a codec that shares a network, such as rainer2020")
    parser.add_argument("-o", "--out", type=Path, help="the file to write (default: where codecs look for it)")
    parser.add_argument("--steps", type=int, help="the number of training steps, short for --set steps=N")
    several(parser, "--set", "a setting of the network", "KEY=VALUE")
    materials = f"how many procedural surfaces to train on, 0 for none (default: {MATERIALS})"
    parser.add_argument("--materials", type=int, default=MATERIALS, help=materials)
    several(parser, "--add", "train on this BTF or folder of maps too; repeatable", "BTF")
    parser.add_argument("--seed", type=seed_option, default=0)
    parser.add_argument("--threads", type=threads, default=1)
    parser.add_argument("--device", default="cpu")


def run(options: argparse.Namespace) -> int:
    """Train the network, write its file, and print its curve; returns the exit code."""
    codec = load_codec(options.codec)
    if codec.network is None:
        raise InputError(f"codec {options.codec} shares no network over materials: it needs no pretraining")
    settings = assignments(options.set)
    if options.steps is not None:
        if "steps" in settings:
            raise InputError("--steps, --set steps: they are the same: give only one of them")
        settings["steps"] = str(options.steps)
    network = codec.network(**settings)
    device = torch.device(usable_device(options.device))
    with Console() as console:
        added = [open_named(name, {}, console.show) for name in options.add]
        fit = Fit(device, options.threads, options.seed, console.show)
        header = pretrain(network, fit, options.out or shared.place(codec.name), options.materials, added)
    console.say_file(header)
    for point in fit.history:
        console.say(f"{point['step']:8,} steps  {point['psnr']:6.2f} dB on surfaces kept out of training")
    return FINE
