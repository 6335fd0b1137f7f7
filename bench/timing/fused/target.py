"""Where Dr.Jit compiles a kernel for: the processor, by LLVM, or an NVIDIA GPU.

A kernel is the same code for both. On a processor a network is a function that the kernel calls (see `with_drjit`); a
GPU has it in line, where a weight is an operand of the multiply-add, too, and a call would pass its numbers by memory.
"""

from dataclasses import dataclass
from types import ModuleType
from typing import Any

import torch

from bench.inputs.errors import InputError, installed
from bench.machine.devices import is_gpu
from bench.program import llvm


@dataclass(frozen=True)
class Target:
    """A back end of Dr.Jit with its module of arrays, `drjit.llvm` or `drjit.cuda`."""

    arrays: ModuleType
    backend: Any  # of `drjit.JitBackend`
    calls: bool  # whether a network is a function that the kernel calls
    device: torch.device

    def ready(self) -> None:
        """Before a kernel: as many threads as PyTorch has; on a GPU, wait until PyTorch has written what it reads."""
        import drjit as dr

        if self.backend == dr.JitBackend.CUDA:  # which works beside PyTorch, in a stream of its own
            torch.cuda.synchronize(self.device)
        elif dr.thread_count() != torch.get_num_threads():
            dr.set_thread_count(torch.get_num_threads())


def target_of(device: torch.device) -> Target:
    """The target of a device. `InputError` says what is missing."""
    if not is_gpu(device):
        on_cpu = llvm.drjit()
        return Target(on_cpu.llvm, on_cpu.JitBackend.LLVM, calls=True, device=device)
    with installed("fused on a GPU needs Dr.Jit: pip install neubtf-bench[mitsuba]"):
        import drjit as dr
    if device.type != "cuda" or not dr.has_backend(dr.JitBackend.CUDA):
        raise InputError(f"fused: Dr.Jit finds no NVIDIA driver for {device}: use network")
    if device.index:
        raise InputError(f"fused: Dr.Jit computes on the first GPU alone, not on {device}: use cuda, or network")
    return Target(dr.cuda, dr.JitBackend.CUDA, calls=False, device=device)
