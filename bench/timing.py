"""Time per sample of decoded materials, as a renderer would pay it.

Contestants take turns (A B C A B C …), so that a machine that slows down slows all of them; each is compared with
the floor, one bilinear fetch of a colour, as the ratio inside a turn. Absolute figures from shared machines advise;
ratios compare.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from time import perf_counter_ns
from typing import Any

import numpy as np
import torch
from threadpoolctl import threadpool_limits
from torch import Tensor

from bench.hemisphere import uniform
from bench.material import DecoderCost, Material, sample_texture

SAMPLES = 30
BATCH = 16_384
SPAN_NS = 10_000_000  # an inner loop runs at least this long, far above the clock's resolution
FLOOR = "floor"


@dataclass(frozen=True)
class Timing:
    """One contestant: raw samples in ns per query, and their ratios to the floor turn by turn."""

    samples: np.ndarray  # (SAMPLES,)
    ratios: np.ndarray  # (SAMPLES,)

    def summary(self) -> dict[str, Any]:
        """Median, interquartile range, bootstrap 95 % interval of the median (ns per sample); ratio to the floor."""
        rng = np.random.default_rng(0)
        resampled = np.median(rng.choice(self.samples, (1000, len(self.samples))), axis=1)
        quarter, three_quarters = np.percentile(self.samples, [25, 75])
        return {
            "ns_per_sample": float(np.median(self.samples)),
            "iqr_ns": float(three_quarters - quarter),
            "interval95_ns": [float(x) for x in np.percentile(resampled, [2.5, 97.5])],
            "ratio_to_floor": float(np.median(self.ratios)),
        }


class _Floor(Material):
    def __init__(self, size: tuple[int, int]):
        super().__init__(size, DecoderCost())
        self.texture = torch.rand(*size, 3)

    def evaluate(self, uv: Tensor, wo: Tensor, wi: Tensor, footprint: Tensor) -> Tensor:
        return sample_texture(self.texture, uv)


@contextmanager
def torch_threads(count: int) -> Iterator[None]:
    """PyTorch, and the libraries under NumPy and scikit-learn, limited to `count` CPU threads inside."""
    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        with threadpool_limits(count):
            yield
    finally:
        torch.set_num_threads(before)


def conditions(threads: int, device: str) -> dict[str, Any]:
    """What a figure of `compare` holds for, to be stated beside it."""
    return {
        "batch": BATCH,
        "dtype": "float32",
        "threads": threads,
        "device": device,
        "execution": "eager",
        "queries": "random uv and directions up to 75°, footprint 0",
        "texture_fetch": True,
    }


def compare(materials: dict[str, Material], threads: int) -> dict[str, Timing]:
    """Time the whole query of each material in turns; the row `FLOOR` is one bilinear colour fetch."""
    size = next(iter(materials.values())).size
    queries = _random_queries()
    contestants = {FLOOR: _Floor(size)} | materials
    with torch_threads(threads):
        calls = {name: _calibrated(partial(material.query, *queries)) for name, material in contestants.items()}
        turns = np.array([[call() for call in calls.values()] for _ in range(SAMPLES)]) / BATCH
    return {name: Timing(turns[:, i], turns[:, i] / turns[:, 0]) for i, name in enumerate(calls)}


def _random_queries() -> tuple[Tensor, Tensor, Tensor]:
    rng = np.random.default_rng(0)
    uv = torch.from_numpy(rng.random((BATCH, 2), np.float32))
    return uv, torch.from_numpy(uniform(rng, BATCH)), torch.from_numpy(uniform(rng, BATCH))


def _calibrated(call: Callable[[], Any]) -> Callable[[], float]:
    """A function that times one turn, in ns a call; warmed up, and repeated until a turn is long enough to time."""
    durations = [_elapsed(call, 1) for _ in range(3)]
    repeat = max(1, round(SPAN_NS / max(min(durations), 1)))
    return lambda: _elapsed(call, repeat) / repeat


def _elapsed(call: Callable[[], Any], repeat: int) -> int:
    start = perf_counter_ns()
    for _ in range(repeat):
        call()
    return perf_counter_ns() - start
