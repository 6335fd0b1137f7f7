"""Renders slices of a BTF from maps and directions: primary visibility with parallax, one light, self-shadowing.

A value is the mean of f_r · (n·ω_i)⁺ · V over the fixed sub-points of a texel: the radiance leaving toward ω_o per unit
irradiance on a plane that faces the light. Texel (row, col) is viewed through its place on the reference plane, the
mean height, as in rectified measurements. Only direct light counts: there is no inter-reflection.

A ray runs from the surface toward the camera (for `View`), or toward the light (for shadows). The *grid* is that of the
maps once they are resized. Each ray of a view passes through a *sub-point* of the reference plane, the centre of a
block of `stride` grid cells. *Visibility* is the share of the light that reaches a place.

All rays of a view are parallel and start on a regular grid, so one marching step of the whole bundle is a shift of the
height map, and no scattered reads are needed. Heights and grid cells are in units of the picture's width, heights
relative to the reference plane z = 0. Grid row i has its centre at y = (H − i − 0.5) · cell_y: rows down, y up.
"""

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from bench.btf import Array
from bench.data.materials import brdf
from bench.data.materials.maps import Maps
from bench.inputs.errors import InputError
from bench.machine.threads import cores

if TYPE_CHECKING:
    from bench.codec import Progress

DESCRIBED = {
    "values": "linear Rec. 709, f_r * cos(theta_i) * visibility, mean over the sub-points, no clamp",
    "reference_plane": "mean height",
    "transport": "direct light, self-shadowing; no inter-reflection",
    "reflectance": "GGX (Walter 2007, Burley 2012), Smith (Heitz 2014), Schlick Fresnel, coupled Lambert",
}
RENDERER_VERSION = 3  # increment when a value changes; part of the key of every cached rendering
SUB_POINTS = 2  # along each side of a texel


class HeightField:
    """A periodic surface of heights that rays are traced against."""

    def __init__(self, height: Array, aspect: float):
        """`height` is (H, W) float32; `aspect` is the picture's physical height over its width."""
        above_lowest = height - height.min()  # exactly 0 on a plane of any height
        self.height = np.ascontiguousarray(above_lowest - above_lowest.mean(dtype=np.float64), np.float32)
        self.shape = self.height.shape
        self.cell = (aspect / self.shape[0], 1 / self.shape[1])  # the sides of a grid cell along y and x
        self.bottom, self.top = float(self.height.min()), float(self.height.max())
        # Doubled so that any shift of the whole field is one view of this array; one more row and column for the
        # further neighbours of a bilinear read.
        self._tiled = np.pad(np.tile(self.height, (2, 2)), ((0, 1), (0, 1)), mode="wrap")

    def normals(self) -> Array:
        """Unit normals (3, H, W) float32 from central differences."""
        h = self.height.astype(np.float64)
        # Toward +x the column grows, toward +y the row falls.
        dx = (np.roll(h, -1, 1) - np.roll(h, 1, 1)) / (2 * self.cell[1])
        dy = (np.roll(h, 1, 0) - np.roll(h, -1, 0)) / (2 * self.cell[0])
        normal = np.stack([-dx, -dy, np.ones_like(h)])
        return (normal / np.linalg.norm(normal, axis=0)).astype(np.float32)

    def trace(self, wo: Array, stride: tuple[int, int]) -> Array:
        """Height (H / stride, W / stride) above the reference plane at which each ray first meets the surface.

        Ray (i, j) passes through the centre of the block (i, j) of stride grid cells on the reference plane, along `wo`
        (unit, z > 0). It meets the surface at that centre + z · `offset(wo)`.
        """
        cells_per_height = self.offset(wo)
        # So many steps down from the highest to the lowest place that no step moves the rays by more than one grid cell
        # along either axis.
        steps = math.ceil((self.top - self.bottom) * max(map(abs, cells_per_height)))
        if steps == 0:  # a plane, or rays along the normal: each ray meets the surface at its own place
            return self._heights_at((0.0, 0.0), 0.0, stride)
        step = (self.top - self.bottom) / steps
        # How far the surface lies above the rays, at the last height and at this one.
        above_before = self._heights_at(cells_per_height, self.top, stride) - np.float32(self.top)
        hit_height = np.full(above_before.shape, self.bottom, np.float32)  # of rays that meet nothing before
        is_open = np.ones(above_before.shape, bool)  # for rays that have not met the surface yet
        for k in range(1, steps + 1):
            z = self.top - k * step
            above = self._heights_at(cells_per_height, z, stride) - np.float32(z)
            crossed = np.flatnonzero((above >= 0) & is_open)
            if len(crossed):
                # It went from b ≤ 0 to a ≥ 0; on a line between both it is 0 at this height. Both may be 0.
                a, b = above.flat[crossed], above_before.flat[crossed]
                hit_height.flat[crossed] = z + step * a / np.maximum(a - b, 1e-20)
                is_open.flat[crossed] = False
                if not is_open.any():
                    break
            above_before = above
        return hit_height

    def offset(self, direction: Array) -> tuple[float, float]:
        """(rows, columns) of the grid that a ray along `direction`, z > 0, crosses as it rises by one unit."""
        x, y, z = (float(v) for v in direction)
        return -y / z / self.cell[0], x / z / self.cell[1]  # rows go down, y goes up

    def _heights_at(self, cells_per_height: tuple[float, float], z: float, stride: tuple[int, int]) -> Array:
        """Bilinear heights (H / stride, W / stride) of the surface at the places where the rays are at height z.

        `cells_per_height` is the `offset` of the rays, (rows, columns).
        """
        H, W = self.shape
        row_stride, col_stride = stride
        # The place of the first ray, which passes through the centre of its block of cells at z = 0.
        row = ((row_stride - 1) / 2 + z * cells_per_height[0]) % H
        col = ((col_stride - 1) / 2 + z * cells_per_height[1]) % W
        # Its whole cell (a remainder that is rounded up to H is row 0), and the fractions that weight the four cells
        # around. They are the same for all rays.
        top, left = int(row) % H, int(col) % W
        down, right = np.float32(row % 1), np.float32(col % 1)

        def corner(rows: int, cols: int) -> Array:
            """The heights of the cells so many rows below and columns to the right of those that hold the places."""
            first_row, first_col = top + rows, left + cols
            return self._tiled[first_row : first_row + H : row_stride, first_col : first_col + W : col_stride]

        heights = corner(0, 0) * ((1 - down) * (1 - right))
        # The other three corners; a weight of 0 is skipped to save time.
        for rows, cols, weight in ((0, 1, (1 - down) * right), (1, 0, down * (1 - right)), (1, 1, down * right)):
            if weight:
                heights += corner(rows, cols) * weight
        return heights

    def visibility(self, wi: Array) -> Array:
        """The share (H, W) of the light from `wi` that reaches each grid point, uint8 with 255 for all of it.

        The horizon, the maximum over j ≥ 1 of h(p + jδ) − jc with c the rise of the light's ray over a step δ of one
        cell, is built by doubling: M₂ₙ(p) = max(Mₙ(p), Mₙ(p + nδ) − nc). A shadow's edge is a ramp of half a step.
        """
        rows_per_height, cols_per_height = self.offset(wi)
        cells_per_height = max(abs(rows_per_height), abs(cols_per_height))  # along the axis that it crosses faster
        # A ray that climbs over the whole relief within one cell meets nothing.
        if (self.top - self.bottom) * cells_per_height <= 1:
            return np.full(self.shape, 255, np.uint8)
        rise = 1 / cells_per_height  # c
        rows, cols = rows_per_height * rise, cols_per_height * rise  # δ
        horizon = shift(self.height, rows, cols) - np.float32(rise)  # M₁
        steps = 1  # n, the number of steps that the horizon covers
        while steps * rise < self.top - self.bottom:
            further = shift(horizon, steps * rows, steps * cols) - np.float32(steps * rise)
            np.maximum(horizon, further, out=horizon)
            steps *= 2
        # 1 for a point above its horizon, and down to 0 for one that lies half a step's rise below it.
        share = 1 + (self.height - horizon) / np.float32(0.5 * rise)
        return (np.clip(share, 0, 1) * 255 + 0.5).astype(np.uint8)  # rounded to the nearest code


def shift(field: Array, rows: float, cols: float) -> Array:
    """The periodic field (H, W) read at (row + rows, column + cols), bilinear."""
    return _shift_axis(_shift_axis(field, rows, 0), cols, 1)


def _shift_axis(field: Array, distance: float, axis: int) -> Array:
    """The periodic field (H, W) read `distance` cells further along one axis, linear between cells."""
    whole = math.floor(distance)
    shifted = np.roll(field, -whole, axis)
    if distance == whole:  # nothing to blend
        return shifted
    shifted_one_more = np.roll(field, -whole - 1, axis)
    shifted += (shifted_one_more - shifted) * np.float32(distance - whole)
    return shifted


@dataclass(frozen=True)
class View:
    """The visible points of one view: a point for each sub-point of each texel, in the order (s, H · W), with s the
    number of sub-points of a texel."""

    wo: Array  # (3,) to the camera
    points: brdf.Points
    frame: Array  # (3 components x y z, 3 axes t b n, s, H · W)
    cell: Array  # (s, H · W) index of the grid cell nearest to each point; visibility is looked up there


class Renderer:
    """A surface prepared to render pictures of `size` (H, W), each texel the mean of sub_points² fixed sub-points.

    The maps are resized to a working grid that is a whole multiple of the sub-points; shrink maps that are much finer
    than the sub-points first (`Maps.resized`), or their detail is aliased.
    """

    def __init__(self, maps: Maps, size: tuple[int, int], sub_points: int = SUB_POINTS):
        """Resize the maps to the grid. `InputError` if `size` or `sub_points`, those along a texel's side, are below
        1."""
        if min(*size, sub_points) < 1:
            raise InputError(f"size and sub_points must be at least 1, not {size}, {sub_points}")
        self.size = size
        self.sub_points = sub_points
        self.stride = _stride(maps, size, sub_points)
        self.aspect = _aspect(maps)
        maps = _on_grid(maps, size, sub_points)
        self.field = HeightField(maps.height, self.aspect)
        # All values of a surface point in one table, (H' · W', 12), so that one read fetches a whole point: normal (3),
        # base colour (3), roughness, metalness, specular, anisotropy, and cosine and sine of twice the angle.
        normal = self.field.normals() if maps.normal is None else np.moveaxis(maps.normal, -1, 0)
        base = np.moveaxis(maps.base_colour, -1, 0)
        rest = [maps.roughness, maps.metalness, maps.specular, maps.anisotropy]
        direction = [np.cos(2 * maps.angle), np.sin(2 * maps.angle)]
        self.table = np.stack([*normal, *base, *rest, *direction], -1).reshape(-1, 12).astype(np.float32)

    def view(self, wo: Array) -> View:
        """Trace the rays toward `wo` (3,) and look up the surface where they meet it."""
        # 1. Where each ray meets the surface.
        z = self.field.trace(wo, self.stride)
        start_rows = _block_centres(z.shape[0], self.stride[0])  # on the reference plane
        start_cols = _block_centres(z.shape[1], self.stride[1])
        rows_per_height, cols_per_height = self.field.offset(wo)
        # Fractional grid row and column where the ray of each sub-point ends.
        row = self._by_sub_point(start_rows[:, None] + z * np.float32(rows_per_height))
        col = self._by_sub_point(start_cols[None, :] + z * np.float32(cols_per_height))
        # 2. The surface there.
        sampled = _bilinear(self.table, self.field.shape, row, col)  # its columns are those of `table`
        normal = sampled[:3]
        normal = normal / np.sqrt((normal * normal).sum(0))
        # 3. The frame, whose tangent is the direction in which highlights are stretched.
        angle = 0.5 * np.arctan2(sampled[11], sampled[10])
        stretch = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)])  # in the reference plane
        tangent = stretch - normal * (stretch * normal).sum(0)  # the same direction, dropped onto the surface
        tangent /= np.sqrt(np.maximum((tangent * tangent).sum(0), 1e-12))  # 0 if the stretch is along the normal
        bitangent = np.cross(normal, tangent, axis=0)
        frame = np.stack([tangent, bitangent, normal], 1)
        surface = {
            "base": sampled[3:6],
            "roughness": sampled[6],
            "metalness": sampled[7],
            "specular": sampled[8],
            "anisotropy": sampled[9],
        }
        # 4. The grid cell nearest to each point.
        H, W = self.field.shape
        nearest_row = np.floor(row + 0.5).astype(np.intp) % H
        nearest_col = np.floor(col + 0.5).astype(np.intp) % W
        cell = nearest_row * W + nearest_col
        return View(wo, brdf.points(_project(frame, wo), surface), frame, cell)

    def _by_sub_point(self, picture: Array) -> Array:
        """One value for each ray, from the order in the picture (H · s, W · s) to sub-points and texels (s², H · W).

        Here s is `sub_points`, those along a side of a texel.
        """
        H, W = self.size
        s = self.sub_points
        return picture.reshape(H, s, W, s).transpose(1, 3, 0, 2).reshape(s * s, H * W)

    def slice(self, view: View, wi: Array, visibility: Array) -> Array:
        """The picture (H, W, 3) float32 of one pair: linear Rec. 709, f_r · cos θ_i · V.

        `wi` is the light's direction (3,). `visibility`, V, are the uint8 codes of `HeightField.visibility` for it.
        """
        points = view.points
        cos_between = np.float32(view.wo @ wi)
        diffuse, specular = brdf.reflect(points, _project(view.frame, wi), cos_between)
        # V from its codes, divided by the number of sub-points, so that the sum below is a mean.
        visible = visibility.take(view.cell) * np.float32(1 / 255 / self.sub_points**2)
        diffuse *= visible
        specular *= visible
        colour = points.diffuse * diffuse  # (3, s, H · W)
        colour += brdf.specular_colour(points, cos_between) * specular
        mean = colour.sum(1)
        return np.moveaxis(mean, 0, -1).reshape(*self.size, 3)


def _stride(maps: Maps, size: tuple[int, int], sub_points: int) -> tuple[int, int]:
    """Grid cells (down, across) from one ray to the next: as many as make the grid at least as fine as the maps."""
    return math.ceil(maps.shape[0] / (size[0] * sub_points)), math.ceil(maps.shape[1] / (size[1] * sub_points))


def _aspect(maps: Maps) -> float:
    """The physical height over the width of the maps' picture."""
    return maps.shape[0] / maps.shape[1] if maps.aspect is None else maps.aspect


def _on_grid(maps: Maps, size: tuple[int, int], sub_points: int) -> Maps:
    """The maps resized to the renderer's grid."""
    rows, cols = _stride(maps, size, sub_points)
    return maps.resized((size[0] * sub_points * rows, size[1] * sub_points * cols))


def half_a_texel_further(maps: Maps, size: tuple[int, int], sub_points: int) -> Maps:
    """Maps whose rendering of `size` (H, W) shows in each texel what lies around its lower right corner.

    They are those of the renderer's grid, moved by half a texel of the picture. This is exact: half a texel is a whole
    number of cells, as `sub_points` is even.
    """
    rows, cols = _stride(maps, size, sub_points)
    # The proportion stays that of the maps as they came: the grid's may be rounded.
    moved = _on_grid(maps, size, sub_points).rolled(-rows * sub_points // 2, -cols * sub_points // 2)
    return replace(moved, aspect=_aspect(maps))


def _block_centres(count: int, stride: int) -> Array:
    """The centres (count,) float32 of blocks of `stride` cells, in cells from the centre of the first cell."""
    return np.arange(count, dtype=np.float32) * stride + (stride - 1) / 2


def _project(frame: Array, direction: Array) -> tuple[Array, Array, Array]:
    """The components of a direction (3,) along t, b and n of each point's frame, see `View.frame`; each (s, H · W)."""
    x, y, z = np.asarray(direction, np.float32)
    # frame[0] holds the x components of all three axes, so the sum is the scalar product with each axis.
    t, b, n = frame[0] * x + frame[1] * y + frame[2] * z
    return t, b, n


def _bilinear(table: Array, shape: tuple[int, ...], row: Array, col: Array) -> Array:
    """The values (C, ...) at fractional grid places `row`, `col` (...), blended from the four grid points around each.

    The grid of `shape` (H, W) is periodic; `table` (H · W, C) holds the values of its points row by row. The result is
    contiguous.
    """
    H, W = shape
    whole_row, whole_col = np.floor(row), np.floor(col)
    row_fraction, col_fraction = (row - whole_row)[..., None], (col - whole_col)[..., None]
    top, left = whole_row.astype(np.intp) % H, whole_col.astype(np.intp) % W
    right = (left + 1) % W
    # Where the grid row above each place, and the one below it, begin in the table.
    above = top * W
    below = (top + 1) % H * W
    blend = table.take(above + left, axis=0)
    blend += (table.take(above + right, axis=0) - blend) * col_fraction
    blend_below = table.take(below + left, axis=0)
    blend_below += (table.take(below + right, axis=0) - blend_below) * col_fraction
    blend += (blend_below - blend) * row_fraction
    return np.ascontiguousarray(np.moveaxis(blend, -1, 0))


def render(
    maps: Maps,
    wo: ArrayLike,
    wi: ArrayLike,
    size: tuple[int, int],
    sub_points: int = SUB_POINTS,
    out: Array | None = None,
    show: "Progress | None" = None,
    label: str = "rendering",
) -> Array:
    """Slices (N, H, W, 3) of a surface at N pairs, linear Rec. 709: each view is traced once and each light cast once.

    `wo` and `wi` are (N, 3) unit vectors with z > 0; `size` is (H, W), rows at the top first. `out`, any float array of
    that shape such as a memory map, receives the slices, with infinity for highlights that its type cannot hold; None
    makes a float32 array. `show(label, done, N)` is called after each view. Uses one thread for each processor that
    this process may use; the result does not depend on their number. `InputError` for other directions or sizes.
    """
    wo = np.asarray(wo, np.float32).reshape(-1, 3)
    wi = np.asarray(wi, np.float32).reshape(-1, 3)
    if wo.shape != wi.shape or not (np.minimum(wo[:, 2], wi[:, 2]) > 0).all():
        raise InputError("wo and wi must have the same number of directions, all above the horizon (z > 0)")
    renderer = Renderer(maps, size, sub_points)
    result = np.empty((len(wo), *size, 3), np.float32) if out is None else out
    # The different views and lights, for each pair the index of its view and light, and how many pairs each light has.
    views, view_of = np.unique(wo, axis=0, return_inverse=True)
    lights, light_of, pair_counts = np.unique(wi, axis=0, return_inverse=True, return_counts=True)
    view_of, light_of = view_of.reshape(-1), light_of.reshape(-1)  # only numpy 2.0 gives (N, 1)

    def shared_visibility(index: int) -> Array | None:
        """The visibility of a light that several pairs share; None for that of a single pair, see `fill_view`."""
        return renderer.field.visibility(lights[index]) if pair_counts[index] > 1 else None

    def fill_view(index: int) -> int:
        """Write all slices of one view into `result`; returns their number."""
        view = renderer.view(views[index])
        pairs = np.flatnonzero(view_of == index)
        for pair in pairs:
            visibility = visibilities[light_of[pair]]
            if visibility is None:  # no other pair needs it, so it is found here and not kept
                visibility = renderer.field.visibility(wi[pair])
            picture = renderer.slice(view, wi[pair], visibility)
            with np.errstate(over="ignore"):  # `out` may hold halves
                result[pair] = picture
        return len(pairs)

    # First the visibilities of all lights, which the views then share.
    done = 0
    with ThreadPoolExecutor(cores()) as pool:
        visibilities = list(pool.map(shared_visibility, range(len(lights))))
        for count in pool.map(fill_view, range(len(views))):
            done += count
            if show:
                show(label, done, len(wo))
    return result
