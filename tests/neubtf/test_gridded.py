"""Grids and an offset along the view in `neubtf-direct`: settings that change no file without them."""

from pathlib import Path
from typing import Any

import pytest
import torch

from bench.codec import Fit, settings_dict
from bench.codecs import container, loading
from bench.codecs.registry import make_codec
from bench.conformance.check import tiny_btf
from bench.inputs.errors import InputError
from bench.runs.suite import CodecSpec, changed_settings
from neubtf.direct import NeuBTFDirect
from neubtf.gridded import GriddedMaterial
from neubtf.renderer import NeuBTFMaterial

GRIDS = {"half": 2, "quarter": 3, "offset": 8}


def written(path: Path, **settings: Any) -> tuple[container.Header, Any]:
    codec = NeuBTFDirect(**{"steps": 30, "batch": 256, "latents": 4} | settings)
    parts = codec.encode(tiny_btf(8), Fit(torch.device("cpu"), 1))
    header = container.save(path, codec, parts)
    return header, loading.load(path).material


@pytest.mark.parametrize("more", [{}, {"weights": "int8", "loss": "display"}, {"recipe": "paper"}])
def test_a_file_holds_the_grids_and_answers(tmp_path: Path, more: dict[str, Any]) -> None:
    header, material = written(tmp_path / "a.nbtf", **GRIDS | more)
    assert isinstance(material, GriddedMaterial)
    assert {name: header.settings[name] for name in GRIDS} == GRIDS
    assert material.size == (8, 8)
    assert material.cost.parameters == sum(p.numel() for p in material.network.parameters())
    picture = material.slice([0, 0, 1], [0, 0.6, 0.8])
    assert picture.isfinite().all()
    assert picture.std() > 0


def test_without_them_neither_file_nor_settings_say_anything_of_them(tmp_path: Path) -> None:
    header, material = written(tmp_path / "a.nbtf")
    assert isinstance(material, NeuBTFMaterial)
    assert not GRIDS.keys() & header.settings.keys()
    assert not GRIDS.keys() & settings_dict(NeuBTFDirect(half=0)).keys()
    assert settings_dict(NeuBTFDirect(half=1))["half"] == 1
    assert changed_settings(CodecSpec("neubtf-direct", {"half": 0, "latents": 4})) == {"latents": 4}
    assert changed_settings(CodecSpec("neubtf-direct", {"half": "2"})) == {"half": 2}


def test_each_grid_takes_part(tmp_path: Path) -> None:
    """A change of any grid changes the answers, that of the offset by what it moves."""
    _, material = written(tmp_path / "a.nbtf", **GRIDS)
    before = material.slice([0.6, 0, 0.8], [0, 0.6, 0.8])
    with torch.no_grad():
        material.network.offset.gate.fill_(0.1)
    for name in ("latents", "latents2", "latents4", "offset"):
        grid = getattr(material, f"grid_{name}")
        kept = grid.clone()
        grid.add_(torch.randn(grid.shape, generator=torch.Generator().manual_seed(1)))
        after = material.slice([0.6, 0, 0.8], [0, 0.6, 0.8])
        assert (after - before).abs().max() > 1e-4, name
        grid.copy_(kept)


def test_a_file_whose_grids_have_other_sizes_is_refused(tmp_path: Path) -> None:
    codec = make_codec("neubtf-direct", {"steps": 2, "batch": 64, "latents": 4, "half": 2})
    parts = codec.encode(tiny_btf(8), Fit(torch.device("cpu"), 1))
    parts.other["size"] = torch.tensor([16, 8], dtype=torch.int32)
    with pytest.raises(InputError, match="grid latents of this file is 8 × 8 × 4"):
        codec.decode(parts, torch.device("cpu"))
