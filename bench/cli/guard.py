"""Runs a command that calls a codec of another distribution in a process of its own, which the codec may end.

A codec that calls `os._exit(0)` or crashes would otherwise end `neubtf-bench check` with exit code 0, or with none of
this program's. The other process writes its exit code to a pipe; if it ends without, the codec has ended it.
"""

import os
import signal
import subprocess
import sys
from collections.abc import Sequence

from bench.codecs.outside_codecs import ending
from bench.codecs.registry import from_outside
from bench.inputs.errors import FAILED, NO, InputError
from bench.machine.threads import handling

VERDICTS = {"check": NO, "encode": FAILED}  # the commands that call a codec, and the exit code if it ends the process
REPORT = "NEUBTF_REPORT"  # in the other process: the file descriptor for its exit code


def guarded(words: Sequence[str]) -> bool:
    """Whether a command is to run in a process of its own."""
    if not words or words[0] not in VERDICTS or REPORT in os.environ:
        return False
    try:
        return any(from_outside(name) for name in _names(words))
    except InputError:  # two packages name the same codec: the command itself says so
        return False


def _names(words: Sequence[str]) -> list[str]:
    """The words of a command that may name a codec: any after the first, since options are not parsed yet."""
    return [word.removeprefix("--codec=") for word in words[1:]]


def run(words: Sequence[str]) -> int:
    """Run a command in a process of its own; returns its exit code."""
    read_end, write_end = os.pipe()
    command = [sys.executable, "-m", "bench.cli", *words]
    child = subprocess.Popen(command, pass_fds=(write_end,), env=os.environ | {REPORT: str(write_end)})
    # Reading ends only when nobody can write any more, even if the other process ends without an answer.
    os.close(write_end)
    # Ctrl-C reaches the other process, too, which says what became of its work; a scheduler's SIGTERM is passed on.
    with handling(signal.SIGINT, signal.SIG_IGN), handling(signal.SIGTERM, lambda *_: child.terminate()):
        code = child.wait()
    with open(read_end, encoding="utf-8") as answers:
        answer = answers.readline()
    if answer:
        return int(answer)
    what = f"the codec ended the process ({ending(code)}): raise an error instead"
    print(f"neubtf-bench: {words[0]}: {what}", file=sys.stderr)
    return VERDICTS[words[0]]


def report(code: int) -> None:
    """In the other process: tell the exit code of its command."""
    place = os.environ.pop(REPORT, "")
    if place:
        with open(int(place), "w", encoding="utf-8") as answers:
            print(code, file=answers)
