"""Counts the processors and their time; sets the CPU threads and the signal handler of a block."""

import os
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from bench.inputs.errors import InputError


def cores() -> int:
    """The number of processors that this process may run on."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@contextmanager
def handling(number: int, handler: Any) -> Iterator[None]:
    """Handle a signal, given by its number, by `handler` in this block; outside the main thread, change nothing.

    Processes started in the block ignore the signals that it ignores.
    """
    if threading.current_thread() is not threading.main_thread():  # `signal.signal` would raise
        yield
        return
    before = signal.signal(number, handler)
    try:
        yield
    finally:
        signal.signal(number, before)


@contextmanager
def torch_threads(count: int) -> Iterator[None]:
    """Limit PyTorch, and the libraries under NumPy and scikit-learn, to `count` CPU threads in this block.

    `InputError` for a count below 1.
    """
    import torch
    from threadpoolctl import threadpool_limits

    if count < 1:
        raise InputError(f"threads = {count}: must be at least 1")
    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        with threadpool_limits(count):
            yield
    finally:
        torch.set_num_threads(before)


def processor_seconds() -> float:
    """The processor time of this process and of its finished children, in s: other processes do not change it."""
    times = os.times()
    return time.process_time() + times.children_user + times.children_system
