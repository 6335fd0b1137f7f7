"""The training of NeuBTF as its paper describes it: autoencoder and renderer end to end.

Each element of a batch has a random slice as its input and another as its target, in a window and at a scale of their
own; only the input is turned in hue, blurred and noisy. docs/neubtf.md has what the paper says and leaves open.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from bench.metrics.display import decode_srgb
from bench.training import Samples, distance
from neubtf.augmentation import Crop, draw_scale
from neubtf.encoder import Encoder, displayed
from neubtf.losses import Style, focal_frequency, shown
from neubtf.training import Guided, StagedSettings, pictures

DARKEST = 1e-4  # least mean of a slice, in a display's range; darker slices are shown as if they had it

PAPER = {"bits": 8, "directions": "xy", "loss": "l1", "keep_scale": 0.0, "init": "published", "optimiser": "adam"}
# Left open, and chosen:
PAPER |= {"steps": 30_000, "crop": 16, "around": 0, "smallest": 0.75, "blur": 0.5, "noise": 0.02}


class Element(NamedTuple):
    """One element of a batch: its window, its input (1, 3, h, w) in sRGB, and log radiance (1, 3, h, w) to meet."""

    window: Crop
    picture: Tensor
    target: Tensor
    view: int  # the pair of the input
    pair: int  # the pair of the target


class Published(Guided):
    """Autoencoder and renderer, compared on whole windows."""

    def __init__(
        self, samples: Samples, settings: StagedSettings, encoder: Encoder, guidance: Tensor, generator: torch.Generator
    ):
        super().__init__(samples, settings, encoder, guidance, generator)
        self.style = Style()
        self.brightness = float(decode_srgb(guidance.numpy()).mean())

    def loss(self, generator: torch.Generator, progress: float) -> Tensor:
        settings = self.settings
        pixel, style, frequency = self.losses([self.element(generator) for _ in range(settings.slices)])
        return settings.pixel * pixel + settings.style * style + settings.frequency * frequency

    def element(self, generator: torch.Generator) -> Element:
        """An element, drawn at random."""
        settings, samples = self.settings, self.samples
        scale = draw_scale(settings.smallest, settings.keep_scale, generator)
        window = Crop.drawn(samples.shape, settings.crop, scale, samples.btf.periodic, generator, settings.around)
        pairs = torch.randint(samples.pairs, (2,), generator=generator)
        texels = window.texels(samples.shape).to(samples.device, non_blocking=True)
        view, target = self.radiance(window, texels, pairs).split(1)
        picture = self.disturbance.disturbed(displayed(self.exposed(view)), generator)
        return Element(window, picture, target, *pairs.tolist())

    def exposed(self, level: Tensor) -> Tensor:
        """Log radiance (1, 3, h, w) of a slice at the brightness of the guidance, as a later photograph."""
        mean = shown(level).mean().clamp_min(DARKEST)
        return (level.expm1() * (self.brightness / mean)).log1p()

    def losses(self, elements: list[Element]) -> Tensor:
        """The losses (3,) of pixels, style and spectrum, not weighted, as means over elements."""
        alike: dict[Crop, list[Element]] = {}
        for element in elements:
            alike.setdefault(element.window.at_origin(), []).append(element)
        each = [len(group) * self._compared(window, group) for window, group in alike.items()]
        return torch.stack(each).sum(0) / len(elements)

    def _compared(self, window: Crop, elements: list[Element]) -> Tensor:
        inner = window.inner().to(self.samples.device, non_blocking=True)

        def by_texel(values: list[Tensor]) -> Tensor:
            """Pictures (1, C, h, w) as (elements · n, C), without the windows' surroundings."""
            return torch.cat(values).flatten(2)[..., inner].movedim(1, -1).flatten(0, 1)

        latents = by_texel([self.encoder(torch.cat([element.picture for element in elements]))])
        level = by_texel([element.target for element in elements])
        pair = torch.tensor([element.pair for element in elements]).repeat_interleave(len(inner))
        rendered = self.rendered(latents, torch.arange(len(latents)), pair)
        ours, truth = (shown(pictures(values, window.inner_size)) for values in (rendered, level))
        pixel = distance(rendered, level, self.settings.loss)
        return torch.stack([pixel, self.style(ours, truth, window.whole), focal_frequency(ours, truth)])
