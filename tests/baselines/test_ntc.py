import math
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
import torch

from baselines.ntc import NTC, NTCObjective, Reader, codes_of, corners_of_texels, encoded_places, values_of
from bench.codec import Fit, Parts
from bench.conformance.check import tiny_btf
from bench.directions import hemisphere
from bench.material import parameters, texel_centres, texel_corners
from bench.training import Samples, gain_of
from tests.baselines.made import coded, cropped, decoded, normed_sines


def codec(**settings: Any) -> NTC:
    return NTC(**{"steps": 10, "batch": 256} | settings)


# 4 · 12 + 20 features and 12 numbers of the place are the published inputs but one, the level of detail. Beside them
# stand 4 of directions: (80 + 4) → 64 → 64 → 3 with biases. Ours has 4 · 6 features of the finer grid, 9 numbers of
# directions and 2 · 64 of each of two layer norms.
@pytest.mark.parametrize(("recipe", "count", "size"), [("paper", 9_795, (24, 10)), ("ours", 8_835, (192, 160))])
def test_network_and_grids_have_the_stated_sizes(recipe: str, count: int, size: tuple[int, int]) -> None:
    parts, material = coded(codec(steps=2, recipe=recipe))
    assert parts.decoder["weights"].shape == (count,)
    assert parameters(material) == material.cost.parameters == count
    # 8 × 8 texels: 2 × 2 points and one of 12 and 20 features, or 8 × 8 and 4 × 4 of 6 and 20, in half a byte each.
    assert (len(parts.texture["fine"]), len(parts.texture["coarse"])) == size


def triangle(x: float) -> float:
    """−1 at whole numbers, 1 between them."""
    return 1 - 4 * abs(x % 1 - 0.5)


def test_places_are_encoded_by_triangle_waves_that_repeat_after_eight_texels() -> None:
    found = encoded_places((10, 17)).reshape(10, 17, 12)
    for row, col in ((0, 0), (3, 7), (9, 16)):
        expected = [
            triangle((place + 0.5) / 8 * 2**octave + phase)
            for octave in range(3)
            for place in (col, row)
            for phase in (0, 0.25)
        ]
        np.testing.assert_allclose(found[row, col], expected, atol=1e-6)
    torch.testing.assert_close(found[:2, :9], found[8:, 8:])
    assert len(found[:8, :8].flatten(0, 1).unique(dim=0)) == 64


@pytest.mark.parametrize("steps", [1, 2, 3, 4, 8])
def test_each_texel_lies_between_the_points_around_it_at_any_side(steps: int) -> None:
    for side in range(1, 131):
        points = -(-side // steps)
        places = [Fraction(2 * texel + 1, 2 * side) * points - Fraction(1, 2) for texel in range(side)]
        first = [math.floor(place) % points for place in places]
        second = [(each + 1) % points for each in first]
        share = torch.tensor([float(place % 1) for place in places])
        rows, row_weights = corners_of_texels((points, 1), (side, 1))
        cols, col_weights = corners_of_texels((1, points), (1, side))
        assert rows.T.tolist() == [first, first, second, second]
        assert cols.T.tolist() == [first, second, first, second]
        nothing = torch.zeros(side)
        torch.testing.assert_close(row_weights, torch.stack([1 - share, nothing, share, nothing], 1))
        torch.testing.assert_close(col_weights, torch.stack([1 - share, share, nothing, nothing], 1))


def test_at_full_resolution_each_texel_reads_its_own_point_first() -> None:
    for size in [(100, 96), (50, 48), *((side, 131 - side) for side in range(1, 131))]:
        found = Reader(size, 1).fine.reshape(*size, 4)
        own = torch.arange(size[0] * size[1]).reshape(size)
        neighbours = [own.roll(shifts, (0, 1)) for shifts in ((0, 0), (0, -1), (-1, 0), (-1, -1))]
        assert torch.equal(found, torch.stack(neighbours, 2)), size


@pytest.mark.parametrize("size", [(64, 128), (8, 1), (2, 32)])
@pytest.mark.parametrize("reduction", [1, 2, 4])
def test_where_sides_are_powers_of_two_floats_are_exact_and_files_read_as_before(
    size: tuple[int, int], reduction: int
) -> None:
    reader, centres = Reader(size, reduction), texel_centres(*size)
    fine, coarse = (tuple(-(-side // steps) for side in size) for steps in (reduction, 2 * reduction))
    assert torch.equal(reader.fine, texel_corners(fine, centres)[0])
    index, weight = texel_corners(coarse, centres)
    assert torch.equal(reader.coarse, index)
    assert torch.equal(reader.weight, weight)


def stored(parts: Parts, name: str, rows: int, cols: int, bits: int) -> np.ndarray:
    """The values (rows, cols, features) of a grid, bit by bit from its bytes."""
    flags = "".join(f"{byte:08b}" for byte in parts.texture[name].tolist())
    codes = [int(flags[i : i + bits][::-1], 2) for i in range(0, len(flags) - bits + 1, bits)]
    channels = {"fine": 12, "coarse": 20}[name]
    return -1 + 2 * np.array(codes[: rows * cols * channels]).reshape(rows, cols, channels) / (2**bits - 1)


def texel(parts: Parts, row: int, col: int, wo: np.ndarray, wi: np.ndarray, bits: int) -> np.ndarray:
    """Radiance (3,) of a texel of 8 × 8, grids of 4 × 4 and 2 × 2 points, loop by loop."""
    fine, coarse = stored(parts, "fine", 4, 4, bits), stored(parts, "coarse", 2, 2, bits)
    y, x = (row + 0.5) / 2 - 0.5, (col + 0.5) / 2 - 0.5
    top, left = int(np.floor(y)), int(np.floor(x))
    near = [fine[(top + i) % 4, (left + j) % 4] for i in (0, 1) for j in (0, 1)]
    y, x = (row + 0.5) / 4 - 0.5, (col + 0.5) / 4 - 0.5
    top, left = int(np.floor(y)), int(np.floor(x))
    b, a = y - top, x - left
    wide = np.zeros(coarse.shape[-1])
    for i, of_row in enumerate((1 - b, b)):
        for j, of_col in enumerate((1 - a, a)):
            wide += of_row * of_col * coarse[(top + i) % 2, (left + j) % 2]
    h = (wo + wi) / np.linalg.norm(wo + wi)
    values = np.concatenate([*near, wide, encoded_places((8, 8))[8 * row + col], wo, wi, h])
    values = normed_sines(values, parts.decoder["weights"], (64, 89), (64, 64), (3, 64))
    return np.expm1(values).clip(0) / float(parts.other["gain"])


@pytest.mark.parametrize("bits", [4, 3])
def test_a_decoded_file_answers_as_the_equations(bits: int) -> None:
    parts, material = coded(codec(steps=30, weights="float32", bits=bits, reduction=2, fine=12))
    wo, wi = hemisphere.from_degrees(50.0, 20.0), hemisphere.from_degrees(35.0, 140.0)
    found = material.slice(wo.tolist(), wi.tolist())
    each = {(r, c): texel(parts, r, c, wo.astype(float), wi.astype(float), bits) for r in (2, 3) for c in (6, 7)}
    for (row, col), expected in each.items():
        # Float32 sums of about a hundred terms.
        np.testing.assert_allclose(found[row, col], expected, rtol=3e-4, atol=2e-5)
    # A quarter of a texel right of and below the centre of texel (2, 6).
    uv = np.array([[6.75 / 8, 1 - 2.75 / 8]], np.float32)
    between = material.query(uv, wo[None].astype(np.float32), wi[None].astype(np.float32))[0]
    shares = {(2, 6): 0.5625, (2, 7): 0.1875, (3, 6): 0.1875, (3, 7): 0.0625}
    np.testing.assert_allclose(between, sum(shares[at] * each[at] for at in shares), rtol=3e-4, atol=2e-5)


def test_one_texel_is_drawn_by_its_bilinear_weight() -> None:
    ours = codec(steps=30)
    material = decoded(ours, tiny_btf())
    one = material.at_one_texel()
    assert one is not None
    # Places around a quarter of a texel right of and below the centre of texel (2, 6), 1e-4 of a texel apart at most.
    jitter = 1e-4 * torch.rand(20_000, 2, generator=torch.Generator().manual_seed(0))
    uv = (torch.tensor([6.75, 8 - 2.75]) + jitter) / 8
    wo = torch.from_numpy(hemisphere.from_degrees(50.0, 20.0)).float().expand(len(uv), 3)
    wi = torch.from_numpy(hemisphere.from_degrees(35.0, 140.0)).float().expand(len(uv), 3)
    picture = material.slice(wo[0].tolist(), wi[0].tolist())
    texels, drawn = picture[2:4, 6:8].flatten(0, 1), one.query(uv, wo, wi)
    shares = torch.isclose(drawn[:, None], texels, rtol=1e-4).all(2).double().mean(0)
    # Five standard deviations of a share of 20,000 draws are .018.
    torch.testing.assert_close(shares, torch.tensor([0.5625, 0.1875, 0.1875, 0.0625]).double(), rtol=0, atol=0.018)
    deviation = drawn.std(0) / len(uv) ** 0.5
    assert ((drawn.mean(0) - material.query(uv, wo, wi).mean(0)).abs() <= 5 * deviation + 1e-6).all()
    assert torch.equal(drawn, one.query(uv, wo, wi))


@pytest.mark.parametrize("rounding", ["round", "noise"])
def test_in_the_end_the_fit_sees_what_the_file_gives_back(rounding: str) -> None:
    fit, settings = Fit(), NTC.Settings(rounding=rounding, reduction=2)
    btf = cropped(5, 7)
    fitting = NTCObjective(Samples(btf, gain_of(btf, fit), fit), settings, fit.generator())
    for grid, seen in zip(fitting.unrounded_grids, fitting.grids(1.0), strict=True):
        # A straight-through sum rounds the last bit.
        torch.testing.assert_close(seen, values_of(codes_of(grid, 4), 4), rtol=0, atol=1e-7)
        assert seen.requires_grad == (rounding == "round")
    early = [fitting.grids(0.2, torch.Generator().manual_seed(seed))[0] for seed in (0, 1)]
    step = 2 / 15
    if rounding == "noise":
        apart = (early[0] - early[1]).abs()
        assert 0.5 * step < apart.max() <= step
    assert all(((grid - fitting.unrounded_grids[0]).abs() <= 0.5 * step + 1e-6).all() for grid in early)
