"""Chooses how a decoded material is computed: its execution and precision. Neither changes the file.

| execution | what it is |
| --- | --- |
| `eager` | PyTorch's operations one by one, in chunks that fit the cache: the default of a material |
| `compiled` | `evaluate` through torch.compile, on the network folded by `bench.timing.fused.lean` |
| `network` | the network and its fetch as one kernel of a GPU, by Triton |
| `fused` | all of `evaluate` as one kernel, by Dr.Jit, on the CPU or an NVIDIA GPU; float32 |

A material whose `evaluate` cannot be recorded has no `fused` execution, and none has one with an LLVM that is too old
for the operations outside networks.

Precisions are those of textures, weights and products; places and directions stay float32. `TOLERANCES` gives the
largest error of the network's answer relative to float64.
"""

import copy
import os
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import torch
from torch import Tensor, nn

from bench.inputs.errors import InputError, did_you_mean, installed, said_by
from bench.machine.devices import is_gpu
from bench.material import Material, Wrapped
from bench.program.llvm import unusable
from bench.timing.fused.target import target_of
from bench.training.decoder import Decoder

EXECUTIONS = ("eager", "compiled", "network", "fused")
DTYPES = {"float32": torch.float32, "tf32": torch.float32, "bfloat16": torch.bfloat16, "float16": torch.float16}
# |answer − float64's| ≤ absolute + relative · the largest |float64's| of the batch, for every execution. Half
# precisions promise it only for networks with a layer norm or without a sine: they cannot hold a phase of many turns.
TOLERANCES = {"float32": (1e-5, 1e-4), "tf32": (1e-2, 2e-2), "float16": (1e-2, 2e-2), "bfloat16": (5e-2, 1e-1)}
# The most kernels of one function in a process, whatever the materials. Beyond them PyTorch silently computes eagerly.
MOST_RECOMPILES = 256
LONG_CHUNK = 65_536  # for compiled half precisions on the CPU: small intermediates, but some overhead a call
FUSED_CHUNK = 1 << 17  # on the CPU: long, because switching between PyTorch's and Dr.Jit's threads is slow


@dataclass(frozen=True)
class Variant:
    """An execution and a precision: `fused bfloat16`."""

    execution: str = "eager"
    precision: str = "float32"

    def __str__(self) -> str:
        return f"{self.execution} {self.precision}"

    @staticmethod
    def parse(text: str) -> "Variant":
        """The variant that a text names: an execution, or an execution and a precision.

        `InputError` names a wrong word.
        """
        execution, _, precision = text.partition(" ")
        precision = precision or "float32"
        for word, known in ((execution, EXECUTIONS), (precision, tuple(DTYPES))):
            if word not in known:
                remedy = f"write one of {', '.join(EXECUTIONS)}, and one of {', '.join(DTYPES)}"
                raise InputError(f"variant {text!r}: no {word!r}{did_you_mean(word, known)}: {remedy}")
        return Variant(execution, precision)


def exists_on(variant: Variant, device: torch.device) -> bool:
    """Whether a kind of device supports a variant; `prepared` reports missing packages."""
    on_nvidia = device.type == "cuda" and torch.version.hip is None
    if variant.execution == "fused":  # by Dr.Jit, which knows no short floats, and no other GPUs
        return variant.precision == "float32" and (on_nvidia or not is_gpu(device))
    if variant.precision == "tf32":  # NVIDIA's
        return on_nvidia
    return variant.execution != "network" or is_gpu(device)


def prepared(material: Material, variant: Variant) -> Material:
    """A copy of a material that is computed in a variant. `InputError` says what is missing or unsupported.

    For the whole process, convolutions in float32 may no longer be rounded as tf32.
    """
    if variant.precision == "tf32" and material.device.type != "cuda":
        raise InputError("tf32 is a precision of NVIDIA's GPUs: use float32 here")
    computed = copy.deepcopy(material).to(dtype=DTYPES[variant.precision])
    # PyTorch lets convolutions round to tf32 unless told not to; float32 must not. `_Tf32` and the kernels of networks
    # allow it themselves, where the variant asks for it.
    torch.backends.cudnn.allow_tf32 = False
    if variant.execution == "network":
        return _with_networks_fused(computed, variant)
    if variant.execution == "fused":
        return _fused(computed, variant)
    if variant.execution == "compiled":
        computed = _Compiled(computed)
    return _Tf32(computed) if variant.precision == "tf32" else computed


def networks(material: Material) -> list[Decoder]:
    """Every decoder network of a material, however deep."""
    return [module for module in nn.ModuleList(_modules(material)).modules() if isinstance(module, Decoder)]


def _modules(material: Material) -> list[nn.Module]:
    """The modules that are attributes of a material."""
    return [value for value in vars(material).values() if isinstance(value, nn.Module)]


def _replace_networks(material: Material, make: Callable[[Decoder], nn.Module]) -> None:
    """Replace each decoder network of a material, changing it, by `make(network)`."""
    # What holds a value, under which name, and the value.
    attributes: list[tuple[Any, str, Any]] = [(material, name, value) for name, value in vars(material).items()]
    for root in _modules(material):
        for module in root.modules():
            attributes += [(module, name, child) for name, child in module.named_children()]
    # Replaced only now, since a loop over modules must not change them.
    for holder, name, value in attributes:
        if isinstance(value, Decoder):
            setattr(holder, name, make(value))


def _fused(material: Material, variant: Variant) -> Material:
    """The material as one kernel, with its networks in it. `InputError` if it cannot be.

    A copy of it is recorded, in which a placeholder with a number stands for each network: the kernel computes a
    network as a whole, in the layers of the `decoders`, and not by the single operations of PyTorch.
    """
    if variant.precision != "float32":
        raise InputError(f"fused computes in float32, not {variant.precision}: use compiled")
    target = target_of(material.device)
    too_old = "" if is_gpu(material.device) else unusable(plugins=True)
    if too_old:
        raise InputError(f"{too_old}; or use compiled")
    from bench.timing.fused.whole import Placeholder, Whole

    recorded = copy.deepcopy(material).to("cpu")
    decoders: list[Decoder] = []

    def placeholder(decoder: Decoder) -> nn.Module:
        """What stands for a network in the copy; notes the network in `decoders`, at the place of its number."""
        decoders.append(decoder)
        return Placeholder(len(decoders) - 1, decoder.architecture.outputs)

    _replace_networks(recorded, placeholder)
    fused = Whole(material, recorded, decoders, target)
    if not is_gpu(material.device):  # a GPU's chunks are long enough
        fused.chunk = FUSED_CHUNK
    return fused


def _with_networks_fused(material: Material, variant: Variant) -> Material:
    """The material with its networks as kernels of a GPU. `InputError` if it has none, or they cannot be."""
    if not is_gpu(material.device):
        raise InputError("network is an execution of GPUs: use fused or compiled")
    if not networks(material):
        raise InputError("network computes decoder networks, and this codec has none: use eager or fused")
    with installed("network needs Triton: pip install triton"):
        from bench.timing.fused.with_triton import TritonNetwork
    _replace_networks(material, partial(TritonNetwork, tf32=variant.precision == "tf32"))
    return material


class _Compiled(Wrapped):
    """`evaluate` through torch.compile: a kernel of fixed size for whole chunks, and one of any size for the rest."""

    def __init__(self, inner: Material):
        """Prepare both kernels, which are compiled when they are first called. Replaces the networks of `inner`."""
        from bench.timing.fused.lean import Lean, compiled

        needs_compiler(inner.device)
        _replace_networks(inner, Lean)
        if not is_gpu(inner.device) and inner.dtype.itemsize < 4:
            inner.chunk = LONG_CHUNK
        super().__init__(inner)
        self.whole = compiled(inner.evaluate, dynamic=False)
        self.rest = compiled(inner.evaluate, dynamic=True)

    def evaluate(self, uv: Tensor, wo: Tensor, wi: Tensor, footprint: Tensor) -> Tensor:
        """RGB (n, 3) by the kernel for whole chunks or by that for the rest, each compiled at its first call.

        `InputError` if compiling fails.
        """
        # `slice` expands one direction to all texels (stride 0): torch.compile would make another kernel for it.
        queries = [x.contiguous() for x in (uv, wo, wi, footprint)]
        compute = self.whole if len(uv) == self.chunk else self.rest
        try:
            # Only sizes vary: by default a kernel for any size would also read each constant from memory.
            with torch._dynamo.config.patch({"specialize_float": True, "recompile_limit": MOST_RECOMPILES}):
                rgb: Tensor = compute(*queries)
        except torch._dynamo.exc.TorchDynamoException as error:
            from torch._inductor.runtime.cache_dir_utils import cache_dir

            # A process that is killed while compiling leaves an incomplete library in the cache.
            remedy = f"remove its cache, {cache_dir()}, or use eager"
            raise InputError(f"torch.compile failed ({said_by(error)}): {remedy}") from error
        return rgb


class _Tf32(Wrapped):
    """Products of float32 numbers rounded as tf32."""

    def evaluate(self, uv: Tensor, wo: Tensor, wi: Tensor, footprint: Tensor) -> Tensor:
        """RGB (n, 3) of the inner material, while PyTorch may round products as tf32."""
        kinds: list[Any] = [torch.backends.cuda.matmul, torch.backends.cudnn]
        earlier = [kind.allow_tf32 for kind in kinds]
        for kind in kinds:
            kind.allow_tf32 = True
        try:
            return self.inner.evaluate(uv, wo, wi, footprint)
        finally:
            for kind, allowed in zip(kinds, earlier, strict=True):
                kind.allow_tf32 = allowed


def needs_compiler(device: torch.device) -> None:
    """Raise `InputError` if torch.compile would find no compiler for a device."""
    if is_gpu(device):
        return
    compilers = [os.environ.get("CXX"), "g++", "clang++"]
    if not any(shutil.which(compiler) for compiler in compilers if compiler):
        raise InputError("compiled needs a C++ compiler: install g++ or clang++, or name one in CXX; or use eager")
