import lzma

import fuzz_codec_files
import numpy as np
import pytest
import torch

from baselines.relief.geometry import Surface
from bench.btf import Layout
from bench.cli.console import file_fields
from bench.codec import Fit, Parts
from bench.codecs import container, loading
from bench.codecs.registry import load_codec
from bench.conformance.check import tiny_btf
from bench.directions import interpolation as directions
from bench.inputs.errors import ContainerError
from bench.training import texture_codes as coding

SCENE = fuzz_codec_files.SCENE | {"name": "table", "size": [8, 8], "window": [0, 0, 2, 2]}
NETWORKS = ["neubtf-direct", "relief", "zeltner2024", "ntc"]


def scene_file(tmp_path, **changes):
    parts = Parts(texture={"mean": torch.ones(2, 2, 3)}, scene=SCENE | changes)
    return tmp_path / "a.nbtf", load_codec("mean-colour")(), parts


@pytest.mark.parametrize("field", SCENE)
@pytest.mark.parametrize("value", [None, -1, [], {}, [[]], [1, 2.5], 1e308])
def test_no_field_of_a_scene_is_trusted(field, value, tmp_path):
    path, codec, parts = scene_file(tmp_path)
    container.save(path, codec, parts)
    fuzz_codec_files.resealed(path, lambda metadata, _: metadata["scene"].update({field: value}))
    with pytest.raises(ContainerError, match=rf"a\.nbtf: .*scene/{field}"):
        container.read_header(path)


@pytest.mark.parametrize("size", [[10**9, 10**9], [20_000, 20_000], [1, 1 << 40]])
def test_a_scene_cannot_claim_a_picture_beyond_all_proportion(size, tmp_path):
    path, codec, parts = scene_file(tmp_path, size=size)
    with pytest.raises(ContainerError, match=r"a\.nbtf: .*picture.*\b12\b"):
        file_fields(container.save(path, codec, parts))


@pytest.mark.parametrize("name", NETWORKS)
def test_weights_are_counted_before_a_network_is_built(name, tmp_path, monkeypatch):
    codec = load_codec(name)(steps=1, batch=16)
    path = container.save(tmp_path / "a.nbtf", codec, codec.encode(tiny_btf(5, 3, 3), Fit(seed=1))).path
    fuzz_codec_files.resealed(path, lambda metadata, _: metadata["settings"].update(layers=64, width=4096))
    monkeypatch.setattr(torch.nn, "Linear", None)  # no layer is made
    with pytest.raises(ContainerError, match=r"1,0\d\d,\d{3},\d{3} weights"):
        loading.load(path)


def test_codes_are_bounded_by_the_bytes_that_hold_them():
    payload = lzma.compress(bytes(1 << 20), lzma.FORMAT_RAW, filters=coding._coder(coding.PLAIN, 1 << 20))
    data = torch.tensor([coding.PLAIN, *[1] * 14, *payload], dtype=torch.uint8)
    with pytest.raises(ValueError, match="234881024 codes"):
        coding.expand(data, (4096, 4096, 14))


@pytest.mark.parametrize("shape", [(1, 1 << 16), (64, 64), (3000, 3000)])
def test_a_height_is_searched_in_bounded_memory(shape, monkeypatch):
    monkeypatch.setattr("baselines.relief.geometry.MOST_FINE", 1 << 20)
    surface = Surface(torch.linspace(-0.2, 0.2, shape[0] * shape[1]).reshape(shape))
    assert surface.padded.numel() <= max(1 << 20, shape[0] * shape[1])


def test_a_height_that_wraps_is_met_where_a_padded_one_is(monkeypatch):
    rng = np.random.default_rng(0)
    height = torch.from_numpy(0.05 * rng.random((48, 64))).float()
    uv, wo = (torch.from_numpy(rng.random((500, count))).float() for count in (2, 3))
    wo = torch.nn.functional.normalize(wo + 0.1, dim=1)
    padded = Surface(height)
    monkeypatch.setattr("baselines.relief.geometry.MOST_FINE", 256 * 256)
    wrapping = Surface(height)
    assert (padded.wraps, wrapping.wraps) == (False, True)
    torch.testing.assert_close(padded.meet(uv, wo), wrapping.meet(uv, wo))
    renewed = Surface(height.flip(0) * 2, renewable=True)
    memory = [buffer.data_ptr() for buffer in renewed.buffers()]
    renewed.renew(height)
    assert [buffer.data_ptr() for buffer in renewed.buffers()] == memory
    for ours, theirs in zip(renewed.meet(uv, wo), wrapping.meet(uv, wo), strict=True):
        assert ours.equal(theirs)
    z = torch.zeros(500, 1)
    assert renewed.excess(uv, z, wo).equal(wrapping.excess(uv, z, wo))


def hemisphere(rng, count, spread=1.0):
    points = rng.standard_normal((count, 3)) * [spread, spread, 1]
    points[:, 2] = np.abs(points[:, 2]) + 0.1
    return (points / np.linalg.norm(points, axis=1, keepdims=True)).astype(np.float32)


def test_directions_that_crowd_in_one_place_are_refused(monkeypatch):
    monkeypatch.setattr(directions, "MOST_CANDIDATES", 100)
    crowd = np.concatenate([hemisphere(np.random.default_rng(0), 3000, 0.02), np.eye(3, dtype=np.float32)])
    with pytest.raises(ValueError, match=r"triangles.* 100$"):
        directions.Hemisphere(crowd)


@pytest.mark.parametrize("kind", ["product", "scattered", "one view"])
def test_directions_are_found_in_blocks_as_at_once(kind, monkeypatch):
    rng = np.random.default_rng(0)
    views, lights = hemisphere(rng, 40), hemisphere(rng, 40)
    if kind != "scattered":
        views, lights = np.repeat(views if kind == "product" else views[:1], 40, 0), np.tile(lights, (len(views), 1))
    if kind == "one view":
        views, lights = views[:40], lights[:40]
    interpolator = directions.PairInterpolator(Layout.of(views, lights))
    queries = torch.from_numpy(hemisphere(rng, 500, 3)), torch.from_numpy(hemisphere(rng, 500, 3))
    once = interpolator(*queries)
    monkeypatch.setattr(directions, "BLOCK", 1000)
    blocks = interpolator(*queries)
    assert once.sample.equal(blocks.sample)
    torch.testing.assert_close(once.weight, blocks.weight)
