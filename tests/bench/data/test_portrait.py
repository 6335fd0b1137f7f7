import re
from itertools import combinations

import numpy as np
import pytest
from PIL import Image

from bench import cli
from bench.btf import BTF, ArraySource
from bench.conformance.check import tiny_btf
from bench.data import portrait
from bench.data.convert import write_btf
from bench.data.described import btf_fields
from bench.data.materials import load
from bench.data.portrait import _draw_directions as draw_directions
from bench.data.portrait import draw, look
from bench.data.readers import open_btf
from bench.directions.hemisphere import from_angles, uniform
from bench.metrics.display import decode_srgb


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
    none_held_out = BTF("x", btf.wo, btf.wi, btf.source, heldout=np.zeros(81, bool), periodic=True)
    assert look(none_held_out).exposed.code > 40  # of all pairs


@pytest.mark.long
def test_a_strip_of_texels_has_a_portrait(btf, tmp_path):
    strip = like(btf, np.random.default_rng(0).uniform(0.1, 1, (len(btf), 1, 600, 3)))
    draw(look(strip), tmp_path / "strip.png")
    assert next(iter(look(strip).sheet.values())).shape == (1, 600, 3)


@pytest.mark.long
def test_a_users_settings_of_matplotlib_do_not_reach_a_portrait(btf, tmp_path, users_settings):
    draw(look(btf), tmp_path / "plain.png")
    with users_settings():
        draw(look(btf), tmp_path / "again.png")
    assert (tmp_path / "again.png").read_bytes() == (tmp_path / "plain.png").read_bytes()


@pytest.mark.long
def test_no_two_numbers_of_a_polar_plot_overlap(btf, tmp_path, monkeypatch):
    drawn = []
    monkeypatch.setattr(portrait, "_draw_directions", lambda *args: (drawn.append(args[0]), draw_directions(*args)))
    draw(look(btf), tmp_path / "look.png")
    for axes in drawn:
        labels = [text for text in axes.get_yticklabels() + axes.get_xticklabels() if text.get_text()]
        boxes = [text.get_window_extent() for text in labels]
        assert not [pair for pair in combinations(boxes, 2) if pair[0].overlaps(pair[1])]


def test_a_missing_cosine_is_suspected(btf):
    uneven = np.random.default_rng(0).uniform(0.9, 1, (len(btf), 1, 1, 1))
    matt = uneven * btf[0]
    (warning,) = look(like(btf, matt)).warnings()
    assert "cosine" in warning
    assert look(like(btf, matt * btf.wi[:, 2, None, None, None])).power == pytest.approx(1, abs=0.1)


@pytest.mark.long
def test_a_few_mirrors_that_make_all_else_black_are_warned_of(btf, tmp_path, caplog):
    values = np.stack(list(btf))
    assert not any("black scores" in warning for warning in look(btf).warnings())
    mirrors = values.copy()
    mirrors[::5] *= 1e4
    owned = like(btf, mirrors)
    assert any("black scores" in warning for warning in look(owned).warnings())
    write_btf(owned, tmp_path / "owned.npz")
    words = ["run", "quick", "--material", str(tmp_path / "owned.npz"), "--codec", "mean-colour"]
    assert cli.main([*words, "--out", str(tmp_path / "run")]) == 0
    assert [record.name for record in caplog.records if "black scores" in record.message] == ["bench.runs.workbench"]


@pytest.mark.parametrize("gloss", [0, 2])
def test_swapped_views_and_lights_are_told_from_a_missing_cosine(btf, gloss):
    cos_o, cos_i = (side[:, 2, None, None, None] for side in (btf.wo, btf.wi))
    brdf = np.random.default_rng(0).uniform(0.9, 1, (len(btf), 16, 16, 3)) * (cos_o * cos_i) ** gloss  # reciprocal
    assert look(like(btf, brdf * cos_i)).warnings() == []
    (warning,) = look(like(btf, brdf * cos_o)).warnings()
    assert "swapped" in warning
    assert "cosine" not in warning


def test_theta_from_the_horizon_is_told_from_a_swap(btf):
    cos_o, cos_i = (side[:, 2, None, None, None] for side in (btf.wo, btf.wi))
    uneven = np.random.default_rng(0).uniform(0.9, 1, (len(btf), 16, 16, 3))
    true_cos_i = np.sqrt(1 - cos_i**2) + 0.05
    for one in (btf, btf.subset(btf.layout.grid[0])):
        pairs = np.arange(len(one))
        (warning,) = look(like(one, (uneven * true_cos_i)[pairs])).warnings()
        assert "horizon" in warning
        assert "swapped" not in warning
    (warning,) = look(like(btf, uneven * cos_o**0.9 / cos_i**0.1)).warnings()
    assert "swapped" in warning


CHANGES = {
    "as given": lambda wi: wi,
    "the light's y mirrored": lambda wi: wi * [1, -1, 1],
    "the light's x mirrored": lambda wi: wi * [-1, 1, 1],
    "the light's x and y exchanged": lambda wi: wi[:, [1, 0, 2]],
}


def scattered(change=lambda wi: wi, count=150, gloss=8):
    """A BTF of scattered pairs of a glossy lobe, whose lights are then told in another frame."""
    rng = np.random.default_rng(3)
    wo, wi = uniform(rng, count), uniform(rng, count)
    half = wo + wi
    cos_h = half[:, 2] / np.linalg.norm(half, axis=1)
    radiance = (0.2 + cos_h**gloss) * wi[:, 2]
    values = radiance[:, None, None, None] * rng.uniform(0.9, 1, (count, 6, 6, 3))
    return BTF("x", wo, change(wi).astype(np.float32), ArraySource(values.astype(np.float32)))


@pytest.mark.parametrize("frame", CHANGES)
def test_the_frame_of_scattered_pairs_is_checked_by_half_vectors(frame):
    seen = look(scattered(CHANGES[frame]))
    assert seen.lobe is None
    assert seen.half_vectors.likely == frame
    warnings = [warning for warning in seen.warnings() if "mirrored" in warning]
    assert len(warnings) == (frame != "as given")


def test_a_matt_surface_or_few_pairs_tell_nothing_of_the_frame():
    assert look(scattered(CHANGES["the light's y mirrored"], gloss=0)).half_vectors.likely == "as given"
    assert look(scattered(count=30)).half_vectors is None


def test_the_exponents_of_scattered_pairs_are_found():
    btf = scattered(gloss=0)
    seen = look(btf)
    assert seen.power == pytest.approx(1, abs=0.1)
    assert seen.power_o == pytest.approx(0, abs=0.1)
    swapped = look(BTF("x", btf.wi, btf.wo, btf.source))
    assert any("swapped" in warning for warning in swapped.warnings())


def test_extremes_are_of_all_slices_or_the_reader_is_told(btf, monkeypatch, tmp_path, capsys):
    values = np.tile(values_of(btf), (5, 1, 1, 1))[:400]
    values[397, 3, 5, 1] = 60.1
    rng = np.random.default_rng(0)
    many = BTF("x", uniform(rng, 400), uniform(rng, 400), ArraySource(values))
    assert look(many).extremes[1] == pytest.approx(60.1)
    assert look(many).read == 400
    monkeypatch.setattr(portrait, "SMALL", 100)
    seen = look(many)
    assert seen.read < 400
    monkeypatch.undo()
    values[396, 0, 0, 0] = np.nan
    np.savez(tmp_path / "a.npz", radiance=values, wo=many.wo, wi=many.wi)
    assert cli.main(["info", str(tmp_path / "a.npz")]) == 2
    assert "radiance[396]" in capsys.readouterr().err


@pytest.mark.parametrize("top", [1, 255])
def test_values_that_are_codes_are_named(btf, top):
    values = values_of(btf)
    codes = np.round(values / values.max() * 255)
    assert any("sRGB" in warning for warning in look(like(btf, codes / 255 * top)).warnings())
    linear = decode_srgb(codes / 255)
    assert not any("sRGB" in warning for warning in look(like(btf, linear)).warnings())


def test_with_one_view_a_missing_cosine_and_a_swap_are_both_named(btf):
    one = btf.subset(btf.layout.grid[0])
    (warning,) = look(like(one, 1 + np.zeros((9, 16, 16, 3)))).warnings()
    assert "cosine" in warning
    assert "swapped" in warning


def test_clipped_highlights_are_counted(btf):
    values = values_of(btf)
    limit = np.percentile(values, 95)
    (warning,) = look(like(btf, np.minimum(values, limit))).warnings()
    assert f"{limit:.4g}: highlights" in warning
    assert look(like(btf, 0 * values + 0.5)).clipped == 0
    # Of flat tiles a bright one is bright as a whole.
    tiles = np.where(np.arange(btf.shape[1]) < btf.shape[1] // 2, 1.0, 0.2)[None, None, :, None]
    assert look(like(btf, values.mean((1, 2), keepdims=True) * tiles)).clipped == 0


def test_negative_values_are_counted(btf):
    values = values_of(btf)
    values[:, 0, 0] = -0.5
    assert re.search(r"negative.*-0\.5", look(like(btf, values)).warnings()[0])
    values[:, 0, 0] = -1e-6
    assert not any("negative" in warning for warning in look(like(btf, values)).warnings())


def test_missing_pairs_of_a_product_are_counted(btf):
    (warning,) = look(btf.subset(range(78))).warnings()
    assert re.search("3 pairs.*missing", warning)
    scattered = btf.subset(range(0, 81, 10))  # the diagonal: no product was meant
    assert not any("missing" in warning for warning in look(scattered).warnings())


@pytest.mark.parametrize(("axis", "border"), [(1, "top–bottom"), (2, "left–right")])
def test_a_seam_is_named_with_its_border(btf, axis, border):
    values = values_of(btf) * np.linspace(0.2, 1, 16).reshape([16 if a == axis else 1 for a in range(4)])
    (warning,) = look(like(btf, values, periodic=True)).warnings()
    assert re.search(f"seam.*{border}.*periodic", warning)


@pytest.mark.long
def test_info_repairs_and_takes_the_unit_of_angles_as_its_errors_suggest(tmp_path, btf, capsys):
    values = values_of(btf)
    values[0, 0, 0, 0] = np.nan
    np.savez(tmp_path / "a.npz", radiance=values, wo=btf.wo, wi=btf.wi)
    assert cli.main(["info", str(tmp_path / "a.npz")]) == 2
    assert "--repair" in capsys.readouterr().err
    assert cli.main(["info", str(tmp_path / "a.npz"), "--repair"]) == 0
    assert "repaired: 1" in capsys.readouterr().out
    angles = {"theta_deg": np.array([0.0, 1.5]), "phi_deg": np.array([0.0, 6.0])}
    np.savez(tmp_path / "b.npz", rgb_geomean=np.ones((2, 2, 3), np.float32), **angles)
    assert cli.main(["info", str(tmp_path / "b.npz")]) == 2
    assert "--radians or --degrees" in capsys.readouterr().err
    for unit in ("radians", "degrees"):
        assert cli.main(["info", str(tmp_path / "b.npz"), f"--{unit}"]) == 0
        assert f"taken as {unit}" in capsys.readouterr().out
    converted = str(tmp_path / "c.npz")
    assert cli.main(["convert", str(tmp_path / "b.npz"), "--radians", "-o", converted]) == 0
    np.testing.assert_allclose(open_btf(converted).wi[1], from_angles(1.5, 6.0), atol=1e-6)
    encode = ["encode", str(tmp_path / "b.npz"), "--codec", "mean-colour", "-o", str(tmp_path / "b.nbtf")]
    assert cli.main(encode) == 2
    assert cli.main([*encode, "--degrees"]) == cli.main([*encode, "--set", "data.angles=degrees"]) == 0
    assert cli.main([*encode, "--set", "data.angles=both"]) == 2
    score = ["score", str(tmp_path / "b.nbtf"), str(tmp_path / "b.npz")]
    assert cli.main(score) == 2
    capsys.readouterr()
    assert cli.main([*score, "--degrees"]) == 0
    radians = ["score", str(tmp_path / "b.nbtf"), str(tmp_path / "b.npz"), "--radians"]
    assert cli.main(radians) == 0
    assert "PSNR" in capsys.readouterr().out
    run = [
        "run",
        "quick",
        "--material",
        str(tmp_path / "b.npz"),
        "--codec",
        "mean-colour",
        "--out",
        str(tmp_path / "r"),
    ]
    assert cli.main(run) == 2
    assert cli.main([*run, "--radians"]) == 0


def test_info_counts_pairs_of_low_light_and_looks_at_none_of_them(tmp_path, monkeypatch):
    monkeypatch.setenv("NEUBTF_CACHE", str(tmp_path))
    small = {"size": 8, "views": 9, "lights": 9, "heldout": 4}
    plain, low = (btf_fields(look(load("satin", **small, low_light=count))) for count in (0, 5))
    assert low["low_light"]["pairs"] == low["low_light"]["lights"] == 5
    assert plain["low_light"] == {"pairs": 0}
    assert low | {"low_light": plain["low_light"]} == plain


def test_info_warns_and_draws(tmp_path, btf, capsys):
    write_btf(like(btf, np.minimum(values_of(btf), 0.1)), tmp_path / "a.npz")
    assert cli.main(["info", str(tmp_path / "a.npz"), "--picture", str(tmp_path / "a.png")]) == 0
    assert "warnings:\n  " in capsys.readouterr().out
    draw(look(tiny_btf(6, 1, 9)), tmp_path / "b.png")  # of one view
    for name in ("a.png", "b.png"):
        with Image.open(tmp_path / name) as picture:
            assert picture.size[0] == 1200
            assert np.asarray(picture).std() > 10
    assert cli.main(["info", str(tmp_path / "a.npz"), "--picture", str(tmp_path / "a.npz" / "a.png")]) == 2
    assert f"{tmp_path / 'a.npz'}: " in capsys.readouterr().err


def test_a_material_of_one_view_is_said_to_be_one():
    line = "one view: a codec's answers from other views are not measured"
    assert line in btf_fields(look(tiny_btf(6, 1, 9)))["notes"]
    assert line not in btf_fields(look(tiny_btf(6, 3, 9)))["notes"]
