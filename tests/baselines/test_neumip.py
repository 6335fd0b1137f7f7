import math
from typing import Any

import numpy as np
import pytest
import torch
from scipy.ndimage import gaussian_filter

from baselines.neumip import Networks, NeuMIP, NeuMIPMaterial, NeuMIPObjective, Pyramid, blur, falloff_factor
from bench.btf import BTF
from bench.codec import Fit, settings_dict
from bench.conformance.check import tiny_btf
from bench.material import parameters, sample_texture
from bench.training import Samples, gain_of
from bench.training import fitting as training
from bench.training.stored_network import load_vector
from tests.baselines.made import decoded

CHANNELS = 7  # as the authors have it


def fitted(btf: BTF | None = None, **settings: Any) -> NeuMIPMaterial:
    codec = NeuMIP(**{"steps": 10, "batch": 256} | settings)
    material = decoded(codec, btf or tiny_btf())
    assert isinstance(material, NeuMIPMaterial)
    return material


@pytest.mark.parametrize(
    ("settings", "count", "channels"),
    [
        ({"recipe": "paper"}, 3332, 14),
        ({"directions": "xy", "outputs": 3}, 3254, 14),
        ({"directions": "xy", "offset": False}, 1756, 7),
        ({}, 3332 + 5 * 25, 14),
    ],
    ids=["the paper's recipe", "authors' text", "no offset", "ours"],
)
def test_parameters_are_those_published_and_our_inputs(settings: dict[str, Any], count: int, channels: int) -> None:
    material = fitted(**settings)
    assert parameters(material) == material.cost.parameters == count
    assert material.cost.texture_channels == channels


def test_a_level_is_fetched_as_a_texture_of_its_own() -> None:
    pyramid = Pyramid((8, 12))
    table = torch.randn(sum(pyramid.counts), CHANNELS)
    uv = torch.rand(50, 2) * 4 - 2
    for level, (texels, size) in enumerate(zip(table.split(pyramid.counts), pyramid.level_sizes, strict=True)):
        expected = sample_texture(texels.reshape(*size, -1), uv)
        for kind in (torch.long, torch.float32):
            found = pyramid.fetch(table, uv, torch.full((50,), level, dtype=kind))
            torch.testing.assert_close(found, expected, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("size", [(16, 16), (15, 8)])
def test_the_blur_is_a_periodic_gaussian(size: tuple[int, int]) -> None:
    texture = np.random.default_rng(0).standard_normal((*size, 3))
    ours = blur(torch.from_numpy(texture).flatten(0, 1), size, falloff_factor(1.5)).reshape(*size, 3)
    theirs = gaussian_filter(texture, (1.5, 1.5, 0), mode="wrap", truncate=8)
    # A sampled Gaussian aliases: at σ = 1.5 by about exp(−2 π² σ² / 4) = 1e-5.
    np.testing.assert_allclose(ours, theirs, atol=1e-4)


def test_the_output_stage_is_the_authors() -> None:
    networks = Networks(NeuMIP(directions="xy").settings)
    load_vector(torch.zeros(1756), networks.decoder)
    y, u, v, mask = 0.3, -0.1, 0.2, torch.tensor([0.5, -1.0, 2.0])
    with torch.no_grad():
        networks.decoder.layers[-1].bias.copy_(torch.cat([torch.tensor([y, u, v]), mask]))  # type: ignore[operator, union-attr]
        rgb = networks.colour(torch.zeros(1, CHANNELS), torch.ones(1, 3), torch.ones(1, 3))
    log = torch.tensor([y + 1.13983 * v, y - 0.39465 * u - 0.58060 * v, y + 2.03211 * u])
    torch.testing.assert_close(rgb[0], log.expm1() * (0.1 + 1 / (1 + (-mask).exp())))


@pytest.mark.parametrize(("size", "along"), [((8, 8), (1, 1)), ((32, 64), (1, 2)), ((64, 32), (2, 1))])
def test_the_offset_moves_along_the_view_equally_far_on_the_surface(
    size: tuple[int, int], along: tuple[int, int]
) -> None:
    networks = Networks(NeuMIP().settings)
    assert networks.offset is not None
    load_vector(torch.cat([torch.zeros(1575), torch.ones(1)]), networks.offset)
    wo = torch.tensor([[0.6, 0.0, 0.8], [0.0, -0.96, 0.28], [0.0, 0.0, 1.0]])
    moved = networks.moved(torch.zeros(3, 2), torch.zeros(3, CHANNELS), wo, Pyramid(size).reach)
    # Nearer to the horizon than z = 0.6 the shift grows no further. An output of 1 is tanh(1).
    one = 0.05 * math.tanh(1)
    expected = torch.tensor([[one * 0.6 / 0.8, 0], [0, -one * 0.96 / 0.6], [0, 0]])
    torch.testing.assert_close(moved, expected * torch.tensor(along))


def test_the_stored_textures_are_those_that_were_fitted() -> None:
    """The blur is baked: what the file answers is what the fit saw at its end."""
    btf, fit, codec = tiny_btf(), Fit(), NeuMIP(steps=10, batch=256, blur=True, bits=32, weights="float32")
    gain = gain_of(btf, fit)
    levels = [Samples(btf.downsample(2**level), gain, fit) for level in range(3)]
    objective = NeuMIPObjective(levels, codec.settings, fit.generator())
    training.train(objective, fit, 10)
    batch = levels[0].draw(100, fit.generator())
    with torch.no_grad():
        expected = objective.predict(batch, 1.0).expm1().clamp_min(0) / gain
    material = decoded(codec, btf)
    wo, wi = (torch.from_numpy(w)[batch.pair] for w in (btf.wo, btf.wi))
    torch.testing.assert_close(material.query(levels[0].centres(batch.texel), wo, wi), expected, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("levels", [0, 9])
def test_a_file_of_no_level_or_of_too_many_is_refused(levels: int) -> None:
    codec = NeuMIP(steps=1, batch=256)
    parts = codec.encode(tiny_btf(), Fit())
    parts.other["levels"] = torch.tensor([levels], dtype=torch.uint8)
    with pytest.raises(ValueError, match=f"{levels} levels .*8 × 8 "):
        codec.decode(parts, torch.device("cpu"))


def test_by_the_papers_recipe_weights_start_as_those_of_pytorch() -> None:
    """PyTorch draws them from its own generator, so they are compared by their spread: uniform within 1 / √inputs."""
    networks = Networks(NeuMIP(recipe="paper").settings)
    networks.start_as_pytorch(torch.Generator().manual_seed(0))
    layers = [layer for layer in networks.modules() if isinstance(layer, torch.nn.Linear)]
    assert len(layers) == 8  # four of the decoder, four of the offset's network
    for layer in layers:
        theirs = torch.nn.Linear(layer.in_features, layer.out_features)
        bound = layer.in_features**-0.5
        for ours, pytorchs in ((layer.weight, theirs.weight), (layer.bias, theirs.bias)):
            assert ours.abs().max() <= bound
            assert pytorchs.abs().max() <= bound
            if ours.numel() >= 25:
                assert ours.abs().max() > 0.8 * bound


def test_a_fit_by_the_papers_recipe_starts_its_weights_so() -> None:
    objectives = {}
    for start in ("mean", "pytorch"):
        codec = NeuMIP(recipe="paper", weights_start=start)
        levels = Samples.levels(tiny_btf(), 1, 1.0, Fit())
        objectives[start] = NeuMIPObjective(levels, codec.settings, Fit().generator())
    last = {start: each.networks.decoder.layers[-1].weight for start, each in objectives.items()}
    assert not last["mean"].any()  # it answers the mean of the data, whatever the input
    assert last["pytorch"].all()


def test_an_offset_that_leaves_the_picture_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """The bound on its depth keeps it from doing so; should that ever fail, the fit says it."""
    monkeypatch.setattr("baselines.neumip.DEEPEST", 1e6)
    samples = Samples(tiny_btf(), 1.0, Fit())
    objective = NeuMIPObjective([samples], NeuMIP().settings, torch.Generator().manual_seed(0))
    assert objective.networks.offset is not None
    assert objective.faults() == []
    with torch.no_grad():
        objective.networks.offset.layers[-1].bias.fill_(1e4)
    (fault,) = objective.faults()
    assert "pictures" in fault


def test_a_setting_that_a_recipe_changes_is_written_at_its_default_too() -> None:
    assert "weights_start" not in settings_dict(NeuMIP())  # files from before it existed stay the same
    assert settings_dict(NeuMIP(recipe="paper"))["weights_start"] == "pytorch"
    assert settings_dict(NeuMIP(recipe="paper", weights_start="mean"))["weights_start"] == "mean"


@pytest.mark.parametrize("outputs", [3, 6])
def test_the_networks_start_at_one_colour(outputs: int) -> None:
    networks, level = Networks(NeuMIP(outputs=outputs).settings), torch.tensor([0.2, 0.5, 1.1])
    networks.start_at(level)
    rgb = networks.colour(torch.randn(4, CHANNELS), torch.ones(4, 3), torch.ones(4, 3))
    torch.testing.assert_close(rgb, level.expm1().expand(4, 3))
