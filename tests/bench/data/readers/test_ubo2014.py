import struct

import numpy as np
import pytest
from ubo2014_write import write_ubo2014

from bench.data.readers import open_btf, ubo2014
from bench.directions.hemisphere import from_angles
from bench.inputs.errors import InputError

VIEWS = np.radians([[0.0, 0.0], [15.0, 60.0], [75.0, -90.0]])
LIGHTS = np.radians([[11.0, 15.0], [30.0, 120.0]])
SHAPE = (4, 5)


def factors(rng, fmf=False, rank=3):
    rows, matrices = (3 * 6, 1) if fmf else (6, 3)
    made = []
    for _ in range(matrices):
        u = rng.standard_normal((rows, rank)) * 0.5
        sv = rng.standard_normal((20, rank)) * 0.5
        made.append((u, sv))
    return made


def decoded(model, given, fmf, dtype):
    """The pictures (6, H, W, 3) by the definition, in double precision."""
    channels = [(u.astype(dtype).astype(float) @ sv.astype(dtype).astype(float).T) for u, sv in given]
    c = channels[0].reshape(6, 3, 20).swapaxes(0, 1) if fmf else np.stack(channels)
    if model == 12:
        c = np.exp(c) - 1e-5
    if model == 11:
        y = np.exp(c[0]) - 1e-5
        u, v = c[1] * y + 1e-5, c[2] * y + 1e-5
        c = np.stack([y + 1.13983 * v, y - 0.39465 * u - 0.58060 * v, y + 2.03211 * u])
    return np.moveaxis(c, 0, -1).reshape(6, *SHAPE, 3)[:, ::-1]


MADE = ("tiny_rgb", "tiny_yuvlog", "tiny_fmf")


@pytest.mark.parametrize("name", MADE)
def test_tiny_files_decode_as_expected(data, name):
    folder = data / "tiny_formats"
    with np.load(folder / "expected.npz", allow_pickle=False) as stored:
        expected, views, lights = (stored[name + part] for part in ("", "_views", "_lights"))
    btf = open_btf(folder / f"{name}.btf")
    shape = expected.shape
    flat = expected.reshape(-1, *shape[2:])
    assert np.abs(np.stack([*btf]) - flat).max() <= 1e-6
    rows, cols = np.mgrid[: shape[2], : shape[3]].reshape(2, -1)
    assert np.abs(btf.texels(rows, cols) - flat.transpose(1, 2, 0, 3).reshape(len(rows), -1, 3)).max() <= 1e-6
    pair = np.arange(len(rows)) % len(btf)
    assert np.abs(btf.gather(pair, rows, cols) - flat[pair, rows, cols]).max() <= 1e-6
    np.testing.assert_array_equal(btf.wo[:: shape[1]], from_angles(*views.T))
    np.testing.assert_array_equal(btf.wi[: shape[1]], from_angles(*lights.T))
    if name != "tiny_rgb":
        assert max(s.max() for s in btf) > 3  # highlights survive


@pytest.mark.parametrize("version", [1, 2, 3, 4])
@pytest.mark.parametrize(("scalar", "dtype"), [(2, np.float16), (4, np.float32), (8, np.float64)])
@pytest.mark.parametrize(("model", "fmf"), [(0, False), (11, False), (12, False), (0, True), (12, True)])
def test_every_colour_model_scalar_and_version(tmp_path, version, scalar, dtype, model, fmf):
    given = factors(np.random.default_rng(model), fmf)
    path, more = tmp_path / "a.btf", {"version": version, "rotations": 2, "xml": "<setup/>"}
    write_ubo2014(path, VIEWS, LIGHTS, SHAPE, given, colour_model=model, scalar=scalar, **more)
    btf = open_btf(path)
    expected = decoded(model, given, fmf, dtype)
    np.testing.assert_allclose([*btf], expected, rtol=2e-5, atol=2e-6)
    np.testing.assert_allclose(btf.texels([1], [3])[0], expected[:, 1, 3], rtol=2e-5, atol=2e-6)
    np.testing.assert_allclose(btf.gather([4], [2], [0])[0], expected[4, 2, 0], rtol=2e-5, atol=2e-6)
    assert btf.provenance["native"] == {"bytes": path.stat().st_size, "rank": 3, "ranks": [3, 3, 3]}
    assert btf.provenance["rotations"] == 2
    assert btf.provenance["ppmm"] == 10.0
    assert btf.provenance.get("xml") == ("<setup/>" if version > 2 else None)


def changed(path, offset, data):
    raw = bytearray(path.read_bytes())
    raw[offset : offset + len(data)] = data
    path.write_bytes(raw)


HEAD = 10
DIRECTIONS = HEAD + 8 + 240 + 16 + 4 + 4 + 4 + 3 * 5
SIZE = DIRECTIONS + 4 + 3 * (12 + 16)
BODY = SIZE + 12


@pytest.mark.parametrize(
    ("offset", "data", "message"),
    [
        (0, b"!PVF06FCRx", "!PVF06FC .*known"),
        (0, b"!NEWFORMAT", "b'!NEWFORMAT'"),
        (HEAD, struct.pack("<I", 7), "header.* 7 bytes.* 291"),
        (HEAD + 4, struct.pack("<I", 5), "header version 5: .*4"),
        (DIRECTIONS - 19, struct.pack("<I", 4), "4 channels"),
        (DIRECTIONS, struct.pack("<I", 0xFFFFFFFF), "4294967295 views.* 120259084260 bytes"),
        (DIRECTIONS, struct.pack("<I", 0), "0 views"),
        (DIRECTIONS + 4, struct.pack("<f", 2.0), r"view 0: .*114\.592.*90"),
        (DIRECTIONS + 4, struct.pack("<2f", *VIEWS[1]), "view 1: .*view 0"),
        (DIRECTIONS + 4 + 28 + 12, b"\0", "lights of view 1 .*view 0"),
        (SIZE, struct.pack("<I", 0xFFFFFFFF), "channel 0: 6 x 20 .*6 x 17179869180"),
        (SIZE + 8, struct.pack("<I", 0xFFFFFFFF), "4294967295 rotations.* 154618822620 bytes"),
        (BODY + 4, struct.pack("<i", 7), "model 7: .*0, 11, 12"),
        (BODY + 56, b"\3", "channel 0: rank 3 .*3 bytes"),
        (BODY + 57, struct.pack("<I", 0), "channel 0: rank 0"),
        (BODY + 57, struct.pack("<I", 0x7FFFFFFF), "channel 0: S .*4294967294"),
    ],
)
def test_damaged_headers_name_file_and_offset(refused, tmp_path, offset, data, message):
    path = tmp_path / "a.btf"
    write_ubo2014(path, VIEWS, LIGHTS, SHAPE, factors(np.random.default_rng(0)))
    changed(path, offset, data)
    refused(path, message)


def test_truncated_files_say_so(refused, tmp_path):
    path = tmp_path / "a.btf"
    write_ubo2014(path, VIEWS, LIGHTS, SHAPE, factors(np.random.default_rng(0)))
    whole = path.read_bytes()
    for length in range(1, len(whole), 7):
        path.write_bytes(whole[:length])
        with pytest.raises(InputError):
            open_btf(path)
    path.write_bytes(whole[:-1])
    refused(path, r"offset \d+: channel 2: .*truncated")


def test_values_that_overflow_are_named_when_read(tmp_path):
    write_ubo2014(tmp_path / "a.btf", VIEWS, LIGHTS, SHAPE, [(np.full((6, 1), 200), np.ones((20, 1)))] * 3)
    btf = open_btf(tmp_path / "a.btf")
    for reading in (lambda: btf[4], lambda: btf.texels([0], [0]), lambda: btf.gather([0], [0], [0])):
        with pytest.raises(InputError, match="not finite"):
            reading()
    given = factors(np.random.default_rng(1))
    given[0][0][4] = 1e4  # log luminance of the fifth pair
    write_ubo2014(tmp_path / "a.btf", VIEWS, LIGHTS, SHAPE, given, scalar=4)
    with pytest.raises(InputError, match="pair 4"):  # though others are read with it
        list(open_btf(tmp_path / "a.btf"))


@pytest.mark.parametrize("dense", [1 << 30, 0])
def test_slices_that_are_multiplied_together_are_those_read_one_by_one(tmp_path, monkeypatch, dense):
    monkeypatch.setattr(ubo2014, "MULTIPLIED", 24 * 20 * 4)  # four of the six pairs
    monkeypatch.setattr(ubo2014, "DENSE_BYTES", dense)
    given = factors(np.random.default_rng(1))
    write_ubo2014(tmp_path / "a.btf", VIEWS, LIGHTS, SHAPE, given, scalar=4)
    btf = open_btf(tmp_path / "a.btf")
    assert btf.source.at_once == 4
    for each, level in ((btf, 1), (btf.downsample(2), 2), (btf.crop(1, 1, 3, 4), 0)):
        one_by_one = np.stack([each[i] for i in range(len(each))])  # float32: terms of about 1 add up to about 0
        np.testing.assert_allclose(np.stack(list(each)), one_by_one, rtol=1e-5, atol=1e-6, err_msg=str(level))
    expected = decoded(11, given, False, np.float32)
    assert any(matrix.is_kept for matrix in btf.source.factors.texels) == (dense > 0)
    np.testing.assert_allclose(np.stack(list(btf)), expected, rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(btf.texels([0, 3], [4, 1])[1], expected[:, 3, 1], rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(btf.gather([5], [0], [4])[0], expected[5, 0, 4], rtol=1e-4, atol=1e-5)
