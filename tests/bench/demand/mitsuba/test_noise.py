import numpy as np
import pytest
import torch

import bench
from bench.inputs.errors import InputError

mi = pytest.importorskip("mitsuba", reason='Mitsuba 3 is not installed: pip install "neubtf-bench[mitsuba]"')
pytestmark = pytest.mark.usefixtures("plugin")
NARROW = torch.tensor([[[3.0, -2.0, -2.0, 0.0, 0.0]]])
SIDE = 6


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    path = tmp_path_factory.mktemp("noise") / "satin.nbtf"
    bench.encode(bench.open("satin", size=8, views=9, lights=9, heldout=4), "pca", path, components=4)
    return path


def measured(file, lobes, samples):
    from bench.demand.mitsuba import noise

    picture = noise.Picture(SIDE, samples, repetitions=24, timed=samples)
    return noise.reached(file, lobes, picture)


@pytest.mark.long
def test_as_many_samples_reach_the_noise_that_is_stated(file, monkeypatch):
    from bench.demand.mitsuba import noise

    monkeypatch.setattr(noise, "NOISE", 0.2)
    (figures,) = measured(file, [None], 16)
    bsdf = mi.load_dict({"type": "neubtf", "filename": str(file), "repeat": noise.REPEAT})
    scene = noise._ball(bsdf, SIDE)
    pictures = [np.asarray(mi.render(scene, spp=round(figures.samples), seed=100 + k)).mean(2) for k in range(24)]
    spread = np.sqrt(np.var(pictures, axis=0, ddof=1).mean()) / np.mean(pictures)
    assert figures.samples > 10
    assert spread == pytest.approx(0.2, rel=0.15)  # of 24 pictures of 36 pixels, some of which are far noisier


def test_a_black_picture_has_no_noise():
    from bench.demand.mitsuba import noise

    with pytest.raises(InputError, match="black"):
        noise._figures(np.zeros((3, 2, 2, 3)), 1.0, 4)
