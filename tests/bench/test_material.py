import numpy as np
import pytest
import torch

from bench.directions.hemisphere import ubo2003, uniform
from bench.directions.interpolation import Hemisphere
from bench.inputs.errors import InputError
from bench.material import CHUNK, DecoderCost, Material, box_centres, sample_texture, texel_centres, to_radiance


class Constant(Material):
    def __init__(self, value=0.5):
        super().__init__((4, 6), DecoderCost())
        self.value, self.seen = torch.tensor([value, -1.0, 2.0]), []

    def evaluate(self, uv, wo, wi, footprint):
        self.seen.append((uv, wo, wi, footprint))
        return self.value.expand(len(uv), 3)


def queries(count, seed=0):
    rng = np.random.default_rng(seed)
    wo, wi = (torch.from_numpy(uniform(rng, count)) for _ in range(2))
    return torch.from_numpy(rng.random((count, 2), np.float32)), wo, wi


def test_below_the_horizon_is_zero_and_the_codec_never_sees_it():
    material, (uv, wo, wi) = Constant(), queries(4)
    wi[1, 2], wo[2, 2] = -wi[1, 2], 0.0
    wo[2, :2] = torch.tensor([1.0, 0.0])
    answer = material.query(uv, wo, wi)
    assert answer[:, 0].tolist() == [0.5, 0.0, 0.0, 0.5]
    _, seen_wo, seen_wi, _ = material.seen[0]
    assert (seen_wo[:, 2] > 0).all()
    assert (seen_wi[:, 2] > 0).all()


def test_below_the_lowest_light_of_the_fit_the_answer_falls_with_the_cosine():
    """The codec is asked for the lowest light at the same azimuth; the answer is continuous there, and 0 at the end."""
    material = Constant()
    material.lowest_light = 0.25
    uv, wo, _ = queries(4)
    cosine = torch.tensor([0.5, 0.25, 0.125, 1e-4])
    azimuth = torch.tensor([0.6, -0.8])
    wi = torch.cat([(1 - cosine.square()).sqrt()[:, None] * azimuth, cosine[:, None]], 1)
    answer = material.query(uv, wo, wi)
    assert answer[:, 0].tolist() == pytest.approx([0.5, 0.5, 0.25, 2e-4])
    _, _, seen, _ = material.seen[-1]
    assert seen[:2].equal(wi[:2])
    torch.testing.assert_close(seen[2:], wi[1].expand(2, 3))
    # Lights that were fitted are answered alike, whatever else is in the batch.
    assert material.query(uv[:2], wo[:2], wi[:2]).equal(answer[:2])


@pytest.mark.parametrize("name", ["uv", "wo", "wi", "footprint"])
@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_a_number_that_is_not_finite_is_refused_by_row(name, bad):
    uv, wo, wi = queries(100)
    given = {"uv": uv, "wo": wo, "wi": wi, "footprint": torch.zeros(100)}
    given[name].reshape(100, -1)[42, 0] = bad
    with pytest.raises(InputError, match=f"{name} .*42 "):
        Constant().query(**given)


def test_queries_of_wrong_shape_kind_or_length_are_named():
    uv, wo, wi = queries(3)
    for wrong, message in (
        ((uv, wo, wi * torch.tensor([[1.0], [1.1], [1.0]])), "wi of row 1 is not of unit length"),
        ((uv, wo, wi, torch.tensor([0.0, 1.0, -0.1])), "footprint of row 2 is negative"),
        ((uv, wo[:2], wi), "uv, wo, wi"),
        ((uv.numpy(), wo.numpy(), wi.numpy(), np.zeros(2)), "footprint"),
        ((np.float32(1), wo.numpy(), wi.numpy()), "must be"),
        ((uv.numpy().astype(str), wo.numpy(), "up"), "not an array of numbers"),
    ):
        with pytest.raises(InputError, match=message):
            Constant().query(*wrong)


def test_directions_may_be_whole_numbers_and_of_another_kind_than_uv():
    uv = torch.full((1, 2), 0.5)
    up = torch.tensor([[0, 0, 1]])
    expected = Constant().query(uv, up.float(), up.float())
    assert torch.equal(Constant().query(uv, up, up), expected)
    assert torch.equal(Constant().query(uv, up.numpy(), up.tolist()), expected)


def test_batches_are_chunked_and_an_empty_one_is_empty():
    material = Constant()
    assert material.query(*queries(0)).shape == (0, 3)
    assert material.query(*queries(CHUNK + 1)).shape == (CHUNK + 1, 3)
    assert [len(uv) for uv, *_ in material.seen] == [CHUNK, 1]
    _, wo, wi = queries(2)  # far uv keeps its place in the texture
    material.query(torch.tensor([[1e6 + 0.25, -1e6 - 0.25], [-0.0, 1 - 2**-24]]), wo, wi)
    assert material.seen[-1][0][0].tolist() == [0.25, 0.75]
    assert material.seen[-1][0][1, 0] == 0.0


def test_a_slice_asks_at_texel_centres_from_the_top_row_down():
    centres = texel_centres(2, 4).reshape(2, 4, 2)
    assert centres[0, 0].tolist() == [0.125, 0.75]
    assert centres[1, 3].tolist() == [0.875, 0.25]
    material = Constant()
    assert material.slice([0, 0, 1], [0, 0, 1]).shape == (4, 6, 3)
    assert material.seen[0][3].unique().tolist() == [pytest.approx(1 / 6)]
    assert material.slice([0, 0, 1], [0, 0, 1], (2, 3)).shape == (2, 3, 3)


def test_boxes_are_asked_where_their_texels_are():
    """Of seven columns in boxes of two the last is left out, and the others stay where they are."""
    assert box_centres((5, 7), 2)[:, 0].tolist() == pytest.approx([1 / 7, 3 / 7, 5 / 7] * 2)
    assert box_centres((5, 7), 2)[::3, 1].tolist() == pytest.approx([1 - 1 / 5, 1 - 3 / 5])
    material = Constant()
    pictures = material.boxes([0, 0, 1], [0, 0, 1], [2, 4], (5, 7))
    assert {factor: tuple(picture.shape) for factor, picture in pictures.items()} == {2: (2, 3, 3), 4: (1, 1, 3)}
    assert material.seen[0][3].tolist() == pytest.approx([2 / 7] * 6 + [4 / 7])


def test_a_texture_at_its_texel_centres_is_itself_and_linear_between():
    texture = torch.rand(5, 7, 3, generator=torch.Generator().manual_seed(0))
    at_centres = sample_texture(texture, texel_centres(5, 7)).reshape(5, 7, 3)
    # uv · W rounds in float32: the weights are off by some 1e-6.
    torch.testing.assert_close(at_centres, texture, atol=5e-6, rtol=0)
    between = sample_texture(texture, torch.tensor([[1.0 / 7, 1 - 0.5 / 5]]))[0]
    torch.testing.assert_close(between, (texture[0, 0] + texture[0, 1]) / 2, atol=5e-6, rtol=0)
    corner = sample_texture(texture, torch.tensor([[0.0, 0.0], [1.0, 1.0], [0.0, 1.0]]))  # wraps around both ways
    expected = (texture[0, 0] + texture[0, -1] + texture[-1, 0] + texture[-1, -1]) / 4
    torch.testing.assert_close(corner, expected.expand(3, 3), atol=1e-6, rtol=0)


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16])
def test_a_short_material_is_asked_in_float32_and_keeps_its_geometry(dtype):
    material, (uv, wo, wi) = Constant(), queries(3)
    material.net, material.side = torch.nn.Linear(2, 3), Hemisphere(ubo2003())
    material.index, material.table = torch.arange(3), torch.tensor([1e6, -1e6, 3.0])
    assert material.modules() == [material.net]
    material.to(dtype=dtype)
    assert material.net.weight.dtype == material.value.dtype == dtype
    assert material.index.dtype == torch.int64
    assert material.side.points.dtype == torch.float32
    if dtype == torch.float16:  # what no half holds becomes the largest that one does
        assert material.table.tolist() == [65504.0, -65504.0, 3.0]
    assert material.query(uv, wo, wi).dtype == torch.float32
    assert {query.dtype for query in material.seen[0]} == {torch.float32}
    assert torch.equal(material.seen[0][1], wo)


def test_radiance_is_finite_whatever_the_level():
    level = torch.tensor([0.0, 0.5, 100.0, 65504.0], dtype=torch.float16)
    radiance = to_radiance(level, 1e-6)
    assert radiance.dtype == torch.float32
    assert radiance.isfinite().all()
    assert radiance[:2].tolist() == pytest.approx([0.0, 1e6 * np.expm1(0.5)])
    # 1e9 is a gain of data of 1e-8: as a half it would be infinite.
    assert to_radiance(torch.ones(1), 1e9).item() == pytest.approx(np.expm1(1) * 1e-9)


def test_arrays_ask_what_tensors_ask_and_the_answer_is_an_array():
    uv, wo, wi = queries(7)
    wanted = Constant().query(uv, wo, wi, 0.25)
    given = [x.numpy() for x in (uv, wo, wi)]
    answer = Constant().query(*given, 0.25)
    assert isinstance(answer, np.ndarray)
    np.testing.assert_array_equal(answer, wanted.numpy())
    reversed_rows = Constant().query(*(x[::-1] for x in given), np.full(7, 0.25))
    np.testing.assert_array_equal(reversed_rows, wanted.numpy()[::-1])
    given[0].setflags(write=False)
    np.testing.assert_array_equal(Constant().query(*given), wanted.numpy())
    lists = Constant().query([[0, 1]], [[0, 0, 1]], [[0, 0, 1]])
    np.testing.assert_array_equal(lists, [[0.5, 0.0, 2.0]])
    assert isinstance(Constant().query(uv, wo, wi), torch.Tensor)


def test_the_cost_of_a_texture_is_four_texels_fetched_and_blended():
    cost = DecoderCost.of_texture(torch.zeros(3, 5, 7, dtype=torch.float16), parameters=11, flops=100)
    assert cost == DecoderCost(11, 7, 3 * 5 * 7, flops_per_sample=100 + 4 * 2 * 7, bytes_per_sample=4 * 7 * 2)
