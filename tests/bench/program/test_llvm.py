import importlib.util
import re

import pytest

from bench.inputs.errors import InputError
from bench.program import llvm

REACHED = "print('LLVM 15.0.6'); print('kernels', flush=True)\n"


@pytest.fixture(autouse=True)
def forgotten():
    llvm._trial_results.cache_clear()
    yield
    llvm._trial_results.cache_clear()


def verdicts(monkeypatch, program):
    monkeypatch.setattr(llvm, "_TRIAL", program)
    return llvm.unusable(), llvm.unusable(plugins=True)


def test_an_llvm_that_ends_the_process_at_a_maximum_serves_the_kernels_alone(monkeypatch, tmp_path):
    program = f"open({str(tmp_path / 'count')!r}, 'a').write('.')\n" + REACHED
    program += "import os, sys; print('LLVM ERROR: Cannot select', file=sys.stderr, flush=True); os.abort()"
    kernels, plugins = verdicts(monkeypatch, program)
    assert kernels == ""
    for words in ("LLVM 15.0.6", "LLVM ERROR: Cannot select", "libllvm19", "DRJIT_LIBLLVM_PATH"):
        assert words in plugins
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", "/other.so")
    verdicts(monkeypatch, program)
    assert (tmp_path / "count").read_text() == ".."  # once for each choice


@pytest.mark.parametrize(
    ("program", "message"),
    [
        ("print('LLVM 15.0.6', flush=True); import os; os.abort()", "LLVM 15.0.6.*exit code -6"),
        ("print('LLVM 15.0.6', flush=True); assert False, 'wrong numbers'", "AssertionError: wrong numbers"),
        ("import os; os._exit(3)", "finds no usable LLVM"),
        ("import time; time.sleep(60)", "no answer within 1 s"),
    ],
)
def test_an_llvm_that_fails_the_kernels_serves_for_nothing(monkeypatch, program, message):
    monkeypatch.setattr(llvm, "LIMIT", 1.0 if "sleep" in program else 60.0)
    for verdict in verdicts(monkeypatch, program):
        assert re.search(message, verdict), verdict
        assert "DRJIT_LIBLLVM_PATH" in verdict


@pytest.mark.skipif(not importlib.util.find_spec("drjit"), reason="Dr.Jit is not installed (the extra mitsuba)")
def test_dr_jit_is_not_given_to_kernels_that_would_end_the_process(monkeypatch):
    monkeypatch.setattr(llvm, "_TRIAL", "raise SystemExit('absent')")
    with pytest.raises(InputError, match="no usable LLVM"):
        llvm.drjit()
