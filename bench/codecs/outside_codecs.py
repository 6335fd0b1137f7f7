"""Tries an external codec in its own process before it is imported into this one.

If importing or constructing the codec calls `sys.exit` or `os._exit`, crashes or hangs, only that process ends.
"""

import json
import os
import signal
from collections.abc import Callable
from functools import cache
from importlib.metadata import EntryPoint
from typing import Any

from bench.inputs import plugins
from bench.inputs.errors import CodecError, InputError

Make = Callable[[str, dict[str, Any] | None], object]
EXPENDABLE = "NEUBTF_EXPENDABLE"  # set in the environment of a process that a codec may end
PATIENCE = 120.0  # seconds for an import, including PyTorch's, on a slow disk


def check(entry: EntryPoint, called: str, make: Make, settings: dict[str, Any] | None = None) -> None:
    """Run `make(name, settings)` in another process first, if the codec is external; without settings, import it.

    `called` is the name of the codec and its distribution for messages. `CodecError` says how the process failed; an
    `InputError` of the codec is passed on. A process that codecs may end makes no trial.
    """
    if EXPENDABLE in os.environ or not plugins.is_outside(entry):
        return
    # As text, because `_error_in_child` caches its answers by its arguments, and a list among them cannot be looked up.
    text = None
    if settings is not None:
        text = json.dumps(settings, sort_keys=True, default=str)
    error = _error_in_child(entry.name, called, make, text)
    if error is not None:
        raise error


@cache
def _error_in_child(name: str, called: str, make: Make, settings: str | None) -> InputError | None:
    """Make a codec in another process with `settings`, JSON, or only import it if they are None.

    Returns the error that this shows, or None.
    """
    import subprocess  # imported here, since listing codecs should be instant
    import sys

    if settings is None:
        parsed = None
        step = "is imported"
    else:
        parsed = json.loads(settings)
        step = f"is made with {parsed or 'its defaults'}"
    # A bare interpreter, because `multiprocessing` would run the calling script again.
    request = json.dumps([sys.path, name, parsed])
    reading, writing = os.pipe()  # this process reads the answer that the other one writes
    script = CHILD.format(module=make.__module__, make=make.__name__)
    command = [sys.executable, "-c", script, request, str(writing)]
    child = subprocess.Popen(command, pass_fds=(writing,), stdin=subprocess.DEVNULL, env=os.environ | {EXPENDABLE: "1"})
    os.close(writing)  # here; once the other process ends, too, reading meets the end
    try:
        with open(reading, encoding="utf-8") as answers:
            child.wait(PATIENCE)
            line = answers.readline()
    except subprocess.TimeoutExpired:
        return CodecError(f"{called} hangs when it {step}: no answer in {PATIENCE:g} s")
    finally:
        child.kill()
        child.wait()
    if not line:
        return CodecError(f"{called} ends the process when it {step}: {ending(child.returncode)}")
    class_name, message = json.loads(line)  # as `answer` wrote them
    if not class_name:  # nothing is wrong
        return None
    if class_name == CodecError.__name__:
        return CodecError(message)
    return InputError(message)


# The script of the other process: it gets this process's import path, then calls `answer`.
CHILD = """
import json, sys
sys.path[:], name, settings = json.loads(sys.argv[1])
from bench.codecs.outside_codecs import answer
from {module} import {make} as make
answer(make, name, settings, int(sys.argv[2]))
"""


def answer(make: Make, name: str, settings: dict[str, Any] | None, descriptor: int) -> None:
    """In the other process: make the codec, and write what is wrong to a file descriptor.

    That is a line of JSON, the name of the error's class and its message; both are "" if nothing is wrong.
    """
    fault = ["", ""]
    try:
        make(name, settings)
    except InputError as error:
        fault = [type(error).__name__, str(error)[:4096]]  # short enough for the buffer of a pipe
    with open(descriptor, "w", encoding="utf-8") as answers:
        print(json.dumps(fault), file=answers)


def ending(code: int | None) -> str:
    """How a process ended, in words, from its return code: a negative one is the number of a signal; None: unknown."""
    if code is None or code >= 0:
        return f"exit code {code}"
    return f"killed by {signal.Signals(-code).name}"
