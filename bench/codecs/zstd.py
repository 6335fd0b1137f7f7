"""Compresses tensors by Zstandard into one tensor of bytes."""

from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

from bench.inputs.errors import ContainerError, installed

if TYPE_CHECKING:
    from torch import Tensor

LEVEL = 19


def compressed(data: bytes) -> "Tensor":
    """Compress bytes into a tensor (n,) uint8."""
    import torch

    packed = _library("zstd = true").ZstdCompressor(level=LEVEL).compress(data)
    return torch.frombuffer(bytearray(packed), dtype=torch.uint8)


def expanded(payload: "Tensor", path: Path, most: int) -> "dict[str, Tensor]":
    """Expand a compressed safetensors file of at most `most` bytes. `ContainerError` if it is damaged."""
    from safetensors import SafetensorError
    from safetensors.torch import load

    zstandard = _library(str(path))
    if str(payload.dtype) != "torch.uint8":
        raise ContainerError(f"{path}: a compressed part is {payload.dtype}, not bytes")
    data = payload.numpy().tobytes()
    try:
        if not 0 <= zstandard.frame_content_size(data) <= most:
            raise ContainerError(f"{path}: a compressed part gives no size, or one far too large for the file")
        return load(zstandard.ZstdDecompressor().decompress(data))
    except (zstandard.ZstdError, SafetensorError) as error:
        raise ContainerError(f"{path}: a compressed part is not sound ({error})") from error


def _library(what: str) -> ModuleType:
    with installed(f"{what}: needs the package zstandard: pip install 'neubtf-bench[zstd]'"):
        import zstandard
    return zstandard
