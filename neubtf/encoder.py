"""The encoder of one material's neural textures: its autoencoder, and the normalisation of guidance images.

It is a part of a NeuBTF file that is needed for new textures of the material, but not by renderers:

    encoder, picture = read_encoder(path)             # a file written with keep_encoder = true, and its own guidance
    texture = encoder(as_guidance(picture))           # (1, D, H, W)

Guidance images are sRGB in [0, 1], (B, 3, H, W). For tiles, see `neubtf.propagation`.
"""

from pathlib import Path

import torch
from torch import Tensor, nn

from bench.codecs import container
from bench.inputs.errors import InputError
from bench.metrics.display import LOG_SCALE, encode_srgb
from bench.training.decoder import load_vector, to_vector
from neubtf.autoencoder import Autoencoder

LEAST_SPREAD = 1 / 255  # least deviation, because that of a guidance image of one colour is 0


class Encoder(nn.Module):
    """Guidance images (B, 3, H, W), sRGB in [0, 1], brought to one scale → neural textures (B, D, H, W)."""

    def __init__(self, autoencoder: Autoencoder, centre: float, spread: float):
        super().__init__()
        self.autoencoder = autoencoder
        self.normal: Tensor
        self.register_buffer("normal", torch.tensor([centre, spread]))

    @classmethod
    def for_guidance(cls, guidance: Tensor, autoencoder: Autoencoder) -> "Encoder":
        """An encoder to which a guidance image (1, 3, H, W) has mean 0 and deviation 1, the mean of its channels'.

        The bias of the autoencoder's head changes: each channel's mean becomes 0.
        """
        spread = guidance[0].flatten(1).std(1, correction=0).mean().item()
        encoder, bias = cls(autoencoder, guidance.mean().item(), max(spread, LEAST_SPREAD)), autoencoder.head.bias
        assert bias is not None
        with torch.no_grad():  # a mean of the first texture would separate no texels, and outweigh the directions
            bias.sub_(encoder(guidance).mean((0, 2, 3)))
        return encoder

    def prepared(self, guidance: Tensor) -> Tensor:
        """The autoencoder's input for a guidance image, in the same shape; each texel is normalised by itself."""
        return (guidance - self.normal[0]) / self.normal[1]

    def forward(self, guidance: Tensor) -> Tensor:
        texture: Tensor = self.autoencoder(self.prepared(guidance))
        return texture


def store_encoder(encoder: Encoder, guidance: Tensor) -> dict[str, Tensor]:
    """The encoder part of a file: weights, rounded to half, normalisation, and the guidance, bytes (H, W, 3)."""
    stored = {"weights": to_vector(encoder.autoencoder).half(), "normal": encoder.normal, "guidance": guidance}
    # Of the paper's recipe alone: files without it, of ours and older ones, have GELU.
    return stored | ({"rectified": torch.ones(1, dtype=torch.uint8)} if encoder.autoencoder.rectified else {})


def load_encoder(tensors: dict[str, Tensor], channels: int) -> Encoder:
    """The encoder that `store_encoder` wrote, for `channels` of the neural texture."""
    autoencoder = Autoencoder(channels, rectified="rectified" in tensors)
    encoder = Encoder(autoencoder, *tensors["normal"].tolist())
    load_vector(tensors["weights"], encoder.autoencoder)
    return encoder


def read_encoder(path: Path) -> tuple[Encoder, Tensor]:
    """The encoder and the guidance, bytes (H, W, 3), of a file. `InputError` if none, `ContainerError` if damaged."""
    header, parts = container.read_parts(path)
    if header.codec != "neubtf":
        raise InputError(f"{path}: its codec is {header.codec}: only neubtf makes textures from guidance images")
    if not parts.encoder:
        raise InputError(f"{path}: it holds no autoencoder: encode the material again, with --set keep_encoder=true")
    return load_encoder(parts.encoder, header.settings["latents"]), parts.encoder["guidance"]


def displayed(log_radiance: Tensor) -> Tensor:
    """sRGB in [0, 1] of log1p(8 · exposure · radiance), any shape: the display transform of the metrics."""
    linear = (log_radiance.expm1() / LOG_SCALE).clamp(0, 1)
    return torch.from_numpy(encode_srgb(linear.double().cpu().numpy())).to(linear)


def eight_bits(guidance: Tensor) -> Tensor:
    """A guidance image (1, 3, H, W) in [0, 1] as bytes (H, W, 3), as a PNG and a codec file store it."""
    return (guidance[0].movedim(0, -1).clamp(0, 1) * 255).round().to(torch.uint8).cpu()


def as_guidance(picture: Tensor) -> Tensor:
    """Bytes (H, W, 3) as a guidance image (1, 3, H, W) in [0, 1]."""
    return picture.movedim(-1, 0)[None].float() / 255
