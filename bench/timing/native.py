"""Tells which short floats a processor multiplies itself; others are emulated: widened, multiplied and rounded."""

import platform
from pathlib import Path

import torch

from bench.machine.devices import is_gpu

# Words of /proc/cpuinfo and of `torch.cpu.get_capabilities`, of x86 and of ARM: each stands for an instruction that
# multiplies such numbers.
_PRODUCTS = {
    "bfloat16": {"avx512_bf16", "amx_bf16", "bf16", "svebf16"},
    "float16": {"avx512_fp16", "amx_fp16", "asimdhp", "fphp"},
}


def emulated(precision: str, device: torch.device) -> bool:
    """Whether a device only emulates products in a precision; False if the system does not say."""
    if is_gpu(device) or precision not in _PRODUCTS:
        return False
    if _x86() and not torch.backends.cpu.get_cpu_capability().startswith("AVX512"):
        return True  # PyTorch was told, or found, that none of the instructions above exist
    extensions = features()
    return extensions is not None and not _PRODUCTS[precision] & extensions


def features() -> set[str] | None:
    """The processor's extensions by name; None if neither Linux nor PyTorch gives them."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        lines = []
    for line in lines:
        name, _, words = line.partition(":")
        if name.strip() in ("flags", "Features"):
            return set(words.split())
    if _x86() and hasattr(torch.cpu, "get_capabilities"):  # since PyTorch 2.11; for ARM it uses other words
        return {name for name, value in torch.cpu.get_capabilities().items() if value is True}
    return None


def _x86() -> bool:
    """Whether this machine's processor is an x86 of 64 bits."""
    return platform.machine().lower() in ("x86_64", "amd64")
