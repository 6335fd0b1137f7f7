import os
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import OpenEXR
import png
import pytest
from PIL import Image

from bench import cli
from bench.btf import box_filter
from bench.cli.console import fields_text
from bench.codec import silent
from bench.data.bake import bake, looks_like_maps, open_svbrdf, read_surface, recognise
from bench.data.bake.surface import SUB_POINTS
from bench.data.described import btf_fields
from bench.data.materials.renderer import render
from bench.data.open import open_material, open_named
from bench.data.portrait import look
from bench.data.readers import open_btf
from bench.data.spec import MaterialSpec, Preparation
from bench.inputs.errors import InputError
from bench.metrics.display import decode_srgb

pytestmark = pytest.mark.usefixtures("brief")
SMALL = Preparation(size=8, views=4, lights=4, heldout=3)


def save(folder, **maps):
    folder.mkdir(exist_ok=True)
    for name, picture in maps.items():
        Image.fromarray(np.round(np.asarray(picture) * 255).astype(np.uint8)).save(folder / f"{name}.png")
    return folder


def flat(value, size=16):
    return np.broadcast_to(np.float64(value), (size, size, *np.shape(value)))


def hills(size=64):
    """Height in [0, 1] and the GL normal codes of a smooth periodic relief 0.05 widths deep."""
    v, u = (1 - (np.arange(size) + 0.5) / size)[:, None], ((np.arange(size) + 0.5) / size)[None, :]
    height = 0.5 + 0.25 * np.sin(2 * np.pi * (u + 0.1)) + 0.25 * np.cos(4 * np.pi * (v - 0.2 * np.ones_like(u)))
    slope_u = 0.25 * 2 * np.pi * np.cos(2 * np.pi * (u + 0.1)) * np.ones_like(v)
    slope_v = -0.25 * 4 * np.pi * np.sin(4 * np.pi * (v - 0.2)) * np.ones_like(u)
    normal = np.stack([-0.05 * slope_u, -0.05 * slope_v, np.ones((size, size))], -1)
    return height, (normal / np.linalg.norm(normal, axis=-1, keepdims=True) + 1) / 2


def downwards(normal):
    return np.stack([normal[..., 0], 1 - normal[..., 1], normal[..., 2]], -1)


NAMES = {
    "albedo": "Bricks102_1K_Color.jpg rusty_metal_02_diff_1k.jpg rough_wood_col_1_1k.jpg Chair_baseColor.png",
    "displacement": "Bricks102_1K_Displacement.jpg rusty_metal_02_disp_1k.png lambert1_Height.png",
    "normal_gl": "Bricks102_1K_NormalGL.jpg rusty_metal_02_nor_gl_1k.exr lambert1_Normal_OpenGL.png",
    "normal_dx": "rough_wood_nor_dx_1k.jpg lambert1_Normal_DirectX.png",
    "normal": "Chair_normal.png",
    "roughness": "Bricks102_1K_Roughness.jpg rusty_metal_02_rough_1k.png",
    "metalness": "Bricks102_1K_Metalness.jpg lambert1_Metallic.png",
    "packed": "rusty_metal_02_arm_1k.jpg Chair_occlusionRoughnessMetallic.png Chair_metallicRoughness.png "
    "Avocado_roughnessMetallic.png Default_metalRoughness.png lantern_metallic_roughness.png T_Brick_ORM.png",
    "smoothness": "wall_glossiness.png Wall_Smoothness.tga Wall_gloss_2K.png",
    "metallic_smoothness": "Barrel_MetallicSmoothness.png",
    "anisotropy_angle": "lambert1_anisotropyangle.png",
}


@pytest.mark.parametrize(("name", "role"), [(name, role) for role in NAMES for name in NAMES[role].split()])
def test_the_usual_names_are_recognised(tmp_path, name, role):
    (tmp_path / name).touch()
    (tmp_path / "preview.png").touch()
    if role != "albedo":
        (tmp_path / f"{name.split('_')[0]}_albedo.png").touch()
    assert recognise(tmp_path).files[role] == name


@pytest.mark.parametrize("size", ["", "_2K", "_1024"])
def test_unreals_letters_are_recognised(tmp_path, size):
    letters = {"D": "albedo", "N": "normal", "R": "roughness", "M": "metalness", "H": "displacement"}
    for letter in letters:
        (tmp_path / f"T_Rock_{letter}{size}.png").touch()
    assert recognise(tmp_path).files == {role: f"T_Rock_{letter}{size}.png" for letter, role in letters.items()}
    assert looks_like_maps(tmp_path)
    for letter in "ABC":  # pictures that are numbered by letters are no maps
        (tmp_path / f"T_Rock_{letter}{size}.png").touch()
    assert not looks_like_maps(tmp_path)


def test_a_metals_roughness_is_no_packed_map(tmp_path):
    for name in ("rusty_metal_diff", "rusty_metal_roughness", "rusty_metal_metalness", "preview"):
        (tmp_path / f"{name}.png").touch()
    maps = recognise(tmp_path)
    assert maps.files["roughness"] == "rusty_metal_roughness.png"
    assert (set(maps.files), maps.doubtful) == ({"albedo", "roughness", "metalness"}, ("preview.png",))


def test_gltf_packs_roughness_in_green_and_metalness_in_blue(tmp_path):
    for name in ("a_roughnessMetallic", "a_metalRoughness"):
        folder = save(tmp_path / name, a_albedo=flat((0.5,) * 3), **{name: flat((0.0, 0.8, 1.0))})
        surface = read_surface(recognise(folder), 8)
        np.testing.assert_allclose(surface.maps.roughness, 0.8, atol=1e-6)
        np.testing.assert_allclose(surface.maps.metalness, 1.0, atol=1e-6)
        assert surface.notes["roughness"] == f"{name}.png (green)"


def test_smoothness_is_inverted_and_said(tmp_path):
    folder = save(tmp_path / "m", w_albedo=flat((0.5,) * 3), w_glossiness=flat(51 / 255))
    surface = read_surface(recognise(folder), 8)
    np.testing.assert_allclose(surface.maps.roughness, 0.8, atol=1e-6)
    assert surface.notes["roughness"] == "w_glossiness.png (inverted)"
    folder = save(tmp_path / "unity", B_AlbedoTransparency=flat((0.5,) * 3), B_MetallicSmoothness=flat((0.4, 0.0, 0.0)))
    with pytest.raises(InputError, match=r"B_MetallicSmoothness\.png: .*alpha"):
        read_surface(recognise(folder), 8)
    exr(folder / "B_MetallicSmoothness.exr", flat((0.4, 0.0, 0.0)))
    (folder / "B_MetallicSmoothness.png").unlink()
    with pytest.raises(InputError, match=r"B_MetallicSmoothness\.exr: .*alpha"):
        read_surface(recognise(folder), 8)
    (folder / "B_MetallicSmoothness.exr").unlink()
    save(folder, B_MetallicSmoothness=flat((0.4, 0.0, 0.0, 0.2)))
    surface = read_surface(recognise(folder), 8)
    np.testing.assert_allclose(surface.maps.roughness, 0.8, atol=1e-6)
    np.testing.assert_allclose(surface.maps.metalness, 0.4, atol=1e-6)
    assert "(alpha, inverted)" in surface.notes["roughness"]
    assert surface.notes["metalness"] == "B_MetallicSmoothness.png (red)"


def exr(path, picture):
    channels = {name: np.ascontiguousarray(picture[..., i], np.float32) for i, name in enumerate("RGB")}
    OpenEXR.File({"type": OpenEXR.scanlineimage}, channels).write(str(path))


def test_exr_normals_are_read_signed_or_as_codes(tmp_path):
    _, codes = hills(16)
    normal = 2 * codes - 1
    up = flat((0.0, 0.0, 1.0))
    for name, stored, expected in (
        ("signed", normal, normal),
        ("codes", codes, normal),
        ("signed_flat", up, up),
        ("codes_flat", flat((0.5, 0.5, 1.0)), up),
    ):
        folder = save(tmp_path / name, a_albedo=flat((0.5,) * 3))
        exr(folder / "a_normal_gl.exr", stored)
        surface = read_surface(recognise(folder), 16)
        np.testing.assert_allclose(surface.maps.normal, expected, atol=1e-6)
        assert ("-1 to" in surface.notes["normal_gl"]) == name.startswith("signed")


def test_exr_heights_of_any_unit_are_scaled_by_the_normals(tmp_path, caplog):
    height, normal = hills()
    for name, unit, offset in (("mm", 50.0, -25.0), ("small", 0.01, 0.0)):
        folder = save(tmp_path / name, a_albedo=flat((0.5,) * 3, 64), a_normal_gl=normal)
        exr(folder / "a_height.exr", np.repeat((height * unit + offset)[..., None], 3, 2))
        surface = read_surface(recognise(folder), 16)
        # As for eight bits: the relief that made the normals was 0.05 widths deep.
        np.testing.assert_allclose(np.ptp(surface.maps.height), 0.05 * np.ptp(height), rtol=0.05)
        (folder / "a_normal_gl.png").unlink()
        depth = 0.3 * (1 if name == "mm" else 0.01 * np.ptp(height))  # small lies in [0, 1]: white is at 1
        read = read_surface(recognise(folder), 64, depth=0.3).maps.height
        np.testing.assert_allclose(np.ptp(read), depth, rtol=1e-4)
    assert caplog.text == ""
    surface = read_surface(recognise(tmp_path / "mm"), 16)
    np.testing.assert_allclose(np.ptp(surface.maps.height), 0.02, rtol=1e-4)
    assert re.search(r"a_height\.exr: .*-24\.9777.*24\.9777.*0\.0200", caplog.text)


@pytest.mark.parametrize("code", [127, 128])
def test_a_drawn_flat_normal_is_flat(tmp_path, code):
    normal = np.repeat(hills(64)[1], 2, 1)
    normal[:, 64:] = (code / 255, code / 255, 1)
    folder = save(tmp_path / "m", albedo=np.full((64, 128, 3), 0.5), normal=normal)
    read = read_surface(recognise(folder), 128).maps.normal
    np.testing.assert_array_equal(read[:, 64:], np.broadcast_to([0, 0, 1], (64, 64, 3)))
    others = 2 * np.round(normal[:, :64] * 255) / 255 - 1
    expected = others / np.linalg.norm(others, axis=-1, keepdims=True)
    np.testing.assert_allclose(
        read[:, :64][np.abs(others[..., 0]) > 0.01], expected[np.abs(others[..., 0]) > 0.01], atol=1e-6
    )


def test_a_scans_codes_around_flat_mean_what_they_say(tmp_path):
    codes = np.random.default_rng(0).integers(127, 129, (64, 64, 2)) / 255
    normal = np.concatenate([codes, np.ones((64, 64, 1))], -1)
    read = read_surface(recognise(save(tmp_path / "m", albedo=flat((0.5,) * 3, 64), normal=normal)), 64).maps.normal
    np.testing.assert_allclose(read[..., :2], 2 * codes - 1, atol=1e-6)


def test_maps_are_given_by_hand(tmp_path, capsys):
    folder = save(tmp_path / "m", photo=flat((0.2,) * 3), grey=flat(0.4), x_color=flat((0.9,) * 3), x_rough=flat(1.0))
    other = save(tmp_path / "other", bumps=flat((0.5, 0.5, 1.0))) / "bumps.png"
    maps = recognise(folder, {"albedo": "photo.png", "roughness": "grey.png", "normal_gl": str(other)})
    assert maps.files == {"albedo": "photo.png", "roughness": "grey.png", "normal_gl": str(other)}
    assert set(maps.unused) == {"x_color.png", "x_rough.png"}
    for path in ("./x_color.png", str(folder / "x_color.png")):  # of a file in the folder, whose name then says nothing
        maps = recognise(folder, {"albedo": "photo.png", "metalness": path})
        assert maps.files == {"albedo": "photo.png", "metalness": "x_color.png", "roughness": "x_rough.png"}
    maps = recognise(folder, {"albedo": "photo.png", "roughness": "grey.png", "normal_gl": str(other)})
    surface = read_surface(maps, 8)
    np.testing.assert_allclose(surface.maps.roughness, 0.4, atol=1e-6)
    words = ["bake", str(folder), "-o", str(tmp_path / "a.npz"), "--size", "4", "--views", "1", "--lights", "1"]
    assert cli.main([*words, "--heldout", "0", "--map", "albedo=photo.png", "--map", "roughness=grey.png"]) == 0
    assert open_btf(tmp_path / "a.npz").provenance["maps"]["albedo"] == "photo.png"
    for wrong, message in (
        ("photo.png", "write MAP=FILE"),
        ("colour=photo.png", "'colour'"),
        ("albedo=none.png", "albedo=none.png: "),
    ):
        assert cli.main([*words, "--map", wrong]) == 2
        assert message in capsys.readouterr().err


def test_what_is_not_recognised_is_a_warning(tmp_path, caplog):
    folder = save(tmp_path / "m", w_albedo=flat((0.5,) * 3), w_foo=flat(0.5), w_specular=flat(0.5))
    read_surface(recognise(folder), 8)
    assert "w_foo.png" in caplog.text
    assert "w_specular.png" in caplog.text
    assert "no normals" in caplog.text


@pytest.mark.long
def test_bake_info_and_run_agree_on_a_folder_of_maps(tmp_path, capsys):
    alone = save(tmp_path / "alone", w_albedo=flat((0.5,) * 3))
    btf = save(tmp_path / "btf", w_albedo=flat((0.5,) * 3), w_rough=flat(0.5))
    (btf / "pairs.csv").touch()
    none = save(tmp_path / "none", photo=flat((0.5,) * 3))
    words = ["--size", "4", "--views", "1", "--lights", "1", "--heldout", "0"]
    said = {}
    for folder, code in ((alone, 0), (btf, 2), (none, 2)):
        assert cli.main(["bake", str(folder), "-o", str(tmp_path / f"{folder.name}.npz"), *words]) == code
        assert looks_like_maps(folder) == (code == 0)
        said["bake"] = capsys.readouterr().err
        assert cli.main(["info", str(folder)]) == code
        said["info"] = capsys.readouterr().err
    assert re.search(r"none: .*photo\.png.*albedo\.png.*pairs\.csv", said["bake"])
    assert said["info"] == said["bake"]
    run = ["run", "quick", "--material", str(none), "--codec", "pca", "--out", str(tmp_path / "run")]
    assert cli.main(run) == 2
    assert capsys.readouterr().err == said["bake"]


def test_a_profile_of_the_albedo_is_applied_and_not_of_data(tmp_path):
    folder = save(tmp_path / "m", albedo=flat((0.5,) * 3), roughness=flat(0.4))
    before = open_svbrdf(folder, SMALL, silent).fingerprint
    for name in ("albedo", "roughness"):
        with Image.open(folder / f"{name}.png") as picture:
            codes = np.asarray(picture)
        with open(folder / f"{name}.png", "wb") as stream:
            writer = png.Writer(16, 16, greyscale=codes.ndim == 2, bitdepth=8, gamma=1.0)
            writer.write(stream, codes.reshape(16, -1).tolist())
    surface = read_surface(recognise(folder), 8)
    np.testing.assert_allclose(surface.maps.base_colour, 128 / 255, atol=1e-6)
    np.testing.assert_allclose(surface.maps.roughness, 0.4, atol=1e-6)
    assert surface.notes["albedo"].endswith("gAMA 1")
    assert open_svbrdf(folder, SMALL, silent).fingerprint != before


def test_what_tells_the_same_is_left_out_and_said(tmp_path):
    for name in ("a_color", "a_NormalGL", "a_NormalDX", "a_rough", "a_metal", "a_arm", "a_ao", "a"):
        (tmp_path / f"{name}.jpg").touch()
    maps = recognise(tmp_path)
    assert set(maps.files) == {"albedo", "normal_gl", "roughness", "metalness"}
    assert set(maps.unused) == {"a_NormalDX.jpg", "a_arm.jpg", "a_ao.jpg", "a.jpg"}


def test_a_second_packed_map_is_left_out_for_the_first(tmp_path):
    for name in ("a_color", "a_arm", "a_MetallicSmoothness"):
        (tmp_path / f"{name}.png").touch()
    maps = recognise(tmp_path)
    assert set(maps.files) == {"albedo", "packed"}
    assert list(maps.unused) == ["a_MetallicSmoothness.png"]


def test_a_packed_map_given_by_hand_goes_before_maps_by_name(tmp_path):
    for name in ("a_color", "a_rough", "a_metal", "a_arm", "a_MetallicSmoothness"):
        (tmp_path / f"{name}.png").touch()
    assert set(recognise(tmp_path).files) == {"albedo", "roughness", "metalness"}
    for role, name in (("packed", "a_arm.png"), ("metallic_smoothness", "a_MetallicSmoothness.png")):
        assert recognise(tmp_path, {role: name}).files == {"albedo": "a_color.png", role: name}
    both = recognise(tmp_path, {"packed": "a_arm.png", "roughness": "a_rough.png"})
    assert set(both.files) == {"albedo", "packed", "roughness"}


@pytest.mark.parametrize("metal", ["a_metallic", "a_ORM"])
def test_a_base_colour_goes_before_a_diffuse_one_where_there_is_metalness(tmp_path, metal):
    for name in ("a_baseColor", "a_diffuse", "a_rough"):
        (tmp_path / f"{name}.png").write_text(name)
    with pytest.raises(InputError, match=r"a_baseColor\.png.*a_diffuse\.png"):
        recognise(tmp_path)
    (tmp_path / f"{metal}.png").touch()
    maps = recognise(tmp_path)
    assert maps.files["albedo"] == "a_baseColor.png"
    assert "a_diffuse.png" in maps.unused


def test_a_second_map_that_cannot_be_read_does_not_stand_in_the_way(tmp_path):
    folder = save(tmp_path / "m", a_color=flat((0.5, 0.5, 0.5)), a_height=flat(0.5))
    Image.fromarray(np.zeros((16, 16), np.uint8)).save(folder / "a_displacement.tif")
    maps = recognise(folder)
    assert maps.files["displacement"] == "a_height.png"
    assert "a_displacement.tif" in maps.unused
    (folder / "a_disp.png").write_bytes((folder / "a_height.png").read_bytes())  # the same file under another name
    assert recognise(folder).files["displacement"] == "a_disp.png"
    Image.fromarray(np.zeros((16, 16), np.uint8)).save(folder / "a_disp.png")
    with pytest.raises(InputError, match=r"a_disp\.png.*a_height\.png"):
        recognise(folder)


def test_maps_in_a_folder_of_the_folder_are_found_and_named(tmp_path):
    save(tmp_path / "textures", rock_diff=flat((0.5, 0.5, 0.5)))
    for attempt in (recognise, open_btf):
        with pytest.raises(InputError, match=f"{tmp_path / 'textures'}: give that folder"):
            attempt(tmp_path)
    save(tmp_path / "more", rock_diff=flat((0.5, 0.5, 0.5)))
    with pytest.raises(InputError, match="give one of these folders"):
        recognise(tmp_path)


def test_folders_that_cannot_be_baked_are_explained(tmp_path):
    (tmp_path / "x_normal.png").touch()
    with pytest.raises(InputError, match=r"albedo.*x_normal\.png"):
        recognise(tmp_path)
    for name in ("x_col_1.png", "x_col_2.png"):
        (tmp_path / name).write_text(name)
    with pytest.raises(InputError, match=r"x_col_1\.png.*x_col_2\.png"):
        recognise(tmp_path)
    with pytest.raises(InputError, match="nothing: "):
        recognise(tmp_path / "nothing")
    for name in ("old_pairs.csv", "._dirs.lp"):  # neither is a list
        (tmp_path / name).touch()
    assert looks_like_maps(tmp_path)
    (tmp_path / "dirs.lp").touch()
    assert not looks_like_maps(tmp_path)
    folder = save(tmp_path / "m", albedo=flat((0.5, 0.5, 0.5)), roughness=np.ones((8, 16)))
    with pytest.raises(InputError, match=r"roughness\.png: .*proportion"):
        read_surface(recognise(folder), 8)


def test_flat_rough_maps_are_lambert_under_fresnel(tmp_path):
    """With roughness 1 the highlight is faint: near the normal the value is a / π · cos θ_i within what F0 = 4 % takes
    from it and gives back."""
    code = 128 / 255
    maps = {"albedo": flat((code,) * 3), "normal": flat((0.5, 0.5, 1.0)), "roughness": flat(1.0)}
    surface = read_surface(recognise(save(tmp_path / "m", **maps, height=flat(0.3))), 8)
    theta = np.radians([0, 15, 30])
    wi = np.stack([np.sin(theta), 0 * theta, np.cos(theta)], -1)
    lambert = np.broadcast_to((decode_srgb([code]) / np.pi * np.cos(theta))[:, None, None, None], (3, 8, 8, 3))
    # Without the dielectric's reflection it is exact, but for the tilt of an 8-bit code of 0.5 (0.2°).
    for specular, rtol in ((1.0, 0.1), (0.0, 4e-3)):
        maps = replace(surface.maps, specular=specular)
        np.testing.assert_allclose(render(maps, np.tile([0, 0, 1], (3, 1)), wi, surface.shape), lambert, rtol=rtol)


@pytest.mark.parametrize("dx", [False, True])
@pytest.mark.parametrize("inverted", [False, True])
def test_dx_normals_and_depth_maps_are_told_by_each_other(tmp_path, dx, inverted):
    height, normal = hills()
    maps = {
        "albedo": flat((0.5, 0.5, 0.5), 64),
        "normal": downwards(normal) if dx else normal,
        "height": 1 - height if inverted else height,
    }
    surface = read_surface(recognise(save(tmp_path / "m", **maps)), 16)
    assert ("(DX)" in surface.notes["normal"]) == dx
    assert ("dark" in surface.notes["displacement"]) == inverted
    expected = 2 * normal - 1
    np.testing.assert_allclose(surface.maps.normal, expected / np.linalg.norm(expected, axis=-1)[..., None], atol=0.01)
    # The relief that made the normals was 0.05 widths deep; central differences and 8 bits blur it by 2 %.
    np.testing.assert_allclose(np.ptp(surface.maps.height), 0.05 * np.ptp(height), rtol=0.05)


def test_grooves_along_one_axis_leave_it_to_the_name(tmp_path):
    height = np.tile(0.5 + 0.5 * np.sin(2 * np.pi * np.arange(32) / 32)[:, None], (1, 32))
    slope = np.roll(height, 1, 0) - np.roll(height, -1, 0)  # along y, which grows upwards
    normal = np.stack([0 * height, -slope, np.ones_like(height)], -1)
    codes = (normal / np.linalg.norm(normal, axis=-1, keepdims=True) + 1) / 2
    maps = {"albedo": flat((0.5, 0.5, 0.5), 32), "height": height}
    surface = read_surface(recognise(save(tmp_path / "gl", **maps, normal_gl=codes)), 8)
    assert "bright" in surface.notes["displacement"]
    surface = read_surface(recognise(save(tmp_path / "dx", **maps, normal_dx=codes)), 8)
    assert "dark" in surface.notes["displacement"]


def test_sixteen_bits_survive(tmp_path):
    folder = save(tmp_path / "m", albedo=flat((0.5,) * 3))
    codes = 30000 + np.arange(256, dtype=np.uint16).reshape(16, 16)
    with open(folder / "disp.png", "wb") as stream:
        png.Writer(16, 16, greyscale=True, bitdepth=16).write(stream, codes.tolist())
    surface = read_surface(recognise(folder), 16, depth=1.0)
    np.testing.assert_allclose(surface.maps.height * 65535, codes, atol=0.01)


@pytest.mark.parametrize("depth", [-0.1, 1.5, np.nan])
def test_a_depth_out_of_range_is_refused_whatever_maps_there_are(tmp_path, depth):
    folder = save(tmp_path / "m", albedo=flat((0.5,) * 3))
    with pytest.raises(InputError, match=r"depth .*between 0 and 1"):
        read_surface(recognise(folder), 8, depth)


def test_packed_maps_and_depth_by_name(tmp_path):
    folder = save(tmp_path / "m", albedo=flat((0.5, 0.5, 0.5)), arm=flat((0.1, 0.6, 1.0)), depth=flat(0.25))
    surface = read_surface(recognise(folder), 8)
    np.testing.assert_allclose(surface.maps.roughness, 0.6, atol=1e-6)
    np.testing.assert_allclose(surface.maps.metalness, 1.0, atol=1e-6)
    assert re.search(r"dark.*0\.0200", surface.notes["depth"])


def test_anisotropy_packed_as_in_gltf_and_apart(tmp_path):
    packed = save(tmp_path / "a", albedo=flat((0.5,) * 3), anisotropy=flat((0.5, 1.0, 0.8)))
    maps = read_surface(recognise(packed), 8).maps
    np.testing.assert_allclose(maps.angle, np.pi / 2, atol=0.01)  # along +y
    np.testing.assert_allclose(maps.anisotropy, 0.8, atol=1e-6)
    apart = save(tmp_path / "b", albedo=flat((0.5,) * 3), anisotropylevel=flat(0.4), anisotropyangle=flat(51 / 255))
    maps = read_surface(recognise(apart), 8).maps
    np.testing.assert_allclose(maps.angle, np.radians(72), atol=1e-5)
    np.testing.assert_allclose(maps.anisotropy, 0.4, atol=1e-6)


def test_albedo_is_averaged_in_linear_light(tmp_path):
    checks = np.indices((64, 64)).sum(0) % 2
    surface = read_surface(recognise(save(tmp_path / "m", albedo=np.repeat(checks[..., None], 3, 2))), 8)
    np.testing.assert_allclose(surface.maps.base_colour, 0.5, atol=1e-6)


def test_normals_that_shrinking_averages_away_make_it_rougher(tmp_path):
    """Facets tilted by ±t have a mean normal of length cos t: α² grows by 1 / cos t − 1."""
    tilt = 0.4 * (-1.0) ** np.arange(64)
    facets = np.stack(np.broadcast_arrays(np.sin(tilt), 0, np.cos(tilt)), -1)
    codes = np.broadcast_to((facets + 1) / 2, (64, 64, 3))
    folder = save(tmp_path / "m", albedo=flat((0.5,) * 3, 64), roughness=flat(0.2, 64), normal=codes)
    coarse, fine = (read_surface(recognise(folder), size).maps for size in (8, 64))
    np.testing.assert_allclose(fine.roughness, 0.2, atol=1e-6)
    np.testing.assert_allclose(coarse.normal[..., 2], 1, atol=1e-4)
    # 8-bit codes round the tilt by up to 1 %.
    np.testing.assert_allclose(coarse.roughness**4, 0.2**4 + 1 / np.cos(0.4) - 1, rtol=0.02)


def test_a_baked_file_opens_again_and_equals_what_was_rendered(tmp_path):
    height, normal = hills()
    folder = save(tmp_path / "m", albedo=flat((0.5, 0.4, 0.3), 64)[:32], normal=normal[:32], height=height[:32])
    surface = read_surface(recognise(folder), 8)
    assert surface.shape == (4, 8)  # square texels: the longer side has the size asked for
    calls = []
    bake(surface, SMALL, tmp_path / "m.npz", lambda *says: calls.append(says))
    assert calls[-1] == ("baking m", 19, 19)
    btf = open_btf(tmp_path / "m.npz")
    assert btf.periodic
    assert len(btf.split().heldout["heldout"]) == 3
    assert btf.provenance["maps"]["albedo"] == "albedo.png"
    expected = render(surface.maps, btf.wo, btf.wi, surface.shape, SUB_POINTS)
    np.testing.assert_array_equal(np.stack(list(btf)), expected)
    assert {path.name for path in tmp_path.iterdir()} <= {"m", "m.npz", "cache"}


def test_a_folder_of_maps_is_a_material_and_is_baked_once(tmp_path, monkeypatch, caplog):
    folder = save(tmp_path / "tiles", albedo=flat((0.5, 0.4, 0.3)), roughness=flat(0.4))
    btf = open_material(MaterialSpec("tiles", str(folder)), SMALL, silent)
    assert (btf.name, btf.shape, len(btf)) == ("tiles", (8, 8), 19)
    assert "roughness.png" in caplog.text
    monkeypatch.setattr("bench.data.bake.render", None)  # a second time nothing is rendered
    again = open_svbrdf(folder, SMALL, silent)
    assert again.fingerprint == btf.fingerprint
    save(folder, roughness=flat(0.5))
    with pytest.raises(TypeError):
        open_svbrdf(folder, SMALL, silent)


class Tracer:
    """A path tracer of grey: a launch has two slices, and the one after `left` of them is killed."""

    def __init__(self, left=99, value=0.25):
        self.left, self.value = left, value

    def provenance(self):
        return {"renderer": "grey"}

    def launches(self, maps, wo, wi, size, sub_points, seed):
        for first in range(0, len(wo), 2):
            if not self.left:
                raise KeyboardInterrupt
            self.left -= 1
            yield np.full((len(wo[first : first + 2]), *size, 3), self.value, np.float32)


def test_a_suites_maps_are_path_traced_into_the_cache(tmp_path):
    folder = save(tmp_path / "tiles", albedo=flat((0.5, 0.4, 0.3)), roughness=flat(0.4))
    spec, data = MaterialSpec("tiles", str(folder)), replace(SMALL, renderer="mitsuba")
    with pytest.raises(KeyboardInterrupt):
        open_material(spec, data, silent, 0, lambda: Tracer(left=3))
    assert list((tmp_path / "cache" / "materials").iterdir()) == []
    btf = open_material(spec, data, silent, 0, Tracer)
    assert {float(slice.max()) for slice in btf} == {0.25}
    assert "grey" in str(btf.provenance)
    assert open_material(spec, SMALL, silent).fingerprint != btf.fingerprint
    once = Tracer(left=0)
    assert open_material(spec, data, silent, 0, lambda: once).fingerprint == btf.fingerprint


def test_bakes_that_differ_in_the_last_bit_are_the_same_data(tmp_path, monkeypatch):
    folder = save(tmp_path / "tiles", albedo=flat((0.5, 0.4, 0.3)), roughness=flat(0.4))
    spec, data = MaterialSpec("tiles", str(folder)), replace(SMALL, renderer="mitsuba")
    one = open_material(spec, data, silent, 0, Tracer)
    monkeypatch.setenv("NEUBTF_CACHE", str(tmp_path / "other"))  # as on another processor
    other = open_material(spec, data, silent, 0, lambda: Tracer(value=np.nextafter(np.float32(0.25), 1)))
    assert not np.array_equal(one[0], other[0])
    assert other.fingerprint == one.fingerprint
    assert other.subset(other.split().train).fingerprint == one.subset(one.split().train).fingerprint


def test_what_cannot_be_path_traced_is_refused(tmp_path):
    folder = save(tmp_path / "tiles", albedo=flat((0.5, 0.4, 0.3)), roughness=flat(0.4))
    data = replace(SMALL, renderer="mitsuba")
    with pytest.raises(InputError, match=r"mitsuba.*satin"):
        open_named("satin", {"data.renderer": "mitsuba"})
    both = open_material(MaterialSpec("satin"), data, silent, 0, Tracer)  # a suite may have maps beside it
    assert both.fingerprint == open_material(MaterialSpec("satin"), SMALL, silent).fingerprint
    with pytest.raises(InputError, match=r"bake.*tiles --renderer"):
        open_material(MaterialSpec("tiles", str(folder)), data, silent)


def test_bake_from_the_command_line(tmp_path, capsys):
    folder = save(tmp_path / "tiles", albedo=flat((0.5, 0.4, 0.3)), rough=flat(0.4))
    words = ["--size", "8", "--views", "3", "--lights", "2", "--heldout", "0"]
    assert cli.main(["bake", str(folder), "-o", str(tmp_path / "out"), *words]) == 0
    assert "rough.png" in capsys.readouterr().out
    assert open_btf(tmp_path / "out").layout.grid.shape == (3, 2)
    assert cli.main(["bake", str(tmp_path / "out"), "-o", str(tmp_path / "x.npz")]) == 2
    assert cli.main(["bake", str(folder), "-o", str(tmp_path / "x.npz"), "--views", "0"]) == 2


REAL = ("bark", "bricks", "fabric_pattern", "rock", "rosewood", "rustymetal")


@pytest.mark.parametrize("name", REAL)
def test_scanned_materials_bake_upright(name):
    if "NEUBTF_DATA" not in os.environ:
        pytest.skip("NEUBTF_DATA names no folder of real materials")
    if not (folder := Path(os.environ["NEUBTF_DATA"]) / "svbrdf" / name).is_dir():
        pytest.skip(f"{folder} is not there")
    surface = read_surface(recognise(folder), 16)
    assert surface.shape == ((8, 16) if name == "bricks" else (16, 16))
    assert not any("DX" in text or "dark" in text for text in surface.notes.values())
    up = np.array([[0.0, 0.0, 1.0]])
    albedo = box_filter(surface.maps.base_colour, SUB_POINTS)
    matt = replace(surface.maps, specular=0.0, metalness=0.0)
    picture = render(matt, up, up, surface.shape)[0]
    assert np.corrcoef(albedo.mean(-1).ravel(), picture.mean(-1).ravel())[0, 1] > 0.7


def test_a_bake_says_its_size_that_of_the_maps_and_what_all_texels_would_take(tmp_path, capsys):
    folder = save(tmp_path / "m", albedo=flat([0.2, 0.4, 0.6], 32))
    words = ["bake", str(folder), "--views", "4", "--lights", "4", "--heldout", "3", "-o", str(tmp_path / "m.npz")]
    for size, hints in (("8", 1), ("32", 0), ("64", 0)):
        assert cli.main([*words, "--size", size]) == 0
        said = capsys.readouterr().out
        assert f"{size} × {size}" in said
        assert said.count("--size 32") == hints


def test_the_maps_of_a_folder_are_listed_once_and_as_words(tmp_path, capsys, caplog):
    folder = save(tmp_path / "m", albedo=flat([0.2, 0.4, 0.6], 32))
    described = fields_text(btf_fields(look(open_svbrdf(folder, SMALL, silent))))
    assert caplog.text.count("albedo.png") == 1
    assert "{" not in described
    assert "albedo.png" in described


def test_pairs_between_texels_are_baked_from_the_maps_moved_by_half_a_texel(tmp_path, monkeypatch):
    monkeypatch.setenv("NEUBTF_CACHE", str(tmp_path / "cache"))
    height, normal = (picture[:48] for picture in hills())  # whose grid at 10 texels is not of their proportion
    folder = save(tmp_path / "maps", wall_albedo=flat((0.5, 0.3, 0.2), 64)[:48], wall_disp=height, wall_nor_gl=normal)
    data = replace(SMALL, size=10)
    plain, btf = open_svbrdf(folder, data, silent), open_svbrdf(folder, replace(data, between=2), silent)
    assert btf.fingerprint == plain.fingerprint
    fine = render(
        read_surface(recognise(folder), 10).maps, btf.wo[[16, 18]], btf.wi[[16, 18]], (16, 20), SUB_POINTS // 2
    )
    fine = np.roll(fine, (-1, -1), (1, 2))
    expected = np.stack([box_filter(picture, 2) for picture in fine])
    np.testing.assert_allclose(btf.between[:], expected, rtol=1e-3, atol=1e-5)
