"""Counts the processors, and limits the number of CPU threads of a block."""

import os
from collections.abc import Iterator
from contextlib import contextmanager


def cores() -> int:
    """The number of processors that this process may run on."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextmanager
def torch_threads(count: int) -> Iterator[None]:
    """Limit PyTorch, and the libraries under NumPy and scikit-learn, to `count` CPU threads in this block."""
    import torch
    from threadpoolctl import threadpool_limits

    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        with threadpool_limits(count):
            yield
    finally:
        torch.set_num_threads(before)
