import inspect
import itertools
import re
import subprocess
import sys
from dataclasses import dataclass, replace

import numpy as np
import pytest
import torch

from baselines.mean_colour import MeanColour, MeanColourMaterial
from bench.codec import Codec, Parts
from bench.conformance import emulated, stress
from bench.conformance.check import (
    STAGES,
    CheckError,
    CodecUnderTest,
    _require_same,
    counted,
    encodes,
    framed,
    on_a_gpu,
)
from bench.conformance.verdicts import _extremes, check, codec_to_check
from bench.material import DecoderCost, Material
from bench.training.quantise import unpack
from tests.tiers import short_for

OURS = ["mean-colour", "table", "pca", "vq", "hsh", "tucker", "rainer2019", "rainer2020", "neumip", "hierarchical"]
OURS += ["neuralbtf", "neubtf", "neubtf-direct", "zeltner2024", "triple-plane", "bcf", "ntc", "biplane", "svbrdf"]


# The stress test tries all of them in CI, a third for each commit.
@pytest.mark.parametrize("name", short_for(OURS, "mean-colour"))
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
    """The checks that a codec named mean-colour fails, as they come: here its files decode with it, in a fresh process
    with ours."""
    monkeypatch.setattr("bench.codecs.registry.load_codec", lambda name, wanted_by="": codec)
    return (result for result in check(codec()) if result.failure)


class Broken(MeanColour):
    material: type[Material] = MeanColourMaterial

    def decode(self, parts, device):
        return self.material(unpack("mean", parts.texture)).to(device)


def broken(material):
    return type("Faulty", (Broken,), {"material": material})


def answers(fault):
    class Faulty(MeanColourMaterial):
        def evaluate(self, uv, wo, wi, footprint):
            return fault(super().evaluate(uv, wo, wi, footprint), wo, wi)

    return broken(Faulty)


def costs(**cost):
    class Faulty(MeanColourMaterial):
        def __init__(self, texture):
            super().__init__(texture)
            self.cost = DecoderCost(**cost)

    return broken(Faulty)


class Halves(MeanColourMaterial):
    def __init__(self, texture):
        super().__init__(texture[::2, ::2])


class Unseeded(MeanColour):
    """Gives another file each time; random numbers would at times be the same once they are halves."""

    fits = itertools.count()

    def encode(self, btf, fit):
        parts = super().encode(btf, fit)
        return Parts(texture={"mean": parts.texture["mean"] + next(self.fits)})


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


@pytest.mark.parametrize(
    ("codec", "promise"),
    [
        (answers(lambda rgb, wo, wi: rgb * 0), "follows the data"),
        (answers(lambda rgb, wo, wi: rgb + len(rgb) * 1e-6), "one batch answers as many small ones"),
        (answers(lambda rgb, wo, wi: rgb + torch.arange(len(rgb))[:, None] * 1e-6), "order of queries"),
        (answers(lambda rgb, wo, wi: rgb / (wo[:, 2:] > 1e-3)), "view at 89.99°: finite, not negative"),
        (answers(lambda rgb, wo, wi: rgb + 0 * wi @ torch.eye(3, dtype=torch.half)), "by .to(wi.dtype)"),
        (costs(parameters=7), "declared parameters"),
        (costs(texture_channels=3, texture_floats=8 * 8 * 3 // 2), "declared parameters"),
        (costs(texture_channels=1, texture_floats=8 * 8 * 3), "declared parameters"),
        (broken(Halves), "a slice holds the answers"),
        (Unseeded, "same seed and threads give the same bytes"),
    ],
)
@pytest.mark.usefixtures("decodes_here")
def test_a_broken_codec_is_caught(codec, promise, monkeypatch):
    assert any(promise in f"{failed.name}: {failed.failure}" for failed in failures(codec, monkeypatch))


@pytest.mark.long
def test_a_codec_that_needs_the_process_of_its_fit_is_caught(monkeypatch):
    assert any("fresh process" in failed.name for failed in failures(Remembers, monkeypatch))


def with_method(name, does):
    return type("Mine", (MeanColour,), {name: does})


def holds(parameters=0, frozen=False, **more):
    """A codec whose decoder part has 640 numbers, in a network, or with `frozen=None` in plain tensors."""

    class Holding(MeanColourMaterial):
        def __init__(self, texture, weights):
            super().__init__(texture)
            self.cost = replace(self.cost, parameters=parameters, **more)
            if frozen is None:
                self.weight, self.bias = weights["weight"], weights["bias"]
                return
            self.network = torch.nn.Linear(9, 64)
            self.network.load_state_dict(weights)
            self.network.requires_grad_(not frozen)

    class Faulty(MeanColour):
        def encode(self, btf, fit):
            weight = torch.randn(64, 9, generator=fit.generator())
            decoder = {"weight": weight, "bias": torch.ones(64)}
            return Parts(decoder=decoder, texture=super().encode(btf, fit).texture)

        def decode(self, parts, device):
            return Holding(unpack("mean", parts.texture), dict(parts.decoder)).to(device)

    return Faulty


class Coarse(MeanColour):
    """Has a texture of half the resolution alone, and declares no channels."""

    def encode(self, btf, fit):
        fine = super().encode(btf, fit).texture["mean"].float()
        return Parts(texture={"mean": fine.unflatten(0, (-1, 2)).unflatten(2, (-1, 2)).mean((1, 3))})

    def decode(self, parts, device):
        material = MeanColourMaterial(unpack("mean", parts.texture))
        material.size = (2 * material.size[0], 2 * material.size[1])
        material.cost = DecoderCost(texture_floats=parts.texture["mean"].numel())
        return material.to(device)


def storing(change):
    def encode(self, btf, fit):
        texture = MeanColour.encode(self, btf, fit).texture
        return Parts(texture=texture, other=change(texture["mean"]))

    return with_method("encode", encode)


def quits(self, btf, fit):
    raise SystemExit(0)


@pytest.mark.parametrize(
    ("codec", "says"),
    [
        (holds(), "declares 0 parameters, holds 640: declare DecoderCost(parameters=640)"),
        (holds(frozen=True), "declares 0 parameters, holds 640: declare DecoderCost(parameters=640)"),
        (holds(frozen=None), "stores 640 numbers; 640 of them are neither parameters nor declared as tables"),
        (holds(parameters=1280), "declares 1,280 parameters, holds 640 in modules"),
        (Coarse, "declares 0 texture channels, stores 3"),
        (with_method("encode", quits), "it ends the process with exit code 0: raise an error instead"),
        (storing(lambda mean: {"x": mean.float() / 0 * 0}), "other/x holds 192 of 192 numbers that are not finite"),
        (storing(lambda mean: {"x": mean.to(torch.float8_e4m3fn)}), "other/x is of type float8_e4m3fn, which a file"),
        (storing(lambda mean: {"x": mean.float().to(torch.uint16)}), "other/x is of type uint16, which a file"),
    ],
)
@pytest.mark.usefixtures("decodes_here")
def test_faults_of_parameters_and_of_what_encode_does_are_named(codec, says, monkeypatch):
    assert any(says in failed.failure for failed in failures(codec, monkeypatch))


class Slow(MeanColour):
    """Learns a twentieth of the mean a step."""

    @dataclass(frozen=True)
    class Settings:
        half: bool = False
        steps: int = 40

    def encode(self, btf, fit):
        mean = super().encode(btf, fit).texture["mean"]
        return Parts(texture={"mean": mean * (1 - 0.95**self.settings.steps) + 0.01 * 0.95**self.settings.steps})


@pytest.mark.long
@pytest.mark.usefixtures("decodes_here")
def test_a_codec_that_learns_slowly_is_told_once_how_to_give_it_more_steps(tmp_path, monkeypatch):
    monkeypatch.setattr("bench.codecs.registry.load_codec", lambda name, wanted_by="": Slow)
    failed = {result.name: result.failure for result in _extremes(CodecUnderTest(Slow(), tmp_path)) if result.failure}
    hinted = [name for name, why in failed.items() if "40 steps" in why]
    assert len(hinted) == 1, failed
    assert failed[hinted[0]].endswith("--set steps=400")
    assert not any("--set steps" in failed.failure for failed in failures(holds(), monkeypatch))  # it has no steps


class Raises(MeanColour):
    def encode(self, btf, fit):
        return super().encode(btf, fit), self.no_such_thing


class InAList(MeanColourMaterial):
    def __init__(self, texture):
        super().__init__(texture)
        self.levels = [texture]

    def evaluate(self, uv, wo, wi, footprint):
        return super().evaluate(uv, wo, wi, footprint) + 0 * self.levels[0][0, 0]


def stays_behind(self, parts, device):
    return MeanColourMaterial(unpack("mean", parts.texture))


def untold(self, parts, device):
    return MeanColourMaterial(unpack("mean", parts.texture).to(device))


@pytest.mark.parametrize(
    ("codec", "says"),
    [
        (with_method("decode", stays_behind), "your decoder leaves `texture` on the CPU: return `material.to(device)`"),
        (broken(InAList), "your decoder leaves `levels.0` on the CPU (RuntimeError"),
        (with_method("decode", untold), "your decoder does not tell its material that it is on a GPU: return"),
    ],
)
@pytest.mark.usefixtures("decodes_here")
def test_a_decoder_that_leaves_a_tensor_on_the_cpu_is_told_its_name(codec, says, monkeypatch, gpu):
    (failed,) = failures(codec, monkeypatch)
    assert failed.failure.startswith(says)


TINT = torch.full((3,), 1.0)


class WithAGlobal(MeanColourMaterial):
    def evaluate(self, uv, wo, wi, footprint):
        return super().evaluate(uv, wo, wi, footprint) * TINT


def fits_with_a_variable(self, btf, fit):
    mean = MeanColour.encode(self, btf, fit).texture["mean"].to(fit.device)
    weights = torch.full((1, 3), 1.0)
    return Parts(texture={"mean": torch.cat([mean * 1, weights.expand(*mean.shape)], 0)[: len(mean)]})


@pytest.mark.parametrize(
    ("codec", "name"),
    [(broken(WithAGlobal), "TINT"), (with_method("encode", fits_with_a_variable), "weights")],
)
@pytest.mark.usefixtures("decodes_here")
def test_a_tensor_that_meets_the_gpus_on_the_cpu_is_named_with_the_authors_line(codec, name, monkeypatch, gpu):
    (failed,) = failures(codec, monkeypatch)
    assert failed.failure.startswith(f"`{name}` ")
    assert f"{__file__}:" in failed.failure


@pytest.mark.long
@pytest.mark.usefixtures("decodes_here")
def test_a_file_of_one_number_is_noted(monkeypatch):
    def padded(self, btf, fit):
        parts = MeanColour.encode(self, btf, fit)
        return replace(parts, other={**parts.other, "padding": torch.zeros(50_000)})

    codec = with_method("encode", padded)
    monkeypatch.setattr("bench.codecs.registry.load_codec", lambda name, wanted_by="": codec)
    (note,) = [result.note for result in check(codec()) if result.name == counted.__doc__]
    assert "other/padding (200,000" in note


@pytest.mark.long
@pytest.mark.usefixtures("decodes_here")
def test_a_pytorch_that_emulates_no_gpu_fails_no_codec(monkeypatch):
    monkeypatch.setattr(emulated, "_libraries", [])
    monkeypatch.delattr("torch.utils.backend_registration._setup_privateuseone_for_python_backend")
    (reason,) = (result.reason for result in check(MeanColour()) if result.name == on_a_gpu.__doc__)
    assert torch.__version__ in reason


AFTER_A_GRADIENT = """
import torch
from baselines.mean_colour import MeanColour
from bench.conformance import stress, verdicts
from bench.conformance.check import on_a_gpu
verdicts.STAGES, stress.CASES = ((on_a_gpu,),), ()
torch.ones(1, requires_grad=True).sum().backward()
print([result.reason for result in verdicts.check(MeanColour())])
"""


@pytest.mark.long
def test_a_process_that_took_a_gradient_emulates_no_gpu_and_fails_no_codec(gpu):
    done = subprocess.run([sys.executable, "-c", AFTER_A_GRADIENT], capture_output=True, text=True, check=True)
    assert re.fullmatch(r"\['[^']*gradient[^']*'\]\n", done.stdout)


def test_the_first_failing_stage_is_the_last_and_names_the_authors_line_once(monkeypatch):
    monkeypatch.setattr("bench.codecs.registry.load_codec", lambda name, wanted_by="": Raises)
    results = list(check(Raises()))
    assert [result.name for result in results if result.failure] == [encodes.__doc__]
    line = inspect.getsourcelines(Raises.encode)[1] + 1
    messages = "\n".join(result.failure for result in results)
    assert messages.count(f"{__file__}:{line}") == 1
    assert "no_such_thing" in messages
    assert len(results) == 1


def draws(self, *queries):
    return MeanColourMaterial.evaluate(self, *queries) + torch.rand(len(queries[0]), 3) / 10


MISTAKES = [
    ("evaluate", lambda self, uv, *_: uv.mean(1), r"a tensor \(4,\), but must return a tensor \(4, 3\)"),
    ("evaluate", draws, "other answers to the same queries .* no random"),
    ("encode", lambda *_: Parts(texture={"mean": np.zeros(3)}), "texture/mean is of type ndarray, but must"),
    ("encode", lambda *_: {"mean": torch.zeros(8, 8, 3)}, "a dict, but must return Parts of tensors"),
    ("encode", lambda *_: Parts(texture=torch.zeros(8, 8, 3)), "texture is of type Tensor, but must return a dict"),
    ("decode", lambda *_: torch.zeros(8, 8, 3), "returned a Tensor, but must return a Material"),
]


@pytest.mark.parametrize(("name", "method", "says"), MISTAKES)
def test_a_first_mistake_names_the_method_its_line_and_the_remedy(name, method, says, monkeypatch):
    material = type("Faulty", (MeanColourMaterial,), {name: method})
    (failed,) = failures(broken(material) if name == "evaluate" else with_method(name, method), monkeypatch)
    message = failed.failure
    code = method.__code__
    assert message.startswith(f"{method.__qualname__} ({__file__}:{code.co_firstlineno}) returned ")
    assert re.search(says, message), message
    assert "\n" not in message


def test_answers_of_another_shape_are_named():
    with pytest.raises(CheckError, match=r"slice: answers have the shape \(4, 3\), not \(5, 3\)"):
        _require_same("slice", torch.zeros(4, 3), torch.zeros(5, 3), tolerance=0.0)
