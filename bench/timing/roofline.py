"""How fast a machine multiplies and copies, and what that allows a decoder: the ceiling of every timing table."""

from dataclasses import replace

import torch

from bench.machine.threads import torch_threads
from bench.material import DecoderCost, Material
from bench.records import Ceiling
from bench.timing import calibrated, clock_of
from bench.timing.execution import DTYPES

# The side of the multiplied matrices: a GPU multiplies small ones slowly.
SIDE = 1024
GPU_SIDE = 8192
# The copied bytes, far beyond any cache: 64 MiB and 1 GiB.
COPIED = 64 << 20
GPU_COPIED = 1 << 30
ROUNDS = 10


def roofline(device: torch.device, threads: int, dtype: torch.dtype = torch.float32) -> Ceiling:
    """What this machine reaches: operations a ns in a matrix product, and bytes a ns in a copy.

    A multiply-add counts as two operations, and a copied byte as two: one read and one written. The clock is that which
    times decoders on as many threads. The best of several rounds, because a limit needs to be reached only once.
    """
    clock = clock_of(threads)
    # Not `is_gpu`: an emulated GPU computes on the CPU.
    side, copied = (GPU_SIDE, GPU_COPIED) if device.type == "cuda" else (SIDE, COPIED)
    with torch_threads(threads):
        a = torch.rand(side, side, device=device).to(dtype)
        b = torch.rand(side, side, device=device).to(dtype)
        product = torch.empty_like(a)
        source = torch.zeros(copied, dtype=torch.uint8, device=device)
        target = torch.empty_like(source)
        time_product = calibrated(lambda: torch.mm(a, b, out=product), device, clock)
        time_copy = calibrated(lambda: target.copy_(source), device, clock)
        product_ns = min(time_product() for _ in range(ROUNDS))
        copy_ns = min(time_copy() for _ in range(ROUNDS))
    return {
        "flops_per_ns": 2 * side**3 / product_ns,
        "bytes_per_ns": 2 * copied / copy_ns,
        "threads": threads,
        "device": str(device),
        "dtype": str(dtype).removeprefix("torch."),
    }


def least_ns(material: Material, precision: str, ceilings: list[Ceiling]) -> float:
    """The fewest ns a sample that ceilings allow a material in a precision: short types read fewer bytes, and may
    multiply faster."""
    cost = replace(material.cost, bytes_per_sample=read_bytes(material.cost, precision))
    usable = {"float32", precision}  # a short type may be widened, where that is quicker
    return min(limit_ns(cost, ceiling) for ceiling in ceilings if ceiling["dtype"] in usable)


def read_bytes(cost: DecoderCost, precision: str) -> int:
    """The bytes that a sample reads in a precision."""
    # `cost` counts bytes of float32, which has four.
    return round(cost.bytes_per_sample * DTYPES[precision].itemsize / 4)


def limit_ns(cost: DecoderCost, ceiling: Ceiling) -> float:
    """The fewest ns a sample that a ceiling allows: for its arithmetic or its reads, whichever takes longer."""
    arithmetic = cost.flops_per_sample / ceiling["flops_per_ns"]
    reads = cost.bytes_per_sample / ceiling["bytes_per_ns"]
    return max(arithmetic, reads)
