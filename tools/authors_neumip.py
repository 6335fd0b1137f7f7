"""NeuMIP by its authors' own code, as the two programs of a codec `command`.

    git clone https://github.com/straintensor/NeuMIP CLONE
    NEUMIP=CLONE NEURALBTF=... neubtf-bench run tools/authors.toml

Of the clone it uses the model, its training step, and their defaults: 30,000 steps of four pictures, each with a query
a texel, whose pair is drawn at random. Ours are the pairs and the unit of radiance, which is that of our own fits
(`bench.training.gain_of`). All queries are of the finest level, because pairs have no coarser ones.
"""

import argparse
import contextlib
import os
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest import mock
from unittest.mock import MagicMock

import authors
import numpy as np
import torch
from torch import Tensor

STEPS = 30_000
PICTURES = 4  # of a step
WEIGHTS = "weights.npz"
# Modules of the clone that render, draw or read files, and import what is not needed here.
ABSENT = ("visualizer", "renderer", "common_renderer", "error_metric", "tqdm")
ABSENT += ("dataset", "dataset.generator_mitsuba", "dataset.dataset_reader", "dataset.rays")


def their_code() -> Any:
    """The module of the clone with the model and its training; what it prints goes to the error stream."""
    sys.path.insert(0, os.environ["NEUMIP"])
    stand_ins = {name: MagicMock() for name in ABSENT}
    stand_ins["common_renderer"].CommonRenderer = object  # their class inherits from it
    with mock.patch.dict(sys.modules, stand_ins), contextlib.redirect_stdout(sys.stderr):
        import neural_rendering  # type: ignore[import-not-found]
    return neural_rendering


def their_model(size: tuple[int, int]) -> Any:
    """Their material of a texture of `size` (H, W), with random weights, ready to be trained on the CPU."""
    code = their_code()
    live = object.__new__(code.NeuralMaterialLive)  # without its files and its GPU
    live.device = torch.device("cpu")
    live.args = SimpleNamespace(experiment="StandardRawLongShadowMaskOnly", loss="comb1", levels=None)  # their defaults
    live.dataset = SimpleNamespace(resolution=lambda: size)
    live.vars = code.NeuralMaterialSavable(live)
    live.vars.set_base_radius(base_radius(size))
    return live


def base_radius(size: tuple[int, int]) -> torch.Tensor:
    """The radius of a query of the finest level, in their units."""
    return torch.tensor(0.5 / size[1])


def tensors_of(live: Any) -> dict[str, torch.Tensor]:
    """Every tensor of the material that is learned, by name."""
    material = live.vars
    found = {f"latents.{level}": each for level, each in enumerate(material.neural_textures.get_params())}
    found |= {f"offset.{level}": each for level, each in enumerate(material.neural_offsets.get_params())}
    for name, network in {"decoder": material.network, "depth": material.offset_network}.items():
        found |= {f"{name}.{key}": each for key, each in network.state_dict(keep_vars=True).items()}
    return found


def encode(btf_file: Path, files: Path, options: argparse.Namespace) -> None:
    """Train on all pairs of a BTF, and write the weights."""
    rng = np.random.default_rng(options.seed)
    np.random.seed(options.seed)  # they draw levels by it
    pairs = authors.pairs_of(btf_file, options.seed, options.threads)
    directions = torch.cat([pairs.views, pairs.lights], 1)
    count, height, width, _ = pairs.radiance.shape
    live = their_model((height, width))
    rows, columns = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    places = torch.stack([(columns + 0.5) / width, 1 - (rows + 0.5) / height])  # (2, H, W): u and v
    location = (2 * places - 1).expand(PICTURES, 2, height, width)
    radius = base_radius((height, width)).expand(PICTURES, 1, height, width)
    for step in range(options.steps):
        pair = torch.from_numpy(rng.integers(count, size=(PICTURES, height, width)))
        queries = directions[pair].permute(0, 3, 1, 2)
        truth = pairs.radiance[pair, rows, columns].permute(0, 3, 1, 2)
        live.train_step((queries, truth, location, radius, radius[:, 0, 0, 0]))
        live.vars.iter_count += 1
        if step % 1000 == 0:
            print(f"{step} of {options.steps}", file=sys.stderr, flush=True)
    arrays = {name: tensor.detach().numpy() for name, tensor in tensors_of(live).items()}
    np.savez(
        files / WEIGHTS,
        size=np.array([height, width]),
        steps=np.int64(options.steps),
        gain=np.float32(pairs.gain),
        **arrays,
    )


@torch.no_grad()
def decode(files: Path) -> None:
    """Answer queries until there are none."""
    with np.load(files / WEIGHTS, allow_pickle=False) as stored:
        arrays = dict(stored)
    height, width = map(int, arrays.pop("size"))
    gain = float(arrays.pop("gain"))
    steps = int(arrays.pop("steps"))
    live = their_model((height, width))
    for name, tensor in tensors_of(live).items():
        tensor.copy_(torch.from_numpy(arrays[name]))
    live.vars.iter_count = steps  # by which the blur of their textures has faded
    radius = base_radius((height, width))

    def evaluate(uv: Tensor, view: Tensor, light: Tensor) -> Tensor:
        location, seen, lit = (each.T[None, :, :, None] for each in (2 * uv - 1, view, light))  # (1, 2, n, 1)
        radii = radius.expand(location[:, :1].shape)
        answers, _ = live.vars.evaluate(torch.cat([seen, lit], 1), location, radii, camera_dir=seen)
        radiance: Tensor = answers[0, :, :, 0].T / gain
        return radiance

    authors.answer(evaluate)


if __name__ == "__main__":
    authors.main(__doc__.splitlines()[0], encode, decode, STEPS)
