"""encode one BTF, all its training pairs, into a codec file"""

import argparse
from pathlib import Path

from bench.arguments import assignments, usable_device
from bench.errors import InputError
from bench.exits import FINE


def arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("btf", help="a built-in material or the path of a BTF")
    parser.add_argument("--codec", required=True)
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="a codec setting, or data.KEY")
    parser.add_argument("--repair", action="store_true", help="mask measured values that are NaN or infinite")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("-o", "--out", type=Path, required=True, help="the codec file to write")


def run(options: argparse.Namespace) -> int:
    import torch

    from bench import container
    from bench.codec import Fit
    from bench.console import Console, file_lines
    from bench.open import open_named
    from bench.registry import load_codec
    from bench.timing import torch_threads

    changes = assignments(options.set) | ({"data.repair": "true"} if options.repair else {})
    settings = {k: v for k, v in changes.items() if not k.startswith("data.")}
    codec = load_codec(options.codec)(**settings)
    if not options.out.parent.is_dir():
        raise InputError(f"{options.out}: its folder is not there: make it first")
    device = torch.device(usable_device(options.device))
    with Console() as console, torch_threads(options.threads):
        btf = open_named(options.btf, changes, console.show)
        fit = Fit(device, options.threads, options.seed, console.show)
        header = container.save(options.out, codec, codec.encode(btf.subset(btf.split().train), fit))
    console.say(file_lines(header))
    return FINE
