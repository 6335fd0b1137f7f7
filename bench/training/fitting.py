"""Fits learned codecs: the objective of a fit, and one training loop for every network.

Networks predict log radiance at texels and pairs. A `Fit` is what the caller gives to every codec: device, seed,
threads, file of the state, and where the curve and the progress go. The curve is measured on the *probe*, random
samples that are drawn once.

The loop has a curve of PSNR over steps and seconds, a state on disk to resume from, and a guard against divergence. The
same seed, machine, versions and threads give the same parameters, whether or not the fit was interrupted.
"""

import logging
import math
import time
from collections.abc import Callable, Hashable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from typing import Any, Literal

import torch
from safetensors.torch import load_file
from safetensors.torch import save as serialise
from torch import Tensor, nn
from torch.nn import functional

from bench.codec import REMARK, Fit
from bench.files import atomic
from bench.inputs.errors import InputError
from bench.machine.threads import processor_seconds
from bench.material import keep_buffers
from bench.metrics.psnr import psnr as decibels
from bench.training.display_loss import SHOWN_FROM, DisplayLoss, displayed
from bench.training.optimiser import Optimisers, ParameterGroup, rate
from bench.training.replay import Steps
from bench.training.samples import PROBE, Batch, Samples
from bench.training.stored_network import STEPS, choose_steps, note_steps, rounded_weights
from bench.training.stored_texture import Rounding, choose_bits

log = logging.getLogger(__name__)

POINTS = 25  # points of the curve
KEEP_EVERY = 100  # steps between two states that a diverging fit can go back to
SHOW_SECONDS = 1.0  # between two moves of the progress bar
SAVE_SECONDS = 5.0  # least seconds between two states on disk; a killed fit loses these, and up to KEEP_EVERY steps
RESCUES = 3  # times that a diverged fit goes back to a good state
START_STEPS = 250  # of each of two starts, of which the better goes on; at most a quarter of the fit's
OTHER_SEED = 0x57A7  # the seed of the second is that of the fit, XOR this
ROUNDED_FROM = 0.5  # share of the steps after which textures are rounded as in the file
ROUNDING_SAMPLES = 4_096  # samples that measure the error of rounding a channel
RATE = 0.2  # the price of bytes: 1 % more bits of all textures counts as this many % more loss
GAIN = 0.02  # dB: a fit that gains less within its patience ends
# A curve of at least so many points that gains less than `STILL` dB from its first one, and is below `GOOD` dB, is of a
# fit on a plateau.
LEAST_POINTS, STILL, GOOD = 5, 0.5, 30.0
FARTHEST = 1e12  # a parameter beyond it, or not finite, is of a diverged fit, whose answers may still be finite
AWAY = 10.0  # root mean square error of log radiance of a diverged fit: a factor of 22,000

LogLoss = Literal["l1", "l2", "both"]
Loss = Literal["l1", "l2", "both", "display"]


class DivergedError(RuntimeError):
    """A fit diverged, also after each remedy."""


def distance(ours: Tensor, target: Tensor, loss: LogLoss) -> Tensor:
    """The mean distance of two log radiances: absolute, squared, or the sum of both."""
    match loss:
        case "l1":
            return functional.l1_loss(ours, target)
        case "l2":
            return functional.mse_loss(ours, target)
        case "both":
            return functional.l1_loss(ours, target) + functional.mse_loss(ours, target)


def phase_by_halves(progress: float) -> Hashable:
    """The phase of a fit whose steps differ by what begins halfway: rounding as in the file, errors as displayed."""
    return progress >= ROUNDED_FROM, progress >= SHOWN_FROM


class Objective(nn.Module):
    """The objective of a fit: parameters, rates, the loss of a step. Its state must be in parameters and buffers."""

    def __init__(self, samples: Samples, settings: Any):
        """`samples` are the data, `settings` those of the codec."""
        super().__init__()
        self.samples = samples
        self.settings = settings
        self.steps_chosen = False  # whether the steps of weights are chosen
        self.display_loss: DisplayLoss | None = None
        if getattr(settings, "loss", "") == "display":  # some codecs have no such setting
            self.display_loss = DisplayLoss(len(samples.wo))

    def groups(self) -> list[ParameterGroup]:
        """Parameter groups, each with its highest learning rate, `lr`; Muon steps those with `hidden`, Adam others."""
        raise NotImplementedError

    def stored_networks(self) -> list[nn.Module]:
        """The networks that the file holds in the precision `settings.weights`."""
        return []

    def as_stored(self, progress: float) -> AbstractContextManager[None]:
        """Within it, weights are as the file holds them: in eight bits, if so set, from half of the fit on."""
        networks = self.networks_in_bits()
        if not networks or progress < ROUNDED_FROM:
            return nullcontext()
        return rounded_weights(networks)

    def networks_in_bits(self) -> list[nn.Module]:
        """The networks whose weights the file holds in at most eight bits."""
        networks = self.stored_networks()
        return networks if networks and self.settings.weights == "int8" else []

    def phase(self, progress: float) -> Hashable | None:
        """A key of the steps that are one program on the device, whatever their random numbers; None: not known.

        A GPU replays the steps of a phase as a graph (`bench.training.replay`): of `progress`, and of what the host
        keeps, they may depend on nothing else.
        """
        return None

    def prepare(self, fit: Fit, progress: float) -> None:
        """What the host does before a step, which no graph can do: from half of the fit on, choose how to round.

        Tensors that steps read may change here, but only in place: a graph reads them where they were.
        """
        if progress >= ROUNDED_FROM:
            self.choose_rounding(fit, progress)

    def rate(self, step: int, steps: int, group: int) -> float:
        """The learning rate of a group at a step, as a share of its highest: one curve over `steps` for all."""
        return rate(step, steps)

    def predict(self, batch: Batch, progress: float) -> Tensor:
        """Log radiance (n, 3) at the texels and pairs of a batch; `progress` goes from 0 to 1."""
        raise NotImplementedError

    def loss(self, generator: torch.Generator, progress: float) -> Tensor:
        """The loss of one step, a scalar: the distance of `predict` from the data at random samples, or a codec's own.

        Every random number comes from the generator, which lives on the CPU.
        """
        batch = self.samples.draw(self.settings.batch, generator)
        return self.distance(self.predict(batch, progress), batch.target, batch.pair, progress)

    def distance(self, ours: Tensor, target: Tensor, direction: Tensor, progress: float) -> Tensor:
        """The distance of log radiances (n, 3) at directions (n,) from their targets, by the setting `loss`."""
        if self.display_loss is None:
            return distance(ours, target, self.settings.loss)
        return self.display_loss(ours, target, direction, distance(ours, target, "both"), progress)

    def priced(self, loss: Tensor) -> Tensor:
        """A loss with the price of the bits of the textures, once these are rounded: log loss + `RATE` · log bits."""
        bits: list[Tensor] = []  # of each texture, a number
        for module in self.modules():
            if isinstance(module, Rounding) and module.spent_bits is not None:
                bits.append(module.spent_bits)
                module.spent_bits = None  # of this step alone
        if not bits or getattr(self.settings, "recipe", "") == "paper":  # nobody published such a price
            return loss
        return loss + RATE * loss.detach() * torch.stack(bits).sum().clamp_min(1).log()

    def faults(self) -> list[str]:
        """What is wrong with a fit whose loss is finite, in words; by default nothing is looked for."""
        return []

    def restored(self) -> None:
        """Set anew what the host keeps beside the tensors, after these were restored from a state."""
        for module in self.modules():
            if isinstance(module, Rounding):
                module.chosen = bool(module.bits.any())
        self.steps_chosen = any(bool(getattr(network, STEPS).any()) for network in self.networks_in_bits())

    @torch.no_grad()
    def choose_rounding(self, fit: Fit, progress: float) -> None:
        """Choose the steps of weights in eight bits, and the bits of each texture with a `Rounding`, unless chosen."""
        networks = self.networks_in_bits()
        if networks and not self.steps_chosen:
            batch = self.samples.draw(ROUNDING_SAMPLES, fit.generator())
            choose_steps(networks, lambda: self.predict(batch, progress), batch.target)
            self.steps_chosen = True
        roundings = [each for each in self.modules() if isinstance(each, Rounding) and each.undecided]
        if roundings:
            batch = self.samples.draw(ROUNDING_SAMPLES, fit.generator())
            with self.as_stored(progress):
                choose_bits(roundings, lambda: self.predict(batch, progress), batch.target)


def display_psnr(level: Tensor, target: Tensor) -> float:
    """Display-space PSNR in dB of log radiance against its target."""
    error = (displayed(level.double()) - displayed(target.double())).square().mean().item()
    # A constant material is fitted exactly; the curve then shows 120 dB, because a record cannot hold infinity.
    return float(decibels(max(error, 1e-12), peak=1.0))


def train(objective: Objective, fit: Fit, steps: int, patience: int = 0) -> float:
    """Fit the parameters of an objective in place, in at most `steps` steps; return the share of steps taken.

    With a `patience` above 0 a fit ends early, once its curve gained less than `GAIN` dB in that many steps; the last
    point of the curve then has `ended`. The state is saved in `fit.checkpoint`, if given, and a fit resumes from it;
    the caller removes it. If the loss is not finite, a parameter exceeds `FARTHEST` or the error `AWAY`, the last good
    state is restored and the learning rate halved; the fourth time, `DivergedError` is raised. Raises `InputError` if
    the file on disk is no state, or one with other tensors, and for fewer steps than one.
    """
    if steps < 1:
        raise InputError(f"steps = {steps}: a fit needs at least one")
    loop = _Loop(objective.to(fit.device), fit, steps)
    loop.resume()
    while loop.step < steps and not (patience and loop.flat(patience)):
        next_state = (loop.step // KEEP_EVERY + 1) * KEEP_EVERY
        loop.advance(min(steps, next_state))
    objective.choose_rounding(fit, loop.step / steps)  # for a fit that ended before its second half
    for fault in [*objective.faults(), *loop.faults()]:
        log.warning("the fit may be stuck: %s: try another seed or a lower learning rate", fault)
        fit.faults.append(fault)
    if loop.step < steps:
        log.info("ended at step %d of %d: the curve is flat", loop.step, steps)
        fit.history[-1]["ended"] = 1.0
        fit.show(loop.label, steps, steps)
    return loop.step / steps


def better_start(make: Callable[[Fit], Objective], fit: Fit, steps: int) -> Fit:
    """The fit with its own seed or another one, whichever gives the better objective after a few of its steps.

    It is for codecs with an offset. A fit of it may find depths that are a period of the surface off, and then stays.
    `make` gives the objective of a fit. A fit above 6,250 steps has no point of its curve so early: it keeps its seed.
    """
    if steps / POINTS > START_STEPS:
        return fit
    best, best_psnr = fit, -math.inf
    for seed in (fit.seed, fit.seed ^ OTHER_SEED):
        start = replace(fit, seed=seed)
        loop = _Loop(make(start).to(fit.device), replace(start, checkpoint=None, history=[]), steps)
        loop.advance(max(1, min(START_STEPS, steps // 4)))
        if loop.curve:  # without a point it diverged
            _, _, psnr = loop.curve[-1]
            if psnr > best_psnr:
                best, best_psnr = start, psnr
    return best


class _Loop:
    """The state of a fit under way: parameters, the optimisers' moments, generator, step, halvings, and the curve."""

    def __init__(self, objective: Objective, fit: Fit, steps: int):
        """Draw the probe, and take the first state as a good one to go back to."""
        keep_buffers()
        note_steps(objective.networks_in_bits())
        self.objective = objective
        self.fit = fit
        self.steps = steps
        self.generator = fit.generator()
        self.optimisers = Optimisers(objective.groups(), fit.device)
        self.highest = self.optimisers.highest  # learning rate of each group
        self.parameters = self.optimisers.parameters
        self.stepper = Steps(self._step, objective.phase, self.optimisers, self.generator, fit.device)
        self.step = 0
        self.halvings = 0  # of the learning rates, after divergence
        self.curve: list[tuple[int, float, float]] = []  # step, processor seconds, PSNR in dB
        samples = objective.samples
        # The probe has a generator of its own, so that the fit's numbers do not depend on it: its seed is any other.
        generator_of_probe = torch.Generator().manual_seed(fit.seed ^ 0x0B5E)
        # A network for all materials is judged by materials that it does not learn from, where there are some.
        if samples.trained_texels < samples.texels:
            self.probe = samples.draw_unseen(PROBE, generator_of_probe)
        else:
            self.probe = samples.draw(PROBE, generator_of_probe)
        self.saved = self.shown = time.perf_counter()  # when the state was last saved, and the progress last shown
        self.started = processor_seconds()
        self.good = self._state()

    def _tensors(self) -> dict[str, Tensor]:
        """Every tensor that a step changes, by name; not copies."""
        model = {f"model.{name}": value for name, value in self.objective.state_dict().items()}
        return model | self.optimisers.tensors()

    def _state(self) -> dict[str, Tensor]:
        """A copy of all that a fit resumes from: `_tensors`, and the loop's step, halvings, curve and generator."""
        progress = torch.tensor([self.step, self.halvings])
        curve = torch.tensor(self.curve, dtype=torch.float64).reshape(-1, 3)
        loop = {"loop.progress": progress, "loop.curve": curve, "loop.generator": self.generator.get_state()}
        tensors = {name: value.detach().clone() for name, value in self._tensors().items()}
        return tensors | loop

    def _restore(self, state: dict[str, Tensor]) -> None:
        """Go back to a state, in place. `InputError` if its tensors have other names or shapes."""
        ours = self._tensors()
        shapes = {name: value.shape for name, value in ours.items()}
        stored = {name: value.shape for name, value in state.items() if not name.startswith("loop.")}
        if shapes != stored:
            raise InputError(f"{self.fit.checkpoint}: it is the state of another fit: remove it")
        with torch.no_grad():
            for name, value in ours.items():
                value.copy_(state[name])
        self.objective.restored()
        self.generator.set_state(state["loop.generator"].cpu())
        self.step, self.halvings = state["loop.progress"].tolist()
        self.curve = [(int(step), seconds, psnr) for step, seconds, psnr in state["loop.curve"].tolist()]

    def resume(self) -> None:
        """Resume from the state on disk, if there is one, and show the progress."""
        path = self.fit.checkpoint
        if path is not None and path.exists():
            try:
                self.good = load_file(path)
            except Exception as error:  # safetensors raises its own types; the remedy is the same for all
                raise InputError(f"{path}: it is not the state of a fit: remove it ({error})") from error
            self._restore(self.good)
            log.info("going on from step %d of %d: %s", self.step, self.steps, path)
            for step, seconds, psnr in self.curve:
                self.fit.log(step, seconds=seconds, psnr=psnr)
            if self.curve:  # seconds of the interrupted process count, too
                _, seconds, _ = self.curve[-1]
                self.started -= seconds
        self._show()

    @property
    def label(self) -> str:
        """The fit in a progress bar, with its latest PSNR."""
        if not self.curve:
            return "fitting"
        _, _, psnr = self.curve[-1]
        return f"fitting{REMARK}{psnr:.1f} dB"

    def _show(self) -> None:
        """Move the progress bar, and remember when."""
        self.fit.show(self.label, self.step, self.steps)
        self.shown = time.perf_counter()

    def faults(self) -> list[str]:
        """A sentence if the curve stood still from its first point on, far from what a fit should reach; else none."""
        if len(self.curve) < LEAST_POINTS:
            return []
        _, _, first = self.curve[0]
        best = max(psnr for _, _, psnr in self.curve)
        if best >= first + STILL or best >= GOOD:
            return []
        return [f"its quality stands still at {best:.1f} dB from the first point of its curve on"]

    def flat(self, patience: int) -> bool:
        """Whether the best PSNR of the curve gained less than `GAIN` dB in the last `patience` steps."""
        earlier = [psnr for step, _, psnr in self.curve if step <= self.step - patience]
        if not earlier:  # the fit has not taken so many steps yet
            return False
        return max(psnr for _, _, psnr in self.curve) < max(earlier) + GAIN

    def _step(self, progress: float) -> Tensor:
        """Take one step at the rates that are set, and return its loss."""
        with self.objective.as_stored(progress):
            loss = self.objective.loss(self.generator, progress)
            self.objective.priced(loss).backward()
        self.optimisers.step()
        return loss.detach()

    def advance(self, end: int) -> None:
        """Step up to `end`, then save the state, or go back to the last good one."""
        total = torch.zeros((), device=self.fit.device)
        while self.step < end:
            progress = self.step / self.steps
            self.objective.prepare(self.fit, progress)
            rates = []
            for group, highest in enumerate(self.highest):
                share = self.objective.rate(self.step, self.steps, group)
                rates.append(highest * share / 2**self.halvings)
            # On the device: asking for the number here would wait for a GPU at each step.
            total += self.stepper.take(progress, rates)
            self.step += 1
            if self.step < end and time.perf_counter() - self.shown >= SHOW_SECONDS:
                self._show()
        # A parameter that is not finite stays so, so an occasional check misses nothing.
        bounded = all((parameter.abs() < FARTHEST).all() for parameter in self.parameters)
        if not (bounded and total.isfinite() and self._measure()):  # only a fit that may be good is measured
            self._rescue()
            return
        self._show()
        self.good = self._state()
        if self.fit.checkpoint and time.perf_counter() - self.saved >= SAVE_SECONDS:
            state = {name: value.cpu() for name, value in self.good.items()}
            atomic.write(self.fit.checkpoint, serialise(state))  # a killed process leaves the old state or the new one
            self.saved = time.perf_counter()

    def _rescue(self) -> None:
        """Go back to the last good state at half the learning rate; `DivergedError` after `RESCUES` times."""
        if self.halvings == RESCUES:
            raise DivergedError(
                f"the fit diverged {RESCUES + 1} times, the last near step {self.step}, at a learning rate of "
                f"{self.highest[0] / 2**self.halvings:.2g}: choose a lower one"
            )
        failed = self.step
        halvings = self.halvings + 1  # `_restore` also brings back the earlier number
        self._restore(self.good)
        self.halvings = halvings
        log.warning("the fit diverged near step %d: back to step %d with half the learning rate", failed, self.step)

    @torch.no_grad()
    def _measure(self) -> bool:
        """Add the PSNR to the curve, at about `POINTS` steps of the fit and at its end.

        Returns False if the fit diverged, else True: dead rectifiers or arbitrary sine outputs can diverge while every
        number is finite.
        """
        last = 0  # step of the last point
        if self.curve:
            last, _, _ = self.curve[-1]
        if self.step < self.steps and self.step - last < self.steps / POINTS:
            return True
        progress = self.step / self.steps
        with self.objective.as_stored(progress):
            level = self.objective.predict(self.probe, progress)
        if not (level - self.probe.target).square().mean() <= AWAY**2:  # also if it is NaN
            return False
        psnr = display_psnr(level, self.probe.target)
        seconds = processor_seconds() - self.started
        self.curve.append((self.step, seconds, psnr))
        self.fit.log(self.step, seconds=seconds, psnr=psnr)
        return True
