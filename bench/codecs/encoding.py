"""Calls a codec's `encode`, which may be anyone's code, and turns what it does wrong into one error that names it."""

import inspect
import os
import threading
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from bench.btf import BTF
from bench.codec import Codec, Fit, Parts
from bench.inputs.errors import CodecError, ContainerError, EncodeError, InputError, said_by, shown, unwritable
from bench.machine.process_state import restored_process_state

_left: list[threading.Thread] = []  # threads that codecs started and did not end


def encoded(codec: Codec, btf: BTF, fit: Fit, encode: Callable[[BTF, Fit], Parts] | None = None) -> Parts:
    """The parts that a codec makes of a BTF, by its own `encode` or by another; the state of the process is restored.

    `EncodeError` if it raises any other error than an `InputError`, or tries to end the process.
    """
    try:
        with restored_process_state(), watched_threads():
            return (encode or codec.encode)(btf, fit)
    except (InputError, KeyboardInterrupt):
        raise
    except BaseException as error:  # also `sys.exit` and a cancelled task of asyncio
        if isinstance(error, OSError) and unwritable(error):  # a full disk is not the codec's fault
            raise
        raise EncodeError(f"codec {codec.name} failed to encode {btf.name}: {raised(error, codec)}") from error


@contextmanager
def watched_threads() -> Iterator[None]:
    """Remember the threads that this block leaves running: the interpreter would wait for them at its end.

    A process that a codec forks ends with the block: it would go on with the command a second time. Let this be the
    innermost of several blocks: in a fork, PyTorch may wait for ever for threads that it does not have.
    """
    before, process = set(threading.enumerate()), os.getpid()
    try:
        yield
    finally:
        if os.getpid() != process:
            os._exit(1)
        new = set(threading.enumerate()) - before
        _left.extend(thread for thread in new if not thread.daemon)


def threads_left() -> list[str]:
    """The names of threads that codecs left running."""
    return [thread.name for thread in _left if thread.is_alive()]


def raised(error: BaseException, codec: Codec) -> str:
    """Describe an error that a codec raised in one line, with the last line of its author's own files in the trace."""
    if isinstance(error, ContainerError) and error.__cause__:  # the file was written just now, so it is not damaged
        error = error.__cause__
    if isinstance(error, CodecError):
        return str(error)  # names the author's line itself
    what = said_by(error)
    if isinstance(error, SystemExit):
        code = 0 if error.code is None else error.code
        how = f"exit code {code}" if isinstance(code, int) else f"the message {shown(code)}"
        what = f"it ends the process with {how}: raise an error instead"
    if "Half" in what and "float" in what.lower():  # networks and tables have the material's dtype, queries do not
        what += ": queries are at least float32; convert what meets them by .to(wi.dtype)"
    place = _own_line(error, codec)
    return f"{what} ({place})" if place else what


def _own_line(error: BaseException, codec: Codec) -> str:
    """The file and line of a codec's own package where an error was raised; "" if the traceback shows none."""
    try:
        own = Path(inspect.getfile(type(codec))).parent
    except (TypeError, OSError):  # typed into a shell
        return ""
    suite = Path(__file__).parents[1]
    place = ""
    for frame in traceback.extract_tb(error.__traceback__):
        file = Path(frame.filename)
        if file.is_relative_to(own) and not file.is_relative_to(suite):
            place = f"{frame.filename}:{frame.lineno}"
    return place
