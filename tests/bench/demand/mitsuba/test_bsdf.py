from dataclasses import replace

import numpy as np
import pytest
import torch

import bench
from bench.codecs import container, loading
from bench.codecs.registry import make_codec
from bench.demand.mitsuba.lobes import NAME, Lobe
from bench.inputs.errors import InputError

mi = pytest.importorskip("mitsuba", reason='Mitsuba 3 is not installed: pip install "neubtf-bench[mitsuba]"')
pytestmark = pytest.mark.usefixtures("plugin")


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    path = tmp_path_factory.mktemp("bsdf") / "satin.nbtf"
    bench.encode(bench.open("satin", size=16, views=9, lights=9, heldout=8), "pca", path, components=6)
    return path


def queries(n):
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(2, n, 3))
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    return (3 * rng.random((n, 2)) - 1).astype("f4"), *directions.astype("f4")


def surface(uv, wo):
    import drjit as dr

    si = dr.zeros(mi.SurfaceInteraction3f, len(uv))
    si.uv, si.wi = mi.Point2f(uv.T), mi.Vector3f(wo.T)
    return si


def answered(file, uv, wo, wi, **more):
    bsdf = mi.load_dict({"type": "neubtf", "filename": str(file), **more})
    return np.asarray(bsdf.eval(mi.BSDFContext(), surface(uv, wo), mi.Vector3f(wi.T))).T


def test_its_radiance_is_the_materials(file, tmp_path):
    uv, wo, wi = queries(10_000)
    wanted = bench.load(file).query(2 * uv, wo, wi)
    np.testing.assert_allclose(answered(file, uv, wo, wi, repeat=2.0), wanted, rtol=1e-4, atol=1e-5)
    assert 0.15 < (wanted > 0).any(1).mean() < 0.35  # black below the horizon, of either direction
    wide = bench.open("satin", size=16, views=9, lights=9, heldout=8).crop(0, 0, 8, 16)
    bench.encode(wide, "pca", tmp_path / "wide.nbtf", components=6)
    wanted = bench.load(tmp_path / "wide.nbtf").query(uv * np.float32([2, 4]), wo, wi)
    np.testing.assert_allclose(answered(tmp_path / "wide.nbtf", uv, wo, wi, repeat=2.0), wanted, rtol=1e-3, atol=1e-5)


@pytest.mark.long
def test_a_back_is_black_or_mirrors_the_front(file):
    uv, wo, wi = queries(200)
    wo[:, 2], wi[:, 2] = -abs(wo[:, 2]), -abs(wi[:, 2])
    up = np.float32([1, 1, -1])
    for two_sided in (False, True):
        radiance = answered(file, uv, wo, wi, two_sided=two_sided)
        wanted = bench.load(file).query(uv, wo * up, wi * up) if two_sided else 0 * radiance
        np.testing.assert_allclose(radiance, wanted, rtol=1e-4, atol=1e-5)


@pytest.fixture(scope="module")
def sampled(file):
    path = file.with_name("sampled.nbtf")
    loaded, (_, parts) = loading.load(file), container.read_parts(file)
    lobes = torch.tensor([[[1.0, -2.0, -0.5, 0.2, -0.1], [0.0, -1.0, -3.0, 0.0, 0.3]]] * 2)
    codec = make_codec(loaded.header.codec, loaded.header.settings)
    container.save(path, codec, replace(parts, sampling={NAME: lobes.half()}))
    return path


@pytest.mark.long
def test_lobes_are_those_that_were_fitted(sampled):
    bsdf = mi.load_dict({"type": "neubtf", "filename": str(sampled)})
    uv, wo, wi = queries(2000)
    uv -= np.floor(uv)
    wo[:, 2], wi[:, 2] = abs(wo[:, 2]), abs(wi[:, 2])
    raw = container.read_parts(sampled)[1].sampling[NAME].float()
    rows, columns = (np.minimum((x * 2).astype(int), 1) for x in (1 - uv[:, 1], uv[:, 0]))
    wanted = Lobe.from_stored(raw[rows, columns]).density(torch.from_numpy(wo), torch.from_numpy(wi)).numpy()
    density = np.asarray(bsdf.pdf(mi.BSDFContext(), surface(uv, wo), mi.Vector3f(wi.T)))
    np.testing.assert_allclose(density, wanted, rtol=2e-3, atol=1e-5)


@pytest.mark.long
def test_without_lobes_directions_are_drawn_as_the_density_says(file):
    sample, pdf = mi.chi2.BSDFAdapter("neubtf", f'<string name="filename" value="{file}"/>')
    test = mi.chi2.ChiSquareTest(mi.chi2.SphericalDomain(), sample, pdf, sample_dim=3, sample_count=200_000, res=41)
    assert test.run()


def test_a_variant_that_cannot_run_it_is_refused():
    from bench.demand.mitsuba.bsdf import register

    mi.set_variant("scalar_rgb")
    try:
        with pytest.raises(InputError, match="scalar_rgb"):
            register()
    finally:
        mi.set_variant("llvm_ad_rgb")
