import json
import subprocess
import sys

import pytest

from bench import cli


@pytest.fixture
def runs(make):
    base = make.run("base", *make.three("pca"), *make.three("vq"))
    worse = make.run("worse", *make.three("pca", psnr=29.0), *make.three("vq", psnr=29.0))
    return str(base.folder), str(worse.folder)


def test_a_comparison_is_printed_and_written_in_every_format(runs, tmp_path, capsys):
    files = ["--markdown", str(tmp_path / "a.md"), "--junit", str(tmp_path / "a.xml"), "--tracker", str(tmp_path / "t")]
    assert cli.main(["compare", *runs, *files, "--annotations"]) == 1
    out = capsys.readouterr().out
    assert "2 worse" in out
    assert "::error title=satin/pca::PSNR" in out
    assert "2 worse" in (tmp_path / "a.md").read_text()
    assert '<testcase classname="satin/pca" name="satin/pca/PSNR"' in (tmp_path / "a.xml").read_text()
    assert json.loads((tmp_path / "t" / "bigger-is-better.json").read_text())[0]["value"] == 29.0
    assert not list(tmp_path.rglob("*.partial"))
    assert cli.main(["compare", *runs, "--codec", "vq", "--material", "satin"]) == 1
    assert "1 worse" in capsys.readouterr().out


def test_what_is_not_comparable_fails_unless_it_is_allowed(make, capsys):
    base = make.run("old", *make.three("pca"), *make.three("vq"))
    newer = make.run("newer", *make.three("pca"), *make.three("vq", version=2, psnr=25.0))
    words = ["compare", str(base.folder), str(newer.folder)]
    assert cli.main(words) == 1
    assert "--allow" in capsys.readouterr().out
    for name in ("vq", "satin/vq", "satin/*"):
        assert cli.main([*words, "--allow", name]) == 0
    assert cli.main([*words, "--allow", "pca"]) == 1


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["/no/such/run", "{base}"], "/no/such/run: "),
        (["{base}", "/no/such.jsonl"], "/no/such.jsonl: "),
        (["{base}", "{base}", "--junit", "/proc/no/a.xml"], "/proc/no/a.xml: "),
        (["{base}", "{base}", "--codec", "pcaa"], "pcaa"),
        (["{base}"], "give NEW"),
        (["{base}", "{base}", "--wide"], "--wide"),
        (["{base}", "{base}", "--update"], "--update: "),
    ],
)
def test_bad_usage_is_one_line_and_2(runs, words, message, capsys):
    assert cli.main(["compare", *(word.format(base=runs[0]) for word in words)]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1


@pytest.mark.parametrize("command", [["compare", "{0}", "{1}"], ["compare", "{0}", "--update", "--out", "{0}/a.jsonl"]])
def test_comparing_imports_neither_pytorch_nor_pandas(runs, command):
    words = [word.format(*runs) for word in command]
    probe = f"from bench import cli; cli.main({words!r})\nimport sys, json; print(json.dumps(list(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", probe], capture_output=True, text=True, check=True)
    assert not {"torch", "pandas", "rich", "scipy"} & set(json.loads(done.stdout.splitlines()[-1]))
