from pathlib import Path

import numpy as np
import pytest

from baselines.mean_colour import MeanColour
from bench.btf import BTF, ArraySource
from bench.codec import Fit
from bench.codecs import container, loading
from bench.directions import hemisphere


def made() -> BTF:
    directions = hemisphere.ubo2003()
    values = np.random.default_rng(0).random((81, 5, 7, 3), np.float32) * 4
    return BTF("made", directions, directions[::-1].copy(), ArraySource(values))


@pytest.mark.parametrize(("half", "tolerance"), [(True, 5e-4), (False, 1e-6)])
def test_every_slice_is_the_mean(tmp_path: Path, half: bool, tolerance: float) -> None:
    btf, codec = made(), MeanColour(half=half)
    header = container.save(tmp_path / "a.nbtf", codec, codec.encode(btf, Fit()))
    material = loading.load(tmp_path / "a.nbtf")[1]
    mean = np.mean(list(btf), 0, dtype=np.float64)
    for pair in (0, 40, 80):
        np.testing.assert_allclose(material.slice(btf.wo[pair], btf.wi[pair]), mean, rtol=tolerance)
    assert header.part_bytes()["texture"] == 5 * 7 * 3 * (2 if half else 4)
