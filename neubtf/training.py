"""The training steps of NeuBTF, our recipe, in three stages; the paper's is `neubtf.published`.

The guidance image of the encoder is a displayed slice; the renderer answers with log radiance.

1. *Direct*: a neural texture and the renderer, without the encoder. Its steps are eight times as fast as others.
2. *Taught*: the encoder learns that texture; each step compares all of its latents at once.
3. *Guided*: the encoder learns from the answers of the renderer, which stays fixed; without a first stage both learn.

A step of the last two shows the encoder a random slice, disturbed, in a random window, or the file's own guidance.
"""

import bisect
from collections.abc import Hashable
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal, NamedTuple

import torch
from torch import Tensor, nn

from bench.inputs.errors import InputError
from bench.inputs.settings import IF_SET, BatchSize, Natural, NotNegative, Positive, Range, Share
from bench.material import sample_texture
from bench.training import (
    Batch,
    Decoder,
    FromHost,
    Loss,
    NetworkSettings,
    Objective,
    ParameterGroup,
    Samples,
    first_latents,
    groups_of,
    on_host,
    phase_by_halves,
)
from bench.training.gridded import GriddedNetwork
from bench.training.grids import OFFSET_CHANNELS, Further
from bench.training.samples import centres
from neubtf.augmentation import Crop, Disturbance, draw_scale
from neubtf.autoencoder import STRIDE, Encoder, displayed, texture_channels
from neubtf.renderer import RendererSettings, on_grids, render

# How many groups of parameters are the encoder's; they come before those of the renderer and the texture.
ENCODER_GROUPS = {"adam": 1, "muon": 2}


@dataclass(frozen=True)
class StagedSettings(NetworkSettings, RendererSettings):
    """The settings of a NeuBTF file and of its fit."""

    steps: Natural = 2_500  # steps of the fit, in three stages
    direct: Share = 0.6  # share of the steps that fit texture and renderer without the autoencoder
    taught: Share = 0.2  # share of the steps that teach the autoencoder this texture; the rest is guided
    explore: Share = 0.25  # share of the steps whose input is a random slice, disturbed; the others see the guidance
    recolour: Share = 0.25  # share of those others that see the guidance in other colours, so that grey ones guide, too
    explore_weight: NotNegative = 0.2  # weight of the loss of such a step, relative to steps that see the guidance
    batch: BatchSize = 4_096  # number of single samples in a step
    slices: Annotated[int, Range(1, 1024)] = 16  # "paper": elements of a step, each with an input of its own
    targets: Annotated[int, Range(1, 1024)] = 1  # "paper": target slices of an element
    texel_pairs: Annotated[int, Range(0, 1024)] = 0  # "paper": pairs a texel of the pixels' loss; 0: the targets'
    crop: Annotated[int, Range(STRIDE, 4096)] = 64  # texels a side that a step uses of a larger picture
    around: Annotated[int, Range(0, 64)] = 16  # texels around a crop that only the autoencoder sees
    smallest: Annotated[float, Range(0, 1, above=True)] = 0.5  # least scale of an input, and so of later guidance
    keep_scale: Share = 0.5  # share of the inputs that keep their scale
    init: Literal["faint", "published"] = "faint"  # of the renderer: answers the mean, or as SIREN's, about the mean
    start: Literal["components", "encoder"] = "components"  # of the first texture; or what the autoencoder makes
    rate: Positive = 1e-2  # highest learning rate of the renderer and of the first stage's texture
    encoder_rate: Positive = 2e-3  # highest learning rate of the autoencoder
    encoder_hidden_rate: Positive = 2e-2  # highest learning rate of Muon for the autoencoder's pointwise layers
    loss: Loss = "both"  # error of log radiance: absolute, squared, or their sum; or, not "paper", later as displayed
    pixel: NotNegative = 1.0  # "paper": weight of the pixels' loss
    style: NotNegative = 0.3  # "paper": weight of the difference of Gram matrices
    frequency: NotNegative = 0.05  # "paper": weight of the focal frequency loss
    hue: NotNegative = 1.0  # largest turn of an input's hue, in turns
    saturation: NotNegative = 1.0  # largest change of an input's saturation, which is multiplied by 1 less to 1 more
    blur: NotNegative = 1.0  # largest blur of an input, σ in texels
    noise: NotNegative = 0.05  # largest noise of an input, σ
    offset: Further = field(default=0, metadata=IF_SET)  # "ours": hidden channels of what moves look-ups along the view
    keep_encoder: bool = False  # store the autoencoder, for new textures
    recipe: Literal["ours", "paper"] = "ours"  # "paper": as published, see docs/neubtf.md, but for `texel_pairs`

    @property
    def channels(self) -> int:
        """The channels of the texture, as the autoencoder makes it."""
        return texture_channels(self.latents, self.offset)

    def __post_init__(self) -> None:
        """Raise `InputError` if no steps are left for the last stage, if there is no texture to teach, or for what the
        paper's recipe does not have."""
        if self.direct + self.taught >= 1 or (self.taught and not self.direct):
            raise InputError("codec neubtf needs direct + taught below 1, and direct above 0 if taught is above 0")
        if self.offset and self.recipe == "paper":
            raise InputError("codec neubtf has no offset by recipe=paper: leave one of the two out")
        if self.loss == "display" and self.recipe == "paper":
            raise InputError("codec neubtf has no loss=display by recipe=paper: leave one of the two out")


class Example(NamedTuple):
    """The input of one step: a window, its texels as row · W + column, and its picture."""

    window: Crop  # moved to the origin
    texels: Tensor  # (n,) of the source in the whole picture
    picture: Tensor  # (1, 3, h, w)
    of_slice: bool  # whether the picture is a slice, disturbed, or else the guidance

    @property
    def inner(self) -> Tensor:
        """The texels (n,) of the picture that a loss compares: those without the window's surroundings."""
        return self.window.inner(self.picture.device)


class Guided(Objective):
    """An encoder and a renderer; `guidance` (1, 3, H, W) is that of the file's own texture."""

    def __init__(
        self, samples: Samples, settings: StagedSettings, encoder: Encoder, guidance: Tensor, generator: torch.Generator
    ):
        """Make the renderer, and keep the rest.

        Its weights are drawn from the generator, and it answers about the mean of the samples at first. With
        `init="faint"` its last layer begins with weights 0, so that it answers just the mean, whatever the input.
        """
        super().__init__(samples, settings)
        self.encoder = encoder
        renderer = Decoder(settings.architecture, generator)
        renderer.start_at(samples.mean(generator), everywhere=settings.init == "faint")
        self.renderer: Any = renderer
        if settings.offset:
            self.renderer = GriddedNetwork(renderer, settings, samples.shape, generator)
        self.disturbance = Disturbance(settings.hue, settings.saturation, settings.blur, settings.noise)
        self.guidance = nn.Buffer(guidance, persistent=False)

    def stored_networks(self) -> list[nn.Module]:
        return [self.renderer]

    def groups(self) -> list[ParameterGroup]:
        """Those of the encoder come first: `ENCODER_GROUPS` counts them, so that `Staged.rate` can stop the others."""
        settings = self.settings
        renderer = groups_of([self.renderer], settings.rate, settings.optimiser, settings.hidden_rate)
        encoder = groups_of([self.encoder], settings.encoder_rate, settings.optimiser, settings.encoder_hidden_rate)
        return [*encoder, *renderer]

    def predict(self, batch: Batch, progress: float) -> Tensor:
        """Log radiance (n, 3) at a batch's texels and pairs, by the texture that the encoder makes of the guidance."""
        latents = by_texel(self.encoder(self.guidance))
        return self.rendered(latents, batch.texel, batch.pair)

    def rendered(self, texture: Tensor, texel: Tensor, pair: Tensor, window: Crop | None = None) -> Tensor:
        """Log radiance (n, 3) of some texels (n,) of a texture (H · W, C), each at one pair (n,).

        The texture, and the numbers of its texels, are those of a window, or of the whole picture.
        """
        size = window.size if window else self.samples.shape
        grids = on_grids(texture.unflatten(0, size), self.settings.latents)
        return self.rendered_from(grids, texel, pair, window)

    def rendered_from(
        self, grids: dict[str, Tensor], texel: Tensor, pair: Tensor, window: Crop | None = None
    ) -> Tensor:
        """As `rendered`, of the grids (h, w, C) of a texture."""
        wo, wi = self.samples.wo[pair], self.samples.wi[pair]
        if "offset" in grids:
            latents = self._fetched(grids, texel, wo, window)
        else:
            latents = grids["latents"].flatten(0, 1).index_select(0, texel)
        return render(self.renderer, latents, wo, wi, self.settings.directions)

    def _fetched(self, grids: dict[str, Tensor], texel: Tensor, wo: Tensor, window: Crop | None) -> Tensor:
        """The latents (n, D) at texels (n,), looked up where the offset moves them for views wo (n, 3).

        A depth moves by as many texels in a window of any scale, because a photograph that guides later has an unknown
        scale.
        """
        picture = self.samples.shape
        size, repeats = (window.size, window.whole) if window else (picture, (True, True))
        uv = centres(texel, size)
        still = torch.zeros_like(uv)
        moves = self.renderer.offset.moved(still, sample_texture(grids["offset"], uv), wo)  # in sides of the picture
        moved_uv = []
        for axis, centre, move in zip((1, 0), uv.unbind(1), moves.unbind(1), strict=True):  # u along columns, v rows
            place = centre + move * (picture[axis] / size[axis])
            if not repeats[axis]:  # beyond the window its border continues
                margin = 0.5 / size[axis]
                place = place.clamp(margin, 1 - margin)
            moved_uv.append(place)
        return sample_texture(grids["latents"], torch.stack(moved_uv, 1))

    def averaged(self, texels: Tensor, weights: Tensor, pairs: Tensor) -> Tensor:
        """Log radiance (…, 3) of weighted means over texels (…, k), at pairs (…); the axes before k are broadcast."""
        pair_of_texel = pairs[..., None]
        shape = torch.broadcast_shapes(texels.shape, pair_of_texel.shape)
        levels = self.samples.at(texels.expand(shape).flatten(), pair_of_texel.expand(shape).flatten()).target
        radiance = levels.expm1().unflatten(0, shape)  # (…, k, 3)
        return (radiance * weights[..., None]).sum(-2).log1p()

    def window_of_slices(self, window: Crop, texels: Tensor, pairs: Tensor) -> Tensor:
        """Log radiance (B, 3, h, w) of a window of the slices of some pairs (B,); a rescale averages radiance.

        `texels` are those of the window's source.
        """
        texel_pairs = pairs.to(texels.device, non_blocking=True).repeat_interleave(len(texels))  # (B · texels,)
        levels = self.samples.at(texels.repeat(len(pairs)), texel_pairs).target  # (B · texels, 3)
        source = pictures(levels, window.source)
        if window.keeps_scale:
            return source
        return window.rescaled(source.expm1()).log1p()


class Staged(Guided):
    """Our recipe: the texture, the encoder that learns it, and both guided."""

    def __init__(
        self, samples: Samples, settings: StagedSettings, encoder: Encoder, guidance: Tensor, generator: torch.Generator
    ):
        """Start the texture of the first stage as the setting `start` says."""
        super().__init__(samples, settings, encoder, guidance, generator)
        if settings.start == "components":
            texture = first_latents(samples, settings.latents, "components", generator)
            if settings.offset:  # components that separate texels also separate heights
                texture = torch.cat([texture, texture[:, :OFFSET_CHANNELS]], 1)
        else:
            with torch.no_grad():  # the encoder's output for the guidance is near textures that it can learn
                texture = by_texel(encoder(guidance)).contiguous()
        self.texture = nn.Parameter(texture)
        # The first step of each stage.
        taught_from = round(settings.direct * settings.steps)
        guided_from = round((settings.direct + settings.taught) * settings.steps)
        self.starts = [0, taught_from, guided_from]

    def groups(self) -> list[ParameterGroup]:
        return [*super().groups(), {"params": [self.texture], "lr": self.settings.rate}]

    def stage(self, progress: float) -> int:
        """The stage at a progress from 0 to 1: 0 is direct, 1 taught, 2 guided. A stage without steps is skipped."""
        step = round(progress * self.settings.steps)
        return bisect.bisect(self.starts, step) - 1  # the last stage that has begun

    def phase(self, progress: float) -> Hashable:
        return phase_by_halves(progress), self.stage(progress)

    def rate(self, step: int, steps: int, group: int) -> float:
        """The share of a group's highest rate at a step: each stage has its own warm-up and fall.

        After a direct stage, the guided one moves the encoder alone: the others' rate is 0.
        """
        stage = self.stage(step / steps)
        start = self.starts[stage]
        end = self.starts[stage + 1] if stage < 2 else steps
        of_encoder = group < ENCODER_GROUPS[self.settings.optimiser]
        had_direct_steps = self.starts[1] > 0
        if stage == 2 and had_direct_steps and not of_encoder:
            return 0.0
        return super().rate(step - start, end - start, group)

    def predict(self, batch: Batch, progress: float) -> Tensor:
        """Log radiance (n, 3) at a batch's texels and pairs; in the first stage by the texture that is fitted."""
        is_direct = self.stage(progress) == 0
        latents = self.texture if is_direct else by_texel(self.encoder(self.guidance))
        return self.rendered(latents, batch.texel, batch.pair)

    def loss(self, generator: torch.Generator, progress: float) -> Tensor:
        """The loss of the stage to which a step belongs."""
        match self.stage(progress):
            case 0:
                return self._direct(generator, progress)
            case 1:
                return self._taught(generator)
            case _:
                return self._guided(generator, progress)

    def example(self, smallest: float, generator: torch.Generator) -> Example:
        """A random slice, disturbed, at a scale of `smallest` or more; or the guidance at its own, maybe recoloured."""
        samples, settings = self.samples, self.settings

        def drawn(progress: float) -> FromHost:
            """The source's texels and, of a slice, its pair; the plan is the window at the origin, and its kind."""
            exploring = float(torch.rand((), generator=generator)) < settings.explore
            scale = draw_scale(smallest, settings.keep_scale, generator) if exploring else 1.0
            window = Crop.drawn(samples.shape, settings.crop, scale, samples.btf.periodic, generator, settings.around)
            if exploring:
                pair = torch.randint(samples.pairs, (), generator=generator)
                return FromHost([window.texels(samples.shape), pair[None]], plan=(window.moved(0, 0), True, False))
            window = window.aligned()  # its cells are then those of the whole guidance
            recoloured = float(torch.rand((), generator=generator)) < settings.recolour
            return FromHost([window.texels(samples.shape)], plan=(window.moved(0, 0), False, recoloured))

        given = on_host(drawn, 0.0, samples.device)
        texels = given.tensors[0]
        window, of_slice, recoloured = given.plan
        if of_slice:
            pair = given.tensors[1]  # (1,)
            picture = displayed(self.window_of_slices(window, texels, pair))
            picture = self.disturbance.disturbed(picture, generator)
        else:
            picture = pictures(by_texel(self.guidance)[texels], window.size)
            if recoloured:
                picture = self.disturbance.recoloured(picture, generator)
        return Example(window, texels, picture, of_slice)

    def _direct(self, generator: torch.Generator, progress: float) -> Tensor:
        """The loss of texture and renderer at random samples, without the encoder."""
        batch = self.samples.draw(self.settings.batch, generator)
        rendered = self.rendered(self.texture, batch.texel, batch.pair)
        return self.distance(rendered, batch.target, batch.pair, progress)

    def _taught(self, generator: torch.Generator) -> Tensor:
        """The squared error of the encoder's latents from the fitted texture's, over the deviation of each channel."""
        example = self.example(smallest=1.0, generator=generator)
        texture = self.texture.detach()
        inner = example.inner
        # A window at its own scale has a texel for each of its source, so both can be compared.
        error = by_texel(self.encoder(example.picture))[inner] - texture[example.texels[inner]]
        deviation = texture.std(0, correction=0).clamp_min(1e-3)  # (D,), not 0 for a constant channel
        return (error / deviation).square().mean()

    def _guided(self, generator: torch.Generator, progress: float) -> Tensor:
        """The loss of single random samples of the window, each at a random pair.

        A slice would hold thousands of texels, but of one pair only.
        """
        example = self.example(self.settings.smallest, generator)
        size = (self.settings.batch,)
        latents = by_texel(self.encoder(example.picture))
        inner = example.inner
        drawn_places = torch.randint(len(inner), size, generator=generator)
        texel = inner[drawn_places.to(latents.device, non_blocking=True)]  # (n,), of the window
        pair = torch.randint(self.samples.pairs, size, generator=generator).to(latents.device, non_blocking=True)
        index, weight = example.window.taps(texel)  # (n, k), of the window's source
        truth = self.averaged(example.texels[index], weight, pair)
        loss = self.distance(self.rendered(latents, texel, pair, example.window), truth, pair, progress)
        return self.settings.explore_weight * loss if example.of_slice else loss


def by_texel(picture: Tensor) -> Tensor:
    """A picture (1, C, H, W) as (H · W, C), row by row."""
    return picture[0].flatten(1).T


def pictures(values: Tensor, size: tuple[int, int]) -> Tensor:
    """Values (B · H · W, C), row by row, as pictures (B, C, H, W)."""
    return values.unflatten(0, (-1, *size)).movedim(-1, 1)


def slice_of(samples: Samples, pair: int) -> Tensor:
    """Log radiance (1, 3, H, W) of one pair."""
    levels = samples.slices(torch.tensor([pair]))[:, 0]  # (H · W, 3)
    return pictures(levels, samples.shape)
