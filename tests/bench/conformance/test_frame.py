import numpy as np
import pytest
import torch

from baselines.mean_colour import MeanColour
from baselines.table import Table
from baselines.vq import VQ
from bench.btf import BTF, ArraySource
from bench.codec import Fit, Parts
from bench.codecs import container, loading, registry
from bench.conformance import frame
from bench.conformance.check import CheckError, CodecUnderTest, framed
from bench.directions.hemisphere import uniform
from bench.material import DecoderCost, Material, sample_texture
from bench.metrics.display import decode_srgb, to_display
from bench.training import gain_of
from tests.tiers import short_for


def encoded(change):
    class Wrong(Table):
        def encode(self, btf, fit):
            pictures = [change(picture) for picture in btf]
            return super().encode(BTF("wrong", btf.wo, btf.wi, ArraySource(np.stack(pictures))), fit)

    return Wrong


def decoded(change):
    """The table whose material answers `change(evaluate, uv, ω_o, ω_i)`."""

    class Wrong(Table):
        def decode(self, parts, device):
            material = super().decode(parts, device)
            evaluate = material.evaluate
            material.evaluate = lambda *queries: change(lambda *three: evaluate(*three, queries[3]), *queries[:3])
            return material

    return Wrong


def asked_otherwise(change):
    return decoded(lambda evaluate, *queries: evaluate(*change(*queries)))


def answered(change):
    return decoded(lambda evaluate, uv, wo, wi: change(evaluate(uv, wo, wi), wi))


def turned(view, light):
    """The table asked at x and y of the view and the light that are each (x, y) → (x, y)."""

    def change(uv, wo, wi):
        wo, wi = (torch.stack([*turn(w[:, 0], w[:, 1]), w[:, 2]], 1) for turn, w in ((view, wo), (light, wi)))
        return uv, wo, wi

    return asked_otherwise(change)


def same(x, y):
    return x, y


def moved(u, v):
    return asked_otherwise(lambda uv, wo, wi: (uv + torch.tensor([u / 24, v / 16]), wo, wi))


def channels(*order):
    return encoded(lambda picture: picture[..., list(order)])


PLANTED = {
    "upside down": encoded(lambda picture: picture[::-1]),
    "mirrored left to right": encoded(lambda picture: picture[:, ::-1]),
    "turned by 180°": encoded(lambda picture: picture[::-1, ::-1]),
    "u and v exchanged": asked_otherwise(lambda uv, wo, wi: (uv.flip(1), wo, wi)),
    "reshape(W, H)": encoded(lambda picture: picture.reshape(picture.shape[1], picture.shape[0], 3)),
    "transposed": encoded(lambda picture: picture.transpose(1, 0, 2)),
    "by 90° to the left": encoded(lambda picture: np.rot90(picture, 1)),
    "by 90° to the right": encoded(lambda picture: np.rot90(picture, -1)),
    "half a texel to the left": moved(1, 0),
    "half a texel to the right": moved(-1, 0),
    "half a texel down": moved(0, 1),
    "half a texel up": moved(0, -1),
    "order BGR": channels(2, 1, 0),
    "order GRB": channels(1, 0, 2),
    "order RBG": channels(0, 2, 1),
    "order GBR": channels(1, 2, 0),
    "order BRG": channels(2, 0, 1),
    "ω_o and ω_i exchanged": asked_otherwise(lambda uv, wo, wi: (uv, wi, wo)),
    **{
        f"{words} in {sides}": turned(turn if "ω_o" in sides else same, turn if "ω_i" in sides else same)
        for sides in ("ω_o and ω_i", "ω_o alone", "ω_i alone")
        for words, turn in (
            ("φ + 180° for φ (ω pointing the other way)", lambda x, y: (-x, -y)),
            ("(−φ for φ)", lambda x, y: (x, -y)),
            ("(180° − φ for φ)", lambda x, y: (-x, y)),
            ("φ + 90° for φ", lambda x, y: (-y, x)),
            ("φ − 90° for φ", lambda x, y: (y, -x)),
            ("+y clockwise", lambda x, y: (y, x)),
        )
    },
    "sRGB for linear": answered(lambda rgb, wi: torch.from_numpy(to_display(rgb.numpy(), 1.0)).float()),
    "sRGB undone twice": encoded(decode_srgb),
    "without the cosine": answered(lambda rgb, wi: rgb / wi[:, 2:]),
    "cosine of ω_i twice": answered(lambda rgb, wi: rgb * wi[:, 2:]),
    "log1p(radiance)": answered(lambda rgb, wi: rgb.log1p()),
    "as 3.14 times the truth": answered(lambda rgb, wi: rgb * torch.pi),
    "as 0.318 times the truth": answered(lambda rgb, wi: rgb / torch.pi),
}


class Logarithm(Table):
    """The table of log1p(gain · radiance), as learned codecs predict it, which does not undo the logarithm."""

    over_gain = False

    def encode(self, btf, fit):
        gain = gain_of(btf, fit)
        logs = np.stack([np.log1p(gain * picture) for picture in btf])
        parts = super().encode(BTF("logs", btf.wo, btf.wi, ArraySource(logs)), fit)
        parts.other["gain"] = torch.tensor([gain])
        return parts

    def decode(self, parts, device):
        material = super().decode(parts, device)
        evaluate = material.evaluate
        by = float(parts.other["gain"]) if self.over_gain else 1.0
        material.evaluate = lambda *queries: evaluate(*queries) / by
        return material


class LogarithmOverGain(Logarithm):
    over_gain = True


PLANTED |= {"log1p(gain · radiance) for": Logarithm, "log1p(gain · radiance) / gain": LogarithmOverGain}


@pytest.mark.parametrize("says", PLANTED)
def test_a_wrong_arrangement_is_named(says, tmp_path, monkeypatch):
    monkeypatch.setattr(registry, "load_codec", lambda name, wanted_by="": PLANTED[says])
    (description,) = [each for each in (*frame.MISTAKES, *frame.logarithms()) if says in each] or [says]
    with pytest.raises(CheckError) as raised:
        framed(CodecUnderTest(PLANTED[says](), tmp_path))
    assert frame.REMEDIES.get(description, says) in str(raised.value)


def test_there_is_a_planted_codec_for_each_arrangement():
    for description in (*frame.MISTAKES, *frame.logarithms()):
        assert sum(words in description for words in PLANTED) == 1, description


def test_what_a_codec_does_not_tell_apart_is_said_and_no_failure(tmp_path):
    note = framed(CodecUnderTest(MeanColour(), tmp_path))
    assert "exchanged" in note
    assert "upside down" not in note
    assert framed(CodecUnderTest(Table(), tmp_path / "table")) is None


class HalfVector(Table):
    """Least squares of cos θ_i · (1, Gaussians of the half vector): right, and blind to all but ω_o + ω_i."""

    CENTRES = torch.from_numpy(uniform(np.random.default_rng(0), 12, 60))

    @classmethod
    def basis(cls, wo, wi):
        half = torch.nn.functional.normalize(wo + wi, dim=1)
        lobes = torch.exp(8 * (half @ cls.CENTRES.T - 1))
        return wi[:, 2:] * torch.cat([torch.ones(len(half), 1), lobes], 1)

    def encode(self, btf, fit):
        basis = self.basis(torch.from_numpy(btf.wo), torch.from_numpy(btf.wi))
        values = torch.from_numpy(np.stack(list(btf))).reshape(len(btf), -1)
        weights = torch.linalg.lstsq(basis, values).solution
        return Parts(texture={"weights": weights.reshape(-1, *btf.shape, 3).permute(1, 2, 0, 3).contiguous()})

    def decode(self, parts, device):
        weights = parts.texture["weights"]

        class Answers(Material):
            def evaluate(self, uv, wo, wi, footprint):
                at = sample_texture(weights.flatten(2), uv).reshape(len(uv), -1, 3)
                return (HalfVector.basis(wo, wi)[:, :, None] * at).sum(1)

        return Answers(
            weights.shape[:2], DecoderCost(texture_channels=weights[0, 0].numel(), texture_floats=weights.numel())
        )


def test_a_codec_of_the_half_vector_alone_has_no_mistake(tmp_path, monkeypatch):
    monkeypatch.setattr(registry, "load_codec", lambda name, wanted_by="": HalfVector)
    tested = CodecUnderTest(HalfVector(), tmp_path)
    assert tested.frame_answers.suspicions()  # its answers alone would accuse it
    assert "ω_i alone" in framed(tested)


@pytest.mark.parametrize("seed", short_for(range(5), 0, 1))
def test_no_seed_brings_a_codec_that_is_right_near_a_wrong_arrangement(seed, tmp_path):
    """`vq` clusters at random: of the codecs here its answers come nearest."""
    btf = frame.material()
    header = container.save(tmp_path / f"a{container.SUFFIX}", VQ(), VQ().encode(btf, Fit(seed=seed)))
    shares = frame.FrameAnswers.at_texel_centres(loading.load(header.path)[1], btf).shares()
    assert max(map(abs, shares.values())) < frame.RIGHT / 2


def test_the_truth_is_told_apart_from_every_wrong_arrangement(tmp_path):
    answers = CodecUnderTest(Table(), tmp_path).frame_answers
    assert max(map(abs, answers.shares().values())) < 0.01
    assert answers.scale == pytest.approx(1, abs=1e-3)
