"""What programs of a codec `command` share that train by the code of a paper's authors: see `tools/authors.toml`.

Each reads the code from a clone outside this repository, and copies nothing of it.
"""

import argparse
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from bench.codec import Fit
from bench.data.readers import open_btf
from bench.training import gain_of


class Pairs(NamedTuple):
    """The pairs of a BTF: radiance (pairs, H, W, 3) times the `gain` of our own fits, x and y (pairs, 2) of views and
    of lights."""

    radiance: Tensor
    views: Tensor
    lights: Tensor
    gain: float


def pairs_of(btf_file: Path, seed: int, threads: int) -> Pairs:
    """All pairs of a BTF."""
    btf = open_btf(btf_file)
    gain = gain_of(btf, Fit(torch.device("cpu"), threads, seed=seed))
    radiance = torch.from_numpy(gain * np.stack([*btf]))
    return Pairs(radiance, torch.from_numpy(btf.wo[:, :2]), torch.from_numpy(btf.wi[:, :2]), gain)


def answer(evaluate: Callable[[Tensor, Tensor, Tensor], Tensor]) -> None:
    """Answer queries until there are none, by the protocol of a codec `command` (docs/sharing.md).

    `evaluate` gets uv, x and y of the view, and those of the light, each (n, 2), and returns radiance (n, 3).
    """
    for line in sys.stdin:
        asked, answered = line.rstrip("\n").split("\t")
        queries = torch.from_numpy(np.load(asked, allow_pickle=False))  # (n, 9)
        with torch.no_grad():
            np.save(answered, evaluate(queries[:, :2], queries[:, 2:4], queries[:, 5:7]).numpy())
        print(flush=True)


def main(
    description: str,
    encode: Callable[[Path, Path, argparse.Namespace], None],
    decode: Callable[[Path], None],
    steps: int,
) -> None:
    """Encode or decode, as the command line says; `steps` is the default number."""
    parser = argparse.ArgumentParser(description=description)
    commands = parser.add_subparsers(dest="command", required=True)
    encoding = commands.add_parser("encode")
    encoding.add_argument("btf", type=Path)
    encoding.add_argument("files", type=Path)
    encoding.add_argument("--seed", type=int, default=0)
    encoding.add_argument("--threads", type=int, default=1)
    encoding.add_argument("--steps", type=int, default=steps)
    decoding = commands.add_parser("decode")
    decoding.add_argument("files", type=Path)
    options = parser.parse_args()
    if options.command == "encode":
        torch.manual_seed(options.seed)
        torch.set_num_threads(options.threads)
        encode(options.btf, options.files, options)
    else:
        decode(options.files)
