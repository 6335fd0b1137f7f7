"""The decoder of NeuBTF, 3,011 parameters, in every execution: ns a sample and the ratio to one eager batch.

    GOMP_SPINCOUNT=5000 python benchmarks/decoders.py [--samples 1048576] [--threads 0] [--rounds 15]
    python benchmarks/decoders.py --bound [--target haswell] [--block 12]

One batch is the network as one writes it down, each operation into new memory. The variable is what `neubtf-bench`
sets, see docs/trade.md. All contestants take turns in one process and answer the same samples; a ratio is the median
over the turns, with its bootstrap 95 % interval. The default is timed twice: on a quiet machine the two differ by at
most 5 %. Targets, on all threads of a CPU: the default at most 0.30 of one batch, compiled 0.15, compiled bfloat16
0.10, fused 0.08. What bfloat16 costs in quality, and whole evaluations on a GPU, `neubtf-bench trade` measures.

`--bound` sets the fused decoder beside what arithmetic alone would take on one core; `--target haswell` compiles for
AVX2 alone, in vectors of eight. Arithmetic is 2,720 multiply-adds of the products and ten operations for each of the 96
hidden numbers. Its rate is that of a kernel of multiply-adds in registers, compiled the same way and measured in turns
with the decoder, in seconds of the processor: other processes disturb little.
"""

import argparse
import ctypes
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from bench.errors import InputError
from bench.material import CHUNK, keep_buffers
from bench.threads import torch_threads
from bench.timing import interval95
from bench.timing.clock import calibrated, elapsed
from bench.timing.execution import DTYPES, FUSED_CHUNK, LONG_CHUNK, needs_compiler
from bench.timing.fused.lean import Lean, compiled
from bench.training.decoder import Architecture, Decoder

NEUBTF = Architecture(18, (32, 32, 32), activation="sine", omega=2.0, norm=True, residual=True)
OPERATIONS = 18 * 32 + 2 * 32 * 32 + 32 * 3 + 10 * 96
TARGETS = {"eager": 0.30, "compiled": 0.15, "compiled bfloat16": 0.10, "fused": 0.08}
AGAIN = "eager, again"
SAMPLES, TURNS = 1 << 16, 25  # of the bound
CHAINS, LENGTH = 12, 300  # independent sums, and how long each is
Call = Callable[[], object]
CPU = torch.device("cpu")


def neubtf(weights: int = 0) -> Decoder:
    return Decoder(NEUBTF, torch.Generator().manual_seed(weights)).requires_grad_(False)


def in_chunks(network: Callable[[Tensor], Tensor], x: Tensor, out: Tensor, chunk: int) -> None:
    for start in range(0, len(x), chunk):
        out[start : start + chunk] = network(x[start : start + chunk])


def textbook(decoder: Decoder, x: Tensor) -> Tensor:
    """What the decoder answers, as one writes it down: an operation after the other, each into new memory."""
    assert decoder.norms is not None
    for layer, norm in zip(decoder.layers, decoder.norms, strict=False):
        hidden = torch.sin(decoder.architecture.omega * norm(layer(x)))
        x = x + hidden if x.shape == hidden.shape else hidden
    answer: Tensor = decoder.layers[-1](x)
    return answer


def on_cpu(samples: int) -> dict[str, Call]:
    """The decoder alone, as each execution computes it. What cannot be computed here is told and left out."""
    decoder = neubtf()
    x, out = torch.randn(samples, 18, generator=torch.Generator().manual_seed(1)), torch.empty(samples, 3)
    calls: dict[str, Call] = {
        "one batch": partial(textbook, decoder, x),
        "eager, one batch": partial(decoder, x),
        "eager": partial(in_chunks, decoder, x, out, CHUNK),
    }
    try:
        needs_compiler(CPU)
        for name, precision, chunk in (("", "float32", CHUNK), (" bfloat16", "bfloat16", LONG_CHUNK)):
            network = compiled(Lean(neubtf().to(DTYPES[precision])), dynamic=False)
            calls["compiled" + name] = partial(in_chunks, network, x, out, chunk)
    except InputError as error:
        print(f"not here: {error}")
    try:
        from bench.timing.fused.with_drjit import DrJitNetwork

        calls["fused"] = partial(in_chunks, DrJitNetwork(decoder), x, out, FUSED_CHUNK)
    except InputError as error:
        print(f"not here: {error}")
    return calls


def measure(calls: dict[str, Call], samples: int, rounds: int) -> None:
    """Time all in turns, the default execution at both ends, and print the table."""
    calls = {"eager": calls["eager"]} | calls | {AGAIN: calls["eager"]}
    with torch.no_grad():
        for call in calls.values():
            calibrated(call, CPU)  # compiles and warms up
        turns = np.array([[elapsed(call, 1, CPU) for call in calls.values()] for _ in range(rounds)]) / samples
    times = dict(zip(calls, turns.T, strict=True))
    print(f"| execution | ns a sample | × one batch (95 %) | target |\n|{' --- |' * 4}")
    for name, ns in times.items():
        ratios = ns / times["one batch"]
        median, (low, high) = float(np.median(ratios)), interval95(ratios)
        wanted = TARGETS.get(name)
        target = f"≤ {wanted:.2f}: {'met' if median <= wanted else 'missed'}" if wanted else ""
        print(f"| {name} | {np.median(ns):.3g} | {median:.3f} ({low:.3f} to {high:.3f}) | {target} |")
    again = float(np.median(times[AGAIN]) / np.median(times["eager"]))
    print(f"The default, timed twice, differs by {100 * abs(again - 1):.1f} %.")


def compile_for(target: str) -> None:
    """Compile for a processor in vectors of eight. Dr.Jit offers no Python function for it."""
    import drjit as dr

    dr.eval(dr.llvm.Float(1, 2) + 1)
    core = ctypes.CDLL(str(Path(dr.__file__).with_name("libdrjit-core.so")))
    core._Z19jit_llvm_set_targetPKcS0_j(target.encode(), None, 8)


def measure_bound(target: str, block: int) -> None:
    """The fused decoder beside multiply-adds in registers, on one core."""
    import drjit as dr
    import drjit.llvm

    from bench.timing.fused.with_drjit import DrJitNetwork

    @dr.freeze
    def registers(x: Any, slope: Any, step: Any) -> Any:
        """CHAINS · LENGTH multiply-adds for each number, none of which waits for memory."""
        sums = [x + chain for chain in range(CHAINS)]
        for _ in range(LENGTH):
            dr.detail.new_scope(dr.JitBackend.LLVM)
            sums = [dr.fma(total, slope, step) for total in sums]
        return sum(sums)

    def arithmetic() -> None:
        dr.eval(registers(*flat))
        dr.sync_thread()

    def seconds(call: Call) -> float:
        before = time.process_time()
        call()
        return time.process_time() - before

    dr.set_thread_count(1)
    if target:
        compile_for(target)
    decoder = DrJitNetwork(neubtf())
    decoder.block = block or (12 if target else decoder.block)
    x = torch.randn(SAMPLES, 18, generator=torch.Generator().manual_seed(1))
    flat = [drjit.llvm.Float(np.random.default_rng(0).random(SAMPLES, np.float32)) for _ in range(3)]
    decoder(x), arithmetic()
    turns = np.array([[seconds(arithmetic), seconds(lambda: decoder(x))] for _ in range(TURNS)]) / SAMPLES * 1e9
    bound, taken = turns[:, 0] / (CHAINS * LENGTH) * OPERATIONS, turns[:, 1]
    version = ".".join(map(str, dr.detail.llvm_version()))
    print(f"LLVM {version}, {target or 'this processor'}, block {decoder.block}: {np.median(taken):.0f} ns a sample")
    print(f"arithmetic takes {np.median(bound):.0f} ns: {100 * np.median(bound / taken):.0f} % of the bound")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--samples", type=int, default=1 << 20)
    parser.add_argument("--threads", type=int, default=0, help="0: all")
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--bound", action="store_true", help="the fused decoder beside arithmetic alone")
    parser.add_argument("--target", default="", help="LLVM's name of a processor with AVX2 (default: the one at hand)")
    parser.add_argument("--block", type=int, default=0, help="sums that grow side by side")
    chosen = parser.parse_args()
    keep_buffers()
    with torch_threads(1 if chosen.bound else chosen.threads or torch.get_num_threads()):
        if chosen.bound:
            return measure_bound(chosen.target, chosen.block)
        print(f"{chosen.samples:,} samples, {torch.get_num_threads()} threads, {time.strftime('%Y-%m-%d %H:%M')}\n")
        measure(on_cpu(chosen.samples), chosen.samples, chosen.rounds)


if __name__ == "__main__":
    main()
