import logging
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from bench.btf import BTF, ArraySource
from bench.codec import Fit, Parts
from bench.codecs import container
from bench.conformance.check import tiny_btf
from bench.inputs.errors import InputError
from bench.material import parameters
from bench.training import Samples, load_texture
from bench.training import fitting as training
from neubtf.autoencoder import Autoencoder, Encoder, as_guidance, read_encoder
from neubtf.codec import NeuBTF, guiding_pair
from tests.tiers import long

FEW: dict[str, Any] = {"steps": 24, "batch": 256}


def fitted(btf: BTF | None = None, **settings: Any) -> tuple[NeuBTF, Parts]:
    codec = NeuBTF(**FEW | settings)
    return codec, codec.encode(btf or tiny_btf(), Fit())


def cut(rows: int, cols: int, pairs: int = 81) -> BTF:
    """A part of the tiny material, which is not periodic any more."""
    whole = tiny_btf(16)
    values = np.stack([whole[i][:rows, :cols] for i in range(pairs)])
    return BTF("cut", whole.wo[:pairs], whole.wi[:pairs], ArraySource(values))


@pytest.mark.parametrize(("directions", "count"), [("xy", 3011), ("xyzh", 3011 + 5 * 32)])
def test_the_decoder_with_the_papers_inputs_is_the_papers(directions: str, count: int) -> None:
    codec, parts = fitted(directions=directions)
    material = codec.decode(parts, torch.device("cpu"))
    assert parameters(material) == material.cost.parameters == count
    assert material.cost.texture_channels == 14
    assert parts.texture["latents.size"].tolist() == [8, 8]


@pytest.mark.parametrize("size", [(8, 12), (7, 10)])
def test_the_files_texture_is_the_autoencoders(size: tuple[int, int], tmp_path: Path) -> None:
    codec, parts = fitted(cut(*size), keep_encoder=True, bits=8)
    header = container.save(tmp_path / "file.nbtf", codec, parts)
    encoder, picture = read_encoder(header.path)
    with torch.no_grad():
        texture = encoder(as_guidance(picture))[0].movedim(0, -1)
    stored = load_texture("latents", container.read_parts(header.path)[1].texture)
    step = (texture.amax((0, 1)) - texture.amin((0, 1))) / 255
    assert stored.shape == (*size, 14)
    # Eight bits round to half a step; the rest is float32.
    assert ((stored - texture).abs() <= 0.501 * step).all()
    assert step.min() > 1e-4


def most_frontal(btf: BTF) -> int:
    return int((btf.wo[:, 2] + btf.wi[:, 2]).argmax())


def test_the_guidance_is_the_most_frontal_slice_as_it_is_displayed() -> None:
    btf = tiny_btf()
    _, parts = fitted(btf, keep_encoder=True)
    pair = most_frontal(btf)
    assert btf.wo[pair, 2] == btf.wo[:, 2].max()
    assert btf.wi[pair, 2] == btf.wi[:, 2].max()
    exposure = parts.other["gain"].item() / 8
    linear = np.clip(btf[pair] * exposure, 0, 1)
    srgb = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    # Log radiance is kept as half floats.
    np.testing.assert_allclose(parts.encoder["guidance"].numpy() / 255, srgb, atol=0.5 / 255 + 1e-3)


def test_where_the_most_frontal_slice_shows_nothing_the_next_that_does_is_the_guidance() -> None:
    like = tiny_btf()
    values = np.stack(list(like))
    values[like.wo[:, 2] > 0.9] = 0.1  # one colour, from above
    btf = BTF("flat", like.wo, like.wi, ArraySource(values), periodic=True)
    _, parts = fitted(btf, keep_encoder=True)
    pair = guiding_pair(Samples(btf, parts.other["gain"].item(), Fit()))
    lit = like.wo[:, 2] < 0.9
    assert lit[pair]
    assert like.wo[pair, 2] + like.wi[pair, 2] == (like.wo[:, 2] + like.wi[:, 2])[lit].max()
    assert parts.encoder["guidance"].float().std((0, 1)).min() > 10
    assert guiding_pair(Samples(like, 1.0, Fit())) == most_frontal(like)
    black = BTF("black", like.wo, like.wi, ArraySource(np.zeros_like(values)))
    assert guiding_pair(Samples(black, 1.0, Fit())) == most_frontal(like)


@pytest.mark.long
def test_the_autoencoder_is_a_part_of_its_own_and_left_out_unless_wanted(tmp_path: Path) -> None:
    codec, without = fitted()
    other, kept = fitted(keep_encoder=True)
    assert not without.encoder
    assert all(without.texture[name].equal(kept.texture[name]) for name in kept.texture)
    sizes = container.save(tmp_path / "kept.nbtf", other, kept).part_bytes()
    assert 360_000 < sizes["encoder"] < 440_000  # some 200,000 halves and a picture
    assert container.save(tmp_path / "plain.nbtf", codec, without).file_bytes < 20_000


def test_it_comes_near_the_data() -> None:
    fit = Fit()
    NeuBTF(steps=240, batch=1024).encode(tiny_btf(), fit)
    # One colour a texel, the mean over pairs, reaches 16 dB.
    assert fit.history[-1]["psnr"] > 17


@pytest.mark.parametrize("size", [(1, 1), (3, 3), (9, 6)])
def test_any_size_is_fitted_and_padding_is_said(size: tuple[int, int], caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    _, parts = fitted(cut(*size))
    assert load_texture("latents", parts.texture).shape == (*size, 14)
    assert f"{size[0]} × {size[1]} texels" in caplog.text


WAYS: list[dict[str, Any]] = [{"direct": 0.0, "taught": 0.0}, {"batch": 1}, {"explore": 1.0, "smallest": 0.3}]
WAYS += [{"crop": 4}, {"recipe": "paper"}, {"recipe": "paper", "slices": 2, "crop": 8}]


@pytest.mark.parametrize("settings", WAYS)
def test_every_way_to_fit_gives_a_texture(settings: dict[str, Any]) -> None:
    codec, parts = fitted(**settings)
    assert codec.decode(parts, torch.device("cpu")).slice([0.0, 0.0, 1.0], [0.0, 0.0, 1.0]).std() > 0


@pytest.mark.long
def test_every_weight_matters() -> None:
    others: list[dict[str, Any]] = [{}, {"pixel": 0.5}]
    others += [{name: 0.0} for name in ("style", "frequency", "hue", "blur", "noise")]
    found = set()
    for each in others:
        parts = fitted(keep_encoder=True, recipe="paper", steps=2, **each)[1]
        found.add(parts.encoder["weights"].numpy().tobytes())
    assert len(found) == len(others)


def test_settings_without_sense_are_refused() -> None:
    for name, value in {"steps": 0, "batch": 0, "slices": 0, "crop": 3, "explore": 1.5, "latents": 0}.items():
        with pytest.raises(InputError, match=name.removesuffix("s")):
            fitted(**{name: value})
    for settings, message in (({"direct": 0.9, "taught": 0.1}, "below 1"), ({"direct": 0.0}, "if taught is above 0")):
        with pytest.raises(InputError, match=message):
            fitted(**settings)


@pytest.mark.parametrize("stop", [long(8), long(14), 22])
def test_a_killed_fit_gives_the_same_file(stop: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(training, "KEEP_EVERY", 2)
    monkeypatch.setattr(training, "SAVE_SECONDS", 0.0)

    def halt(label: str, done: int, total: int) -> None:
        if label.startswith("fitting") and done == stop:
            raise KeyboardInterrupt

    codec = NeuBTF(**FEW)
    with pytest.raises(KeyboardInterrupt):
        codec.encode(tiny_btf(), Fit(show=halt, checkpoint=tmp_path / "state"))
    resumed = codec.encode(tiny_btf(), Fit(checkpoint=tmp_path / "state"))
    assert container.to_bytes(codec, resumed) == container.to_bytes(codec, codec.encode(tiny_btf(), Fit()))


def test_the_encoder_sees_its_own_guidance_with_mean_0_and_deviation_1() -> None:
    faint = 0.5 + 0.01 * torch.randn(1, 3, 16, 16, generator=torch.Generator().manual_seed(0))
    seen = Encoder.for_guidance(faint, Autoencoder(2)).prepared(faint)
    assert seen.mean().item() == pytest.approx(0, abs=1e-4)
    assert seen[0].flatten(1).std(1, correction=0).mean().item() == pytest.approx(1, rel=1e-4)
    of_one_colour = torch.full((1, 3, 16, 16), 0.2)
    assert Encoder.for_guidance(of_one_colour, Autoencoder(2)).prepared(of_one_colour).abs().max() < 1e-3
