"""The most memory that a stretch of work takes: of this process on a CPU, of PyTorch's tensors on a GPU."""

import re
from pathlib import Path

import torch

from bench.machine.devices import is_gpu

_PROCESS = Path("/proc/self")
_RESET_PEAK = "5"  # what the kernel's `clear_refs` takes to forget the peak so far: see proc(5)


def forget_peak(device: torch.device) -> bool:
    """Start anew: `peak_bytes` tells the most since now. Returns whether that could be done."""
    if is_gpu(device):
        reset = getattr(torch.get_device_module(device), "reset_peak_memory_stats", None)
        if reset is None:  # not each maker's module has it
            return False
        reset(device)
        return True
    try:
        (_PROCESS / "clear_refs").write_text(_RESET_PEAK, encoding="ascii")
    except OSError:  # only Linux has this file, and a sandbox may not let it be written
        return False
    return True


def peak_bytes(device: torch.device) -> int | None:
    """The most bytes that were held at once since `forget_peak`, if that could be done; None where nobody counts them.

    On a CPU it is all memory of this process, PyTorch and the BTF included.
    """
    if is_gpu(device):
        peak_of = getattr(torch.get_device_module(device), "max_memory_allocated", None)
        return None if peak_of is None else int(peak_of(device))
    try:
        status = (_PROCESS / "status").read_text(encoding="utf-8")
    except OSError:
        return None
    kilobytes = re.search(r"^VmHWM:\s+(\d+) kB$", status, re.MULTILINE)
    return int(kilobytes[1]) * 1024 if kilobytes else None
