"""Tries an external codec in its own process before it is imported into this one.

If importing or constructing the codec calls `sys.exit` or `os._exit`, crashes or hangs, only that process ends.
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
EXPENDABLE = "NEUBTF_EXPENDABLE"  # set in the environment of a process that a codec may end
PATIENCE = 120.0  # seconds for an import, PyTorch's included, on a slow disk


def is_outside(entry: EntryPoint) -> bool:
    """Whether a codec comes from another distribution than this suite."""
    return entry.dist is not None and entry.dist.name != OURS


def check(entry: EntryPoint, called: str, make: Make, settings: dict[str, Any] | None = None) -> None:
    """Run `make(name, settings)` in another process first, if the codec is external; without settings, import it.

    `CodecError` says how the process failed; an `InputError` of the codec is passed on.
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
    import multiprocessing  # imported here, since listing codecs should be instant

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
