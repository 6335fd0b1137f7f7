"""Times a call, on the CPU by the clock, on a GPU by events; warms it up and repeats it to be long enough."""

from collections.abc import Callable
from contextlib import nullcontext
from time import perf_counter_ns, process_time_ns
from typing import Any

import torch

from bench.machine.devices import is_gpu

Clock = Callable[[], int]  # tells a time on the CPU in ns
SPAN_NS = 3_000_000  # an inner loop runs about this long: far above the clock's resolution, below what disturbs both
STABLE = 0.1  # a call is warm if two in a row differ by less
MOST_WARM_UPS = 10


def clock_of(threads: int) -> Clock:
    """The clock of calls on so many CPU threads; of one it leaves out what other processes take."""
    return process_time_ns if threads == 1 else perf_counter_ns


def calibrated(
    call: Callable[[], Any], device: torch.device, clock: Clock = perf_counter_ns, wall: Clock = perf_counter_ns
) -> Callable[[], float]:
    """A function that times one turn by `clock`, in ns a call; the call is warm, and repeated until a turn is long
    enough by `wall`: one that waits for another process takes no time of this one."""
    last = elapsed(call, 1, device, wall)
    for _ in range(MOST_WARM_UPS):
        before, last = last, elapsed(call, 1, device, wall)
        if abs(last - before) < STABLE * before:
            break
    repeat = max(1, round(SPAN_NS / max(last, 1)))
    return lambda: elapsed(call, repeat, device, clock) / repeat


def elapsed(call: Callable[[], Any], repeat: int, device: torch.device, clock: Clock = perf_counter_ns) -> float:
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
