"""NeuBTF's autoencoder: makes a neural texture from a guidance image of the same size, for periodic pictures.

A light U-Net of ConvNeXt blocks, as in Rodriguez-Pardo et al., "NeuBTF", 2023: 5×5 depth-wise kernels, layer norm and
GELU, residuals scaled by 1/√2 everywhere (Karras et al., "StyleGAN2", 2020), 1×1 convolutions on the skips, CBAM
attention at the bottleneck (Woo et al., 2018), nearest-neighbour upsampling, circular padding, orthogonal weights.

Everything is local except one pooling over the whole picture for CBAM, so tiles, with HALO texels of the periodic
picture around each, take two passes: see `neubtf.propagation`. Tiles begin and end at multiples of STRIDE. A texel
depends only on the guidance within RADIUS texels, in rows and in columns, and on what is pooled.

The encoder of one material's neural textures is its autoencoder, and the normalisation of guidance images. It is a part
of a NeuBTF file that is needed for new textures of the material, but not by renderers:

    encoder, picture = read_encoder(path)             # a file written with keep_encoder = true, and its own guidance
    texture = encoder(as_guidance(picture))           # (1, D, H, W)

Guidance images are sRGB in [0, 1], (B, 3, H, W). For tiles, see `neubtf.propagation`.
"""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

from bench.codecs import container
from bench.inputs.errors import InputError
from bench.metrics.display import LOG_SCALE
from bench.training.grids import OFFSET_CHANNELS
from bench.training.stored_network import load_vector, to_vector

STRIDE = 4  # texels a cell of the bottleneck; the grid of cells begins at texel (0, 0)
RADIUS = 36  # see `test_a_texel_depends_on_its_surroundings_only`
HALO = math.ceil(RADIUS / STRIDE) * STRIDE
LEAST = 3 * STRIDE  # texels that circular padding by three cells needs
WIDTHS = (24, 64, 96)  # channels at full, half and quarter resolution
EXPANSIONS = (2, 4, 4)  # of the pointwise layers; full resolution takes most of the time
REDUCTION = 8  # of the channels inside CBAM's perceptron
SCALE = 1 / math.sqrt(2)  # keeps the variance of a sum of two
FAINT = 0.05  # scale of the first texture: beside a strong texture the renderer hardly uses the directions
LEAST_SPREAD = 1 / 255  # least deviation, because that of a guidance image of one colour is 0


class Features(NamedTuple):
    """The encoder's output: the skips at full and half resolution, and the cells of the bottleneck (B, C, h, w)."""

    full: Tensor
    half: Tensor
    deep: Tensor


@dataclass(frozen=True)
class Pooled:
    """Sum and maximum over the bottleneck's cells, both (B, C), and the number of cells."""

    total: Tensor
    peak: Tensor
    cells: int

    @classmethod
    def of_cells(cls, deep: Tensor) -> "Pooled":
        """The statistics of some cells (B, C, h, w)."""
        return cls(deep.sum((2, 3)), deep.amax((2, 3)), deep.shape[2] * deep.shape[3])

    def joined(self, other: "Pooled") -> "Pooled":
        """The statistics of these cells and others."""
        return Pooled(self.total + other.total, torch.maximum(self.peak, other.peak), self.cells + other.cells)


class Autoencoder(nn.Module):
    """Guidance (B, 3, H, W) → neural texture (B, D, H, W), any H and W, both periodic. About 200,000 parameters.

    The first texture is `FAINT` times what orthogonal weights make.

    Shifting the guidance by multiples of STRIDE, around its borders, shifts the texture. A side that is not a multiple
    of STRIDE is padded circularly, so its far border still sees the near one, but the cells do not fit the period.
    """

    def __init__(self, channels: int, generator: torch.Generator | None = None, rectified: bool = False):
        """Make the layers, drawn from the generator, for `channels` of the neural texture. `rectified`: CBAM's
        perceptron has ReLU, not GELU."""
        super().__init__()
        # In each list of modules, 0 is of full, 1 of half and 2 of quarter resolution. The order of all modules is that
        # of the draws and of the weights in files.
        self.rectified = rectified
        full, half, deep = WIDTHS
        full_expansion, half_expansion, deep_expansion = EXPANSIONS
        self.stem = Circular(3, full, kernel=3)
        self.encoders = nn.ModuleList(
            [Block(full, full_expansion), Block(half, half_expansion), Block(deep, deep_expansion)]
        )
        self.downs = nn.ModuleList(
            [nn.Conv2d(full, half, kernel_size=2, stride=2), nn.Conv2d(half, deep, kernel_size=2, stride=2)]
        )
        self.attention = Attention(deep, rectified)
        self.ups = nn.ModuleList([nn.Conv2d(half, full, kernel_size=1), nn.Conv2d(deep, half, kernel_size=1)])
        self.skips = nn.ModuleList([nn.Conv2d(full, full, kernel_size=1), nn.Conv2d(half, half, kernel_size=1)])
        self.decoders = nn.ModuleList([Block(full, full_expansion), Block(half, half_expansion)])
        self.norm = ChannelNorm(full)
        self.head = nn.Conv2d(full, channels, 1)
        _orthogonal(self, generator)
        with torch.no_grad():
            self.head.weight.mul_(FAINT)

    def forward(self, guidance: Tensor) -> Tensor:
        """The texture (B, D, H, W) of guidance (B, 3, H, W), normalised by `Encoder.prepared`."""
        height, width = guidance.shape[2:]
        if height % STRIDE == 0 and width % STRIDE == 0:
            # Repeat a period that is too short for the kernels; this does not change its texture.
            down, across = math.ceil(LEAST / height), math.ceil(LEAST / width)
            features = self.encode(guidance.repeat(1, 1, down, across))
            return self.decode(features, Pooled.of_cells(features.deep))[..., :height, :width]
        # A side that does not fit the cells is handled as a tile: with a halo, which is not pooled, and cut off.
        features = self.encode(surrounded(guidance, (0, 0), (rounded_up(height), rounded_up(width))))
        halo_cells = HALO // STRIDE
        pooled = Pooled.of_cells(features.deep[..., halo_cells:-halo_cells, halo_cells:-halo_cells])
        return self.decode(features, pooled)[..., HALO : HALO + height, HALO : HALO + width]

    def encode(self, guidance: Tensor) -> Features:
        """The features of a picture, or of a tile with its halo, (B, 3, H, W), whose sides are multiples of STRIDE."""
        full = self.encoders[0](self.stem(guidance))
        half = self.encoders[1](self.downs[0](full))
        return Features(full, half, self.encoders[2](self.downs[1](half)))

    def decode(self, features: Features, pooled: Pooled) -> Tensor:
        """The texture (B, D, H, W) of features, given the statistics of the whole picture that they belong to."""
        deep = self.attention(features.deep, pooled)
        half = SCALE * (_doubled(self.ups[1](deep)) + self.skips[1](features.half))
        half = self.decoders[1](half)
        full = SCALE * (_doubled(self.ups[0](half)) + self.skips[0](features.full))
        full = self.decoders[0](full)
        return self.head(self.norm(full))


def surrounded(picture: Tensor, corner: tuple[int, int], size: tuple[int, int]) -> Tensor:
    """The window of `size` at `corner` (row, column) of a periodic picture (B, C, H, W), with HALO texels around it."""
    for dim, first, count in zip((2, 3), corner, size, strict=True):
        places = torch.arange(first - HALO, first + count + HALO, device=picture.device) % picture.shape[dim]
        picture = picture.index_select(dim, places)
    return picture


def rounded_up(side: int) -> int:
    """The least multiple of the stride that is no less than a side, in texels."""
    return math.ceil(side / STRIDE) * STRIDE


def _doubled(x: Tensor) -> Tensor:
    """A picture (B, C, h, w) at twice its size, each texel repeated."""
    return functional.interpolate(x, scale_factor=2, mode="nearest")


class Circular(nn.Module):
    """A convolution of an odd kernel over a periodic picture; `groups` as in PyTorch."""

    def __init__(self, inputs: int, outputs: int, kernel: int, groups: int = 1):
        super().__init__()
        self.conv = nn.Conv2d(inputs, outputs, kernel, groups=groups)
        self.pad = kernel // 2

    def forward(self, x: Tensor) -> Tensor:
        return self.conv(functional.pad(x, (self.pad,) * 4, mode="circular"))


class ChannelNorm(nn.LayerNorm):
    """Layer norm over the channels of each texel (B, C, H, W), so that a tile does not depend on its neighbours."""

    def forward(self, x: Tensor) -> Tensor:
        return super().forward(x.movedim(1, -1)).movedim(-1, 1)


class Block(nn.Module):
    """A ConvNeXt block (Liu et al. 2022): depth-wise 5×5 → layer norm → wider → GELU → back, and its input again."""

    def __init__(self, channels: int, expansion: int):
        """Make the layers; `expansion` is how many times as many channels the middle has."""
        super().__init__()
        self.spatial = Circular(channels, channels, kernel=5, groups=channels)
        self.norm = nn.LayerNorm(channels)
        self.wider = nn.Linear(channels, expansion * channels)
        self.back = nn.Linear(expansion * channels, channels)

    def hidden_matrices(self) -> list[Tensor]:
        """The pointwise layers' weights, most of the network's: see `bench.training.groups_of`."""
        return [self.wider.weight, self.back.weight]

    def forward(self, x: Tensor) -> Tensor:
        """Channels (B, C, H, W) to as many; the pointwise layers need them last."""
        hidden = self.norm(self.spatial(x).movedim(1, -1))  # (B, H, W, C)
        change = self.back(functional.gelu(self.wider(hidden))).movedim(-1, 1)  # (B, C, H, W)
        return SCALE * (x + change)


class Attention(nn.Module):
    """CBAM: a gain for each channel, from the whole picture's mean and maximum, then one for each cell."""

    def __init__(self, channels: int, rectified: bool):
        """Make the layers; `rectified`: ReLU in place of GELU."""
        super().__init__()
        few = channels // REDUCTION
        activation = nn.ReLU() if rectified else nn.GELU()
        self.perceptron = nn.Sequential(nn.Linear(channels, few), activation, nn.Linear(few, channels))
        self.spatial = Circular(2, 1, kernel=7)

    def forward(self, x: Tensor, pooled: Pooled) -> Tensor:
        """The cells (B, C, h, w) plus themselves times both gains, scaled; `pooled` is of the whole picture."""
        channel_gain = self.perceptron(pooled.total / pooled.cells) + self.perceptron(pooled.peak)  # (B, C)
        y = x * channel_gain.sigmoid()[..., None, None]
        mean_and_peak = torch.cat([y.mean(1, keepdim=True), y.amax(1, keepdim=True)], 1)  # (B, 2, h, w)
        cell_gain = self.spatial(mean_and_peak).sigmoid()  # (B, 1, h, w)
        return SCALE * (x + y * cell_gain)


def _orthogonal(network: nn.Module, generator: torch.Generator | None) -> None:
    """Draw orthogonal weights (Saxe et al. 2014) for all convolutions and linear layers, and set their biases to 0."""
    for module in network.modules():
        if isinstance(module, nn.Conv2d | nn.Linear):
            nn.init.orthogonal_(module.weight, generator=generator)
            assert module.bias is not None
            nn.init.zeros_(module.bias)


class Encoder(nn.Module):
    """Guidance images (B, 3, H, W), sRGB in [0, 1], brought to one scale → neural textures (B, D, H, W)."""

    def __init__(self, autoencoder: Autoencoder, centre: float, spread: float):
        """Keep the autoencoder, and the scale: `centre` of the guidance becomes 0, and `spread` more becomes 1."""
        super().__init__()
        self.autoencoder = autoencoder
        self.normal = nn.Buffer(torch.tensor([centre, spread]))

    @classmethod
    def for_guidance(cls, guidance: Tensor, autoencoder: Autoencoder) -> "Encoder":
        """An encoder whose autoencoder sees this guidance image (1, 3, H, W) with mean 0 and about deviation 1.

        It is divided by the mean of its channels' deviations. The bias of the autoencoder's head changes: each channel
        of this guidance's texture then has mean 0.
        """
        spread = guidance[0].flatten(1).std(1, correction=0).mean().item()
        encoder = cls(autoencoder, guidance.mean().item(), max(spread, LEAST_SPREAD))
        bias = autoencoder.head.bias
        assert bias is not None
        with torch.no_grad():  # a mean of the first texture would separate no texels, and outweigh the directions
            bias.sub_(encoder(guidance).mean((0, 2, 3)))
        return encoder

    def prepared(self, guidance: Tensor) -> Tensor:
        """The autoencoder's input for a guidance image, in the same shape; each texel is normalised by itself."""
        return (guidance - self.normal[0]) / self.normal[1]

    def forward(self, guidance: Tensor) -> Tensor:
        return self.autoencoder(self.prepared(guidance))


def store_encoder(encoder: Encoder, guidance: Tensor) -> dict[str, Tensor]:
    """The encoder part of a file: weights, rounded to half, normalisation, and the guidance, bytes (H, W, 3)."""
    tensors = {"weights": to_vector(encoder.autoencoder).half(), "normal": encoder.normal, "guidance": guidance}
    # Only files of the paper's recipe have this tensor. Those of ours, and older ones, have GELU.
    if encoder.autoencoder.rectified:
        tensors["rectified"] = torch.ones(1, dtype=torch.uint8)
    return tensors


def load_encoder(tensors: dict[str, Tensor], channels: int) -> Encoder:
    """The encoder that `store_encoder` wrote, for `channels` of the neural texture."""
    autoencoder = Autoencoder(channels, rectified="rectified" in tensors)
    encoder = Encoder(autoencoder, *tensors["normal"].tolist())
    load_vector(tensors["weights"], encoder.autoencoder)
    return encoder


def read_encoder(path: Path) -> tuple[Encoder, Tensor]:
    """The encoder and the guidance, bytes (H, W, 3), of a file.

    Raises `InputError` if it is of another codec or holds no encoder, and `ContainerError` if it is damaged.
    """
    header, parts = container.read_parts(path)
    if header.codec != "neubtf":
        raise InputError(f"{path}: its codec is {header.codec}: only neubtf makes textures from guidance images")
    if not parts.encoder:
        raise InputError(f"{path}: it holds no autoencoder: encode the material again, with --set keep_encoder=true")
    channels = texture_channels(header.settings["latents"], header.settings.get("offset", 0))
    return load_encoder(parts.encoder, channels), parts.encoder["guidance"]


def texture_channels(latents: int, offset: int) -> int:
    """The channels of a texture by the settings of these names: the latents, then those that an offset reads."""
    return latents + OFFSET_CHANNELS if offset else latents


def displayed(log_radiance: Tensor) -> Tensor:
    """sRGB in [0, 1] of log radiance, any shape: the display transform of the metrics.

    Computed where the tensor is: a step of a fit would wait for a GPU whose numbers NumPy needs.
    """
    linear = (log_radiance.expm1() / LOG_SCALE).clamp(0, 1).double()
    # The curve of sRGB: a line up to 0.0031308, and a power above.
    power = 1.055 * linear.pow(1 / 2.4) - 0.055
    return torch.where(linear <= 0.0031308, 12.92 * linear, power).to(log_radiance)


def eight_bits(guidance: Tensor) -> Tensor:
    """A guidance image (1, 3, H, W) in [0, 1] as bytes (H, W, 3), as a PNG and a codec file store it."""
    picture = guidance[0].movedim(0, -1)  # (H, W, 3)
    return (picture.clamp(0, 1) * 255).round().to(torch.uint8).cpu()


def as_guidance(picture: Tensor) -> Tensor:
    """Bytes (H, W, 3) as a guidance image (1, 3, H, W) in [0, 1]."""
    return picture.movedim(-1, 0)[None].float() / 255
