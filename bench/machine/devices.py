"""Tells GPUs from CPUs, by whatever name PyTorch knows them; imports PyTorch only where it must ask it."""

import re
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bench.inputs.errors import InputError

if TYPE_CHECKING:
    import torch

LOADED_SECONDS = 0.5  # before a GPU's power is read: drivers average over some tenths of a second


def is_gpu(device: "torch.device | str") -> bool:
    """Whether a device is a GPU, of any maker."""
    return str(device).partition(":")[0] != "cpu"


def present(device: "torch.device | str") -> bool:
    """Whether PyTorch finds this device here; without a number, such as `cuda`, one of its kind.

    `RuntimeError` for a kind of device that this PyTorch was not built for.
    """
    import torch

    if not is_gpu(device):
        return True
    module = torch.get_device_module(device)
    return bool(module.is_available()) and (torch.device(device).index or 0) < module.device_count()


def records_graphs(device: "torch.device") -> bool:
    """Whether a device can record the kernels of a step once, and start them all at once from then on."""
    import torch

    return hasattr(torch.get_device_module(device), "CUDAGraph")


def watts(device: "torch.device", call: Callable[[], Any]) -> float | None:
    """The power, in W, that a GPU draws while it repeats a call, as its driver tells it; None where it tells none."""
    import torch

    module = torch.get_device_module(device)
    if not hasattr(module, "power_draw"):
        return None
    end = time.monotonic() + LOADED_SECONDS
    while time.monotonic() < end:
        call()
    try:
        return float(module.power_draw(device)) / 1000  # it tells milliwatts
    except (ImportError, RuntimeError):  # NVIDIA's needs the package `nvidia-ml-py`
        return None


def require_present(name: str, option: str) -> None:
    """Raise an `InputError`, which names the option, if PyTorch does not know a device of this name, or finds none."""
    import torch

    try:
        here = present(torch.device(name))
    except RuntimeError:
        raise InputError(f"{option} {name}: no such device: use cpu or cuda") from None
    if not here:
        raise InputError(f"{option} {name}: PyTorch finds no such device here: use cpu")


def device_name(device: "torch.device | str") -> str:
    """The name of a GPU, with the versions of NVIDIA's driver ("unknown" without it) and of the CUDA that PyTorch was
    built for ("none" without it): times depend on them. "" for a CPU."""
    import torch

    if not is_gpu(device):
        return ""
    # Some makers' modules have no such function: then `str` gives the name of the device, such as `mps`.
    name_of = getattr(torch.get_device_module(device), "get_device_name", str)
    try:
        about_driver = Path("/proc/driver/nvidia/version").read_text(encoding="utf-8")
    except OSError:
        about_driver = ""
    version = re.search(r"\d+\.\d[.\d]*", about_driver)
    return f"{name_of(device)}, driver {version[0] if version else 'unknown'}, CUDA {torch.version.cuda or 'none'}"
