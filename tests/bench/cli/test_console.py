"""What is told of work under way: bars on a terminal, a line now and then without one."""

from pathlib import Path

import pytest
from rich.console import Console as RichConsole

from bench.cli import console
from bench.conformance.check import tiny_btf
from bench.data.readers.folder import write_folder
from bench.runs import runner
from bench.runs.suite import load_suite, with_changes


@pytest.fixture
def clock(monkeypatch):
    """A clock that tests turn on: seconds in a list of one."""
    now = [100.0]
    monkeypatch.setattr(console.time, "monotonic", lambda: now[0])
    return now


def terminal(clock):
    screen = console.Console()
    screen.out = RichConsole(force_terminal=True, width=100)
    screen.bars = console.Progress(*screen.bars.columns, get_time=lambda: clock[0], console=screen.out)
    return screen


def left(screen):
    (task,) = screen.bars.tasks
    return console._TimeLeft().render(task).plain


def test_a_fit_has_one_bar_whatever_is_remarked(clock):
    screen = terminal(clock)
    screen.show("satin/pca/0: fitting", 0, 10)
    screen.show("satin/pca/0: fitting · 20.1 dB", 4, 10)
    (task,) = screen.bars.tasks
    assert (task.description, task.completed) == ("satin/pca/0: fitting · 20.1 dB", 4)
    screen.show("satin/pca/0: fitting · 21.0 dB", 10, 10)
    assert screen.bars.tasks == []


def test_the_time_left_is_that_of_the_mean_pace_and_runs_down(clock):
    screen = terminal(clock)
    screen.show("jobs", 2, 10)  # two were done before
    assert left(screen) == ""
    clock[0] += 100
    screen.show("jobs", 4, 10)
    assert left(screen) == "5:00 left"
    clock[0] += 20
    assert left(screen) == "4:40 left"
    clock[0] += 10_000  # a job that takes longer than those before it
    assert left(screen) == "4:10 left"


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
        assert capsys.readouterr().err == "fitting · 20.3 dB: 60 of 100\n"
        clock[0] += 9
        screen.say("a job has ended")
        clock[0] += 9
        screen.show("fitting", 0, 100)
        assert capsys.readouterr().err == ""


@pytest.mark.usefixtures("brief")
def test_a_run_tells_codec_and_material_the_psnr_so_far_and_that_it_times(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_folder(tiny_btf(12, 6, 6), tmp_path / "btf")
    suite = with_changes(load_suite("quick"), ["btf"], ["neubtf-direct"], {"neubtf-direct.steps": "4"}, None)
    shown = []
    options = runner.Options(Path("run"), show=lambda label, done, total: shown.append((label, done, total)))
    (outcome,) = runner.run(suite, options)
    fits = [each for each in shown if each[0].startswith("btf/neubtf-direct steps=4/0: fitting")]
    assert fits[0] == ("btf/neubtf-direct steps=4/0: fitting", 0, 4)
    psnr = outcome.record["history"][-1]["psnr"]
    assert fits[-1] == (f"btf/neubtf-direct steps=4/0: fitting · {psnr:.1f} dB", 4, 4)
    assert shown[0] == ("jobs", 0, 1)
    assert ("btf: timing decoders", 3, 3) in shown
    for label in {label for label, _, _ in shown}:  # every bar is removed
        bar = label.partition(" · ")[0]
        assert any(other.partition(" · ")[0] == bar and done == total for other, done, total in shown), bar
