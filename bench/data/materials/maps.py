"""The pictures that describe a material's surface, as physically based asset packs name them: its maps.

Pictures are resized and made periodic here, too. A *seam* is the jump at a border of a picture that is repeated; it is
measured, and blended away. A map is *scalar* if it has one number a texel, not a colour or a vector.
"""

from dataclasses import dataclass, fields, replace
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike

from bench.btf import Array
from bench.inputs.errors import InputError

Map = Any  # a picture or a number in, a float32 picture out


@dataclass(frozen=True, eq=False)
class Maps:
    """A periodic surface: pictures (H', W') or (H', W', 3), row 0 at the top, x right, y up.

    A number stands for a flat map; afterwards every map is a float32 array of such a picture.

    - `height`: displacement along the normal, in units of the picture's *width*; map texels are square. Its mean is
      the reference plane.
    - `base_colour`: linear Rec. 709; a dielectric's diffuse albedo, a metal's reflectance at normal incidence.
    - `roughness`: perceptual, in [0, 1]; the GGX width is α = roughness² (Burley 2012).
    - `metalness`: 0 dielectric, 1 metal, a linear mix between.
    - `specular`: weight in [0, 1] of the dielectric's Fresnel reflection, F0 = 0.04 · specular and F90 = specular
      (glTF KHR_materials_specular); 0 leaves Lambert.
    - `anisotropy`: in [0, 1]; α along the stretch is α / s and across it α · s, with
      s = √(1 − 0.9 · anisotropy) (Burley 2012).
    - `angle`: direction in which the highlight is stretched, across the scratches or fibres; radians from +x,
      counter-clockwise, the same modulo π.
    - `normal`: unit vectors (OpenGL: y up) for shading instead of the slopes of `height`; None uses the slopes.
    - `aspect`: the picture's physical height over its width, no map; None is that of square map texels.

    Raises `InputError` if shapes differ, a value is not finite or one of the weights lies outside [0, 1].
    """

    height: Map
    base_colour: Map
    roughness: Map
    metalness: Map = 0.0
    specular: Map = 1.0
    anisotropy: Map = 0.0
    angle: Map = 0.0
    normal: Map | None = None
    aspect: float | None = None

    def __post_init__(self) -> None:
        """Bring every map to a checked float32 array of the common shape."""
        maps = {field.name: getattr(self, field.name) for field in fields(self) if field.name != "aspect"}
        shape = _common_shape(maps)
        for name, value in maps.items():
            if value is not None:
                object.__setattr__(self, name, _checked(name, value, shape))  # a frozen class refuses `self.name =`

    @property
    def shape(self) -> tuple[int, int]:
        return self.height.shape[0], self.height.shape[1]

    def resized(self, shape: tuple[int, int]) -> "Maps":
        """The maps at another size (H', W'): linear interpolation to enlarge, area averages to shrink, periodic. Angles
        are averaged as directions modulo π. Heights stay in units of the picture's width."""
        if shape == self.shape:
            return self
        # `angle` and `normal` are averaged as vectors below.
        averaged = [name for name in (*_SCALARS, "base_colour") if name != "angle"]
        maps: dict[str, Any] = {name: resize(getattr(self, name), shape) for name in averaged}
        normal = None
        if self.normal is not None:
            normal = resize(self.normal, shape)
            # Opposite normals may cancel: 1e-12 avoids a division by 0.
            normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-12)
        return replace(self, **maps, angle=resize_angle(self.angle, shape), normal=normal)

    def rolled(self, rows: int, cols: int) -> "Maps":
        """The periodic maps moved by so many of their own texels, rows down and columns to the right."""
        moved: dict[str, Any] = {}
        for name in (*_SCALARS, "base_colour", "normal"):
            picture = getattr(self, name)
            if picture is not None:  # normals may be missing
                moved[name] = np.roll(picture, (rows, cols), (0, 1))
        return replace(self, **moved)


class Recipe(Protocol):
    """A material's parameters as a frozen dataclass; they are part of the key of every rendering."""

    def maps(self, seed: int) -> Maps:
        """The surface, at a resolution of its choice; the same for the same seed and parameters."""
        ...


_SCALARS = ("height", "roughness", "metalness", "specular", "anisotropy", "angle")


def _common_shape(maps: dict[str, Any]) -> tuple[int, ...]:
    """The (H', W') of the first of some maps, by name, that is a picture; (1, 1) if all are numbers or colours."""
    for name, value in maps.items():
        shape = np.shape(value)
        axes = 2 if name in _SCALARS else 3  # of a picture of this map; a number or a colour has fewer
        if len(shape) == axes:
            return shape[:2]
    return (1, 1)


def _checked(name: str, value: ArrayLike, shape: tuple[int, ...]) -> Array:
    """The map as a float32 array of the common shape (H', W'), or (H', W', 3) for colours and normals.

    Raises `InputError`, which names the map, for another shape or wrong values.
    """
    array = np.asarray(value, np.float32)
    wanted = shape if name in _SCALARS else (*shape, 3)
    try:
        array = np.broadcast_to(array, wanted)
    except ValueError:
        raise InputError(f"map {name} has shape {array.shape}, but the others need {wanted}") from None
    if not np.isfinite(array).all():
        raise InputError(f"map {name} holds values that are not finite")
    is_weight = name not in ("height", "angle", "normal")  # colours, too, are weights of the light
    if is_weight and (array.min() < 0 or array.max() > 1):
        raise InputError(f"map {name} must lie in [0, 1], not [{array.min():g}, {array.max():g}]")
    return array


def resize(picture: Array, shape: tuple[int, int]) -> Array:
    """A periodic picture (H, W, ...) at another size: linear interpolation to enlarge, area averages to shrink."""
    for axis, size in enumerate(shape):  # the first two axes, not the channels
        old_size = picture.shape[axis]
        if size == old_size:
            continue
        weights = _enlarging_weights(size, old_size) if size > old_size else _shrinking_weights(size, old_size)
        resized = np.tensordot(weights, picture.astype(np.float64), (1, axis))  # puts the new axis first
        picture = np.moveaxis(resized, 0, axis)
    return picture.astype(np.float32)


def resize_angle(angle: Array, shape: tuple[int, int]) -> Array:
    """Periodic angles (H, W) in radians at another size, as by `resize`. They are the same modulo π, so they are
    averaged as directions of twice the angle."""
    double_angle = resize(np.stack([np.cos(2 * angle), np.sin(2 * angle)], -1), shape)
    return 0.5 * np.arctan2(double_angle[..., 1], double_angle[..., 0])


def _enlarging_weights(size: int, old_size: int) -> Array:
    """The weights (size, old_size) of linear interpolation between the centres of `old_size` periodic texels."""
    weights = np.zeros((size, old_size))
    new = np.arange(size)
    place = (new + 0.5) * old_size / size - 0.5  # of a new centre, counted in old texels from the first centre
    before = np.floor(place).astype(int)  # the old centre before it; the next one is `before + 1`
    fraction = place - before
    # `add.at` adds twice where both neighbours are the same texel.
    np.add.at(weights, (new, before % old_size), 1 - fraction)
    np.add.at(weights, (new, (before + 1) % old_size), fraction)
    return weights


def _shrinking_weights(size: int, old_size: int) -> Array:
    """The weights (size, old_size) of area averages: the share of each new texel that each old one covers."""
    old_starts = np.arange(old_size)
    edges = np.arange(size + 1) * old_size / size  # of the new texels, counted in old ones
    ends = np.minimum(edges[1:, None], old_starts + 1)
    starts = np.maximum(edges[:-1, None], old_starts)
    return np.maximum(ends - starts, 0) * size / old_size


def make_periodic(picture: Array, overlap: tuple[int, int]) -> Array:
    """A picture (H − rows, W − columns) that repeats without a seam, made of one that is (H, W); both may have
    channels.

    Its last rows and columns, as many as `overlap` (rows, columns) says, are blended into its first ones and cut off.
    The blend's deviation from the mean is scaled by 1 / √(w² + (1 − w)²), which keeps the contrast of texture; it may
    leave the range of the picture. Raises `InputError` if a margin is more than half of a side.
    """
    rows, cols = overlap
    height, width = picture.shape[:2]
    if not (0 <= 2 * rows <= height and 0 <= 2 * cols <= width):
        raise InputError(f"margins of {cols} × {rows} do not fit twice into a picture of {width} × {height}")
    mean = picture.mean((0, 1))
    for axis, margin in enumerate(overlap):
        lines = np.moveaxis(picture - mean, axis, 0)  # rows, then columns
        kept = len(lines) - margin
        # From 0 at the border to 1; without a margin the array is empty, and `max` avoids a division by 0.
        weight = 0.5 - 0.5 * np.cos(np.pi * (np.arange(margin) + 0.5) / max(margin, 1))
        weight = weight.reshape(-1, *(1,) * (lines.ndim - 1))  # (margin, 1, …)
        blend = weight * lines[:margin] + (1 - weight) * lines[kept:]
        blend /= np.sqrt(weight**2 + (1 - weight) ** 2)
        cut = np.concatenate([blend, lines[margin:kept]])
        picture = np.moveaxis(cut, 0, axis) + mean
    return picture


class Seam(NamedTuple):
    """Means of |difference| between neighbouring columns (or rows) of a picture that is repeated."""

    across: float  # between the last and the first, at the border
    inside: float  # over all neighbours inside
    largest: float  # of the two neighbours inside that differ most


def seams(picture: Array) -> tuple[Seam, Seam]:
    """The seams of a picture (H, W, C) repeated from left to right, and from top to bottom.

    A side below 4 is too short to measure, and gives (0, 1, 1), which is no seam.
    """
    return _left_right_seam(picture), _left_right_seam(picture.swapaxes(0, 1))


def _left_right_seam(picture: Array) -> Seam:
    """The seam of a picture (H, W, C) that is repeated from left to right; see `seams`."""
    if picture.shape[1] < 4:
        return Seam(0.0, 1.0, 1.0)
    steps = np.abs(np.diff(picture, axis=1)).mean((0, 2))  # (W − 1,), from each column to the next
    across = np.abs(picture[:, 0] - picture[:, -1]).mean()
    return Seam(float(across), float(steps.mean()), float(steps.max()))
