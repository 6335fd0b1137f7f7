"""Trains the network that a codec shares over materials, on surfaces that no suite contains."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path

from bench.btf import BTF
from bench.codec import Fit, SharedNetwork
from bench.codecs import shared
from bench.codecs.container import Header
from bench.data.materials.variations import load_variation
from bench.inputs.errors import InputError
from bench.machine.threads import torch_threads

MATERIALS = 224  # the default number of variations in training
UNSEEN = range(100_000, 100_016)  # variations for its curve, kept out of training


def pretrain(
    network: SharedNetwork, fit: Fit, path: Path, materials: int = MATERIALS, added: Sequence[BTF] = ()
) -> Header:
    """Train a network on the first `materials` variations and on the BTFs in `added`, and write its file.

    Its curve, in `fit.history`, is the PSNR on variations kept out of training. The default needs no data, so everybody
    can make the same file. Raises `InputError` if there is no material to train on.
    """
    if materials < 0 or materials + len(added) < 1:
        raise InputError(f"a network needs at least one training material, not {materials}")
    numbers = fit.progress([*range(materials), *UNSEEN], "rendering materials to train on")
    btfs = [load_variation(number) for number in numbers]
    fit = dataclasses.replace(fit, unseen=btfs[materials:])
    with torch_threads(fit.threads):
        return shared.make(network, [*btfs[:materials], *added], fit, path)
