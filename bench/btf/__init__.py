"""The bidirectional texture function (BTF): every reader returns one, every codec encodes one.

Conventions, on which every docstring of the suite relies:

- **Frame.** Seen from above with the picture upright, x points right (+u), y points up (+v) and the normal z
  toward the eye. `wo` points to the camera and `wi` to the light: unit vectors, float32, z > 0 above the
  surface. θ is measured from z, φ from +x counter-clockwise; radians, unless a name ends in `_deg`.
- **Texels.** `uv` is in periods of the picture, u across and v up. Row 0 is the top row of the picture: texel (row,
  col) has its centre at u = (col + 0.5) / W, v = 1 − (row + 0.5) / H. Texels are square: a period is W texels wide and
  H high. A footprint is the side of a square box, in units of the longer side of the picture; see `periods`.
- **Values.** Linear Rec. 709 RGB of f_r · cos θ_i: the radiance that leaves toward ω_o under a directional light
  of unit irradiance on a plane that faces it. Highlights are not clamped. `BTF.provenance` lists the reader's changes.

docs/structure.md defines the words: pair, slice, ABRDF and others.
"""

import hashlib
import json
from collections.abc import Iterator
from dataclasses import KW_ONLY, dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from bench.btf import scratch
from bench.files.atomic import cache_dir
from bench.inputs.errors import InputError

# The `source` of a provenance. These words are part of fingerprints, so they stay, however our packages are called.
RENDERED = "rendered by bench.materials"
BAKED = "baked from maps by bench.bake"
HOLDOUT = 0.125  # the share of the views, and of the lights, that `BTF.split` holds out by default
MASKS = ("heldout", "validation", "low_light")  # of pairs that no codec trains on: fields of a BTF
SAME_DIRECTION = 1e-6  # the largest distance of two unit vectors that count as one direction
MANY_TEXELS = 4_096  # that are read at once: more are picked out of whole slices
Array = np.ndarray


class NotFiniteError(InputError):
    """Radiance that is NaN or infinite; `values` holds what was read, for `bench.data.derived` to repair."""

    def __init__(self, message: str, values: Array):
        super().__init__(message)
        self.values = values


def finite(values: Array, label: str) -> Array:
    """Return values (..., 3) if all are finite; else raise a `NotFiniteError` with `label`, count and first index."""
    good = np.isfinite(values)
    if good.all():
        return values
    # The indices of the first bad value, one for each axis.
    place = ", ".join(str(int(i)) for i in np.argwhere(~good)[0])
    count = int(good.size - np.count_nonzero(good))
    raise NotFiniteError(
        f"{label}: {count} of {good.size} values are not finite (NaN or infinite), the first at index ({place}): "
        "mend the values, leave the pair out, or mask them by --repair (data.repair=true)",
        values,
    )


def in_float32(values: Array, label: str) -> Array:
    """Values of any float type in float32; `InputError` where some are finite, but too large for it."""
    with np.errstate(over="ignore", invalid="ignore"):
        converted = np.asarray(values, np.float32)
    if values.dtype.itemsize > 4:  # of a type that holds larger numbers
        too_large = np.isinf(converted) & np.isfinite(values)
        if too_large.any():
            largest = float(np.abs(values[too_large]).max())
            count = f"{np.count_nonzero(too_large)} of {values.size} values"
            fault = f"{count} are beyond float32, the largest {largest:.3g}"
            raise InputError(f"{label}: {fault}: multiply all by {1 / largest:.0e} in float64")
    return converted


class Source:
    """Where the values of a BTF come from.

    A reader implements `fingerprint`, and `slice`; or, if it reads several slices faster together than one by one,
    `slices` instead, and sets `at_once` to how many. The rest has defaults.

    The default `texels` (of few texels) and `gather` are for sources that can only read whole slices cheaply: they read
    a scratch file of halves (`bench.btf.scratch`), which is made once and cached under the fingerprint.
    """

    shape: tuple[int, int]  # (H, W)
    count: int  # pairs
    at_once: int = 1  # slices that are best read together

    def slice(self, pair: int) -> Array:
        """The picture of one pair, (H, W, 3) float32."""
        return self.slices(np.array([pair]))[0]

    def slices(self, pairs: Array) -> list[Array]:
        """The pictures of some pairs, (H, W, 3) float32 each; it is fastest with `at_once` pairs."""
        return [self.slice(int(pair)) for pair in pairs]

    def fingerprint(self) -> str:
        """A hex digest that changes with the content, found without reading all of it."""
        raise NotImplementedError

    def texels(self, rows: Array, cols: Array, pairs: Array) -> Array:
        """ABRDFs (n, len(pairs), 3) float32 of n texels at some pairs."""
        if len(rows) > MANY_TEXELS:
            return np.stack([self.slice(int(pair))[rows, cols] for pair in pairs], 1)
        flat = rows * self.shape[1] + cols
        # (len(pairs),) and (n, 1) broadcast to (n, len(pairs)).
        return scratch.scattered(self._scratch, pairs, flat[:, None])

    def gather(self, pair: Array, row: Array, col: Array) -> Array:
        """Single values (n, 3) float32 at n places: `pair`, `row` and `col` are (n,)."""
        return scratch.scattered(self._scratch, pair, row * self.shape[1] + col)

    def window(self, top: int, left: int, height: int, width: int) -> "Source":
        """A window of the pictures, which may reach around their borders."""
        return _Cropped(self, top, left, height, width)

    def only(self, pairs: Array) -> "Source":
        """A source that must answer only these pairs, under the same indices; it may drop data of other pairs."""
        return self

    @cached_property
    def digest(self) -> str:
        """The fingerprint, computed once."""
        return self.fingerprint()

    @cached_property
    def _scratch(self) -> Array:
        """The memory-mapped copy (blocks, H · W, pairs of a block, 3) for scattered reads, made at the first use."""
        # Files named `…-blocks.npy` are older, and may hold dim values in too few bits.
        path = cache_dir() / "scratch" / f"{self.digest[:32]}-copy.npy"
        return scratch.opened(path, self.slice, self.count, self.shape)


class ArraySource(Source):
    """Values held in one array (count, H, W, 3), in memory or memory-mapped, of any float type."""

    def __init__(self, values: Array, label: str = "radiance"):
        """Values (pairs, H, W, 3), linear radiance of any float type; other shapes raise `ValueError`.

        `label` names them in errors.
        """
        if values.ndim != 4 or values.shape[-1] != 3:
            raise ValueError(f"values must be (pairs, H, W, 3), not {values.shape}")
        self.values = values
        self.label = label
        self.count = len(values)
        self.shape = (values.shape[1], values.shape[2])

    def slice(self, pair: int) -> Array:
        return in_float32(self.values[pair], f"{self.label}[{pair}]")

    def texels(self, rows: Array, cols: Array, pairs: Array) -> Array:
        return in_float32(self.values[pairs[None, :], rows[:, None], cols[:, None]], f"{self.label} at texels")

    def gather(self, pair: Array, row: Array, col: Array) -> Array:
        return in_float32(self.values[pair, row, col], f"{self.label} at samples")

    def fingerprint(self) -> str:
        """A hash of shape, type and all values."""
        # An array has no file that tells its content, so all of it is read.
        digest = hashlib.sha256(f"{self.values.shape} {self.values.dtype}".encode())
        for block in self.values:
            digest.update(np.ascontiguousarray(block).tobytes())
        return digest.hexdigest()


class _BoxFiltered(Source):
    """Another source averaged over factor × factor texels; rows and columns that do not fill a box are left out."""

    def __init__(self, source: Source, factor: int):
        self.source = source
        self.factor = factor
        self.count = source.count
        self.at_once = source.at_once
        self.shape = (source.shape[0] // factor, source.shape[1] // factor)

    def _box(self, rows: Array, cols: Array) -> tuple[Array, Array]:
        """The rows and columns, each (n · factor²,), of the source's texels in n boxes, box after box, row by row."""
        inside = np.arange(self.factor)
        fine_rows = rows[:, None] * self.factor + inside
        fine_cols = cols[:, None] * self.factor + inside
        # From (n, factor) each to (n, factor, factor): rows down, columns across.
        fine_rows, fine_cols = np.broadcast_arrays(fine_rows[:, :, None], fine_cols[:, None, :])
        return fine_rows.reshape(-1), fine_cols.reshape(-1)

    def slices(self, pairs: Array) -> list[Array]:
        return [box_filter(picture, self.factor) for picture in self.source.slices(pairs)]

    def texels(self, rows: Array, cols: Array, pairs: Array) -> Array:
        """As `Source.texels`: the means of all texels of the source in each box."""
        # A few texels here are many of the source, for which it would read whole slices: ask it part by part. Where
        # they are many here, too, whole slices are best.
        most = max(1, MANY_TEXELS // self.factor**2)
        if most < len(rows) <= MANY_TEXELS:
            starts = range(0, len(rows), most)
            return np.concatenate([self.texels(rows[i : i + most], cols[i : i + most], pairs) for i in starts])
        fine = self.source.texels(*self._box(rows, cols), pairs)
        return fine.reshape(len(rows), self.factor**2, len(pairs), 3).mean(1)

    def gather(self, pair: Array, row: Array, col: Array) -> Array:
        fine = self.source.gather(np.repeat(pair, self.factor**2), *self._box(row, col))
        return fine.reshape(len(row), self.factor**2, 3).mean(1)

    def fingerprint(self) -> str:
        return hashlib.sha256(f"{self.source.digest} box {self.factor}".encode()).hexdigest()


class _Cropped(Source):
    """A window of another source, which may reach around its border."""

    def __init__(self, source: Source, top: int, left: int, height: int, width: int):
        """A window of `height` × `width` texels, whose first is (top, left). It wraps around the source."""
        self.source = source
        self.count = source.count
        self.shape = (height, width)
        self.at_once = source.at_once
        # The source's row of each row of the window, and its column of each column.
        self.rows = (top + np.arange(height)) % source.shape[0]
        self.cols = (left + np.arange(width)) % source.shape[1]

    def slices(self, pairs: Array) -> list[Array]:
        return [picture[self.rows[:, None], self.cols] for picture in self.source.slices(pairs)]

    def texels(self, rows: Array, cols: Array, pairs: Array) -> Array:
        return self.source.texels(self.rows[rows], self.cols[cols], pairs)

    def gather(self, pair: Array, row: Array, col: Array) -> Array:
        return self.source.gather(pair, self.rows[row], self.cols[col])

    def fingerprint(self) -> str:
        text = f"{self.source.digest} window {self.rows[0]} {self.cols[0]} {self.shape}"
        return hashlib.sha256(text.encode()).hexdigest()


def periods(size: tuple[int, int]) -> tuple[float, float]:
    """The length of the longer side of a picture (H, W), in periods along u and along v: 1 and 1 of a square one."""
    height, width = size
    return max(size) / width, max(size) / height


def box_filter(picture: Array, factor: int) -> Array:
    """The mean of each factor × factor box of a picture (H, W, C); an incomplete last row or column is left out."""
    height, width = picture.shape[0] // factor, picture.shape[1] // factor
    full = picture[: height * factor, : width * factor]
    return full.reshape(height, factor, width, factor, -1).mean((1, 3))


@dataclass(frozen=True)
class Layout:
    """How the pairs of a BTF are arranged: its distinct views and lights, and whether they form a product."""

    views: Array  # (V, 3)
    lights: Array  # (L, 3)
    view: Array  # (N,) index into views
    light: Array  # (N,) index into lights

    @classmethod
    def of(cls, wo: Array, wi: Array) -> "Layout":
        """The layout of pairs wo, wi (N, 3); directions within 1e-6 of each other are one."""
        views, view = _distinct(wo)
        lights, light = _distinct(wi)
        return cls(views, lights, view, light)

    @cached_property
    def grid(self) -> Array | None:
        """Pair indices (V, L) where every view is combined with every light exactly once, else None."""
        if len(self.view) != len(self.views) * len(self.lights):
            return None
        grid = np.full((len(self.views), len(self.lights)), -1)  # −1: no pair
        grid[self.view, self.light] = np.arange(len(self.view))
        return None if (grid < 0).any() else grid


@dataclass(frozen=True)
class Split:
    """Disjoint pair indices: what a codec may train on, the held-out groups by name, those that choose settings, and
    those of low light, which decide nothing."""

    train: Array
    heldout: dict[str, Array] = field(default_factory=dict)
    validation: Array = field(default_factory=lambda: np.empty(0, int))
    low_light: Array = field(default_factory=lambda: np.empty(0, int))  # lower lights than any that is trained on

    def __repr__(self) -> str:
        """A line such as `<Split: 64 training pairs, 17 held out (new view 8, new light 8, both new 1)>`."""
        held_out = f"{sum(map(len, self.heldout.values())):,} held out"
        if len(self.heldout) > 1:
            groups = ", ".join(f"{name} {len(pairs):,}" for name, pairs in self.heldout.items())
            held_out += f" ({groups})"
        words = [f"{len(self.train):,} training pairs", held_out]
        if len(self.validation):
            words.append(f"{len(self.validation):,} for validation")
        if len(self.low_light):
            words.append(f"{len(self.low_light):,} of low light")
        return f"<Split: {', '.join(words)}>"


@dataclass(eq=False, repr=False)
class BTF:
    """Outgoing radiance over texels × pairs, read lazily. See the module for frame, units and colour space.

    Every read checks that the values are finite; if not, it raises a `NotFiniteError` with their number and place.

    `wo` and `wi` are (N, 3) float32, `shape` is (H, W), `len(btf)` is N and `btf[i]` the slice (H, W, 3) float32.
    `heldout`, where declared, is an (N,) mask of pairs that no codec may train on; `validation`, of those that choose;
    `low_light`, of pairs lit lower than any that is trained on, which belong to none of these.
    `holdout`, from 0 to below 1, is the share of the views and of the lights that `split` holds out where no `heldout`
    is declared.
    `periodic` says that the picture wraps around without a seam, as every rendered material does.
    `between`, of some rendered materials, is a BTF of a few held-out pairs half a texel down and to the right of the
    texel centres. No fit and no other BTF made from this one has it, and the fingerprint leaves it out.
    """

    name: str
    wo: Array
    wi: Array
    source: Source
    _: KW_ONLY
    heldout: Array | None = None
    validation: Array | None = None
    low_light: Array | None = None
    holdout: float = HOLDOUT
    periodic: bool = False
    between: "BTF | None" = None
    provenance: dict[str, Any] = field(default_factory=dict)
    pairs: Array = None  # type: ignore[assignment]  # those of the source; by default all

    def __post_init__(self) -> None:
        """Convert what was given to arrays of the stated types, and check their shapes; `pairs` default to all."""
        self.wo = np.asarray(self.wo, np.float32)
        self.wi = np.asarray(self.wi, np.float32)
        if self.pairs is None:
            self.pairs = np.arange(self.source.count)
        self.provenance = dict(self.provenance or {})
        if self.wo.shape != (len(self.pairs), 3) or self.wi.shape != self.wo.shape:
            raise ValueError(f"wo and wi must be ({len(self.pairs)}, 3), not {self.wo.shape}, {self.wi.shape}")
        for name in MASKS:
            if getattr(self, name) is None:
                continue
            mask = np.asarray(getattr(self, name), bool)
            if mask.shape != (len(self.pairs),):
                raise ValueError(f"{name} must be ({len(self.pairs)},), not {mask.shape}")
            setattr(self, name, mask)
        # Whole views and lights that `split` would hold out otherwise have no place for them.
        if self.heldout is None and self.low_light is not None and self.low_light.any():
            raise ValueError("low_light needs a declared heldout, which may be all False")

    def __repr__(self) -> str:
        held = "" if self.heldout is None else f", {int(self.heldout.sum()):,} of them held out"
        return f"<BTF {self.name}: {self.shape[0]} × {self.shape[1]} texels, {len(self):,} pairs{held}>"

    @property
    def shape(self) -> tuple[int, int]:
        return self.source.shape

    def __len__(self) -> int:
        return len(self.pairs)

    def __getitem__(self, pair: int | slice) -> Array:
        """The slice (H, W, 3) of a pair, or those of a range of pairs, (n, H, W, 3)."""
        if isinstance(pair, slice):
            chosen = np.arange(len(self))[pair]
            return np.array(list(self._slices(chosen)), np.float32).reshape(len(chosen), *self.shape, 3)
        return finite(self.source.slice(int(self.pairs[pair])), f"{self.name}: pair {pair}")

    def __iter__(self) -> Iterator[Array]:
        """The slices (H, W, 3) of all pairs in order."""
        return self._slices(np.arange(len(self)))

    def _slices(self, chosen: Array) -> Iterator[Array]:
        """The slices (H, W, 3) float32 of the pairs of some indices (n,), in that order; as many are read together as
        is best for the source."""
        for start in range(0, len(chosen), self.source.at_once):
            together = chosen[start : start + self.source.at_once]
            for pair, picture in zip(together, self.source.slices(self.pairs[together]), strict=True):
                yield finite(picture, f"{self.name}: pair {pair}")

    def texels(self, rows: ArrayLike, cols: ArrayLike) -> Array:
        """ABRDFs (n, N, 3) float32 of the n texels (rows[i], cols[i])."""
        values = self.source.texels(np.asarray(rows), np.asarray(cols), self.pairs)
        return finite(values, f"{self.name}: texels, pairs, channels")

    def gather(self, pair: ArrayLike, row: ArrayLike, col: ArrayLike) -> Array:
        """Values (n, 3) float32 at n scattered (pair, row, col)."""
        values = self.source.gather(self.pairs[np.asarray(pair)], np.asarray(row), np.asarray(col))
        return finite(values, f"{self.name}: samples, channels")

    def subset(self, pairs: ArrayLike) -> "BTF":
        """The same BTF at some of its pairs, given by index."""
        chosen = np.asarray(pairs)
        kept: dict[str, Any] = {}
        for name in ("wo", "wi", *MASKS, "pairs"):
            values = getattr(self, name)
            kept[name] = None if values is None else values[chosen]
        # The source keeps its numbering, so `pairs` stays valid.
        return replace(self, source=self.source.only(self.pairs[chosen]), between=None, **kept)

    def without_low_light(self) -> "BTF":
        """The BTF without its pairs of low light, as if they had never been drawn."""
        if self.low_light is None:
            return self
        rest = self.subset(np.flatnonzero(~self.low_light))
        provenance = {key: value for key, value in self.provenance.items() if key != "low_light"}
        return replace(rest, low_light=None, provenance=provenance)

    def without_test(self) -> "BTF":
        """The BTF without its test pairs; its held-out pairs are then whole views and lights of the rest."""
        return replace(self.subset(self.split().train), heldout=None)

    def with_validation(self) -> "BTF":
        """The BTF with validation pairs besides its test pairs: whole views and lights of the rest."""
        train = self.split().train
        rest = self.without_test().split()  # its indices count the pairs of `train` alone
        # The pairs of `train` that the second split holds out are those that choose settings.
        choosing = np.delete(train, rest.train)
        return replace(self, validation=np.isin(np.arange(len(self)), choosing))

    def downsample(self, factor: int) -> "BTF":
        """The BTF box-filtered over factor × factor texels, in linear light. Rows and columns at the end that do not
        fill a box are left out; the result is then not periodic. `ValueError` if no whole box fits."""
        if not 1 <= factor <= min(self.shape):
            raise ValueError(f"factor must be between 1 and {min(self.shape)}, not {factor}")
        if factor == 1:
            return self
        periodic = self.periodic and not any(side % factor for side in self.shape)
        return replace(self, periodic=periodic).over(_BoxFiltered(self.source, factor), downsampled=factor)

    def crop(self, top: int, left: int, height: int, width: int) -> "BTF":
        """The BTF of a window, which may reach around the border; not periodic. `ValueError` if larger than the BTF."""
        if not (1 <= height <= self.shape[0] and 1 <= width <= self.shape[1]):
            raise ValueError(f"a window of {height} × {width} does not fit into {self.shape}")
        source = self.source.window(top, left, height, width)
        return replace(self, periodic=False).over(source, cropped=[top, left, height, width])

    def over(self, source: Source, **provenance: Any) -> "BTF":
        """The same pairs read from another source of equal count; `provenance` is added to say what was done."""
        return replace(self, source=source, between=None, provenance=self.provenance | provenance)

    @cached_property
    def layout(self) -> Layout:
        return Layout.of(self.wo, self.wi)

    @cached_property
    def fingerprint(self) -> str:
        """Hex digest of content, pairs, directions, split and `periodic`; two BTFs that share it hold the same table.

        Pairs of low light are not part of it: they decide nothing, so scores with and without them are comparable.
        """
        if self.low_light is not None:
            return self.without_low_light().fingerprint
        digest = hashlib.sha256(self.source.digest.encode())
        digest.update(self.pairs.astype(np.int64).tobytes())
        digest.update(self.wo.tobytes() + self.wi.tobytes())
        heldout = False if self.heldout is None else self.heldout.tolist()  # False stands for no declared mask
        digest.update(json.dumps([heldout, self.periodic]).encode())
        # A mask without a pair says the same as no mask, and so adds nothing.
        if self.validation is not None and self.validation.any():
            digest.update(self.validation.tobytes())
        # The usual share adds nothing either, and a declared mask is there already.
        if self.heldout is None and self.holdout != HOLDOUT:
            digest.update(f"holdout {float(self.holdout)}".encode())
        return digest.hexdigest()

    def split(self, seed: int = 0) -> Split:
        """Training pairs and held-out groups, disjoint.

        A declared split is kept as the one group `heldout`. Otherwise whole views and whole lights are held out
        (the share `holdout` of each, by seed), so that the training pairs of a product stay a product; the groups are
        `new view`, `new light` and `both new`. A side with fewer than four directions holds out none. There are no
        groups if `holdout` is 0. `InputError` if it leaves no pair to train on.
        """
        none = np.zeros(len(self), bool)
        choosing = none if self.validation is None else self.validation
        if self.heldout is not None:
            low = none if self.low_light is None else self.low_light
            train = ~self.heldout & ~choosing & ~low
            heldout = {"heldout": np.flatnonzero(self.heldout)}
            return Split(np.flatnonzero(train), heldout, np.flatnonzero(choosing), np.flatnonzero(low))
        rng = np.random.default_rng(seed)
        # Masks (N,) of the pairs whose view, or whose light, is drawn to be held out.
        drawn_view = _heldout_directions(rng, len(self.layout.views), self.holdout)[self.layout.view]
        drawn_light = _heldout_directions(rng, len(self.layout.lights), self.holdout)[self.layout.light]
        trained = ~drawn_view & ~drawn_light
        if len(self) and not trained.any():
            raise InputError(f"{self.name}: data.holdout={self.holdout:g} leaves no pairs to train on: lower it")
        # Of scattered pairs a held-out view takes its light with it, which is then new, too.
        new_view = ~np.isin(self.layout.view, self.layout.view[trained])
        new_light = ~np.isin(self.layout.light, self.layout.light[trained])
        groups = {
            "new view": new_view & ~new_light,
            "new light": ~new_view & new_light,
            "both new": new_view & new_light,
        }
        heldout = {name: np.flatnonzero(mask) for name, mask in groups.items() if mask.any()}
        return Split(np.flatnonzero(trained & ~choosing), heldout, np.flatnonzero(choosing))


def _heldout_directions(rng: np.random.Generator, count: int, share: float) -> Array:
    """Mask (count,) of the held-out directions of one side: none if they are fewer than four, or the share is 0; else
    at least one."""
    mask = np.zeros(count, bool)
    if share and count >= 4:
        chosen = max(1, round(count * share))
        mask[rng.permutation(count)[:chosen]] = True
    return mask


def _distinct(directions: Array) -> tuple[Array, Array]:
    """Distinct directions (n, 3) in the order of first appearance, and the index in them (N,) of each of (N, 3)."""
    rounded = np.round(directions, 6) + 0.0  # the sum makes 0 of −0
    first, index = _first_places(rounded)
    return _merged(directions[first], index)


def _first_places(values: Array) -> tuple[Array, Array]:
    """Where each distinct value, or row, of an array first stands, in ascending order (n,); and for each value (N,),
    which of these n it equals."""
    _, first, inverse = np.unique(values, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)  # NumPy sorts by value; this puts the first places in ascending order
    rank = np.argsort(order)  # and this tells where each of NumPy's values then stands
    return first[order], rank[inverse.reshape(-1)]


def _merged(distinct: Array, index: Array) -> tuple[Array, Array]:
    """Distinct rows (n, 3) and the index of each direction in them, where rows within 1e-6 of each other become one.

    Rounding has merged most; it leaves apart those on either side of a boundary. The first of several stands for all.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    near = cKDTree(distinct).query_pairs(SAME_DIRECTION, output_type="ndarray")  # (m, 2)
    if not len(near):
        return distinct, index
    ones = np.ones(len(near), bool)
    graph = coo_array((ones, (near[:, 0], near[:, 1])), shape=(len(distinct), len(distinct)))
    _, group = connected_components(graph, directed=False)  # of each row
    first, merged = _first_places(group)
    return distinct[first], merged[index]
