"""A Tucker factorisation of the table texels × views × lights × colours.

TensorTextures (Vasilescu and Terzopoulos, SIGGRAPH 2004) factors texels × views × lights by one singular value
decomposition a mode; Wang et al. ("Out-of-core tensor approximation of multi-dimensional matrices of visual data",
SIGGRAPH 2005) continue with alternating least squares, known as HOOI. Here this begins with the principal components of
the texels, which fit in memory. The three colours stay whole.

A *mode* is an axis of the table: texels, V views or L lights. Its *basis* has K, J or M vectors, and the *core* says
how much each product of the three counts. With `domain=log` the table holds log radiance.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal

import torch
from torch import Tensor
from torch.nn import functional

from baselines.components import ComponentsMaterial, principal_components, probed_values, rounded_coefficients
from bench.btf import BTF, Layout
from bench.codec import Codec, Fit, Parts
from bench.directions.interpolation import PairInterpolator, pack_layout, unpack_layout
from bench.inputs.settings import Count, Natural
from bench.material import DecoderCost, Material, at_least_float32, saturated
from bench.training import Bits, Rounding, gain_of, load_texture, store_texture
from bench.training.quantise import FloatPrecision, pack, unpack
from bench.training.svd import Factors

PASSES = 4  # passes over the data, one if they are small
OVERSAMPLING = 2  # components of the texels that the alternation chooses from, as a multiple of those kept


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

    name, version = "tucker", 4
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
        """Store coefficients (H, W, K), bases of views and lights, and the core (J, M, 3, K + 1).

        The mean of all texels is one more component of the texels, the first in the core; its coefficient, 1, is not
        stored.
        """
        settings = self.settings
        layout = btf.layout
        gain = gain_of(btf, fit)
        log_gain = gain if settings.domain == "log" else None  # None: radiance is decomposed as it is
        # The components of texels, then the factors of the table on them.
        factors = principal_components(btf, fit, log_gain, OVERSAMPLING * settings.components, PASSES)
        tensor, texel_components = _tensor(factors, layout)
        ranks = (settings.components, *_direction_ranks(settings, layout))
        texel_basis, view_basis, light_basis, first_core = tucker_factors(tensor, ranks, settings.alternations)
        core, coefficients = _scaled(first_core, texel_components.T @ texel_basis)
        coefficients = coefficients.reshape(*btf.shape, -1)  # (H, W, K)
        # How finely coefficients are rounded: by their errors in the values of P probed pairs.
        bits = settings.bits
        pairs, values = probed_values(btf, fit, log_gain)
        view_index, light_index = _mode_indices(layout)
        views, lights = view_basis[view_index[pairs]], light_basis[light_index[pairs]]  # (P, J), (P, M)
        rows = torch.einsum("pj,pm,jmck->pck", views, lights, core).flatten(0, 1)  # (3 · P, K + 1)
        rounding = rounded_coefficients(coefficients, bits, rows[:, :1], rows[:, 1:], values)
        precision: FloatPrecision = "float32" if bits == 32 else "half"
        # One channel for each slice of the core, because their sizes differ by orders of magnitude.
        decoder = store_texture("core", core, rounding_with_zero(core, bits))
        decoder |= pack("view", view_basis, precision)
        decoder |= pack("light", light_basis, precision)
        return Parts(
            decoder=decoder,
            texture=store_texture("coefficients", coefficients, rounding),
            other={"gain": torch.tensor([gain]), **pack_layout(layout)},
        )

    def decode(self, parts: Parts, device: torch.device) -> Material:
        """The material of a file's parts, on a device. `ValueError` if core and components do not fit."""
        texture = load_texture("coefficients", parts.texture)
        core = load_texture("core", parts.decoder)
        view_basis, light_basis = unpack("view", parts.decoder), unpack("light", parts.decoder)  # (V, J), (L, M)
        layout = unpack_layout(parts.other)
        view_index, light_index = _mode_indices(layout)
        core_shape = (view_basis.shape[1], light_basis.shape[1], 3, texture.shape[2] + 1)  # (J, M, 3, K + 1)
        if core.shape != core_shape:
            raise ValueError(f"its core is {tuple(core.shape)}, but its factors need {core_shape}")
        if int(view_index.max()) >= len(view_basis) or int(light_index.max()) >= len(light_basis):
            raise ValueError("its pairs name a view or light that it has no components of")
        gain = float(parts.other["gain"]) if self.settings.domain == "log" else None
        pair_factors = view_basis[view_index], light_basis[light_index]  # (N, J), (N, M)
        return TuckerMaterial(texture, core, pair_factors, PairInterpolator(layout), gain).to(device)


def _mode_indices(layout: Layout) -> tuple[Tensor, Tensor]:
    """The place of each of N pairs along the mode of views and along that of lights, (N,) each.

    If the pairs are not all products of some views and lights, the mode of views is one of pairs, and that of lights
    has one place.
    """
    if layout.grid is None:
        return torch.arange(len(layout.view)), torch.zeros(len(layout.view), dtype=torch.long)
    return torch.from_numpy(layout.view).long(), torch.from_numpy(layout.light).long()


def _direction_ranks(settings: Tucker.Settings, layout: Layout) -> tuple[int, int]:
    """The most components of the modes of views and of lights.

    Pairs that form no product are one mode, as in `_mode_indices`, whose components may be as many as those of both.
    """
    if layout.grid is None:
        return min(settings.views * settings.lights, len(layout.view)), 1
    return min(settings.views, len(layout.views)), min(settings.lights, len(layout.lights))


def _tensor(factors: Factors, layout: Layout) -> tuple[Tensor, Tensor]:
    """The table on an orthonormal basis of T texels: the tensor (k + 1, V, L, 3), the mean first, and the basis (k, T).

    `factors` are the principal components of the texels. The mean is multiplied by √T, the length of its coefficients,
    which are 1 at each texel.
    """
    length = torch.linalg.vector_norm(factors.coefficients, dim=1, keepdim=True)
    texels = factors.coefficients.shape[1]
    rows = torch.cat([factors.mean[:, None] * texels**0.5, factors.basis * length.T], 1)  # (3 · N, k + 1)
    view, light = _mode_indices(layout)
    tensor = torch.zeros(rows.shape[1], int(view.max()) + 1, int(light.max()) + 1, 3, device=rows.device)
    tensor[:, view, light] = rows.T.unflatten(1, (-1, 3))  # (k + 1, N, 3), each pair to its view and light
    return tensor, factors.coefficients / length


def _scaled(core: Tensor, coefficients: Tensor) -> tuple[Tensor, Tensor]:
    """The core (J, M, 3, K + 1), and the coefficients (T, K) of T texels, scaled to lie between −1 and 1.

    Given are the core (K + 1, J, M, 3) of `tucker_factors` and coefficients of any range. Each is divided by the
    largest of its component, and the core's slice is multiplied by it, so that eight bits suit all slices equally.
    """
    scale = coefficients.abs().amax(0).clamp_min(torch.finfo(torch.float32).tiny)  # (K,)
    of_mean = core[:1] / len(coefficients) ** 0.5  # √T, by which `_tensor` multiplied the mean
    of_components = core[1:] * scale[:, None, None, None]
    return torch.cat([of_mean, of_components]).permute(1, 2, 3, 0).contiguous(), coefficients / scale


def leading_basis(tensor: Tensor, mode: int, rank: int) -> Tensor:
    """The orthonormal basis (size, ≤ rank) of an axis, `mode`, that keeps most of the tensor's energy, its squares."""
    rows = tensor.movedim(mode, 0).flatten(1).double()  # (size, all others)
    _, eigenvectors = torch.linalg.eigh(rows @ rows.T)
    strongest_first = eigenvectors.flip(1)  # the last has the largest eigenvalue
    return strongest_first[:, :rank].to(tensor.dtype)


def tucker_factors(
    tensor: Tensor, ranks: tuple[int, int, int], alternations: int
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Bases of texels (k, K), views (V, J) and lights (L, M), and the core (K + 1, J, M, 3), of (k + 1, V, L, 3).

    K, J and M are at most the `ranks`. The tensor's first slice, the mean, is kept as it is beside the texels'
    components. Each alternation finds the best basis of a mode given the others: De Lathauwer, De Moor, Vandewalle, "On
    the best rank-1 and rank-(R₁, …, R_N) approximation", 2000.
    """
    # Letters of the products: k, v, l are components of texels, views and lights of the table; K, j, m are those of the
    # bases, and c is the colours.
    view, light = leading_basis(tensor, 1, ranks[1]), leading_basis(tensor, 2, ranks[2])
    texel = leading_basis(tensor[1:], 0, ranks[0])
    for _ in range(alternations):
        on_texel_basis = torch.cat([tensor[:1], torch.einsum("kvlc,kK->Kvlc", tensor[1:], texel)])  # (K + 1, V, L, 3)
        view = leading_basis(torch.einsum("kvlc,lm->kvmc", on_texel_basis, light), 1, ranks[1])
        light = leading_basis(torch.einsum("kvlc,vj->kjlc", on_texel_basis, view), 2, ranks[2])
        texel = leading_basis(torch.einsum("kvlc,vj,lm->kjmc", tensor[1:], view, light), 0, ranks[0])
    view, light, texel = _signed(view), _signed(light), _signed(texel)
    on_direction_bases = torch.einsum("kvlc,vj,lm->kjmc", tensor, view, light)  # (k + 1, J, M, 3)
    core = torch.cat([on_direction_bases[:1], torch.einsum("kjmc,kK->Kjmc", on_direction_bases[1:], texel)])
    return texel, view, light, core


def _signed(basis: Tensor) -> Tensor:
    """A basis (size, ≤ size), each vector with the sign that makes its product with (1, ½, ⅓, …) positive.

    A decomposition leaves the sign open, so rounding would decide it.
    """
    reference = 1 / torch.arange(1, len(basis) + 1, dtype=basis.dtype, device=basis.device)
    return basis * torch.where(reference @ basis < 0, -1.0, 1.0)


def rounding_with_zero(values: Tensor, bits: int) -> Rounding:
    """The rounding of values (…, C) to 8 bits, with 0 among the values that a channel can take; `bits` above 8 are
    floats.

    Most numbers of a core are nearly 0: if 0 were between two such values, all would be wrong to the same side.
    """
    rounding = Rounding(values.shape[-1], max(8, bits)).to(values.device)
    low, high = torch.aminmax(values.flatten(0, -2), dim=0)
    # `low` is rounded down to a multiple of the step, so that 0 is met, too. Eight bits have 255 steps: 254 span the
    # values, and one is left for what `low` falls.
    step = ((high - low) / 254).clamp_min(1e-12)  # more than 0, also for equal values
    rounding.low.copy_((low / step).floor() * step)
    rounding.step.copy_(step)
    rounding.bits.fill_(8)
    return rounding


class TuckerMaterial(ComponentsMaterial):
    """Coefficients (H, W, K) bilinear over texels, components of pairs' views and lights, and the core."""

    def __init__(
        self,
        texture: Tensor,
        core: Tensor,
        pair_factors: Sequence[Tensor],
        interpolator: PairInterpolator,
        gain: float | None,
    ):
        """Count the cost of an answer step by step, and keep the parts.

        `pair_factors` are the components (N, J) of each pair's view and (N, M) of its light; the core is (J, M, 3,
        K + 1). `gain` is None if the table holds radiance.
        """
        components = texture.shape[2]
        view_count, light_count = core.shape[:2]  # J, M
        coefficients_read = 4 * components  # of four texels
        directions_read = interpolator.reads * (view_count + light_count)  # components of some pairs' view and light
        # The four steps of an answer, each in multiply-adds.
        mixed_texels = coefficients_read
        products_of_pairs = interpolator.reads * view_count * light_count  # view ⊗ light of each pair, added up
        times_core = core.numel()
        times_coefficients = 3 * components
        multiply_adds = mixed_texels + products_of_pairs + times_core + times_coefficients
        cost = DecoderCost(
            texture_channels=components,
            texture_floats=texture.numel(),
            table_floats=core.numel() + sum(factor.numel() for factor in pair_factors),
            flops_per_sample=2 * multiply_adds,
            bytes_per_sample=4 * (coefficients_read + directions_read + core.numel()),  # float32
        )
        super().__init__(texture, interpolator, gain, cost)
        self.core = core.flatten(2).flatten(0, 1)  # (J · M, 3 · (K + 1))
        self.view, self.light = pair_factors

    def combined(self, pair: Tensor, weight: Tensor, coefficients: Tensor) -> Tensor:
        """Σ weight · view ⊗ light of pairs, through the core to eigen-ABRDFs, times the coefficients: (n, 3).

        Arguments are those of `ComponentsMaterial.combined`.
        """
        # In a slice all queries have one pair of directions, expanded: strides are 0, and its rows are made once.
        if len(pair) > 1 and pair.stride(0) == weight.stride(0) == 0:
            pair, weight = pair[:1], weight[:1]
        # Products of halves may overflow a half with either sign, so they are added in float32.
        dtype = at_least_float32(coefficients.dtype)
        view = functional.embedding(pair, self.view).to(dtype)  # (n, P, J), of P pairs
        light = functional.embedding(pair, self.light).to(dtype)  # (n, P, M)
        products = torch.einsum("npj,npm->njm", view * weight[..., None].to(dtype), light).flatten(1)  # (n, J · M)
        rows = saturated(products @ self.core.to(dtype)).unflatten(1, (3, -1))  # (n, 3, K + 1)
        return (rows * coefficients[:, None].to(dtype)).sum(-1)
