"""The fit of `relief`: latents, frames and network, by random samples of every level of detail."""

from collections.abc import Iterator
from typing import Any

import torch
from torch import Tensor, nn

from baselines.relief import latents as coding
from baselines.relief.geometry import Surface, slope, wrapped
from baselines.relief.height import smoothed, stepped
from baselines.relief.material import answer
from baselines.relief.network import Network
from baselines.relief.planes import REACH
from baselines.relief.pyramid import Pyramid
from bench.codec import Fit
from bench.material import sample_texture
from bench.training import Batch, Objective, Samples, distance, first_latents, groups_of

COARSE_SHARE = 8  # one sample in so many is of a coarser level
ROUNDED_FROM = 0.5  # of the steps: from there on the latents are those that the file will hold
BEARABLE = 0.005  # share of the fit's squared error that rounding may add, where the bits are left to the fit
PROBED = 4  # bits that a channel is rounded to alone, to see what its rounding adds
# Of the steps. Before, latents are still apart from where they belong, and would pull the height with them.
REFINED_FROM = 0.5
RENEWED = 10  # steps between two surfaces that are marched, while the height is refined
HIGHEST = 2 * REACH  # and −HIGHEST the lowest height, in widths of the picture: what a decoder reads
HEIGHT_RATE = 0.02  # texels, the highest learning rate of the height


class Rectified(Samples):
    """Samples whose slices show surface points where each view sees them, instead of places on the plane."""

    def __init__(self, samples: Samples, height: Tensor):
        self.__dict__.update(vars(samples))
        self.height = height.reshape(-1, 1).to(samples.device)

    def slices(self, pair: Tensor) -> Tensor:
        """The log radiance (texels, n, 3) of some pairs (n,), texels being those of the height."""
        texel = torch.arange(self.texels, device=self.device)
        slices = []
        for i, flat in zip(pair.tolist(), super().slices(pair).unbind(1), strict=True):
            along = slope(self.wo[i : i + 1], self.shape)
            place = wrapped(self.centres(texel) - self.height * along)
            slices.append(sample_texture(flat.reshape(*self.shape, 3), place))
        return torch.stack(slices, 1)


class ReliefObjective(Objective):
    """The latents of the finest level, the network and, where there is a height, its refinement."""

    def __init__(self, levels: list[Samples], height: Tensor | None, settings: Any, fit: Fit):
        super().__init__(levels[0])
        self.levels, self.settings, self.fit = levels, settings, fit
        generator = fit.generator()
        self.network = Network(settings, height is not None, generator)
        self.network.start_at(self.samples.mean(generator))
        self.pyramid = Pyramid(self.samples.shape)
        self.first_height = height
        # How far the height that was found moves, in texels, before it is smoothed.
        self.offset = nn.Parameter(torch.zeros_like(height)) if height is not None and settings.refine else None
        self.relief = None if height is None else Surface(stepped(height)[2])
        self.moved = False  # the surface that is marched is not the one that was found
        source = self.samples if height is None else Rectified(self.samples, height)
        self.latents = nn.Parameter(first_latents(source, settings.latents, settings.start, generator))
        # How the latents are rounded, once they are: lowest value and step of each channel; a step of 0 says not yet.
        self.register_buffer("low", torch.zeros(settings.latents))
        self.register_buffer("step", torch.zeros(settings.latents))
        self.register_buffer("bits", torch.zeros(settings.latents, dtype=torch.long))

    low: Tensor
    step: Tensor
    bits: Tensor

    def groups(self) -> list[dict[str, Any]]:
        settings = self.settings
        networks = groups_of([self.network], settings.rate, settings.optimiser, settings.hidden_rate)
        refined = [] if self.offset is None else [{"params": [self.offset], "lr": HEIGHT_RATE}]
        return [*networks, {"params": [self.latents], "lr": settings.latent_rate}, *refined]

    @property
    def height(self) -> Tensor | None:
        """The height (H, W) as it is refined so far, not rounded; none where there is no relief."""
        if self.first_height is None or self.offset is None:
            return self.first_height
        moved = self.first_height.to(self.offset) + smoothed(self.offset) / self.samples.shape[1]
        return moved.clamp(-HIGHEST, HIGHEST)

    @torch.no_grad()
    def renew(self) -> None:
        """March the height as it is now, in the steps that the file will hold."""
        height = self.height
        if height is not None and height.isfinite().all():  # else the fit diverges, which its loop mends
            self.relief = Surface(stepped(height)[2]).to(self.latents.device)

    def table(self, progress: float) -> Tensor:
        """The pyramid as it is looked up at some progress of the fit."""
        latents: Tensor = self.latents
        if progress >= ROUNDED_FROM:
            if not self.step.any():
                self.bits.copy_(self._bits())
                low, step = coding.steps_for(latents, self.bits)
                self.low.copy_(low)
                self.step.copy_(step)
            latents = coding.rounded(latents, self.low, self.step, self.bits)
        return self.pyramid.table(latents)

    @torch.no_grad()
    def _bits(self) -> Tensor:
        """How many bits each channel is rounded to. The error that one adds grows with the square of its rounding."""
        batch = self.samples.draw(self.settings.batch, self.fit.generator())
        queries = next(self._queries([(0, batch)]))

        def answers(latents: Tensor) -> Tensor:
            return answer(self.network, self.pyramid, self.relief, self.pyramid.table(latents), queries)

        changes = [self._rounding(bits) for bits in range(1, coding.MOST_BITS + 1)]
        exact, felt = answers(self.latents), list[Tensor]()
        for channel in range(self.settings.latents):
            moved = self.latents.clone()
            moved[:, channel] += changes[PROBED - 1][:, channel]
            felt.append((answers(moved) - exact).square().mean())
        spread = torch.stack([change.square().mean(0) for change in changes], 1)
        noise = spread * (torch.stack(felt) / spread[:, PROBED - 1].clamp_min(1e-30))[:, None]
        bits = self.settings.bits
        bearable = 0.0 if bits else BEARABLE * float((exact - batch.target).square().mean())
        return coding.shared_out(noise.cpu(), (bits or coding.MOST_BITS) * len(noise), bearable)

    def _rounding(self, bits: int) -> Tensor:
        """The change of the latents when each channel is rounded to some bits."""
        counts = torch.full_like(self.bits, bits)
        return coding.rounded(self.latents, *coding.steps_for(self.latents, counts), counts) - self.latents

    @torch.no_grad()
    def coded(self) -> tuple[Tensor, Tensor, Tensor]:
        """The codes (H · W, D) of the latents, and lowest value and step of each channel."""
        self.table(1.0)
        return coding.codes_of(self.latents, self.low, self.step, self.bits), self.low, self.step

    def predict(self, batch: Batch, progress: float) -> Tensor:
        if progress == 1 and self.offset is not None:
            self.renew()
        queries = next(self._queries([(0, batch)]))
        return answer(self.network, self.pyramid, self.relief, self.table(progress), queries)

    def loss(self, generator: torch.Generator, progress: float) -> Tensor:
        coarse = self.settings.batch // COARSE_SHARE if len(self.levels) > 1 else 0
        batches = [(0, self.samples.draw(self.settings.batch - coarse, generator))]
        if coarse:
            level = int(torch.randint(1, len(self.levels), (), generator=generator))
            batches.append((level, self.levels[level].draw(coarse, generator)))
        queries = [torch.cat(parts) for parts in zip(*self._queries(batches), strict=True)]
        uv, wo, wi, level_of = queries
        height = self.height if self.offset is not None and progress >= REFINED_FROM else None
        # By the number of the step: a fit that goes on after a stop marches the same surface. One that was set back to
        # before the height moved marches the height as it was found.
        if (height is not None or self.moved) and round(progress * self.settings.steps) % RENEWED == 0:
            self.renew()
            self.moved = height is not None
        ours = answer(self.network, self.pyramid, self.relief, self.table(progress), (uv, wo, wi, level_of), height)
        return distance(ours, torch.cat([batch.target for _, batch in batches]), self.settings.loss)

    def _queries(self, batches: list[tuple[int, Batch]]) -> Iterator[tuple[Tensor, Tensor, Tensor, Tensor]]:
        """uv, wo, wi and level of batches. Texels of a coarser level are boxes of the finest, which it may not fill."""
        height, width = self.samples.shape
        for level, batch in batches:
            samples, factor = self.levels[level], 2**level
            row = batch.texel.div(samples.shape[1], rounding_mode="floor")
            col = batch.texel - row * samples.shape[1]
            uv = torch.stack([(col + 0.5) * (factor / width), 1 - (row + 0.5) * (factor / height)], 1)
            yield uv, samples.wo[batch.pair], samples.wi[batch.pair], torch.full_like(uv[:, 0], level)
