"""Tests whether Dr.Jit works with the LLVM of this machine, by a trial in a process of its own.

Dr.Jit ends its process at an operation that LLVM cannot compile: on x86, LLVM 16 and older cannot compile its maximum,
minimum and arctangent. The kernels of networks and of the path tracer use none of these, but recorded programs and the
plug-ins of Mitsuba do. The failures depend on Dr.Jit, LLVM and the processor, so each version is tested.
"""

import os
import subprocess
import sys
from functools import cache
from tempfile import TemporaryDirectory
from types import ModuleType

from bench.inputs.errors import InputError, installed

CHOICE = "DRJIT_LIBLLVM_PATH"
EXAMPLE = "/usr/lib/x86_64-linux-gnu/libLLVM-19.so"
REMEDY = f"install LLVM 19 (Debian: apt-get install libllvm19), or name another LLVM's library in {CHOICE} ({EXAMPLE})"
LIMIT = 120.0  # seconds; a trial usually takes one
# Each trial prints its name if it passes. For x = 0.5, 1.5, … 9.5, `one` gives ⌊x⌋ · (⌊x⌋ + 1) plus 1 / x above 4 and x
# below; `off` is how far each result is from that. `row >> 31` is 0 everywhere: see `bench.program.kernel`.
_TRIAL = """
import drjit as dr
if not dr.has_backend(dr.JitBackend.LLVM):
    raise SystemExit("absent")
from drjit.llvm import ArrayXf, Float, UInt32
print("LLVM", ".".join(map(str, dr.detail.llvm_version())), flush=True)
x = dr.linspace(Float, 0.5, 9.5, 10)
row = dr.arange(UInt32, 10)
one = lambda v: dr.fma(dr.floor(v), dr.round(v + 0.1), dr.select(v > 4, dr.rsqrt(v * v), dr.sqrt(v * v)))
def kernel():
    out, read = dr.empty(Float, 10), dr.gather(ArrayXf, x, row, shape=(1, 10))
    dr.scatter(out, dr.switch(row >> 31, [one], read[0]), row)
    return out
trials = {
    "kernels": kernel,
    "maximum": lambda: dr.maximum(x, 4.0),
    "minimum": lambda: dr.minimum(x, 4.0),
    "arctangent": lambda: dr.atan2(x, 4.0),
}
for name, trial in trials.items():
    result = trial()
    dr.eval(result)
    if name == "kernels":
        off = [abs(a - int(b) * (int(b) + 1) - (1 / b if b > 4 else b)) for a, b in zip(list(result), list(x))]
        assert max(off) < 1e-3, "wrong numbers"
    print(name, flush=True)
"""


def drjit() -> ModuleType:
    """Dr.Jit with an LLVM that compiles kernels of networks. `InputError` says what to install."""
    with installed("fused on the CPU needs Dr.Jit: pip install neubtf-bench[mitsuba]"):
        import drjit as dr
    reason = unusable()
    if reason:
        raise InputError(reason)
    return dr


def unusable(plugins: bool = False) -> str:
    """Why Dr.Jit cannot use this machine's LLVM for kernels of networks and of the path tracer or, with `plugins`, for
    recorded programs and Mitsuba's plug-ins too, and the remedy; "" if it can. Dr.Jit must be installed.

    The trial takes about a second, once in a process.
    """
    version, passed_trials, end = _trial_results(os.environ.get(CHOICE, ""))
    if not version:
        return f"Dr.Jit finds no usable LLVM ({end}): {REMEDY}"
    # Trials run in order until one ends the process, so the last one that matters tells of all before it.
    last = "arctangent" if plugins else "kernels"
    if last in passed_trials:
        return ""
    return f"Dr.Jit cannot use {version}, which ended a trial process ({end}): {REMEDY}"


@cache
def _trial_results(choice: str) -> tuple[str, tuple[str, ...], str]:
    """Run the trials. Gives LLVM's version, "" without one; the names of passed trials; and how the process ended.

    `choice` is the value of the environment variable `CHOICE`, which the process inherits: a result is remembered for
    each.
    """
    try:
        # An empty cache: Dr.Jit names kernels by the processor alone, and would load those that another LLVM compiled.
        with TemporaryDirectory() as empty:
            process = subprocess.run(
                [sys.executable, "-c", _TRIAL], stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=LIMIT,
                env=os.environ | {"DRJIT_CACHE_DIR": empty},
            )  # fmt: skip
    except subprocess.TimeoutExpired:
        return f"LLVM ({choice or 'as found'})", (), f"no answer within {LIMIT:.0f} s"
    version, *passed_trials = process.stdout.split("\n")
    return version, tuple(passed_trials), _end_of(process)


def _end_of(process: subprocess.CompletedProcess[str]) -> str:
    """How a process ended: its first error or last line, or its exit code."""
    lines = process.stderr.splitlines()
    errors = [line for line in lines if "error" in line.lower()]
    telling = errors[:1] or lines[-1:]
    if not telling:
        return f"exit code {process.returncode}"
    return " ".join(telling[0].split())[:200]
