import logging
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from baselines.neumip import NeuMIP
from baselines.pca import PCA
from baselines.table import Table
from bench import cli
from bench.btf import BTF, ArraySource
from bench.codec import Fit
from bench.codecs import container, loading
from bench.codecs.scene_material import SceneMaterial
from bench.codecs.window import CELLS, Window, cell_of, from_hex
from bench.conformance.check import tiny_btf
from bench.demand import UNIFORM
from bench.demand.demand import Demand
from bench.demand.fitting import Goal, Problem, Search, density_of, psnr_outside
from bench.demand.frame_scorer import FrameScorer
from bench.demand.needed_part import NeededPart, shares_of_others
from bench.directions.hemisphere import uniform
from bench.inputs.errors import InputError
from bench.material import texel_centres
from bench.training.samples import Samples
from tests.baselines.made import decoded
from tests.bench.demand.scenes import camera, demand_of, light, surface

NEAR = (
    camera(40, 30, 12, [0, -0.8, 1.4])
    + surface(size=[1, 1])
    + light("directional", toward=[0.5, 0, 0.9], irradiance=[3, 3, 3])
)
FAR = NEAR.replace("size = [1, 1]", "size = [2, 2]\nrepeat = [8, 8]").replace("fov_deg = 12", "fov_deg = 60")


def random_demand(count=4000, footprint=0.0):
    rng = np.random.default_rng(0)
    ones = np.ones((count, 3), np.float32)
    uv = rng.random((count, 2), np.float32)
    sizes = np.full(count, footprint, np.float32)
    pixel = np.arange(count, dtype=np.int32)
    return Demand(uv, sizes, uniform(rng, count), uniform(rng, count), ones, pixel, (1, 50, count // 50))


def encode(codec, btf, fit, demand, uniform=UNIFORM):
    return Problem.for_codec(codec, btf, demand, uniform).encode(codec, fit)


def loaded(codec, parts, folder):
    return loading.load(container.save(folder / "a.nbtf", codec, parts).path)[1]


def test_a_near_scene_needs_a_window_and_few_pairs_a_far_one_nothing_fine_and_one_from_everywhere_all():
    part = NeededPart.for_demand(tiny_btf(64, 9, 9), demand_of(NEAR))
    assert part.window.factor == 1
    assert part.window.height < 40
    assert part.window.width < 40
    assert 9 <= len(part.pairs) <= 27
    queries = demand_of(FAR)
    part = NeededPart.for_demand(tiny_btf(64, 9, 9), queries)
    assert part.window.full
    assert part.window.factor == int(np.percentile(queries.footprint, 1) * 64) > 2
    part = NeededPart.for_demand(tiny_btf(16, 6, 6), random_demand())
    assert part.window == Window.whole((16, 16))
    assert len(part.pairs) == 36
    assert part.views.sum() > 100


@pytest.mark.parametrize("start", [0.0, 0.7])
def test_a_window_maps_its_texels_onto_its_own_around_the_border_too(start):
    btf, queries = tiny_btf(32, 4, 4), random_demand(200)
    queries = replace(queries, place=((start + 0.4 * queries.place) % 1).astype(np.float32))
    window = NeededPart.for_demand(btf, queries).window
    assert 12 <= window.height <= 17
    uv = texel_centres(32, 32)
    inside = window.holds(uv)
    assert inside[torch.from_numpy(((uv.numpy() - start) % 1 < 0.4).all(1))].all()
    cut = window.cut(btf)
    assert not cut.periodic
    place = window.within(uv[inside])
    row, col = ((1 - place[:, 1]) * cut.shape[0]).long(), (place[:, 0] * cut.shape[1]).long()
    whole = btf[3].reshape(-1, 3)[inside.numpy()]
    np.testing.assert_array_equal(cut[3][row, col], whole)
    np.testing.assert_array_equal(cut.texels([2], [3])[0, 5], cut[5][2, 3])
    np.testing.assert_array_equal(cut.gather([5], [2], [3])[0], cut[5][2, 3])


def test_a_texture_that_is_not_square_has_windows_and_samples_of_square_texels():
    """A scene sees as much of it along u as along v, in texels, and a footprint covers as many of them."""
    btf, queries = tiny_btf(64, 4, 4).crop(0, 0, 32, 64), demand_of(NEAR)
    whole, window = (NeededPart.for_demand(each, queries).window for each in (tiny_btf(64, 4, 4), btf))
    assert window.size == (32, 64)
    assert abs(window.height - whole.height) <= 1 or window.height == 32
    assert window.width == whole.width
    middle = replace(random_demand(1), place=np.float32([[0.5, 0.25]]), footprint=np.float32([8 / 64]))
    drawn = density_of(middle, btf.layout, Window.whole((32, 64)), 0.0)
    samples = drawn.draw(4000, (32, 64), torch.Generator().manual_seed(0)).texel
    assert sorted({*(samples // 64).tolist()}) == list(range(12, 20))
    assert sorted({*(samples % 64).tolist()}) == list(range(28, 36))


def test_beyond_a_window_the_nearest_texel_of_it_answers():
    window = Window((32, 32), 8, 8, 16, 16)
    uv = torch.tensor([[0.26, 0.5], [0.2, 0.5], [0.8, 0.5], [0.05, 0.5]])
    np.testing.assert_allclose(window.within(uv)[:, 0], [0.5 / 16, 0.5 / 16, 15.5 / 16, 0.5 / 16], atol=1e-6)
    assert window.holds(uv).tolist() == [True, False, False, False]


def test_queries_between_needed_directions_are_answered_as_the_whole_table_answers_them(tmp_path):
    btf, queries = tiny_btf(16, 25, 25), demand_of(NEAR)
    full = decoded(Table(), btf)
    part = loaded(Table(), encode(Table(), btf, Fit(), queries), tmp_path)
    columns = [torch.from_numpy(x) for x in (queries.uv(btf.shape), queries.wo, queries.wi, queries.footprint)]
    difference = (full.query(*columns) - part.query(*columns)).abs().amax(1).numpy()
    share = queries.importance
    # 0.1 % of the demand may lie outside what is kept; a half float is off by 5e-4 of a value.
    assert share[difference > 2e-3].sum() < 2e-3
    assert len(part.inner.values) < len(full.values) / 5


def test_directions_at_the_horizon_lie_in_cells_at_the_border_of_the_map():
    row, column = np.divmod(cell_of(torch.tensor([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])).numpy(), CELLS)
    assert (row.tolist(), column.tolist()) == ([CELLS // 2, CELLS - 1], [CELLS - 1, CELLS // 2])


def test_samples_follow_the_demand_and_a_share_is_uniform():
    btf, queries = tiny_btf(32, 9, 9), demand_of(NEAR)
    window = Window.whole(btf.shape)
    density = density_of(queries, btf.layout, window, 0.25)
    samples = Samples(btf, 2.0, Fit(density=density))
    batch = samples.draw(20_000, torch.Generator().manual_seed(0))
    torch.testing.assert_close(samples.seen(batch.texel, batch.pair).target, batch.target)
    drawn = batch.pair >= len(btf)
    assert drawn.float().mean() == pytest.approx(0.75, abs=0.02)
    seen = NeededPart.for_demand(btf, queries).window
    assert seen.holds(samples.centres(batch.texel[drawn])).float().mean() > 0.99
    assert seen.holds(samples.centres(batch.texel[~drawn])).float().mean() < 0.9
    wo = samples.wo[batch.pair[drawn]].mean(0).numpy()
    np.testing.assert_allclose(wo, queries.importance @ queries.wo, atol=5e-3)
    wo, wi, uv = samples.wo[batch.pair], samples.wi[batch.pair], samples.centres(batch.texel)
    between = decoded(Table(), btf).query(*(x[drawn][:500] for x in (uv, wo, wi)))
    np.testing.assert_allclose(batch.target[drawn][:500].expm1() / 2, between, rtol=3e-3, atol=1e-3)
    pair, texel = batch.pair[~drawn][:50], batch.texel[~drawn][:50]
    truth = np.stack([btf[int(p)].reshape(-1, 3)[int(t)] for p, t in zip(pair, texel, strict=True)])
    np.testing.assert_allclose(batch.target[~drawn][:50].expm1() / 2, truth, rtol=2e-3, atol=1e-4)


def test_pairs_that_weigh_more_are_met_better():
    btf = noisy_btf()
    codec = PCA(components=3, domain="rgb", bits=32)
    weights = torch.full((len(btf),), 0.1)
    weights[40] = len(btf)
    errors = []
    for fit in (Fit(), Fit(density=SimpleNamespace(weights=weights))):
        material = decoded(codec, btf, fit)
        errors.append(np.abs(material.slice(btf.wo[40].tolist(), btf.wi[40].tolist()).numpy() - btf[40]).mean())
    assert errors[1] < errors[0] / 3


def test_queries_far_outside_are_reported_once(tmp_path, caplog):
    btf, queries = tiny_btf(32, 9, 9), demand_of(NEAR)
    material = loaded(PCA(components=2), encode(PCA(components=2), btf, Fit(), queries), tmp_path)
    assert isinstance(material, SceneMaterial)
    inside = [torch.from_numpy(x) for x in (queries.uv(btf.shape), queries.wo, queries.wi, queries.footprint)]
    with caplog.at_level(logging.WARNING):
        material.query(*inside)
        assert not caplog.records
        for _ in range(2):
            material.query(inside[0] + 0.5, *inside[1:])
        material.query(inside[0], -inside[1] * torch.tensor([1.0, 1.0, -1.0]), *inside[2:])
    assert len(caplog.records) == 1
    assert f"a.nbtf: {len(queries)} of {len(queries)} queries" in caplog.text


def test_a_file_says_what_it_was_fitted_to_and_a_wrong_window_is_an_error(tmp_path):
    btf, queries = tiny_btf(32, 9, 9), replace(demand_of(NEAR), fingerprint="ab" * 32)
    parts = encode(PCA(components=2), btf, Fit(), queries, 0.2)
    header = container.save(tmp_path / "a.nbtf", PCA(components=2), parts)
    assert header.scene["demand"] == "ab" * 32
    assert (header.scene["name"], header.scene["uniform"]) == ("test", 0.2)
    assert from_hex(header.scene["views"]).any()
    parts.scene["window"][3] += 5
    container.save(tmp_path / "b.nbtf", PCA(components=2), parts)
    with pytest.raises(InputError, match="window"):
        loading.load(tmp_path / "b.nbtf")


def noisy_btf():
    """More components than any small model has, so that size buys quality."""
    btf = tiny_btf(16, 9, 9)
    values = np.stack(list(btf)) * np.random.default_rng(0).uniform(0.7, 1.3, (81, 16, 16, 3)).astype(np.float32)
    return BTF("noisy", btf.wo, btf.wi, ArraySource(values), periodic=True)


def search(tmp_path, queries, codec):
    return Search(codec, noisy_btf(), FrameScorer(noisy_btf(), queries), Fit, tmp_path)


@pytest.mark.long
def test_a_search_finds_the_smallest_that_does_as_well_as_the_full_model(tmp_path):
    result = search(tmp_path, demand_of(NEAR), PCA(components=8)).run()
    assert result.met
    assert result.scene is not None
    assert result.scene.psnr >= result.full.psnr - 0.2
    scene, full = (sum(size for *_, size in model.header.tensors.values()) for model in (result.scene, result.full))
    assert scene < full / 2  # the header of so small a file is half of it


@pytest.mark.long
def test_a_target_is_met_or_the_best_is_given(tmp_path):
    looking = search(tmp_path, demand_of(NEAR), PCA(components=8))
    low = looking.run(Goal(psnr=15.0))
    assert low.met
    assert low.chosen.header.settings["components"] == 1
    high = looking.run(Goal(psnr=90.0))
    assert not high.met
    assert high.chosen.psnr == max(high.full.psnr, high.chosen.psnr)
    assert high.why == "no model reaches the goal"
    assert not looking.run(Goal(flip=0.0)).met
    everything = search(tmp_path, random_demand(), Table()).run()
    assert everything.scene is None
    assert everything.met
    assert everything.chosen is everything.full


@pytest.mark.long
def test_encode_writes_the_scene_model_and_its_table(tmp_path, capsys):
    np.savez(tmp_path / "no.npz", a=1)
    demand_of(NEAR).save(tmp_path / "near.npz")
    words = ["encode", "satin", "--codec", "pca", "-o", str(tmp_path / "out.nbtf")]
    for setting in ("components=8", "domain=rgb", "data.size=16", "data.views=9", "data.lights=9"):
        words += ["--set", setting]
    assert cli.main([*words, "--scene", str(tmp_path / "near.npz")]) == 0
    out = capsys.readouterr().out
    assert "outside" in out
    assert container.read_header(tmp_path / "out.nbtf").settings["scene"] is True
    assert cli.main([*words, "--scene", str(tmp_path / "near.npz"), "--target-psnr", "48.13"]) == 1
    capsys.readouterr()
    for target in ("99", "nan"):  # which no frames can have
        assert cli.main([*words, "--scene", str(tmp_path / "near.npz"), "--target-psnr", target]) == 2
        assert "--target-psnr" in capsys.readouterr().err
    assert cli.main([*words, "--target-psnr", "30"]) == 2
    assert "--scene" in capsys.readouterr().err
    assert cli.main([*words, "--scene", str(tmp_path / "no.npz")]) == 2
    assert "no.npz: " in capsys.readouterr().err


def test_levels_that_a_scene_never_touches_are_left_out_of_a_pyramid(tmp_path):
    btf, codec = tiny_btf(16, 6, 6), NeuMIP(steps=2, batch=64, offset=False)
    near, far = (random_demand(footprint=side / 16) for side in (1.0, 4.0))
    rows = {}
    for name, queries in (("near", near), ("far", far)):
        factor = NeededPart.for_demand(btf, queries, every_pair=True).window.factor
        material = loaded(codec, encode(codec, btf, Fit(), queries), tmp_path)
        rows[name] = (factor, material.inner.pyramid.level_sizes)
        columns = (torch.from_numpy(x) for x in (queries.uv(btf.shape), queries.wo, queries.wi))
        assert material.query(*columns).isfinite().all()
    assert rows == {"near": (1, [(16, 16)]), "far": (4, [(4, 4)])}
    mixed = replace(near, footprint=np.where(np.arange(4000) % 2, 1 / 16, 3 / 16).astype(np.float32))
    material = loaded(codec, encode(codec, btf, Fit(), mixed), tmp_path)
    assert material.inner.pyramid.level_sizes == [(16, 16), (8, 8), (4, 4)]


def test_coarse_queries_that_hardly_count_need_no_level():
    btf = tiny_btf(16, 6, 6)
    coarse = np.arange(4000) % 2 == 1
    queries = replace(random_demand(), footprint=np.where(coarse, 3 / 16, 1 / 16).astype(np.float32))
    dim = replace(queries, weight=np.where(coarse[:, None], 1e-4, 1).repeat(3, 1).astype(np.float32))
    whole = NeededPart.for_demand(btf, queries).window
    assert [density_of(demand, btf.layout, whole, 0.1).levels(16) for demand in (queries, dim)] == [3, 1]


def test_held_out_pairs_count_where_they_lie_in_the_scene():
    """Of two held-out pairs, that in the middle of the demand counts alone; a scene near neither has none."""
    near, far = demand_of(NEAR), tiny_btf(64, 9, 9).layout
    wo, wi = (np.average(side, axis=0, weights=near.importance) for side in (near.wo, near.wi))
    others = np.stack([np.concatenate([wo, wi]), [0.9, 0.1, 0.4, -0.9, 0.1, 0.4]]).astype(np.float32)
    sides = [side / np.linalg.norm(side, axis=1, keepdims=True) for side in (others[:, :3], others[:, 3:])]
    assert shares_of_others(far, near, *sides).tolist() == [1.0, 0.0]
    assert shares_of_others(far, near, *(side[1:] for side in sides)).tolist() == [0.0]


def test_outside_a_scene_an_exact_model_has_no_decibels():
    """JSON has no infinity."""
    btf = tiny_btf(8, 3, 3)
    slices = torch.from_numpy(np.stack([btf[pair] for pair in range(len(btf))]))
    pairs = np.concatenate([btf.wo, btf.wi], 1).tolist()
    exact = SimpleNamespace(slice=lambda wo, wi, size: slices[pairs.index(wo + wi)])
    shares = np.zeros(len(btf))
    scorer = SimpleNamespace(btf=btf, shares=shares)
    assert psnr_outside(scorer, exact) is None
    slices += 0.1
    assert psnr_outside(scorer, exact) > 0
    assert psnr_outside(SimpleNamespace(btf=btf, shares=shares + 1), exact) is None
