"""Records a decoded material as a program: the steps that compute one query, and the constants that they need.

`program_of` records the operations of `Material.faded` for one query with PyTorch's tracer. So one generator writes the
shaders of all codecs whose operations it knows, including external ones; no codec writes a shader. Operations on only
constants are computed here and become constants.
"""

import io
import logging
import threading
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, redirect_stdout
from typing import Any

import torch
from torch import Tensor
from torch._guards import TracingContext, tracing
from torch._subclasses.fake_tensor import FakeTensorMode
from torch.func import functionalize
from torch.fx import GraphModule
from torch.fx.experimental.proxy_tensor import make_fx

from bench.inputs.errors import InputError
from bench.material import Material
from bench.program import INPUTS, Program, Step

MOST_RANKED = 256  # the most numbers that a program ranks: to find nine, a shader takes 54 statements for each of them
# Operations that return the values of their argument unchanged.
SAME = ("alias", "detach", "clone", "contiguous", "lift_fresh_copy")

_RECORDING = threading.Lock()  # PyTorch's state while recording is global, so two recordings would disturb each other


@contextmanager
def _quiet() -> Iterator[None]:
    """Silence what PyTorch warns, logs and prints while it records."""
    before = logging.root.manager.disable
    logging.disable(logging.CRITICAL)
    try:
        with warnings.catch_warnings(), redirect_stdout(io.StringIO()):
            warnings.simplefilter("ignore")
            yield
    finally:
        logging.disable(before)


@contextmanager
def _exporting() -> Iterator[None]:
    """Let `torch.compiler.is_exporting()` say that a recording is under way, as in `torch.export`."""
    flags = "_is_compiling_flag", "_is_exporting_flag"
    before = [getattr(torch.compiler, flag) for flag in flags]
    try:
        for flag in flags:
            setattr(torch.compiler, flag, True)
        yield
    finally:
        for flag, value in zip(flags, before, strict=True):
            setattr(torch.compiler, flag, value)


def _graph_of(material: Material) -> GraphModule:
    """The graph of a material's answer to one query, in operations of the core set that change nothing in place.

    `torch.export` gives the same graph in three times the time.
    """
    # Only the shapes of this query matter: what depends on its values cannot be recorded.
    zenith = torch.tensor([[0.0, 0.0, 1.0]])
    query = torch.full((1, 2), 0.5), zenith, zenith.clone(), torch.full((1,), 0.01)
    # How operations are taken apart into those of the core set; two more are added.
    decompositions = torch.export.default_decompositions()
    decompositions[torch.ops.aten._cdist_forward.default] = _distances
    decompositions[torch.ops.aten.topk.default] = _top_k
    # What was not read from a file has no lowest light.
    answer = material.faded if material.lowest_light else material.evaluate

    def of_query(uv: Tensor, wo: Tensor, wi: Tensor, footprint: Tensor) -> Tensor:
        """The answer, as a function: of a method, the tracer would count `self` as one more argument."""
        return answer(uv, wo, wi, footprint)

    # Without a mode of its own PyTorch makes a new one for each step, which takes half of the time.
    one_mode = tracing(TracingContext(FakeTensorMode(allow_fallback_kernels=True)))
    with torch.no_grad(), _quiet(), _exporting(), one_mode:
        as_written = make_fx(of_query)(*query)
        # `functionalize` takes only what PyTorch itself does not take apart, so it is given the first graph.
        graph = make_fx(functionalize(as_written), decomposition_table=dict(decompositions))(*query)
    graph.graph.eliminate_dead_code()
    return graph


def _distances(left: Tensor, right: Tensor, order: float, mode: int | None) -> Tensor:
    """`cdist` as plain operations: Euclidean distances (..., n, m) of points (..., n, k) and (..., m, k). `mode`, how
    PyTorch would compute them, is ignored; `InputError` if `order` is not 2."""
    if order != 2:
        raise InputError(f"distances of order {order:g}")
    return (left.unsqueeze(-2) - right.unsqueeze(-3)).square().sum(-1).sqrt()


def _top_k(source: Tensor, count: int, axis: int = -1, largest: bool = True, ranked: bool = True) -> list[Tensor]:
    """`topk` as plain operations: the extreme number is found, then replaced by one that comes last, `count` times.

    So results are in order, `ranked` or not. `InputError` if there are more than `MOST_RANKED` numbers along the axis.
    """
    rows = source.shape[axis]
    if rows > MOST_RANKED:
        raise InputError(f"it ranks {rows:,} numbers, but the limit is {MOST_RANKED}")
    # With the sign that puts it after every number that a material computes.
    half_of_largest = torch.finfo(source.dtype).max / 2
    last = -half_of_largest if largest else half_of_largest
    axes_after = source.ndim - 1 - axis % source.ndim
    # (rows, 1, …), so that it broadcasts along `axis` of the source.
    numbers = torch.arange(rows).unflatten(0, [rows] + [1] * axes_after)
    places, values = [], []
    for _ in range(count):
        place = source.argmax(axis, keepdim=True) if largest else source.argmin(axis, keepdim=True)
        places.append(place)
        values.append(source.gather(axis, place))
        source = torch.where(numbers == place, last, source)
    return [torch.cat(values, axis), torch.cat(places, axis)]


def program_of(material: Material) -> Program:
    """The program of a float32 material on the CPU. Raises `InputError` if `evaluate` cannot be recorded: it branches
    in Python on the values of a query, or uses something other than tensor operations."""
    try:
        # In a thread of its own. A profiler that inspects the frames of this one, such as a Dask worker's, keeps them
        # alive, and with them guards by which PyTorch pauses recording, so an operation would be missing.
        with _RECORDING, ThreadPoolExecutor(1) as thread:
            graph = thread.submit(_graph_of, material).result()
        return _program_from(graph, material.size)
    except Exception as error:  # PyTorch has no type of its own for what it cannot record
        message = str(error).strip()
        what = message.splitlines()[0] if message else type(error).__name__
        raise InputError(f"this material cannot be recorded as a program: {what}") from error


def _program_from(graph: GraphModule, size: tuple[int, int]) -> Program:
    """The program of a recording, for a material of `size` (H, W)."""
    recorder = _Recorder()
    inputs = iter(INPUTS)
    for node in graph.graph.nodes:
        match node.op:
            case "placeholder":
                recorder.values[node.name] = next(inputs)
            case "get_attr":  # a constant
                recorder.values[node.name] = getattr(graph, str(node.target)).detach()
            case "call_function":
                recorder.record(node)
            case "output":
                (result,) = node.args
    return recorder.program(result.name, size)


class _Recorder:
    """Maps each node of the graph to a constant tensor, or to the name of an input or a step."""

    def __init__(self) -> None:
        self.values: dict[str, Any] = {}  # by name of the node
        self.steps: list[Step] = []

    def record(self, node: torch.fx.Node) -> None:
        """Compute a node whose arguments are all constants, or note it as a step."""
        target: Any = node.target
        operation = str(getattr(target, "overloadpacket", target).__name__).removeprefix("_")
        if operation == "assert_tensor_metadata":  # it computes nothing
            return
        arguments = [self._argument(value) for value in node.args]
        if operation in SAME:
            # A constant is made contiguous, since a view that follows a copy may need the copy's order in memory.
            source = arguments[0]
            self.values[node.name] = source.contiguous() if isinstance(source, Tensor) else source
        elif operation == "getitem":
            # Several results are known as a list of values, or by one name, with a point and the number of each.
            source, number = arguments
            is_several = isinstance(source, (list, tuple))
            self.values[node.name] = source[number] if is_several else f"{source}.{number}"
        elif operation == "full_like":  # depends only on the shape
            result = node.meta["val"]
            self.values[node.name] = torch.full(tuple(result.shape), arguments[1], dtype=result.dtype)
        elif not _any_named(arguments):
            options = {key: self._argument(value) for key, value in node.kwargs.items()}
            self.values[node.name] = target(*arguments, **options)
        else:
            self._add(node, operation, arguments)

    def _add(self, node: torch.fx.Node, operation: str, arguments: list[Any]) -> None:
        """Note a node as a step, or as several if it splits a tensor. `InputError` for what a program cannot hold."""
        result = node.meta["val"]
        if operation == "embedding_bag_forward_only":
            table, index, offsets, _, mode, _, *weights = arguments
            if mode != 0:
                raise InputError("an embedding bag that is not a sum")
            arguments = [table, index, len(offsets), *weights[:1]]
            result = result[0]  # of its several results only the first, the sums, may be used
            self.values[node.name] = [node.name]
        elif operation in ("split_with_sizes", "split", "unbind"):
            self._add_split(node, operation, arguments)
            return
        else:
            self.values[node.name] = node.name
        if not isinstance(result, Tensor):
            raise InputError(f"{operation} gives several tensors")
        # These say only how a tensor is stored; any other option would change its values.
        foreign = set(node.kwargs) - {"dtype", "layout", "device", "memory_format", "pin_memory"}
        if foreign:
            raise InputError(f"{operation} with {min(foreign)}")
        self._add_step(node.name, operation, arguments, result)

    def _add_step(self, name: str, operation: str, arguments: list[Any], result: Tensor) -> None:
        """Add a step whose result has the shape and type of `result`; its constants are kept under names."""
        plain_arguments = [_plain(argument, self._keep) for argument in arguments]
        self.steps.append(Step(name, operation, plain_arguments, tuple(result.shape), _kind_of(result)))

    def _add_split(self, node: torch.fx.Node, operation: str, arguments: list[Any]) -> None:
        """Note a node that splits a tensor as steps, a slice or a selection for each part."""
        source, *rest = arguments
        before_axis = 0 if operation == "unbind" else 1  # a split's sizes come before its axis
        axis = int(rest[before_axis]) if len(rest) > before_axis else 0
        start = 0
        names = []
        for number, part in enumerate(node.meta["val"]):
            name = f"{node.name}.{number}"
            names.append(name)
            if operation == "unbind":
                self._add_step(name, "select", [source, axis, number], part)
            else:
                end = start + part.shape[axis]
                self._add_step(name, "slice", [source, axis, start, end], part)
                start = end
        self.values[node.name] = names

    def _argument(self, value: Any) -> Any:
        """An argument of a node, with the constants or names of the nodes that it refers to."""
        if isinstance(value, torch.fx.Node):
            return self.values[value.name]
        if isinstance(value, (list, tuple)):
            return [self._argument(each) for each in value]
        return value

    def _keep(self, tensor: Tensor) -> str:
        """Store a constant and return its name; the same numbers in memory keep the name that they have."""
        for name, value in self.values.items():
            if isinstance(value, Tensor) and _is_same(value, tensor):
                return name
        name = f"constant{len(self.values)}"
        self.values[name] = tensor
        return name

    def program(self, result: str, size: tuple[int, int]) -> Program:
        """The program, reduced to the steps and constants that the result needs."""
        last = self.values[result]
        if isinstance(last, Tensor):  # the answer depends on no input
            last = self._keep(last)
        needed = {last}
        # From the last step back, so that everything that needs a step is seen before the step itself.
        steps: list[Step] = []
        for step in reversed(self.steps):
            if step.name in needed:
                steps.append(step)
                needed |= step.names()
        constants = {}
        for name, value in self.values.items():
            if name in needed and isinstance(value, Tensor):
                constant = value.detach().cpu()
                constant = constant.float() if constant.is_floating_point() else constant.int()
                constants[name] = constant.numpy()
        return Program(tuple(reversed(steps)), constants, last, size)


def _is_same(one: Tensor, other: Tensor) -> bool:
    """Whether two tensors are the same numbers in memory, in the same order."""
    if one.shape != other.shape or one.dtype != other.dtype or one.stride() != other.stride():
        return False
    return one.data_ptr() == other.data_ptr()


def _kind_of(tensor: Tensor) -> str:
    """The kind of a tensor in a program: "float", "int" or "bool"."""
    if tensor.dtype.is_floating_point:
        return "float"
    return "bool" if tensor.dtype == torch.bool else "int"


def _any_named(arguments: Any) -> bool:
    """Whether some arguments contain an input or a step: strings are names, constants are tensors."""
    if isinstance(arguments, list):
        return any(_any_named(each) for each in arguments)
    return isinstance(arguments, str)


def _plain(argument: Any, keep: Callable[[Tensor], str]) -> Any:
    """An argument in the form of `bench.program.Step`; `keep` stores a constant tensor and returns its name."""
    if isinstance(argument, list):
        return [_plain(each, keep) for each in argument]
    if isinstance(argument, Tensor):
        return float(argument) if argument.ndim == 0 else {"of": keep(argument)}
    if isinstance(argument, str):
        return {"of": argument}
    if argument is None or isinstance(argument, (int, float, bool)):
        return argument
    return str(argument)
