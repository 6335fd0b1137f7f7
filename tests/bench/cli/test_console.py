import re
from types import SimpleNamespace

import pytest

from bench.cli import console


@pytest.fixture
def clock(monkeypatch):
    now = [100.0]
    monkeypatch.setattr(console.time, "monotonic", lambda: now[0])
    return now


def test_without_a_terminal_a_long_silence_is_broken(clock, monkeypatch, capsys):
    monkeypatch.setattr(console, "SILENCE", 10.0)
    with console.Console() as screen:
        screen.show("fitting", 0, 100)
        clock[0] += 9
        screen.show("fitting · 20.1 dB", 50, 100)
        assert capsys.readouterr().err == ""
        clock[0] += 2
        screen.show("fitting · 20.3 dB", 60, 100)
        screen.show("fitting · 20.3 dB", 61, 100)
        (line,) = capsys.readouterr().err.splitlines()
        assert re.findall(r"\d+", line)[-2:] == ["60", "100"]
        clock[0] += 9
        screen.say("a job has ended")
        clock[0] += 9
        screen.show("fitting", 0, 100)
        assert capsys.readouterr().err == ""


def test_without_a_terminal_each_tenth_of_a_pass_is_printed_once(clock, monkeypatch, capsys):
    monkeypatch.setattr(console, "SILENCE", 10.0)
    moments = [0, 0, 5, 54, 40, 58, 61, 22, 137, 200]  # a fit that goes back, and a caller that repeats itself
    with console.Console() as screen:
        for done in moments:
            clock[0] += 11
            screen.show("reading", done, 200)
        for _ in range(3):  # a second pass over the same data
            clock[0] += 11
            screen.show("reading", 22, 200)
        clock[0] += 11
        screen.show("jobs", 0, 0)
    numbers = [re.findall(r"\d+", line) for line in capsys.readouterr().err.splitlines()]
    assert numbers == [*([done, "200"] for done in ("0", "54", "61", "137", "200")), ["2", "22", "200"], ["0", "0"]]


def test_what_is_said_holds_no_control_characters(clock, capsys):
    screen = console.Console()
    screen.say("a\x1b[2J\nb\r")
    screen.spoke -= 2 * console.SILENCE
    screen.show("fit\n::error::x", 1, 9)
    said = capsys.readouterr()
    assert said.out == "a\\x1b[2J\nb\\r\n"
    assert said.err.startswith(r"fit\n::error::x")
    assert said.err.count("\n") == 1


def test_a_job_is_one_line_whatever_its_name(clock, capsys):
    record = {"job": "a\n::error file=x::b/pca/0", "status": "failed", "error": "no\nluck"}
    console.Console().ended(SimpleNamespace(record=record, progress="1 of 2", cached=None))
    said = capsys.readouterr().out
    assert said.startswith(r"a\n::error file=x::b/pca/0: ")
    assert r"no\nluck" in said
    assert said.count("\n") == 1


def test_fields_are_lines_and_records_are_tables():
    fields = {
        "size": [4, 16],
        "periodic": False,
        "lobe": {"sum_share": 0.123456, "seen\x1b": None},
        "layers": [{"kind": "Linear", "parameters": 1250}, {"kind": "Norm", "parameters": 8}],
        "tensors": {"a": {"shape": [2, 3]}},
        "warnings": ["one", "two\nthree"],
        "notes": [],
    }
    assert console.fields_text(fields).splitlines() == [
        "size: 4 × 16",
        "periodic: False",
        "lobe:",
        f"  sum_share ({console._MEANINGS['lobe/sum_share']}): 0.1235",
        r"  seen\x1b: none",
        "layers:",
        "  kind    parameters",
        "  Linear       1,250",
        "  Norm             8",
        "tensors:",
        "  name  shape",
        "  a     2 × 3",
        "warnings:",
        "  one",
        r"  two\nthree",
        "notes: none",
    ]
