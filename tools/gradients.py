"""How much the losses of NeuBTF's paper steer a fit: the norm of each one's gradient as a share of the pixels' norm.

    python tools/gradients.py [MATERIAL ...] [--batches 30] [--size 64]

Medians over batches at the start of a fit by `recipe=paper`, all weights at 1. A weight that gives a loss the share x
is x over its share here. Materials are names or paths under `$NEUBTF_DATA`; measured data are shrunk to that size.
"""

import argparse

import numpy as np
import torch

from bench.codec import Fit, silent
from bench.data.open import open_material
from bench.data.spec import Preparation, named
from bench.machine.threads import torch_threads
from bench.training import Samples, gain_of
from neubtf.autoencoder import Autoencoder, Encoder, displayed
from neubtf.codec import NeuBTF, guiding_pair
from neubtf.published import Published
from neubtf.training import slice_of


def shares(material: str, size: int, batches: int) -> list[float]:
    """The medians of the norms of the gradients of style and spectrum over that of the pixels."""
    btf = open_material(named(material), Preparation(size=size, texels=size, split="validation"), silent)
    btf = btf.subset(btf.split(0).train)
    chosen, fit = NeuBTF(recipe="paper").settings, Fit()
    gain, generator = gain_of(btf, fit), fit.generator()
    samples = Samples(btf, gain, fit)
    guidance = displayed(slice_of(samples, guiding_pair(samples)))
    encoder = Encoder.for_guidance(guidance, Autoencoder(chosen.latents, generator, rectified=True))
    fitting = Published(samples, chosen, encoder, guidance, generator)
    parameters = [*fitting.parameters()]
    norms = []
    for _ in range(batches):
        losses = fitting.losses(fitting.batch(generator), generator)
        each = [torch.autograd.grad(loss, parameters, retain_graph=True, allow_unused=True) for loss in losses]
        norms.append([sum(float(g.square().sum()) for g in grads if g is not None) ** 0.5 for grads in each])
    pixel, style, frequency = np.array(norms).T
    return [float(np.median(style / pixel)), float(np.median(frequency / pixel))]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("material", nargs="*", default=["satin", "ubo2003_local_pca/corduroy", "svbrdf/rock"])
    parser.add_argument("--batches", type=int, default=30)
    parser.add_argument("--size", type=int, default=64)
    options = parser.parse_args()
    print("| material | style | spectrum |\n| --- | --- | --- |")
    with torch_threads(1):
        for material in options.material:
            found = shares(material, options.size, options.batches)
            print(f"| {material} | {found[0]:.1e} | {found[1]:.1e} |", flush=True)


if __name__ == "__main__":
    main()
