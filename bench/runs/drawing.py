"""Decoded materials as programs with an exposure, so that `reports` draws them without PyTorch.

A program is a list of array operations recorded from a decoder (`bench.program`): NumPy or a shader runs it. An
exposure is the factor that brings linear radiance into the range of a display.
"""

import numpy as np
import torch

from bench.btf import BTF, ArraySource
from bench.codec import Fit, Progress, followed, silent
from bench.codecs.registry import load_codec
from bench.data.derived import thinned
from bench.directions.hemisphere import thin, thinned_product, ubo2003, uniform
from bench.material import Material
from bench.metrics.display import exposure, exposure_of
from bench.program import Program
from bench.program.recording import program_of

PAIRS, POINTS = 256, 256  # random pairs, and points at each pair, that give the exposure where there is no BTF
SPARSE = 9  # the most views, and the most lights, of a truth that a page shows live
SPARSE_FLOATS = 1_000_000  # the most floats of such a truth
BAKED = 13  # views, and lights, of a material that cannot be a program: 5.5 MB at 64² texels


def drawable(material: Material) -> tuple[Program, float]:
    """A material's program, and the exposure that its picture needs: that of random pairs up to 75°. `InputError` if
    the material cannot be recorded as a program."""
    program = program_of(material)
    # There is no BTF to take the exposure of, so random answers stand for it.
    rng = np.random.default_rng(0)
    uv = torch.from_numpy(rng.random((PAIRS * POINTS, 2), np.float32))
    wo = torch.from_numpy(uniform(rng, PAIRS).astype(np.float32)).repeat_interleave(POINTS, 0)
    wi = torch.from_numpy(uniform(rng, PAIRS).astype(np.float32)).repeat_interleave(POINTS, 0)
    answers = material.query(uv, wo, wi).numpy()
    return program, exposure_of(answers.reshape(PAIRS, POINTS, 3))


def baked(material: Material, name: str, show: Progress = silent) -> BTF:
    """The slices of a material at `BAKED` views × `BAKED` lights, for materials that cannot be a program."""
    wo, wi = thinned_product(ubo2003(), BAKED, BAKED)  # each (BAKED², 3)
    pairs = followed(show, zip(wo.tolist(), wi.tolist(), strict=True), f"baking {name}", len(wo))
    slices = [material.slice(view, light).numpy() for view, light in pairs]
    return BTF(name, wo, wi, ArraySource(np.stack(slices)))


def drawable_truth(btf: BTF, show: Progress = silent) -> tuple[Program, float]:
    """A BTF itself as a program, the interpolated table of its training pairs, and the BTF's own exposure."""
    train = btf.subset(btf.split().train)
    return _interpolated(train, show), exposure(btf)


def sparse_truth(btf: BTF) -> Program | None:
    """A BTF as an interpolated table small enough for a page; None if not even three views and three lights fit into
    `SPARSE_FLOATS`.

    The table has a product of few training views and lights or, if they form no product, as many training pairs.
    """
    train = btf.subset(btf.split().train)
    # `count` views × `count` lights are count² slices of H · W · 3 floats.
    floats_of_slice = 3 * btf.shape[0] * btf.shape[1]
    count = min(SPARSE, int((SPARSE_FLOATS / floats_of_slice) ** 0.5))
    if count < 3:  # the texture is too large for a page
        return None
    layout = train.layout
    if layout.grid is None:  # the pairs are no product of views and lights
        return _interpolated(thinned(train, count * count), silent)
    views = thin(layout.views, min(count, len(layout.views)))
    lights = thin(layout.lights, min(count, len(layout.lights)))
    pairs_in_product = np.flatnonzero(np.isin(layout.view, views) & np.isin(layout.light, lights))
    return _interpolated(train.subset(pairs_in_product), silent)


def _interpolated(btf: BTF, show: Progress) -> Program:
    """All pairs of a BTF as a program: the codec `table`, which stores them and interpolates between directions."""
    codec_class = load_codec("table")
    table = codec_class()
    parts = table.encode(btf, Fit(show=show))
    material = table.decode(parts, torch.device("cpu"))
    return program_of(material)
