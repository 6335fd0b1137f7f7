import sys

import numpy as np
import pytest

from bench import cli
from bench.demand.collect import collect
from bench.inputs.errors import InputError
from bench.metrics import get
from bench.program import llvm
from tests.bench.demand.mitsuba.test_path_tracer import with_mitsuba
from tests.bench.demand.scenes import camera, light, surface
from tests.bench.demand.scenes import demand_of as demanded

CAMERA = """
<sensor type="perspective">
  <float name="fov" value="40"/><string name="fov_axis" value="x"/>
  <transform name="to_world"><lookat origin="0.3,-1.5,0.9" target="0,0,0" up="0,0,1"/></transform>
  <film type="hdrfilm">
    <integer name="width" value="40"/><integer name="height" value="20"/><rfilter type="box"/>
  </film>
  <sampler type="independent"><integer name="sample_count" value="64"/></sampler>
</sensor>
"""
ENCODE = ["encode", "satin", "--codec", "mean-colour", "-o"]
CLOTH = '<bsdf type="diffuse" id="cloth"><rgb name="reflectance" value="0.5,0.5,0.5"/></bsdf>'
PLANE = """
<shape type="rectangle">
  <transform name="to_world"><scale x="2" y="2"/></transform><ref id="cloth"/>
</shape>
"""
LAMP = '<emitter type="point"><point name="position" x="1" y="0" z="3"/><rgb name="intensity" value="9,8,7"/></emitter>'
BLOCKER = """
<shape type="rectangle">
  <transform name="to_world"><scale x="0.05" y="0.05"/><translate x="0.8" y="0" z="2.4"/></transform>
  <bsdf type="diffuse" id="board"/>
</shape>
"""
TEXT = (
    camera(40, 20, 40, [0.3, -1.5, 0.9])
    + surface(size=[4, 4])
    + light("point", position=[1, 0, 3], intensity=[9, 8, 7])
)


def written(folder, *parts):
    path = folder / "scene.xml"
    text = "".join(['<scene version="3.0.0"><integrator type="direct"/>', *parts, "</scene>"])
    path.write_text(text)
    return path


def demand_of(path, bsdf="cloth"):
    from bench.demand.mitsuba.scene import MitsubaScene

    if reason := llvm.unusable(plugins=True):
        pytest.skip(reason)
    return collect(MitsubaScene(path, bsdf), 10**6)


@with_mitsuba
def test_a_plane_a_camera_and_a_light_ask_the_same_as_in_toml(tmp_path):
    demand = demand_of(written(tmp_path, CAMERA, CLOTH, PLANE, LAMP))
    expected = demanded(TEXT)
    assert demand.frames == expected.frames
    for name in ("place", "footprint", "wo", "wi", "weight", "pixel"):
        # Mitsuba computes in float32.
        np.testing.assert_allclose(getattr(demand, name), getattr(expected, name), atol=2e-6)


@with_mitsuba
@pytest.mark.parametrize("extra", ["", BLOCKER])
def test_the_sum_over_the_demand_is_the_frame_of_the_direct_integrator(tmp_path, extra):
    # At the rim of the shadow a pixel is lit in part; a ray through its middle sees all or nothing.
    fine = CAMERA.replace('"40"/><integer', '"160"/><integer').replace('"height" value="20"', '"height" value="80"')
    path = written(tmp_path, fine, CLOTH, PLANE, LAMP, extra)
    demand = demand_of(path)
    assert demand.frames == (1, 80, 160)
    import mitsuba as mi

    frame = np.asarray(mi.render(mi.load_file(str(path))), np.float64)[..., :3]
    summed = demand.pictures(np.repeat(demand.wi[:, 2:] * 0.5 / np.pi, 3, 1))[0]
    if extra:  # a board beneath the lamp, out of the picture
        shadow = (demand.pictures(np.ones((len(demand), 3)))[0] == 0).all(-1)
        assert 0.01 < shadow.mean() < 0.2
    flip = get("flip_ldr_67ppd").load()
    assert flip.score(flip.prepare(frame, 4.0), summed) <= 0.03


TUBE = """
<shape type="cylinder">
  <point name="p0" x="-0.6" y="0" z="0"/><point name="p1" x="0.6" y="0" z="0"/><float name="radius" value="0.3"/>
  <ref id="cloth"/>
</shape>
"""


@with_mitsuba
@pytest.mark.parametrize("shape", [PLANE, TUBE], ids=["plane", "tube"])
def test_a_diffuser_under_an_even_sky_has_its_colour_whatever_its_shape(shape, tmp_path, monkeypatch):
    if reason := llvm.unusable(plugins=True):
        pytest.skip(reason)
    monkeypatch.setattr("bench.demand.mitsuba.scene.SAMPLES", 128)
    sky = '<emitter type="constant"><rgb name="radiance" value="0.4,0.5,0.6"/></emitter>'
    demand = demand_of(written(tmp_path, CAMERA, CLOTH, shape, sky))
    seen = demand.pictures(np.repeat(demand.wi[:, 2:] * 0.5 / np.pi, 3, 1))[0].reshape(-1, 3)[np.unique(demand.pixel)]
    assert len(seen) > 50
    np.testing.assert_allclose(seen.mean(0), [0.2, 0.25, 0.3], rtol=0.01)
    assert (seen.std(0) < 0.15 * seen.mean(0)).all()


@with_mitsuba
def test_each_sensor_is_a_frame(tmp_path):
    higher = CAMERA.replace("0.3,-1.5,0.9", "0.3,-1.5,1.9")
    demand = demand_of(written(tmp_path, CAMERA, higher, CLOTH, PLANE, LAMP))
    assert demand.frames == (2, 20, 40)
    later = demand.pixel >= 800
    assert demand.wo[later, 2].mean() > demand.wo[~later, 2].mean() + 0.1


@with_mitsuba
def test_what_will_not_do_says_why(tmp_path):
    away = CAMERA.replace('target="0,0,0"', 'target="0.3,-3,0.9"')
    fov = '<float name="fov" value="40"/><string name="fov_axis" value="x"/>'
    parallel = CAMERA.replace("perspective", "orthographic").replace(fov, "")
    for parts, bsdf, message in [
        ((CAMERA, CLOTH, PLANE, LAMP), "clot", "did you mean 'cloth'"),
        ((away, CLOTH, PLANE, LAMP), "cloth", "behind the camera"),
        ((CLOTH, PLANE, LAMP), "cloth", "no sensor|no ray of the camera"),
        ((CAMERA, CLOTH, PLANE), "cloth", "no emitter|no light reaches the side"),
        ((CAMERA, "<bsdf>"), "cloth", "Mitsuba cannot load it"),
        ((CAMERA, CAMERA.replace('"20"', '"30"'), CLOTH, PLANE, LAMP), "cloth", "its sensors differ in size"),
        ((parallel, CLOTH, PLANE, LAMP), "cloth", "the rays of a sensor are parallel"),
    ]:
        with pytest.raises(InputError, match=message):
            demand_of(written(tmp_path, *parts), bsdf)


@with_mitsuba
def test_a_mesh_without_texture_coordinates_is_refused(tmp_path):
    import mitsuba as mi

    from bench.demand.mitsuba.path_tracer import using
    from bench.demand.mitsuba.scene import _chosen

    (tmp_path / "bare.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    bare = '<shape type="obj"><string name="filename" value="bare.obj"/><ref id="cloth"/></shape>'
    path = written(tmp_path, CAMERA, CLOTH, bare, LAMP)
    # Some versions of LLVM cannot load a mesh that has no uv; the check is the same in every variant.
    with using("scalar_rgb"), pytest.raises(InputError, match="mesh uv"):
        _chosen(mi.load_file(str(path)), path, "cloth")


@with_mitsuba
def test_an_llvm_that_ends_the_process_is_refused(tmp_path, capsys, monkeypatch):
    import drjit as dr

    if dr.has_backend(dr.JitBackend.CUDA):
        pytest.skip("this machine has a CUDA device, which needs no LLVM")
    monkeypatch.setattr(llvm, "_trial_results", lambda choice: ("LLVM 15.0.6", ("kernels",), "Cannot select: fmaximum"))
    path = written(tmp_path, CAMERA, CLOTH, PLANE, LAMP)
    assert cli.main([*ENCODE, str(tmp_path / "a.nbtf"), "--scene", str(path), "--bsdf", "cloth"]) == 2
    assert "DRJIT_LIBLLVM_PATH" in capsys.readouterr().err


def test_the_command_says_what_it_lacks(tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "mitsuba", None)
    monkeypatch.delitem(sys.modules, "bench.demand.mitsuba.scene", raising=False)
    path = str(written(tmp_path))
    for words, message in (
        ([path], "--bsdf ID"),
        ([str(tmp_path / "no.xml"), "--bsdf", "a"], "no such file"),
        (["wall", "--bsdf", "a"], "Mitsuba scene"),
        ([path, "--bsdf", "a"], "needs Mitsuba 3"),
    ):
        assert cli.main([*ENCODE, str(tmp_path / "a.nbtf"), "--scene", *words]) == 2
        assert message in capsys.readouterr().err
