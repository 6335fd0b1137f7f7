import dataclasses
import itertools
from typing import get_args, get_type_hints

import numpy as np
import pytest
import torch

from bench.codec import Fit
from bench.codecs import container, shared
from bench.codecs.registry import codec_entries, load_codec
from bench.conformance.check import CodecUnderTest, batches, counted, others, slices, tiny_btf, wraps
from bench.training.stored_network import BEARABLE

COARSE = {32: 0.002, 16: 0.002, 8: 0.02}  # bits of a number, and how far the answers may be off
SHORT = ("pca", "relief")  # of the short tier
# Few steps at a high rate would move constant channels far from the range that was rounded to at half of the steps.
BRIEF = {"plane_rate": 1e-3, "steps": 3, "texels": 4, "pairs": 4, "batch": 64, "kept": 8, "components": 4}


def settings(kind, **chosen):
    """Those of `kind` that make a fit short, and of the chosen ones what it has."""
    names = {field.name for field in dataclasses.fields(kind.Settings)}
    return kind(**{name: value for name, value in (BRIEF | chosen).items() if name in names})


def choices(kind, name):
    return get_args(get_type_hints(kind.Settings).get(name)) if kind else ()


def ladder():
    """Each codec with each precision of its textures and each of its weights, the finest first."""
    for name in sorted(codec_entries()):
        codec = load_codec(name)
        textures = [bits for bits in choices(codec, "bits") if bits in COARSE]
        weights = choices(codec, "weights") or choices(codec.network, "weights") or ("",)
        if textures:
            yield name, list(itertools.product(sorted(textures, reverse=True), sorted(weights)))


def trained(codec, weights, folder):
    network, path = settings(codec.network, weights=weights), folder / f"{codec.name}{container.SUFFIX}"
    return shared.read(shared.make(network, others(tiny_btf()), Fit(seed=1), path).path)


def fit_error(tested):
    """The root mean square error of the log1p of the answers at the data."""
    pairs = zip(tested.btf.wo.tolist(), tested.btf.wi.tolist(), strict=True)
    decoded = torch.stack([tested.material.slice(wo, wi) for wo, wi in pairs])
    truth = torch.from_numpy(np.stack(list(tested.btf)))
    return (decoded.log1p() - truth.log1p()).square().mean().sqrt()


@pytest.mark.parametrize(
    ("name", "precisions"),
    [pytest.param(*each, id=each[0], marks=() if each[0] in SHORT else pytest.mark.long) for each in ladder()],
)
def test_every_precision_keeps_the_promises_and_answers_nearly_as_the_finest(name, precisions, tmp_path):
    answers = []
    for bits, weights in precisions:
        codec = settings(load_codec(name), bits=bits, weights=weights)
        folder = tmp_path / f"{bits} {weights}"
        folder.mkdir()
        tested = CodecUnderTest(codec, folder, trained(codec, weights, folder) if codec.network else None)
        for promise in (batches, slices, wraps, counted):
            promise(tested)
        tensors = tested.header.file_bytes - tested.header.part_bytes()["header"]  # its words deflate by chance
        answers.append((tensors, tested.answers.log1p()))
        if len(answers) == 1:  # of the finest
            error = fit_error(tested)
    for (bits, weights), (size, answer) in zip(precisions, answers, strict=True):
        difference, scale = (answer - answers[0][1]).square().mean().sqrt(), answers[0][1].square().mean().sqrt()
        # A step of eight bits is 1/255 of a channel's range, and a decoder may answer it with some steps of its own.
        allowed = COARSE[bits] * scale
        if weights == "int8":  # they may add a share of the squared error of the fit, which is large after few steps
            allowed = max(COARSE[8] * scale, 2 * BEARABLE**0.5 * error)
        assert difference <= allowed
        assert size <= answers[0][0]
    assert torch.stack([answer for _, answer in answers]).isfinite().all()
