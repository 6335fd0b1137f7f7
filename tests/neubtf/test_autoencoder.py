import pytest
import torch
from torch import Tensor

from neubtf.autoencoder import HALO, RADIUS, STRIDE, Autoencoder, Pooled, surrounded

ROUNDING = 1e-5  # float32 sums in another order, through some ten layers of values of unit size


def made(channels: int = 14) -> Autoencoder:
    return Autoencoder(channels, torch.Generator().manual_seed(1))


def picture(height: int, width: int) -> Tensor:
    return torch.rand(1, 3, height, width, generator=torch.Generator().manual_seed(2))


def close(ours: Tensor, theirs: Tensor) -> None:
    torch.testing.assert_close(ours, theirs, rtol=0, atol=ROUNDING)


@torch.no_grad()
@pytest.mark.parametrize("shift", [(STRIDE, 0), (-3 * STRIDE, 2 * STRIDE)])
def test_a_shifted_picture_has_the_shifted_texture(shift: tuple[int, int]) -> None:
    autoencoder, guidance = made(), picture(32, 48)
    close(autoencoder(guidance.roll(shift, (2, 3))), autoencoder(guidance).roll(shift, (2, 3)))


@torch.no_grad()
@pytest.mark.parametrize("size", [(1, 1), (3, 3), (5, 64), (30, 41)])
def test_any_size_is_padded_circularly(size: tuple[int, int]) -> None:
    autoencoder, guidance = made(5), picture(*size)
    height, width = size
    texture = autoencoder(guidance)
    assert texture.shape == (1, 5, height, width)
    # The oracle: a part of the endless picture with a wider margin, so that its own borders do not matter.
    margin = 2 * HALO
    up = [-(-side // STRIDE) * STRIDE for side in size]
    rows, cols = (torch.arange(-margin, n + margin) % side for n, side in zip(up, size, strict=True))
    features = autoencoder.encode(guidance[:, :, rows][..., cols])
    inner = margin // STRIDE
    pooled = Pooled.of_cells(features.deep[..., inner:-inner, inner:-inner])
    expected = autoencoder.decode(features, pooled)
    close(texture, expected[..., margin : margin + height, margin : margin + width])


@torch.no_grad()
def test_tiles_add_up_to_the_whole() -> None:
    autoencoder, guidance = made(), picture(64, 96)
    side = 32
    corners = [(row, col) for row in range(0, 64, side) for col in range(0, 96, side)]
    pooled, inner = None, slice(HALO // STRIDE, -(HALO // STRIDE))
    for corner in corners:
        deep = autoencoder.encode(surrounded(guidance, corner, (side, side))).deep[..., inner, inner]
        pooled = Pooled.of_cells(deep) if pooled is None else pooled.joined(Pooled.of_cells(deep))
    assert pooled is not None
    assert pooled.cells == 16 * 24
    texture, kept = torch.empty(1, 14, 64, 96), slice(HALO, -HALO)
    for row, col in corners:
        features = autoencoder.encode(surrounded(guidance, (row, col), (side, side)))
        texture[..., row : row + side, col : col + side] = autoencoder.decode(features, pooled)[..., kept, kept]
    close(texture, autoencoder(guidance))


@pytest.mark.parametrize("row", [60, 61, 62, 63])
def test_a_texel_depends_on_its_surroundings_only(row: int) -> None:
    autoencoder = Autoencoder(1, torch.Generator().manual_seed(1)).double()
    guidance = torch.rand(1, 3, 128, 12, dtype=torch.float64, requires_grad=True)
    features = autoencoder.encode(guidance)
    pooled = Pooled.of_cells(features.deep)
    still = Pooled(pooled.total.detach(), pooled.peak.detach(), pooled.cells)
    (slope,) = torch.autograd.grad(autoencoder.decode(features, still)[0, 0, row].sum(), guidance)
    touched = slope.abs().sum((0, 1, 3)).nonzero()[:, 0] - row
    assert touched.abs().max() <= RADIUS
    if row == 61:  # the cell's own corner decides how far it is to the last cell
        assert touched.min() == -RADIUS
