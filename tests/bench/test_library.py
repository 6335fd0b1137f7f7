import json
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

import bench
from bench import cli
from bench.codecs import container
from bench.codecs.registry import load_codec
from bench.conformance.check import tiny_btf
from bench.data.readers.folder import write_folder
from bench.directions.hemisphere import from_degrees
from bench.inputs.errors import ContainerError, InputError
from bench.records import load_run
from bench.runs import library
from bench.runs.suite import parse_suite
from tests.bench.demand.scenes import SUN, camera, demand_of, surface

PAGE = Path(__file__).parents[2] / "docs" / "api.md"


@pytest.fixture(autouse=True)
def small(tmp_path, monkeypatch, brief, undrawn, untimed):
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def folder(tmp_path):
    write_folder(tiny_btf(12, 6, 6), tmp_path / "btf")
    return tmp_path / "btf"


def test_the_example_of_the_page_runs_and_has_ten_lines(capsys):
    example = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.S)[0]
    assert len([line for line in example.splitlines() if line and "import" not in line]) <= 10
    names = {}
    exec(example, names)
    assert names["rgb"].shape == (1, 3)
    assert isinstance(names["rgb"], np.ndarray)
    assert "(32, 32) 101" in capsys.readouterr().out


@pytest.mark.long
def test_a_file_of_a_run_scores_what_its_record_says(tmp_path, folder):
    words = ["run", "quick", "--out", "run", "--material", str(folder), "--codec", "pca", "--set", "components=3"]
    assert cli.main(words) == 0
    (job,) = load_run(tmp_path / "run").jobs
    found = bench.score(tmp_path / "run" / job["file"], bench.open(folder))
    assert found["score_key"] == job["score_key"]
    for part in ("scores", "footprints", "bytes", "parameters", "cost", "pairs", "settings"):
        assert found[part] == job[part], part


def test_a_command_a_script_and_a_run_make_the_same_file(tmp_path, folder):
    """Their seeds follow one rule: of the name of the BTF, the codec and the repetition."""
    words = ["--codec", "neubtf-direct", "--set", "steps=3", "--set", "latents=2"]
    assert cli.main(["run", "quick", "--out", "run", "--material", str(folder), "--seed", "1", *words]) == 0
    (job,) = load_run(tmp_path / "run").jobs
    for seed in (0, 1):
        assert cli.main(["encode", str(folder), *words, "--seed", str(seed), "-o", f"{seed}.nbtf"]) == 0
    settings = {"steps": 3, "latents": 2}
    script = bench.encode(bench.open(folder), "neubtf-direct", "script.nbtf", seed=1, **settings)
    assert job["score_key"]["sha256"] == script.sha256 == container.read_header(Path("1.nbtf")).sha256
    assert container.read_header(Path("0.nbtf")).sha256 != script.sha256


def test_a_suite_of_a_script_may_hold_any_character():
    suite = {"description": "é 🎨 \n", "materials": ["satin"], "codecs": [{"codec": "pca"}]}
    assert parse_suite("script", library._as_toml(suite)).description == "é 🎨 \n"
    with pytest.raises(InputError, match="uniform must be a finite number"):
        parse_suite("script", library._as_toml(suite | {"uniform": float("inf")}))


@pytest.mark.long
def test_a_script_runs_a_suite_as_the_command_does_and_gets_a_frame(tmp_path, folder):
    words = ["run", "quick", "--out", "run", "--material", str(folder), "--codec", "pca"]
    assert cli.main(words) == 0
    frame = bench.run("quick", "script", materials=[str(folder)], codecs=["pca"])
    of_command = bench.load_runs("run")
    for column in ("label", "sha256"):
        assert list(frame[column]) == list(of_command[column])
    suite = {
        "materials": [{"name": "mine", "path": folder}],
        "codecs": [{"codec": "mean-colour"}, {"codec": "pca", "components": [2, 3]}],
        "seeds": [0],
    }
    frame = bench.run(suite, "dictionary")
    assert list(frame["label"]) == ["mean-colour", "pca components=2", "pca components=3"]
    assert set(frame["material"]) == {"mine"}
    assert (frame["status"] == "ok").all()
    with pytest.raises(InputError, match=r"bench\.run.*object"):
        bench.run(suite | {"seeds": object()}, "dictionary")


@pytest.mark.long
@pytest.mark.usefixtures("decodes_here")
def test_a_script_checks_a_codec_as_the_command_does():
    results = list(bench.check("mean-colour", half=False))
    assert len(results) > 20
    assert not any(result.failure for result in results)


def test_ranges_of_pairs_are_slices_and_objects_say_what_they_are(folder):
    btf = bench.open(folder)
    np.testing.assert_array_equal(btf[2:5], np.stack([btf[2], btf[3], btf[4]]))
    assert btf[:0].shape == (0, *btf.shape, 3)
    split = btf.split()
    assert f"{len(split.train):,} training pairs" in repr(split)
    header = bench.encode(btf, "mean-colour", "a.nbtf")
    assert f"{header.file_bytes:,} bytes" in repr(header)


@pytest.mark.long
def test_a_script_fits_to_a_scene_as_a_run_does(tmp_path, folder):
    """A learned codec, too, whose samples are drawn by the demand."""
    demand_of(camera(16, 12, 30, [0, -0.8, 1.4]) + surface(size=[1, 1]) + SUN).save(tmp_path / "scene.npz")
    steps = ["--set", "neubtf-direct.steps=3", "--set", "scene=true"]
    codecs = ["--codec", "pca", "--codec", "neubtf-direct"]
    words = ["run", "quick", "--out", "run", "--material", str(folder), "--scene", "scene.npz", *codecs, *steps]
    assert cli.main(words) == 0
    measured = {job["codec"]: job for job in load_run(tmp_path / "run").jobs if job["settings"].get("scene")}
    assert set(measured) == {"pca", "neubtf-direct"}
    btf = bench.open(folder)
    for name, job in measured.items():
        header = bench.encode(btf, name, f"{name}.nbtf", demand="scene.npz", **job["settings"])
        assert header.sha256 == job["score_key"]["sha256"], name
        assert header.scene
    with pytest.raises(InputError, match=r"demand.*scene=True"):
        bench.encode(btf, "pca", "c.nbtf", demand="scene.npz")
    assert not Path("c.nbtf").exists()


@pytest.mark.long
def test_a_script_searches_the_smallest_file_for_a_scene_as_the_command_does(tmp_path, folder, capsys):
    demand_of(camera(16, 12, 30, [0, -0.8, 1.4]) + surface(size=[1, 1]) + SUN).save(tmp_path / "scene.npz")
    words = ["encode", str(folder), "--codec", "pca", "--set", "components=4", "--scene", "scene.npz"]
    code = cli.main([*words, "-o", "command.nbtf"])
    shown = capsys.readouterr().out
    goal = bench.SceneGoal(tmp_path / "scene.npz")
    found = bench.encode_for_scene(bench.open(folder), "pca", "script.nbtf", goal, components=4)
    assert code == 0
    assert found.search.met
    assert found.described().partition(".")[0] in shown
    assert found.rows[0]["model"] == "full"
    assert Path("script.nbtf").read_bytes() == Path("command.nbtf").read_bytes()
    unreachable = bench.SceneGoal("scene.npz", psnr=99.0)
    missed = bench.encode_for_scene(bench.open(folder), "pca", "script.nbtf", unreachable, components=1)
    assert not missed.search.met
    assert missed.described() != found.described()


@pytest.mark.long
def test_a_file_is_scored_as_by_a_run_or_at_another_draw_of_pairs(tmp_path, capsys):
    size = {"size": 8, "views": 4, "lights": 4, "heldout": 6, "low_light": 2, "between": 2}
    changes = [word for key, value in size.items() for word in ("--set", f"data.{key}={value}")]
    assert (
        cli.main(
            ["run", "quick", "--out", "run", "--material", "satin", "--codec", "mean-colour", "--seed", "1", *changes]
        )
        == 0
    )
    (job,) = load_run(tmp_path / "run").jobs
    file = str(tmp_path / "run" / job["file"])
    for draw in ("0", "1"):
        assert cli.main(["score", file, "satin", *changes, "--set", f"data.seed={draw}", "--json", f"{draw}.json"]) == 0
    assert json.loads(Path("0.json").read_text())["scores"] == job["scores"]  # whatever the seed of the fit
    assert json.loads(Path("1.json").read_text())["scores"] != job["scores"]
    first = bench.open("satin", **size)
    assert not np.array_equal(first.wo, bench.open("satin", **size, seed=1).wo)
    assert np.array_equal(first.wo, bench.open("satin", **size, seed=0).wo)
    assert cli.main(["score", file, "satin", "--set", "data.seed=x"]) == 2
    assert "data.seed" in capsys.readouterr().err


def test_a_command_does_not_write_over_what_it_reads(folder, capsys):
    btf = bench.open(folder)
    np.savez("measured.npz", radiance=np.stack(list(btf)), wo=btf.wo, wi=btf.wi)
    before = Path("measured.npz").read_bytes()
    Path("link.npz").symlink_to("measured.npz")
    for words in (
        ["encode", "measured.npz", "--codec", "mean-colour", "-o", "measured.npz"],
        ["encode", "link.npz", "--codec", "mean-colour", "-o", "measured.npz"],
        ["convert", "measured.npz", "-o", "./measured.npz"],
    ):
        assert cli.main(words) == 2
        assert re.search(r"measured\.npz: .*--out", capsys.readouterr().err)
    assert cli.main(["info", "measured.npz", "--picture", "measured.npz"]) == 2
    assert re.search(r"measured\.npz: .*--picture", capsys.readouterr().err)
    assert cli.main(["encode", str(folder), "--codec", "mean-colour", "-o", "measured.npz"]) == 2
    assert re.search(r"measured\.npz: .*another kind", capsys.readouterr().err)
    assert cli.main(["encode", "measured.npz", "--codec", "mean-colour", "-o", "."]) == 2
    assert "a folder" in capsys.readouterr().err
    assert cli.main(["encode", "measured.npz", "--codec", "mean-colour", "-o", "a.nbtf"]) == 0
    assert cli.main(["convert", "measured.npz", "-o", "pictures"]) == 0
    picture = next(Path("pictures").glob("*.exr"))
    assert cli.main(["render", "a.nbtf", "--truth", "pictures", "-o", str(picture)]) == 2
    assert f"{picture}: " in capsys.readouterr().err
    assert Path("measured.npz").read_bytes() == before


def test_encoding_takes_a_name_with_settings_or_a_codec(folder, capsys):
    btf = bench.open(folder)
    header = bench.encode(btf, "pca", "a.nbtf", components="3")
    assert header.settings["components"] == 3
    made = load_codec("pca")(components=3)
    assert bench.encode(btf, made, "b.nbtf").sha256 == header.sha256
    with pytest.raises(InputError, match="components"):
        bench.encode(btf, made, "c.nbtf", components=4)
    with pytest.raises(InputError, match="components"):
        bench.encode_for_scene(btf, made, "c.nbtf", bench.SceneGoal("a.npz"), components=4)
    with pytest.raises(InputError, match=r"data\.sise.*'size'"):
        bench.open("satin", sise=8)
    with pytest.raises(InputError, match="threads = 0"):
        bench.encode(btf, "mean-colour", "c.nbtf", threads=0)
    with pytest.raises(InputError, match=r"bench\.encode_for_scene.*'satin'"):
        bench.encode_for_scene("satin", "pca", "c.nbtf", "a.npz")
    with pytest.raises(InputError, match=r"bench\.SceneGoal.*'a\.npz'"):
        bench.encode_for_scene(tiny_btf(), "pca", "a.nbtf", "a.npz")
    with pytest.raises(InputError, match=r"quantum.*cuda"):
        bench.load("a.nbtf", device="quantum")
    with pytest.raises(InputError, match=r"'satin'.*bench\.open"):
        bench.encode("satin", "pca", "c.nbtf")
    with pytest.raises(InputError, match=r"bench\.score.*ndarray.*bench\.from_arrays"):
        bench.score(np.zeros((3, 8, 8, 3)), btf)
    with pytest.raises(InputError, match=r"bench\.score.*'satin'"):
        bench.score("a.nbtf", "satin")
    with pytest.raises(InputError, match="scene = true"):
        bench.encode(btf, "pca", "c.nbtf", scene=True)
    assert cli.main(["encode", str(folder), "--codec", "pca", "--set", "scene=true", "-o", "c.nbtf"]) == 2
    assert "scene = true" in capsys.readouterr().err
    assert not Path("c.nbtf").exists()


def test_a_file_of_another_resolution_is_not_scored(folder):
    btf = bench.open(folder)
    bench.encode(btf, "mean-colour", "a.nbtf")
    with pytest.raises(InputError, match=r"12 × 12.*6 × 6"):
        bench.score("a.nbtf", btf.downsample(2))
    write_folder(btf.subset(range(5, len(btf))), "few")
    with pytest.raises(InputError, match=f"^few: .* 5 of the {len(btf)} "):
        bench.score("few", btf)
    Path("a.nbtf").write_bytes(b"no codec file")
    with pytest.raises(ContainerError):
        bench.score("a.nbtf", btf)


def test_arrays_become_a_btf_that_is_encoded_and_scored(folder):
    example = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.S)[1]
    names = {}
    exec(example, names)
    assert names["found"]["bytes"]["total"] == Path("mine.nbtf").stat().st_size
    own, btf = names["own"], names["btf"]
    assert re.match(f"<BTF mine: 8 × 8 .*{len(own)} .*6 ", repr(own))
    for i in range(len(btf)):
        np.testing.assert_array_equal(own[i], btf[i])
    radiance, wo, wi = names["radiance"], btf.wo, btf.wi
    for (values, views, lights, *heldout), message in (
        ((radiance[0], wo, wi), r"radiance is \(8, 8, 3\)"),
        ((radiance.transpose(0, 3, 1, 2), wo, wi), r"radiance.transpose\(0, 2, 3, 1\)"),
        (((255 * radiance).astype(np.uint8), wo, wi), "255"),
        ((np.where(radiance == radiance[3, 0, 0, 0], np.nan, radiance), wo, wi), r"radiance\[3\]: .* repair=True"),
        ((radiance, wo[:, [0, 2, 1]], wi), "is y up"),
        ((radiance, wo[:-1], wi), "wo is"),
        ((radiance, wo > 0, wi), r"wo is \(\d+, 3\) bool"),
        ((radiance, wo, 2 * wi), r"wi\[0\]: .* unit vector"),
        ((radiance, 0 * wo + wo[0], 0 * wi + wi[0]), "pair 1: .* pair 0"),
        ((radiance, wo, wi, np.ones(len(wo), bool)), "heldout"),
    ):
        with pytest.raises(InputError, match=message):
            bench.from_arrays(values, views, lights, **({"heldout": heldout[0]} if heldout else {}))


def test_negative_radiance_and_radians_are_warned_of(tmp_path, caplog):
    made = tiny_btf()
    values = np.stack(list(made))
    values[:, 0, 0] = -0.5
    btf = bench.from_arrays(values, made.wo, made.wi)
    said = r"arrays: 1\.56% .*-0\.5"
    assert re.search(said, caplog.text)
    caplog.clear()
    bench.encode(btf, "mean-colour", tmp_path / "a.nbtf")
    assert re.search(said, caplog.text)
    caplog.clear()
    small = from_degrees(np.linspace(0.1, 1.5, 81), np.linspace(0, 6.2, 81))
    bench.from_arrays(np.maximum(values, -1e-6), small, made.wi)
    assert "theta_o" in caplog.text  # each column is judged alone
    assert "theta_i" not in caplog.text
    bench.from_arrays(np.maximum(values, -1e-6), small, small)
    assert "wo and wi" in caplog.text


@pytest.mark.parametrize(
    ("factor", "fault"),
    [
        (1e-19, r"the 99th percentile of its values is \S+e-20, below 1e-12, .*: multiply it by 1e\+\d\d in float64"),
        (1e-42, r"the 99th percentile of its values is \S+e-4\d, below 1e-12, .*: multiply it by 1e\+4\d in float64"),
        (1e19, r"its largest value is \S+e\+\d\d, above 1e\+12, .*: multiply it by 1e-\d\d in float64"),
    ],
)
def test_radiance_that_no_record_could_hold_is_refused_before_the_fit(tmp_path, capsys, factor, fault):
    made = tiny_btf()
    values = np.stack(list(made))
    np.savez(tmp_path / "x.npz", radiance=(values * factor).astype(np.float32), wo=made.wo, wi=made.wi)
    btf = bench.open(tmp_path / "x.npz")
    with pytest.raises(InputError, match=rf"^x: {fault}$"):
        bench.encode(btf, "mean-colour", tmp_path / "x.nbtf")
    bench.encode(made, "mean-colour", tmp_path / "made.nbtf")
    with pytest.raises(InputError, match=rf"^x: {fault}$"):
        bench.score(tmp_path / "made.nbtf", btf)
    assert cli.main(["encode", str(tmp_path / "x.npz"), "--codec", "mean-colour", "-o", str(tmp_path / "x.nbtf")]) == 2
    assert not (tmp_path / "x.nbtf").exists()
    capsys.readouterr()
    out = str(tmp_path / "run")
    run = ["run", "quick", "--material", str(tmp_path / "x.npz"), "--codec", "mean-colour", "--out", out]
    assert cli.main(run) == 2
    assert re.fullmatch(f"neubtf-bench: x: {fault}\n", capsys.readouterr().err)
    assert list(load_run(out).jobs) == []


def test_black_data_and_a_scale_far_from_1_are_no_extremes(tmp_path):
    made = tiny_btf()
    values = np.stack(list(made))
    for factor in (0, 1e-8, 1e8):
        btf = bench.from_arrays(values * np.float32(factor), made.wo, made.wi)
        bench.encode(btf, "mean-colour", tmp_path / "a.nbtf")
        assert bench.score(tmp_path / "a.nbtf", btf)["bytes"]


def test_what_is_no_name_or_path_is_told_where_arrays_go_and_not_printed():
    with pytest.raises(InputError, match=r"dict.*bench\.from_arrays"):
        bench.open({"radiance": np.zeros((4, 2, 2, 3))})


@pytest.mark.long
def test_a_setting_that_a_material_has_not_is_told_with_the_one_it_has(folder, capsys):
    with pytest.raises(InputError, match=r"data\.size: btf .*data\.texels"):
        bench.open(folder, size=8)
    with pytest.raises(InputError, match=r"data\.texels: satin .*data\.size"):
        bench.open("satin", texels=8)
    with pytest.raises(InputError, match=r"data\.renderer: btf "):
        bench.open(folder, renderer="builtin")
    for setting, value, remedy in (("pairs", 9, "data.views.*data.lights"), ("repair", True, "")):
        with pytest.raises(InputError, match=rf"data\.{setting}: satin .*{remedy}"):
            bench.open("satin", **{setting: value})
    words = ["run", "quick", "--material", str(folder), "--codec", "mean-colour", "--out", "run"]
    assert cli.main([*words, "--set", "data.size=8"]) == 2
    assert "data.size: btf " in capsys.readouterr().err
    assert cli.main([*words, "--material", "satin", "--set", "data.size=8"]) == 0, "satin has a size"
    assert re.search(r"data\.size=8: btf .*data\.texels", capsys.readouterr().out)


@pytest.mark.long
def test_a_material_and_a_folder_of_slices_score_as_the_file_they_come_from(folder, capsys):
    btf = bench.open(folder)
    bench.encode(btf, "pca", "a.nbtf", components=3)
    material, from_file = bench.load("a.nbtf"), bench.score("a.nbtf", btf)
    assert repr(material).startswith("<PCAMaterial: 12 × 12 ")
    from_material = bench.score(material, btf)
    assert from_material["scores"] == from_file["scores"]
    assert from_material["footprints"] == from_file["footprints"]
    assert cli.main(["decode", "a.nbtf", "--like", str(folder), "-o", "slices"]) == 0
    from_slices = bench.score("slices", btf)
    assert bench.score(bench.open("slices"), btf)["scores"] == from_slices["scores"]
    for metric, stats in from_file["scores"]["heldout"]["metrics"].items():
        assert from_slices["scores"]["heldout"]["metrics"][metric]["mean"] == pytest.approx(stats["mean"], rel=1e-6)
    psnr = from_slices["scores"]["heldout"]["metrics"]["psnr_display"]["mean"]
    assert cli.main(["score", "slices", str(folder)]) == 0
    assert f"{psnr:.2f}" in capsys.readouterr().out


def test_the_command_prints_the_table_of_a_run_and_writes_json(folder, capsys):
    assert cli.main(["encode", str(folder), "--codec", "pca", "--set", "components=3", "-o", "a.nbtf"]) == 0
    capsys.readouterr()
    assert cli.main(["score", "a.nbtf", str(folder), "--json", "a.json"]) == 0
    shown = capsys.readouterr().out
    assert re.search(r"^pca components=3  +\d", shown, re.M), "and no setting that is a default"
    assert f"{Path('a.nbtf').stat().st_size:,}" in shown
    found = json.loads(Path("a.json").read_text())
    mean = found["scores"]["heldout"]["metrics"]["psnr_display"]["mean"]
    assert f"{mean:.2f}" in shown
    assert container.read_header("a.nbtf").sha256 == found["score_key"]["sha256"]
    assert cli.main(["score", "a.nbtf", str(folder), "--set", "components=4"]) == 2
    assert "only data.KEY" in capsys.readouterr().err


def test_version_and_author_are_the_same_wherever_they_stand():
    root = PAGE.parents[1]
    project = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    citation = (root / "CITATION.cff").read_text(encoding="utf-8")
    assert f"\nversion: {project['version']}\n" in citation
    assert f"- name: {project['authors'][0]['name']}\n" in citation
    assert project["authors"][0]["name"] in (root / "LICENSE").read_text(encoding="utf-8")
    assert bench.__version__ == project["version"]


@pytest.mark.long
def test_the_longest_name_of_a_material_leaves_room_for_every_file_of_a_run(tmp_path):
    made, name = tiny_btf(), "a" * 196 + ".npz"
    np.savez(tmp_path / name, radiance=np.stack(list(made)), wo=made.wo, wi=made.wi)
    out = str(tmp_path / "run")
    codec = ["--codec", "neubtf"]  # whose label is long with a few changed settings
    for setting in ("steps=2", "optimiser=adam", "activation=relu", "weights=float32", "init=published"):
        codec += ["--set", setting]
    assert cli.main(["run", "quick", "--material", str(tmp_path / name), *codec, "--out", out]) == 0
    assert {job["status"] for job in load_run(out).jobs} == {"ok"}
