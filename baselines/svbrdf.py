"""SVBRDF maps (base colour, normal, roughness, metalness), the usual model of a surface without a BTF codec.

The reflectance is that of the built-in materials (`bench.data.materials.brdf`: GGX and a Lambert base), so there are
neither parallax nor cast shadows, and no anisotropy. The maps are fitted by the loop of every learned codec, stored in
eight bits as pictures are, and averaged for larger footprints: colours in linear light, normals as vectors.

A texel's *maps* are `CHANNELS` numbers, linear colour from 0 to 1 among them; its *codes* are the `STORED_CHANNELS`
bytes of a file. The fit compares log radiance.
"""

from collections.abc import Hashable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from baselines.pyramids import Pyramid
from bench.btf import BTF
from bench.codec import Codec, Fit, Parts
from bench.data.materials import brdf
from bench.inputs.settings import BatchSize, Natural, Positive
from bench.material import DecoderCost, Material
from bench.metrics.display import decode_srgb, encode_srgb
from bench.training import Batch, Loss, Objective, ParameterGroup, Samples, compress, expand, fitted

CHANNELS = 8  # of a fetched texel: linear base colour, normal, roughness, metalness
STORED_CHANNELS = 7  # of a texel's codes: the normal's z follows from x and y
ALBEDO_PAIRS = 256  # pairs by whose radiance the base colour starts
PAIRS_AT_ONCE = 16  # pairs of these that are read together
ROUGHNESS, METALNESS = 0.7, 0.1  # initial values
WHITE = 0.8  # base colour from which the brightest tenth of all texels and colours start
LEAST_BRIGHTNESS = 1e-30  # keeps the scale of black data above 0, since its logarithm is fitted
SCALE_RATE = 0.1  # relative to the rate of the maps
REFLECTANCE_FLOPS = 150  # operations of `shaded`, about


class SVBRDF(Codec):
    """SVBRDF maps: base colour, normal, roughness, metalness as 8-bit pictures, without a BTF codec."""

    name, version = "svbrdf", 1
    physical = True

    @dataclass(frozen=True)
    class Settings:
        steps: Natural = 2_500  # steps of the fit
        batch: BatchSize = 4_096  # samples a step
        patience: Natural = 0  # steps without a gain of 0.02 dB on its probe that end the fit; 0: never
        rate: Positive = 3e-2  # highest learning rate
        loss: Loss = "both"  # error of log radiance: absolute, squared, or their sum; or later errors as displayed

    def encode(self, btf: BTF, fit: Fit) -> Parts:
        """Fit the maps, and store their codes (H, W, 7), eight bits each, and the factor on the radiance."""
        fitting = fitted(MapsObjective, self.settings, btf, fit)
        maps = fitting.maps(fitting.numbers.detach())
        codes = codes_of(maps).reshape(*btf.shape, STORED_CHANNELS)
        other = {"scale": fitting.log_scale.detach().exp().cpu(), "size": torch.tensor(btf.shape, dtype=torch.int32)}
        return Parts(texture={"maps": compress(codes, [8] * STORED_CHANNELS)}, other=other)

    def decode(self, parts: Parts, device: torch.device) -> Material:
        """The material of a file's parts, on a device."""
        height, width = parts.other["size"].tolist()
        codes = expand(parts.texture["maps"], (height, width, STORED_CHANNELS))
        return MapsMaterial(codes, float(parts.other["scale"])).to(device)


def shaded(maps: Tensor, wo: Tensor, wi: Tensor) -> Tensor:
    """The radiance f_r · cos θ_i (n, 3) of texels' maps (n, `CHANNELS`) at unit directions (n, 3).

    Normals need not have length 1.
    """
    length = maps[:, 3:6].square().sum(1, keepdim=True).clamp_min(1e-12).sqrt()
    normal = maps[:, 3:6] / length
    x, y, z = normal.unbind(1)
    tangent_length = (1 - x * x).clamp_min(1e-6).sqrt()  # of the x axis without its part along the normal

    def local(w: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """The parts (n,) of directions (n, 3) along the tangent, the bitangent and the normal.

        The tangent is the x axis without its part along the normal, at length 1; the bitangent is normal × tangent.
        """
        along_normal = (w * normal).sum(1)
        along_tangent = (w[:, 0] - x * along_normal) / tangent_length
        along_bitangent = (z * w[:, 1] - y * w[:, 2]) / tangent_length
        return along_tangent, along_bitangent, along_normal

    # `brdf` has the axis of colours first.
    values: dict[str, Any] = {"base": maps[:, :3].T, "roughness": maps[:, 6], "metalness": maps[:, 7]}
    points = brdf.points(local(wo), values | {"specular": 1.0, "anisotropy": 0.0})
    wo_wi = (wo * wi).sum(1)
    through, specular = brdf.reflect(points, local(wi), wo_wi)
    colours = points.diffuse * through + brdf.specular_colour(points, wo_wi) * specular  # (3, n)
    return colours.T


class MapsObjective(Objective):
    """Seven fitted numbers a texel, and the logarithm of a factor on the radiance.

    The numbers are the logits of the base colour, x and y of a normal whose z is 1, and the logits of roughness and
    metalness.
    """

    def __init__(self, samples: Samples, settings: Any, generator: torch.Generator):
        """Start at the albedo of each texel, scaled so that nine of ten of its numbers are at most `WHITE`, with that
        scale in `log_scale`; the normal straight up, usual roughness and metalness."""
        super().__init__(samples, settings)
        albedo = _albedo(samples, generator)  # (texels, 3)
        brightness = float(np.percentile(albedo.cpu().numpy(), 90))
        if brightness == 0:  # most texels are black
            brightness = float(albedo.max())
        brightness = max(brightness, LEAST_BRIGHTNESS)
        # Measured data may have any unit, so a factor on the reflected radiance is fitted with the maps.
        self.log_scale = nn.Parameter(torch.tensor([brightness / WHITE]).log())
        # (texels, 3). Clamped, because the logits of 0 and 1 are infinite.
        base = (albedo * (WHITE / brightness)).clamp(0.01, 0.99).logit()
        roughness, metalness = torch.tensor([ROUGHNESS, METALNESS]).logit()
        # The normal points straight up: x and y are 0. These four numbers are the same for each texel.
        other_numbers = torch.tensor([0, 0, roughness, metalness]).expand(len(base), 4)
        self.numbers = nn.Parameter(torch.cat([base.cpu(), other_numbers], 1))

    def groups(self) -> list[ParameterGroup]:
        rate = self.settings.rate
        return [{"params": [self.numbers], "lr": rate}, {"params": [self.log_scale], "lr": SCALE_RATE * rate}]

    def maps(self, numbers: Tensor) -> Tensor:
        """The maps (n, `CHANNELS`) of the fitted numbers (n, 7) of some texels; normals are not normalised."""
        base_colour = numbers[:, :3].sigmoid()
        normal_xy = numbers[:, 3:5]
        normal_z = torch.ones_like(numbers[:, :1])
        roughness_metalness = numbers[:, 5:].sigmoid()
        return torch.cat([base_colour, normal_xy, normal_z, roughness_metalness], 1)

    def phase(self, progress: float) -> Hashable:
        return ()  # all steps are alike

    def predict(self, batch: Batch, progress: float) -> Tensor:
        """Log radiance (n, 3) of the maps, not rounded, at the texels and pairs of a batch."""
        maps = self.maps(self.numbers.index_select(0, batch.texel))
        radiance = shaded(maps, self.samples.wo[batch.pair], self.samples.wi[batch.pair])
        return (self.samples.gain * self.log_scale.exp() * radiance).log1p()


def _albedo(samples: Samples, generator: torch.Generator) -> Tensor:
    """The factor (texels, 3) by which a rough white plane is nearest to the texels, over some pairs."""
    # At most `ALBEDO_PAIRS` random pairs, in order.
    pairs = torch.randperm(samples.pairs, generator=generator)[:ALBEDO_PAIRS].sort().values.to(samples.device)
    # White base colour, a flat normal, roughness 1, metalness 0: in the order of `CHANNELS`.
    white = torch.tensor([1.0, 1.0, 1.0, 0.0, 0.0, 1.0, 1.0, 0.0], device=samples.device).expand(len(pairs), CHANNELS)
    of_plane = shaded(white, samples.wo[pairs], samples.wi[pairs])[:, 0]  # (pairs,): one colour, as all are equal
    # The least squares of radiance = factor · of_plane: Σ of_plane · radiance / Σ of_plane².
    weights = of_plane / of_plane.square().sum()
    total = torch.zeros(samples.texels, 3, device=samples.device)
    for some_pairs, some_weights in zip(pairs.split(PAIRS_AT_ONCE), weights.split(PAIRS_AT_ONCE), strict=True):
        radiance = samples.slices(some_pairs).expm1()  # (texels, PAIRS_AT_ONCE, 3), times the gain
        total += (radiance * some_weights[:, None]).sum(1)
    return total / samples.gain


def codes_of(maps: Tensor) -> Tensor:
    """The codes (n, `STORED_CHANNELS`), whole numbers from 0 to 255, of maps (n, `CHANNELS`): base colour as sRGB.

    x and y of the normal, from −1 to 1, become shares from 0 to 1.
    """
    normal = nn.functional.normalize(maps[:, 3:6], dim=1)
    colour = torch.from_numpy(encode_srgb(maps[:, :3].cpu().numpy()))
    shares = torch.cat([colour, (normal[:, :2].cpu() + 1) / 2, maps[:, 6:].cpu()], 1)
    return (255 * shares).round().clamp(0, 255)


def maps_of(codes: Tensor) -> Tensor:
    """The maps (n, `CHANNELS`) float32 of codes (n, `STORED_CHANNELS`)."""
    shares = codes.float() / 255  # from 0 to 1
    colour = torch.from_numpy(decode_srgb(shares[:, :3].numpy())).float()
    xy = 2 * shares[:, 3:5] - 1
    # The normal has length 1. Rounded or altered x and y may leave nothing for z, which stays above 0.
    z = (1 - xy.square().sum(1, keepdim=True)).clamp_min(1e-4).sqrt()
    return torch.cat([colour, xy, z, shares[:, 5:]], 1)


class MapsMaterial(Material):
    """Maps and their averages over larger boxes, looked up trilinearly; the answer is `scale` × their radiance."""

    def __init__(self, codes: Tensor, scale: float):
        """Make the levels of detail, count the cost of an answer, and keep the parts.

        `codes` (H, W, `STORED_CHANNELS`) are bytes.
        """
        size = (codes.shape[0], codes.shape[1])
        self.codes = codes.to(torch.uint8)
        self.pyramid = Pyramid(size)
        self.scale = scale
        self.table = table = self.pyramid.table(maps_of(codes.flatten(0, 1)))  # the maps of all levels, a row a texel
        numbers_read = 8 * CHANNELS  # of four texels at two levels
        cost = DecoderCost(
            texture_channels=CHANNELS,
            texture_floats=table.numel(),
            flops_per_sample=REFLECTANCE_FLOPS + 2 * numbers_read,  # each is multiplied and added
            bytes_per_sample=numbers_read * table.element_size(),
        )
        super().__init__(size, cost)

    def maps(self) -> tuple[dict[str, np.ndarray], float]:
        """The pictures (H, W, 3) or (H, W) as bytes, by the names that renderers use, and the factor on the radiance.

        Base colour, roughness and metalness are the file's own codes. A normal from −1 to 1 is 0 to 255; its z is
        computed.
        """
        codes = self.codes.cpu()
        normal = maps_of(codes.flatten(0, 1))[:, 3:6].reshape(*self.size, 3)
        pictures = {
            "BaseColor": codes[..., :3],
            "NormalGL": (255 * (normal + 1) / 2).round().to(torch.uint8),
            "Roughness": codes[..., 5],
            "Metalness": codes[..., 6],
        }
        return {name: picture.contiguous().numpy() for name, picture in pictures.items()}, self.scale

    def evaluate(self, uv: Tensor, wo: Tensor, wi: Tensor, footprint: Tensor) -> Tensor:
        """Linear radiance (n, 3) of queries, each (n, …); see `Material`. Maps are averaged before they are shaded."""
        maps = self.pyramid.fetch(self.table, uv, self.pyramid.level(footprint)).to(wo.dtype)
        return self.scale * shaded(maps, wo, wi)
