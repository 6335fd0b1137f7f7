import argparse
import errno
import io
import logging
import re
import signal
import subprocess
import sys
from importlib.metadata import EntryPoint
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from bench import cli
from bench.cli import commands
from bench.codecs import loading
from bench.conformance.check import tiny_btf
from bench.data.readers import open_btf
from bench.data.readers.folder import write_folder
from bench.inputs.errors import InputError
from tests.tiers import short_for

SMALL = [part for key in ("size=12", "views=6", "lights=6", "heldout=4") for part in ("--set", f"data.{key}")]


pytestmark = pytest.mark.usefixtures("brief", "undrawn")


@pytest.fixture
def folder(tmp_path):
    write_folder(tiny_btf(12, 6, 6), tmp_path / "btf")
    return tmp_path / "btf"


def test_run_prints_a_table_writes_reports_and_is_cached_the_second_time(tmp_path, monkeypatch, capsys):
    words = ["run", "quick", "--out", str(tmp_path / "run"), "--material", "satin", "--codec", "mean-colour", *SMALL]
    assert cli.main(words) == 0
    out = capsys.readouterr().out
    assert "mean-colour" in out
    assert "1 ok" in out
    written = {path.suffix for path in (tmp_path / "run").rglob("*") if path.is_file()}
    assert {".jsonl", ".nbtf", ".md", ".tex", ".csv", ".png"} <= written
    assert cli.main(words) == 0
    out = capsys.readouterr().out
    assert "1 from" in out
    assert "measured again" in out
    with monkeypatch.context() as without:  # a codec of other programs, or a GPU that is not here, is not timed
        without.setattr("bench.runs.runner.timings", lambda *_: [])
        assert cli.main(words) == 0
    out = capsys.readouterr().out
    assert "1 from" in out
    assert "measured again" not in out
    assert cli.main(["table", str(tmp_path / "run"), "--format", "csv"]) == 0
    assert "mean-colour" in capsys.readouterr().out
    assert cli.main(["report", str(tmp_path / "run")]) == 0
    capsys.readouterr()
    assert cli.main(["table", "budgets", str(tmp_path / "run")]) == 4
    assert cli.main(["table", "unfinished", str(tmp_path / "run")]) == 0
    (tmp_path / "runs").mkdir()
    (tmp_path / "run").rename(tmp_path / "runs" / "run")
    monkeypatch.chdir(tmp_path)
    assert cli.main(["table", "footprints"]) == 0
    assert "mean-colour" in capsys.readouterr().out


def test_a_command_of_another_package_is_found_by_its_entry_point(tmp_path, monkeypatch, capsys):
    says = '"""shout loudly"""\narguments = lambda parser: parser.add_argument("word")\n'
    (tmp_path / "shout.py").write_text(
        f"{says}run = lambda options, terminal: terminal.say(options.word.upper()) or 0\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setattr(commands.plugins, "points", lambda group: [EntryPoint("shout", "shout", group)])
    assert cli.main(["shout", "hello"]) == 0
    assert "HELLO" in capsys.readouterr().out
    with pytest.raises(SystemExit):
        cli.main(["--help"])
    assert "shout loudly" in capsys.readouterr().out
    monkeypatch.setattr(commands.plugins, "points", lambda group: [EntryPoint("run", "shout", group)])
    assert cli.main(["list"]) == 2
    assert "'run'" in capsys.readouterr().err


def test_encode_info_and_decode_agree(tmp_path, folder, capsys):
    file = tmp_path / "a.nbtf"
    assert cli.main(["encode", str(folder), "--codec", "pca", "--set", "components=3", "-o", str(file)]) == 0
    assert cli.main(["info", str(file)]) == 0
    out = capsys.readouterr().out
    assert "codec: pca\n" in out
    assert "  components: 3\n" in out
    assert f"  total: {file.stat().st_size:,}\n" in out
    assert cli.main(["decode", str(file), "--like", str(folder), "-o", str(tmp_path / "slices")]) == 0
    decoded, material = open_btf(tmp_path / "slices"), loading.load(file)[1]
    wo, wi = decoded.wo[7].tolist(), decoded.wi[7].tolist()
    # The angles went through degrees in a text file.
    np.testing.assert_allclose(decoded[7], material.slice(wo, wi).numpy(), atol=1e-4)
    assert cli.main(["decode", str(file), "--count", "2", "-o", str(tmp_path / "four")]) == 0
    assert cli.main(["decode", str(file), "--count", "2", "--like", str(folder), "-o", str(tmp_path / "four")]) == 2
    assert len(open_btf(tmp_path / "four")) == 4


@pytest.mark.parametrize("codec", short_for(["neubtf-direct", "neumip", "relief", "pca"], "neumip", "pca"))
def test_info_shows_the_layers_that_add_up_to_the_parameters(tmp_path, folder, codec, capsys):
    file, steps = str(tmp_path / "a.nbtf"), [] if codec == "pca" else ["--set", "steps=2"]
    assert cli.main(["encode", str(folder), "--codec", codec, *steps, "-o", file]) == 0
    capsys.readouterr()
    assert cli.main(["info", file]) == 0
    decoder, *lines = capsys.readouterr().out.partition("  parameters: ")[2].splitlines()
    matches = [re.fullmatch(r"    [\w.]+ +(?:Linear|LayerNorm|Frames|Offset) +([\d,]+)", line) for line in lines]
    counted = [int(match[1].replace(",", "")) for match in matches if match]
    assert sum(counted) == int(decoder.replace(",", ""))


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["encod"], "'encode'"),
        (["reference", "update", "runs/ci"], "`compare RUN --update`"),
        (["submit", "run", "-o", "a.zip"], "`results pack`"),
        (["list", "suites", "quick"], "only codecs"),
        (["check", "pca", "--set", "components=0"], "not '0'"),
        (["run", "quik"], "'quick'"),
        (["run", "--set", "components"], "write KEY=VALUE"),
        (["run", "--codec", "pcaa"], "'pca'"),
        (["run", "--material", "satn", "--codec", "mean-colour", *SMALL], "'satin'"),
        (["run", "--material", "/no/such/btf", "--codec", "mean-colour"], "/no/such/btf: "),
        (["run", "--device", "abacus"], "abacus"),
        (["info", "/no/such/file"], "/no/such/file"),
        (["encode", "satin", "--codec", "pca", "-o", "/no/such/folder/a.nbtf"], "/no/such/folder"),
        (["table", "/no/such/run"], "/no/such/run: "),
        (["table", "sumary", "/no/such/run"], "'summary'"),
        (["table", "budgets"], "runs/"),
        (["table", "budgets", "main"], "budgets and main"),
    ],
)
def test_bad_usage_is_one_line_and_exit_code_2(words, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert cli.main(words) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1


def options_of(parser):
    """Every option of a command and of its actions, each with the parser that has it."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for inner in action.choices.values():
                yield from options_of(inner)
        elif action.option_strings:
            yield parser, action


def test_every_option_of_every_command_is_repeatable_or_refused_the_second_time():
    kept, refused = set(), set()
    for name in commands.modules():
        (listing,) = [action for action in cli.parser([name])._actions if isinstance(action.choices, dict)]
        for parser, action in options_of(listing.choices[name]):
            if action.nargs == 0:  # a switch
                continue
            option = action.option_strings[-1]
            given = argparse.Namespace(**{action.dest: action.default})
            action(parser, given, "a", option)
            if getattr(given, action.dest) == ["a"]:
                action(parser, given, "b", option)
                assert getattr(given, action.dest) == ["a", "b"], (name, option)
                kept.add((name, option))
                continue
            with pytest.raises(InputError, match=f"^{option}: .*twice"):
                action(parser, given, "b", option)
            refused.add((name, option))
    assert {("run", "--seed"), ("run", "--codec"), ("figure", "--pair")} <= kept
    assert {("encode", "--seed"), ("run", "--jobs"), ("propagate", "--guidance")} <= refused


@pytest.mark.parametrize(
    "words",
    [
        ["run", "--jobs", "2", "--jobs", "1"],
        ["encode", "satin", "--codec", "pca", "--codec", "vq", "-o", "a.nbtf"],
        ["run", "--seed", "1", "--seed", "1"],
        ["run", "--set", "pca.components=3", "--set", "pca.components=4"],
        ["run", "--scheduler", "there", "--resource", "GPU=1", "--resource", "GPU=2"],
        ["bake", "maps", "--map", "albedo=a.png", "--map", "albedo=b.png", "-o", "a.npz"],
        ["table", "main", "a", "--name", "pca=one", "--name", "pca=two"],
    ],
)
def test_what_would_silently_keep_its_last_value_is_refused_in_one_line(words, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert cli.main(words) == 2
    error = capsys.readouterr().err
    assert "twice" in error
    assert error.count("\n") == 1


@pytest.mark.parametrize("words", [["encode", "satin", "--codec", "pca"], ["run"], ["bake", "maps"]])
def test_a_seed_is_one_of_those_of_a_suite(words, capsys):
    for seed in ("-1", "99999999999"):
        with pytest.raises(SystemExit):
            cli.main([*words, "--seed", seed, "--out", "out"])
        assert re.search("--seed.*2,147,483,647", capsys.readouterr().err)


def test_a_material_that_is_not_there_means_nothing_was_measured(tmp_path, capsys):
    suite = tmp_path / "paper.toml"
    suite.write_text('[[materials]]\nname = "f"\npath = "f.btf"\nwhere = "ask UBO"\n[[codecs]]\ncodec = "pca"\n')
    assert cli.main(["run", str(suite), "--out", str(tmp_path / "run")]) == 4
    assert "ask UBO" in capsys.readouterr().out


def test_check_fails_with_exit_code_1(monkeypatch, capsys):
    black = "baselines.mean_colour.MeanColourMaterial.evaluate", lambda self, uv, *_: uv.new_zeros(len(uv), 3)
    monkeypatch.setattr(*black)
    assert cli.main(["check", "mean-colour"]) == 1
    assert re.search("^FAIL .*follows", capsys.readouterr().out, re.M)


def raises(error):
    raise error


@pytest.mark.parametrize(
    ("ends", "code", "said"),
    [
        (lambda _: raises(KeyboardInterrupt()), 130, "interrupted"),
        (lambda _: raises(ZeroDivisionError("oops")), 70, "oops"),
        (lambda _: signal.raise_signal(signal.SIGTERM), 130, "interrupted"),
    ],
)
def test_an_interruption_and_a_termination_are_130_and_an_internal_error_70(ends, code, said, monkeypatch, capsys):
    monkeypatch.setattr("bench.cli.commands.list.run", ends)
    before = signal.getsignal(signal.SIGTERM)
    assert cli.main(["list"]) == code
    assert said in capsys.readouterr().err
    assert signal.getsignal(signal.SIGTERM) is before


def test_options_of_a_material_are_refused_beside_the_cache(tmp_path, capsys):
    for words in (["--cache", "--json", str(tmp_path / "a.json")], ["--remove-cache", "--picture", "a.png"]):
        assert cli.main(["info", *words]) == 2
        assert "--picture and --json" in capsys.readouterr().err


def test_the_cache_is_shown_and_cleared(tmp_path, capsys):
    assert cli.main(["info", "--cache"]) == 0
    (tmp_path / "cache" / "scratch").mkdir(parents=True)
    (tmp_path / "cache" / "scratch" / "a").write_bytes(b"12")
    assert cli.main(["info", "--remove-cache"]) == 0
    assert "removed 1" in capsys.readouterr().out
    assert not (tmp_path / "cache" / "scratch" / "a").exists()


SCIENCE = {"torch", "scipy", "skimage", "numpy"}


@pytest.mark.parametrize(
    ("code", "heavy"),
    [
        ("import bench", {"torch", "skimage"}),
        ("from bench import cli; cli.main(['list'])", {"torch", "skimage"}),
        ("from bench import cli\ntry: cli.main(['--help'])\nexcept SystemExit: pass", {"torch", "skimage"}),
        ("import bench.records, reports", {"torch", "skimage"}),
        ("import bench.compare.choosing, bench.compare.choosing", {"torch", "numpy"}),
        ("import bench.metrics as m; m.get('ssim')", SCIENCE | {"matplotlib"}),
        ("import bench.data.readers", {"torch", "PIL", "OpenEXR", "h5py", "png", "scipy", "skimage"}),
        ("import bench.data.materials as m; m.describe()", SCIENCE),
        ("from bench.data.materials import load; load('satin', 4, views=1, lights=1, heldout=0)", {"torch"}),
    ],
)
def test_what_is_light_imports_nothing_heavy(code, heavy):
    probe = f"{code}\nimport sys; print(sorted({heavy} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", probe], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"


@pytest.mark.parametrize("encoding", ["utf-8", "latin-1", "cp1252", "ascii"])
def test_what_an_encoding_lacks_is_replaced_and_no_command_fails_on_it(encoding, folder, monkeypatch):
    records = str(Path(__file__).parents[3] / "docs" / "results" / "quick.jsonl")
    for words in (["table", "main", records], ["list", "codecs"], ["info", str(folder)]):
        printed = io.BytesIO()
        stream = io.TextIOWrapper(printed, encoding=encoding)
        with monkeypatch.context() as patched:
            patched.setattr(sys, "stdout", stream)
            assert cli.main(words) == 0
        stream.flush()
        text = printed.getvalue().decode(encoding)
        assert len(text) > 100, words
        if words[0] == "table":  # it has arrows
            assert ("?" in text) == (encoding != "utf-8")


def test_without_a_command_all_are_listed_in_groups_on_one_screen(capsys):
    assert cli.main([]) == 2
    out = capsys.readouterr().out
    assert len(out.splitlines()) <= 40
    assert max(map(len, out.splitlines())) <= cli.WIDTH
    for group, names in commands.GROUPS.items():
        block = out.partition(f"\n{group}:\n")[2].partition(":\n")[0]
        assert all(re.search(rf"^  {name} +\w", block, re.M) for name in names), group
    assert {name for names in commands.GROUPS.values() for name in names} <= set(commands.modules())
    assert all(re.search(rf"^  {name} +\w", out, re.M) for name in commands.modules())


@pytest.mark.long
def test_a_file_in_the_place_of_a_folder_is_one_line_that_names_it_and_exit_code_2(
    tmp_path, folder, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    run = ["run", "quick", "--material", str(folder), "--codec", "mean-colour", "--out"]
    assert cli.main(["encode", str(folder), "--codec", "mean-colour", "-o", "a.nbtf"]) == 0
    assert cli.main([*run, "run"]) == 0
    assert cli.main(["results", "pack", "run", "-o", "a.zip"]) == 0
    Path("notes.txt").write_text("text")
    for words in (
        ["export", "a.nbtf", "-o", "notes.txt"],
        ["results", "verify", "a.zip", "--out", "notes.txt"],
        ["stress", "--codec", "mean-colour", "--out", "notes.txt"],
        [*run, "notes.txt"],
        ["new", "codec", "my-codec", "--out", "notes.txt"],
        ["history", "run", "--plot", "notes.txt"],
        ["figure", "rate", "run", "-o", "notes.txt/a.png"],
        ["results", "pack", "run", "-o", "notes.txt/b.zip"],
    ):
        capsys.readouterr()
        assert cli.main(words) == 2, words
        error = capsys.readouterr().err
        assert error.count("\n") == 1
        assert "notes.txt: " in error
    for cache in ("notes.txt", "notes.txt/cache"):
        monkeypatch.setenv("NEUBTF_CACHE", cache)
        assert cli.main([*run[:3], "satin", *run[4:], "other", *SMALL]) == 2
        assert re.search(r"^neubtf-bench: \S*notes\.txt: .*\$NEUBTF_CACHE$", capsys.readouterr().err, re.M)
    assert Path("notes.txt").read_text() == "text"


def test_no_command_writes_over_a_file_of_another_kind(tmp_path, folder, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert cli.main(["encode", str(folder), "--codec", "mean-colour", "-o", "a.nbtf"]) == 0
    assert cli.main(["run", "quick", "--material", str(folder), "--codec", "mean-colour", "--out", "run"]) == 0
    Path("maps").mkdir()
    Image.new("RGB", (8, 8)).save("maps/m_color.png")
    Path("shader").mkdir()
    Path("shader/README.md").write_text("# A project\n")
    content = Path("a.nbtf").read_bytes()
    for words in (
        ["view", "a.nbtf", "-o"],
        ["encode", str(folder), "--codec", "mean-colour", "-o"],
        ["convert", str(folder), "-o"],
        ["decode", "a.nbtf", "-o"],
        ["info", str(folder), "--picture"],
        ["info", str(folder), "--json"],
        ["info", "a.nbtf", "--json"],
        ["list", "--json"],
        ["list", "codecs", "pca", "--json"],
        ["choose", str(folder), "--max-bytes", "1M", "--json"],
        ["score", "a.nbtf", str(folder), "--json"],
        ["compare", "run", "run", "--markdown"],
        ["compare", "run", "run", "--junit"],
        ["figure", "rate", "run", "-o"],
        ["results", "pack", "run", "-o"],
        ["results", "add", "run"],
        ["compare", "--update", "run", "-o"],
        ["render", "a.nbtf", "-o"],
        ["bake", "maps", "-o"],
    ):
        for kind, before in (("b.nbtf", content), ("notes", b"some words\n")):
            if kind == "b.nbtf" and words[0] == "encode":  # it is of this kind
                continue
            Path(kind).write_bytes(before)
            capsys.readouterr()
            assert cli.main([*words, kind]) == 2, words
            assert kind in capsys.readouterr().err
            assert Path(kind).read_bytes() == before, words
    assert cli.main(["export", "a.nbtf", "-o", "shader"]) == 2
    assert [path.name for path in Path("shader").iterdir()] == ["README.md"]


@pytest.mark.long
def test_a_file_of_the_same_kind_is_replaced_by_its_name_or_its_content(tmp_path, folder, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert cli.main(["encode", str(folder), "--codec", "mean-colour", "-o", "a.nbtf"]) == 0
    for words in (
        ["view", "a.nbtf", "-o", "page"],
        ["score", "a.nbtf", str(folder), "--json", "scores"],
        ["info", str(folder), "--picture", "picture"],
        ["info", str(folder), "--json", "about"],
        ["list", "suites", "--json", "listed"],
        ["encode", str(folder), "--codec", "mean-colour", "-o", "codec"],
        ["export", "a.nbtf", "-o", "shader"],
    ):
        place = Path(words[-1])
        if words[0] != "export":
            place.write_bytes(b"")  # an empty one holds nothing that could be lost
        assert cli.main(words) == cli.main(words) == 0
    Path("page.html").write_text("not whole")
    assert cli.main(["view", "a.nbtf", "-o", "page.html"]) == 0


def test_a_full_disk_is_one_line_that_names_the_file(tmp_path, folder, monkeypatch, capsys):
    def full(source, target):
        raise OSError(errno.ENOSPC, "No space left on device", str(source))

    monkeypatch.setattr("bench.files.atomic.os.replace", full)
    file = tmp_path / "a.nbtf"
    assert cli.main(["encode", str(folder), "--codec", "mean-colour", "-o", str(file)]) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"neubtf-bench: {file}: ")
    assert error.count("\n") == 1
    assert not list(tmp_path.glob("*.partial"))


def test_output_that_nobody_reads_is_no_success():
    with subprocess.Popen([sys.executable, "-m", "bench.cli", "list"], stdout=subprocess.PIPE) as program:
        program.stdout.close()
        assert program.wait() == 141


def test_a_warning_is_one_line_without_control_characters():
    record = logging.LogRecord("bench", logging.WARNING, "", 1, "%s: dark", ("a\n::error::b\x1b[31m",), None)
    assert cli._Visible().format(record) == r"a\n::error::b\x1b[31m: dark"


def test_two_outputs_are_two_files(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert cli.main(["compare", "a", "b", "--markdown", "v.md", "--junit", "v.md"]) == 2
    assert "v.md" in capsys.readouterr().err
