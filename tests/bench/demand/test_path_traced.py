"""Pictures that Mitsuba path-traces of a codec file, against those that the suite renders itself."""

import math

import numpy as np
import pytest

import bench
from bench import llvm
from bench.demand import still
from bench.demand.scene import parse_scene

mi = pytest.importorskip("mitsuba", reason='Mitsuba 3 is not installed: pip install "neubtf-bench[mitsuba]"')
CODECS = {
    "pca": {"components": 6},
    "vq": {"codes": 64},
    "hsh": {},
    "neumip": {"steps": 60},
    "neubtf-direct": {"steps": 60, "width": 16},
    "relief": {"steps": 60, "width": 16},
}
SIDE, RAYS, SAMPLES = 48, 8, 256
EYE, LAMP = (0.4, -3.0, 0.9), (-1.3, -2.5, 1.7)
BALL = f"""
[camera]
width = {SIDE}
height = {SIDE}
fov_deg = 21
position = {list(EYE)}
target = [0.0, 0.0, 0.0]
[surface]
shape = "sphere"
radius = 0.5
repeat = [3, 3]
[[lights]]
kind = "point"
position = {list(LAMP)}
intensity = [10.0, 9.0, 8.0]
"""


@pytest.fixture(scope="module", autouse=True)
def plugin():
    if reason := llvm.unusable(plugins=True):
        pytest.skip(reason)
    mi.set_variant("llvm_ad_rgb")
    from bench.demand.mitsuba_bsdf import register

    register()


@pytest.fixture(scope="module")
def btf():
    """Woven, in two colours: no direction of the picture and none of the light is like another."""
    return bench.open("satin", size=16, views=25, lights=25, heldout=8)


def written(folder, rows=96, columns=192):
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


def camera(side=SIDE):
    return {
        "type": "perspective",
        "fov": 21.0,
        "to_world": mi.ScalarTransform4f().look_at(EYE, [0, 0, 0], [0, 0, 1]),
        "film": {"type": "hdrfilm", "width": side, "height": side, "rfilter": {"type": "box"}},
        "sampler": {"type": "stratified"},
    }


def traced(shape, file, **parameters):
    """Mitsuba's picture (SIDE, SIDE, 3) of a shape that wears a codec file."""
    scene = {
        "type": "scene",
        "integrator": {"type": "direct"},
        "shape": shape | {"bsdf": {"type": "neubtf", "filename": str(file)} | parameters},
        "lamp": {"type": "point", "position": LAMP, "intensity": {"type": "rgb", "value": [10.0, 9.0, 8.0]}},
        "camera": camera(),
    }
    return np.asarray(mi.render(mi.load_dict(scene), spp=SAMPLES))[..., :3]


def apart(ours, theirs):
    return float(np.sqrt(np.square(ours - theirs).mean()) / theirs.mean())


@pytest.mark.parametrize("codec", [pytest.param(name, marks=pytest.mark.short if name == "pca" else ()) for name in CODECS])
def test_a_ball_is_the_one_that_the_suite_renders(codec, btf, tmp_path):
    file = tmp_path / "a.nbtf"
    bench.encode(btf, codec, file, **CODECS[codec])
    scene = parse_scene("ball", BALL)
    ours = still.render(scene, [still.of_material(bench.load(file))], rays=RAYS)[0][..., :3]
    angle = 2 * math.tan(math.radians(21 / 2)) / SIDE
    shape = {"type": "obj", "filename": str(written(tmp_path)), "flip_tex_coords": False}
    theirs = traced(shape, file, pixel_angle=angle, repeat=3.0)
    print(codec, apart(ours, theirs), apart(ours, theirs[:, ::-1]), ours.mean(), theirs.mean())
