import importlib.util
import re
import sys

import numpy as np
import pytest
from PIL import Image

from bench import cli
from bench.codec import silent
from bench.data.bake import open_svbrdf
from bench.data.materials import brdf
from bench.data.materials.maps import Maps
from bench.data.materials.renderer import render
from bench.data.spec import Preparation
from bench.inputs.errors import InputError

with_mitsuba = pytest.mark.skipif(
    importlib.util.find_spec("mitsuba") is None,
    reason='Mitsuba 3 is optional and not installed: pip install "neubtf-bench[mitsuba]"',
)
SMALL = Preparation(size=8, views=4, lights=4, heldout=3)


def tracer():
    from bench.demand.mitsuba import path_tracer

    return path_tracer


def hills(size=32, height=0.1, base=0.5, **maps):
    u = (np.arange(size) + 0.5) / size
    relief = height / 2 * (np.sin(2 * np.pi * u)[:, None] + np.cos(2 * np.pi * u)[None])
    return Maps(relief, np.full((size, size, 3), base), **({"roughness": 0.5} | maps))


def folder_of_maps(folder):
    folder.mkdir()
    for name, value in {"albedo": (128, 128, 128), "roughness": (200, 200, 200)}.items():
        Image.fromarray(np.full((8, 8, 3), value, np.uint8)).save(folder / f"{name}.png")
    return folder


def test_without_mitsuba_it_says_what_to_install(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "mitsuba", None)
    monkeypatch.delitem(sys.modules, "bench.demand.mitsuba.path_tracer", raising=False)
    monkeypatch.delattr("bench.demand.mitsuba.path_tracer", raising=False)
    folder = folder_of_maps(tmp_path / "maps")
    words = ["bake", str(folder), "-o", str(tmp_path / "out.npz"), "--size", "8", "--renderer", "mitsuba"]
    assert cli.main(words) == 2
    assert "neubtf-bench[mitsuba]" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["maps"]


def path_trace(*arguments, **options):
    return np.concatenate([*tracer().launches(*arguments, **options)])


FLAT = {
    "diffuse": {"roughness": 1.0, "specular": 0.0},
    "rough dielectric": {"roughness": 0.4},
    "metal": {"roughness": 0.4, "metalness": 1.0},
    "brushed metal": {"roughness": 0.4, "metalness": 1.0, "anisotropy": 0.8, "angle": 2.0},
}


@with_mitsuba
@pytest.mark.parametrize("kind", FLAT)
def test_without_relief_it_is_the_built_in_renderer(kind):
    """Asked for are 2 % of each slice's mean. There is nothing to estimate, so that rounding is all that differs."""
    base = np.random.default_rng(0).uniform(0.1, 0.9, (16, 16, 3)).astype(np.float32)
    maps = Maps(0.0, base, **FLAT[kind])
    wo, wi = Preparation(views=6, lights=6, heldout=20).all_pairs("", 0)
    ours, theirs = (f(maps, wo, wi, (8, 8), 2).mean((1, 2)) for f in (render, path_trace))
    np.testing.assert_allclose(theirs, ours, rtol=2e-3)


@with_mitsuba
def test_between_texels_it_is_the_built_in_renderer(tmp_path, monkeypatch):
    monkeypatch.setenv("NEUBTF_CACHE", str(tmp_path / "cache"))
    folder = folder_of_maps(tmp_path / "maps")
    colours = np.random.default_rng(0).integers(40, 200, (8, 8, 3), np.uint8)
    Image.fromarray(colours).save(folder / "albedo.png")
    data = Preparation(size=8, views=2, lights=2, heldout=3, between=3)
    ours, theirs = (open_svbrdf(folder, data, silent, path_tracer=how).between[:] for how in (tracer(), None))
    np.testing.assert_allclose(ours, theirs, rtol=1e-2)
    assert np.abs(theirs[:, 1:] / theirs[:, :-1] - 1).mean() > 0.1  # neighbours differ by more


@pytest.mark.long
@with_mitsuba
def test_direct_light_on_relief_is_that_of_the_built_in_renderer():
    """Shadows, parallax and occlusion: within 1 % of each slice's mean, where inter-reflection adds far more."""
    maps = hills(128, height=0.15, base=0.9)
    wo, wi = Preparation(views=5, lights=5, heldout=10).all_pairs("", 0)
    ours = render(maps, wo, wi, (32, 32), 4).mean((1, 2, 3))
    direct, full = (path_trace(maps, wo, wi, (32, 32), 4, depth=d).mean((1, 2, 3)) for d in (2, 16))
    np.testing.assert_allclose(direct, ours, rtol=0.01)
    assert (full > direct).all()
    assert full.mean() / direct.mean() > 1.05


@pytest.mark.long
@with_mitsuba
def test_inter_reflection_is_that_of_mitsubas_own_integrator():
    """A white Lambert relief under `path`, by rays through random points: its own standard error is 0.3 %."""
    import mitsuba as mi

    maps = hills(height=0.48, base=0.9, roughness=1.0, specular=0.0)
    wo, wi = np.float32([[0.6, 0, 0.8]]), np.float32([[0.28, 0, 0.96]])
    ours = path_trace(maps, wo, wi, (32, 32), 4).mean()
    with tracer().using("scalar_rgb"):
        own_tracer = tracer().PathTracer(maps, (32, 32), 1, 0.8, 0.8)
        sun = {"type": "directional", "direction": (-wi[0]).tolist(), "irradiance": 1.0}
        scene = mi.load_dict({"type": "scene", "mesh": smooth(own_tracer), "sun": sun})
        path = mi.load_dict({"type": "path", "max_depth": 16, "rr_depth": 100})
        sampler = mi.load_dict({"type": "independent", "sample_count": 1})
        toward = mi.Vector3f(wo[0].tolist())
        starts = [mi.Point3f(x, y, 0) + toward for x, y in np.random.default_rng(0).random((30_000, 2))]
        rays = (mi.RayDifferential3f(start, -toward) for start in starts)
        theirs = np.mean([path.sample(scene, sampler, ray)[0][0] for ray in rays])
    assert ours == pytest.approx(theirs, rel=0.015)


def smooth(own_tracer):
    import mitsuba as mi

    old = mi.traverse(own_tracer._mesh(0.8, 0.8))
    vertices, faces = np.array(old["vertex_positions"]), np.array(old["faces"])
    look = mi.Properties()
    look["bsdf"] = mi.load_dict({"type": "diffuse", "reflectance": 0.9})
    mesh = mi.Mesh("smooth", len(vertices) // 3, len(faces) // 3, has_vertex_normals=True, props=look)
    size = own_tracer.size[0]
    col, row = (np.floor(place * size).astype(int) % size for place in (vertices[::3], 1 - vertices[1::3]))
    new = mi.traverse(mesh)
    new["vertex_positions"], new["faces"] = vertices, faces
    new["vertex_normals"] = np.ascontiguousarray(own_tracer.field.normals()[:, row, col].T).reshape(-1)
    new.update()
    return mesh


@with_mitsuba
@pytest.mark.parametrize("kind", FLAT)
@pytest.mark.parametrize("o", [(0.0, 0.0, 1.0), (0.8, 0.36, 0.48)])
def test_drawn_directions_have_the_built_in_reflectance_as_their_mean(kind, o):
    """The albedo by drawing equals that by quadrature of `bench.data.materials.brdf`; 100,000 draws err by 0.4 %."""
    import mitsuba as mi

    from bench.demand.mitsuba import path_tracer

    names = ("roughness", "metalness", "specular", "anisotropy")
    values = {"metalness": 0.0, "specular": 1.0, "anisotropy": 0.0} | FLAT[kind]
    maps = {name: np.full(1, values[name]) for name in names}
    at = brdf.points(tuple(np.full(1, x) for x in o), maps | {"base": np.full((3, 1), 0.6)})
    cos, phi = np.meshgrid((np.arange(400) + 0.5) / 400, (np.arange(800) + 0.5) / 800 * 2 * np.pi)
    sin = np.sqrt(1 - cos * cos)
    i = tuple(x.reshape(-1) for x in (sin * np.cos(phi), sin * np.sin(phi), cos))
    between = sum(a * b for a, b in zip(o, i, strict=True))
    through, highlight = brdf.reflect(at, i, between)
    expected = 2 * np.pi * (at.diffuse[0] * through + brdf.specular_colour(at, between)[0] * highlight).mean()
    random = np.random.default_rng(0).random((3, 100_000)).astype(np.float32)
    with tracer().using(tracer().fastest_variant()):
        here = path_tracer.shading(mi.Vector3f(*o), mi.Color3f(0.6), *(mi.Float(values[name]) for name in names))
        if mi.variant() == "scalar_rgb":
            pytest.skip("LLVM is not on this machine")
        choice, x, y = (mi.Float(row) for row in random)
        drawn = np.array(path_tracer.sample(here, choice, mi.Point2f(x, y))[1])[0].mean()
    assert drawn == pytest.approx(expected, rel=0.01)


@pytest.mark.long
@with_mitsuba
def test_neighbouring_tiles_occlude():
    """A surface cut elsewhere is the same surface: only what lies around the tile can make it so."""
    maps = hills(height=0.6)
    moved = Maps(np.roll(maps.height, 12, 1), maps.base_colour, 0.5)
    wo, wi = (np.float32([[x, 0, 0.28]]) for x in (0.96, -0.96))
    first, second = (path_trace(m, wo, wi, (32, 32), 1, depth=2)[0] for m in (maps, moved))
    # Rounding moves single rays across the edge of a shadow.
    assert np.mean(np.isclose(np.roll(first, 12, 1), second, rtol=1e-2, atol=1e-4)) > 0.99


@with_mitsuba
def test_the_seed_decides_the_paths_and_the_launches_do_not(monkeypatch):
    maps, (wo, wi) = hills(), Preparation(views=3, lights=3, heldout=0).all_pairs("", 0)
    first, other = (path_trace(maps, wo, wi, (8, 8), 2, seed=seed) for seed in (5, 6))
    monkeypatch.setattr("bench.demand.mitsuba.path_tracer.WAVEFRONT", 600)
    again = path_trace(maps, wo, wi, (8, 8), 2, seed=5)
    np.testing.assert_array_equal(first, again)
    assert "Mitsuba" in tracer().provenance()["renderer"]
    assert not np.array_equal(first, other)
    np.testing.assert_allclose(first.mean(), other.mean(), rtol=0.02)


@with_mitsuba
def test_without_llvm_it_says_so_and_gives_the_same_values(monkeypatch, caplog):
    maps, (wo, wi) = hills(8), Preparation(views=2, lights=2, heldout=0).all_pairs("", 0)
    first = path_trace(maps, wo, wi, (4, 4), 2)
    monkeypatch.setattr("bench.demand.mitsuba.path_tracer.unusable", lambda: "there is none")
    second = path_trace(maps, wo, wi, (4, 4), 2)
    assert re.search("scalar_rgb.*there is none", caplog.text)
    np.testing.assert_allclose(second, first, rtol=1e-3, atol=1e-5)


@with_mitsuba
def test_what_cannot_be_traced_is_refused():
    up, down = np.float32([[0, 0, 1]]), np.float32([[0, 0, -1]])
    with pytest.raises(InputError, match="horizon"):
        path_trace(hills(), up, down, (8, 8))
    low = np.float32([[1, 0, 1e-4]])
    with pytest.raises(InputError, match="too large"):
        path_trace(hills(), low, up, (8, 8))
