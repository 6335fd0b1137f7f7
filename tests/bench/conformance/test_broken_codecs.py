"""`BROKEN` names for each row of the catalogue a codec that breaks there, and what the verdict must say of it."""

import itertools
import re
from dataclasses import dataclass

import numpy as np
import pytest
import torch

from baselines.mean_colour import MeanColour, MeanColourMaterial
from bench.btf import NotFiniteError
from bench.codec import Parts
from bench.conformance import stress
from bench.conformance.stress.case import subject_of
from bench.conformance.stress.data import ordinary
from bench.conformance.stress.queries import Queries
from bench.material import HALF_MAX, DecoderCost, Material, sample_texture, to_radiance
from bench.training import Bits, Rounding, load_texture, store_texture
from bench.training.decoder import Architecture, Decoder
from bench.training.quantise import unpack
from bench.training.stored_network import load_vector, to_vector

CASES = {case.name: case for case in stress.CASES}


class Sound(MeanColour):
    material: type[Material] = MeanColourMaterial

    def decode(self, parts, device):
        return self.material(unpack("mean", parts.texture))


class TinyMaterial(Material):
    architecture = Architecture(inputs=3, widths=(4,), activation="sine", norm=True)
    kind = Decoder

    def __init__(self, texture, weights):
        super().__init__(tuple(texture.shape[:2]), DecoderCost())
        self.texture, self.network = texture, self.kind(self.architecture)
        load_vector(weights, self.network)

    def evaluate(self, uv, wo, wi, footprint):
        return self.radiance(self.network(sample_texture(self.texture, uv)))

    def radiance(self, level):
        return to_radiance(level, 1.0)


class Tiny(Sound):
    material = TinyMaterial

    @dataclass(frozen=True)
    class Settings:
        bits: Bits = 32

    def encode(self, btf, fit):
        mean = torch.from_numpy(np.mean(list(btf), 0))
        weights = to_vector(Decoder(TinyMaterial.architecture, fit.generator()))
        rounding = Rounding(3, self.settings.bits)
        if rounding.undecided:
            rounding.set(mean, torch.full((3,), 8))
        return Parts(decoder={"weights": weights}, texture=store_texture("mean", mean, rounding))

    def decode(self, parts, device):
        return self.material(load_texture("mean", parts.texture), parts.decoder["weights"].float())


def with_material(material, codec=Sound):
    return type("Broken", (codec,), {"material": material})


def with_methods(base=MeanColourMaterial, **methods):
    return with_material(type("Faulty", (base,), methods), Tiny if base is TinyMaterial else Sound)


def answers(fault):
    """A codec whose answers went through `fault(rgb, queries)`."""
    return with_methods(evaluate=lambda self, *q: fault(MeanColourMaterial.evaluate(self, *q), Queries(*q)))


def at(place):
    return with_methods(evaluate=lambda self, uv, *rest: MeanColourMaterial.evaluate(self, place(uv), *rest))


def replies(fault):
    """A codec whose answers, below the horizon and clamped, went through `fault(rgb, queries)`."""

    def query(self, uv, wo, wi, footprint=None):
        return fault(MeanColourMaterial.query(self, uv, wo, wi, footprint), Queries(uv, wo, wi, footprint))

    return with_methods(query=query)


def stores(mean):
    """A codec that stores `mean(values (N, H, W, 3), btf)` as its texture (H, W, 3)."""

    class Faulty(Sound):
        def encode(self, btf, fit):
            values = torch.from_numpy(np.stack(list(btf))).double()
            return Parts(texture={"mean": mean(values, btf).float()})

    return Faulty


def of_itself(x):
    """1, but 0 / 0 where a number is 0."""
    return x / x


def eight_bits_of_the_peak(values, btf):
    mean = values.mean(0)
    return (mean / mean.max() * 255).round() * mean.max() / 255


def between_least_and_largest(values, btf):
    mean = values.mean(0)
    low, range_ = mean.amin((0, 1)), mean.amax((0, 1)) - mean.amin((0, 1))
    return low + (mean - low) / range_ * range_


def with_a_short_cosine(values, btf):
    cosine = torch.from_numpy(btf.wi[:, 2].astype(np.float64))
    return (values / cosine.clamp_min(0.1)[:, None, None, None]).mean(0) * cosine.mean()


def once_a_pair(values, btf):
    return values.sum(0) / len(np.unique(np.concatenate([btf.wo, btf.wi], 1), axis=0))


def one_row_too_bright(values, btf):
    return values.mean(0) * (1 + 99 * (torch.arange(values.shape[1]) == 2))[:, None, None]


class Forgiving(Sound):
    def encode(self, btf, fit):
        try:
            return super().encode(btf, fit)
        except NotFiniteError as error:
            return Parts(texture={"mean": torch.from_numpy(np.nan_to_num(error.values))})


class BelowRepair(Sound):
    def encode(self, btf, fit):
        source = getattr(btf.source, "source", btf.source)
        return Parts(texture={"mean": torch.from_numpy(np.mean([source.slice(i) for i in range(len(btf))], 0))})


class Rate(Sound):
    @dataclass(frozen=True)
    class Settings:
        half: bool = True
        rate: float = 1e-2


class AnswersTheHorizon(MeanColourMaterial):
    def _answer(self, uv, wo, wi, footprint):
        below = (wo[:, 2:] < 0) | (wi[:, 2:] < 0)
        return self.evaluate(uv, wo, wi, footprint).masked_fill(below, 0)


class Unchecked(MeanColourMaterial):
    def query(self, uv, wo, wi, footprint=None):
        return self._answer(uv, wo, wi, uv.new_zeros(len(uv)) if footprint is None else footprint)


def one_period(self, uv, *rest):
    return MeanColourMaterial._answer(self, uv.clamp(0, 1), *rest)


class HalfGain(MeanColourMaterial):
    def __init__(self, texture):
        super().__init__(texture)
        self.gain = torch.tensor([1e6])

    def evaluate(self, *queries):
        return super().evaluate(*queries) * self.gain / self.gain


def added_up(rgb, queries):
    """The mean of a thousand, added up at the precision of the texture."""
    return sum(itertools.repeat(rgb, 1000), torch.zeros_like(rgb)) / 1000


def brighter_at_a_sample(rgb, queries):
    return rgb * (1 + 0.1 * (queries.wo[:, None] == torch.from_numpy(ordinary().wo)).all(2).any(1, keepdim=True))


def a_level_of_detail(rgb, queries):
    levels = (queries.footprint * 8).log2().clamp_min(0).ceil().long()
    return rgb * torch.ones(4)[levels][:, None]


def half_footprint(rgb, queries):
    size = queries.footprint[:, None]
    return torch.where(size > 0, rgb * of_itself(size.half().float()), rgb)


class HalfSine(Decoder):
    def _activate(self, x):
        return x.half().sin().to(x.dtype)


class NoEpsilon(TinyMaterial):
    def __init__(self, *stored):
        super().__init__(*stored)
        for norm in self.network.norms:
            norm.eps = 0.0


class LastCodeMissing(Tiny):
    def decode(self, parts, device):
        material, texture = super().decode(parts, device), parts.texture
        if "mean.step" in texture:
            codes = (material.texture - texture["mean.low"]) / texture["mean.step"]
            material.texture[codes > 254.5] = torch.nan
        return material


BAD, NAN, INF = "not finite", r"\[nan", "inf"
DUE = "required"
MOVES = "the answer moves by"
DIFFER = "answers differ by"
HALF_SUM = stores(lambda values, btf: values.sum(0).half() / len(values))
NO_WRAP = at(lambda uv: uv.clamp(1 / 16, 15 / 16))  # does not go from the last texel to the first
OF_THE_PEAK = stores(eight_bits_of_the_peak)

BROKEN = {
    # data
    "all zero": (stores(lambda v, btf: v.mean(0) / v.max() * v.max()), BAD),
    "two constants": (stores(lambda v, btf: v.mean((0, 1, 2)).expand(v.shape[1:])), "off by 150"),
    "one texel": (stores(between_least_and_largest), BAD),
    "one pair": (stores(lambda v, btf: v.mean(0) * of_itself(v.amax(0) - v.amin(0))), BAD),
    "one row": (stores(lambda v, btf: v.mean(0).transpose(0, 1)), "8 × 1"),
    "3 × 1,001 texels": (stores(lambda v, btf: v.mean(0) * (torch.arange(v.shape[2]) < 256)[:, None]), DUE),
    "rank one": (stores(lambda v, btf: v[v.mean((1, 2, 3)).argmax()]), DUE),
    "scaled by 2^-27": (stores(lambda v, btf: v.mean(0) + 1e-6), "unscaled"),
    "scaled by 2^-13": (stores(lambda v, btf: (v.mean(0) * 255).round() / 255), "unscaled"),
    "scaled by 2^13": (stores(lambda v, btf: v.mean(0).clamp(max=100)), "unscaled"),
    "65,504 beside zeros": (HALF_SUM, BAD),
    "random highlights of 65,504": (HALF_SUM, BAD),
    "highlights of 1e6": (stores(lambda v, btf: v.mean(0).clamp(max=HALF_MAX)), DUE),
    "subnormal halves": (stores(lambda v, btf: v.mean(0) * (v.mean(0) >= 2**-14)), DUE),
    "one firefly texel": (OF_THE_PEAK, DUE),
    "negative noise below 1e-3": (stores(lambda v, btf: v.sqrt().mean(0).square()), BAD),
    "identical pairs twice": (stores(once_a_pair), DUE),
    "black seen from above": (stores(lambda v, btf: v[(btf.wo + btf.wi)[:, 2].argmax()]), DUE),
    "views only at the zenith": (stores(lambda v, btf: v.mean(0) * of_itself(torch.tensor(np.ptp(btf.wo, 0)))), BAD),
    "lights only at grazing": (stores(with_a_short_cosine), DUE),
    "NaN and infinite texels": (Forgiving, "were encoded"),
    "NaN texels, repaired": (BelowRepair, BAD),
    # queries
    "view at 89.99°": (answers(lambda rgb, q: rgb / (q.wo[:, 2:] > 1e-3)), INF),
    "light at 89.99°": (answers(lambda rgb, q: rgb / (q.wi[:, 2:] > 0.3)), INF),
    "view and light at 89.99°": (answers(lambda rgb, q: rgb / ((q.wo + q.wi)[:, 2:] > 0.3)), INF),
    "view and light barely above z = 0": (answers(lambda rgb, q: rgb * of_itself(q.wo[:, 2:].square())), NAN),
    "ω_o = ω_i": (answers(lambda rgb, q: rgb * of_itself((q.wo - q.wi).norm(dim=1)[:, None])), NAN),
    "light mirrored to the view": (
        answers(lambda rgb, q: rgb * of_itself((q.wo + q.wi)[:, :2].square().sum(1, True))),
        NAN,
    ),
    "light opposite to the view": (with_methods(_answer=lambda self, *queries: self.evaluate(*queries)), "at --query"),
    "view at the zenith": (answers(lambda rgb, q: rgb + 1e-3 / (1 - q.wo[:, 2:] + 1e-6)), "answers, the first"),
    "light at the zenith": (answers(lambda rgb, q: rgb * of_itself(q.wi[:, :2].norm(dim=1)[:, None])), NAN),
    "view and light at the zenith": (answers(lambda rgb, q: rgb * of_itself(2 - (q.wo + q.wi)[:, 2:])), NAN),
    "z = 0 and below": (with_material(AnswersTheHorizon), "at --query"),
    "direction not of unit length": (with_material(Unchecked), "length 2 was answered"),
    "uv = ±1e6": (with_methods(_answer=one_period), DIFFER),
    "uv = −0.0": (replies(lambda rgb, q: rgb * ~q.uv.signbit().any(1, keepdim=True)), DIFFER),
    "uv = 1 − 2⁻²⁴": (NO_WRAP, DIFFER),
    "footprint 0": (answers(lambda rgb, q: rgb + 1e-6 / (q.footprint[:, None] + 1e-12)), "answers, the first"),
    "footprint 1e-9": (answers(half_footprint), NAN),
    "footprint 10": (answers(a_level_of_detail), "IndexError"),
    "batch of 0": (replies(lambda rgb, q: torch.stack(list(rgb))), "RuntimeError"),
    "batch of 1": (replies(lambda rgb, q: rgb.squeeze(0)), r"the answer is \(3,\)"),
    "batch of 2²² + 1": (replies(lambda rgb, q: rgb * (torch.arange(len(rgb)) < 1 << 22)[:, None]), DIFFER),
    # networks
    "stored texture × 1e4": (answers(lambda rgb, q: rgb.exp().log()), INF),
    "weights at half's maximum": (
        with_methods(TinyMaterial, radiance=lambda _, x: x.exp() / x.exp().sum(1, True)),
        NAN,
    ),
    "layer norm of a constant vector": (with_material(NoEpsilon, Tiny), NAN),
    "expm1 overflow": (with_methods(TinyMaterial, radiance=lambda self, level: level.expm1()), INF),
    "sine of 1e5": (with_methods(TinyMaterial, kind=HalfSine), NAN),
    "gradients at exact zero": (answers(lambda rgb, q: rgb.sqrt().square()), "a gradient of shape"),
    "fp16, all of the above": (with_material(HalfGain), INF),
    "bf16, all of the above": (answers(lambda rgb, q: rgb * of_itself(torch.ones_like(rgb) + 1e-3 - 1)), NAN),
    "int8 texture, all of the above": (LastCodeMissing, "nan"),
    "fitted with a firefly (reported)": (OF_THE_PEAK, "as mean colours"),
    # invariants
    "10,000 random queries": (answers(lambda rgb, q: rgb / ((q.uv - 0.3).norm(dim=1, keepdim=True) > 0.02)), INF),
    "continuous anywhere": (at(lambda uv: (uv * 8).round() / 8), MOVES),
    "continuous at the samples": (answers(brighter_at_a_sample), MOVES),
    "continuous across the wrap": (NO_WRAP, MOVES),
    "continuous across the zenith": (answers(lambda rgb, q: rgb * (1 + 0.1 * q.wo[:, :1].sign())), MOVES),
    "size of a batch": (answers(lambda rgb, q: rgb + len(rgb) * 1e-3), "batches of 7"),
    "order of a batch": (answers(lambda rgb, q: rgb + torch.arange(len(rgb))[:, None] * 1e-3), "reversed"),
    "fp16 against fp64": (answers(added_up), "in float64"),
    "bf16 against fp64": (answers(added_up), "in float64"),
    "Helmholtz reciprocity (reported)": (answers(lambda rgb, q: rgb * q.wo[:, 2:]), "view and light changes f_r by"),
    "a fit that diverges": (Rate, "ended without an error"),
    "drawn queries": (answers(lambda rgb, q: rgb + (q.uv[:, :1] > 0.5) * 100), "a firefly: neubtf-bench stress"),
    "drawn data": (stores(one_row_too_bright), "a firefly: neubtf-bench stress"),
    "directional albedo (reported)": (answers(lambda rgb, q: rgb * (2 - q.wo[:, 2:])), "reflects 2.* at θ = [78]"),
}


def verdict(codec, name, folder, monkeypatch):
    """The verdict on a codec; its files, which say mean-colour, decode with it."""
    monkeypatch.setattr("bench.codecs.registry.load_codec", lambda name, wanted_by="": codec)
    return stress.judge(CASES[name], subject_of(codec, folder))


@pytest.mark.parametrize("name", CASES)
def test_a_broken_codec_fails(name, tmp_path, monkeypatch):
    codec, reason = BROKEN[name]
    outcome = verdict(codec, name, tmp_path, monkeypatch)
    assert (outcome.verdict, bool(re.search(reason, outcome.detail))) == ("fail", True), outcome
    assert outcome.figure


@pytest.mark.parametrize("sound", [pytest.param(Sound, marks=pytest.mark.long), Tiny])
def test_the_same_codec_without_the_fault_passes(sound, tmp_path, monkeypatch):
    names = [name for name, (codec, _) in BROKEN.items() if issubclass(codec, Tiny) == (sound is Tiny)]
    outcomes = {name: verdict(sound, name, tmp_path, monkeypatch) for name in names}
    short = {name: outcome for name, outcome in outcomes.items() if outcome.verdict != "pass"}
    assert set(short) <= {"a fit that diverges"}, short  # nothing is fitted here
