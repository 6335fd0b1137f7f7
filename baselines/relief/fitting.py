"""The fit of `relief`: latents, frames and network, by random samples of every level of detail."""

from functools import partial
from typing import Any

import torch
from torch import Tensor, nn

from baselines.pyramids import Pyramid, drawn, queries_of
from baselines.relief.geometry import Surface, slope, smoothed, stepped, wrapped
from baselines.relief.material import Network, answer
from baselines.relief.planes import REACH
from bench.codec import Fit
from bench.material import sample_texture
from bench.training import Batch, Objective, Rounding, Samples, distance, first_latents, groups_of

COARSE_SHARE = 8  # one of this many samples is of a coarser level
# Share of the steps. Earlier, latents are still misplaced, and would pull the height with them.
REFINED_FROM = 0.5
RENEWED = 10  # steps between two surfaces that are marched, while the height is refined
HIGHEST = 2 * REACH  # and −HIGHEST the lowest height, in widths of the picture: what a decoder reads
HEIGHT_RATE = 0.02  # texels, the highest learning rate of the height


def rectified(samples: Samples, height: Tensor, pair: Tensor) -> Tensor:
    """`Samples.slices` of the surface points of a height (H, W), where each view sees them, not of the plane."""
    centres = samples.centres(torch.arange(samples.texels, device=samples.device))
    height, slices = height.reshape(-1, 1).to(samples.device), []
    for i, flat in zip(pair.tolist(), samples.slices(pair).unbind(1), strict=True):
        place = wrapped(centres - height * slope(samples.wo[i : i + 1], samples.shape))
        slices.append(sample_texture(flat.reshape(*samples.shape, 3), place))
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
        self.first_height: Tensor | None
        self.register_buffer("first_height", height, persistent=False)
        # The shift of the found height in texels, before smoothing.
        self.offset = nn.Parameter(torch.zeros_like(height)) if height is not None and settings.refine else None
        self.relief = None if height is None else Surface(stepped(height)[2])
        self.moved = False  # whether the marched surface differs from the found one
        slices = None if height is None else partial(rectified, self.samples, height)
        self.latents = nn.Parameter(first_latents(self.samples, settings.latents, settings.start, generator, slices))
        self.rounding = Rounding(settings.latents, settings.bits)

    def groups(self) -> list[dict[str, Any]]:
        settings = self.settings
        networks = groups_of([self.network], settings.rate, settings.optimiser, settings.hidden_rate)
        refined = [] if self.offset is None else [{"params": [self.offset], "lr": HEIGHT_RATE}]
        return [*networks, {"params": [self.latents], "lr": settings.latent_rate}, *refined]

    @property
    def height(self) -> Tensor | None:
        """The height (H, W) as refined so far, not rounded; none without a relief."""
        if self.first_height is None or self.offset is None:
            return self.first_height
        moved = self.first_height + smoothed(self.offset) / self.samples.shape[1]
        return moved.clamp(-HIGHEST, HIGHEST)

    @torch.no_grad()
    def renew(self) -> None:
        """March the height as it is now, in the steps that the file will hold."""
        height = self.height
        if height is not None and height.isfinite().all():  # otherwise the fit diverges, and its loop handles that
            self.relief = Surface(stepped(height)[2]).to(self.latents.device)

    def table(self) -> Tensor:
        """The pyramid as it is looked up: from half of the fit on that of the file."""
        return self.pyramid.table(self.rounding(self.latents))

    def predict(self, batch: Batch, progress: float) -> Tensor:
        if progress == 1 and self.offset is not None:
            self.renew()
        return answer(self.network, self.pyramid, self.relief, self.table(), queries_of(self.levels, 0, batch))

    def loss(self, generator: torch.Generator, progress: float) -> Tensor:
        queries, target = drawn(self.levels, self.settings.batch, COARSE_SHARE, generator)
        height = self.height if self.offset is not None and progress >= REFINED_FROM else None
        # By the number of the step, so that a resumed fit marches the same surface. A fit that was set back to before
        # the height moved marches the found height.
        if (height is not None or self.moved) and round(progress * self.settings.steps) % RENEWED == 0:
            self.renew()
            self.moved = height is not None
        ours = answer(self.network, self.pyramid, self.relief, self.table(), queries, height)
        return distance(ours, target, self.settings.loss)
