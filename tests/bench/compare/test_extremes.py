import json
import re

import pytest

from bench.cli import main
from bench.records import append


def stress(folder, **verdicts):
    folder.mkdir()
    for extreme, verdict in verdicts.items():
        record = {"kind": "stress", "subject": "pca", "extreme": extreme, "verdict": verdict, "group": "queries"}
        append(folder, record | {"order": 0, "figure": "", "detail": ""})
    return str(folder)


@pytest.fixture
def held(tmp_path):
    return stress(tmp_path / "held", dark="pass", bright="pass") + "/records.jsonl"


@pytest.mark.parametrize(
    ("after", "code", "message"),
    [
        ({"dark": "pass", "bright": "pass"}, 0, "2 cells"),
        ({"dark": "pass", "bright": "fail"}, 1, "pca: bright"),
        ({"dark": "pass", "bright": "n/a"}, 1, "pca: bright"),
        ({"dark": "pass"}, 1, "pca: bright"),
    ],
)
def test_a_cell_that_held_must_hold(after, code, message, tmp_path, capsys):
    base, new = stress(tmp_path / "base", dark="pass", bright="pass"), stress(tmp_path / "new", **after)
    assert main(["compare", base, new]) == code
    assert message in capsys.readouterr().out


def test_a_codec_that_neither_has_is_named_and_others_are_not_counted(held, tmp_path, capsys):
    assert main(["compare", held, held, "--codec", "pcaa"]) == 2
    assert re.search("--codec pcaa.*'pca'", capsys.readouterr().err)
    with open(held) as lines, open(tmp_path / "both.jsonl", "w") as both:
        for line in lines:
            record = json.loads(line)
            del record["crc32"]
            both.write(json.dumps(record) + "\n" + json.dumps(record | {"subject": "vq", "verdict": "fail"}) + "\n")
            both.write(json.dumps(record | {"subject": "table"}) + "\n")
    assert main(["compare", str(tmp_path / "both.jsonl"), str(tmp_path / "both.jsonl"), "--codec", "pca"]) == 0
    assert "2 cells" in capsys.readouterr().out


@pytest.mark.parametrize("option", ["--material", "--junit", "--markdown", "--tracker", "--annotations"])
def test_an_option_that_stress_tests_do_not_have_is_refused(option, held, tmp_path, capsys):
    words = [option] if option == "--annotations" else [option, str(tmp_path / "a")]
    assert main(["compare", held, held, *words]) == 2
    assert f"{option}: " in capsys.readouterr().err
    assert not (tmp_path / "a").exists()


def test_without_a_common_cell_nothing_is_compared(held, tmp_path):
    assert main(["compare", held, stress(tmp_path / "new", other="pass")]) == 4


def test_a_damaged_line_of_the_base_is_an_error(held, capsys):
    with open(held, "a") as file:
        file.write('{"kind": "stress", "subject": "pca", "extr')
    assert main(["compare", held, held]) == 2
    assert "line(s) 3" in capsys.readouterr().err


def test_jobs_and_a_stress_test_in_one_file_are_refused(held, make, capsys):
    job = make.run("run", make.job()).folder / "records.jsonl"
    with open(held, "a") as file:
        file.write(job.read_text())
    for words in ([held, str(job)], [str(job), held]):
        assert main(["compare", *words]) == 2
        assert f"{held}: " in capsys.readouterr().err
