import json
import zipfile

import numpy as np
import pytest

from bench import cli
from bench.demand import demand as demands
from bench.demand.collect import collect
from bench.demand.overview import summarise
from bench.demand.scene import named_scene, parse_scene, shipped
from bench.demand.text_scene import TextScene
from bench.inputs.errors import InputError
from tests.bench.demand.scenes import SUN, camera, demand_of, light, surface

ABOVE = camera(40, 20, 40, [0, 0, 2], up=[0, 1, 0]) + surface(size=[4, 4], repeat=[2, 2])
LAMP = light("point", position=[1, 0, 3], intensity=[9, 9, 9])
SKY = light("environment", radiance=[1, 1, 1], samples=4)
BALL = ABOVE[: ABOVE.index("[surface]")] + surface(shape="sphere", radius=0.5, repeat=[4, 2])


def test_a_plane_seen_from_above_has_the_picture_s_own_frame():
    demand = demand_of(ABOVE + SUN)
    assert demand.frames == (1, 20, 40)
    assert len(demand) == 800
    pixel = 2 * np.tan(np.radians(20)) / 40 * 2  # scene units, at distance 2; the texture's period is 2
    x, y = (demand.pixel % 40 - 19.5) * pixel, -(demand.pixel // 40 - 9.5) * pixel
    np.testing.assert_allclose(
        demand.uv((8, 8)), np.stack([(x / 4 + 0.5) * 2 % 1, (y / 4 + 0.5) * 2 % 1], 1), atol=1e-5
    )
    np.testing.assert_allclose(
        demand.wo * np.sqrt(x**2 + y**2 + 4)[:, None], np.stack([-x, -y, 0 * x + 2], 1), atol=1e-5
    )
    np.testing.assert_allclose(demand.wi, np.broadcast_to([0.6, 0, 0.8], (800, 3)), atol=1e-6)
    np.testing.assert_allclose(demand.footprint, pixel / 2, rtol=1e-5)


@pytest.mark.parametrize("text", [ABOVE, BALL])
def test_frames_follow_the_surface_and_a_footprint_is_the_step_to_the_next_pixel(text):
    tilted = text.replace("[0, 0, 2]", "[0.3, -1.5, 0.9]").replace("up = [0, 1, 0]", "up = [0, 0, 1]")
    fine = tilted.replace("width = 40", "width = 1200").replace("height = 20", "height = 600")
    col, row = np.meshgrid(np.arange(1200) + 0.5, np.arange(600) + 0.5)
    points = TextScene(parse_scene("test", fine + SUN)).cast(0, col.ravel(), row.ravel())
    view = points.eye - points.position
    np.testing.assert_allclose(points.wo[:, 2], (view * points.normal).sum(1) / np.linalg.norm(view, axis=1), atol=1e-9)
    uv = np.full((600 * 1200, 2), np.nan)
    uv[points.pixel] = points.uv
    uv = uv.reshape(600, 1200, 2)
    steps = [np.linalg.norm(uv[1:, :-1] - uv[:-1, :-1], axis=-1), np.linalg.norm(uv[:-1, 1:] - uv[:-1, :-1], axis=-1)]
    expected = np.maximum(*steps).ravel()
    footprints = np.full((600, 1200), np.nan)
    footprints.ravel()[points.pixel] = points.footprint
    footprints = footprints[:-1, :-1].ravel()
    # Where the surface curves away, or wraps, the next pixel is not on the plane that touches it here.
    straight = np.isfinite(expected) & np.isfinite(footprints) & (footprints < 0.02)
    assert straight.sum() > 10_000
    assert np.median(np.abs(footprints[straight] / expected[straight] - 1)) < 0.01


@pytest.mark.parametrize("light", [SUN, LAMP])
def test_the_sum_over_the_demand_is_the_picture_of_a_diffuser(light):
    demand = demand_of(ABOVE + light)
    picture = demand.pictures(np.repeat(demand.wi[:, 2:] / np.pi, 3, 1))[0]
    pixel = 2 * np.tan(np.radians(20)) / 40 * 2
    x, y = (np.arange(40) - 19.5) * pixel, -(np.arange(20)[:, None] - 9.5) * pixel
    if light == SUN:
        expected = np.broadcast_to(0.8 * np.array([1, 2, 3]) / np.pi, (20, 40, 3))
    else:
        expected = np.repeat((9 * 3 / ((x - 1) ** 2 + y**2 + 9) ** 1.5 / np.pi)[..., None], 3, 2)
    np.testing.assert_allclose(picture, expected, rtol=1e-5)


def test_an_environment_lights_a_diffuser_evenly():
    demand = demand_of(ABOVE + SKY.replace("samples = 4", "samples = 64"))
    picture = demand.pictures(np.repeat(demand.wi[:, 2:] / np.pi, 3, 1))
    # A white diffuser under radiance 1 from all around sends back 1.
    assert picture.mean() == pytest.approx(1, abs=0.02)


def test_a_lamp_of_an_environment_sends_what_its_disc_does():
    lamp = "lamps = [{toward = [0, 0, 1], cone_deg = 5, radiance = [50, 50, 50]}]\n"
    demand = demand_of(ABOVE + SKY.replace("radiance = [1, 1, 1]\n", lamp))
    irradiance = 50 * np.pi * np.sin(np.radians(5)) ** 2
    picture = demand.pictures(np.repeat(demand.wi[:, 2:] / np.pi, 3, 1))
    assert picture.mean() * np.pi == pytest.approx(irradiance, rel=1e-2)
    assert (demand.wi[:, 2] >= np.cos(np.radians(5)) - 1e-6).all()


def test_a_limit_of_queries_casts_fewer_rays_with_the_picture_s_footprints():
    whole, part = demand_of(ABOVE + SUN), demand_of(ABOVE + SUN, limit=200)
    thin = whole.thinned(300, np.random.default_rng(0))
    assert len(thin) == 300
    assert thin.weight.sum() == pytest.approx(whole.weight.sum(), rel=1e-5)
    assert len(part) <= 200
    assert part.frames[1] < 20
    assert np.median(part.footprint) == pytest.approx(np.median(whole.footprint), rel=1e-3)


def test_how_much_of_a_texture_is_seen_does_not_depend_on_the_number_of_queries():
    """Seen from above, the texture repeats more than once in the picture, so all of it is seen."""
    above = ABOVE[: ABOVE.index("[surface]")] + surface(size=[4, 4], repeat=[8, 8])
    demand = demand_of(above + SUN)
    for count in (100, 300, 800):
        assert summarise(demand.thinned(count, np.random.default_rng(0))).coverage > 0.95


def test_a_demand_is_read_as_it_was_written(tmp_path, capsys):
    demand = demand_of(ABOVE + LAMP + SUN)
    demand.save(tmp_path / "a.npz")
    read = demands.load(str(tmp_path / "a.npz"))
    for name in ("place", "footprint", "weight", "pixel"):
        np.testing.assert_array_equal(getattr(read, name), getattr(demand, name))
    for name in ("wo", "wi"):
        np.testing.assert_allclose(getattr(read, name), getattr(demand, name), atol=2e-5)
    assert (read.frames, read.provenance) == (demand.frames, demand.provenance)
    with pytest.raises(InputError, match=r"none\.npz"):
        demands.load(tmp_path / "none.npz")
    with zipfile.ZipFile(tmp_path / "c.npz", "w", zipfile.ZIP_DEFLATED) as bomb, bomb.open("place.npy", "w") as file:
        for _ in range(65):
            file.write(bytes(1 << 20))
    with pytest.raises(InputError, match=r"c\.npz: .*68,157,440"):
        demands.load(tmp_path / "c.npz")
    (tmp_path / "b.npz").write_bytes(b"PK")  # which stops a run before anything is written
    assert cli.main(["run", "quick", "--scene", str(tmp_path / "b.npz"), "--out", str(tmp_path / "run")]) == 2
    assert "b.npz: " in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


def about(**changes):
    content = {"format": 2, "frames": [1, 20, 40], "provenance": {"scene": "test"}} | changes
    return np.frombuffer(json.dumps(content).encode(), np.uint8)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"about": None}, "about"),
        ({"about": np.array([{}], object)}, r"about\.npy"),
        ({"about": np.frombuffer(b"[" * 99_999, np.uint8)}, "about"),
        ({"about": about(format="1")}, "format"),
        ({"about": about(provenance={"scene": [1]})}, "provenance: scene"),
        ({"about": about(frames=[1, 20, -40])}, "frames"),
        ({"about": about(frames=[10**6] * 3)}, "frames"),
        ({"about": about(format=99)}, "format 99"),
        ({"about": about(format=1)}, "format 1 "),
        ({"about": about(frames=[1, 2, 2])}, "pixel"),
        ({"pixel": None}, "pixel"),
        ({"pixel": np.zeros(800, np.float64)}, "pixel .*float64"),
        ({"pixel": np.zeros(2_000_000, np.int32)}, "2000000"),
        ({"place": np.full((800, 2), np.nan, np.float32)}, "place"),
        ({"weight": np.zeros((800, 3), np.float32)}, "weight"),
        ({"weight": np.full((800, 3), np.inf, np.float32)}, "weight"),
        ({"footprint": np.zeros(800, np.float32)}, "footprint"),
        ({"wo": np.zeros((800, 3), np.int16)}, "wo"),
        ({"more": np.zeros(3)}, "more"),
        ({}, "0 queries"),
    ],
    ids=range(20),
)
def test_a_demand_of_wrong_types_or_absurd_sizes_is_refused_by_name(tmp_path, changes, message):
    demand_of(ABOVE + SUN).save(tmp_path / "a.npz")
    arrays = dict(np.load(tmp_path / "a.npz"))
    arrays |= changes or {name: values[:0] for name, values in arrays.items() if name != "about"}
    np.savez(tmp_path / "a.npz", **{name: values for name, values in arrays.items() if values is not None})
    with pytest.raises(InputError, match=rf"a\.npz: .*{message}"):
        demands.load(tmp_path / "a.npz")


def test_a_huge_picture_asks_for_frames_that_fit_in_memory(monkeypatch):
    monkeypatch.setattr("bench.demand.collect.FRAME", 1 << 14)
    text = ABOVE.replace("width = 40", "width = 65_536").replace("height = 20", "height = 65_536")
    demand = demand_of(text.replace("position = [0, 0, 2]", "position = [0, 0, 100]") + SUN, limit=1000)
    assert demand.frames == (1, 128, 128)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (SUN, "", "lights is missing"),
        (ABOVE, "", "camera is missing"),
        ("fov_deg", "fov", "'fov'; did you mean 'fov_deg'"),
        ("width = 40", "width = -1", "camera: width"),
        ("width = 40", "width = 1_000_000_000", "camera: width"),
        ("fov_deg = 40", "fov_deg = nan", "camera: fov_deg"),
        ("[0, 0, 2]", "[0, 2]", "position"),
        ("[0, 0, 2]", "[0, 0, 1e400]", "camera: position"),
        ("[0, 1, 0]", "[0, 0, 1]", "must not be parallel"),
        ("target = [0, 0, 0]", "", "target"),
        ("target = [0, 0, 0]", "target = [0, 0, 4]", "no ray of the camera finds the material"),
        ("up = [0, 1, 0]", "path = []", "path has no frame"),
        ("up = [0, 1, 0]", "path = [3]", "camera"),
        ("up = [0, 1, 0]", "path = [{width = 8}, {}]\nup = [0, 1, 0]", "camera: all frames .* one width"),
        ("[2, 2]", "[2, 0]", "surface: repeat"),
        ("[surface]", "[surface]\nshape = ['sphere']", "shape"),
        ("directional", "direct", "'direct'; did you mean 'directional'"),
        ("[1, 2, 3]", "[1, 2, -3]", "lights: irradiance"),
        ("[0.6, 0, 0.8]", "[0, 0, 0]", "lights: toward"),
        ("0.8", "-0.8", "no light reaches the side"),
        (SUN, '[[lights]]\nkind = "point"\nposition = [0, 0, 1]', "intensity"),
        (SUN, SKY.replace("[1, 1, 1]", "[0, 0, 0]"), "not all may be 0"),
        (SUN, SKY.replace("radiance = [1, 1, 1]", "lamps = [3]"), "lights: lamps"),
        (SUN, SKY.replace("samples = 4", "samples = 100_000") * 2, "lights: .* 200,000 samples .*: give fewer"),
        (SUN, "[[lights", "not TOML"),
        (ABOVE + SUN, f"a = {'[' * 5000}{']' * 5000}", "nested too deeply"),
        ("size = [4, 4]", "size = [0.2, 0.2]", "too few rays hit the material"),
        (SUN, LAMP.replace("[1, 0, 3]", "[9, 0, 1e-4]"), "no light reaches"),  # its cosine is 0 in a file
        ("size = [4, 4]", "radius = 4", "surface: a plane has a size, no radius"),
        ("size = [4, 4]", 'size = [4, 4]\nshape = "sphere"', "surface: a sphere has a radius, no size"),
        ("[1, 2, 3]", "[1, 2, 3]\nsamples = 16", "lights: a light of kind directional has no samples"),
        (SUN, SKY + "position = [0, 0, 1]", "lights: a light of kind environment has no position"),
    ],
    ids=range(32),
)
def test_a_scene_that_will_not_do_says_why(old, new, message):
    scene = (ABOVE + SUN).replace(old, new)
    seeds, limit = (50, 1) if message.startswith("too few") else (1, 10**6)
    with pytest.raises(InputError, match=message):
        [collect(TextScene(parse_scene("test", scene)), limit, seed) for seed in range(seeds)]


@pytest.mark.parametrize("name", sorted(shipped()))
def test_every_scene_that_ships_sees_its_material(name):
    demand = collect(TextScene(named_scene(name)), 5_000)
    assert 500 < len(demand) <= 5_000
    for values in (demand.place, demand.wo, demand.wi, demand.weight, demand.footprint):
        assert np.isfinite(values).all()
    assert summarise(demand).coverage > 0.1


@pytest.mark.long
def test_encode_collects_the_demand_of_a_scene_writes_it_beside_and_draws_it(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("bench.cli.commands._scene.QUERIES", 2000)
    words = ["encode", "satin", "--codec", "mean-colour", "-o", str(tmp_path / "a.nbtf")]
    for setting in ("size=16", "views=6", "lights=6", "heldout=4"):
        words += ["--set", f"data.{setting}"]
    assert cli.main([*words, "--scene", "wall"]) == 0
    assert "the normal:" in capsys.readouterr().out
    assert (tmp_path / "demand-wall.png").stat().st_size > 10_000
    first = (tmp_path / "a.nbtf").read_bytes()
    assert len(demands.load(tmp_path / "demand-wall.npz")) <= 2000
    assert cli.main([*words, "--scene", str(tmp_path / "demand-wall.npz")]) == 0
    assert (tmp_path / "a.nbtf").read_bytes() == first
    capsys.readouterr()
    for added, message in (
        (["--scene", "wal"], "'wall'"),
        (["--scene", str(tmp_path / "a.toml")], "a.toml"),
        (["--bsdf", "cloth"], "--scene"),
    ):
        assert cli.main([*words, *added]) == 2
        assert message in capsys.readouterr().err
