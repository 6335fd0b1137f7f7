import numpy as np
import pytest
import torch

from bench.btf import Layout
from bench.directions import hemisphere, interpolation
from bench.directions.interpolation import Hemisphere, PairInterpolator, pack_layout, stereographic, unpack_layout

SETS = {
    "ubo2003": hemisphere.ubo2003(),
    "ubo2014": hemisphere.ubo2014(),
    "thinned": hemisphere.ubo2003()[hemisphere.thin(hemisphere.ubo2003(), 25)],
    "random": hemisphere.uniform(np.random.default_rng(1), 40),
    "triangle": hemisphere.from_degrees([10.0, 60, 60], [0, 120, 240]),
}


def tensor(directions: np.ndarray) -> torch.Tensor:
    return torch.as_tensor(directions, dtype=torch.float32)


def queries(count: int, theta_max_deg: float = 89.0, seed: int = 0) -> torch.Tensor:
    return tensor(hemisphere.uniform(np.random.default_rng(seed), count, theta_max_deg))


def scattered(count: int = 60) -> tuple[torch.Tensor, torch.Tensor, PairInterpolator]:
    wo, wi = queries(count, 75.0, seed=2), queries(count, 75.0, seed=3)
    return wo, wi, PairInterpolator(Layout.of(wo.numpy(), wi.numpy()))


def dense(weights: tuple[torch.Tensor, torch.Tensor], count: int) -> torch.Tensor:
    index, weight = weights
    return torch.zeros(len(index), count, dtype=weight.dtype).scatter_add_(1, index, weight)


@pytest.mark.parametrize("name", SETS)
class TestHemisphere:
    def test_exact_at_its_samples(self, name: str) -> None:
        directions = SETS[name]
        weights = dense(Hemisphere(directions)(tensor(directions)), len(directions))
        # Float32 barycentric coordinates in triangles of a few degrees.
        torch.testing.assert_close(weights, torch.eye(len(directions)), atol=5e-5, rtol=0)

    def test_inside_the_hull_the_weights_reproduce_the_place_in_the_plane(self, name: str) -> None:
        side, wanted = Hemisphere(SETS[name]), queries(5000)
        _, weight = side(wanted)
        assert weight.min() >= 0
        torch.testing.assert_close(weight.sum(1), torch.ones(5000), atol=1e-6, rtol=0)
        wanted = wanted[~side.outside(wanted)]
        sample, weight = side(wanted)
        places = (side.points[sample] * weight[..., None]).sum(1)
        assert len(wanted) > 500
        torch.testing.assert_close(places, stereographic(wanted), atol=1e-4, rtol=0)

    def test_a_neighbourhood_answers_alike(self, name: str) -> None:
        """Across cells of the candidate grid, triangles and the hull: a small step changes the weights little."""
        side = Hemisphere(SETS[name])
        start = queries(4000, seed=4)
        rng = np.random.default_rng(5)
        step = torch.nn.functional.normalize(start + 1e-4 * tensor(rng.standard_normal(start.shape)), dim=1)
        step[:, 2].clamp_min_(1e-3)
        place = [(side.points[i] * w[..., None]).sum(1) for i, w in (side(start), side(step))]
        # The step is at most about 5e-4 in the plane; projection onto the hull never lengthens it.
        assert (place[0] - place[1]).norm(dim=1).max() < 1e-3
        change = (dense(side(start), len(SETS[name])) - dense(side(step), len(SETS[name]))).abs().max()
        assert change < 0.05

    def test_outside_the_hull_the_nearest_point_of_the_hull_answers(self, name: str) -> None:
        side, wanted = Hemisphere(SETS[name]), queries(3000)
        wanted = wanted[side.outside(wanted)]
        sample, weight = side(wanted)
        answered = (side.points[sample] * weight[..., None]).sum(1)
        rim = torch.linspace(0, 1, 201)[:, None, None]
        border = (side.edges[:, 0] + rim * (side.edges[:, 1] - side.edges[:, 0])).reshape(-1, 2)
        nearest = torch.cdist(stereographic(wanted), border, compute_mode="donot_use_mm_for_euclid_dist").amin(1)
        assert len(wanted) > 50
        # Points of the border are at most 0.01 apart, so the nearest of them is at most this much too far.
        distance = (answered - stereographic(wanted)).norm(dim=1)
        assert (distance < nearest + 1e-4).all()
        assert (distance > nearest - 5e-3).all()
        assert ((weight > 1e-3).sum(1) <= 2).all()


def test_the_rim_of_a_ring_is_the_hull() -> None:
    side = Hemisphere(SETS["ubo2003"])
    azimuth = np.arange(0, 360, 15.0) + 7.5
    inside, outside = (tensor(hemisphere.from_degrees(np.full(24, t), azimuth)) for t in (73.0, 76.0))
    assert not side.outside(inside).any()
    assert side.outside(outside).all()


@pytest.mark.parametrize("count", [1, 2])
def test_one_or_two_directions_answer_with_the_nearest(count: int) -> None:
    directions = hemisphere.from_degrees([20.0, 50.0], [0.0, 180.0])[:count]
    wanted = tensor(hemisphere.from_degrees([25.0, 60.0, 0.0], [10.0, 170.0, 0.0]))
    sample, weight = Hemisphere(directions)(wanted)
    assert sample[:, 0].tolist() == [0, count - 1, 0]
    assert (weight == 1).all()
    arc = hemisphere.from_degrees([60.0, 30, 0, 30, 60], [180.0, 180, 0, 0, 0])  # through the zenith
    sample, _ = Hemisphere(arc)(tensor(hemisphere.from_degrees([28.0, 55.0], [20.0, 170.0])))
    assert sample[:, 0].tolist() == [3, 0]


class TestPairs:
    views, lights = SETS["thinned"], SETS["random"]

    def test_a_lambertian_surface_is_reproduced_everywhere(self) -> None:
        """Radiance / cos θ_i is interpolated: a diffuse surface, radiance a/π · cos θ_i, comes out exactly."""
        wo, wi = queries(2000, seed=6), queries(2000, seed=7)
        layout = Layout.of(*hemisphere.product(self.views, self.lights))
        table = torch.as_tensor(layout.lights[layout.light, 2])
        index, weight = PairInterpolator(layout)(wo, wi)
        torch.testing.assert_close((table[index] * weight).sum(1), wi[:, 2], atol=1e-6, rtol=1e-5)
        _, swi, pairs = scattered()
        index, weight = pairs(wo, wi)
        torch.testing.assert_close((swi[:, 2][index] * weight).sum(1), wi[:, 2], atol=1e-6, rtol=1e-5)
        for each in (PairInterpolator(layout), pairs):
            _, share = each.shares(wo, wi)
            assert share.min() >= 0
            torch.testing.assert_close(share.sum(1), torch.ones(2000), atol=1e-6, rtol=0)

    def test_exact_at_the_pairs_of_a_product(self) -> None:
        wo, wi = hemisphere.product(self.views, self.lights)
        pairs = PairInterpolator(Layout.of(wo, wi))
        assert pairs.product
        weights = dense(pairs(tensor(wo), tensor(wi)), len(wo))
        # Two sides at 5e-5, times a ratio of cosines of at most 4 (θ ≤ 75°).
        torch.testing.assert_close(weights, torch.eye(len(wo)), atol=4e-4, rtol=0)

    def test_exact_at_scattered_pairs(self) -> None:
        for count in (60, 3):
            wo, wi, pairs = scattered(count)
            assert not pairs.product
            torch.testing.assert_close(dense(pairs(wo, wi), len(wo)), torch.eye(len(wo)), atol=1e-6, rtol=0)

    def test_pairs_that_are_all_equally_far_weigh_alike(self) -> None:
        azimuth = np.arange(12) * np.pi / 6
        wo = np.concatenate(
            [hemisphere.from_angles(np.full(12, 0.5), azimuth), hemisphere.from_angles([1.2, 1.3], [0.1, 2])]
        )
        wi = np.concatenate([np.tile([0.0, 0.0, 1.0], (12, 1)), hemisphere.from_angles([1.0, 1.1], [0.3, 4])])
        pairs = PairInterpolator(Layout.of(wo.astype(np.float32), wi.astype(np.float32)))
        zenith = torch.tensor([[0.0, 0.0, 1.0]])
        _, weight = pairs(zenith, zenith)
        torch.testing.assert_close(weight, torch.full((1, 8), 1 / 8), atol=1e-3, rtol=0)

    def test_scattered_weights_do_not_jump(self) -> None:
        _, _, pairs = scattered()
        ends = queries(2, 70.0, seed=9), queries(2, 70.0, seed=10)
        t = torch.linspace(0, 1, 4001)[:, None]
        path = [torch.nn.functional.normalize(a * (1 - t) + b * t, dim=1) for a, b in ends]
        weights = dense(pairs(*path), 60)
        # A path of length about 2 in 4,000 steps: a jump would be of the size of a weight, 0.1.
        assert (weights[1:] - weights[:-1]).abs().max() < 0.01

    def test_one_view_interpolates_the_lights_alone(self) -> None:
        wo, wi = hemisphere.product(np.array([[0.0, 0, 1]], np.float32), self.lights)
        pairs = PairInterpolator(Layout.of(wo, wi))
        assert pairs.reads == 3
        query = queries(100, seed=7)
        index, share = pairs.shares(queries(100, seed=6), query)
        expected = Hemisphere(self.lights)(query)
        assert torch.equal(index, expected.sample)
        assert torch.equal(share, expected.weight)

    def test_outside_is_either_side(self) -> None:
        pairs = PairInterpolator(Layout.of(*hemisphere.product(SETS["ubo2003"], SETS["ubo2003"])))
        low, high = (tensor(hemisphere.from_degrees([t], [10.0])) for t in (85.0, 20.0))
        wo, wi = torch.cat([high, low, high, low]), torch.cat([high, high, low, low])
        assert pairs.outside(wo, wi).tolist() == [False, True, True, True]
        assert not scattered()[2].outside(wo, wi).any()

    def test_nothing_is_outside_of_sides_without_a_triangle_on_the_device_of_the_queries(self) -> None:
        pairs = PairInterpolator(Layout.of(*hemisphere.product(SETS["ubo2003"][:2], SETS["ubo2003"][:2])))
        assert not pairs.outside(queries(9, seed=1), queries(9, seed=2)).any()
        assert pairs.outside(queries(9, seed=1).to("meta"), queries(9, seed=2).to("meta")).is_meta


class TestPackedLayout:
    views, lights = SETS["triangle"], SETS["thinned"][:5]

    def layout(self, order: np.ndarray | None = None) -> Layout:
        wo, wi = hemisphere.product(self.views, self.lights)
        return Layout.of(wo, wi) if order is None else Layout.of(wo[order], wi[order])

    @pytest.mark.parametrize(
        ("order", "tensors"),
        [
            (None, {"views", "lights"}),
            (np.arange(15).reshape(3, 5).T.flatten(), {"views", "lights", "views_fastest"}),
            (np.random.default_rng(0).permutation(15), {"views", "lights", "pairs"}),
            (np.arange(14), {"views", "lights", "pairs"}),
        ],
        ids=["lights fastest", "views fastest", "no order", "a pair is missing"],
    )
    def test_it_comes_back_and_a_product_says_its_pairs(self, order: np.ndarray | None, tensors: set[str]) -> None:
        layout = self.layout(order)
        packed = pack_layout(layout)
        assert set(packed) == tensors
        found = unpack_layout(packed, len(layout.view))
        for name in ("views", "lights", "view", "light"):
            assert np.array_equal(getattr(found, name), getattr(layout, name))

    def test_one_side_of_one_direction_is_a_product(self) -> None:
        layout = Layout.of(np.repeat(self.views[:1], 5, 0), self.lights)
        assert set(pack_layout(layout)) == {"views", "lights"}
        assert unpack_layout(pack_layout(layout)).grid is not None

    def test_more_pairs_than_memory_should_hold_are_stored_or_refused(self, monkeypatch: pytest.MonkeyPatch) -> None:
        implied = pack_layout(self.layout())
        monkeypatch.setattr(interpolation, "MOST_IMPLIED", 14)
        assert np.array_equal(unpack_layout(pack_layout(self.layout())).light, self.layout().light)
        with pytest.raises(ValueError, match="its pairs are not those"):
            unpack_layout(implied)

    @pytest.mark.parametrize(
        "pairs",
        [torch.zeros(0, 2), torch.zeros(15), torch.zeros(15, 3), torch.tensor([[0, 5]]), torch.tensor([[-1, 0]])],
    )
    def test_pairs_that_fit_no_directions_are_refused(self, pairs: torch.Tensor) -> None:
        with pytest.raises(ValueError, match="its pairs are not those"):
            unpack_layout(pack_layout(self.layout()) | {"pairs": pairs.long()})

    def test_another_number_of_pairs_than_the_table_has_is_refused(self) -> None:
        with pytest.raises(ValueError, match="its pairs are not those"):
            unpack_layout(pack_layout(self.layout()), 14)
