"""The pictures that describe a material's surface, as physically based asset packs name them.

Pictures are made periodic, too: the seam at the borders is measured, and blended away.
"""

from dataclasses import dataclass, fields, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from bench.btf import Array
from bench.inputs.errors import InputError

Map = Any  # a picture or a number in, a float32 picture out


@dataclass(frozen=True, eq=False)
class Maps:
    """A periodic surface: pictures (H', W') or (H', W', 3), row 0 at the top, x right, y up.

    A number stands for a flat map; every field is a float32 array afterwards.

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

    def __post_init__(self) -> None:
        """Bring every map to a checked float32 array of the common shape."""
        given = {field.name: getattr(self, field.name) for field in fields(self)}
        shape = _common_shape(given)
        for name, value in given.items():
            if value is not None:
                object.__setattr__(self, name, _checked(name, value, shape))

    @property
    def shape(self) -> tuple[int, int]:
        return self.height.shape[0], self.height.shape[1]

    def resized(self, shape: tuple[int, int]) -> "Maps":
        """The maps at another size (H', W'): linear interpolation to enlarge, area averages to shrink, periodic. Angles
        are averaged as directions modulo π. Heights stay in units of the picture's width."""
        if shape == self.shape:
            return self
        # `angle` and `normal` are averaged as vectors below, an angle by twice its value, because it has a period of π.
        averaged = [name for name in (*_SCALARS, "base_colour") if name != "angle"]
        maps = {name: resize(getattr(self, name), shape) for name in averaged}
        double = resize(np.stack([np.cos(2 * self.angle), np.sin(2 * self.angle)], -1), shape)
        angle = 0.5 * np.arctan2(double[..., 1], double[..., 0])
        normal = None if self.normal is None else resize(self.normal, shape)
        if normal is not None:
            normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-12)
        return replace(self, **maps, angle=angle, normal=normal)


class Recipe(Protocol):
    """A material's parameters as a frozen dataclass; they are part of the key of every rendering."""

    def maps(self, seed: int) -> Maps:
        """The surface, at a resolution of its choice; the same for the same seed and parameters."""
        ...


_SCALARS = ("height", "roughness", "metalness", "specular", "anisotropy", "angle")


def _common_shape(given: dict[str, Any]) -> tuple[int, ...]:
    """The (H', W') of the first map that is a picture; (1, 1) if all are numbers or single colours."""
    for name, value in given.items():
        shape = np.shape(value)
        axes = 2 if name in _SCALARS else 3
        if len(shape) == axes:
            return shape[:2]
    return (1, 1)


def _checked(name: str, value: ArrayLike, shape: tuple[int, ...]) -> Array:
    """The map as a float32 array of the common shape (H', W'), or (H', W', 3) for colours and normals."""
    array = np.asarray(value, np.float32)
    wanted = shape if name in _SCALARS else (*shape, 3)
    try:
        array = np.broadcast_to(array, wanted)
    except ValueError:
        raise InputError(f"map {name} has shape {array.shape}, but the others need {wanted}") from None
    if not np.isfinite(array).all():
        raise InputError(f"map {name} holds values that are not finite")
    if name not in ("height", "angle", "normal") and (array.min() < 0 or array.max() > 1):
        raise InputError(f"map {name} must lie in [0, 1], not [{array.min():g}, {array.max():g}]")
    return array


def resize(picture: Array, shape: tuple[int, int]) -> Array:
    """A periodic picture (H, W, ...) at another size: linear interpolation to enlarge, area averages to shrink."""
    for axis, size in enumerate(shape):  # the first two axes, not the channels
        old = picture.shape[axis]
        if size == old:
            continue
        weights = _enlarging(size, old) if size > old else _shrinking(size, old)
        resized = np.tensordot(weights, picture.astype(np.float64), (1, axis))  # puts the new axis first
        picture = np.moveaxis(resized, 0, axis)
    return picture.astype(np.float32)


def _enlarging(size: int, old: int) -> Array:
    """The weights (size, old) of linear interpolation between the centres of `old` periodic texels."""
    weights = np.zeros((size, old))
    row = np.arange(size)
    place = (row + 0.5) * old / size - 0.5  # of a new centre, counted in old texels from the first centre
    low = np.floor(place).astype(int)
    # `add.at` adds twice where both neighbours are the same texel.
    np.add.at(weights, (row, low % old), 1 - (place - low))
    np.add.at(weights, (row, (low + 1) % old), place - low)
    return weights


def _shrinking(size: int, old: int) -> Array:
    """The weights (size, old) of area averages: the share of each new texel that each old one covers."""
    cells = np.arange(old)
    edges = np.arange(size + 1) * old / size  # of the new texels, counted in old ones
    overlap = np.minimum(edges[1:, None], cells + 1) - np.maximum(edges[:-1, None], cells)
    return np.maximum(overlap, 0) * size / old


def make_periodic(picture: Array, overlap: tuple[int, int]) -> Array:
    """A picture (H, W) or (H, W, C) cut by `overlap` (rows, columns), its far margins blended into its near ones.

    The blend's deviation from the mean is scaled by 1 / √(w² + (1 − w)²), which keeps the contrast of texture; it may
    leave the range of the picture. Raises `InputError` if a margin is more than half of a side.
    """
    rows, cols = overlap
    height, width = picture.shape[:2]
    if not (0 <= 2 * rows <= height and 0 <= 2 * cols <= width):
        raise InputError(f"margins of {cols} × {rows} do not fit twice into a picture of {width} × {height}")
    mean = picture.mean((0, 1))
    for axis, margin in enumerate(overlap):
        moved = np.moveaxis(picture - mean, axis, 0)
        size = len(moved) - margin
        # From 0 at the border to 1; without a margin the array is empty, and `max` avoids a division by 0.
        weight = 0.5 - 0.5 * np.cos(np.pi * (np.arange(margin) + 0.5) / max(margin, 1))
        weight = weight.reshape(-1, *(1,) * (moved.ndim - 1))  # (margin, 1, …)
        blend = weight * moved[:margin] + (1 - weight) * moved[size:]
        blend /= np.sqrt(weight**2 + (1 - weight) ** 2)
        cut = np.concatenate([blend, moved[margin:size]])
        picture = np.moveaxis(cut, 0, axis) + mean
    return picture


def seams(picture: Array) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """The seams of a picture (H, W, C) repeated from left to right, and from top to bottom: three numbers each.

    They are means of |difference| between neighbours: across the border, over all neighbours inside, and the largest
    mean inside between two whole columns (or rows). A side below 4 is too short to measure, and gives (0, 1, 1).
    """
    return _seam(picture), _seam(picture.swapaxes(0, 1))


def _seam(picture: Array) -> tuple[float, float, float]:
    """The three numbers of `seams` at the left–right border."""
    if picture.shape[1] < 4:
        return 0.0, 1.0, 1.0
    steps = np.abs(np.diff(picture, axis=1)).mean((0, 2))
    across = np.abs(picture[:, 0] - picture[:, -1]).mean()
    return float(across), float(steps.mean()), float(steps.max())
