"""What the trial of LLVM concludes; the trial itself is replaced by small programs that end in each way."""

import importlib.util
import logging
import re

import pytest

from bench.errors import InputError
from bench.program import llvm

REACHED = "print('LLVM 15.0.6'); print('kernels', flush=True)\n"


@pytest.fixture(autouse=True)
def forgotten():
    llvm._tried.cache_clear()
    yield
    llvm._tried.cache_clear()


def verdicts(monkeypatch, program):
    monkeypatch.setattr(llvm, "_TRIAL", program)
    return llvm.unusable(), llvm.unusable(plugins=True)


def test_an_llvm_that_ends_the_process_at_a_maximum_serves_the_kernels_alone(monkeypatch):
    program = REACHED + "import os, sys; print('LLVM ERROR: Cannot select', file=sys.stderr, flush=True); os.abort()"
    kernels, plugins = verdicts(monkeypatch, program)
    assert kernels == ""
    assert "LLVM 15.0.6, which ended a trial process (LLVM ERROR: Cannot select)" in plugins
    assert "install LLVM 19 (Debian: apt-get install libllvm19)" in plugins
    assert "DRJIT_LIBLLVM_PATH" in plugins


@pytest.mark.parametrize(
    ("program", "message"),
    [
        ("print('LLVM 15.0.6', flush=True); import os; os.abort()", "LLVM 15.0.6.*exit code -6"),
        ("print('LLVM 15.0.6', flush=True); assert False, 'wrong numbers'", "AssertionError: wrong numbers"),
        ("raise SystemExit('absent')", "finds no usable LLVM"),
        ("import os; os._exit(3)", "finds no usable LLVM"),
        ("import time; time.sleep(60)", "no answer within 1 s"),
    ],
)
def test_an_llvm_that_fails_the_kernels_serves_for_nothing(monkeypatch, program, message):
    monkeypatch.setattr(llvm, "LIMIT", 1.0 if "sleep" in program else 60.0)
    for verdict in verdicts(monkeypatch, program):
        assert re.search(message, verdict), verdict
        assert "DRJIT_LIBLLVM_PATH" in verdict


def test_the_trial_is_made_once_for_each_choice(monkeypatch, tmp_path):
    count = tmp_path / "count"
    program = f"open({str(count)!r}, 'a').write('.')\n" + REACHED
    verdicts(monkeypatch, program)
    assert count.read_text() == "."
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", "/other.so")
    verdicts(monkeypatch, program)
    assert count.read_text() == ".."


@pytest.mark.skipif(not importlib.util.find_spec("drjit"), reason="Dr.Jit is not installed (the extra mitsuba)")
def test_dr_jit_is_not_given_to_kernels_that_would_end_the_process(monkeypatch, caplog):
    monkeypatch.setattr(llvm, "_TRIAL", "raise SystemExit('absent')")
    with pytest.raises(InputError, match="no usable LLVM"):
        llvm.drjit()
    if importlib.util.find_spec("mitsuba"):
        from bench.demand.mitsuba import path_tracer

        with caplog.at_level(logging.WARNING):
            assert path_tracer.fastest_variant() == "scalar_rgb"
        assert "which is about a thousand times slower: Dr.Jit finds no usable LLVM" in caplog.text


@pytest.mark.skipif(not importlib.util.find_spec("drjit"), reason="Dr.Jit is not installed (the extra mitsuba)")
def test_the_trial_tells_the_llvm_of_this_machine():
    """A verdict names a version of LLVM, or Dr.Jit itself finds none."""
    import drjit as dr

    version, passed, end = llvm._tried("")
    assert bool(version) == dr.has_backend(dr.JitBackend.LLVM), end
    if llvm.unusable(plugins=True) == "":
        assert dr.maximum(dr.llvm.Float(1, 3), 2).numpy().tolist() == [2, 3]
    assert set(passed) <= {"kernels", "maximum", "minimum", "arctangent", ""}
