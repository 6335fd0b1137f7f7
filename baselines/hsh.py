"""Hemispherical harmonics for each texel, fitted by least squares: the graphics default for one view, many lights.

`ptm` has polynomials of the light in their place. The basis of `hsh` is Gautron et al.'s: spherical harmonics of the
hemisphere stretched over the sphere. Reflectance transformation imaging (RTI) gives each texel and colour nine or
sixteen harmonics of the light. With several views, each texel has the products of the light's and the view's harmonics,
as in Gunawardane et al. ("Optimized image sampling for view and light interpolation", 2009).

*Band* l has 2l + 1 harmonics, so n bands have n². Of polynomials, band l are the l + 1 products of powers of x and y of
degree l, so n bands have n (n + 1) / 2. There are N pairs; K is the number of products of functions of light and view,
of which each texel has a coefficient for each colour. What is fitted is radiance or, with `domain=log`, log radiance;
with `cosine` it is of radiance over the cosine of the light.
"""

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

import numpy as np
import torch
from torch import Tensor

from baselines.components import probed_values, rounded_coefficients
from bench.btf import BTF
from bench.codec import Codec, Fit, Parts
from bench.inputs.settings import NotNegative, Range
from bench.material import DecoderCost, Material, sample_texture, to_radiance
from bench.training import MOST_CODES, Bits, Rounding, gain_of, load_texture, store_texture

BLOCK_BYTES = 16 << 20  # slices read together
LEAST_COSINE = 0.02  # of a light: keeps radiance / cosine finite at the horizon
RIDGE = 1e-9  # of every harmonic: decides between equal fits if there are more harmonics than pairs
MOST_BANDS = 6

Bands = Annotated[int, Range(1, MOST_BANDS)]


class HSH(Codec):
    """Hemispherical harmonics of the light, times those of the view, a texel: least squares, no network.

    @inproceedings{gautron2004novel,
      author = {Gautron, Pascal and Křivánek, Jaroslav and Pattanaik, Sumanta and Bouatouch, Kadi},
      title = {A Novel Hemispherical Basis for Accurate and Efficient Rendering},
      booktitle = {Eurographics Symposium on Rendering},
      pages = {321--330},
      year = {2004},
      doi = {10.2312/EGWR/EGSR04/321-330}
    }
    """

    name, version = "hsh", 5
    interpolates, sizes = True, ("lights", "views")
    recipes: ClassVar = {"paper": {"bits": 8, "domain": "rgb", "cosine": False, "smoothness": 0.0}}

    @staticmethod
    def light_functions(wi: Tensor, bands: int) -> Tensor:
        """The functions (n, …) of lights (n, 3), band after band."""
        return harmonics(wi, bands)

    @staticmethod
    def functions_in_band(band: int) -> int:
        """The number of functions of the light in a band."""
        return 2 * band + 1

    @dataclass(frozen=True)
    class Settings:
        recipe: Literal["ours", "paper"] = "ours"  # "paper": plain least squares of the radiance, as RTI has it
        lights: Bands = 3  # bands of the light: n² harmonics, of `ptm` n (n + 1) / 2 terms; fewer for few lights
        views: Bands = 2  # bands of the view; one, a constant, if there is one view
        domain: Literal["log", "rgb"] = "log"  # fitted quantity: log1p(8 · exposure · x) or x itself
        cosine: bool = True  # fit radiance over the cosine of the light, and multiply by it at decoding
        smoothness: NotNegative = 3e-5  # weight of (l (l + 1))² on functions of band l, for smoothness between samples
        bits: Bits = 0  # bits of a stored coefficient on average; 0: chosen by the data; 16, 32: floats

    def encode(self, btf: BTF, fit: Fit) -> Parts:
        """Solve for all texels at once, and store their coefficients (H, W, 3 · K).

        The three colours of a harmonic follow each other, so that one predicts the next.
        """
        gain = gain_of(btf, fit)
        settings = self.settings
        # n bands are n² harmonics, of which there should be no more than directions.
        light_bands = min(settings.lights, math.isqrt(len(btf.layout.lights)))
        view_bands = min(settings.views, math.isqrt(len(btf.layout.views)))
        bands = [light_bands, view_bands]
        cosine = _cosine_or_one(torch.from_numpy(btf.wi), settings.cosine)
        solution = self._solution(btf, bands, cosine, fit).to(fit.device)  # (K, N)
        texels = btf.shape[0] * btf.shape[1]
        coefficients = torch.zeros(len(solution), texels * 3, device=fit.device)
        pictures_at_once = max(1, BLOCK_BYTES // (texels * 12))  # of three float32 a texel
        pictures = iter(fit.progress(btf))
        for rows in torch.arange(len(btf)).split(pictures_at_once):
            block = np.stack(list(itertools.islice(pictures, len(rows))))  # (rows, H, W, 3), the next pictures
            values = torch.from_numpy(block).flatten(1).clamp_min(0).to(fit.device) / cosine[rows].to(fit.device)
            if settings.domain == "log":
                values = (gain * values).log1p()
            # The product solution · values of all pairs is the sum of those of each block of pairs.
            coefficients += solution[:, rows] @ values  # values are (rows, texels · 3)
        texture = coefficients.unflatten(1, (*btf.shape, 3)).permute(1, 2, 0, 3).flatten(2)  # (H, W, 3 · K)
        rounding = self._rounding(btf, texture, gain, bands, fit)
        other = {"gain": torch.tensor([gain]), "bands": torch.tensor(bands, dtype=torch.uint8)}
        return Parts(texture=store_texture("coefficients", texture, rounding), other=other)

    def _rounding(self, btf: BTF, texture: Tensor, gain: float, bands: list[int], fit: Fit) -> Rounding:
        """How coefficients (H, W, 3 · K) are rounded, chosen by the errors of radiance or its logarithm at some pairs.

        `bands` are the numbers of bands of light and view.
        """
        pairs, values = probed_values(btf, fit, None)  # radiance (3 · P, texels): `gain` enters after the division
        wo, wi = torch.from_numpy(btf.wo)[pairs], torch.from_numpy(btf.wi)[pairs]
        cosine = _cosine_or_one(wi, self.settings.cosine).repeat_interleave(3, 0)
        values = values.clamp_min(0) / cosine.to(values)
        if self.settings.domain == "log":
            values = (gain * values).log1p()
        # Each colour has coefficients of its own: the rows of a colour are 0 at those of the others.
        terms = basis(wo, wi, bands, self.light_functions)  # (P, K)
        of_colours = torch.einsum("pk,cd->pckd", terms, torch.eye(3))  # (P, 3, K, 3)
        # An error of radiance is one of radiance / cosine times the cosine, so rows and values are multiplied by it.
        rows = (of_colours.flatten(2).flatten(0, 1) * cosine).to(values)  # (3 · P, 3 · K)
        no_mean = torch.zeros(len(rows), 1, device=values.device)
        # Harmonics that a surface hardly has take no bits; a file of more codes needs a bit of each, or is not opened.
        least = 0 if texture.numel() <= MOST_CODES else 1
        return rounded_coefficients(texture, self.settings.bits, no_mean, rows, values * cosine.to(values), least)

    def _solution(self, btf: BTF, bands: list[int], cosine: Tensor, fit: Fit) -> Tensor:
        """The matrix (K, N) from the values of the pairs to the coefficients: weighted, regularised least squares.

        `bands` are the numbers of bands of light and view, `cosine` (N, 1) is that of each pair's light, or 1.
        """
        wo, wi = torch.from_numpy(btf.wo).double(), torch.from_numpy(btf.wi).double()
        terms = basis(wo, wi, bands, self.light_functions)  # (N, K)
        # An error of radiance is one of radiance / cosine times the cosine.
        weight = cosine.double().square()  # (N, 1)
        if fit.density is not None:  # in a fit to a scene, its demand for each pair
            weight = weight * fit.density.weights.double()[:, None]
        light_roughness = torch.tensor(_roughness(bands[0], self.functions_in_band))
        view_roughness = torch.tensor(_roughness(bands[1], HSH.functions_in_band))
        # In the order of `basis`: of each function of the light all of the view.
        roughness = (light_roughness[:, None] + view_roughness).flatten().double()  # (K,)
        # The normal equations: (terms' weighted products + penalty) · solution = (weighted terms)'.
        penalty = len(btf) * torch.diag(self.settings.smoothness * roughness.square() + RIDGE)
        normal = terms.T @ (weight * terms) + penalty
        return torch.linalg.solve(normal, (weight * terms).T).float()

    def decode(self, parts: Parts, device: torch.device) -> Material:
        """The material of a file's parts, on a device. `ValueError` if coefficients and bands do not fit, or there are
        too many bands."""
        texture = load_texture("coefficients", parts.texture)
        bands = parts.other["bands"].tolist()
        light_count = sum(self.functions_in_band(band) for band in range(bands[0]))
        if texture.shape[2] != 3 * light_count * bands[1] ** 2 or max(bands) > MOST_BANDS:
            raise ValueError(f"{texture.shape[2]} coefficients a texel for {bands} bands")
        gain = float(parts.other["gain"]) if self.settings.domain == "log" else None
        return HSHMaterial(texture, bands, gain, self.settings.cosine, self.light_functions).to(device)


class PTM(HSH):
    """Polynomial texture maps: a polynomial of x and y of the light a texel and colour, by least squares.

    The oldest format of reflectance transformation imaging, there with six terms, `lights=3`. Those of several views
    are multiplied by harmonics of the view.

    @inproceedings{malzbender2001polynomial,
      author = {Malzbender, Tom and Gelb, Dan and Wolters, Hans},
      title = {Polynomial Texture Maps},
      booktitle = {Proceedings of SIGGRAPH 2001},
      pages = {519--528},
      year = {2001},
      doi = {10.1145/383259.383320}
    }
    """

    name, version = "ptm", 1
    physical = True  # a polynomial of few terms over the cosine is no constant near the horizon

    @staticmethod
    def light_functions(wi: Tensor, bands: int) -> Tensor:
        return polynomials(wi, bands)

    @staticmethod
    def functions_in_band(band: int) -> int:
        return band + 1


def _roughness(bands: int, functions_in_band: Callable[[int], int]) -> list[float]:
    """How much each function of some bands varies: l (l + 1) for those of band l.

    Of harmonics it is minus the eigenvalue of the Laplacian.
    """
    roughness = []
    for band in range(bands):
        roughness += [band * (band + 1.0)] * functions_in_band(band)
    return roughness


def _cosine_or_one(wi: Tensor, cosine: bool) -> Tensor:
    """What radiance is divided by, (n, 1): with the setting `cosine` the cosines of lights (n, 3), else ones."""
    return wi[:, 2:].clamp_min(LEAST_COSINE) if cosine else torch.ones_like(wi[:, 2:])


def basis(wo: Tensor, wi: Tensor, bands: list[int], light_functions: Callable[[Tensor, int], Tensor]) -> Tensor:
    """The products (n, K) of the functions of lights and the harmonics of views, both (n, 3).

    `bands` are the numbers of bands of the light and of the view, in this order. Of each function of the light there
    are the products with all harmonics of the view.
    """
    light, view = light_functions(wi, bands[0]), harmonics(wo, bands[1])
    return (light[:, :, None] * view[:, None]).flatten(1)


def polynomials(directions: Tensor, bands: int) -> Tensor:
    """The products (n, bands (bands + 1) / 2) of powers of x and y of directions (n, 3), by degree: 1, x, y, x², …"""
    x, y = directions[:, 0], directions[:, 1]
    degree = [torch.ones_like(x)]
    terms = list(degree)
    for _ in range(1, bands):
        degree = [term * x for term in degree] + [degree[-1] * y]
        terms += degree
    return torch.stack(terms, 1)


def harmonics(directions: Tensor, bands: int) -> Tensor:
    """Hemispherical harmonics (n, bands²) of unit directions (n, 3), orthonormal over the hemisphere.

    H_l^m = √((2l + 1) (l − |m|)! / (2π (l + |m|)!)) P_l^|m|(2 cos θ − 1), times √2 cos mφ or √2 sin |m|φ.
    """
    x, y, z = directions.unbind(1)
    z = z.clamp_min(0)
    # With t = 2z − 1, P_l^m has the factor √(1 − t²)^m. With a = √(1 − t²) cos φ and b = √(1 − t²) sin φ this factor
    # times cos mφ is the real part of (a + ib)^m, and times sin mφ the imaginary one. As √(1 − t²) = 2 √(z (1 − z))
    # and √(x² + y²) = √(1 − z²), a and b are x and y times 2 √(z / (1 + z)).
    stretch = 2 * (z / (1 + z)).sqrt()
    a, b, t = stretch * x, stretch * y, 2 * z - 1
    real, imaginary = torch.ones_like(t), torch.zeros_like(t)  # of (a + ib)^m
    terms: dict[tuple[int, int], Tensor] = {}  # H_l^m by (l, m)
    for m in range(bands):
        # P_m^m without its factor is 1 · 3 · 5 · … · (2m − 1). Higher bands follow from the two before them.
        before, legendre = torch.zeros_like(t), torch.full_like(t, math.prod(range(1, 2 * m, 2)))
        for band in range(m, bands):
            if band > m:
                following = (t * (2 * band - 1) * legendre - (band + m - 1) * before) / (band - m)
                before, legendre = legendre, following
            norm = math.sqrt((2 * band + 1) * math.factorial(band - m) / (2 * math.pi * math.factorial(band + m)))
            both_signs = math.sqrt(2) if m else 1  # for cos mφ and sin mφ; m = 0 has no sine
            scaled = legendre * (norm * both_signs)
            terms[band, m] = scaled * real
            if m:
                terms[band, -m] = scaled * imaginary
        # (a + ib)^(m + 1) = (a + ib) · (a + ib)^m.
        real, imaginary = a * real - b * imaginary, a * imaginary + b * real
    ordered = []
    for band in range(bands):
        ordered += [terms[band, m] for m in range(-band, band + 1)]
    return torch.stack(ordered, 1)


class HSHMaterial(Material):
    """Coefficients (H, W, 3 · K) bilinear over texels, times the functions of the query's directions.

    `gain` is None if radiance was fitted, not its logarithm. Larger footprints are not filtered.
    """

    def __init__(
        self,
        texture: Tensor,
        bands: list[int],
        gain: float | None,
        cosine: bool,
        light_functions: Callable[[Tensor, int], Tensor],
    ):
        """Count the cost of an answer, and keep the parts.

        `bands` are the numbers of bands of the `light_functions` and of the harmonics of the view; with `cosine`
        coefficients are of radiance over the cosine of the light.
        """
        height, width, channels = texture.shape
        times_coefficients = 2 * channels  # multiply and add each coefficient
        products = channels // 3  # one for each function of the light with each of the view
        functions_made = 6 * sum(n * n for n in bands)  # about six operations each, polynomials counted as harmonics
        flops = times_coefficients + products + functions_made
        super().__init__((height, width), DecoderCost.of_texture(texture, flops=flops))
        self.texture = texture
        self.bands = bands
        self.gain = gain
        self.cosine = cosine
        self.light_functions = light_functions

    def evaluate(self, uv: Tensor, wo: Tensor, wi: Tensor, footprint: Tensor) -> Tensor:
        """Linear radiance (n, 3) of queries, each (n, …); see `Material`. The footprint is ignored: there is one level
        of detail."""
        coefficients = sample_texture(self.texture, uv).to(wi.dtype).unflatten(1, (-1, 3))
        level = torch.einsum("nkc,nk->nc", coefficients, basis(wo, wi, self.bands, self.light_functions))
        # `level` is log1p(gain · radiance), or without `gain` radiance; with `cosine`, of radiance over the cosine.
        radiance = level if self.gain is None else to_radiance(level, self.gain)
        return radiance * _cosine_or_one(wi, self.cosine)
