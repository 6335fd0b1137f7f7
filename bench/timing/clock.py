"""Times a call, on the CPU by the clock, on a GPU by events; warms it up and repeats it to be long enough."""

from collections.abc import Callable
from contextlib import nullcontext
from time import perf_counter_ns
from typing import Any

import torch

from bench.devices import is_gpu

SPAN_NS = 10_000_000  # an inner loop runs at least this long, far above the clock's resolution
STABLE = 0.1  # a call is warm if two in a row differ by less
MOST_WARM_UPS = 10


def calibrated(
    call: Callable[[], Any], device: torch.device, clock: Callable[[], int] = perf_counter_ns
) -> Callable[[], float]:
    """A function that times one turn, in ns a call; the call is warm, and repeated until a turn is long enough.

    `clock` tells the time in ns on the CPU.
    """
    last = elapsed(call, 1, device, clock)
    for _ in range(MOST_WARM_UPS):
        before, last = last, elapsed(call, 1, device, clock)
        if abs(last - before) < STABLE * before:
            break
    repeat = max(1, round(SPAN_NS / max(last, 1)))
    return lambda: elapsed(call, repeat, device, clock) / repeat


def elapsed(
    call: Callable[[], Any], repeat: int, device: torch.device, clock: Callable[[], int] = perf_counter_ns
) -> float:
    """ns that `repeat` calls take."""
    if is_gpu(device):
        module = torch.get_device_module(device)
        with module.device(device) if device.index else nullcontext():  # `cuda:1` has a queue of its own
            start, end = (module.Event(enable_timing=True) for _ in range(2))
            start.record()
            for _ in range(repeat):
                call()
            end.record()
            end.synchronize()
        return float(1e6 * start.elapsed_time(end))
    begun = clock()
    for _ in range(repeat):
        call()
    return clock() - begun
