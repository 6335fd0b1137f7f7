import numpy as np
import pytest
import torch

from baselines.relief.geometry import Surface, shifted, slope
from bench.directions.hemisphere import from_degrees, uniform
from bench.material import texel_centres


def waves(size: tuple[int, int], amplitude: float = 0.05) -> torch.Tensor:
    uv = texel_centres(*size) * 2 * torch.pi
    return amplitude * (uv[:, 0].sin() * uv[:, 1].cos()).reshape(size)


def test_a_plane_is_met_at_its_height() -> None:
    relief = Surface(torch.full((8, 8), 0.05))
    wo = torch.from_numpy(from_degrees([0, 45, 60], [0, 0, 90])).float()
    uv, z = relief.meet(torch.full((3, 2), 0.5), wo)
    torch.testing.assert_close(z, torch.full((3, 1), 0.05))
    # Toward the eye a ray rises: it meets what is higher nearer to the eye.
    expected = [[0.5, 0.5], [0.55, 0.5], [0.5, 0.5 + 0.05 * 3**0.5]]
    torch.testing.assert_close(uv, torch.tensor(expected), rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("size", [(64, 64), (32, 64)])
def test_rays_meet_the_surface_and_nothing_before(size: tuple[int, int]) -> None:
    """In closed form: of all crossings of the ray with the waves, found by a fine search, it is the first."""
    rng = np.random.default_rng(0)
    uv = torch.from_numpy(rng.random((400, 2)).astype(np.float32))
    wo = torch.from_numpy(uniform(rng, 400, 70))
    relief = Surface(waves(size))
    _, found = relief.meet(uv, wo)
    z = torch.linspace(0.05, -0.05, 2001)
    place = uv[:, None] + z[:, None] * slope(wo, size)[:, None]
    height = 0.05 * (2 * torch.pi * place[..., 0]).sin() * (2 * torch.pi * place[..., 1]).cos()
    first = z[(height >= z).to(torch.uint8).argmax(1)]
    # Texels are bilinear and the first crossing of a ray that grazes a crest may be missed: most must agree.
    apart = (found[:, 0] - first).abs()
    assert apart.median() < 5e-4
    assert (apart < 3e-3).float().mean() > 0.97


@pytest.mark.parametrize("size", [(64, 64), (32, 64)])
def test_where_a_ray_hits_follows_the_height(size: tuple[int, int]) -> None:
    """The gradient says where rays hit once the height has changed a little."""
    rng = np.random.default_rng(0)
    uv, wo = torch.from_numpy(rng.random((400, 2))).float(), torch.from_numpy(uniform(rng, 400, 60))
    height = waves(size, 0.02).requires_grad_()
    change = 5e-4 * waves(size, 1.0).roll(size[0] // 4, 0)
    hits = Surface(height.detach()).meet(uv, wo)[0]
    followed = Surface(height.detach()).follow(height, hits, wo)
    torch.testing.assert_close(followed, hits)

    def along(weight: torch.Tensor) -> torch.Tensor:  # the change of each hit, from the gradient of their weighted sum
        (gradient,) = torch.autograd.grad((followed * weight).sum(), height, retain_graph=True)
        return (gradient * change).sum()

    moved = Surface(height.detach() + change).meet(uv, wo)[0] - hits
    moved = moved - moved.round()  # across the edge of the picture
    expected, found = [], []
    for row in range(0, 400, 8):
        for side in (0, 1):
            weight = torch.zeros_like(hits)
            weight[row, side] = 1
            found.append(along(weight))
            expected.append(moved[row, side])
    # The change is finite, texels are bilinear and a secant ends near the surface: most rays must agree.
    apart = (torch.stack(found) - torch.stack(expected)).abs()
    assert apart.median() < 0.05 * torch.stack(expected).abs().median()


def test_a_wall_stands_in_the_way_of_a_low_light_from_its_side_alone() -> None:
    height = torch.zeros(64, 64)
    height[:, 40:44] = 0.1
    relief = Surface(height)
    uv, z = torch.tensor([[0.5, 0.5]]), torch.zeros(1, 1)
    low_east, low_west, high_east = (torch.from_numpy(from_degrees([t], [p])).float() for t, p in
                                     ((70, 0), (70, 180), (20, 0)))  # fmt: skip
    # The wall is 0.125 to 0.19 away and 0.1 high; the ray of 70° is 0.046 high where it begins.
    assert 2 < relief.excess(uv, z, low_east) < 0.055 * 64
    assert relief.excess(uv, z, low_west) < 0
    assert relief.excess(uv, z, high_east) < 0


def test_shifting_undoes_parallax() -> None:
    """A plane of height z seen along ω_o, shifted by z, is the plane as seen from above."""
    picture = torch.rand(1, 16, 16)
    # tan θ = 1: a height of two texels moves by two.
    for azimuth, (rows, cols) in {0: (0, -2), 90: (2, 0), 180: (0, 2), 270: (-2, 0)}.items():
        view = torch.from_numpy(from_degrees([45], [azimuth])).float()[0]
        seen = picture.roll((rows, cols), (1, 2))  # a point appears at its place − z tan θ, and rows grow downwards
        torch.testing.assert_close(shifted(seen, view, 2 / 16), picture, rtol=0, atol=1e-4)
