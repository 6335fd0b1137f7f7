"""Measures how fast this machine multiplies and copies: the ceiling of the time per sample in every timing table."""

from typing import Any

import torch

from bench.machine.threads import torch_threads
from bench.material import DecoderCost
from bench.timing import calibrated

SIDE = 1024  # side of the multiplied matrices
COPIED = 64 << 20  # bytes: far beyond any cache
ROUNDS = 10


def roofline(device: torch.device, threads: int, dtype: torch.dtype = torch.float32) -> dict[str, Any]:
    """Measured flop/s of a matrix product (a fused multiply-add counts as two) and bytes/s of a copy, read and written.
    The best of several rounds, because a limit needs to be reached only once."""
    with torch_threads(threads):
        a, b = (torch.rand(SIDE, SIDE, device=device).to(dtype) for _ in range(2))
        product = torch.empty_like(a)
        source = torch.zeros(COPIED, dtype=torch.uint8, device=device)
        target = torch.empty_like(source)
        multiply = calibrated(lambda: torch.mm(a, b, out=product), device)
        copy = calibrated(lambda: target.copy_(source), device)
        best = [min(call() for _ in range(ROUNDS)) for call in (multiply, copy)]
    rates = {"flops_per_ns": 2 * SIDE**3 / best[0], "bytes_per_ns": 2 * COPIED / best[1]}
    return rates | {"threads": threads, "device": str(device), "dtype": str(dtype).removeprefix("torch.")}


def limit_ns(cost: DecoderCost, ceiling: dict[str, Any]) -> float:
    """The fewest ns a sample that a ceiling allows: for its arithmetic or its reads, whichever takes longer."""
    return max(cost.flops_per_sample / ceiling["flops_per_ns"], cost.bytes_per_sample / ceiling["bytes_per_ns"])
