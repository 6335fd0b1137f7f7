"""The training of NeuBTF as its paper describes it: autoencoder and renderer end to end.

Each element of a batch has a random slice as its input and others as its targets, in a window and at a scale of their
own; only the input is turned in hue, blurred and noisy. docs/neubtf.md has what the paper says and leaves open.

Style and spectrum see linear radiance in the display's range [0, 1], because the paper compresses only the pixel term,
and because one highlight would otherwise outweigh every Gram matrix and spectrum. Pictures (B, 3, H, W) are periodic.
"""

from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

from bench.metrics.display import LOG_SCALE, decode_srgb
from bench.training import Samples, distance
from neubtf.augmentation import Crop, draw_scale
from neubtf.autoencoder import Encoder, displayed
from neubtf.training import Guided, StagedSettings, pictures

DARKEST = 1e-4  # least mean of a slice, in a display's range; darker slices are shown as if they had it

PAPER = {"bits": 8, "directions": "xy", "loss": "l1", "keep_scale": 0.0, "init": "published", "optimiser": "adam"}
# Left open, and chosen:
PAPER |= {"steps": 30_000, "crop": 16, "around": 0, "smallest": 0.75, "blur": 0.5, "noise": 0.02}
FILTERS = 24  # filters of each scale
KERNEL = 5  # texels a side at each scale
SCALES = 3  # full, half and quarter resolution
BANK_SEED = 0x57  # the bank is the same for every fit: it is part of the loss, not of the network


def shown(log_radiance: Tensor) -> Tensor:
    """Linear radiance × exposure in [0, 1] of log1p(8 · exposure · radiance), any shape."""
    return (log_radiance.expm1() / LOG_SCALE).clamp(0, 1)


class Style(nn.Module):
    """The distance of two pictures' textures: the squared difference of Gram matrices (Gatys et al. 2016), averaged.

    The features are those of Ustyuzhaninov et al., "What does it take to generate natural textures?", 2017: one layer
    of fixed random filters at several scales, rectified, so that no trained weights are needed.
    """

    def __init__(self) -> None:
        super().__init__()
        generator = torch.Generator().manual_seed(BANK_SEED)
        bank = torch.empty(SCALES, FILTERS, 3 * KERNEL * KERNEL)
        for scale in bank:
            nn.init.orthogonal_(scale, generator=generator)
        self.bank = nn.Buffer(bank.reshape(SCALES, FILTERS, 3, KERNEL, KERNEL), persistent=False)

    def forward(self, ours: Tensor, theirs: Tensor, periodic: tuple[bool, bool] = (True, True)) -> Tensor:
        """The distance of pictures that repeat, or not, in rows and in columns, at scales that fit the filters."""
        distances = list[Tensor]()
        for scale, filters in enumerate(self.bank):
            if scale:
                ours, theirs = (functional.avg_pool2d(x, 2, ceil_mode=True) for x in (ours, theirs))
            sides = zip(ours.shape[2:], periodic, strict=True)
            if all(wraps or side >= KERNEL for side, wraps in sides):
                distances.append(functional.mse_loss(_gram(ours, filters, periodic), _gram(theirs, filters, periodic)))
        return torch.stack(distances).mean() if distances else torch.zeros((), device=ours.device)


def _gram(pictures: Tensor, filters: Tensor, periodic: tuple[bool, bool]) -> Tensor:
    """(B, F, F): the mean over texels of products of rectified responses; of inner texels if it does not repeat."""
    half = KERNEL // 2
    for dim, wraps in zip((2, 3), periodic, strict=True):
        size = pictures.shape[dim]
        if wraps:
            pictures = pictures.index_select(dim, torch.arange(-half, size + half, device=pictures.device) % size)
    responses = functional.conv2d(pictures, filters).relu().flatten(2)
    return responses @ responses.mT / responses.shape[2]


def focal_frequency(ours: Tensor, theirs: Tensor) -> Tensor:
    """Focal frequency loss (Jiang et al., "Focal frequency loss for image reconstruction and synthesis", 2021), α = 1.

    The mean of w · |F − F'|² over the orthonormal spectra F, F' of both pictures, with w = |F − F'| over its maximum in
    each channel of each picture, held constant.
    """
    difference = torch.fft.fft2(ours - theirs, norm="ortho")
    squared = difference.real.square() + difference.imag.square()
    with torch.no_grad():
        weight = squared.sqrt()
        weight = weight / weight.amax((2, 3), keepdim=True).clamp_min(torch.finfo(weight.dtype).tiny)
    return (weight * squared).mean()


class Element(NamedTuple):
    """One element of a batch: its window, its input, and the target slices that its texture is compared with."""

    window: Crop
    texels: Tensor  # of the window's source, as row · W + column
    picture: Tensor  # (1, 3, h, w) in sRGB, the input
    targets: Tensor  # (targets, 3, h, w), log radiance
    view: int  # the pair of the input
    pairs: Tensor  # (targets,), those of the target slices


class Published(Guided):
    """Autoencoder and renderer, compared on whole windows.

    An element's texture is rendered at `targets` pairs, whose slices give style and spectrum; the pixels' loss is at
    `texel_pairs` random pairs of each texel, or without any at those slices.
    """

    def __init__(
        self, samples: Samples, settings: StagedSettings, encoder: Encoder, guidance: Tensor, generator: torch.Generator
    ):
        super().__init__(samples, settings, encoder, guidance, generator)
        self.style = Style()
        self.brightness = float(decode_srgb(guidance.cpu().numpy()).mean())

    def loss(self, generator: torch.Generator, progress: float) -> Tensor:
        settings = self.settings
        elements = [self.element(generator) for _ in range(settings.slices)]
        pixel, style, frequency = self.losses(elements, generator)
        return settings.pixel * pixel + settings.style * style + settings.frequency * frequency

    def element(self, generator: torch.Generator) -> Element:
        """An element, drawn at random."""
        settings, samples = self.settings, self.samples
        scale = draw_scale(settings.smallest, settings.keep_scale, generator)
        window = Crop.drawn(samples.shape, settings.crop, scale, samples.btf.periodic, generator, settings.around)
        view, *targets = torch.randint(samples.pairs, (1 + settings.targets,), generator=generator).tolist()
        texels = window.texels(samples.shape).to(samples.device, non_blocking=True)
        levels = self.radiance(window, texels, torch.tensor([view, *targets]))
        picture = self.disturbance.disturbed(displayed(self.exposed(levels[:1])), generator)
        return Element(window, texels, picture, levels[1:], view, torch.tensor(targets))

    def exposed(self, level: Tensor) -> Tensor:
        """Log radiance (1, 3, h, w) of a slice at the brightness of the guidance, as a later photograph."""
        mean = shown(level).mean().clamp_min(DARKEST)
        return (level.expm1() * (self.brightness / mean)).log1p()

    def losses(self, elements: list[Element], generator: torch.Generator) -> Tensor:
        """The losses (3,) of pixels, style and spectrum, not weighted, as means over elements."""
        alike: dict[Crop, list[Element]] = {}
        for element in elements:
            alike.setdefault(element.window.at_origin(), []).append(element)
        each = [len(group) * self._compared(window, group, generator) for window, group in alike.items()]
        return torch.stack(each).sum(0) / len(elements)

    def _compared(self, window: Crop, elements: list[Element], generator: torch.Generator) -> Tensor:
        """The losses (3,) of elements with equal windows; their surroundings are left out."""
        settings, device = self.settings, self.samples.device
        inner = window.inner().to(device, non_blocking=True)
        textures = self.encoder(torch.cat([element.picture for element in elements]))
        latents = textures.flatten(2)[..., inner].movedim(1, -1)  # (elements, n, D)

        levels = torch.stack([element.targets for element in elements]).flatten(3)[..., inner]
        levels = levels.movedim(2, -1).flatten(0, 2)  # (elements · targets · n, 3)
        pairs = torch.stack([element.pairs for element in elements])
        repeated = latents[:, None].expand(-1, pairs.shape[1], -1, -1).flatten(0, 2)
        pairs = pairs.flatten().to(device, non_blocking=True)
        rendered = self.answered(repeated, pairs.repeat_interleave(len(inner)))
        ours, truth = (shown(pictures(values, window.inner_size)) for values in (rendered, levels))

        if settings.texel_pairs:
            repeated = latents.flatten(0, 1).repeat_interleave(settings.texel_pairs, 0)
            pair, levels = self._at_texels(elements, inner, generator)
            rendered = self.answered(repeated, pair)
        pixel = distance(rendered, levels, settings.loss)
        return torch.stack([pixel, self.style(ours, truth, window.whole), focal_frequency(ours, truth)])

    def _at_texels(self, elements: list[Element], inner: Tensor, generator: torch.Generator) -> tuple[Tensor, Tensor]:
        """Random pairs (elements · n · texel_pairs,) of the inner texels (n,) of elements, and log radiance there."""
        drawn, levels = [], []
        for element in elements:
            index, weight = element.window.taps(inner)
            index, weight = (x.repeat_interleave(self.settings.texel_pairs, 0) for x in (index, weight))
            pair = torch.randint(self.samples.pairs, (len(index),), generator=generator)
            pair = pair.to(self.samples.device, non_blocking=True)
            each = pair.repeat_interleave(index.shape[1])
            values = self.samples.at(element.texels[index].flatten(), each).target.expm1().unflatten(0, index.shape)
            drawn.append(pair)
            levels.append((values * weight[..., None]).sum(1).log1p())
        return torch.cat(drawn), torch.cat(levels)
