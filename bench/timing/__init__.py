"""Measures the time per sample of decoded materials, as a renderer would see it.

A sample is one query: place, view and light, answered by a colour. The materials that are timed together are
contestants.

Materials take short turns in random order, each between two turns of the floor, one bilinear fetch of a colour, and
each is divided by the mean of these two: what slows the machine down for longer than some milliseconds slows both. On
one thread the clock is the processor's own, which leaves out what other processes take. The figure is the median of
these ratios, with its 95 % interval, which is wide where the machine was not quiet.

These ratios compare codecs within a run. Neither nanoseconds nor ratios carry over to another processor: the floor
waits for memory and a network multiplies, and these speeds change by different factors. `rainer2019` took 15 times the
floor on one processor and 23 to 28 times on another.
"""

from collections.abc import Callable, Iterator, Mapping
from contextlib import nullcontext
from dataclasses import dataclass
from functools import partial
from time import perf_counter_ns, process_time_ns
from typing import Any

import numpy as np
import torch
from torch import Tensor

from bench import records
from bench.codec import Progress, followed, silent
from bench.directions.hemisphere import uniform
from bench.machine.devices import device_name, is_gpu
from bench.machine.threads import torch_threads
from bench.material import DecoderCost, Material, sample_texture

TURNS = 30
BATCH = 16_384
GPU_BATCH = 1 << 20  # with fewer a GPU's time counts its launches
FLOOR = "floor"

Clock = Callable[[], int]  # tells a time on the CPU in ns
SPAN_NS = 3_000_000  # an inner loop runs about this long: far above the clock's resolution, shorter than disturbances
STABLE = 0.1  # a call is warm if two in a row differ by less
MOST_WARM_UPS = 10


def random_queries(batch: int, device: torch.device) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """A batch of queries, the same each time: uv (n, 2), wo and wi (n, 3) up to 75°, and footprint (n,), which is 0."""
    rng = np.random.default_rng(0)
    uv = torch.from_numpy(rng.random((batch, 2), np.float32))
    wo = torch.from_numpy(uniform(rng, batch))
    wi = torch.from_numpy(uniform(rng, batch))
    return uv.to(device), wo.to(device), wi.to(device), torch.zeros(batch, device=device)


@dataclass(frozen=True)
class Timing:
    """One contestant: raw samples in ns per query, and their ratios to the floor timed beside them, turn by turn."""

    samples: np.ndarray  # (turns,)
    ratios: np.ndarray  # (turns,)

    def summary(self) -> records.Timing:
        """The median in ns per sample, with its spread and bootstrap 95 % interval; the same of the ratio to the floor.

        `ratio_least` is the smallest ratio of a turn, and `floor_ns` the median time of the floors beside the turns.
        """
        quarter, three_quarters = np.percentile(self.samples, [25, 75])
        return {
            "ns_per_sample": float(np.median(self.samples)),
            "iqr_ns": float(three_quarters - quarter),
            "interval95_ns": interval95(self.samples),
            "ratio_to_floor": float(np.median(self.ratios)),
            "ratio_interval95": interval95(self.ratios),
            "ratio_least": float(self.ratios.min()),
            "floor_ns": float(np.median(self.samples / self.ratios)),
        }


def interval95(samples: np.ndarray) -> list[float]:
    """The bootstrap 95 % interval of the median of some samples (n,): its lower and upper end."""
    # A thousand new sets of n are drawn from the samples, with repetition. Their medians spread as the median itself.
    resampled = np.random.default_rng(0).choice(samples, (1000, len(samples)))
    medians = np.median(resampled, axis=1)
    low, high = np.percentile(medians, [2.5, 97.5])
    return [float(low), float(high)]


class _Floor(Material):
    """What every codec does at least: one bilinear fetch of a colour, from a random texture of `size`."""

    def __init__(self, size: tuple[int, int]):
        super().__init__(size, DecoderCost())
        self.texture = torch.rand(*size, 3)

    def evaluate(self, uv: Tensor, wo: Tensor, wi: Tensor, footprint: Tensor) -> Tensor:
        """The colour (n, 3) at uv (n, 2); directions and footprint are ignored."""
        return sample_texture(self.texture, uv)


def batch_on(device: torch.device | str, cpu: int = BATCH) -> int:
    """The samples of a timed batch on a device: `GPU_BATCH` on a GPU, else those given for a `cpu`."""
    return GPU_BATCH if is_gpu(device) else cpu


def hardware(device: torch.device | str) -> records.Timing:
    """The name of a GPU, for a record of times on it; nothing for a CPU, which the record of the run names."""
    return {"gpu": device_name(device)} if is_gpu(device) else {}


def conditions(threads: int, device: str) -> records.Timing:
    """The usual conditions of a time, to be recorded with it; who measures under others replaces these."""
    stated: records.Timing = {
        "batch": batch_on(device),
        "dtype": "float32",
        "threads": threads,
        "device": device,
        "execution": "eager",
        "queries": "random uv and directions up to 75°, footprint 0",
    }
    return stated | hardware(device)


def time_materials(
    materials: dict[str, Material], threads: int, batch: int = 0, show: Progress = silent, turns: int = 0
) -> dict[str, Timing]:
    """Time the whole query of each material in turns, `TURNS` by default; the row `FLOOR` is one bilinear fetch.

    A call answers `batch` samples, by default as many as are usual on the device. All materials are on one device; the
    size of the first stands for those of all.
    """
    first = next(iter(materials.values()))
    samples = batch or batch_on(first.device)
    queries = random_queries(samples, first.device)
    calls = {name: partial(material.query, *queries) for name, material in materials.items()}
    return in_turns(calls, samples, first.size, threads, first.device, show, turns)


def in_turns(
    calls: Mapping[str, Callable[[], Any]],
    batch: int,
    size: tuple[int, int],
    threads: int,
    device: torch.device,
    show: Progress = silent,
    turns: int = 0,
) -> dict[str, Timing]:
    """Time calls that each answer `batch` samples, each between two floors of `size`, in random order, in so many turns
    (`TURNS` by default)."""
    turns = turns or TURNS
    floor = partial(_Floor(size).to(device).query, *random_queries(batch, device))
    rng = np.random.default_rng(0)
    clock = clock_of(threads)
    orders = [rng.permutation(len(calls)) for _ in range(turns)]
    samples = np.empty((turns, len(calls)))  # ns a call, in the order of `calls`
    floors = np.empty((turns, len(calls) + 1))  # before the first call of a turn and after each, in its own order
    ratios = np.empty_like(samples)
    with torch_threads(threads):
        everyone: Iterator[Callable[[], Any]] = followed(show, [floor, *calls.values()], "warming up", len(calls) + 1)
        time_floor, *time_calls = [calibrated(call, device, clock) for call in everyone]  # each gives ns a call
        for turn in followed(show, range(turns), "timing decoders", turns):
            # In one turn: floor, call, floor, call, … floor. Each call is divided by the mean of the two around it.
            floors[turn, 0] = time_floor()
            for place, i in enumerate(orders[turn]):
                samples[turn, i] = time_calls[i]()
                floors[turn, place + 1] = time_floor()
                ratios[turn, i] = samples[turn, i] / floors[turn, place : place + 2].mean()
    timing_of_floor = Timing(floors.mean(1) / batch, np.ones(turns))
    timings = {name: Timing(samples[:, i] / batch, ratios[:, i]) for i, name in enumerate(calls)}
    return {FLOOR: timing_of_floor} | timings


def clock_of(threads: int) -> Clock:
    """The clock of calls on so many CPU threads; of one it leaves out what other processes take."""
    return process_time_ns if threads == 1 else perf_counter_ns


def calibrated(
    call: Callable[[], Any], device: torch.device, clock: Clock = perf_counter_ns, wall: Clock = perf_counter_ns
) -> Callable[[], float]:
    """A function that times one turn of a call by `clock` and returns ns a call.

    First the call is warmed up. A turn repeats it often enough to last about `SPAN_NS` by `wall`, not by `clock`: while
    a call waits for another process, the clock of this process stands still.
    """
    last = elapsed(call, 1, device, wall)
    for _ in range(MOST_WARM_UPS):
        before = last
        last = elapsed(call, 1, device, wall)
        if abs(last - before) < STABLE * before:
            break
    repeat = max(1, round(SPAN_NS / max(last, 1)))
    return lambda: elapsed(call, repeat, device, clock) / repeat


def elapsed(call: Callable[[], Any], repeat: int, device: torch.device, clock: Clock = perf_counter_ns) -> float:
    """The time in ns that `repeat` calls take: on a GPU by its own events, else by `clock`."""
    if is_gpu(device):
        module = torch.get_device_module(device)
        # Events belong to the current GPU's queue. The current one is number 0, so only another must be made current.
        with module.device(device) if device.index else nullcontext():
            start, end = module.Event(enable_timing=True), module.Event(enable_timing=True)
            start.record()
            for _ in range(repeat):
                call()
            end.record()
            end.synchronize()
        milliseconds = start.elapsed_time(end)
        return float(1e6 * milliseconds)
    begun = clock()
    for _ in range(repeat):
        call()
    return clock() - begun
