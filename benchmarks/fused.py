"""The fused decoder of NeuBTF on the CPU beside what arithmetic alone would take: ns a sample on one core.

    python benchmarks/fused.py [--target haswell] [--block 12]

`--target haswell` compiles for AVX2 alone, in vectors of eight. Arithmetic is 2,720 multiply-adds of the products and
ten operations for each of the 96 hidden numbers. Its rate is that of a kernel of multiply-adds in registers, compiled
the same way and measured in turns with the decoder, in seconds of the processor: other processes disturb little.
"""

import argparse
import ctypes
import time
from pathlib import Path
from typing import Any

import drjit as dr
import drjit.llvm
import numpy as np
import torch

from bench.decoder import Architecture, Decoder
from bench.timing.fused.with_drjit import DrJitNetwork

NEUBTF = Architecture(18, (32, 32, 32), activation="sine", omega=2.0, norm=True, residual=True)
OPERATIONS = 18 * 32 + 2 * 32 * 32 + 32 * 3 + 10 * 96
SAMPLES, TURNS = 1 << 16, 25
CHAINS, LENGTH = 12, 300  # independent sums, and how long each is


def compile_for(target: str) -> None:
    """Compile for a processor in vectors of eight. Dr.Jit offers no Python function for it."""
    dr.eval(dr.llvm.Float(1, 2) + 1)
    core = ctypes.CDLL(str(Path(dr.__file__).with_name("libdrjit-core.so")))
    core._Z19jit_llvm_set_targetPKcS0_j(target.encode(), None, 8)


@dr.freeze
def registers(x: Any, slope: Any, step: Any) -> Any:
    """CHAINS · LENGTH multiply-adds for each number, none of which waits for memory."""
    sums = [x + chain for chain in range(CHAINS)]
    for _ in range(LENGTH):
        dr.detail.new_scope(dr.JitBackend.LLVM)
        sums = [dr.fma(total, slope, step) for total in sums]
    return sum(sums)


def seconds(call: Any) -> float:
    before = time.process_time()
    call()
    return time.process_time() - before


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--target", help="LLVM's name of a processor with AVX2 (default: the one at hand)")
    parser.add_argument("--block", type=int, help="sums that grow side by side")
    chosen = parser.parse_args()
    torch.set_num_threads(1)
    dr.set_thread_count(1)
    if chosen.target:
        compile_for(chosen.target)
    decoder = DrJitNetwork(Decoder(NEUBTF, torch.Generator().manual_seed(0)).requires_grad_(False))
    decoder.block = chosen.block or (12 if chosen.target else decoder.block)
    x = torch.randn(SAMPLES, 18, generator=torch.Generator().manual_seed(1))
    flat = [dr.llvm.Float(np.random.default_rng(0).random(n, np.float32)) for n in (SAMPLES, SAMPLES, SAMPLES)]

    def arithmetic() -> None:
        dr.eval(registers(*flat))
        dr.sync_thread()

    decoder(x), arithmetic()
    turns = np.array([[seconds(arithmetic), seconds(lambda: decoder(x))] for _ in range(TURNS)]) / SAMPLES * 1e9
    bound, taken = turns[:, 0] / (CHAINS * LENGTH) * OPERATIONS, turns[:, 1]
    version, target = ".".join(map(str, dr.detail.llvm_version())), chosen.target or "this processor"
    print(f"LLVM {version}, {target}, block {decoder.block}: {np.median(taken):.0f} ns a sample")
    print(f"arithmetic takes {np.median(bound):.0f} ns: {100 * np.median(bound / taken):.0f} % of the bound")


if __name__ == "__main__":
    main()
