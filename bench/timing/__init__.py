"""Measures the time per sample of decoded materials, as a renderer would see it.

Materials take turns (A B C A B C …), so if the machine slows down, it slows down all of them. The floor, one bilinear
fetch of a colour, is timed first and last in each turn, and each material is divided by the mean of both. If the two
differ, or other processes use the processor, the figures say that the machine was not quiet.

These ratios compare codecs within a run. Neither nanoseconds nor ratios carry over to another processor: the floor
waits for memory and a network multiplies, and these speeds change by different factors. `rainer2019` took 15 times the
floor on one processor and 23 to 28 times on another.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
import torch
from torch import Tensor

from bench.codec import Progress, followed, silent
from bench.devices import described, is_gpu
from bench.material import DecoderCost, Material, sample_texture
from bench.threads import torch_threads
from bench.timing.clock import calibrated
from bench.timing.machine import Watch, unrest
from bench.timing.queries import Queries

SAMPLES = 30
BATCH = 16_384
GPU_BATCH = 1 << 20  # with fewer a GPU's time counts its launches
FLOOR = "floor"
FLOORS = 2  # the first and the last of a turn; ratios are to their mean


@dataclass(frozen=True)
class Timing:
    """One contestant: raw samples in ns per query, their ratios to the floor turn by turn, and the machine's state."""

    samples: np.ndarray  # (SAMPLES,)
    ratios: np.ndarray  # (SAMPLES,)
    machine: dict[str, Any] = field(default_factory=dict)

    def summary(self) -> dict[str, Any]:
        """Median, interquartile range, bootstrap 95 % interval of the median (ns per sample); ratio to the floor.

        `unrest` says in words why the machine was not quiet; it is "" if it was.
        """
        quarter, three_quarters = np.percentile(self.samples, [25, 75])
        return {
            "ns_per_sample": float(np.median(self.samples)),
            "iqr_ns": float(three_quarters - quarter),
            "interval95_ns": interval95(self.samples),
            "ratio_to_floor": float(np.median(self.ratios)),
            "ratio_interval95": interval95(self.ratios),
            "floor_ns": float(np.median(self.samples / self.ratios)),
            "floors": FLOORS,
            **self.machine,
            "unrest": unrest(self.machine),
        }


def interval95(samples: np.ndarray) -> list[float]:
    """The bootstrap 95 % interval of the median of some samples."""
    resampled = np.median(np.random.default_rng(0).choice(samples, (1000, len(samples))), axis=1)
    return [float(x) for x in np.percentile(resampled, [2.5, 97.5])]


class _Floor(Material):
    def __init__(self, size: tuple[int, int]):
        super().__init__(size, DecoderCost())
        self.texture = torch.rand(*size, 3)

    def evaluate(self, uv: Tensor, wo: Tensor, wi: Tensor, footprint: Tensor) -> Tensor:
        return sample_texture(self.texture, uv)


def batch_on(device: torch.device | str, cpu: int = BATCH) -> int:
    """The samples of a timed batch on a device."""
    return GPU_BATCH if is_gpu(device) else cpu


def hardware(device: torch.device | str) -> dict[str, str]:
    """What a record of times on a GPU says of it; the CPU stands in the record of its run."""
    return {"gpu": described(device)} if is_gpu(device) else {}


def conditions(threads: int, device: str) -> dict[str, Any]:
    """The conditions under which `time_materials` measures, to be published with its figures."""
    return {
        "batch": batch_on(device),
        "dtype": "float32",
        "threads": threads,
        "device": device,
        "execution": "eager",
        "queries": "random uv and directions up to 75°, footprint 0",
        "texture_fetch": True,
        **hardware(device),
    }


def time_materials(
    materials: dict[str, Material], threads: int, queries: Queries | None = None, show: Progress = silent
) -> dict[str, Timing]:
    """Time the whole query of each material in turns; the row `FLOOR` is one bilinear colour fetch."""
    first = next(iter(materials.values()))
    batch = (queries or Queries(batch_on(first.device))).draw(first.size, first.device)
    calls = {name: partial(material.query, *batch) for name, material in materials.items()}
    return in_turns(calls, len(batch[0]), first.size, threads, first.device, show)


def in_turns(
    calls: Mapping[str, Callable[[], Any]],
    batch: int,
    size: tuple[int, int],
    threads: int,
    device: torch.device,
    show: Progress = silent,
) -> dict[str, Timing]:
    """Time calls that each answer `batch` samples in turns with the floor over a texture of `size`."""
    floor = partial(_Floor(size).to(device).query, *Queries(batch).draw(size, device))
    with torch_threads(threads):
        everyone: list[Callable[[], Any]] = [floor, *calls.values(), floor]
        timed = [calibrated(call, device) for call in followed(show, everyone, "warming up decoders", len(everyone))]
        with Watch() as watch:
            rounds = followed(show, range(SAMPLES), "timing decoders", SAMPLES)
            turns = np.array([[call() for call in timed] for _ in rounds]) / batch
    again = float(np.median(turns[:, -1]) / np.median(turns[:, 0]))
    machine = watch.state() | {"floor_again": again}
    turns[:, 0] = (turns[:, 0] + turns[:, -1]) / 2
    return {name: Timing(turns[:, i], turns[:, i] / turns[:, 0], machine) for i, name in enumerate([FLOOR, *calls])}
