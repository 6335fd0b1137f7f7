"""The conformance test must fail where a codec breaks a promise: each broken codec here breaks one."""

import random
from dataclasses import dataclass

import pytest
import torch

from baselines.mean_colour import MeanColour, MeanColourMaterial
from bench.codec import Codec, Parts
from bench.codecs.quantise import unpack
from bench.codecs.registry import load_codec
from bench.conformance import stability
from bench.conformance.check import CHECKS
from bench.conformance.verdicts import check
from bench.material import DecoderCost, Material


@pytest.mark.parametrize("name", ["mean-colour", "table", "pca"])
def test_our_codecs_keep_every_promise(name):
    results = list(check(load_codec(name)()))
    assert len(results) == len(CHECKS) + sum(case.cheap for case in stability.CASES)
    assert [result for result in results if result.failure] == []


def failures(codec, monkeypatch):
    """The checks that a codec named mean-colour fails: here its files decode with it, in a fresh process with ours."""
    monkeypatch.setattr("bench.codecs.registry.load_codec", lambda name, wanted_by="": codec)
    return {result.name: result.failure for result in check(codec()) if result.failure}


class Broken(MeanColour):
    """The mean-colour codec with one fault in its material."""

    material: type[Material] = MeanColourMaterial

    def decode(self, parts, device):
        return self.material(unpack("mean", parts.texture))


class Dark(MeanColourMaterial):
    def evaluate(self, uv, wo, wi, footprint):
        return torch.zeros(len(uv), 3)


class DependsOnBatch(MeanColourMaterial):
    def evaluate(self, uv, wo, wi, footprint):
        return super().evaluate(uv, wo, wi, footprint) + len(uv) * 1e-3


class DependsOnOrder(MeanColourMaterial):
    def evaluate(self, uv, wo, wi, footprint):
        return super().evaluate(uv, wo, wi, footprint) + torch.arange(len(uv))[:, None] * 1e-3


class BreaksAtGrazing(MeanColourMaterial):
    def evaluate(self, uv, wo, wi, footprint):
        return super().evaluate(uv, wo, wi, footprint) / (wo[:, 2:] > 1e-3)


class Miscounts(MeanColourMaterial):
    def __init__(self, texture):
        super().__init__(texture)
        self.cost = DecoderCost(parameters=7)


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


@pytest.mark.parametrize(
    ("codec", "promise"), [(Unseeded, "same seed and threads give the same bytes"), (Remembers, "fresh process")]
)
def test_a_broken_fit_is_caught(codec, promise, monkeypatch):
    failed = failures(codec, monkeypatch)
    assert any(promise in name for name in failed), failed
