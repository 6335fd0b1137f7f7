"""Profiles a material's time per sample over the timed part, the batch size, the order of queries, and the threads.

A profile times a codec in many conditions, to show what its time depends on. One condition changes at a time. The
common condition is the whole query of `BATCH` random samples on one thread, on a GPU of `GPU_BATCH`. How fast this
machine multiplies and copies is the ceiling in every timing table.
"""

from collections.abc import Callable, Container, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import torch
from torch import Tensor

from bench.machine.threads import torch_threads
from bench.material import DecoderCost, Material
from bench.records import Ceiling
from bench.timing import BATCH, FLOOR, Queries, Timing, batch_on, calibrated, clock_of, in_turns
from bench.timing.execution import DTYPES, networks

BATCHES = (1, 64, 1024, BATCH, 1 << 18, 1 << 20, 1 << 22)
FOOTPRINTS = (1, 2, 4, 8)  # in texels
# The side of the multiplied matrices: a GPU multiplies small ones slowly.
SIDE = 1024
GPU_SIDE = 8192
# The copied bytes, far beyond any cache: 64 MiB and 1 GiB.
COPIED = 64 << 20
GPU_COPIED = 1 << 30
ROUNDS = 10


@dataclass(frozen=True)
class Condition:
    """What is timed, on which queries and how many CPU threads; as in `Queries` where both have a field."""

    part: str = "query"  # or `evaluate` (the fetch and the networks, without checks), or `decoder` (networks alone)
    batch: int = BATCH
    coherent: bool = False
    footprint: float = 0.0  # in texels
    threads: int = 1


def conditions(batches: tuple[int, ...], all_threads: int, batch: int = BATCH) -> list[Condition]:
    """Every condition of a profile, the common one first."""
    common = Condition(batch=batch)
    others = [replace(common, part="decoder"), replace(common, part="evaluate")]
    others += [replace(common, batch=size) for size in batches]
    others += [replace(common, coherent=True)]
    others += [replace(common, footprint=side) for side in FOOTPRINTS]
    others += [replace(common, threads=all_threads)]
    # Each once: one of the others may equal the common one.
    return list(dict.fromkeys([common, *others]))


def profile(
    materials: dict[str, Material],
    all_threads: int,
    batches: tuple[int, ...] = BATCHES,
    done: Container[tuple[str, Condition]] = (),
) -> Iterator[tuple[str, Condition, Timing]]:
    """The timing of each material, given by name, in each condition that is not done, and of the floor."""
    first = next(iter(materials.values()))
    for condition in conditions(batches, all_threads, batch_on(first.device)):
        missing = {name: material for name, material in materials.items() if (name, condition) not in done}
        calls = {name: _call(material, condition) for name, material in missing.items()}
        # Without the codecs that lack the condition's part.
        existing = {name: call for name, call in calls.items() if call}
        if not existing:
            continue
        timed = in_turns(existing, condition.batch, first.size, condition.threads, first.device)
        for name, timing in timed.items():
            # The floor is always a whole query, so under another part its record would be mislabelled.
            if name != FLOOR or condition.part == "query":
                yield name, condition, timing


def _call(material: Material, condition: Condition) -> Callable[[], Any] | None:
    """A call that answers the batch of a condition once; None if a material has no such part."""
    queries = Queries(condition.batch, condition.coherent, condition.footprint).draw(material.size, material.device)
    match condition.part:
        case "query":
            return partial(material.query, *queries)
        case "evaluate":
            return partial(_chunks, material.evaluate, queries, material.chunk)
    decoders = networks(material)  # of the part `decoder`
    if not decoders:  # a codec without a network
        return None
    inputs = [torch.randn(condition.batch, net.architecture.inputs, device=material.device) for net in decoders]
    return lambda: [_chunks(net, (x,), material.chunk) for net, x in zip(decoders, inputs, strict=True)]


@torch.no_grad()
def _chunks(call: Callable[..., Tensor], inputs: tuple[Tensor, ...], chunk: int) -> None:
    """Call a function of the inputs (n, …) for each `chunk` of rows, as `Material.query` does; answers are dropped."""
    for start in range(0, len(inputs[0]), chunk):
        call(*(x[start : start + chunk] for x in inputs))


def roofline(device: torch.device, threads: int, dtype: torch.dtype = torch.float32) -> Ceiling:
    """What this machine reaches: operations a ns in a matrix product, and bytes a ns in a copy.

    A multiply-add counts as two operations, and a copied byte as two: one read and one written. The clock is that which
    times decoders on as many threads. The best of several rounds, because a limit needs to be reached only once.
    """
    clock = clock_of(threads)
    with torch_threads(threads):
        product_call, copy_call = ceiling_calls(device, dtype)
        time_product = calibrated(product_call, device, clock)
        time_copy = calibrated(copy_call, device, clock)
        product_ns = min(time_product() for _ in range(ROUNDS))
        copy_ns = min(time_copy() for _ in range(ROUNDS))
    flops, read = rates(product_ns, copy_ns, device)
    return {
        "flops_per_ns": flops,
        "bytes_per_ns": read,
        "threads": threads,
        "device": str(device),
        "dtype": str(dtype).removeprefix("torch."),
    }


def ceiling_calls(device: torch.device, dtype: torch.dtype) -> tuple[Callable[[], Any], Callable[[], Any]]:
    """A matrix product and a copy, whose times are ceilings of a machine."""
    side, copied = sizes_on(device)
    a = torch.rand(side, side, device=device).to(dtype)
    b = torch.rand(side, side, device=device).to(dtype)
    product = torch.empty_like(a)
    source = torch.zeros(copied, dtype=torch.uint8, device=device)
    target = torch.empty_like(source)
    return lambda: torch.mm(a, b, out=product), lambda: target.copy_(source)


def sizes_on(device: torch.device) -> tuple[int, int]:
    """The side of the multiplied matrices, and the copied bytes."""
    if device.type == "cuda":  # not `is_gpu`: an emulated GPU computes on the CPU
        return GPU_SIDE, GPU_COPIED
    return SIDE, COPIED


def rates(product_ns: float, copy_ns: float, device: torch.device) -> tuple[float, float]:
    """Operations and bytes a ns, from the times of both calls of `ceiling_calls`."""
    side, copied = sizes_on(device)
    operations = 2 * side**3  # a multiplication and an addition for each of side³ products
    moved = 2 * copied  # each byte is read and written
    return operations / product_ns, moved / copy_ns


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
