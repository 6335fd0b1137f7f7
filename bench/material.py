"""The decoded material: answers queries (u, v, ω_o, ω_i, footprint) → RGB, in PyTorch.

Frame, units and colour space: see `bench.btf`.
"""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, ClassVar, overload

import numpy as np
import torch
from numpy.typing import ArrayLike
from torch import Tensor, nn
from torch.nn import functional

from bench.inputs.errors import InputError, answered
from bench.machine.devices import is_gpu

CHUNK = 16_384  # queries evaluated at once: intermediates stay in cache, memory does not grow with the batch
GPU_CHUNKS = 64  # a chunk on a GPU is this many of the CPU's: 2^20 queries fill it
UNIT_TOLERANCE = 1e-3
HALF_MAX = 65504.0
DEEPEST = 64  # levels of nested networks that are distinguished
HIGHEST_LEVEL = 60.0  # of log radiance: 1e26 times the brightest percent, but far below the limit of float32


@dataclass(frozen=True)
class DecoderCost:
    """The cost of a decoder as its codec declares it; `neubtf-bench check` compares it with counted values."""

    parameters: int = 0  # numbers of the decoder's networks, each once, frozen or not; 0 for tables
    texture_channels: int = 0  # numbers a texel of the finest texture
    texture_floats: int = 0  # numbers in all textures of the decoder, including coarser levels and finer copies
    flops_per_sample: int = 0  # a fused multiply-add counts as two
    bytes_per_sample: int = 0  # read from textures and tables for one query
    table_floats: int = 0  # numbers of the file's decoder part that belong to no network: a basis, a codebook

    @classmethod
    def of_texture(cls, texture: Tensor, parameters: int = 0, flops: int = 0) -> "DecoderCost":
        """The cost of fetching a texture (H, W, C) bilinearly and decoding it with a network."""
        channels = texture.shape[2]
        numbers_read = 4 * channels  # of the four texels around a query; each is multiplied and added
        bytes_read = numbers_read * texture.element_size()
        return cls(parameters, channels, texture.numel(), flops + 2 * numbers_read, bytes_read)


class Material:
    """A decoded material. A codec writes `evaluate`, and `maps` or `at_one_texel` if it has them; the rest is final.

    `size` is (H, W), the resolution that `slice` answers at. Tensors and networks that `evaluate` uses are
    attributes, so that `to` and `modules` find them.
    """

    opaque: ClassVar[bool] = False  # whether another program answers, whose parameters and time cannot be measured

    def __init__(self, size: tuple[int, int], cost: DecoderCost):
        """A material of `size` (H, W) texels, on the CPU in float32 at first; `cost` is what tables show of it."""
        self.size = size
        self.cost = cost
        self.lowest_light = 0.0  # cos θ of the lowest light of the fit: see `faded`
        self.device = torch.device("cpu")
        self.dtype = torch.float32
        self.chunk = CHUNK

    def __repr__(self) -> str:
        """A line such as `<TextureMaterial: 128 × 128 texels, 8 texture channels, 3,171 parameters, float32, cpu>`."""
        height, width = self.size
        cost = self.cost
        dtype = str(self.dtype).removeprefix("torch.")
        numbers = f"{cost.texture_channels} texture channels, {cost.parameters:,} parameters"
        return f"<{type(self).__name__}: {height} × {width} texels, {numbers}, {dtype}, {self.device}>"

    def evaluate(self, uv: Tensor, wo: Tensor, wi: Tensor, footprint: Tensor) -> Tensor:
        """RGB (n, 3) of valid queries above the horizon: uv (n, 2), wo and wi (n, 3), footprint (n,). Pure.

        Queries stay float32 for a half or bfloat16 material: these types can resolve neither texels nor the zenith.
        """
        raise NotImplementedError

    @property
    def lowest_light_deg(self) -> float:
        """The angle from the normal, in degrees, of the lowest light of the fit."""
        return math.degrees(math.acos(self.lowest_light))

    def faded(self, uv: Tensor, wo: Tensor, wi: Tensor, footprint: Tensor) -> Tensor:
        """As `evaluate`, with an answer that falls to 0 with the light's cosine where the light is lower than any of
        the fit: the answer is that of the lowest light of the fit at its azimuth, times the ratio of their cosines.

        A fit says nothing of lower lights, and what a network makes of them need not even be dark.
        """
        cosine = wi[:, 2:]
        raised = cosine.clamp_min(self.lowest_light)
        sine = (1 - cosine.square()).clamp_min(1e-12).sqrt()
        stretch = (1 - raised.square()).clamp_min(0).sqrt() / sine  # of the part along the surface
        light = torch.where(cosine < self.lowest_light, torch.cat([wi[:, :2] * stretch, raised], 1), wi)
        return self.evaluate(uv, wo, light, footprint) * (cosine / raised)

    def modules(self) -> Sequence[nn.Module]:
        """The networks whose parameters are counted as the decoder's, each once; none for tables."""
        # A dictionary keeps each network once, in order; modules without parameters are left out.
        networks = dict.fromkeys(value for value in vars(self).values() if isinstance(value, nn.Module))
        return [network for network in networks if next(network.parameters(), None) is not None]

    def maps(self) -> tuple[dict[str, np.ndarray], float]:
        """PBR pictures by name, if the codec stores any, and a factor on the radiance that they reflect.

        A picture is uint8 (H, W) or (H, W, 3), row 0 on top. Names are those that renderers use: `BaseColor` (sRGB),
        `NormalGL` (−1 to 1 as 0 to 255, y up), `Roughness` and `Metalness`.
        """
        return {}, 1.0

    def at_one_texel(self) -> "Material | None":
        """The same material, which answers a query by one texel, drawn by its bilinear weight: noisy, of the same mean.

        Only a codec whose network answers texels has one, and is timed both ways; others give None.
        """
        return None

    def to(self, device: torch.device | str | None = None, dtype: torch.dtype | None = None) -> "Material":
        """Move every tensor and network to a device, floating-point ones to a dtype, in place; returns itself.

        Modules without parameters hold geometry, such as sampled directions, and stay at least float32.
        """
        for name, value in vars(self).items():
            if isinstance(value, nn.Module):
                has_parameters = next(value.parameters(), None) is not None
                module_dtype = dtype
                if dtype is not None and not has_parameters:
                    module_dtype = at_least_float32(dtype)
                value.to(device=device, dtype=module_dtype)
            elif isinstance(value, Tensor):
                moved = value.to(device=device, dtype=dtype if value.is_floating_point() else None)
                if moved.dtype != value.dtype:
                    moved = saturated(moved)  # a half cannot hold what is beyond its range
                setattr(self, name, moved)
        if device is not None:
            # A chunk is longer on a GPU. The two factors cancel, unless one device is a GPU and the other is not.
            self.chunk *= GPU_CHUNKS if is_gpu(device) else 1
            self.chunk //= GPU_CHUNKS if is_gpu(self.device) else 1
            self.device = torch.device(device)
        self.dtype = dtype or self.dtype
        return self

    @overload
    def query(self, uv: Tensor, wo: Tensor, wi: Tensor, footprint: Tensor | float | None = None) -> Tensor: ...
    @overload
    def query(self, uv: ArrayLike, wo: ArrayLike, wi: ArrayLike, footprint: ArrayLike | None = None) -> np.ndarray: ...

    @torch.no_grad()
    def query(self, uv: Any, wo: Any, wi: Any, footprint: Any = None) -> Tensor | np.ndarray:
        """RGB (n, 3) float32, ≥ 0, of n queries: uv (n, 2), wo and wi (n, 3), footprint (n,) or one number.

        Queries are tensors or NumPy arrays; the result is of uv's kind. A direction at or below the horizon gives 0.
        Directions must be of unit length within 1e-3 and every number finite; otherwise an `InputError` names the first
        bad row. Memory beyond inputs and outputs is bounded.
        """
        footprint = 0.0 if footprint is None else footprint
        if not isinstance(uv, Tensor):
            tensors = map(_tensor, (uv, wo, wi, footprint))
            return self.query(*tensors).cpu().numpy()
        keep_buffers()
        wo = _tensor(wo).to(uv.device)
        wi = _tensor(wi).to(uv.device)
        footprint = torch.as_tensor(footprint, device=uv.device)
        _check_shapes(uv, wo, wi, footprint)
        footprint = footprint.expand(len(uv))
        out = torch.empty(len(uv), 3, device=uv.device)
        for start in range(0, len(uv), self.chunk):
            rows = slice(start, start + self.chunk)
            queries = uv[rows], wo[rows], wi[rows], footprint[rows]
            _check_values(*queries, start)
            out[rows] = self._answer(*queries)
        return out

    def _answer(self, uv: Tensor, wo: Tensor, wi: Tensor, footprint: Tensor) -> Tensor:
        """Answer one chunk. Below the horizon the result is 0; `evaluate` is given the zenith there instead."""
        below = (wo[:, 2] <= 0) | (wi[:, 2] <= 0)
        # Wrap in double precision: float32 would lose the position of uv = ±1e6.
        uv = uv.double()
        uv = uv - uv.floor()
        # On a GPU always: whether any is below would first have to be waited for.
        if is_gpu(below.device) or below.any():
            zenith = torch.eye(3, dtype=wo.dtype, device=wo.device)[2]
            wo = torch.where(below[:, None], zenith, wo)
            wi = torch.where(below[:, None], zenith, wi)
        dtype = at_least_float32(self.dtype)
        # Without waiting for a copy to a GPU: the CPU's tensor is read before `to` returns, and the GPU works in order.
        ahead = is_gpu(self.device)
        queries = [x.to(self.device, dtype, non_blocking=ahead) for x in (uv, wo, wi, footprint)]
        # On a CPU only where it changes anything: most batches are of lights that were fitted.
        fades = self.lowest_light > 0 and (ahead or bool((wi[:, 2] < self.lowest_light).any()))
        rgb = self.faded(*queries) if fades else self.evaluate(*queries)
        if not isinstance(rgb, Tensor) or rgb.shape != (len(uv), 3):
            answer = f"a tensor {tuple(rgb.shape)}" if isinstance(rgb, Tensor) else rgb
            raise answered(self.evaluate, answer, f"a tensor ({len(uv)}, 3)")
        return rgb.float().clamp_min(0).masked_fill(below[:, None].to(rgb.device), 0)

    def slice(self, wo: Sequence[float], wi: Sequence[float], size: tuple[int, int] | None = None) -> Tensor:
        """The picture (H, W, 3) of one pair at the texel centres of `size`, each with a footprint of one texel."""
        return self.boxes(wo, wi, [1], size)[1]

    def boxes(
        self, wo: Sequence[float], wi: Sequence[float], factors: Sequence[int], size: tuple[int, int] | None = None
    ) -> dict[int, Tensor]:
        """The pictures of one pair, of `size` (H, W) averaged over boxes of factor × factor texels, by factor:
        (H // factor, W // factor, 3) each.

        Each box is one query at its centre, with the box as footprint. Boxes are those of `bench.btf.box_filter`.
        """
        height, width = size or self.size
        places = [box_centres((height, width), factor) for factor in factors]
        counts = [len(centres) for centres in places]
        # All boxes are one batch: a batch of the few boxes of a large factor takes as long as one of many.
        uv = torch.cat(places)
        footprints = torch.tensor(factors).repeat_interleave(torch.tensor(counts)) / max(height, width)
        view, light = (torch.as_tensor(side, dtype=torch.float32).expand(len(uv), 3) for side in (wo, wi))
        pictures = {}
        for factor, answers in zip(factors, self.query(uv, view, light, footprints).split(counts), strict=True):
            pictures[factor] = answers.reshape(height // factor, width // factor, 3)
        return pictures


class Wrapped(Material):
    """Wraps a material, and computes its `evaluate` in another way or elsewhere; `to` does not move the inner one."""

    def __init__(self, inner: Material):
        """Take size, cost, lowest light, device, type and chunk from the inner material."""
        super().__init__(inner.size, inner.cost)
        self.inner = inner
        self.lowest_light = inner.lowest_light
        self.device = inner.device
        self.dtype = inner.dtype
        self.chunk = inner.chunk

    def modules(self) -> Sequence[nn.Module]:
        return self.inner.modules()


def parameters(material: Material) -> int:
    """The number of parameters of the decoder's networks: see `layers`."""
    return sum(count for _, _, count in layers(material))


def resident_bytes(material: Material) -> int:
    """Bytes of a decoder in memory: textures with their levels and copies, tables, networks."""
    # By address: tensors that share memory count once.
    storages = {tensor.untyped_storage().data_ptr(): tensor.untyped_storage().nbytes() for tensor in _tensors(material)}
    return sum(storages.values())


def _tensors(material: Material) -> Iterator[Tensor]:
    """Every tensor that a material holds, also in its networks and in a material that it wraps."""
    for value in vars(material).values():
        if isinstance(value, Material):
            yield from _tensors(value)
        elif isinstance(value, nn.Module):
            yield from value.parameters()
            yield from value.buffers()
        elif isinstance(value, Tensor):
            yield value


def layers(material: Material) -> list[tuple[str, str, int]]:
    """Name, kind and number of parameters of each layer of the decoder networks, as torchinfo walks through them.

    Each parameter counts once, in the layer that is reached first, even if layers share it or networks share layers. A
    frozen one counts, too: a renderer needs it as much as one that was trained. Parameters that the material holds
    itself come last.
    """
    from torchinfo import summary

    rows = []
    counted = set[int]()  # the identities of parameters
    place = list[str]()  # the names of a layer and of those around it, from the outermost

    def uncounted(parameters: Iterable[nn.Parameter]) -> int:
        """How many numbers those of the parameters hold that were not counted before; they are counted now."""
        new = [parameter for parameter in parameters if id(parameter) not in counted]
        counted.update(id(parameter) for parameter in new)
        return sum(parameter.numel() for parameter in new)

    for network in material.modules():
        for layer in summary(network, depth=DEEPEST, verbose=0).summary_list:
            # Names of layers that are as deep or deeper end; this layer's takes their place.
            place[layer.depth :] = [layer.var_name]
            count = uncounted(layer.module.parameters(recurse=False))
            if count:
                rows.append((".".join(place), layer.class_name, count))
    for name, value in vars(material).items():
        if isinstance(value, nn.Parameter):
            count = uncounted([value])
            if count:
                rows.append((name, "Parameter", count))
    return rows


@cache
def keep_buffers() -> None:
    """Make the C library reuse freed blocks for the next chunk; by default it maps large blocks again, page by page.
    glibc raises its mapping threshold to the largest block freed, up to 32 MB; an untouched block costs nothing."""
    torch.empty(31 << 20, dtype=torch.uint8)


def _tensor(values: ArrayLike | Tensor) -> Tensor:
    """Convert to a tensor, which may share memory; whole numbers become floats."""
    if isinstance(values, Tensor):
        return values if values.is_floating_point() else values.float()
    try:
        array = np.asarray(values)
        array = array if np.issubdtype(array.dtype, np.floating) else array.astype(np.float32)
    except (ValueError, TypeError) as error:
        raise InputError(f"query: not an array of numbers ({error})") from error
    return torch.from_numpy(np.require(array, requirements=["C", "W"]))  # no negative strides or read-only memory


def _check_shapes(uv: Tensor, wo: Tensor, wi: Tensor, footprint: Tensor) -> None:
    """Raise an `InputError` unless uv is (n, 2), wo and wi are (n, 3), and footprint is (), (1,) or (n,)."""
    n = len(uv) if uv.ndim else 0
    if uv.shape != (n, 2) or wo.shape != (n, 3) or wi.shape != (n, 3):
        shapes = f"{tuple(uv.shape)}, {tuple(wo.shape)}, {tuple(wi.shape)}"
        raise InputError(f"query: uv, wo, wi must be (n, 2), (n, 3), (n, 3), not {shapes}")
    if footprint.shape not in ((), (1,), (n,)):
        raise InputError(f"query: footprint must be one number or ({n},), not {tuple(footprint.shape)}")


def _check_values(uv: Tensor, wo: Tensor, wi: Tensor, footprint: Tensor, start: int) -> None:
    """Raise an `InputError` that names the first invalid row, counted from `start`."""
    # A sum is not finite if any of its terms is not, and it is far cheaper than a mask.
    sums = torch.stack([values.sum(dtype=torch.float64) for values in (uv, wo, wi, footprint)])
    # Masks (n,) of the views, and of the lights, that are not of unit length.
    wo_off, wi_off = [(torch.linalg.vector_norm(values, dim=1) - 1).abs() > UNIT_TOLERANCE for values in (wo, wi)]
    # `&`, not `and`, makes one answer of three: a GPU is waited for each time that the host asks for one.
    if sums.isfinite().all() & ~(wo_off | wi_off).any() & (footprint.min() >= 0):
        return
    for name, values in (("uv", uv), ("wo", wo), ("wi", wi), ("footprint", footprint[:, None])):
        wrong_rows = (~torch.isfinite(values).all(1)).nonzero()
        if len(wrong_rows):
            row = int(wrong_rows[0])
            raise InputError(f"query: {name} of row {start + row} is not finite: {values[row].tolist()}")
    for name, values, off in (("wo", wo, wo_off), ("wi", wi, wi_off)):
        if off.any():
            row = int(off.nonzero()[0])
            where = f"{name} of row {start + row}"
            raise InputError(f"query: {where} is not of unit length: {values[row].tolist()}; normalise it")
    if footprint.min() < 0:
        raise InputError(f"query: footprint of row {start + int(footprint.argmin())} is negative")


def at_least_float32(dtype: torch.dtype) -> torch.dtype:
    """The dtype, or float32 if it is shorter."""
    return torch.promote_types(dtype, torch.float32)


def saturated(x: Tensor) -> Tensor:
    """Replace infinite halves by the largest finite half, 65,504; other dtypes are returned as they are."""
    return x.clamp(-HALF_MAX, HALF_MAX) if x.dtype == torch.float16 else x


def to_radiance(level: Tensor, gain: float) -> Tensor:
    """Radiance of level = log1p(gain · radiance), of any shape.

    At least in float32, since a half would overflow at 65,504 / gain. A level above `HIGHEST_LEVEL` counts as that, so
    that the result is always finite.
    """
    return level.to(at_least_float32(level.dtype)).clamp(max=HIGHEST_LEVEL).expm1() / gain


def texel_centres(height: int, width: int) -> Tensor:
    """uv (height · width, 2) of the texel centres, row by row from the top of the picture."""
    return box_centres((height, width), 1)


def box_centres(size: tuple[int, int], factor: int) -> Tensor:
    """uv (n, 2) of the centres of whole boxes of factor × factor texels of a picture (H, W), from the top row down."""
    height, width = size
    # The centres in texels from the top and from the left.
    row = factor * (torch.arange(height // factor) + 0.5)
    col = factor * (torch.arange(width // factor) + 0.5)
    v, u = torch.meshgrid(1 - row / height, col / width, indexing="ij")
    return torch.stack([u, v], -1).reshape(-1, 2)


def texel_corners(size: tuple[int, int], uv: Tensor) -> tuple[Tensor, Tensor]:
    """Flat texel indices (n, 4) and bilinear weights (n, 4) around uv (n, 2) in a periodic picture of `size`: upper
    left, upper right, lower left, lower right."""
    index, weight = _corners(size, uv)
    return index.long(), weight


def _corners(size: tuple[int, int], uv: Tensor) -> tuple[Tensor, Tensor]:
    """As `texel_corners`, with int32 indices, which take half the time to compute and read."""
    height, width = size
    # Half precision cannot resolve texels, so positions are float32 for any dtype of the codec. They count from the
    # centre of the first texel, half a texel inside the picture.
    col = uv[:, 0].float() * width - 0.5
    row = (1 - uv[:, 1].float()) * height - 0.5
    first_col = col.floor()
    first_row = row.floor()
    right = col - first_col  # the share of the texels on the right
    below = row - first_row  # and of the lower ones
    left = 1 - right
    above = 1 - below
    west = first_col.int().remainder(width)  # the columns and rows of the four texels
    north = first_row.int().remainder(height)
    # The next column and row; after the last comes the first. A comparison is far cheaper than a second remainder.
    east = torch.where(west == width - 1, 0, west + 1)
    south = torch.where(north == height - 1, 0, north + 1)
    north_start = north * width  # the flat index of the first texel of each row
    south_start = south * width
    index = torch.stack([north_start + west, north_start + east, south_start + west, south_start + east], 1)
    return index, torch.stack([above * left, above * right, below * left, below * right], 1)


def sample_texture(texture: Tensor, uv: Tensor) -> Tensor:
    """A texture (H, W, C) at uv (n, 2), bilinear and periodic: (n, C), in the texture's dtype."""
    index, weight = _corners((texture.shape[0], texture.shape[1]), uv)
    rows = texture.flatten(0, 1)  # (H · W, C)
    weight = weight.to(texture.dtype)
    if texture.shape[2] and not (texture.requires_grad or uv.requires_grad):
        return functional.embedding_bag(index, rows, per_sample_weights=weight, mode="sum")
    # The gradient of an embedding bag is slower than that of the explicit sum.
    return torch.einsum("nk,nkc->nc", weight, rows[index])
