"""Locks a run's folder, so that one run at a time works in it; a dead process cannot keep the lock.

The holder keeps `RUN/lock` open under `flock`; the kernel releases it when the process ends, for whatever reason. The
file names the holder. Some file systems do not carry `flock` to other hosts. There the file's modification time counts:
the holder renews it every 10 seconds, and the lock of another host is stale if it was not renewed for a minute.
"""

import fcntl
import json
import logging
import os
import platform
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from bench.files.atomic import is_still, make_folder
from bench.inputs.errors import InputError, writable

log = logging.getLogger(__name__)

FILE = "lock"
RENEWED_EVERY = 10.0  # seconds
STALE_AFTER = 60.0  # seconds


@contextmanager
def locked(folder: Path, run: str) -> Iterator[None]:
    """Hold the lock of a run's folder, which is made if missing; takes over that of a dead process, with a warning.

    `InputError` names the holder, or says why the folder cannot be written. A lock that another host took over
    meanwhile, because this process was suspended, is left to it.
    """
    with writable(folder, "choose another --out"):  # turns an error of writing into an `InputError` with this remedy
        make_folder(folder)
        file = _acquire(folder, run)
    done = threading.Event()

    def renew() -> None:
        """Touch the file at times, so that other hosts do not take the lock for stale."""
        while not done.wait(RENEWED_EVERY):
            with suppress(OSError):  # a file system that is unavailable for a moment must not stop the run
                if _is_ours(folder, run):
                    os.utime(folder / FILE)

    threading.Thread(target=renew, daemon=True).start()
    try:
        yield
    finally:
        done.set()
        if _is_ours(folder, run):
            (folder / FILE).unlink(missing_ok=True)
        os.close(file)


def can_use_folder(folder: Path, run: str) -> bool:
    """Whether this process sees the locked folder of a run and may write there. Workers of a cluster may not."""
    return _holder(folder / FILE).get("run") == run and os.access(folder, os.W_OK)


def error_of_unseen_folder(folder: Path, who: str) -> InputError:
    """The error of workers that `can_use_folder` refuses; `who` names them."""
    return InputError(
        f"{folder}: not seen by {who}, or not writable there: put --out on a file system that every worker sees"
    )


def _is_ours(folder: Path, run: str) -> bool:
    """Whether the lock names this run and this process: another host may have taken it over."""
    holder = _holder(folder / FILE)
    signed = (holder.get("run"), holder.get("process"), holder.get("host"))
    return signed == (run, os.getpid(), platform.node())


def _acquire(folder: Path, run: str) -> int:
    """The descriptor of the lock's file, which is open, locked and signed. `InputError` if another run has the lock."""
    while True:  # again if the holder removed the file meanwhile
        file = os.open(folder / FILE, os.O_RDWR | os.O_CREAT, 0o644)  # readable for all: it names the holder to others
        try:
            kept_by_kernel = _lock_by_kernel(file)
            if is_still(file, folder / FILE):  # the open file is the one of that name, not one that was removed
                _refuse_if_alive(folder, kept_by_kernel)
                _sign(file, run)
                return file
        except BlockingIOError:
            os.close(file)
            raise InputError(_busy_message(folder, _holder(folder / FILE))) from None
        except BaseException:
            os.close(file)
            raise
        os.close(file)  # its holder removed it after we opened it and before we locked it


def _lock_by_kernel(file: int) -> bool:
    """Lock an open file; False if its file system cannot: what the file says must do then.

    `BlockingIOError` if another process holds it.
    """
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise
    except OSError:
        return False
    return True


def _sign(file: int, run: str) -> None:
    """Write into the lock's open file that this process holds it, for a run."""
    since = f"{datetime.now(UTC):%F %T} UTC"
    holder = {"process": os.getpid(), "host": platform.node(), "since": since, "run": run}
    os.truncate(file, 0)
    os.pwrite(file, json.dumps(holder).encode(), 0)
    os.fsync(file)


def _refuse_if_alive(folder: Path, kept_by_kernel: bool) -> None:
    """Check that the process that signed the lock before is gone; warns if one was. `InputError` if it may still run.

    `kept_by_kernel`: we hold the kernel's lock, so no process of this host does.
    """
    holder = _holder(folder / FILE)
    if not holder:  # nobody signed the lock
        return
    if holder.get("host") == platform.node():
        alive = not kept_by_kernel and _process_runs(int(holder["process"]))
    else:
        # How long ago it was renewed, both times by the clock of the file system, because clocks of two hosts differ.
        with tempfile.TemporaryFile(dir=folder) as made_now:
            now = os.fstat(made_now.fileno()).st_mtime
            renewed = os.stat(folder / FILE).st_mtime
        alive = now - renewed < STALE_AFTER
    if alive:
        raise InputError(_busy_message(folder, holder))
    log.warning("%s: the lock of %s is taken over, because its process is gone", folder, _holder_in_words(holder))


def _holder(path: Path) -> dict[str, Any]:
    """The process that the lock's file names: `process`, its number, `host`, `run` and `since`; empty if none does."""
    try:
        holder = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    if not isinstance(holder, dict) or not {"process", "host", "run"} <= holder.keys():  # not signed by a run
        return {}
    return holder


def _process_runs(process: int) -> bool:
    """Whether a process of this machine still runs, perhaps one of another user."""
    try:
        os.kill(process, 0)  # signal 0 ends nothing: it only asks whether the process can be reached
    except OSError as error:
        return not isinstance(error, ProcessLookupError)  # any other error, such as a missing permission: it exists
    return True


def _holder_in_words(holder: dict[str, Any]) -> str:
    """Which process holds a lock, for messages."""
    return f"process {holder['process']} on {holder['host']}, since {holder.get('since')}"


def _busy_message(folder: Path, holder: dict[str, Any]) -> str:
    """The message that a run still uses the folder, and which process it is, if known."""
    who = "another process"
    if holder:
        who = _holder_in_words(holder)
    return f"{folder}: another run uses this folder ({who}): wait for its end, stop it, or choose another --out"
