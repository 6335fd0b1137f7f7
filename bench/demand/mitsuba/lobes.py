"""Lobes to draw light directions from: a small model of the directions of reflection, fitted to a material's answers.

The texture is divided into cells. Each has a mixture of the cosine and one GGX lobe, whose visible normals are drawn
about a tilted normal with two roughnesses, along u and across (Heitz, "Sampling the GGX Distribution of Visible
Normals", JCGT 2018). The fit minimises the cross entropy to f_r · cos θ_i, so it works for any decoded material. The
lobes change no answer; they only reduce the noise of a renderer that draws from them.
"""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from bench.codec import Progress, silent
from bench.directions.hemisphere import uniform
from bench.inputs.errors import ContainerError
from bench.material import Material

NAME = "lobes"  # name of the tensor (cells, cells, 5) in the part `sampling`
CELLS, STEPS, RATE = 8, 150, 0.05  # of a fit: cells along each side of the texture, steps, learning rate
VIEWS, LIGHTS = 4, 64  # views, and lights of each view, for each cell in a step
CHECKED = 512  # lights of each view that decide whether a cell keeps its lobe
OFF = -20.0  # raw share of a lobe that is switched off
LOWEST_VIEW, LOWEST_LIGHT = 84.0, 89.9  # degrees from the normal: limit of fitted views, and of lights
LEAST_COSINE = 0.05  # share of the cosine in the mixture, so that every light can be drawn
LEAST_ROUGHNESS = 0.03
START = (0.0, -1.0, -1.0, 0.0, 0.0)  # share 0.475, roughness 0.29, no tilt


@dataclass(frozen=True)
class Lobe:
    """The lobe of each query: its share of the mixture, roughness along and across (n,), and its axes (n, 3)."""

    share: Tensor
    along: Tensor
    across: Tensor
    axes: tuple[Tensor, Tensor, Tensor]

    @classmethod
    def from_stored(cls, raw: Tensor) -> "Lobe":
        """Lobes from the five stored numbers (n, 5); all numbers are valid.

        They are, before a sigmoid, the share and the roughness along and across; before a tanh, the tilt along x and y.
        """
        share = (1 - LEAST_COSINE) * raw[:, 0].sigmoid()
        along, across = (LEAST_ROUGHNESS + (1 - LEAST_ROUGHNESS) * raw[:, 1:3].sigmoid()).unbind(1)
        x, y = raw[:, 3:].tanh().unbind(1)
        normal = _unit(torch.stack([x, y, torch.ones_like(x)], 1))
        # The x axis less its part along the normal.
        tangent = [1 - normal[:, 0] ** 2, -normal[:, 0] * normal[:, 1], -normal[:, 0] * normal[:, 2]]
        first = _unit(torch.stack(tangent, 1))
        return cls(share, along, across, (first, torch.linalg.cross(normal, first), normal))

    def _along_axes(self, directions: Tensor) -> Tensor:
        """Directions (n, 3) in the frame of the axes."""
        return torch.stack([(directions * axis).sum(1) for axis in self.axes], 1)

    def density(self, wo: Tensor, wi: Tensor) -> Tensor:
        """The density (n,) of drawing wi (n, 3) for wo (n, 3), both above the horizon, over solid angle.

        That of the lobe is GGX's D(half) · G₁(view) / (4 · height of the view), as visible normals are drawn.
        """
        view, light = self._along_axes(wo), self._along_axes(wi)
        half = _unit(view + light)
        stretched = (half[:, 0] / self.along) ** 2 + (half[:, 1] / self.across) ** 2 + half[:, 2] ** 2
        normals = 1 / (math.pi * self.along * self.across * stretched**2)
        height = view[:, 2].clamp_min(1e-4)
        met = (view * half).sum(1).clamp_min(1e-4)
        slope = ((self.along * view[:, 0]) ** 2 + (self.across * view[:, 1]) ** 2) / height**2
        unshadowed = 2 / (1 + (1 + slope).sqrt())
        lobe = normals * unshadowed / (4 * height) * (half[:, 2] > 0)
        share = torch.where(view[:, 2] > 1e-4, self.share, 0.0) * (met > 1e-4)
        return (1 - share) * wi[:, 2] / math.pi + share * lobe


def _unit(vectors: Tensor) -> Tensor:
    """Vectors (n, 3) scaled to length 1."""
    return vectors / torch.linalg.vector_norm(vectors, dim=1, keepdim=True)


def fitted(
    material: Material, cells: int = CELLS, steps: int = STEPS, seed: int = 0, show: Progress = silent
) -> Tensor:
    """The lobes (cells, cells, 5) float16 of a material, rows from the top; the same seed gives the same."""
    rng = np.random.default_rng(seed)
    raw = torch.tensor(START).repeat(cells * cells, 1).requires_grad_()
    optimiser = torch.optim.Adam([raw], RATE)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, steps)
    for step in range(steps):
        cell, wo, wi, values = drawn(material, cells, VIEWS, LIGHTS, rng)
        # A dark place counts as much as a bright one: answers are brought to one mean in every view.
        weights = values / values.mean(1, keepdim=True).clamp_min(1e-9)
        density = Lobe.from_stored(raw[cell]).density(wo, wi)
        # The cross entropy of the density to the answers.
        loss = -(weights.flatten() * density.clamp_min(1e-9).log()).mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        schedule.step()
        show("fitting lobes", step + 1, steps)
    lobes = raw.detach()
    of_cosine, of_lobes, _ = _variances(material, lobes, CHECKED, rng)
    # The sums of variances over the views of each cell: (cells²,).
    of_cosine = of_cosine.view(len(lobes), -1).sum(1)
    of_lobes = of_lobes.view(len(lobes), -1).sum(1)
    # The fit minimises entropy, not variance: some cells are better with the cosine alone. Number 0 is the share.
    lobes[of_lobes > of_cosine, 0] = OFF
    return lobes.reshape(cells, cells, -1).half()


def drawn(
    material: Material, cells: int, views: int, lights: int, rng: np.random.Generator
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Queries (n,) over all cells, n = cells² · views · lights: for each its cell (n,), and wo and wi (n, 3), uniform
    over the hemisphere up to `LOWEST_VIEW` and `LOWEST_LIGHT`; and the answers, means of RGB (cells² · views, lights).
    """
    cell = torch.arange(cells * cells).repeat_interleave(views)
    place = torch.from_numpy(rng.random((len(cell), 2), np.float32))
    uv = torch.stack([(cell % cells + place[:, 0]) / cells, 1 - (cell // cells + place[:, 1]) / cells], 1)
    wo = torch.from_numpy(uniform(rng, len(cell), LOWEST_VIEW))
    wi = torch.from_numpy(uniform(rng, len(cell) * lights, LOWEST_LIGHT))
    # Each place and view once for each of its lights.
    cell = cell.repeat_interleave(lights, 0)
    uv = uv.repeat_interleave(lights, 0)
    wo = wo.repeat_interleave(lights, 0)
    return cell, wo, wi, material.query(uv, wo, wi).mean(1).view(-1, lights)


def checked(path: Path, sampling: dict[str, Tensor]) -> Tensor | None:
    """The lobes (cells, cells, 5) float32 of the part `sampling` of the file `path`; None if it has none.
    `ContainerError` if they are invalid."""
    if NAME not in sampling:
        return None
    lobes = sampling[NAME]
    if lobes.ndim != 3 or lobes.shape[0] != lobes.shape[1] or lobes.shape[2] != len(START) or not lobes.numel():
        fault = f"{path}: its lobes are {tuple(lobes.shape)}, not (cells, cells, {len(START)})"
        raise ContainerError(f"{fault}: fit them again with `export --lobes`")
    return lobes.float()


@dataclass(frozen=True)
class Noise:
    """Compares the noise of drawing from lobes with that of drawing by the cosine, under a uniform environment."""

    total: float  # ratio of the sums of variances over all views and places
    median: float  # median of the ratios of variances
    largest_albedo: float  # the largest radiance of any view and place under a uniform environment of radiance 1


def noise(material: Material, lobes: Tensor, seed: int = 1, lights: int = 1024) -> Noise:
    """The noise of lobes (cells, cells, 5), by quadrature over `lights` directions of each view, drawn by `seed`."""
    cosine, mixed, albedo = _variances(material, lobes.reshape(-1, lobes.shape[2]), lights, np.random.default_rng(seed))
    ratios = mixed / cosine.clamp_min(1e-12)
    return Noise(float(mixed.sum() / cosine.sum()), float(ratios.median()), float(albedo.max()))


@torch.no_grad()
def _variances(material: Material, raw: Tensor, lights: int, rng: np.random.Generator) -> tuple[Tensor, Tensor, Tensor]:
    """For some views of each cell: the variance of one sample drawn by the cosine, and by the lobes `raw` (cells², 5),
    and the mean, which is the albedo; each (cells² · views,)."""
    cell, wo, wi, values = drawn(material, math.isqrt(len(raw)), VIEWS, lights, rng)
    hemisphere = 2 * math.pi  # its solid angle
    albedo = values.mean(1) * hemisphere

    def variance(density: Tensor) -> Tensor:
        """The mean of (f / p)² over directions of density p, less the square of the mean, by uniform directions."""
        return (values.square() / density.view(-1, lights)).mean(1) * hemisphere - albedo**2

    by_cosine = variance(wi[:, 2] / math.pi)
    by_lobes = variance(Lobe.from_stored(raw[cell]).density(wo, wi))
    return by_cosine, by_lobes, albedo
