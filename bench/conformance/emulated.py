"""An emulated GPU: tensors in host memory that PyTorch takes for a GPU's, to find mistakes where there is no GPU.

It is PyTorch's spare backend, "PrivateUse1", under the name "gpu". A tensor on it has a storage of its own over the
memory of a CPU tensor, so that views, autograd, optimisers and modules are PyTorch's. Each operation runs on the CPU,
and therefore gives the CPU's bits; but it is refused where CUDA would refuse it: for tensors on two devices, and for a
generator of the CPU. `counted` counts what a GPU and its host would do: kernels, waits, and bytes copied.

Not emulated: rounding and order of sums of a GPU, dtypes that it lacks, asynchrony, torch.compile and Triton.
"""

import linecache
import re
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from types import FrameType, ModuleType
from typing import Any

import torch
from torch import Tensor
from torch.utils import _pytree as tree

NAME = "gpu"
DIFFERENT = "expected all tensors"  # begins, in lower case, what PyTorch and this module say of tensors on two devices

# Where CUDA takes tensors of the CPU: indices, and numbers (0-dim) in `pointwise` operations and in these.
_INDEXING = {"aten::index", "aten::index_put", "aten::index_put_", "aten::_index_put_impl_"}
_OF_NUMBERS = {"aten::masked_fill", "aten::masked_fill_", "aten::index_fill_", "aten::fill_", *_INDEXING}
# Where a host waits for a GPU: a number, a size that depends on data, a solver that reports errors.
_WAITING = {
    *("aten::_local_scalar_dense", "aten::nonzero", "aten::masked_select", "aten::_unique2", "aten::unique_dim"),
    *("aten::equal", "aten::repeat_interleave", "aten::_linalg_eigh", "aten::_linalg_svd", "aten::linalg_inv_ex"),
    "aten::_linalg_solve_ex",
}
# Beginnings of names of operations that start nothing on a GPU.
_WITHOUT_KERNEL = ("aten::empty", "aten::set_", "aten::resize_")
_aten = torch.ops.aten
# Makes a tensor one over a given storage. With `_cpu_keys`, PyTorch runs its CPU code for a tensor of the device.
_place = _aten.set_.source_Storage_storage_offset
_clone: Callable[[Any], Any] = torch.UntypedStorage.clone
_cpu_keys: Any = torch._C.DispatchKeySet(torch._C.DispatchKey.CPU)
_libraries = list[torch.library.Library]()  # they hold the kernels


class NoEmulationError(Exception):
    """This PyTorch cannot emulate a GPU: it is too old, or has another device in its place."""


@dataclass
class Traffic:
    """What a GPU and its host did: kernels and waits by the name of the operation, and bytes copied between the two.

    A copy between the two is a wait, too, unless it goes up and is `non_blocking`.
    """

    kernels: Counter[str] = field(default_factory=Counter)
    waits: Counter[str] = field(default_factory=Counter)
    copied: int = 0


_traffic = list[Traffic]()


@contextmanager
def counted() -> Iterator[Traffic]:
    """Count what happens on the device in this block."""
    traffic = Traffic()
    _traffic.append(traffic)
    try:
        yield traffic
    finally:
        _traffic.pop()  # blocks nest, so the last is this one's


@contextmanager
def emulated() -> Iterator[torch.device]:
    """The device, in a block in which it works. `NoEmulationError` if it cannot be."""
    register()
    try:
        with torch.enable_grad():
            torch.ones((), device=NAME, requires_grad=True).square().backward()
    except RuntimeError as error:  # autograd's engine counted the devices before this one
        raise NoEmulationError("a GPU is emulated only in a process that took no gradient before") from error
    before = torch.__future__.get_swap_module_params_on_conversion()
    # `Module.to` keeps its parameters, as on CUDA; and `copy.deepcopy` copies storages, which have no allocator here.
    torch.__future__.set_swap_module_params_on_conversion(True)
    torch.UntypedStorage.clone = _cloned  # type: ignore[method-assign, assignment]
    try:
        yield torch.device(NAME, 0)
    finally:
        torch.UntypedStorage.clone = _clone  # type: ignore[method-assign]
        torch.__future__.set_swap_module_params_on_conversion(before)


class HostEvent:
    """An event as a GPU's, by the host's clock: its kernels have ended when their call returns."""

    def __init__(self, enable_timing: bool = False):
        """`enable_timing` is an option of a GPU's events; this one always notes its time."""
        self.seconds = 0.0

    def record(self) -> None:
        """Note the time at which all kernels before have ended, which is now."""
        self.seconds = time.perf_counter()

    def synchronize(self) -> None:
        """Wait until the event has happened, which it has."""

    def elapsed_time(self, end: "HostEvent") -> float:
        """Milliseconds until another event."""
        return 1e3 * (end.seconds - self.seconds)


class HostGraph:
    """A graph as a GPU's: operations that are recorded, without having changed anything, and done again in the same
    memory."""

    def __init__(self) -> None:
        self.operations: list[Callable[[], Any]] = []
        # By address: memory that an operation overwrites, and a copy of what it held before the recording.
        self.overwritten: dict[int, tuple[torch.UntypedStorage, torch.UntypedStorage]] = {}

    def __enter__(self) -> None:
        _recording.append(self)

    def __exit__(self, *error: object) -> None:
        """Leave all memory as it was before the recording."""
        _recording.pop()
        for memory, held in self.overwritten.values():
            if held.nbytes() == memory.nbytes():  # else it was made while recording, of no size at first
                memory.copy_(held)

    def keep(self, tensor: Tensor) -> None:
        """Keep what the memory of a tensor of the device holds, before it is overwritten."""
        memory = tensor.untyped_storage().memory  # type: ignore[attr-defined]
        if memory.data_ptr() not in self.overwritten:
            self.overwritten[memory.data_ptr()] = memory, _clone(memory)

    def replay(self) -> None:
        """Do all operations again."""
        for operation in self.operations:
            operation()


_recording = list[HostGraph]()


def register() -> None:
    """Add the device to PyTorch; `NoEmulationError` if it cannot. A process must do so before its first gradient."""
    if _libraries:
        return
    try:
        from torch.utils.backend_registration import _setup_privateuseone_for_python_backend
    except ImportError as error:
        raise NoEmulationError(f"a GPU is emulated by PyTorch 2.9 or newer, and this is {torch.__version__}") from error
    try:
        _setup_privateuseone_for_python_backend(NAME)
    except RuntimeError as error:
        raise NoEmulationError(f"no GPU is emulated where PyTorch has another device: {error}") from error
    every = torch.library.Library("_", "IMPL")  # "_": of every namespace
    aten = torch.library.Library("aten", "IMPL")
    every.fallback(_computed, "PrivateUse1")
    kernels: dict[str, Callable[..., Any]] = {
        "_copy_from": _copied,
        "set_.source_Storage_storage_offset": partial(_place.redispatch, _cpu_keys),
        "convolution_overrideable": partial(_computed, _aten.convolution.default),
        "convolution_backward_overrideable": _convolved_back,
        # Otherwise PyTorch makes these of several kernels, unlike CUDA.
        **{name: partial(_computed, getattr(_aten, name).default) for name in ("native_layer_norm", "mse_loss")},
    }
    for name, kernel in kernels.items():
        aten.impl(name, kernel, "PrivateUse1")
    module: Any = torch.get_device_module(NAME)
    module.Event = HostEvent
    module.CUDAGraph = HostGraph
    module.graph = lambda graph: graph  # the block in which it records
    module.synchronize = lambda device=None: None
    _libraries.extend([every, aten])


def _on_device(value: Any) -> bool:
    """Whether a tensor, a storage or a generator is on the emulated device."""
    return value.device.type == NAME


def _host(tensor: Tensor) -> Tensor:
    """The CPU tensor over the memory of one on the device, with its dtype, sizes and strides."""
    storage: Any = tensor.untyped_storage()
    return torch.empty(0, dtype=tensor.dtype).set_(
        storage.memory, tensor.storage_offset(), tensor.size(), tensor.stride()
    )


def _storage(memory: torch.UntypedStorage) -> Any:
    """A storage of the device over the memory of one of the CPU."""
    make: Any = torch._C._construct_storage_from_data_pointer
    storage = make(memory.data_ptr(), torch.device(NAME, 0), memory.nbytes())
    storage.memory = memory  # keeps it alive
    return storage


def _device(host: Tensor, storage: Any = None, out: Tensor | None = None) -> Tensor:
    """A tensor of the device over the memory of a CPU tensor.

    `storage` is the device's storage of that memory, if there is one already; `out` is a tensor of the device that
    shall be the one over it, instead of a new tensor.
    """
    acc: Any = torch._C._acc
    out = acc.create_empty_tensor((0,), host.dtype) if out is None else out
    storage = _storage(host.untyped_storage()) if storage is None else storage
    return _place.redispatch(_cpu_keys, out, storage, host.storage_offset(), host.size(), host.stride())


def _cloned(storage: torch.UntypedStorage) -> torch.UntypedStorage:
    """A copy of a storage where it is: PyTorch's own method fails on the device."""
    if not _on_device(storage):
        return _clone(storage)
    return _storage(_clone(storage.memory))  # type: ignore[attr-defined]


class _Operands:
    """The tensors of one operation: checked and lowered to the CPU; its results raised to the device again."""

    def __init__(self, op: Any):
        """`op` is an operation of PyTorch, one overload of it."""
        self.op = op
        self.name = op._schema.name
        # By the id of a CPU tensor that the operation is given: this tensor, and the device's that it stands for.
        self.lowered_tensors: dict[int, tuple[Tensor, Tensor]] = {}
        # By the address of a storage of the CPU (`_cdata`): the device's storage over the same memory.
        self.storages: dict[int, Any] = {}

    def lowered(self, value: Any, position: int = -1) -> Any:
        """An argument as the CPU takes it; `position` is its place among those without a name, −1 for one with a name.
        `RuntimeError` for a tensor or a generator of the CPU where CUDA takes none."""
        if isinstance(value, torch.Generator) and not _on_device(value):
            raise RuntimeError(f"{self.name}: expected a generator on {NAME}, but it is on {value.device}")
        if isinstance(value, torch.device):
            return torch.device("cpu")
        if not isinstance(value, Tensor):
            return value
        if _on_device(value):
            host = _host(value)
            self.lowered_tensors[id(host)] = host, value
            self.storages[host.untyped_storage()._cdata] = value.untyped_storage()
            return host
        takes_numbers = torch.Tag.pointwise in self.op.tags or self.name in _OF_NUMBERS
        if value.ndim == 0 and takes_numbers:  # a number, which the host passes to the kernel
            return value
        if self.name in _INDEXING and position == 1:  # the indices, the second argument, which a GPU copies
            _count_copy("an index", value)
            return value
        raise RuntimeError(f"{self.name}: {DIFFERENT} on {NAME}, but one is on {value.device}")

    def raised(self, value: Any) -> Any:
        """A result of the CPU as a tensor of the device: the one that was given, if it was written in place."""
        if not isinstance(value, Tensor):
            return value
        if id(value) not in self.lowered_tensors:  # a new tensor
            # If it is a view of an argument, it shares the device's storage, too; else it gets a storage of its own.
            storage = self.storages.get(value.untyped_storage()._cdata)
            return _device(value, storage)
        host, ours = self.lowered_tensors[id(value)]  # an argument, written in place
        if ours.shape == host.shape and ours.untyped_storage().nbytes() == host.untyped_storage().nbytes():
            return ours
        return _device(host, out=ours)  # it was resized, so the device's has to follow

    def only_views(self, results: Any) -> bool:
        """Whether all that an operation returned are views of what it was given."""
        new = [x for x in tree.tree_leaves(results) if isinstance(x, Tensor) and id(x) not in self.lowered_tensors]
        return bool(new) and all(x.untyped_storage()._cdata in self.storages for x in new)


def _computed(op: Any, *args: Any, **kwargs: Any) -> Any:
    """Compute an operation of the device on the CPU. Counts it, and records it where a graph is recorded."""
    operands = _Operands(op)
    unnamed = [tree.tree_map(partial(operands.lowered, position=i), argument) for i, argument in enumerate(args)]
    named = {key: tree.tree_map(operands.lowered, value) for key, value in kwargs.items()}
    compute = partial(_accepting(op, args), *unnamed, **named)
    if _recording:
        _keep_written(op, args, kwargs)
    results = compute()
    starts_kernel = not operands.only_views(results) and not operands.name.startswith(_WITHOUT_KERNEL)
    if starts_kernel:
        for traffic in _traffic:
            counter = traffic.waits if operands.name in _WAITING else traffic.kernels
            counter[operands.name] += 1
    raised = tree.tree_map(operands.raised, results)
    if _recording and starts_kernel:
        _record(operands.name, compute, results)
    return raised


def _accepting(op: Any, args: Sequence[Any]) -> Callable[..., Any]:
    """The operation in a form that takes these arguments: PyTorch wraps a number as a tensor for some overloads, and
    unwraps it again for a kernel in Python, so that only another overload takes it."""
    accepting: Callable[..., Any] = op
    for declared, given in zip(op._schema.arguments, args, strict=False):
        if str(declared.type) == "Tensor" and isinstance(given, int | float):
            accepting = op._overloadpacket
    return accepting


def _keep_written(op: Any, args: Sequence[Any], kwargs: dict[str, Any]) -> None:
    """Note for the recorded graph the tensors that an operation writes into, before it does."""
    declared = op._schema.arguments
    given = {argument.name: value for argument, value in zip(declared, args, strict=False)} | kwargs
    for argument in declared:
        if argument.is_write:
            tree.tree_map_only(Tensor, _recording[-1].keep, given.get(argument.name))


def _record(name: str, compute: Callable[[], Any], results: Any) -> None:
    """Add an operation to the graph that is recorded: `compute` does it again on the same tensors, over the device's
    memory; `results` are those of the first time, which later operations read. `RuntimeError` for one that waits."""
    if name in _WAITING:
        raise RuntimeError(f"{name}: operation not permitted when stream is capturing")

    def again() -> None:
        """Compute it again, and copy its results to where the first ones are, unless it wrote them there."""
        new_results = tree.tree_leaves(compute())
        for first, new in zip(tree.tree_leaves(results), new_results, strict=True):
            if isinstance(first, Tensor) and first is not new:
                first.copy_(new)

    _recording[-1].operations.append(again)


def _count_copy(what: str, tensor: Tensor, waits: bool = True) -> None:
    """Count a copy between host and device and, if the host `waits` for it, a wait under the name `what`."""
    for traffic in _traffic:
        traffic.copied += tensor.nbytes
        traffic.waits[what] += waits


def _copied(source: Tensor, target: Tensor, non_blocking: bool = False) -> Tensor:
    """Copy between two tensors, at least one of them on the device."""
    from_device, to_device = _on_device(source), _on_device(target)
    host_source = _host(source) if from_device else source
    host_target = _host(target) if to_device else target
    if _recording:
        if not (from_device and to_device):
            raise RuntimeError("aten::copy_: operation not permitted when stream is capturing")
        _recording[-1].keep(target)
        _recording[-1].operations.append(partial(host_target.copy_, host_source))
    host_target.copy_(host_source)
    if from_device and to_device:
        for traffic in _traffic:
            traffic.kernels["aten::copy_"] += 1
    elif to_device:
        _count_copy("up", source, waits=not non_blocking)
    else:
        _count_copy("down", source)
    return target


def _convolved_back(grad: Tensor, *args: Any) -> Any:
    """The gradients of a convolution. PyTorch asks a device without the shape of the bias, the third argument of the
    operation on the CPU: a bias has a number for each channel of the result."""
    inputs_and_weights, rest = args[:2], args[2:]
    shape_of_bias = [grad.shape[1]]
    return _computed(_aten.convolution_backward.default, grad, *inputs_and_weights, shape_of_bias, *rest)


def left_in(frame: FrameType, line: int) -> list[str]:
    """The names on a line of a frame's code that are tensors of the CPU, or hold some: variables and globals."""
    words = re.findall(r"\w+", linecache.getline(frame.f_code.co_filename, line))
    variables = frame.f_globals | frame.f_locals
    return left_behind({word: variables.get(word) for word in words})


def left_behind(owner: object) -> list[str]:
    """The names of tensors of the CPU that an object holds, in its attributes, however deep."""
    names = list[str]()
    seen = set[int]()

    def search(value: Any, name: str) -> None:
        """Add the names of the CPU's tensors in a value that is called `name`."""
        if isinstance(value, Tensor):
            if value.device.type == "cpu":
                names.append(name)
        elif id(value) not in seen and not isinstance(value, type | ModuleType):
            seen.add(id(value))
            inner = value if isinstance(value, dict) else getattr(value, "__dict__", {})
            items = enumerate(value) if isinstance(value, list | tuple) else inner.items()
            for key, each in items:
                # PyTorch's modules keep their parts in dictionaries of their own, whose names tell a reader nothing.
                skipped = str(key) in ("_parameters", "_buffers", "_modules")
                search(each, name if skipped else f"{name}.{key}".lstrip("."))

    search(owner, "")
    return names
