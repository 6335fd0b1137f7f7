import numpy as np
import pytest
from PIL import Image

from bench import cli
from bench.btf import BTF, ArraySource
from bench.cli.console import btf_lines
from bench.conformance.check import tiny_btf
from bench.data.convert import write_btf
from bench.data.portrait import draw, look


def values_of(btf):
    return np.stack(list(btf))


def like(btf, values, periodic=False):
    return BTF("x", btf.wo, btf.wi, ArraySource(values.astype(np.float32)), periodic=periodic)


@pytest.fixture
def btf():
    return tiny_btf(16, 9, 9)


def test_nothing_is_wrong_with_a_sound_btf_and_held_out_pairs_are_not_missing(btf):
    split = BTF("x", btf.wo, btf.wi, btf.source, heldout=np.arange(81) >= 72, periodic=True)
    assert look(btf).warnings() == look(split).warnings() == []


def test_a_missing_cosine_is_suspected(btf):
    uneven = np.random.default_rng(0).uniform(0.9, 1, (len(btf), 1, 1, 1))
    matt = uneven * btf[0]
    (warning,) = look(like(btf, matt)).warnings()
    assert "cosine seems to be missing" in warning
    assert look(like(btf, matt * btf.wi[:, 2, None, None, None])).power == pytest.approx(1, abs=0.1)


def test_clipped_highlights_are_counted(btf):
    values = values_of(btf)
    limit = np.percentile(values, 95)
    (warning,) = look(like(btf, np.minimum(values, limit))).warnings()
    assert f"exactly at the maximum, {limit:.4g}: highlights are clipped" in warning
    assert look(like(btf, 0 * values + 0.5)).clipped == 0
    tiles = np.where(np.arange(btf.shape[1]) < btf.shape[1] // 2, 1.0, 0.2)[None, None, :, None]
    assert look(like(btf, values.mean((1, 2), keepdims=True) * tiles)).clipped == 0, "a flat tile is bright as a whole"


def test_negative_values_are_counted(btf):
    values = values_of(btf)
    values[:, 0, 0] = -0.5
    assert "of the values are negative, the least -0.5" in look(like(btf, values)).warnings()[0]
    values[:, 0, 0] = -1e-6
    assert not any("negative" in warning for warning in look(like(btf, values)).warnings())


def test_missing_pairs_of_a_product_are_counted(btf):
    (warning,) = look(btf.subset(range(78))).warnings()
    assert warning == "3 pairs of the product of 9 views × 9 lights are missing"
    scattered = btf.subset(range(0, 81, 10))  # the diagonal: no product was meant
    assert not any("missing of" in warning for warning in look(scattered).warnings())


@pytest.mark.parametrize(("axis", "border"), [(1, "top–bottom"), (2, "left–right")])
def test_a_seam_is_named_with_its_border(btf, axis, border):
    values = values_of(btf) * np.linspace(0.2, 1, 16).reshape([16 if a == axis else 1 for a in range(4)])
    (warning,) = look(like(btf, values, periodic=True)).warnings()
    assert f"a seam at the {border} border" in warning
    assert "although the data call it periodic" in warning


def test_info_warns_and_draws(tmp_path, btf, capsys):
    write_btf(like(btf, np.minimum(values_of(btf), 0.1)), tmp_path / "a.npz")
    assert cli.main(["info", str(tmp_path / "a.npz"), "--picture", str(tmp_path / "a.png")]) == 0
    assert "warning: " in capsys.readouterr().out
    draw(look(tiny_btf(6, 1, 9)), tmp_path / "b.png")  # of one view
    for name in ("a.png", "b.png"):
        with Image.open(tmp_path / name) as picture:
            assert picture.size[0] == 1200
            assert np.asarray(picture).std() > 10
    assert cli.main(["info", str(tmp_path / "a.npz"), "--picture", str(tmp_path / "no" / "a.png")]) == 2
    assert "cannot be written" in capsys.readouterr().err


def test_a_material_of_one_view_is_said_to_be_one():
    line = "one view: a codec's answers from other views are not measured"
    assert line in btf_lines(look(tiny_btf(6, 1, 9))).splitlines()
    assert line not in btf_lines(look(tiny_btf(6, 3, 9)))
