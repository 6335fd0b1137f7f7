import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from bench.data.materials.procedural import smooth
from bench.data.materials.renderer import HeightField
from bench.directions.hemisphere import from_degrees


def bilinear(field, row, col):
    return map_coordinates(field.astype(np.float64), [row, col], order=1, mode="grid-wrap")


@pytest.fixture(scope="module")
def hills():
    return HeightField(0.03 * smooth(np.random.default_rng(0), 64, 0.05, 0.07), aspect=1.0)


@pytest.mark.parametrize("angles", [(0, 0), (30, 20), (60, 140), (75, 260), (75, 0)])
@pytest.mark.parametrize("stride", [1, 2])
def test_rays_end_where_a_fine_march_ends(hills, angles, stride):
    wo = from_degrees(*angles)
    start = np.arange(0, 64, stride) + (stride - 1) / 2
    row, col = np.meshgrid(start, start, indexing="ij")
    rows, cols = hills.offset(wo)
    expected, alive = np.full(row.shape, hills.bottom), np.ones(row.shape, bool)
    for z in np.linspace(hills.top, hills.bottom, 3000):
        hit = alive & (bilinear(hills.height, row + z * rows, col + z * cols) >= z)
        expected[hit], alive = z, alive & ~hit
    error = np.abs(hills.trace(wo, (stride, stride)) - expected) / (hills.top - hills.bottom)
    assert np.median(error) < 1e-3
    assert (error > 0.02).mean() < 0.01  # rays that graze a ridge inside one step of a cell may pass it


@pytest.mark.parametrize("angles", [(45, 30), (65, 100), (75, 200), (75, 300)])
def test_shadows_fall_where_a_fine_march_finds_an_occluder(hills, angles):
    wi = from_degrees(*angles)
    row, col = np.meshgrid(np.arange(64.0), np.arange(64.0), indexing="ij")
    rows, cols = hills.offset(wi)
    step = 0.25 / max(abs(rows), abs(cols))
    lit = np.ones(row.shape, bool)
    for rise in np.arange(step, hills.top - hills.bottom, step):
        lit &= bilinear(hills.height, row + rise * rows, col + rise * cols) <= hills.height + rise
    got = hills.visibility(wi) / 255
    wrong = np.abs(got - lit) > 0.5
    # Edges differ by up to a cell: an edge is longest, and so most wrong, where shadows are half of the picture.
    assert wrong.mean() < 0.06
    assert abs(got.mean() - lit.mean()) < 0.06
