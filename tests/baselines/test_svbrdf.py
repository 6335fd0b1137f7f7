from pathlib import Path

import numpy as np
import pytest
import torch

from baselines.mean_colour import MeanColour
from baselines.svbrdf import CHANNELS, SVBRDF, MapsMaterial, shaded
from bench import cli
from bench.btf import BTF, ArraySource
from bench.codec import Fit, Parts
from bench.codecs import container
from bench.conformance.check import tiny_btf
from bench.data.bake import read_surface, recognise
from bench.data.materials.maps import Maps
from bench.data.materials.renderer import render
from bench.directions.hemisphere import thin, ubo2003, uniform

SIZE = 8


def flat_maps(seed: int = 0) -> Maps:
    """A plane of two metals and two dielectrics with tilted normals, every texel another."""
    rng = np.random.default_rng(seed)
    normal = np.concatenate([rng.uniform(-0.3, 0.3, (SIZE, SIZE, 2)), np.ones((SIZE, SIZE, 1))], 2)
    return Maps(
        0.0,
        rng.uniform(0.2, 0.9, (SIZE, SIZE, 3)),
        rng.uniform(0.3, 0.7, (SIZE, SIZE)),
        (np.arange(SIZE) % 2)[None].repeat(SIZE, 0),
        normal=normal / np.linalg.norm(normal, axis=2, keepdims=True),
    )


def table_of(maps: Maps) -> torch.Tensor:
    assert maps.normal is not None
    scalars = np.stack([maps.roughness, maps.metalness], 2)
    return torch.from_numpy(np.concatenate([maps.base_colour, maps.normal, scalars], 2)).reshape(-1, CHANNELS)


def rendered(maps: Maps, wo: np.ndarray, wi: np.ndarray) -> BTF:
    values = render(maps, wo, wi, (SIZE, SIZE), sub_points=1)  # a point a texel: nothing is averaged
    return BTF("flat", wo, wi, ArraySource(values), periodic=True)


def decoded(parts: Parts) -> MapsMaterial:
    material = SVBRDF().decode(parts, torch.device("cpu"))
    assert isinstance(material, MapsMaterial)
    return material


def product(views: int, lights: int) -> tuple[np.ndarray, np.ndarray]:
    directions = ubo2003()
    wo, wi = directions[thin(directions, views)], directions[thin(directions, lights)]
    return np.repeat(wo, lights, 0), np.tile(wi, (views, 1))


def test_the_reflectance_is_the_renderers() -> None:
    maps, rng = flat_maps(), np.random.default_rng(1)
    wo, wi = uniform(rng, 40, 75.0), uniform(rng, 40, 75.0)
    for picture, view, light in zip(rendered(maps, wo, wi), wo, wi, strict=True):
        both = (torch.from_numpy(w).expand(SIZE * SIZE, 3) for w in (view, light))
        # Float32 in another order; the renderer keeps visibility in 255 steps, here all of it.
        np.testing.assert_allclose(shaded(table_of(maps), *both), picture.reshape(-1, 3), rtol=2e-4, atol=1e-6)


@pytest.fixture(scope="module")
def fitted() -> Parts:
    """What is stored of the flat material."""
    return SVBRDF(steps=1200, batch=2048).encode(rendered(flat_maps(), *product(25, 25)), Fit())


def test_it_finds_the_maps_of_a_flat_material(fitted: Parts) -> None:
    material, truth = decoded(fitted), table_of(flat_maps())
    found = material.table[: SIZE * SIZE].clone()
    found[:, :3] *= material.scale  # a scale near 1 and colours share what they reflect
    off = (found - truth).abs().amax(0)
    # Half a code is 0.002, of normals 0.004, and of the brightest sRGB codes 0.005; the others are the fit's.
    assert (off <= torch.tensor([*[0.02] * 3, *[0.01] * 3, 0.01, 0.03])).all(), off


def test_a_larger_footprint_sees_averages_of_the_maps() -> None:
    codes = torch.tensor([[[255, 255, 255], [0, 0, 0]], [[0, 0, 0], [255, 255, 255]]])
    codes = torch.cat([codes, torch.tensor([128, 128, 255, 0]).expand(2, 2, 4)], 2)
    material = MapsMaterial(codes, 2.0)
    up = torch.tensor([[0.0, 0.0, 1.0]])
    for footprint, base in ((0.0, 1.0), (1.0, 0.5)):  # grey in linear light
        maps = torch.tensor([[base, base, base, 0.0, 0.0, 1.0, 1.0, 0.0]])
        answer = material.query(torch.tensor([[0.25, 0.75]]), up, up, footprint)
        torch.testing.assert_close(answer, 2 * shaded(maps, up, up), rtol=1e-3, atol=0)  # 128 is no exact normal


def test_decode_writes_maps_that_bake_reads(tmp_path: Path, fitted: Parts, capsys: pytest.CaptureFixture[str]) -> None:
    file, folder = tmp_path / "flat.nbtf", tmp_path / "maps"
    container.save(file, SVBRDF(), fitted)
    assert cli.main(["decode", str(file), "--maps", "-o", str(folder)]) == 0
    assert {path.name for path in folder.iterdir()} == {
        f"flat_{name}.png" for name in ("BaseColor", "NormalGL", "Roughness", "Metalness")
    }
    read = read_surface(recognise(folder), SIZE).maps
    # The same codes; z has codes of its own there.
    np.testing.assert_allclose(table_of(read), decoded(fitted).table[: SIZE * SIZE], atol=4e-3)


def test_maps_are_refused_where_there_are_none(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "mean.nbtf"
    container.save(file, MeanColour(), MeanColour().encode(tiny_btf(), Fit()))
    assert cli.main(["decode", str(file), "--maps", "-o", str(tmp_path / "maps")]) == 2
    assert "mean-colour" in capsys.readouterr().err
    assert not (tmp_path / "maps").exists()


def test_data_in_another_unit_have_the_same_maps() -> None:
    like = tiny_btf()
    values = np.stack(list(like))
    files = [SVBRDF(steps=20).encode(BTF("x", like.wo, like.wi, ArraySource(f * values)), Fit()) for f in (1, 4)]
    assert torch.equal(files[0].texture["maps"], files[1].texture["maps"])
    torch.testing.assert_close(4 * files[0].other["scale"], files[1].other["scale"])
