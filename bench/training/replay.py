"""The steps of a fit: taken one by one, or on a GPU replayed as CUDA graphs, which start all kernels of a step at once.

A step of a small network starts hundreds of kernels, and starting them takes longer than they run. A graph is recorded
once; then it is the same program in the same memory at each step. What differs from step to step goes through memory
that stays: random numbers, which the CPU draws as it does without a graph, and learning rates. Where the program itself
differs, another graph is recorded: in another phase of the fit (`Objective.phase`), and after another *decision*, a
drawn number that the host reads, such as a level of detail.

The first step of each kind is taken without a graph, and makes what later ones only read. A phase whose steps cannot be
recorded, because they wait for the GPU, is taken step by step; so is each step of an objective that names no phase.
"""

import logging
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor
from torch.overrides import TorchFunctionMode

from bench.machine.devices import records_graphs
from bench.training.optimiser import Optimisers

log = logging.getLogger(__name__)

READS = (Tensor.__bool__, Tensor.__float__, Tensor.__int__, Tensor.item)  # what reads a drawn number on the host

Decisions = tuple[int | float, ...]


@dataclass
class Draw:
    """One or many random numbers of a step: how they are drawn, those of the first step, and what reads them."""

    make: Callable[[], Tensor]
    first: Tensor
    buffer: Tensor | None = None  # memory of the device in which the step reads them
    decides: bool = False  # whether the host reads it


@dataclass
class Program:
    """A kind of step: its draws in their order and, once it is recorded, what starts it."""

    draws: list[Draw]
    loss: Tensor  # of the first step; once recorded, where each step leaves its own
    replay: Callable[[], Any] | None = None


class Drawing(TorchFunctionMode):
    """Within it, a step's draws from a generator are noted, or if they are known, are not drawn but read from memory.

    What is drawn may go to the device by `Tensor.to`, as it is, or be one number that the host reads.
    """

    def __init__(self, generator: torch.Generator, known: list[Draw] | None = None):
        super().__init__()
        self.generator = generator
        self.known = known is not None
        self.draws = known or []
        self.count = 0  # of draws so far
        self.changed = False  # whether a step changes numbers on the host, which a replay cannot do again

    def __torch_function__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        kwargs = kwargs or {}
        if kwargs.get("generator") is self.generator:
            if not self.known:
                self.draws.append(Draw(lambda: func(*args, **kwargs), func(*args, **kwargs)))
            self.count += 1
            return self.draws[self.count - 1].first
        draw = next((draw for draw in self.draws if args and args[0] is draw.first), None)
        if draw is not None and func is Tensor.to:
            if draw.buffer is None:
                draw.buffer = func(*args, **kwargs)
            return draw.buffer
        if draw is not None:
            draw.decides |= func in READS
            self.changed |= func not in READS and func.__name__ != "__get__"  # of an attribute, such as the shape
        return func(*args, **kwargs)


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
        self.refused: set[Hashable] = set()  # phases that cannot be recorded
        self.programs: dict[tuple[Hashable, Decisions], Program] = {}
        # How the next numbers are drawn in a phase after so many draws and these decisions.
        self.next_draw: dict[tuple[Hashable, int, Decisions], Draw] = {}

    def take(self, progress: float, rates: list[float]) -> Tensor:
        """One step, each group of parameters at its rate; `progress` goes from 0 to 1. Returns the loss, a scalar that
        the next step may overwrite."""
        self.optimisers.set_rates(rates)
        phase = self.phase(progress) if records_graphs(self.device) else None
        if phase is None or phase in self.refused:
            return self.step(progress)
        before = self.generator.get_state()
        decisions, numbers = self._drawn(phase)
        program = self.programs.get((phase, decisions))
        if program is None:
            self.generator.set_state(before)
            return self._first(phase, progress)
        for draw, values in zip(program.draws, numbers, strict=True):
            if draw.buffer is not None:
                draw.buffer.copy_(values, non_blocking=True)
        if program.replay is None:
            try:
                self._record(program, progress)
            except RuntimeError as error:
                log.info("steps are not replayed as a graph: %s", error)
                self.refused.add(phase)
                self.optimisers.clear()
                with Drawing(self.generator, program.draws):
                    return self.step(progress)
        assert program.replay is not None
        program.replay()
        return program.loss

    def _drawn(self, phase: Hashable) -> tuple[Decisions, list[Tensor]]:
        """The decisions and all random numbers of a step, as far as earlier steps tell how they are drawn."""
        numbers: list[Tensor] = []
        decisions: Decisions = ()
        while draw := self.next_draw.get((phase, len(numbers), decisions)):
            numbers.append(draw.make())
            if draw.decides:
                decisions += (numbers[-1].item(),)
        return decisions, numbers

    def _first(self, phase: Hashable, progress: float) -> Tensor:
        """A step of a kind that was not taken before, kernel by kernel, which notes its draws."""
        with Drawing(self.generator) as drawing:
            loss = self.step(progress)
        if drawing.changed or any((draw.buffer is None) != draw.decides for draw in drawing.draws):
            log.info("steps are not replayed as a graph: the host changes random numbers")
            self.refused.add(phase)
            return loss
        decisions: Decisions = ()
        for number, draw in enumerate(drawing.draws):
            self.next_draw[phase, number, decisions] = draw
            if draw.decides:
                decisions += (draw.first.item(),)
        self.programs[phase, decisions] = Program(drawing.draws, loss)
        return loss

    def _record(self, program: Program, progress: float) -> None:
        """Record a step with the numbers that are in its memory, without taking it."""
        module: Any = torch.get_device_module(self.device)
        graph = module.CUDAGraph()
        with Drawing(self.generator, program.draws), module.graph(graph):
            program.loss = self.step(progress)
        program.replay = graph.replay
