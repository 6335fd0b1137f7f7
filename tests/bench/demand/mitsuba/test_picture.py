import math
from dataclasses import replace

import numpy as np
import OpenEXR
import pytest

import bench
from bench import cli
from bench.demand import still
from bench.demand.scene import parse_scene
from tests.bench.demand import scenes

mi = pytest.importorskip("mitsuba", reason='Mitsuba 3 is not installed: pip install "neubtf-bench[mitsuba]"')
pytestmark = pytest.mark.usefixtures("plugin")
CODECS = {
    "pca": {"components": 6},
    "vq": {"codes": 64},
    "hsh": {},
    "ptm": {},
    "neumip": {"steps": 60},
    "neubtf-direct": {"steps": 60, "width": 16},
    "relief": {"steps": 60, "width": 16},
}
SIDE, RAYS, SAMPLES = 48, 8, 64
NOISE = 0.03  # of the mean: rays at random in a pixel against a grid of them
PIXEL = 2 * math.tan(math.radians(21 / 2)) / SIDE  # the angle of a pixel
EYE, LAMP = (0.4, -3.0, 0.9), (-1.3, -2.5, 1.7)
BALL = (
    scenes.camera(SIDE, SIDE, 21, list(EYE))
    + scenes.surface(shape="sphere", radius=0.5, repeat=[3, 3])
    + scenes.light("point", position=list(LAMP), intensity=[10.0, 9.0, 8.0])
)
WALL = """
<scene version="3.0.0">
  <integrator type="direct"/>
  <sensor type="perspective">
    <float name="fov" value="30"/>
    <transform name="to_world"><lookat origin="0,-1,3" target="0,0,0" up="0,1,0"/></transform>
    <film type="hdrfilm"><integer name="width" value="16"/><integer name="height" value="16"/></film>
  </sensor>
  <bsdf type="diffuse" id="cloth"></bsdf>
  <shape type="rectangle"><transform name="to_world"><scale value="2"/></transform><ref id="cloth"/></shape>
  <emitter type="directional"><vector name="direction" value="0.3,0,-1"/><rgb name="irradiance" value="1"/></emitter>
</scene>
"""


@pytest.fixture(scope="module")
def btf():
    return bench.open("satin", size=16, views=25, lights=25, heldout=8)


def written(folder, rows=48, columns=96):
    """The suite's ball (the file's path), as triangles: Mitsuba's own lays the texture the other way up."""
    east, north = np.meshgrid(np.linspace(0, 1, columns + 1), np.linspace(0, 1, rows + 1)[1:-1])
    phi, theta = (east - 0.5) * 2 * np.pi, (north - 0.5) * np.pi
    normal = np.stack([np.cos(phi) * np.cos(theta), np.sin(phi) * np.cos(theta), np.sin(theta)], -1).reshape(-1, 3)
    lines = [f"v {x} {y} {z}" for x, y, z in 0.5 * normal] + [f"vn {x} {y} {z}" for x, y, z in normal]
    lines += [f"vt {u} {v}" for u, v in zip(east.ravel(), north.ravel(), strict=True)]
    corners = np.arange(1, east.size + 1).reshape(east.shape)
    square = np.stack([corners[:-1, :-1], corners[:-1, 1:], corners[1:, 1:], corners[1:, :-1]], -1).reshape(-1, 4)
    lines += [f"f {' '.join(f'{k}/{k}/{k}' for k in each)}" for a, b, c, d in square for each in ((a, b, c), (a, c, d))]
    path = folder / "ball.obj"
    path.write_text("\n".join(lines))
    return path


def camera(**more):
    return {
        "type": "perspective",
        "fov": 21.0,
        "to_world": mi.ScalarTransform4f().look_at(EYE, [0, 0, 0], [0, 0, 1]),
        "film": {"type": "hdrfilm", "width": SIDE, "height": SIDE, "rfilter": {"type": "box"}},
        "sampler": {"type": "stratified"},
    } | more


def traced(shape, file):
    """Mitsuba's picture (SIDE, SIDE, 3) of a shape that wears a codec file, at the footprints of whole pixels."""
    bsdf = {"type": "neubtf", "filename": str(file), "repeat": 3.0, "pixel_angle": PIXEL}
    scene = {
        "type": "scene",
        "integrator": {"type": "direct"},
        "shape": shape | {"bsdf": bsdf},
        "lamp": {"type": "point", "position": LAMP, "intensity": {"type": "rgb", "value": [10.0, 9.0, 8.0]}},
        "camera": camera(),
    }
    return np.asarray(mi.render(mi.load_dict(scene), spp=SAMPLES))[..., :3]


def rendered(answers):
    return still.render(parse_scene("ball", BALL), [answers], rays=RAYS)[0][..., :3]


def apart(ours, theirs):
    return float(np.sqrt(np.square(ours - theirs).mean()) / theirs.mean())


@pytest.mark.parametrize("codec", [pytest.param(n, marks=() if n == "pca" else pytest.mark.long) for n in CODECS])
def test_a_ball_is_the_one_that_the_suite_renders(codec, btf, tmp_path):
    file = tmp_path / "a.nbtf"
    bench.encode(btf, codec, file, **CODECS[codec])
    ours = rendered(still.of_material(bench.load(file)))
    theirs = traced({"type": "obj", "filename": str(written(tmp_path)), "flip_tex_coords": False}, file)
    assert ours.std() > ours.mean()  # half of it is black
    assert apart(ours, theirs) < NOISE
    assert abs(ours.mean() / theirs.mean() - 1) < 0.01


@pytest.mark.long
def test_a_ball_of_mitsuba_wears_the_mirrored_material(btf, tmp_path):
    """Its v runs down and its u starts behind: texture and relief lie mirrored, and are lit as what they show."""
    file = tmp_path / "a.nbtf"
    bench.encode(btf, "pca", file, components=6)
    upright, flip = still.of_material(bench.load(file)), np.float32([1, -1, 1])

    def mirrored(demand, flip=flip):
        place = (demand.place * np.float32([1, -1]) + np.float32([0.5, 0])) % 1
        return upright(replace(demand, place=place, wo=demand.wo * flip, wi=demand.wi * flip))

    theirs = traced({"type": "sphere", "radius": 0.5}, file)
    assert apart(rendered(mirrored), theirs) < NOISE
    assert apart(rendered(lambda demand: mirrored(demand, np.float32([1, 1, 1]))), theirs) > 3 * NOISE


def test_a_footprint_is_that_of_a_pixel(btf, tmp_path):
    """On a slanted wall, against the rays through the neighbouring pixels."""
    file = tmp_path / "a.nbtf"
    bench.encode(btf, "mean-colour", file)
    bsdf = mi.load_dict({"type": "neubtf", "filename": str(file), "pixel_angle": PIXEL})
    wall = {"type": "rectangle", "to_world": mi.ScalarTransform4f().scale([1, 2, 1])}
    scene = mi.load_dict({"type": "scene", "wall": wall, "camera": camera()})
    col, row = (mi.Float(x) for x in np.random.default_rng(0).random((2, 1000)).astype("f4"))
    rays, _ = scene.sensors()[0].sample_ray_differential(0.0, 0.5, mi.Point2f(col, row), mi.Point2f(0.5, 0.5))
    si = scene.ray_intersect(rays)
    footprints = np.asarray(bsdf._footprint(si))
    si.compute_uv_partials(rays)
    across, down = (np.linalg.norm(np.asarray(each), axis=0) for each in (si.duv_dx, si.duv_dy))
    hit = np.asarray(si.is_valid())
    assert hit.mean() > 0.2
    # Pixels are square and their angle is that in the middle of the picture; a cone is round.
    ratio = footprints[hit] / np.maximum(across, down)[hit]
    assert (abs(ratio - 1) < 0.1).all()
    bsdf.pixel_angle = 0.0
    np.testing.assert_allclose(np.asarray(bsdf._footprint(si))[hit], np.maximum(across, down)[hit], rtol=1e-5)


@pytest.mark.long
def test_render_replaces_a_bsdf_and_samples_of_a_pixel_share_its_footprint(btf, tmp_path, monkeypatch, capsys):
    from bench.demand.mitsuba.scene import sample_angle

    monkeypatch.chdir(tmp_path)
    (tmp_path / "wall.xml").write_text(WALL)
    bench.encode(btf, "neumip", "a.nbtf", steps=20)
    words = ["render", "a.nbtf", "--scene", "wall.xml", "-o", "a.exr"]
    assert cli.main([*words, "--bsdf", "clot"]) == 2
    assert "'cloth'" in capsys.readouterr().err
    (tmp_path / "odd.xml").write_bytes(b'<?xml version="1.0" encoding="gbk"?>' + WALL.encode())
    assert cli.main(["render", "a.nbtf", "--scene", "odd.xml", "-o", "a.exr", "--bsdf", "cloth"]) == 2
    assert "odd.xml: " in capsys.readouterr().err
    assert cli.main(words) == 2
    assert cli.main([*words, "--bsdf", "cloth", "--samples", "4", "--tiling", "20"]) == 0
    with OpenEXR.File("a.exr") as written:
        picture = written.channels()["RGBA"].pixels[..., :3]

    def wanted(angle):
        text = (
            '<bsdf type="neubtf" id="cloth"><string name="filename" value="a.nbtf"/><float name="repeat" value="20"/>'
        )
        text = WALL.replace('<bsdf type="diffuse" id="cloth">', f'{text}<float name="pixel_angle" value="{angle}"/>')
        return np.asarray(mi.render(mi.load_string(text), spp=4))

    np.testing.assert_allclose(picture, wanted(2 * math.tan(math.radians(15)) / 16 / 2), rtol=1e-3)
    assert apart(wanted(0.0), picture) > 0.02
    from_afar = mi.load_dict({"type": "orthographic"})
    assert sample_angle(from_afar, 4) == 0
