import math
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from bench import cli
from bench.codec import Fit
from bench.codecs import container
from bench.codecs.registry import load_codec
from bench.conformance.check import tiny_btf
from neubtf.latents import display_values, sheet


def test_channels_are_standardised_and_squashed() -> None:
    texture = torch.randn(20, 30, 5, generator=torch.Generator().manual_seed(0)) * torch.arange(1, 6) + 7
    texture[..., 3] = -2.5
    shown = display_values(texture)
    back = 1 - (1 / shown[..., [0, 1, 2, 4]] - 1).log().flatten(0, 1)
    torch.testing.assert_close(back.mean(0), torch.zeros(4), atol=1e-5, rtol=0)
    torch.testing.assert_close(back.std(0, correction=0), torch.ones(4), atol=1e-5, rtol=0)
    assert shown[..., 3].sub(1 / (math.e + 1)).abs().max() < 1e-6
    assert (shown.flatten(0, 1).argsort(0)[:, 0] == texture.flatten(0, 1).argsort(0)[:, 0]).all()


@pytest.mark.parametrize("size", [(4, 4), (64, 64), (1, 1), (900, 500), (3, 700)])
def test_the_sheet_has_a_size_to_look_at(size: tuple[int, int]) -> None:
    page = sheet(torch.linspace(0, 1, size[0] * size[1] * 14).reshape(*size, 14))
    assert page.dtype == np.uint8
    assert 192 <= max(page.shape) < 6000


def test_the_sheet_shows_every_channel_in_the_colour_of_its_place() -> None:
    texture = torch.zeros(192, 192, 5)
    for channel in range(5):  # each is bright in a row of its own
        texture[40 * channel, :, channel] = 1
    page = sheet(texture)
    first, second = page[6:198, 6:198], page[6:198, 204:396]
    for channel, (picture, colour) in enumerate([(first, 0), (first, 1), (first, 2), (second, 0), (second, 1)]):
        assert (picture[..., colour].argmax(0) == 40 * channel).all()
    assert not second[..., 2].any()


def test_the_command_draws_a_file(tmp_path: Path, capsys) -> None:
    codec = load_codec("neubtf-direct")(steps=1, latents=3)
    container.save(tmp_path / "file.nbtf", codec, codec.encode(tiny_btf(), Fit()))
    assert cli.main(["latents", str(tmp_path / "file.nbtf")]) == 0
    assert "3 channels" in capsys.readouterr().out
    with Image.open(tmp_path / "file.latents.png") as page:
        assert page.mode == "RGB"


def test_a_file_of_another_codec_is_refused(tmp_path: Path, capsys) -> None:
    for codec in (load_codec("bcf")(steps=1, textures=1), load_codec("mean-colour")()):
        container.save(tmp_path / "file.nbtf", codec, codec.encode(tiny_btf(), Fit()))
        assert cli.main(["latents", str(tmp_path / "file.nbtf")]) == 2
        assert f"codec {codec.name}" in capsys.readouterr().err
    assert cli.main(["latents", str(tmp_path / "file.nbtf"), "-o", str(tmp_path)]) == 2


def test_latents_on_several_grids_are_no_texture_to_draw(tmp_path: Path, capsys) -> None:
    codec = load_codec("neubtf-direct")(steps=1, latents=3, half=2)
    container.save(tmp_path / "file.nbtf", codec, codec.encode(tiny_btf(), Fit()))
    assert cli.main(["latents", str(tmp_path / "file.nbtf")]) == 2
    assert "half, quarter, offset" in capsys.readouterr().err
