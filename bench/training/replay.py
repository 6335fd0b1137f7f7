"""The steps of a fit: taken one by one, or on a GPU replayed as CUDA graphs, which start all kernels of a step at once.

A step of a small network starts hundreds of kernels, and starting them takes longer than they run. A graph is recorded
once; then it is the same program in the same memory at each step. What differs from step to step goes through memory
that stays: random numbers, which the CPU draws as it does without a graph, what the host makes of them (`on_host`), and
learning rates. Where the program itself differs, another graph is recorded: in another phase of the fit
(`Objective.phase`), and after another *decision*: a drawn number that the host reads, such as a level of detail, or the
plan that it makes.

The first step of each kind is taken without a graph, and makes what later ones only read. A phase whose steps cannot be
recorded, because they wait for the GPU, is taken step by step; so is each step of an objective that names no phase.
"""

import logging
from collections.abc import Callable, Hashable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.overrides import TorchFunctionMode

from bench.machine.devices import records_graphs
from bench.training.optimiser import Optimisers

log = logging.getLogger(__name__)

READS = (Tensor.__bool__, Tensor.__float__, Tensor.__int__, Tensor.item)  # what reads a drawn number on the host

MOST_GRAPHS = 64  # of a fit; rarer kinds of steps are taken one by one: each graph keeps its own memory

Decisions = tuple[Hashable, ...]


class FromHost(NamedTuple):
    """What the host gives a step: tensors of the CPU, and a plan on which the step's program depends."""

    tensors: list[Tensor]
    plan: Any = None  # hashable; None: drawn numbers, one tensor of them


@dataclass
class Draw:
    """One thing that the host gives a step: how it is made at a progress, what the first step had, where it is read."""

    make: Callable[[float], FromHost]
    first: FromHost
    buffers: list[Tensor] = field(default_factory=list)  # memory of the device in which the step reads the tensors
    decides: bool = False  # whether the host reads it

    def decision(self, given: FromHost) -> Hashable:
        """What of `given`, made in place of `first`, decides the program of the step: the plan, or the drawn number."""
        return given.tensors[0].item() if given.plan is None else given.plan


@dataclass
class Program:
    """A kind of step: its draws in their order and, once it is recorded, what starts it."""

    draws: list[Draw]
    loss: Tensor  # of the first step; once recorded, where each step leaves its own
    replay: Callable[[], Any] | None = None


class Drawing(TorchFunctionMode):
    """Within it, what the host gives a step is noted, or if it is known, is not made but read from memory.

    What is drawn from the generator may go to the device by `Tensor.to`, as it is, or be one number that the host
    reads. What else the host makes of drawn numbers is made by `on_host`.
    """

    def __init__(self, generator: torch.Generator, known: list[Draw] | None = None):
        super().__init__()
        self.generator = generator
        self.notes = known is None  # whether draws are noted, as they are at the first step of a kind
        self.draws = known or []
        self.count = 0  # of draws so far
        self.changed = False  # whether a step changes numbers on the host, which a replay cannot do again
        self.is_making = False  # whether the host makes what it will give the step

    def __enter__(self) -> "Drawing":
        super().__enter__()  # type: ignore[no-untyped-call]
        _drawings.append(self)
        return self

    def __exit__(self, *error: Any) -> None:
        _drawings.pop()
        super().__exit__(*error)  # type: ignore[no-untyped-call]

    def next(self, make: Callable[[float], FromHost], progress: float) -> Draw:
        """The next draw: a known one, or a new one."""
        if self.notes:
            self.draws.append(Draw(make, make(progress)))
        self.count += 1
        return self.draws[self.count - 1]

    def planned(self, make: Callable[[float], FromHost], progress: float, device: torch.device) -> FromHost:
        """What `on_host` gives: the memory of the device in which the step reads the tensors, and the plan."""
        self.is_making = True
        draw = self.next(make, progress)
        self.is_making = False
        draw.decides = True
        if self.notes:
            draw.buffers = _on_device(draw.first.tensors, device)
        return FromHost(draw.buffers, draw.first.plan)

    def _draw_of(self, value: object) -> Draw | None:
        """The draw whose numbers `value` is, as they came from the generator; None for any other value."""
        for draw in self.draws:
            if draw.first.plan is None and draw.first.tensors[0] is value:
                return draw
        return None

    def __torch_function__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        """Call PyTorch's `func`, or give what is known: numbers of the first step, or their memory on the device.

        PyTorch calls this for each of its functions within the block. What reads or changes drawn numbers is noted, if
        they are its first argument; of others nothing reaches the device, so that `Steps` refuses the phase.
        """
        kwargs = kwargs or {}
        if self.is_making:  # what the host makes is noted as a whole
            return func(*args, **kwargs)
        if kwargs.get("generator") is self.generator:
            return self.next(lambda progress: FromHost([func(*args, **kwargs)]), 0.0).first.tensors[0]
        draw = self._draw_of(args[0]) if args else None
        if draw is None:
            return func(*args, **kwargs)
        if func is Tensor.to:
            if not draw.buffers:
                draw.buffers = [func(*args, **kwargs)]
            return draw.buffers[0]
        if func in READS:
            draw.decides = True
        elif func.__name__ != "__get__":  # more than asking for an attribute, such as the shape
            self.changed = True
        return func(*args, **kwargs)


_drawings = list[Drawing]()  # those that are entered, the innermost last


def on_host(make: Callable[[float], FromHost], progress: float, device: torch.device) -> FromHost:
    """What `make` gives a step at a progress, its tensors on the device.

    `make` may draw random numbers, and do with them on the host what it likes. Its plan, which is hashable and not
    None, must tell all on which the program of the step depends, the sizes of the tensors among it.
    """
    if _drawings:
        return _drawings[-1].planned(make, progress, device)
    given = make(progress)
    return FromHost(_on_device(given.tensors, device), given.plan)


def _on_device(tensors: list[Tensor], device: torch.device) -> list[Tensor]:
    """The tensors on a device; the host does not wait for the copies."""
    return [tensor.to(device, non_blocking=True) for tensor in tensors]


class Steps:
    """The steps of a fit."""

    def __init__(
        self,
        step: Callable[[float], Tensor],
        phase: Callable[[float], Hashable | None],
        optimisers: Optimisers,
        generator: torch.Generator,
        device: torch.device,
    ):
        """`step` takes one, kernel by kernel, at a progress from 0 to 1, and returns its loss; `phase` is that of an
        objective. The generator, which lives on the CPU, gives all random numbers of a step."""
        self.step = step
        self.phase = phase
        self.optimisers = optimisers
        self.generator = generator
        self.device = device
        self.refused_phases: set[Hashable] = set()  # those that cannot be recorded
        self.programs: dict[tuple[Hashable, Decisions], Program] = {}
        # How the next numbers are drawn in a phase after so many draws and these decisions.
        self.next_draw: dict[tuple[Hashable, int, Decisions], Draw] = {}

    def take(self, progress: float, rates: list[float]) -> Tensor:
        """One step, each group of parameters at its rate; `progress` goes from 0 to 1. Returns the loss, a scalar that
        the next step may overwrite."""
        self.optimisers.set_rates(rates)
        phase = self.phase(progress) if records_graphs(self.device) else None
        if phase is None or phase in self.refused_phases:
            return self.step(progress)
        before = self.generator.get_state()
        decisions, numbers = self._draw(phase, progress)
        program = self.programs.get((phase, decisions))
        if program is None:
            self.generator.set_state(before)
            return self._first_step(phase, progress)
        for draw, given in zip(program.draws, numbers, strict=True):
            for buffer, values in zip(draw.buffers, given.tensors, strict=False):  # what only the host reads has none
                buffer.copy_(values, non_blocking=True)
        if program.replay is None and not self._record(program, phase, progress):
            with Drawing(self.generator, program.draws):
                return self.step(progress)
        assert program.replay is not None
        program.replay()
        return program.loss

    def _draw(self, phase: Hashable, progress: float) -> tuple[Decisions, list[FromHost]]:
        """The decisions and all that the host gives a step, as far as earlier steps tell how it is made."""
        numbers: list[FromHost] = []
        decisions: Decisions = ()
        while draw := self.next_draw.get((phase, len(numbers), decisions)):
            numbers.append(draw.make(progress))
            if draw.decides:
                decisions += (draw.decision(numbers[-1]),)
        return decisions, numbers

    def _first_step(self, phase: Hashable, progress: float) -> Tensor:
        """A step of a kind that was not taken before, kernel by kernel, which notes its draws."""
        with Drawing(self.generator) as drawing:
            loss = self.step(progress)
        # A replay gives drawn numbers back to the device, or to the host that reads them: each must go to one of both.
        random_draws = [draw for draw in drawing.draws if draw.first.plan is None]
        goes_to_one = all(bool(draw.buffers) != draw.decides for draw in random_draws)
        if drawing.changed or not goes_to_one:
            log.info("steps are not replayed as a graph: the host changes random numbers")
            self.refused_phases.add(phase)
            return loss
        decisions: Decisions = ()
        for number, draw in enumerate(drawing.draws):
            self.next_draw[phase, number, decisions] = draw
            if draw.decides:
                decisions += (draw.decision(draw.first),)
        self.programs[phase, decisions] = Program(drawing.draws, loss)
        return loss

    def _record(self, program: Program, phase: Hashable, progress: float) -> bool:
        """Record a step with the numbers that are in its memory, without taking it; returns whether that could be done.

        Beyond `MOST_GRAPHS` nothing is recorded. A phase whose step cannot be recorded is refused from now on.
        """
        if sum(each.replay is not None for each in self.programs.values()) == MOST_GRAPHS:
            return False
        try:
            module: Any = torch.get_device_module(self.device)
            graph = module.CUDAGraph()
            with Drawing(self.generator, program.draws), module.graph(graph):
                program.loss = self.step(progress)
        except RuntimeError as error:
            log.info("steps are not replayed as a graph: %s", error)
            self.refused_phases.add(phase)
            self.optimisers.clear()
            return False
        program.replay = graph.replay
        return True
