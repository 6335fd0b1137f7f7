"""The conformance test must fail where a codec breaks a promise: each broken codec here breaks one."""

import inspect
import random
import re
import subprocess
import sys
from dataclasses import dataclass

import numpy as np
import pytest
import torch

from baselines.mean_colour import MeanColour, MeanColourMaterial
from bench.codec import Codec, Parts
from bench.conformance import emulated, stress
from bench.conformance.check import STAGES, encodes, framed, on_a_gpu
from bench.conformance.verdicts import check, codec_to_check
from bench.material import DecoderCost, Material
from bench.training.quantise import unpack
from tests.tiers import short_for

OURS = ["mean-colour", "table", "pca", "vq", "hsh", "tucker", "rainer2019", "rainer2020", "neumip", "hierarchical"]
OURS += ["neuralbtf", "neubtf", "neubtf-direct", "zeltner2024", "triple-plane", "bcf", "ntc", "biplane", "svbrdf"]


# The stress test tries all of them in CI.
@pytest.mark.parametrize("name", short_for(OURS, "mean-colour", "neubtf-direct", "rainer2020"))
def test_our_codecs_keep_every_promise(name, monkeypatch):
    # The extremes are tried on every codec by the stress test, where they have a table of their own.
    learned = name not in ("mean-colour", "table", "pca")
    if learned:
        monkeypatch.setattr(stress, "CASES", ())
    results = list(check(codec_to_check(name, {})))
    assert len(results) == sum(map(len, STAGES)) + (0 if learned else sum(case.cheap for case in stress.CASES))
    assert [result for result in results if result.failure] == []
    told_apart = [result.note for result in results if result.name == framed.__doc__]
    assert all(told_apart) == (name in ("mean-colour", "svbrdf"))  # of which neither sees a single azimuth


def failures(codec, monkeypatch):
    """The checks that a codec named mean-colour fails: here its files decode with it, in a fresh process with ours."""
    monkeypatch.setattr("bench.codecs.registry.load_codec", lambda name, wanted_by="": codec)
    return {result.name: result.failure for result in check(codec()) if result.failure}


class Broken(MeanColour):
    """The mean-colour codec with one fault in its material."""

    material: type[Material] = MeanColourMaterial

    def decode(self, parts, device):
        return self.material(unpack("mean", parts.texture)).to(device)


class Dark(MeanColourMaterial):
    def evaluate(self, uv, wo, wi, footprint):
        return torch.zeros(len(uv), 3)


class DependsOnBatch(MeanColourMaterial):
    def evaluate(self, uv, wo, wi, footprint):
        return super().evaluate(uv, wo, wi, footprint) + len(uv) * 1e-6


class DependsOnOrder(MeanColourMaterial):
    def evaluate(self, uv, wo, wi, footprint):
        return super().evaluate(uv, wo, wi, footprint) + torch.arange(len(uv))[:, None] * 1e-6


class BreaksAtGrazing(MeanColourMaterial):
    def evaluate(self, uv, wo, wi, footprint):
        return super().evaluate(uv, wo, wi, footprint) / (wo[:, 2:] > 1e-3)


class Miscounts(MeanColourMaterial):
    def __init__(self, texture):
        super().__init__(texture)
        self.cost = DecoderCost(parameters=7)


class MiscountsNumbers(MeanColourMaterial):
    def __init__(self, texture):
        super().__init__(texture)
        self.cost = DecoderCost(texture_channels=3, texture_floats=texture.numel() // 2)


class MiscountsChannels(MeanColourMaterial):
    def __init__(self, texture):
        super().__init__(texture)
        self.cost = DecoderCost(texture_channels=1, texture_floats=texture.numel())


class Halves(MeanColourMaterial):
    def __init__(self, texture):
        super().__init__(texture[::2, ::2])


@pytest.mark.parametrize(
    ("material", "promise"),
    [
        (Dark, "follows the data"),
        (DependsOnBatch, "one batch answers as many small ones"),
        (DependsOnOrder, "order of queries"),
        (BreaksAtGrazing, "view at 89.99°: finite, not negative"),
        (Miscounts, "declared parameters"),
        (MiscountsNumbers, "declared parameters"),
        (MiscountsChannels, "declared parameters"),
        (Halves, "a slice holds the answers"),
    ],
)
def test_a_broken_material_is_caught(material, promise, monkeypatch):
    failed = failures(type("Faulty", (Broken,), {"material": material}), monkeypatch)
    assert any(promise in name for name in failed), failed


class Unseeded(MeanColour):
    def encode(self, btf, fit):
        parts = super().encode(btf, fit)
        return Parts(texture={"mean": parts.texture["mean"] + random.random() / 100})


class Remembers(Codec):
    """Decodes to what it fitted in this process: a fresh one has nothing."""

    name, version = "mean-colour", 1
    kept = None

    @dataclass(frozen=True)
    class Settings:
        half: bool = True

    def encode(self, btf, fit):
        Remembers.kept = MeanColour().encode(btf, fit).texture["mean"]
        return Parts(other={"nothing": torch.zeros(1)})

    def decode(self, parts, device):
        return MeanColourMaterial(Remembers.kept.float())


class Halved(MeanColourMaterial):
    """Multiplies by a matrix of the material's precision, without turning what meets it."""

    def evaluate(self, uv, wo, wi, footprint):
        return super().evaluate(uv, wo, wi, footprint) + 0 * wi @ torch.eye(3, dtype=torch.half)


def test_a_failure_comes_with_its_remedy(monkeypatch):
    (message,) = failures(Unseeded, monkeypatch).values()
    assert message.endswith("draw from fit.generator() or fit.seed alone")
    faulty = type("Faulty", (Broken,), {"material": Halved})
    assert "by .to(wi.dtype)" in next(iter(failures(faulty, monkeypatch).values()))


@pytest.mark.parametrize(
    ("codec", "promise"), [(Unseeded, "same seed and threads give the same bytes"), (Remembers, "fresh process")]
)
def test_a_broken_fit_is_caught(codec, promise, monkeypatch):
    failed = failures(codec, monkeypatch)
    assert any(promise in name for name in failed), failed


class Raises(MeanColour):
    def encode(self, btf, fit):
        return super().encode(btf, fit), self.no_such_thing


class StaysBehind(MeanColour):
    def decode(self, parts, device):
        return MeanColourMaterial(unpack("mean", parts.texture))


class InAList(MeanColourMaterial):
    def __init__(self, texture):
        super().__init__(texture)
        self.levels = [texture]

    def evaluate(self, uv, wo, wi, footprint):
        return super().evaluate(uv, wo, wi, footprint) + 0 * self.levels[0][0, 0]


class Untold(MeanColour):
    def decode(self, parts, device):
        return MeanColourMaterial(unpack("mean", parts.texture).to(device))


@pytest.mark.parametrize(
    ("codec", "says"),
    [
        (StaysBehind, "your decoder leaves `texture` on the CPU: return `material.to(device)`"),
        (type("Faulty", (Broken,), {"material": InAList}), "your decoder leaves `levels.0` on the CPU (RuntimeError"),
        (Untold, "your decoder does not tell its material that it is on a GPU: return `material.to(device)`"),
    ],
)
def test_a_decoder_that_leaves_a_tensor_on_the_cpu_is_told_its_name(codec, says, monkeypatch, gpu):
    (message,) = failures(codec, monkeypatch).values()
    assert message.startswith(says)


def test_a_pytorch_that_emulates_no_gpu_fails_no_codec(monkeypatch):
    monkeypatch.setattr(emulated, "_libraries", [])
    monkeypatch.delattr("torch.utils.backend_registration._setup_privateuseone_for_python_backend")
    (reason,) = (result.reason for result in check(MeanColour()) if result.name == on_a_gpu.__doc__)
    assert reason.startswith("a GPU is emulated by PyTorch 2.9 or newer, and this is ")


AFTER_A_GRADIENT = """
import torch
from baselines.mean_colour import MeanColour
from bench.conformance.check import on_a_gpu
from bench.conformance.verdicts import check
torch.ones(1, requires_grad=True).sum().backward()
print([result.reason for result in check(MeanColour()) if result.name == on_a_gpu.__doc__])
"""


def test_a_process_that_took_a_gradient_emulates_no_gpu_and_fails_no_codec(gpu):
    done = subprocess.run([sys.executable, "-c", AFTER_A_GRADIENT], capture_output=True, text=True, check=True)
    assert done.stdout == "['a GPU is emulated only in a process that took no gradient before']\n"


def test_the_first_failing_stage_is_the_last_and_names_the_authors_line_once(monkeypatch):
    monkeypatch.setattr("bench.codecs.registry.load_codec", lambda name, wanted_by="": Raises)
    results = list(check(Raises()))
    assert [result.name for result in results if result.failure] == [encodes.__doc__]
    line = inspect.getsourcelines(Raises.encode)[1] + 1
    messages = "\n".join(result.failure for result in results)
    assert messages.count(f"{__file__}:{line}") == 1
    assert "no_such_thing" in messages
    assert len(results) == 1


class Flat(MeanColourMaterial):
    def evaluate(self, uv, wo, wi, footprint):
        return super().evaluate(uv, wo, wi, footprint).mean(1)


class Draws(MeanColourMaterial):
    def evaluate(self, uv, wo, wi, footprint):
        return super().evaluate(uv, wo, wi, footprint) + torch.rand(len(uv), 3) / 10


def with_method(name, does):
    return type("Mine", (MeanColour,), {name: does})


def gives_arrays(self, btf, fit):
    return Parts(texture={"mean": np.zeros((8, 8, 3))})


def gives_a_dictionary(self, btf, fit):
    return {"mean": torch.zeros(8, 8, 3)}


def gives_a_tensor(self, btf, fit):
    return Parts(texture=torch.zeros(8, 8, 3))


def decodes_to_a_tensor(self, parts, device):
    return unpack("mean", parts.texture)


MISTAKES = [
    (type("Mine", (Broken,), {"material": Flat}), Flat.evaluate, r"a tensor \(4,\), but must return a tensor \(4, 3\)"),
    (type("Mine", (Broken,), {"material": Draws}), Draws.evaluate, "other answers to the same queries .* no random"),
    (
        with_method("encode", gives_arrays),
        gives_arrays,
        "Parts whose texture/mean is of type ndarray, but must return a tensor",
    ),
    (with_method("encode", gives_a_dictionary), gives_a_dictionary, "a dict, but must return Parts of tensors"),
    (with_method("encode", gives_a_tensor), gives_a_tensor, "texture is of type Tensor, but must return a dictionary"),
    (with_method("decode", decodes_to_a_tensor), decodes_to_a_tensor, "returned a Tensor, but must return a Material"),
]


@pytest.mark.parametrize(("codec", "method", "says"), MISTAKES, ids=lambda given: getattr(given, "__qualname__", None))
def test_a_first_mistake_names_the_method_its_line_and_the_remedy(codec, method, says, monkeypatch):
    (message,) = failures(codec, monkeypatch).values()
    code = method.__code__
    assert message.startswith(f"{method.__qualname__} ({__file__}:{code.co_firstlineno}) returned ")
    assert re.search(says, message), message
    assert "\n" not in message
