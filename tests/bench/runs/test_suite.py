import dataclasses
import json
import re
from pathlib import Path

import pytest

from bench import cli
from bench.codecs.registry import load_codec, make_codec
from bench.data.spec import MaterialSpec, Preparation
from bench.inputs.errors import InputError
from bench.inputs.settings import descriptions
from bench.runs.suite import (
    CodecSpec,
    Suite,
    builtin_suites,
    canonical,
    load_suite,
    parse_suite,
    with_changes,
    with_metrics,
)

TEXT = """
threads = 1
seeds = [0, 1]
materials = ["satin", {name = "fabric", path = "ubo/fabric.btf", where = "ask for it"}]
[data]
size = 16
[[codecs]]
codec = "mean-colour"
[[codecs]]
codec = "pca"
components = [2, 4]
domain = ["log", "rgb"]
"""


def test_lists_are_sweeps_and_labels_say_what_differs_from_the_defaults():
    suite = parse_suite("test", TEXT)
    swept = [f"pca components={count} domain={domain}" for count in (2, 4) for domain in ("log", "rgb")]
    assert [spec.label for spec in suite.codecs] == ["mean-colour", *swept]
    assert (suite.threads, suite.seeds, suite.data.size, suite.data.views) == (1, (0, 1), 16, 25)
    assert [(m.name, m.path) for m in suite.materials] == [("satin", ""), ("fabric", "ubo/fabric.btf")]


def test_a_codec_may_be_run_on_some_of_the_materials_but_the_command_line_asks_for_all_of_its_own():
    suite = parse_suite("test", TEXT.replace('"mean-colour"', '"mean-colour"\nmaterials = ["fabric"]'))
    of_mean = [(m.name, seed) for m, codec, seed in suite.cells if codec.codec == "mean-colour"]
    assert (of_mean, len(suite.cells)) == ([("fabric", 0), ("fabric", 1)], 2 + 2 * 4 * 2)
    assert len(with_changes(suite, ["satin"], [], {}).cells) == 5 * 2


def test_entries_that_a_default_makes_equal_need_equal_seeds():
    """Else the seeds of one would be lost, and a material be run with those of the other."""
    suite = parse_suite("test", TEXT)
    first = CodecSpec("pca", {}, (), ("satin",), (0,))
    second = CodecSpec("pca", {"components": 16}, (), ("fabric",), (1, 2))  # the default, spelled out
    with pytest.raises(InputError, match=r"'pca'.*seeds"):
        canonical(dataclasses.replace(suite, codecs=(first, second)))
    (merged,) = canonical(dataclasses.replace(suite, codecs=(first, dataclasses.replace(second, seeds=(0,))))).codecs
    assert (merged.materials, merged.seeds) == (("satin", "fabric"), (0,))


def test_a_codec_may_have_seeds_of_its_own_but_the_command_line_overrides_them():
    suite = parse_suite("test", TEXT.replace('"mean-colour"', '"mean-colour"\nseeds = [3, 5]\nmaterials = ["satin"]'))
    assert [seed for _, codec, seed in suite.cells if codec.codec == "mean-colour"] == [3, 5]
    assert {seed for _, codec, seed in suite.cells if codec.codec != "mean-colour"} == set(suite.seeds)
    assert {seed for *_, seed in with_changes(suite, [], [], {}, [7]).cells} == {7}


@pytest.mark.parametrize("name", builtin_suites())
def test_every_built_in_suite_names_materials_and_codecs_that_exist(name):
    from bench.data.materials import names

    suite = load_suite(name)
    assert suite.description
    assert suite.materials
    for spec in suite.codecs:
        load_codec(spec.codec)(**spec.settings)
    for material in suite.materials:
        assert material.where if material.path else material.name in names()


def test_a_suite_is_scored_at_test_pairs_but_where_it_says_validation():
    suite = parse_suite("test", TEXT)
    assert suite.data.split == "test"
    assert suite.data.described(3).startswith("150 test")
    assert parse_suite("test", TEXT.replace("size = 16", 'split = "validation"')).data.split == "validation"
    assert with_changes(suite, [], [], {"data.split": "validation"}).data.split == "validation"
    choosing = with_changes(suite, [], [], {"data.validation": "true"})
    together = {"data.split": "validation", "data.validation": "false"}  # in this order, alone they do not go together
    assert with_changes(choosing, [], [], together).data.split == "validation"
    with pytest.raises(InputError, match=r"split.*'validation'.*'tests'"):
        with_changes(suite, [], [], {"data.split": "tests"})


def test_entries_that_a_change_makes_equal_run_on_the_materials_of_both():
    text = """
    materials = ["satin", "brick"]
    codecs = [
        {codec = "pca", components = 4, materials = ["satin"]},
        {codec = "pca", components = 8, materials = ["brick"]},
        {codec = "vq", codes = 8},
        {codec = "vq", codes = 9, materials = ["brick"]},
    ]
    """
    changes = {"pca.components": "2", "vq.codes": "4"}
    suite = with_changes(parse_suite("test", text), [], [], changes)
    assert {spec.codec: spec.materials for spec in suite.codecs} == {"pca": ("satin", "brick"), "vq": ()}


def test_the_setting_scene_of_every_codec_may_be_changed_by_a_word():
    changed = with_changes(parse_suite("test", '[[codecs]]\ncodec = "pca"\n'), [], [], {"pca.scene": "yes"})
    assert changed.codecs[0].settings == {"scene": True}
    with pytest.raises(InputError, match=r"scene.*pca.*'maybe'"):
        load_codec("pca")(scene="maybe")


def test_a_row_has_one_name_however_it_is_spelled():
    suite = parse_suite("test", TEXT + '\n[[codecs]]\ncodec = "pca"\nscene = false\nmaterials = ["satin"]\n')
    suite = with_changes(suite, [], [], {"pca.components": "16"})
    assert [spec.label for spec in suite.codecs] != ["mean-colour", "pca", "pca domain=rgb"]
    assert [spec.label for spec in canonical(suite).codecs] == ["mean-colour", "pca", "pca domain=rgb"]
    assert [spec.materials for spec in canonical(suite).codecs] == [(), (), ()]
    swept = canonical(parse_suite("test", TEXT.replace("[2, 4]", "[8, 16]"))).codecs
    labels = ["pca components=8", "pca components=8 domain=rgb", "pca", "pca domain=rgb"]
    assert [spec.label for spec in swept[1:]] == labels
    assert {spec.curve for spec in swept[1:]} == {"pca"}


OURS = [("neubtf", "steps", 2500), ("neubtf", "optimiser", "muon"), ("neubtf-direct", "start", "mixed")]
OURS += [("rainer2019", "directions", "xyzh"), ("neumip", "blur", False), ("ntc", "reduction", 1)]
OURS += [("hsh", "cosine", True)]


@pytest.mark.parametrize(("codec", "name", "value"), OURS)
def test_no_setting_is_dropped_whose_default_the_recipe_has_changed(codec, name, value):
    assert getattr(load_codec(codec)().settings, name) == value
    words = str(value).lower()
    changes = {f"{codec}.recipe": "paper", f"{codec}.{name}": words}
    (spec,) = canonical(with_changes(parse_suite("a", ""), [], [codec], changes)).codecs
    assert set(spec.label.split()) == {codec, "recipe=paper", f"{name}={words}"}
    assert getattr(make_codec(spec.codec, spec.settings).settings, name) == value


@pytest.mark.parametrize("name", ["data.sise=8", "data.size=big", "flavour=8", "table.components=8", "components=x"])
def test_a_bad_setting_on_the_command_line_is_named(name):
    setting, value = name.split("=")
    with pytest.raises(InputError, match=setting.split(".")[-1].replace("sise", "size")):
        with_changes(parse_suite("test", TEXT), [], [], {setting: value})


@pytest.mark.parametrize(
    ("key", "says"),
    [
        ("pca.componets", "no codec of this run has a setting 'componets'; did you mean 'components'?"),
        ("componets", "did you mean 'components'?"),
        ("heldot", "did you mean 'data.heldout'?"),
        ("pcb.components", "it runs no codec 'pcb'; did you mean 'pca'?"),
        ("steps", "a setting 'steps': `neubtf-bench list codecs"),  # pca has none, and no key of the data is near
        ("qqqq", "a setting 'qqqq': `neubtf-bench list codecs"),
    ],
)
def test_a_misspelled_setting_suggests_the_nearest(key, says):
    with pytest.raises(InputError, match=says):
        with_changes(load_suite("quick"), [], ["pca"], {key: "1"})


def test_an_unknown_suite_suggests_the_nearest_and_a_missing_file_is_named():
    with pytest.raises(InputError, match=r"'quik'.*'quick'"):
        load_suite("quik")
    with pytest.raises(InputError, match=r"absent\.toml: "):
        load_suite("absent.toml")


def test_the_command_line_chooses_materials_codecs_settings_and_seed(tmp_path):
    suite = parse_suite("test", TEXT)
    chosen = with_changes(suite, ["brick", str(tmp_path)], ["pca", "table"], {"pca.components": "3"}, [7])
    assert [(m.name, m.path) for m in chosen.materials] == [("brick", ""), (tmp_path.name, str(tmp_path))]
    # The sweep over components has become one value: four jobs are two.
    labels = ["pca components=3 domain=log", "pca components=3 domain=rgb", "table"]
    assert [spec.label for spec in chosen.codecs] == labels
    assert chosen.codecs[0].settings == {"components": 3, "domain": "log"}
    assert chosen.codecs[0].curve == "pca"
    assert chosen.seeds == (7,)
    assert with_changes(suite, [], [], {"data.size": "8"}).data.size == 8
    assert with_changes(suite, [], [], {}, [2, 0]).seeds == (2, 0)
    with pytest.raises(InputError, match="--seed: '2' appears twice"):
        with_changes(suite, [], [], {}, [2, 0, 2])


def test_two_paths_of_one_name_are_two_materials(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for place in ("coin/rti/dirs.lp", "tablet/rti/dirs.lp", "tablet/other/dirs.lp", "satin"):
        Path(place).parent.mkdir(parents=True, exist_ok=True)
        Path(place).write_text("")

    def names(*materials):
        suite = with_changes(load_suite("quick"), list(materials), ["pca"], {})
        return [spec.name for spec in suite.materials]

    assert names("coin/rti", "tablet/rti") == ["coin-rti", "tablet-rti"]
    assert names("tablet/rti/dirs.lp", "tablet/other/dirs.lp") == ["rti-dirs.lp", "other-dirs.lp"]
    assert names("coin/rti/dirs.lp", "tablet/rti/dirs.lp") == ["coin-rti-dirs.lp", "tablet-rti-dirs.lp"]
    assert names("coin/rti/dirs.lp", "satin") == ["dirs.lp", "satin"]
    with pytest.raises(InputError, match="coin/rti: "):
        names("coin/rti", "./coin/rti")


def test_a_suite_may_name_the_demand_of_a_scene_and_codecs_that_are_fitted_to_it():
    text = 'demand = "wall.npz"\nuniform = 0.25\nmaterials = ["satin"]\n'
    text += '[[codecs]]\ncodec = "pca"\nscene = [false, true]\n'
    suite = parse_suite("a", text)
    assert (suite.demand, suite.uniform) == ("wall.npz", 0.25)
    assert [spec.settings["scene"] for spec in suite.codecs] == [False, True]
    assert len({spec.curve for spec in suite.codecs}) == 2  # no ladder of rates mixes the two
    with pytest.raises(InputError, match=r"uniform .*1\.5"):
        parse_suite("a", text.replace("0.25", "1.5"))
    changed = with_changes(suite, [], [], {"scene": "true"})
    assert [spec.settings["scene"] for spec in changed.codecs] == [True]


def test_a_suite_chooses_its_metrics_and_the_command_line_adds_some():
    assert parse_suite("test", TEXT).metrics[:2] == ("psnr_display", "psnr_log1p")
    suite = parse_suite("test", 'metrics = ["flip_hdr_67ppd"]\n' + TEXT)
    assert suite.metrics == ("psnr_display", "flip_hdr_67ppd")
    assert with_metrics(suite, ["ssim", "psnr_display"]).metrics == ("psnr_display", "flip_hdr_67ppd", "ssim")
    with pytest.raises(InputError, match=r"test: metrics: .*'flipp'"):
        parse_suite("test", 'metrics = ["flipp"]\n' + TEXT)
    with pytest.raises(InputError, match=r"--metric: .*'ssm'"):
        with_metrics(suite, ["ssm"])


ATTACKS = [
    ("size = 16", "heldout = 1_000_000_000", "data: heldout must be"),
    ("size = 16", "size = 8192\nheldout = 100_000", "data: 8192 × 8192 texels at 25 × 25 + 100000 pairs are"),
    ("size = 16", "size = nan", "data: size must be"),
    ("size = 16", 'size = "16"', "data: size must be"),
    ("size = 16", "sise = 16", "data: no key 'sise'; did you mean 'size'?"),
    ("size = 16", "repair = 1", "data: repair must be"),
    ("size = 16", 'split = "tests"', "split"),
    ("size = 16", 'directions = "ubo"', "data: directions: unknown direction set 'ubo': there are ubo2003, ubo2014"),
    ("size = 16", "lights = 82", "data: lights must be from 1 to the 81 of ubo2003, not 82"),
    ("[data]\nsize = 16", "data = [1]", "data must be a table"),
    ("threads = 1", "thraeds = 1", "no key 'thraeds'; did you mean 'threads'?"),
    ("threads = 1", "threads = 100000", "threads must be"),
    ("threads = 1", "threads = 0x" + "f" * 9000, "threads must be"),
    ("threads = 1", "threads = " + "9" * 9000, "not TOML"),
    ("threads = 1", "uniform = inf", "uniform must be"),
    ("seeds = [0, 1]", "seeds = [-1]", "seeds must be"),
    ("seeds = [0, 1]", "seeds = [true]", "seeds must be"),
    ("seeds = [0, 1]", "seeds = 0", "seeds must be a list"),
    ("threads = 1", f"variants = {'[' * 5000}{']' * 5000}", "nested too deeply"),
    ("threads = 1", "demand = [[[[1]]]]", "demand must be a text"),
    ("components = [2, 4]", "components = [[2], 4]", "codecs.components must be"),
    ("components = [2, 4]", "components = inf", "codecs.components must be"),
    ("components = [2, 4]", "passes = 1_000_000_000", "setting passes of codec pca must be"),
    ('"mean-colour"', '"mean-colour"\nseeds = [2, 2]', "codecs.seeds: '2' appears twice"),
    ('"mean-colour"', '"mean-colour"\nmaterials = ["silk"]', "codecs.materials names 'silk'"),
    ('codec = "mean-colour"', "half = true", "codecs.codec must be a text"),
    ('"satin", ', '"satin", "satin", ', "materials: 'satin' appears twice: give one of them another name"),
    ("seeds = [0, 1]", "seeds = [1, 1]", "seeds: '1' appears twice: leave one out"),
    ("components = [2, 4]", "components = [2, 2]", "'pca components=2 domain=log' appears twice: leave one out"),
    ("components = [2, 4]", "components = []", "codecs.components is an empty list"),
    ("materials = [", "materials = [7, ", "materials must be a table"),
    ("threads = 1", "variants = " + "'" + "x" * (1 << 20) + "'", "larger than 1 MiB"),
    ("components = [2, 4]", "\n".join(f"{name} = {list(range(100))}" for name in "abcde"), "the limit is 100,000"),
    ("seeds = [0, 1]", f"seeds = {list(range(50_000))}", "it has 500,000 jobs"),
]


@pytest.mark.parametrize(("old", "new", "message"), ATTACKS, ids=[f"{a[1]:.24}" for a in ATTACKS])
def test_an_absurd_suite_is_refused_before_anything_is_done(old, new, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "bad.toml").write_text(TEXT.replace(old, new, 1))
    assert cli.main(["run", "bad.toml"]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert len(error) < 400
    assert list(tmp_path.iterdir()) == [tmp_path / "bad.toml"]


def test_jobs_are_counted_on_the_materials_that_a_codec_names():
    materials = ", ".join(f'{{name = "m{number}", path = "m{number}.npz"}}' for number in range(400))
    text = f'seeds = {list(range(200))}\nmaterials = [{materials}]\n[[codecs]]\ncodec = "pca"\nmaterials = ["m0"]'
    for more in ("", '\n[[codecs]]\ncodec = "vq"'):
        assert parse_suite("small", text + more).materials  # 200 jobs, then 80,200
    with pytest.raises(InputError, match="160,200 jobs"):
        parse_suite("large", text + '\n[[codecs]]\ncodec = "vq"\n[[codecs]]\ncodec = "table"')


def test_threads_of_the_command_line_have_a_limit_too(capsys):
    with pytest.raises(SystemExit):
        cli.main(["encode", "satin", "--codec", "pca", "-o", "a.nbtf", "--threads", "100000"])
    assert re.search("--threads.* 1,024.* '100000'", capsys.readouterr().err)


PAGE = (Path(__file__).parents[3] / "docs" / "suites.md").read_text(encoding="utf-8")


def documented(section):
    """The rows of the table in a section of the page, by key: what a value must be, and its default."""
    text = re.search(rf"^## {section}$(.*?)(?=^## |\Z)", PAGE, re.M | re.S)[1]
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in text.splitlines() if "| `" in line[:4]]
    assert all(row[-1] for row in rows), "a meaning"
    return {row[0].strip("`"): (row[1], row[2].strip("`")) for row in rows}


def as_toml(value):
    if isinstance(value, tuple):
        return f"[{', '.join(map(as_toml, value))}]"
    return json.dumps(value)


def expected(kind, without=()):
    """The same of the fields of a dataclass, in the words of its error messages."""
    words = {each.name: each.kind for each in descriptions(kind)}
    found = {}
    for field in dataclasses.fields(kind):
        if field.name not in without:
            required = field.default is dataclasses.MISSING
            found[field.name] = (words[field.name], "required" if required else as_toml(field.default))
    return found


def test_the_page_of_suites_has_every_key_with_its_values_and_its_default():
    of_suite, tables = documented("The suite"), ("data", "materials", "codecs")  # these have sections of their own
    assert [of_suite.pop(key)[1] for key in tables] == ["{}", "[]", "[]"]
    assert of_suite == expected(Suite, without=("name", "text", *tables))
    assert documented("Data") == expected(Preparation)
    assert documented("Materials") == expected(MaterialSpec)
    assert documented("Codecs") == expected(CodecSpec, without=("settings", "swept"))  # made of all other keys


def test_the_suite_of_the_page_is_what_its_comments_say():
    (text,) = re.findall(r"^```toml\n(.*?)^```$", PAGE, re.S | re.M)
    suite = canonical(parse_suite("my", text))
    assert [spec.name for spec in suite.materials] == ["satin", "cloth.npz", "wool"]
    labels = [spec.label for spec in suite.codecs]
    assert labels == [
        "pca components=8",
        "pca components=8 domain=rgb",
        "pca",
        "pca domain=rgb",
        "neubtf-direct steps=500",
    ]
    assert len(suite.cells) == 2 * (3 * 4 + 1)


def test_settings_of_the_data_of_a_suite_without_materials_are_kept():
    suite = parse_suite("test", '[[codecs]]\ncodec = "pca"\n')
    assert with_changes(suite, [], [], {"data.size": "8"}).data.size == 8


@pytest.mark.parametrize("name", ["", " "])
def test_a_material_has_a_name(name):
    with pytest.raises(InputError, match="blank"):
        parse_suite("s", f'materials = [{{name = "{name}", path = "a.npz"}}]\ncodecs = [{{codec = "pca"}}]')


def test_a_suite_may_begin_with_a_byte_order_mark(tmp_path):
    text = 'materials = ["satin"]\ncodecs = [{codec = "pca"}]'
    (tmp_path / "s.toml").write_bytes(b"\xef\xbb\xbf" + text.encode())
    assert load_suite(str(tmp_path / "s.toml")).text == text
