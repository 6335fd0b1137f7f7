"""Directions drawn for every codec and material come as often as their density says."""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import torch

import bench
from bench.codecs import container
from bench.codecs.registry import codec_entries, load_codec, make_codec
from bench.conformance.stress.case import subject_of
from bench.data import materials
from bench.demand.mitsuba.lobes import NAME, Lobe, fitted, noise
from bench.directions.hemisphere import uniform
from tests.tiers import short_for

mi = pytest.importorskip("mitsuba", reason='Mitsuba 3 is not installed: pip install "neubtf-bench[mitsuba]"')
dr = pytest.importorskip("drjit")
pytestmark = pytest.mark.usefixtures("plugin")
CODECS = sorted(set(codec_entries()) - {"command"})  # which is any program, named by its settings
SIGNIFICANCE = 0.01  # of all tests together: Bonferroni
VIEWS = (25.0, 70.0)
DRAWN = 60_000


@pytest.fixture(autouse=True)
def folder_of_tables(tmp_path, monkeypatch):
    """Mitsuba writes the tables of a test that fails into the working directory."""
    monkeypatch.chdir(tmp_path)


@cache
def opened(material):
    return bench.open(material, size=16, views=9, lights=9, heldout=4)


def bsdf_of(lobes, folder):
    """The plug-in with lobes. Directions do not depend on what is answered, so that any small file holds them."""
    path = folder / "a.nbtf"
    if not path.exists():
        bench.encode(opened("satin"), "mean-colour", path)
    header, parts = container.read_header(path), container.read_parts(path)[1]
    out = folder / "b.nbtf"
    container.save(out, make_codec(header.codec, header.settings), replace(parts, sampling={NAME: lobes}))
    return mi.load_dict({"type": "neubtf", "filename": str(out)})


def surface(uv, theta_deg, count):
    si, theta = dr.zeros(mi.SurfaceInteraction3f, count), math.radians(theta_deg)
    si.uv, si.wi = mi.Point2f(*uv), mi.Vector3f(math.sin(theta), 0.0, math.cos(theta))
    return si


def misfit(bsdf, uv, theta_deg, tests, other=None):
    """Why the drawn directions are not those of the density, or of another's; "" where they are."""
    context = mi.BSDFContext()

    def draw(sample):
        drawn = bsdf.sample(context, surface(uv, theta_deg, DRAWN), sample.x, mi.Point2f(sample.y, sample.z))[0]
        return drawn.wo, dr.select(drawn.pdf > 0, mi.Float(1), 0)  # below the horizon nothing is drawn

    def density(wo):
        return (other or bsdf).pdf(context, surface(uv, theta_deg, dr.width(wo)), wo)

    test = mi.chi2.ChiSquareTest(
        mi.chi2.SphericalDomain(), draw, density, sample_dim=3, sample_count=DRAWN, res=31, ires=8
    )
    return "" if test.run(SIGNIFICANCE, tests) else test.messages


def busiest(lobes):
    """Where the texture's lobe is drawn most often."""
    share = Lobe.from_stored(lobes.float().reshape(-1, lobes.shape[2])).share.reshape(lobes.shape[:2])
    row, col = divmod(int(share.argmax()), share.shape[1])
    return (col + 0.5) / share.shape[1], 1 - (row + 0.5) / share.shape[0]


@pytest.mark.parametrize("codec", short_for(CODECS, "mean-colour"))
def test_chi_square(codec, tmp_path, record_property, request):
    subject = subject_of(load_codec(codec), tmp_path)
    short = {"steps": 10} if subject.has_steps else {}
    names = sorted(materials.names())
    if request.config.getoption("-m") == "not long":
        names = ["leather"]
    for name in names:
        subject.encode(opened(name), **short)
        decoded = bench.load(tmp_path / "stress.nbtf")
        lobes = fitted(decoded, cells=2, steps=20)
        bsdf, uv = bsdf_of(lobes, tmp_path), busiest(lobes)
        for theta in VIEWS:
            assert not misfit(bsdf, uv, theta, len(VIEWS) * len(CODECS) * len(materials.names())), (name, theta)
        record_property(f"largest albedo of {name}", noise(decoded, lobes.float(), lights=256).largest_albedo)


FITTED = "mean-colour hsh neumip neuralbtf neubtf-direct relief bcf rainer2019 zeltner2024 ntc triple-plane"


@pytest.mark.parametrize("codec", short_for(FITTED.split(), "neubtf-direct"))
def test_a_weight_is_the_answer_over_the_density(codec, tmp_path):
    subject, count = subject_of(load_codec(codec), tmp_path), 2000
    subject.encode(opened("satin"), **({"steps": 10} if subject.has_steps else {}))
    decoded = bench.load(tmp_path / "stress.nbtf")
    bsdf = mi.load_dict({"type": "neubtf", "filename": str(tmp_path / "stress.nbtf")})
    bsdf.draw_from(torch.tensor([[[1.0, -2.0, -0.5, 0.2, -0.1]]]))
    rng, si = np.random.default_rng(0), dr.zeros(mi.SurfaceInteraction3f, count)
    uv, wo = rng.random((count, 2)).astype("f4"), uniform(rng, count, 85.0).astype("f4")
    si.uv, si.wi = mi.Point2f(uv.T), mi.Vector3f(wo.T)
    context, chance = mi.BSDFContext(), rng.random((3, count))
    drawn, weight = bsdf.sample(context, si, mi.Float(chance[0]), mi.Point2f(chance[1:]))
    density, wi = np.asarray(bsdf.pdf(context, si, drawn.wo)), np.asarray(drawn.wo).T
    answer = decoded.query(uv, wo, np.ascontiguousarray(wi))
    assert (density > 0).mean() > 0.8
    off = np.abs((np.asarray(weight) * density).T - answer) > 1e-3 * answer + 1e-5
    assert off.any(1).mean() <= 1e-3  # a march may step over an edge by the last bit
    assert answer.std() > 0.01


def test_the_chi_square_finds_a_density_that_is_slightly_off(tmp_path):
    def made(name, roughness):
        (tmp_path / name).mkdir()
        return bsdf_of(torch.tensor([[[1.0, roughness, -1.0, 0.0, 0.0]]]).half(), tmp_path / name)

    one, other = made("a", -1.0), made("b", -0.7)
    assert not misfit(one, (0.5, 0.5), 25.0, 270)
    assert misfit(one, (0.5, 0.5), 25.0, 270, other)
