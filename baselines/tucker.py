"""A Tucker factorisation of the table texels × views × lights × colours.

TensorTextures (Vasilescu and Terzopoulos, SIGGRAPH 2004) factors texels × views × lights by one singular value
decomposition a mode; Wang et al. ("Out-of-core tensor approximation of multi-dimensional matrices of visual data",
SIGGRAPH 2005) continue with alternating least squares, known as HOOI. Here this begins with the principal components of
the texels, which fit in memory. The three colours stay whole.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal

import torch
from torch import Tensor
from torch.nn import functional

from baselines.components import ComponentsMaterial, principal, probed, rounded_coefficients
from bench.btf import BTF, Layout
from bench.codec import Codec, Fit, Parts
from bench.directions.interpolation import PairInterpolator, pack_layout, unpack_layout
from bench.inputs.settings import Count, Natural
from bench.material import DecoderCost, Material, at_least_float32, saturated
from bench.training import Bits, Rounding, gain_of, load_texture, store_texture
from bench.training.quantise import FloatPrecision, pack, unpack
from bench.training.svd import Factors

PASSES = 4  # passes over the data, one if they are small
OVERSAMPLED = 2  # components of the texels that the alternation chooses from, as a multiple of those kept


class Tucker(Codec):
    """Tucker factorisation: components of texels, of views and of lights, and a core that joins them.

    @article{vasilescu2004tensortextures,
      author = {Vasilescu, M. Alex O. and Terzopoulos, Demetri},
      title = {{TensorTextures}: Multilinear Image-Based Rendering},
      journal = {ACM Transactions on Graphics},
      volume = {23},
      number = {3},
      pages = {336--342},
      year = {2004},
      doi = {10.1145/1015706.1015725}
    }
    """

    name, version = "tucker", 3
    interpolates, sizes = True, ("components", "views", "lights")
    recipes: ClassVar = {"paper": {"bits": 8, "domain": "rgb", "alternations": 0}}

    @dataclass(frozen=True)
    class Settings:
        recipe: Literal["ours", "paper"] = "ours"  # "paper": of radiance, one decomposition a mode (HOSVD)
        components: Count = 16  # components of the texels
        views: Count = 16  # components of the views, at most the number of views
        lights: Count = 16  # components of the lights
        alternations: Natural = 8  # least squares of one mode after another (HOOI), after the first decomposition
        domain: Literal["log", "rgb"] = "log"  # decomposed quantity: log1p(8 · exposure · x) or x itself
        bits: Bits = 0  # bits of a stored coefficient on average; 0: chosen by the data; 16, 32: floats; core: 8

    def encode(self, btf: BTF, fit: Fit) -> Parts:
        """Coefficients (H, W, K), bases of views and lights, and the core (J, M, 3, K + 1), the mean's slice first."""
        settings = self.settings
        layout = btf.layout
        gain = gain_of(btf, fit)
        level = gain if settings.domain == "log" else None
        factors = principal(btf, fit, level, OVERSAMPLED * settings.components, PASSES)
        tensor, turn = _tensor(factors, layout)
        ranks = _ranks(settings, layout)
        texel, view, light, core = factored(tensor, (settings.components, *ranks), settings.alternations)
        coefficients = turn.T @ texel  # (T, K)
        # Coefficients in [−1, 1], as in `pca`, so that eight bits suit all slices of the core equally.
        scale = coefficients.abs().amax(0).clamp_min(torch.finfo(torch.float32).tiny)  # (K,)
        core[1:] *= scale[:, None, None, None]
        core[0] /= len(coefficients) ** 0.5  # √texels, by which `_tensor` multiplied the mean
        core = core.permute(1, 2, 3, 0).contiguous()  # (J, M, 3, K + 1)
        coefficients = (coefficients / scale).reshape(*btf.shape, -1)  # (H, W, K)
        bits = settings.bits
        pairs, values = probed(btf, fit, level)
        joined = [mode[index[pairs]] for mode, index in zip((view, light), _modes(layout), strict=True)]
        rows = torch.einsum("pj,pm,jmck->pck", *joined, core).flatten(0, 1)  # (3 · P, K + 1)
        rounding = rounded_coefficients(coefficients, bits, rows[:, :1], rows[:, 1:], values)
        fine: FloatPrecision = "float32" if bits == 32 else "half"
        return Parts(
            # One channel for each slice of the core, because their sizes differ by orders of magnitude.
            decoder=store_texture("core", core, rounding_with_zero(core, bits))
            | pack("view", view, fine)
            | pack("light", light, fine),
            texture=store_texture("coefficients", coefficients, rounding),
            other={"gain": torch.tensor([gain]), **pack_layout(layout)},
        )

    def decode(self, parts: Parts, device: torch.device) -> Material:
        texture = load_texture("coefficients", parts.texture)
        core = load_texture("core", parts.decoder)
        view, light = unpack("view", parts.decoder), unpack("light", parts.decoder)
        layout = unpack_layout(parts.other)
        index = _modes(layout)
        wanted = (view.shape[1], light.shape[1], 3, texture.shape[2] + 1)
        if core.shape != wanted or any(int(i.max()) >= len(f) for i, f in zip(index, (view, light), strict=True)):
            raise ValueError(f"its core is {tuple(core.shape)}, but its factors need {wanted}")
        gain = float(parts.other["gain"]) if self.settings.domain == "log" else None
        modes = view[index[0]], light[index[1]]
        return TuckerMaterial(texture, core, modes, PairInterpolator(layout), gain).to(device)


def _modes(layout: Layout) -> tuple[Tensor, Tensor]:
    """The place of each pair (N,) along the modes of views and of lights; pairs that form no product are one mode."""
    if layout.grid is None:
        return torch.arange(len(layout.view)), torch.zeros(len(layout.view), dtype=torch.long)
    return torch.from_numpy(layout.view).long(), torch.from_numpy(layout.light).long()


def _ranks(settings: Tucker.Settings, layout: Layout) -> tuple[int, int]:
    """The most components of the modes of views and of lights; pairs that form no product share one mode."""
    if layout.grid is None:
        return min(settings.views * settings.lights, len(layout.view)), 1
    return min(settings.views, len(layout.views)), min(settings.lights, len(layout.lights))


def _tensor(factors: Factors, layout: Layout) -> tuple[Tensor, Tensor]:
    """The table on an orthonormal basis of T texels: the tensor (k + 1, V, L, 3), the mean first, and the basis (k, T).

    The mean is multiplied by √T, the length of its coefficients, which are 1 at each texel.
    """
    length = torch.linalg.vector_norm(factors.coefficients, dim=1, keepdim=True)
    texels = factors.coefficients.shape[1]
    rows = torch.cat([factors.mean[:, None] * texels**0.5, factors.basis * length.T], 1)  # (3 · N, k + 1)
    view, light = _modes(layout)
    tensor = torch.zeros(rows.shape[1], int(view.max()) + 1, int(light.max()) + 1, 3, device=rows.device)
    tensor[:, view, light] = rows.T.unflatten(1, (-1, 3))  # (k + 1, N, 3)
    return tensor, factors.coefficients / length


def leading(tensor: Tensor, mode: int, rank: int) -> Tensor:
    """The orthonormal basis (size, ≤ rank) of a mode that keeps most of the tensor's energy."""
    rows = tensor.movedim(mode, 0).flatten(1).double()  # (size, all others)
    return torch.linalg.eigh(rows @ rows.T)[1].flip(1)[:, :rank].to(tensor.dtype)  # the last is the strongest


def factored(tensor: Tensor, ranks: tuple[int, int, int], alternations: int) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Bases of texels (k, K), views (V, J) and lights (L, M), and the core (K + 1, J, M, 3), of (k + 1, V, L, 3).

    The first slice, the mean, is kept beside the texels' components. Each alternation finds the best basis of a mode
    given the others: De Lathauwer, De Moor, Vandewalle, "On the best rank-1 and rank-(R₁, …, R_N) approximation", 2000.
    """
    view, light = leading(tensor, 1, ranks[1]), leading(tensor, 2, ranks[2])
    texel = leading(tensor[1:], 0, ranks[0])
    for _ in range(alternations):
        reduced = torch.cat([tensor[:1], torch.einsum("kvlc,kK->Kvlc", tensor[1:], texel)])
        view = leading(torch.einsum("kvlc,lm->kvmc", reduced, light), 1, ranks[1])
        light = leading(torch.einsum("kvlc,vj->kjlc", reduced, view), 2, ranks[2])
        texel = leading(torch.einsum("kvlc,vj,lm->kjmc", tensor[1:], view, light), 0, ranks[0])
    view, light, texel = _signed(view), _signed(light), _signed(texel)
    core = torch.einsum("kvlc,vj,lm->kjmc", tensor, view, light)
    return texel, view, light, torch.cat([core[:1], torch.einsum("kjmc,kK->Kjmc", core[1:], texel)])


def _signed(basis: Tensor) -> Tensor:
    """A basis (size, ≤ size), each vector positive along 1, ½, ⅓, …: in a decomposition rounding decides the sign."""
    along = 1 / torch.arange(1, len(basis) + 1, dtype=basis.dtype, device=basis.device)
    return basis * torch.where(along @ basis < 0, -1.0, 1.0)


def rounding_with_zero(values: Tensor, bits: int) -> Rounding:
    """The rounding of values (…, C) to 8 bits, with 0 among each channel's levels; `bits` above 8 are floats.

    Most numbers of a core are nearly 0: if 0 were between two levels, all would be wrong to the same side.
    """
    rounding = Rounding(values.shape[-1], max(8, bits)).to(values.device)
    low, high = torch.aminmax(values.flatten(0, -2), dim=0)
    # `low` becomes a multiple of the step, so that 0 is a level, too. It may fall by up to a step: of 255, one is left.
    step = ((high - low) / 254).clamp_min(1e-12)
    rounding.low.copy_((low / step).floor() * step)
    rounding.step.copy_(step)
    rounding.bits.fill_(8)
    return rounding


class TuckerMaterial(ComponentsMaterial):
    """Coefficients (H, W, K) bilinear over texels, components (N, J), (N, M) of pairs' views and lights, the core."""

    def __init__(
        self, texture: Tensor, core: Tensor, modes: Sequence[Tensor], interpolator: PairInterpolator, gain: float | None
    ):
        components = texture.shape[2]
        joined = core.shape[0] * core.shape[1]
        directions = interpolator.reads * (core.shape[0] + core.shape[1])
        cost = DecoderCost(
            texture_channels=components,
            texture_floats=texture.numel(),
            table_floats=core.numel() + sum(mode.numel() for mode in modes),
            flops_per_sample=2 * (4 * components + interpolator.reads * joined + core.numel() + 3 * components),
            bytes_per_sample=4 * (4 * components + directions + core.numel()),
        )
        super().__init__(texture, interpolator, gain, cost)
        self.core = core.flatten(2).flatten(0, 1)  # (J · M, 3 · (K + 1))
        self.view, self.light = modes

    def combined(self, pair: Tensor, weight: Tensor, coefficients: Tensor) -> Tensor:
        """Σ weight · view ⊗ light of pairs, through the core to eigen-ABRDFs, times the coefficients: (n, 3)."""
        if len(pair) > 1 and pair.stride(0) == weight.stride(0) == 0:  # a slice: one pair of directions
            pair, weight = pair[:1], weight[:1]
        # Products of halves may overflow a half with either sign, so they are added in float32.
        dtype = at_least_float32(coefficients.dtype)
        # (n, P, J) and (n, P, M), of P pairs.
        view, light = (functional.embedding(pair, mode).to(dtype) for mode in (self.view, self.light))
        joined = torch.einsum("npj,npm->njm", view * weight[..., None].to(dtype), light).flatten(1)
        rows = saturated(joined @ self.core.to(dtype)).unflatten(1, (3, -1))  # (n, 3, K + 1)
        return (rows * coefficients[:, None].to(dtype)).sum(-1)
