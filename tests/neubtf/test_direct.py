from pathlib import Path
from typing import Any

import pytest
import torch

from bench.codec import Fit, Parts
from bench.codecs import container
from bench.codecs.registry import load_codec
from bench.conformance.check import tiny_btf
from bench.inputs.errors import InputError
from bench.material import Material, parameters
from bench.training import Samples, load_texture, train
from neubtf.direct import Direct, NeuBTFDirect
from neubtf.renderer import render
from tests.baselines.made import cropped


def fitted(**settings: Any) -> tuple[NeuBTFDirect, Parts, Material]:
    codec = NeuBTFDirect(**{"steps": 20, "batch": 512} | settings)
    parts = codec.encode(tiny_btf(), Fit())
    return codec, parts, codec.decode(parts, torch.device("cpu"))


@pytest.mark.parametrize("recipe", ["ours", "paper"])
def test_it_comes_near_the_data(recipe: str) -> None:
    fit = Fit()
    NeuBTFDirect(steps=300, batch=1024, recipe=recipe).encode(tiny_btf(), fit)
    # One colour a texel, the mean over pairs, reaches 16 dB.
    assert fit.history[-1]["psnr"] > 25


@pytest.mark.parametrize(
    ("settings", "count"),
    [
        ({}, 3011 + 5 * 32),
        ({"start": "random"}, 3011 + 5 * 32),
        ({"directions": "xy"}, 3011),
        ({"recipe": "paper", "directions": "xyzh"}, 3011 + 5 * 32),
        ({"norm": False, "omega": 30}, 3171 - 192),
        ({"activation": "relu"}, 3171),
        ({"residual": False}, 3171),
        ({"layers": 1}, 23 * 32 + 32 + 64 + 99),
        ({"width": 16, "latents": 4}, (13 * 16 + 16) + 2 * (16 * 16 + 16) + 3 * 32 + (16 * 3 + 3)),
    ],
)
def test_every_ablation_fits(settings: dict[str, Any], count: int) -> None:
    _, _, material = fitted(**settings)
    assert parameters(material) == material.cost.parameters == count
    assert material.slice([0, 0, 1], [0, 0.6, 0.8]).isfinite().all()


def test_a_half_costs_half(tmp_path: Path) -> None:
    sizes = {}
    for bits in (32, 16, 8, 4):
        codec, parts, _ = fitted(bits=bits)
        sizes[bits] = container.save(tmp_path / f"{bits}", codec, parts).part_bytes()["texture"]
    floats, steps = 8 * 8 * 14, 1 + 14 + 2 * 4 * 14 + 8
    assert sizes[32] == 2 * sizes[16] == 4 * floats
    assert 0.9 * floats < sizes[8] <= floats + steps
    assert 0.4 * floats < sizes[4] <= floats / 2 + steps


def test_the_stored_texture_is_what_was_fitted() -> None:
    """The material is R(T(u, v), ω_o, ω_i) of the stored tensors and nothing else."""
    _, parts, material = fitted(bits=32, weights="float32")
    wo, wi = torch.tensor([[0.6, 0.0, 0.8]]), torch.tensor([[0.0, 0.0, 1.0]])
    latents = parts.texture["latents"][2, 5][None]
    with torch.no_grad():
        expected = render(material.network, latents, wo, wi, "xyzh").expm1() / parts.other["gain"]  # type: ignore[attr-defined]
    asked = material.query(torch.tensor([[5.5 / 8, 1 - 2.5 / 8]]), wo, wi)
    torch.testing.assert_close(asked, expected.clamp_min(0))


@pytest.mark.parametrize(("height", "width", "expected"), [(8, 4, [2.0, 1.0]), (4, 8, [1.0, 2.0])])
@pytest.mark.parametrize("name", ["neubtf-direct", "relief"])
def test_an_offset_is_along_the_view_in_a_picture_that_is_not_square(
    name: str, height: int, width: int, expected: list[float]
) -> None:
    settings: Any = {"steps": 2, "batch": 64, "offset": 4} | ({"relief": False} if name == "relief" else {})
    codec = load_codec(name)(**settings)
    material: Any = codec.decode(codec.encode(cropped(height, width), Fit()), torch.device("cpu"))
    assert material.network.offset.periods.tolist() == expected


@pytest.mark.parametrize("name", ["latents", "layers", "omega", "steps"])
def test_settings_without_sense_are_refused(name: str) -> None:
    with pytest.raises(InputError, match=name.removesuffix("s")):
        fitted(**{name: 0})


def test_a_killed_fit_gives_the_same_file(ends_alike_when_killed: Any) -> None:
    codec, btf = NeuBTFDirect(steps=30, batch=64), tiny_btf()
    ends_alike_when_killed(codec, btf)


@pytest.mark.parametrize("patience", [0, 1])
def test_the_file_holds_the_texture_that_the_fit_looked_up(patience: int) -> None:
    """From half of the fit on, or where it ends before, what is fitted beside the texture knows its rounding."""
    samples, codec = Samples(tiny_btf(), 1.0, Fit()), NeuBTFDirect(steps=200, batch=64, patience=patience)
    direct = Direct(samples, codec.settings, Fit().generator())
    train(direct, Fit(), 200, patience)
    seen = direct.grids.rounded()["latents"]
    torch.testing.assert_close(load_texture("latents", direct.grids.stored()), seen)
    assert not torch.equal(seen, direct.grids.values["latents"])
