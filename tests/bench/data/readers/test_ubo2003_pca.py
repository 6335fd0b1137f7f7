import json
import shutil

import numpy as np
import pytest
from PIL import Image
from ubo2003_pca_write import random_codes, save, write_ubo2003_pca

from bench.data.readers import open_btf
from bench.data.readers.ubo2003_pca import PIXELS
from bench.directions.hemisphere import to_degrees, ubo2003
from bench.inputs.errors import InputError
from bench.metrics.display import decode_srgb

MEASURED = ["corduroy", "impalla", "wool"]
SIZE = 4


@pytest.fixture(scope="module")
def clone(tmp_path_factory):
    """A folder as a clone has it, and the sRGB codes (views, lights, row, column, colour) by the definition."""
    given = random_codes(SIZE)
    folder = write_ubo2003_pca(tmp_path_factory.mktemp("clone") / "felt" / "3_8", *given)
    components, weights = (x.astype(float) / 255 * 2 - 1 for x in given[:2])
    singular = given[2][..., 0] * 10.0 + given[2][..., 1] * 0.1
    codes = np.einsum("bhwj,bj,bvlcj->bvlhwc", components, singular, weights, optimize=True)
    return folder, codes.reshape(81, 81, SIZE, SIZE, 3)


@pytest.fixture
def copy(clone, tmp_path):
    return shutil.copytree(clone[0], tmp_path / "felt")


def test_slices_and_scattered_reads_are_the_sums_of_the_codes(clone, tmp_path, monkeypatch):
    monkeypatch.setenv("NEUBTF_CACHE", str(tmp_path))
    btf = open_btf(clone[0])
    assert not {"components", "weights"} & set(vars(btf.source))  # opening decodes no picture
    codes = clone[1].reshape(-1, SIZE, SIZE, 3)
    assert codes.min() < 0 < 1 < codes.max()  # what is clipped is there
    expected = decode_srgb(np.clip(codes, 0, 1))
    rng = np.random.default_rng(0)
    pair, row, col = rng.integers(0, [[6561], [SIZE], [SIZE]], (3, 500))
    for each in pair[:50]:
        np.testing.assert_allclose(btf.source.codes(each), codes[each], atol=1e-5)
        np.testing.assert_allclose(btf[each], expected[each], atol=2e-5)
    np.testing.assert_allclose(btf.gather(pair, row, col), expected[pair, row, col], atol=2e-5)
    np.testing.assert_allclose(btf.texels(row[:5], col[:5]).swapaxes(0, 1), expected[:, row[:5], col[:5]], atol=2e-5)
    some = btf.subset([6000, 3, 200])
    np.testing.assert_allclose(some.texels([1], [2])[0], expected[[6000, 3, 200], 1, 2], atol=2e-5)
    assert not list(tmp_path.iterdir())  # nothing is unpacked


def test_views_and_lights_are_those_of_ubo2003_in_its_order(clone):
    btf = open_btf(clone[0])
    assert (btf.shape, len(btf), btf.periodic) == ((SIZE, SIZE), 6561, False)
    np.testing.assert_array_equal(btf.wo.reshape(81, 81, 3)[:, 0], ubo2003())
    np.testing.assert_array_equal(btf.wi[:81], ubo2003())
    theta, phi = to_degrees(btf.wo[81 * 7])
    assert (round(float(theta)), round(float(phi))) == (30, 0)
    assert btf.provenance["source"].startswith("measured")
    assert btf.provenance["native"]["bytes"] == sum(p.stat().st_size for p in clone[0].glob("*.png"))
    assert btf.provenance["native"]["rank"] == 8


def test_a_material_has_one_name_and_fingerprint_wherever_it_lies(clone, copy):
    places = [clone[0], clone[0].parent, clone[0] / "meta.json", copy, copy / "meta.json"]
    btfs = [open_btf(place) for place in places]
    assert {btf.name for btf in btfs} == {"felt"}
    assert len({btf.fingerprint for btf in btfs}) == 1
    codes = random_codes(SIZE, seed=1)
    other = open_btf(write_ubo2003_pca(copy, *codes))
    assert other.fingerprint != btfs[0].fingerprint


@pytest.mark.parametrize("name", MEASURED)
def test_measured_materials_decode_as_expected(data, name):
    folder = data / "ubo2003_local_pca"
    btf = open_btf(folder / name)
    assert (btf.name, btf.shape, len(btf)) == (name, (256, 256), 6561)
    for known in json.loads((folder / "expected.json").read_text())[name]:
        pair = known["view"] * 81 + known["light"]
        codes = btf.source.codes(pair)
        np.testing.assert_allclose(codes.mean((0, 1)), known["mean_code"], atol=1e-5)  # five decimals are given
        for place, value in known.items():
            if place.startswith("row_"):
                row, col = map(int, place.split("_")[1::2])
                np.testing.assert_allclose(codes[row, col], value, atol=1e-5)
                linear = decode_srgb(np.clip(value, 0, 1))
                np.testing.assert_allclose(btf.gather([pair], [row], [col])[0], linear, atol=5e-5)


@pytest.mark.parametrize(
    ("notes", "message"),
    [
        ({"blockSize": "9"}, "blockSize"),
        ({"numComp": "4"}, "numComp"),
        ({"numDirections": 151}, "numDirections"),
        ({"imageSize": "1" * 3000}, "imageSize"),
        ({"imageSize": "-4"}, "imageSize"),
        (b"[" * 60000, "cannot be read"),
        (b"[8]", "object"),
        (b'{"numComp": "' + b"8" * (1 << 16) + b'"}', "64 KiB"),
        (b"\xff\xfe\x00", "cannot be read"),
    ],
    ids=range(9),
)
def test_notes_that_lie_or_are_damaged_are_named_with_their_field(refused, copy, notes, message):
    if isinstance(notes, dict):
        notes = json.dumps(json.loads((copy / "meta.json").read_text()) | notes).encode()
    (copy / "meta.json").write_bytes(notes)
    refused(copy, rf"felt/meta\.json: .*{message}")


def test_other_numbered_pictures_with_a_meta_json_are_not_taken_for_this_format(refused, tmp_path):
    (tmp_path / "meta.json").write_text('{"author": "me"}')
    Image.new("RGBA", (4, 4)).save(tmp_path / "0.png")
    refused(tmp_path, r"pairs\.csv")


def test_pictures_of_another_kind_are_refused(refused, copy):
    Image.new("RGB", (4, 27)).save(copy / "3.png")
    refused(copy, r"3\.png: .*alpha")
    (copy / "3.png").write_bytes(b"GIF89a")
    refused(copy, r"3\.png: .*b'GIF89a'")
    (copy / "3.png").unlink()
    refused(copy, r"felt/3\.png: .*missing")
    shutil.copy(copy / "2.png", copy / "3.png")
    notes = (copy / "meta.json").read_text()
    (copy / "meta.json").write_text(json.dumps(json.loads(notes) | {"imageSize": "8"}))
    refused(copy, r"felt/0\.png: .*imageSize")
    (copy / "meta.json").write_text(notes)
    save(copy / "R.png", np.zeros((10, 40), np.uint8))
    refused(copy, rf"R\.png: .*{PIXELS}")


@pytest.mark.parametrize("name", ["7.png", "R.png"])
def test_bytes_that_are_cut_off_or_changed_are_an_error_when_read(copy, name):
    whole = (copy / name).read_bytes()
    altered = bytearray(whole)
    altered[len(whole) // 2] ^= 1
    for damaged in (whole[:40], whole[: len(whole) // 2], whole[:-20], whole[:-1], altered):
        (copy / name).write_bytes(damaged)
        with pytest.raises(InputError, match=rf"felt/{name}: "):
            open_btf(copy)[0]
