"""Tells GPUs from CPUs, by whatever name PyTorch knows them; imports PyTorch only where it must ask it."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import torch


def is_gpu(device: "torch.device | str") -> bool:
    """Whether a device is a GPU, of any maker."""
    return str(device).partition(":")[0] != "cpu"


def present(device: "torch.device | str") -> bool:
    """Whether PyTorch finds a device of this kind here."""
    import torch

    return not is_gpu(device) or bool(torch.get_device_module(device).is_available())
