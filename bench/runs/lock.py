"""Locks a run's folder, so that one run at a time works in it; the file `RUN/lock` names the run that does."""

import json
import os
import platform
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from bench.files.atomic import holding
from bench.inputs.errors import InputError, writable

FILE = "lock"


@contextmanager
def locked(folder: Path, run: str) -> Iterator[None]:
    """Hold the lock of a run's folder, which is made if missing, until the block or the process ends.

    `InputError` names the holder, or says why the folder cannot be written.
    """
    with ExitStack() as held:
        with writable(folder, "choose another --out"):  # turns an error of writing into an `InputError`
            try:
                file = held.enter_context(holding(folder / FILE, wait=False))
            except BlockingIOError:
                raise InputError(_busy_message(folder)) from None
            since = f"{datetime.now(UTC):%F %T} UTC"
            holder = {"process": os.getpid(), "host": platform.node(), "since": since, "run": run}
            os.truncate(file, 0)
            os.pwrite(file, json.dumps(holder).encode(), 0)
            os.fsync(file)
        yield


def can_use_folder(folder: Path, run: str) -> bool:
    """Whether this process sees the locked folder of a run and may write there. Workers of a cluster may not."""
    return _holder(folder).get("run") == run and os.access(folder, os.W_OK)


def error_of_unseen_folder(folder: Path, who: str) -> InputError:
    """The error of workers that `can_use_folder` refuses; `who` names them."""
    return InputError(
        f"{folder}: not seen by {who}, or not writable there: put --out on a file system that every worker sees"
    )


def _holder(folder: Path) -> dict[str, Any]:
    """What the holder of a folder's lock wrote: its `process`, `host` and `run`, and `since` when; empty if nothing."""
    try:
        return dict(json.loads((folder / FILE).read_text(encoding="utf-8")))
    except (OSError, ValueError, TypeError):
        return {}


def _busy_message(folder: Path) -> str:
    """The message that a run still uses the folder, and which process it is, if known."""
    holder = _holder(folder)
    who = "another process"
    if holder:
        who = f"process {holder.get('process')} on {holder.get('host')}, since {holder.get('since')}"
    return f"{folder}: another run uses this folder ({who}): wait for its end, stop it, or choose another --out"
