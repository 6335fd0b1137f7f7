"""Grids and an offset along the view in the codecs that share them: settings that change no file without them."""

from pathlib import Path
from typing import Any

import pytest
import torch

from bench.codec import Codec, Fit, settings_dict
from bench.codecs import container, loading
from bench.codecs.registry import make_codec
from bench.conformance import counting
from bench.conformance.check import tiny_btf
from bench.inputs.errors import InputError
from bench.runs.suite import CodecSpec, changed_settings
from bench.training import Samples, first_latents, gain_of
from bench.training.gridded import GriddedMaterial, GriddedNetwork, first_grids
from tests.tiers import long, short_for

GRIDS = {"half": 2, "quarter": 3, "offset": 8}
CODECS = {
    "neubtf-direct": {"batch": 256, "latents": 4},
    "zeltner2024": {"batch": 256, "latents": 4},
    "rainer2019": {"texels": 16, "pairs": 16, "latents": 4},
}
OTHERS = {"triple-plane": {"batch": 256, "channels": 4}, "bcf": {"batch": 256, "textures": 1}}  # have more beside grids
every_codec = pytest.mark.parametrize("name", short_for(CODECS, "neubtf-direct", "zeltner2024"))


def small(name: str, **settings: Any) -> Codec:
    return make_codec(name, {"steps": 30} | (CODECS | OTHERS)[name] | settings)


def written(path: Path, codec: Codec) -> tuple[container.Header, Any]:
    parts = codec.encode(tiny_btf(8), Fit(torch.device("cpu"), 1))
    header = container.save(path, codec, parts)
    return header, loading.load(path).material


@pytest.mark.parametrize(
    ("name", "more"),
    [
        *((name, {"weights": "int8", "loss": "display"}) for name in (*CODECS, "bcf")),
        ("triple-plane", {}),
        *(long(name, more) for name in CODECS for more in ({}, {"bits": 32})),
        long("neubtf-direct", {"recipe": "paper"}),
        long("zeltner2024", {"recipe": "paper"}),
        long("zeltner2024", {"frames": 0}),
    ],
)
def test_a_file_holds_the_grids_and_answers(tmp_path: Path, name: str, more: dict[str, Any]) -> None:
    header, material = written(tmp_path / "a.nbtf", small(name, **GRIDS | more))
    assert isinstance(material, GriddedMaterial)
    assert {setting: header.settings[setting] for setting in GRIDS} == GRIDS
    assert material.size == (8, 8)
    assert material.cost.parameters == sum(p.numel() for p in material.network.parameters())
    assert counting.fault(material, container.read_parts(header.path)[1]) == ""
    picture = material.slice([0, 0, 1], [0, 0.6, 0.8])
    assert picture.isfinite().all()
    assert picture.std() > 0


@every_codec
def test_the_cost_counts_the_grids_and_the_offset(tmp_path: Path, name: str) -> None:
    header, material = written(tmp_path / "a.nbtf", small(name, **GRIDS))
    assert counting.fault(material, container.read_parts(header.path)[1]) == ""
    _, plain = written(tmp_path / "b.nbtf", small(name, latents=4 + 2 + 3))
    # The offset: 7 → 8 → 1 with biases, a depth and a move; its four channels are fetched, too.
    assert material.cost.parameters - plain.cost.parameters == 7 * 8 + 8 + 8 + 1 + 1
    assert material.cost.flops_per_sample - plain.cost.flops_per_sample == 2 * (7 * 8 + 8) + 8 + 9 + 2 * 4 * 4
    assert material.cost.bytes_per_sample - plain.cost.bytes_per_sample == 4 * 4 * 4
    assert plain.cost.texture_channels - material.cost.texture_channels == 2 + 3


@every_codec
def test_without_them_neither_file_nor_settings_say_anything_of_them(tmp_path: Path, name: str) -> None:
    codec = small(name)
    header, _ = written(tmp_path / "a.nbtf", codec)
    assert not GRIDS.keys() & header.settings.keys()
    stored = container.read_parts(header.path)[1]
    assert set(stored.texture) == {"latents", "latents.low", "latents.step", "latents.size"}
    assert set(stored.other) == {"gain"}
    assert not GRIDS.keys() & settings_dict(small(name, half=0)).keys()
    assert settings_dict(small(name, half=1))["half"] == 1
    assert changed_settings(CodecSpec(name, {"half": 0, "latents": 4})) == {"latents": 4}
    assert changed_settings(CodecSpec(name, {"half": "2"})) == {"half": 2}


def test_without_them_a_fit_looks_up_one_texture_as_it_is() -> None:
    fit = Fit()
    settings = small("neubtf-direct").settings
    samples = Samples(tiny_btf(8), gain_of(tiny_btf(8), fit), fit)
    grids = first_grids(samples, settings, "mixed", torch.Generator().manual_seed(1))
    first = first_latents(samples, 4, "mixed", torch.Generator().manual_seed(1))
    batch = samples.draw(100, torch.Generator().manual_seed(2))
    network = GriddedNetwork(torch.nn.Identity(), settings, (8, 8))
    assert network.fetch_batch(grids.rounded(), samples, batch).equal(first[batch.texel])
    assert not list(network.parameters())


@pytest.mark.parametrize("name", [*CODECS, *OTHERS])
def test_each_grid_takes_part(tmp_path: Path, name: str) -> None:
    """A change of any grid changes the answers, that of the offset by what it moves."""
    _, material = written(tmp_path / "a.nbtf", small(name, **GRIDS))
    before = material.slice([0.6, 0, 0.8], [0, 0.6, 0.8])
    with torch.no_grad():
        material.network.offset.gate.fill_(0.1)
    for grid_name in ("latents", "latents2", "latents4", "offset"):
        grid = getattr(material, f"grid_{grid_name}")
        kept = grid.clone()
        grid.add_(torch.randn(grid.shape, generator=torch.Generator().manual_seed(1)))
        after = material.slice([0.6, 0, 0.8], [0, 0.6, 0.8])
        assert (after - before).abs().max() > 1e-4, grid_name
        grid.copy_(kept)


@every_codec
def test_a_file_whose_grids_have_other_sizes_is_refused(name: str) -> None:
    codec = small(name, steps=2, half=2)
    parts = codec.encode(tiny_btf(8), Fit(torch.device("cpu"), 1))
    parts.other["size"] = torch.tensor([16, 8], dtype=torch.int32)
    with pytest.raises(InputError, match=r"latents .*8 × 8 × 4"):
        codec.decode(parts, torch.device("cpu"))


@pytest.mark.parametrize("setting", GRIDS)
def test_an_encoder_makes_no_grids(setting: str) -> None:
    with pytest.raises(InputError, match="half, quarter and offset"):
        make_codec("rainer2019", {"start": "encoder", setting: 4})


def test_statistics_of_another_size_are_refused() -> None:
    codec = small("rainer2019", steps=2, offset=4, bits=32)
    parts = codec.encode(tiny_btf(8), Fit(torch.device("cpu"), 1))
    parts.texture["statistics"] = parts.texture["statistics"][:4]
    with pytest.raises(InputError, match="statistics"):
        codec.decode(parts, torch.device("cpu"))
