"""Tries a codec of another distribution in a process of its own, before it is let into this one.

What it does there when it is imported, or made with settings, can end that process and not this one: `sys.exit`,
`os._exit`, a crash, a hang.
"""

import os
import signal
from collections.abc import Callable
from functools import cache
from importlib.metadata import EntryPoint
from typing import TYPE_CHECKING, Any

from bench.errors import CodecError, InputError

if TYPE_CHECKING:
    from multiprocessing.connection import Connection

Make = Callable[[str, dict[str, Any] | None], object]
OURS = "neubtf-bench"
EXPENDABLE = "NEUBTF_EXPENDABLE"  # set in the environment of a process that may die of a codec
PATIENCE = 120.0  # seconds for an import, PyTorch's among them, on a slow disk


def is_outside(entry: EntryPoint) -> bool:
    """Whether a codec comes from another distribution than this suite."""
    return entry.dist is not None and entry.dist.name != OURS


def check(entry: EntryPoint, called: str, make: Make, settings: dict[str, Any] | None = None) -> None:
    """Do `make(name, settings)` in another process first, if the codec is from outside; without settings, import it.

    `CodecError` says what became of it; an `InputError` of the codec's own is passed on.
    """
    if EXPENDABLE in os.environ or not is_outside(entry):
        return
    pairs = None if settings is None else tuple(sorted(settings.items()))
    error = _tried(entry.name, called, make, pairs)
    if error is not None:
        raise error


@cache
def _tried(name: str, called: str, make: Make, settings: tuple[tuple[str, Any], ...] | None) -> InputError | None:
    """What is wrong with a codec, or None."""
    import multiprocessing  # here, as listing codecs should be instant

    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe(duplex=False)
    child = context.Process(target=_try, args=(make, name, settings, theirs), daemon=True)
    child.start()
    theirs.close()
    doing = "is imported" if settings is None else f"is made with {dict(settings) or 'its defaults'}"
    try:
        if ours.poll(PATIENCE):
            answer: InputError | None = ours.recv()
            return answer
        return CodecError(f"{called} hangs when it {doing}: no answer in {PATIENCE:g} s")
    except EOFError:
        child.join()
        return CodecError(f"{called} ends the process when it {doing}: {ending(child.exitcode)}")
    finally:
        child.kill()


def _try(make: Make, name: str, settings: tuple[tuple[str, Any], ...] | None, answer: "Connection") -> None:
    os.environ[EXPENDABLE] = "1"
    try:
        make(name, None if settings is None else dict(settings))
    except InputError as error:
        answer.send(error)
    else:
        answer.send(None)


def ending(code: int | None) -> str:
    """How a process ended, in words."""
    if code is None or code >= 0:
        return f"exit code {code}"
    return f"killed by {signal.Signals(-code).name}"
