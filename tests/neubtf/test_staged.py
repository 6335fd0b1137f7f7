"""The steps of our recipe: look-ups that move along the view, and errors as displayed."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor

from bench.codec import Fit, Parts
from bench.codecs import container
from bench.conformance.check import tiny_btf
from bench.inputs.errors import InputError
from bench.training import Decoder, Samples, load_texture, store_texture
from bench.training.gridded import GriddedNetwork
from bench.training.samples import centres
from bench.training.stored_network import load_network, store_network
from bench.training.stored_texture import Rounding
from neubtf.augmentation import Crop
from neubtf.autoencoder import Autoencoder, Encoder, as_guidance, read_encoder
from neubtf.codec import NeuBTF
from neubtf.renderer import on_grids
from neubtf.training import Staged

GATE = 0.2  # depths of up to a fifth of the picture
VIEW = torch.tensor([[0.48, -0.36, 0.8]])
LIGHT = torch.tensor([[0.0, 0.6, 0.8]])


def fitted(**settings: Any) -> tuple[NeuBTF, Parts]:
    """A brief fit with an offset whose depths are not small."""
    codec = NeuBTF(steps=24, batch=256, offset=4, bits=32, weights="float32", **settings)
    parts = codec.encode(tiny_btf(), Fit())
    return codec, replace(parts, decoder=with_gate(codec, parts, GATE))


def with_gate(codec: NeuBTF, parts: Parts, gate: float) -> dict[str, Tensor]:
    """The network of a file, its depths scaled by another gate."""
    network = GriddedNetwork(Decoder(codec.settings.architecture), codec.settings, tiny_btf().shape)
    load_network(network, parts.decoder)
    assert network.offset is not None
    with torch.no_grad():
        network.offset.gate.fill_(gate)
    return store_network(network, "float32")


def answers(codec: NeuBTF, parts: Parts, uv: Tensor) -> Tensor:
    """Radiance (n, 3) of a file at uv (n, 2), seen and lit aslant."""
    material = codec.decode(parts, torch.device("cpu"))
    return material.query(uv, VIEW.expand(len(uv), 3), LIGHT.expand(len(uv), 3))


def staged(settings: Any, generator: torch.Generator) -> Staged:
    """The objective of a fit to 16 × 16 texels."""
    guidance = torch.rand(1, 3, 16, 16, generator=generator)
    encoder = Encoder.for_guidance(guidance, Autoencoder(settings.channels, generator))
    return Staged(Samples(tiny_btf(16), 1.0, Fit()), settings, encoder, guidance, generator)


def test_the_offset_has_a_grid_of_its_own() -> None:
    codec, parts = fitted()
    assert load_texture("latents", parts.texture).shape == (8, 8, 14)
    assert load_texture("offset", parts.texture).shape == (2, 2, 4)
    assert codec.decode(parts, torch.device("cpu")).cost.texture_channels == 14


def test_the_files_grids_are_those_of_its_autoencoder(tmp_path: Path) -> None:
    codec, parts = fitted(keep_encoder=True)
    encoder, picture = read_encoder(container.save(tmp_path / "file.nbtf", codec, parts).path)
    with torch.no_grad():
        texture = encoder(as_guidance(picture))[0].movedim(0, -1)
    for name, grid in on_grids(texture, 14).items():
        torch.testing.assert_close(load_texture(name, parts.texture), grid)
    torch.testing.assert_close(on_grids(texture, 14)["offset"][1, 0], texture[4:, :4, 14:].mean((0, 1)))


def test_a_texel_moves_by_as_many_texels_in_a_larger_texture() -> None:
    codec, parts = fitted()
    textures: dict[str, Tensor] = {}
    for name in ("latents", "offset"):
        repeated = load_texture(name, parts.texture).repeat(2, 3, 1)  # (16, 24, C) shows the same at every texel
        textures |= store_texture(name, repeated, Rounding(repeated.shape[2], 32))
    larger = replace(parts, texture=textures)
    texel = torch.arange(64)
    in_larger = texel // 8 * 24 + texel % 8
    torch.testing.assert_close(
        answers(codec, larger, centres(in_larger, (16, 24))), answers(codec, parts, centres(texel, (8, 8)))
    )


def test_the_offset_moves_what_is_seen() -> None:
    codec, parts = fitted()
    uv = centres(torch.arange(64), (8, 8))
    unmoved = replace(parts, decoder=with_gate(codec, parts, 0.0))
    assert (answers(codec, parts, uv) - answers(codec, unmoved, uv)).abs().max() > 1e-3


def test_grids_that_do_not_fit_are_refused() -> None:
    codec, parts = fitted()
    textures = parts.texture | store_texture("offset", torch.zeros(3, 2, 4), Rounding(4, 32))
    with pytest.raises(InputError, match="grid offset"):
        codec.decode(replace(parts, texture=textures), torch.device("cpu"))


@pytest.mark.parametrize("corner", [(0, 0), (4, 8)])
def test_a_window_shows_what_the_picture_shows(corner: tuple[int, int]) -> None:
    """Where its look-ups stay inside it, and its cells are cells of the picture."""
    settings = NeuBTF(offset=4).settings
    generator = torch.Generator().manual_seed(0)
    fitting = staged(settings, generator)
    samples = fitting.samples
    with torch.no_grad():
        fitting.renderer.offset.gate.fill_(1 / 16)  # a texel
        fitting.renderer.decoder.layers[-1].weight.normal_(generator=generator)
    texture = torch.randn(256, settings.channels, generator=generator)
    window = Crop(corner, (8, 8), (8, 8), whole=(False, False))
    texels = window.texels((16, 16))
    inner = replace(window, around=(3, 3)).inner(torch.device("cpu"))
    steep = samples.wo[:, 2] > 0.4  # whose look-ups move by less than the margin of 3 texels
    aslant = torch.arange(samples.pairs)[steep & (samples.wo[:, 2] < 0.9)]
    pair = aslant[torch.randint(len(aslant), (len(inner),), generator=generator)]
    with torch.no_grad():
        in_window = fitting.rendered(texture[texels], inner, pair, window)
        in_picture = fitting.rendered(texture, texels[inner], pair)
        fitting.renderer.offset.gate.zero_()
        unmoved = fitting.rendered(texture, texels[inner], pair)
    # Both round uv in their own sides: by some 1e-7, which steep textures and a large last layer amplify.
    torch.testing.assert_close(in_window, in_picture, rtol=0, atol=1e-3)
    assert (unmoved - in_picture).abs().mean() > 0.1


@pytest.mark.parametrize("settings", [{"offset": 4}, {"loss": "display"}])
def test_the_papers_recipe_has_nothing_of_others(settings: dict[str, Any]) -> None:
    with pytest.raises(InputError, match=next(iter(settings))):
        NeuBTF(recipe="paper", **settings)


@pytest.mark.parametrize("progress", [0.55, 0.95], ids=["direct", "guided"])
def test_later_errors_are_those_of_the_display(progress: float) -> None:
    losses = []
    for loss in ("both", "display"):
        fitting = staged(NeuBTF(steps=100, batch=256, loss=loss).settings, torch.Generator().manual_seed(0))
        losses.append([fitting.loss(torch.Generator().manual_seed(1), at).item() for at in (0.1, progress)])
    (early, late), (early_display, late_display) = losses
    assert early_display == early
    assert late_display != late


def test_a_share_of_direct_steps_that_rounds_to_none_leaves_the_renderer_to_the_guided_stage() -> None:
    settings = NeuBTF(steps=10, direct=0.01, taught=0.0).settings
    guidance = torch.rand(1, 3, 12, 12)
    encoder = Encoder.for_guidance(guidance, Autoencoder(settings.channels))
    fitting = Staged(Samples(tiny_btf(12), 1.0, Fit()), settings, encoder, guidance, Fit().generator())
    assert fitting.rate(0, settings.steps, len(fitting.groups()) - 1) > 0
