"""Textures on several grids: where their points lie, what is stored, and how an offset moves a look-up."""

from dataclasses import dataclass

import pytest
import torch

from bench.inputs.errors import InputError
from bench.material import sample_texture, texel_centres
from bench.training.grids import Grids, GridSettings, Offset, channels, load_grids, size_of, total_channels


@dataclass(frozen=True)
class Settings(GridSettings):
    latents: int = 2
    bits: int = 4


def numbers(shape: tuple[int, int], count: int) -> torch.Tensor:
    return torch.randn(shape[0] * shape[1], count, generator=torch.Generator().manual_seed(0))


def test_channels_are_those_of_the_settings() -> None:
    assert channels(Settings()) == {"latents": 2}
    assert channels(Settings(half=3, quarter=5, offset=16)) == {"latents": 2, "latents2": 3, "latents4": 5, "offset": 4}
    assert channels(Settings(latents=0, quarter=5, offset=16), offset=False) == {"latents4": 5}
    assert total_channels(Settings(half=3, quarter=5, offset=16)) == 10


def test_incomplete_points_at_the_edges_count() -> None:
    assert [size_of(name, (9, 6)) for name in ("latents", "latents2", "latents4", "offset")] == [
        (9, 6),
        (5, 3),
        (3, 2),
        (3, 2),
    ]


@pytest.mark.parametrize("shape", [(8, 8), (9, 6), (1, 5)])
def test_a_file_holds_the_rounded_grids(shape: tuple[int, int]) -> None:
    settings = Settings(half=3, quarter=5, offset=16)
    grids = Grids(numbers(shape, total_channels(settings)), shape, settings, offset=True)
    for name, values in grids.values.items():
        grids.roundings[name].set(values.detach(), torch.full((values.shape[-1],), 4))
    found = load_grids(grids.stored(), settings, shape, offset=True)
    assert {name: tuple(values.shape) for name, values in found.items()} == {
        name: (*size_of(name, shape), count) for name, count in channels(settings).items()
    }
    for name, values in grids.rounded().items():
        torch.testing.assert_close(found[name], values.detach())
    with pytest.raises(InputError, match="grid latents"):
        load_grids(grids.stored(), settings, (shape[0] + 1, shape[1]), offset=True)


def test_a_coarse_grid_starts_at_the_means_of_its_texels() -> None:
    """Row 0 of a grid is the top of the picture, as that of a texture is."""
    shape, settings = (8, 8), Settings(latents=1, half=1, quarter=1)
    first = numbers(shape, 3)
    grids = Grids(first, shape, settings, offset=False)
    picture = first.reshape(*shape, 3)
    assert torch.equal(grids.values["latents"][..., 0], picture[..., 0])
    torch.testing.assert_close(grids.values["latents2"][0, 0, 0], picture[:2, :2, 1].mean())
    torch.testing.assert_close(grids.values["latents4"][1, 0, 0], picture[4:, :4, 2].mean())
    # A point of a coarse grid lies at the centre of its texels.
    centre = texel_centres(*shape).reshape(*shape, 2)[4:, :4].mean((0, 1))
    found = sample_texture(grids.values["latents4"], centre[None])[0, 0]
    torch.testing.assert_close(found, picture[4:, :4, 2].mean())


def test_an_offset_starts_closed_and_moves_with_the_view() -> None:
    offset = Offset(16, (4, 5), torch.Generator().manual_seed(0))
    uv = torch.rand(20, 2, generator=torch.Generator().manual_seed(1))
    latents = numbers((4, 5), 4)
    up, aside = torch.tensor([0.0, 0, 1]).expand(20, 3), torch.tensor([0.6, 0, 0.8]).expand(20, 3)
    assert torch.equal(offset.moved(uv, latents, up), uv)
    with torch.no_grad():
        offset.gate.fill_(0.01)
    one, other = offset.moved(uv, latents, up), offset.moved(uv, latents, aside)
    assert ((one - uv).abs() <= 0.01).all()
    assert (one != other).any()


def test_a_depth_of_latents_alone_is_the_same_for_every_view() -> None:
    offset = Offset(16, (6, 6), torch.Generator().manual_seed(0), by_view=False)
    with torch.no_grad():
        offset.gate.fill_(0.1)
    latents, uv = numbers((4, 5), 4), torch.zeros(20, 2)
    one = offset.moved(uv, latents, torch.tensor([0.6, 0, 0.8]).expand(20, 3))
    other = offset.moved(uv, latents, torch.tensor([0, 0.8, 0.6]).expand(20, 3))
    torch.testing.assert_close(one[:, 0] / 0.75, other[:, 1] / (4 / 3))


@pytest.mark.parametrize("shape", [(4, 8), (8, 4), (6, 6)])
def test_an_offset_moves_along_the_view_on_the_surface(shape: tuple[int, int]) -> None:
    """Texels are square, so in texels it moves as far along u as along v, and as far in every shape of picture."""
    offset = Offset(16, shape, torch.Generator().manual_seed(0))
    with torch.no_grad():
        offset.gate.fill_(0.1)
    latents, wo = numbers((4, 5), 4), torch.tensor([0.48, 0.36, 0.8]).expand(20, 3)
    height, width = shape
    texels = (offset.moved(torch.zeros(20, 2), latents, wo) * torch.tensor([width, height])).detach()
    square = Offset(16, (max(shape), max(shape)), torch.Generator().manual_seed(0))
    square.load_state_dict(offset.state_dict())
    torch.testing.assert_close(texels[:, 1] / texels[:, 0], torch.full((20,), 0.75))
    torch.testing.assert_close(texels, (square.moved(torch.zeros(20, 2), latents, wo) * max(shape)).detach())
