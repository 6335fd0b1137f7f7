"""NeuralBTF by its authors' own code, as the two programs of a codec `command`.

    git clone https://github.com/mandyxmq/NeuralBTF-release CLONE
    NEUMIP=... NEURALBTF=CLONE neubtf-bench run tools/authors.toml

Of the clone it uses the model, its loss, how it draws queries, and their defaults: 20,000 steps of ten pictures. Of a
picture it asks 20 × 20 queries a step, theirs 512 × 512, which would take a core minutes. The pyramid is as theirs of a
whole capture: from a quarter of the sides, with an offset texture of a sixteenth. Ours are the pairs, and the unit of
radiance, exposure.
"""

import argparse
import os
import sys
from pathlib import Path
from typing import Any

import authors
import numpy as np
import torch
from torch import Tensor

from bench.metrics.display import LOG_SCALE

STEPS = 20_000
PICTURES = 10  # of a step
SIDE = 20  # queries a row and column of a picture
RATE = 1e-3
WEIGHTS = "weights.npz"
CPU = torch.device("cpu")


def their_model(side: int) -> Any:
    """Their model of square pictures of so many texels a side, with random weights."""
    sys.path.insert(0, os.environ["NEURALBTF"])
    from neuralbtf.models import ModelConfig, MultiResNeuralTextureModel  # type: ignore[import-not-found]

    return MultiResNeuralTextureModel(ModelConfig(texture_res=side, min_res=side // 4, off_texture_res=side // 16))


def encode(btf_file: Path, files: Path, options: argparse.Namespace) -> None:
    """Train on all pairs of a square BTF, and write the weights."""
    pairs = authors.pairs_of(btf_file, options.seed, options.threads)
    scale = pairs.gain / LOG_SCALE  # exposure
    pictures = pairs.radiance.flip(1) / LOG_SCALE  # the first row is that of v = 0
    directions = torch.cat([pairs.lights, pairs.views], 1)
    _, height, width, _ = pictures.shape
    if height != width:
        raise SystemExit(f"{height} × {width} texels: their textures are square")
    model = their_model(width)
    from neuralbtf.data import make_model_input, stratified_uv  # type: ignore[import-not-found]
    from neuralbtf.losses import training_loss  # type: ignore[import-not-found]

    optimiser = torch.optim.Adam(model.parameter_groups(RATE))
    shown = len(pictures) // PICTURES * PICTURES  # in a round, each once; the rest wait for another round
    batches: list[Tensor] = []
    for step in range(options.steps):
        batches = batches or list(torch.randperm(len(pictures))[:shown].split(PICTURES))
        batch = batches.pop()
        inputs = make_model_input(stratified_uv(SIDE, SIDE, CPU), directions[batch])
        optimiser.zero_grad()
        training_loss(model(inputs), pictures[batch], inputs[:, :2]).backward()
        optimiser.step()
        if step % 1000 == 0:
            print(f"{step} of {options.steps}", file=sys.stderr, flush=True)
    arrays = {name: tensor.numpy() for name, tensor in model.state_dict().items()}
    np.savez(files / WEIGHTS, side=np.int64(width), scale=np.float64(scale), **arrays)


def decode(files: Path) -> None:
    """Answer queries at the uv of which their training shows the texels."""
    with np.load(files / WEIGHTS, allow_pickle=False) as stored:
        arrays = dict(stored)
    side = int(arrays.pop("side"))
    scale = float(arrays.pop("scale"))
    model = their_model(side)
    model.load_state_dict({name: torch.from_numpy(array) for name, array in arrays.items()})

    def evaluate(uv: Tensor, view: Tensor, light: Tensor) -> Tensor:
        # Their training takes the outermost texels' centres for uv 0 and 1 (`GT_ALIGN_CORNERS`).
        theirs = ((side * uv - 0.5) / (side - 1)).clamp(0, 1)
        answers: Tensor = model(torch.cat([theirs, light, view], 1))
        return answers.clamp_min(0) / scale  # as theirs are rendered

    authors.answer(evaluate)


if __name__ == "__main__":
    authors.main(__doc__.splitlines()[0], encode, decode, STEPS)
