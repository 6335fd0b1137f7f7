from pathlib import Path

import numpy as np
import OpenEXR
import pytest
import torch
from PIL import Image
from torch import Tensor

import bench
from bench import cli
from bench.conformance.check import tiny_btf
from bench.data.convert import write_btf
from bench.demand import still
from bench.demand.scene import named_scene, parse_scene
from bench.demand.text_scene import TextScene
from bench.inputs.errors import InputError
from bench.material import DecoderCost, Material
from bench.metrics.display import to_display
from tests.bench.demand.scenes import SUN, camera, surface

CAMERA = camera(40, 40, 40, [0, 0, 2], up=[0, 1, 0])
PLANE = CAMERA + surface(size=[4, 4]) + SUN
BALL = CAMERA + surface(shape="sphere", radius=0.5, up=[0, 1, 0]) + SUN
MITSUBA = ["--scene", "room.xml", "--bsdf", "cloth"]


class Lambert(Material):
    def __init__(self, size: tuple[int, int] = (8, 8)) -> None:
        super().__init__(size, DecoderCost())

    def evaluate(self, uv: Tensor, wo: Tensor, wi: Tensor, footprint: Tensor) -> Tensor:
        return torch.stack([torch.full_like(uv[:, 0], 0.5), uv[:, 0], uv[:, 1]], 1) * wi[:, 2:] / torch.pi


def picture(text: str, rays: int = 1) -> np.ndarray:
    return still.render(parse_scene("test", text), [still.of_material(Lambert())], rays=rays)[0]


@pytest.mark.parametrize("size", [(8, 8), (4, 8), (8, 4)])
def test_a_diffuse_plane_has_the_value_of_its_light(size):
    """A plane of 4 × 4 fills the picture: uv runs over 1.456 / 4 of it, v upwards; a texture is not squeezed."""
    ours = still.render(parse_scene("test", PLANE), [still.of_material(Lambert(size))], rays=1)[0]
    place = (np.arange(40) - 19.5) * (4 * np.tan(np.radians(20)) / 40)  # scene units at distance 2
    u, v = np.meshgrid(place / 4 + 0.5, -place / 4 + 0.5)
    wide, high = max(size) / size[1], max(size) / size[0]
    truth = np.stack([np.full((40, 40), 0.5), 2 * (wide * u % 1), 3 * (high * v % 1)], -1) * 0.8 / np.pi
    np.testing.assert_allclose(ours[..., :3], truth, rtol=1e-4, atol=1e-6)
    assert (ours[..., 3] == 1).all()


def test_a_diffuse_ball_follows_the_cosine_of_its_normal() -> None:
    ours = picture(BALL)
    col, row = np.meshgrid(np.arange(40) + 0.5, np.arange(40) + 0.5)
    points = TextScene(parse_scene("test", BALL)).cast(0, col.ravel(), row.ravel())
    assert 500 < len(points) < 1200
    normal = points.position / 0.5
    truth = 0.5 / np.pi * np.maximum(normal @ [0.6, 0, 0.8], 0)
    np.testing.assert_allclose(ours.reshape(-1, 4)[points.pixel, 0], truth, atol=1e-5)
    assert not ours[0, 0].any()


def test_more_rays_smooth_the_rim_alone() -> None:
    coarse, fine = picture(BALL), picture(BALL, rays=4)
    assert set(np.unique(coarse[..., 3])) == {0, 1}
    assert ((fine[..., 3] > 0) & (fine[..., 3] < 1)).sum() > 40
    inner = fine[..., 3] == 1
    assert np.abs(coarse - fine)[inner].max() < 0.06


def test_a_ray_meets_the_drape_first_where_it_is_first_below_it() -> None:
    from bench.demand.text_scene import _height, _unit_of

    scene = still.changed(named_scene("drape"), None, 1.0, 60)
    col, row = np.meshgrid(np.arange(60) + 0.5, np.arange(60) + 0.5)
    points = TextScene(scene).cast(0, col.ravel(), row.ravel())
    assert len(points) > 1000
    scale = _unit_of(scene.surface)
    local = points.position / scale
    np.testing.assert_allclose(local[:, 2], _height(local[:, :2]), atol=1e-6)
    for share in np.linspace(0.9, 0.985, 30):  # between the eye and the hit nothing is in the way
        before = (points.eye + (points.position - points.eye) * share) / scale
        inside = (np.abs(before[:, :2]) < 1.1).all(1)
        assert (before[inside, 2] > _height(before[inside, :2]) - 0.01).mean() > 0.999
    for along in (points.dp_du, points.dp_dv):
        np.testing.assert_allclose((points.normal * along).sum(1), 0, atol=1e-6)
    step = points.position + 1e-5 * points.dp_du  # dp/du is where the surface goes
    moved = step / scale
    np.testing.assert_allclose(moved[:, 2], _height(moved[:, :2]), atol=1e-6)


def test_lights_and_tiling_replace_those_of_the_scene() -> None:
    scene = still.changed(named_scene("plane"), "environment", 2.0, 100)
    assert scene.surface.repeat == (6, 6)
    assert (scene.cameras[0].width, scene.cameras[0].height) == (100, 100)
    assert len(scene.lights) == 7
    ours = still.render(scene, [still.of_material(Lambert())], rays=1)[0]
    expected = sum(light.irradiance[0] * light.toward[2] for light in scene.lights) * 0.5 / np.pi
    np.testing.assert_allclose(ours[ours[..., 3] == 1][:, 0], expected, rtol=1e-4)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    bench.encode(tiny_btf(), "mean-colour", tmp_path / "checks.nbtf")
    return tmp_path / "checks.nbtf"


def test_the_command_writes_linear_floats_or_the_display_s_bytes(file: Path, tmp_path: Path) -> None:
    shown = ["render", str(file), str(file), "--width", "24", "--rays", "1", "--exposure", "2", "-o"]
    assert cli.main([*shown, str(tmp_path / "a.exr")]) == 0
    assert cli.main([*shown, str(tmp_path / "a.png")]) == 0
    linear = OpenEXR.File(str(tmp_path / "a.exr")).channels()["RGBA"].pixels
    assert linear.shape == (24, 48, 4)
    np.testing.assert_array_equal(linear[:, :24], linear[:, 24:])
    pixels = np.asarray(Image.open(tmp_path / "a.png"))
    np.testing.assert_allclose(pixels[..., :3], 255 * to_display(linear[..., :3], 2.0), atol=0.51)
    np.testing.assert_array_equal(pixels[..., 3], 255 * linear[..., 3])


def test_a_png_has_captions_below_where_they_are_legible(file: Path, tmp_path: Path, capsys) -> None:
    shown = ["render", str(file), "--truth", str(file.with_name("truth.npz")), "--rays", "1", "-o"]
    write_btf(tiny_btf(), file.with_name("truth.npz"))
    for width, rows in ((160, 160 + still.CAPTION), (24, 24)):
        assert cli.main([*shown, str(tmp_path / "a.png"), "--width", str(width)]) == 0
        with Image.open(tmp_path / "a.png") as picture:
            assert picture.size == (2 * width, rows)
            below = np.asarray(picture)[width:, :, 3]
        if rows > width:
            assert below[:, :width].any()  # the truth's
            assert below[:, width:].any()
        said = capsys.readouterr().out
        assert f"mean-colour, {file.stat().st_size:,} bytes" in said
        assert " dB " in said


def test_the_psnr_in_a_frame_is_that_of_the_pixels_which_show_the_surface_alone() -> None:
    truth = np.full((2, 3, 4), 0.5)
    truth[..., 3] = [[1, 1, 0.5], [1, 1, 0]]
    ours = truth.copy()
    ours[truth[..., 3] < 1, :3] = 0.1
    assert still.psnr_in_frame(ours, truth, 1.0) == np.inf
    ours[0, 0, :3] = 0.25
    white, grey = to_display(np.array([0.5, 0.25]), 1.0)
    error = (white - grey) ** 2 / 4
    np.testing.assert_allclose(still.psnr_in_frame(ours, truth, 1.0), -10 * np.log10(error))


def test_a_picture_whose_pixels_all_show_more_than_the_surface_is_refused() -> None:
    half = np.full((2, 3, 4), 0.5)
    for measure in (still.exposure_for, lambda picture: still.psnr_in_frame(picture, half, 1.0)):
        with pytest.raises(InputError, match="no pixel shows nothing but the surface: move the camera"):
            measure(half)


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--scene", "spheer"], "did you mean 'sphere'?"),
        (["--scene", "room.xml"], "BSDF"),
        (["--bsdf", "cloth"], "--bsdf"),
        (["-o", "a.jpg"], "a.jpg"),
        (["-o", "checks.nbtf/a.png"], "checks.nbtf: "),
        (["--frame", "3"], "--frame 3"),
        (["--tiling", "nan"], "--tiling nan"),
        (["--width", "0"], "--width 0"),
        (["--exposure", "0"], "--exposure 0"),
        (["--set", "data.size=8"], "--set"),
        ([*MITSUBA, "--rays", "3"], "--rays"),
        ([*MITSUBA, "--device", "cpu"], "--device"),
        ([*MITSUBA, "--samples", "0"], "--samples 0"),
    ],
)
def test_wrong_words_are_named(file, words, says, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    out = [] if "-o" in words else ["-o", "a.png"]
    width = [] if {"--width", "room.xml"} & {*words} else ["--width", "8"]
    assert cli.main(["render", str(file), *width, *words, *out]) == 2
    assert says in capsys.readouterr().err
    assert not list(tmp_path.glob("a.*"))
