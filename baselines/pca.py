"""Principal components of the ABRDFs: a texture of coefficients times a few eigen-ABRDFs.

A texel's ABRDF is about the mean of all plus the sum of k components, the eigen-ABRDFs, times its k coefficients. With
`domain=log` it holds log radiance. The file rounds coefficients and components.
"""

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from baselines.components import ComponentsMaterial, principal_components, probed_values, rounded_coefficients
from bench.btf import BTF
from bench.codec import Codec, Fit, Parts
from bench.directions.interpolation import PairInterpolator, pack_layout, picture_of_pairs, unpack_layout
from bench.inputs.settings import Count, Range
from bench.material import DecoderCost, Material, at_least_float32, saturated
from bench.training import Bits, gain_of, load_table, load_texture, round_after, store_table, store_texture
from bench.training.quantise import FloatPrecision, pack, unpack
from bench.training.svd import Factors, strongest

LARGE = 4 << 30  # bytes of a matrix in float32; the components of a larger one are found in a part of it
PART_PAIRS, PART_TEXELS = 2_048, 16_384  # the part: its pairs, and the texels at which all pairs are then fitted
SPARE = 64  # components of the part beyond the requested ones
PAIRS_AT_ONCE = 64  # pairs that are read and fitted together


class PCA(Codec):
    """Principal components of the ABRDFs, interpolated over directions: the linear baseline.

    @inproceedings{mueller2003compression,
      author = {Müller, Gero and Meseth, Jan and Klein, Reinhard},
      title = {Compression and Real-Time Rendering of Measured {BTFs} Using Local {PCA}},
      booktitle = {Vision, Modeling and Visualisation 2003},
      pages = {271--280},
      year = {2003},
      url = {https://cg.cs.uni-bonn.de/de/publikationen/paper-details/mueller-2003-compression/}
    }
    """

    name, version = "pca", 5
    interpolates, sizes = True, ("components",)

    @dataclass(frozen=True)
    class Settings:
        components: Count = 16  # eigen-ABRDFs; fewer if the data have a lower rank
        domain: Literal["log", "rgb"] = "log"  # decomposed quantity: log1p(8 · exposure · x) or x itself
        bits: Bits = 0  # bits of a stored number on average; 0: chosen by the data; 16, 32: floats
        passes: Annotated[int, Range(2, 1000)] = 4  # passes over the data; one if they are small

    def encode(self, btf: BTF, fit: Fit) -> Parts:
        """Store the coefficients (H, W, k) and, of N pairs, the components with the mean.

        With `domain=log` the mean is the first of k + 1 components, (V, L, k + 1, 3) of N = V · L. With `domain=rgb` it
        is stored apart as floats, (N, 3), beside k components, (V, L, k, 3).
        """
        log = self.settings.domain == "log"
        gain = gain_of(btf, fit) if log else 1.0
        log_gain = gain if log else None  # None: radiance is decomposed as it is
        factors = self._factors_of(btf, fit, log_gain)
        bits = self.settings.bits
        texture = factors.coefficients.T.unflatten(0, btf.shape)  # (H, W, k)
        mean = factors.mean.reshape(-1, 3)  # (N, 3)
        basis = factors.basis.unflatten(0, (-1, 3))  # (N, 3, k)
        # Some values, (3 · P, texels), which tell how finely coefficients and components must be rounded.
        pairs, values = probed_values(btf, fit, log_gain)
        # First the coefficients are rounded, with exact components. (3 · P, 1): the mean, apart from the components.
        apart_mean = mean[pairs].reshape(-1, 1)
        rows = basis[pairs].flatten(0, 1)  # (3 · P, k)
        rounding = rounded_coefficients(texture, bits, apart_mean, rows, values)
        # Then the components are rounded, with exact coefficients.
        coefficients = factors.coefficients  # (k, texels)
        decoder = dict[str, Tensor]()
        if log:  # the mean is one more component, whose coefficient is 1
            basis = torch.cat([mean[..., None], basis], 2)  # (N, 3, k + 1)
            rows = basis[pairs].flatten(0, 1)
            coefficients = functional.pad(coefficients, (0, 0, 1, 0), value=1.0)  # (k + 1, texels)
            apart_mean = torch.zeros_like(apart_mean)  # it is among the rows now
        else:  # the mean's range is that of the highlights, so eight bits are too few
            precision: FloatPrecision = "float32" if bits == 32 else "half"
            decoder = pack("mean", mean, precision)

        def answers(components: Tensor) -> Tensor:
            """The values (3 · P, texels) that components (3 · P, k or k + 1) of the probed pairs give."""
            return apart_mean + components @ coefficients

        basis_rounding = round_after(rows, bits, answers, values).fit_to(basis)
        # The colours of a component follow each other, so that one predicts the next.
        table = basis.transpose(1, 2).unflatten(0, picture_of_pairs(btf.layout))
        return Parts(
            decoder=decoder | store_table("basis", table, basis_rounding, axis=2),
            texture=store_texture("coefficients", texture, rounding),
            other={"gain": torch.tensor([gain]), **pack_layout(btf.layout)},
        )

    def _factors_of(self, btf: BTF, fit: Fit, gain: float | None) -> Factors:
        """The components of a BTF, found in a part of it if its matrix is larger than `LARGE`, but never for a scene.

        `gain` is that of log radiance; None: of radiance as it is.
        """
        matrix_bytes = 12 * len(btf) * btf.shape[0] * btf.shape[1]  # three float32 a texel and pair
        if matrix_bytes > LARGE and not fit.density:
            return self._factors_of_part(btf, fit, gain)
        return principal_components(btf, fit, gain, self.settings.components, self.settings.passes)

    def _factors_of_part(self, btf: BTF, fit: Fit, gain: float | None) -> Factors:
        """The components of a whole measurement, for which four readings would take a quarter of an hour.

        First more components than requested are found in some of the pairs, at all texels. Then each pair is fitted by
        their coefficients at some texels, by least squares, which gives components of all pairs. The strongest of these
        are kept. Against a reading of everything the error of a row grows by 0.6 %. `gain` is as in `_factors_of`.
        """
        # Some pairs and some texels at random, each in order; each draw starts from the seed of the fit.
        pairs = torch.randperm(len(btf), generator=fit.generator())[:PART_PAIRS].sort().values
        texel_count = btf.shape[0] * btf.shape[1]
        texels = torch.randperm(texel_count, generator=fit.generator())[:PART_TEXELS].sort().values
        more = self.settings.components + SPARE
        factors = principal_components(btf.subset(pairs.numpy()), fit, gain, more, self.settings.passes)
        # The mean is the first component, whose coefficient is 1: (k + 1, texels).
        coefficients = functional.pad(factors.coefficients[:, texels].double(), (0, 0, 1, 0), value=1.0)
        # The least squares of values = coefficientsᵀ · components are solution · values.
        solution = torch.linalg.pinv(coefficients).T.float()  # (k + 1, texels)
        rows, columns = np.divmod(texels.numpy(), btf.shape[1])
        components = []
        for start in fit.progress(range(0, len(btf), PAIRS_AT_ONCE), "fitting each pair"):
            next_pairs = btf.subset(np.arange(start, min(start + PAIRS_AT_ONCE, len(btf))))
            values = torch.from_numpy(next_pairs.texels(rows, columns)).flatten(1).to(fit.device)
            if gain is not None:  # log radiance, in place
                values.clamp_min_(0).mul_(gain).log1p_()
            components.append(solution @ values)  # (k + 1, 3 · pairs), of values (texels, 3 · pairs)
        table = torch.cat(components, 1)  # (k + 1, 3 · N), the mean first
        return strongest(Factors(table[0], table[1:].T, factors.coefficients), self.settings.components)

    def decode(self, parts: Parts, device: torch.device) -> Material:
        """The material of a file's parts, on a device. `ValueError` if components and coefficients do not fit."""
        texture = load_texture("coefficients", parts.texture)
        table = load_table("basis", parts.decoder, axis=2).flatten(0, 1).transpose(1, 2)  # (N, 3, k + 1), or k
        gain = float(parts.other["gain"]) if self.settings.domain == "log" else None
        if gain is None:
            table = torch.cat([unpack("mean", parts.decoder)[..., None], table], 2)
        if table.shape[1:] != (3, texture.shape[2] + 1):  # (N, 3, k + 1): the mean's coefficient is 1
            raise ValueError(f"components {tuple(table.shape)} for coefficients {tuple(texture.shape)}")
        interpolator = PairInterpolator(unpack_layout(parts.other, len(table)))
        return PCAMaterial(texture, table, interpolator, gain).to(device)


class PCAMaterial(ComponentsMaterial):
    """Coefficients (H, W, k) bilinear over texels, eigen-ABRDFs (N, 3, k + 1) interpolated over directions."""

    def __init__(self, texture: Tensor, table: Tensor, interpolator: PairInterpolator, gain: float | None):
        """Count the cost of an answer term by term, and keep the parts. `gain` is None if answers are radiance."""
        components = texture.shape[2]
        row = table[0].numel()  # numbers of a pair: 3 · (k + 1)
        coefficients_read = 4 * components  # of four texels
        table_read = interpolator.reads * row
        # Each number that is read enters a weighted sum; the mixed row is then multiplied by the coefficients.
        multiply_adds = coefficients_read + table_read + row
        cost = DecoderCost(
            texture_channels=components,
            texture_floats=texture.numel(),
            table_floats=table.numel(),
            flops_per_sample=2 * multiply_adds,
            bytes_per_sample=4 * (coefficients_read + table_read),  # float32
        )
        super().__init__(texture, interpolator, gain, cost)
        self.table = table.flatten(1)  # (N, 3 · (k + 1))

    def combined(self, pair: Tensor, weight: Tensor, coefficients: Tensor) -> Tensor:
        """Σ weight · table row · coefficients, (n, 3), as in `ComponentsMaterial`.

        An embedding bag adds up the rows without allocating them, (n, P, 3, k + 1) of P pairs.
        """
        rows = functional.embedding_bag(pair, self.table, per_sample_weights=weight.to(self.table.dtype), mode="sum")
        rows = saturated(rows)  # shares in halves may add up to slightly more than 1
        # Products of halves may overflow a half with either sign, so they are added in float32.
        dtype = at_least_float32(rows.dtype)
        components = rows.reshape(len(pair), 3, -1).to(dtype)  # (n, 3, k + 1)
        return (components * coefficients[:, None].to(dtype)).sum(-1)
