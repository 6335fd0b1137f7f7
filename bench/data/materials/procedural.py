"""Materials made of noise, waves and scattered points: woven and knitted ones, leather and metals.

Each class is a recipe: its fields are parameters, and `maps` makes the surface of them. Heights are in units of the
tile's width, other lengths too, unless a comment says what they count.

The building blocks of `maps` are periodic, all (size, size) float64 with row 0 at the top. Noise has unit deviation
(`smooth`), so a small factor before it, such as 0.06, is the deviation that it adds. A factor for a colour (size, size,
3) is one number a texel, so it gets a last axis for the channels: `[..., None]`. `np.clip` keeps a map in its range.
"""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.spatial import cKDTree

from bench.btf import Array
from bench.data.materials.maps import Maps
from bench.metrics.display import decode_srgb

Colour = tuple[float, float, float]  # sRGB codes


def grid(size: int) -> tuple[Array, Array]:
    """u and v in [0, 1] of every texel centre, (size, size) each; u to the right, v upwards."""
    centre = (np.arange(size) + 0.5) / size
    u, v = np.meshgrid(centre, 1 - centre)
    return u, v


def smooth(rng: np.random.Generator, size: int, sigma_v: float, sigma_u: float) -> Array:
    """Periodic white noise (size, size), drawn from `rng`, after a Gaussian filter, with zero mean and unit deviation.

    `sigma_v` is the filter's width from row to row, `sigma_u` along a row, as shares of the tile's side.
    """
    field = gaussian_filter(rng.normal(size=(size, size)), (sigma_v * size, sigma_u * size), mode="wrap")
    return (field - field.mean()) / field.std()


def distances_to_points(rng: np.random.Generator, size: int, cells: int, jitter: float) -> tuple[Array, Array]:
    """Distances, each (size, size), from every texel to the nearest and to the second nearest of cells² points.

    The tile is cut into cells × cells squares. Each has one point, moved from its middle at random, by up to `jitter`
    of a square along each axis. Distances are shares of the tile's side, and periodic.
    """
    corners = np.stack(np.meshgrid(np.arange(cells), np.arange(cells)), -1).reshape(-1, 2)
    moves = rng.uniform(-jitter, jitter, corners.shape)
    # A point pushed over the tile's border comes in again at the other side.
    points = (corners + 0.5 + moves) / cells % 1.0
    texels = np.stack(grid(size), -1)
    distances, _ = cKDTree(points, boxsize=1.0).query(texels, k=2)
    return distances[..., 0], distances[..., 1]


def normalised(picture: Array) -> Array:
    """The picture stretched to [0, 1]; its values may not all be equal."""
    return (picture - picture.min()) / np.ptp(picture)


def mix(first: Array, second: Array, weight: Array) -> Array:
    """The colours (H, W, 3) between two colours (3,): the first where the weight (H, W) is 0, the second at 1."""
    return first + (second - first) * weight[..., None]


def srgb(*codes: float) -> Array:
    """A colour of sRGB codes in [0, 255] as linear Rec. 709 (IEC 61966-2-1)."""
    return decode_srgb(np.array(codes) / 255)


@dataclass(frozen=True)
class Satin:
    """A warp-faced satin: each warp thread floats over four wefts and dips under the fifth, its neighbour two further.
    Fibres run along their thread with some twist, and highlights stretch across the fibres."""

    resolution: int = 256
    threads: int = 10  # warp threads and weft threads in a tile, a multiple of five
    height: float = 0.011  # height of a thread above the interlacing plane
    twist_deg: float = 12.0  # angle of the fibres to the axis of their thread
    roughness: float = 0.42
    anisotropy: float = 0.85
    warp_srgb: Colour = (150, 22, 48)
    weft_srgb: Colour = (214, 170, 84)

    def maps(self, seed: int) -> Maps:
        """At each texel the thread that rides higher shows, with its colour, fibres and twist."""
        rng = np.random.default_rng(seed)
        u, v = grid(self.resolution)
        # Warp threads run along v, side by side along u; weft threads the other way. Places are counted in threads.
        place_u, place_v = u * self.threads, v * self.threads
        warp_number, weft_number = np.floor(place_u).astype(int), np.floor(place_v).astype(int)
        # Where a warp thread dips, a weft thread rides over it: 3 is the inverse of 2 modulo 5.
        warp_top = self._axis_height(warp_number, place_v, 2) + _bulge(place_u)
        weft_top = -self._axis_height(weft_number, place_u, 3) + _bulge(place_v)
        is_warp = warp_top >= weft_top
        # Each thread has a tint of its own. Among all threads, those of the warp have the first numbers, those of the
        # weft the others.
        thread_number = np.where(is_warp, warp_number, weft_number + self.threads)
        tint = rng.normal(1, 0.06, 2 * self.threads)[thread_number]
        warp_fibres = smooth(rng, self.resolution, 0.05, 0.004)  # noise stretched along the thread
        weft_fibres = smooth(rng, self.resolution, 0.004, 0.05)  # which runs along u
        fibre = np.where(is_warp, warp_fibres, weft_fibres)
        colour = mix(srgb(*self.weft_srgb), srgb(*self.warp_srgb), is_warp.astype(float))
        colour = colour * (tint * (1 + 0.12 * fibre))[..., None]
        twist = np.radians(self.twist_deg) + 0.06 * fibre
        fibre_angle = np.where(is_warp, np.pi / 2, 0.0) + twist
        top = np.maximum(warp_top, weft_top)
        return Maps(
            height=self.height * (top + 0.05 * fibre),
            base_colour=np.clip(colour, 0, 1),
            roughness=np.clip(self.roughness + 0.04 * fibre, 0.2, 0.8),
            metalness=0.35,
            anisotropy=self.anisotropy,
            angle=fibre_angle + np.pi / 2,  # highlights stretch across the fibres
        )

    def _axis_height(self, thread: Array, along: Array, step: int) -> Array:
        """Height of the axis of the thread at each texel: +0.5 where it rides over the crossed threads, −0.5 in the
        middle of each crossed thread that it dips under, smooth between.

        `thread` is the thread's number, `along` the place on it, counted in crossed threads. Each thread dips `step`
        crossed threads further than its neighbour.
        """
        from_a_dip = along - 0.5 - step * thread
        # The distance to the nearest dip, counted in crossed threads; dips are five apart.
        distance = np.abs((from_a_dip + 2.5) % 5 - 2.5)
        dip = np.where(distance < 1, 0.5 + 0.5 * np.cos(np.pi * distance), 0)
        return 0.5 - dip


def _bulge(across: Array) -> Array:
    """The round cross-section of threads that are one unit of `across` wide: 0 at an edge and 1 in the middle."""
    x = 2 * (across % 1) - 1  # from −1 at one edge to 1 at the other
    return np.sqrt(np.maximum(1 - x * x, 0))


@dataclass(frozen=True)
class CableKnit:
    """One cable in a tile. Its relief is a seventh of the tile's width, so that at 75° it shifts by half the tile."""

    resolution: int = 256
    height: float = 0.14  # from the deepest gap to the top of the cable
    stitches: int = 10  # V stitches along a strand, rows of purl bumps on the ground
    bumps: int = 8  # purl bumps across the whole tile
    sway: float = 0.13  # how far a strand swings to each side
    radius: float = 0.15  # half the width of a strand
    yarn: float = 0.28  # relief of the yarns on a strand, as a share of the strand's
    roughness: float = 0.75
    colour_srgb: Colour = (226, 208, 172)

    def maps(self, seed: int) -> Maps:
        """The highest of the ground and the two strands shows at each texel; all have one colour, mottled and fuzzy."""
        rng = np.random.default_rng(seed)
        u, v = grid(self.resolution)
        ground = self._ground(u, v)
        strands = [self._strand(u, v, side) for side in (-1, 1)]
        layers = np.stack([ground, *strands])
        fuzz = smooth(rng, self.resolution, 0.004, 0.004)
        height = normalised(layers.max(0) + 0.008 * fuzz)
        tint = 1 + 0.05 * smooth(rng, self.resolution, 0.06, 0.06) + 0.05 * fuzz
        return Maps(
            height=self.height * height,
            base_colour=np.clip(srgb(*self.colour_srgb) * tint[..., None], 0, 1),
            roughness=self.roughness,
            specular=0.5,
        )

    def _strand(self, u: Array, v: Array, side: int) -> Array:
        """Heights (size, size) of a round strand that winds about the other, covered by V stitches. Outside its width
        they are −1, which is below everything else.

        `u` and `v` are the places of the texels, see `grid`; `side` is −1 or 1, one for each strand.
        """
        turn = 2 * np.pi * v
        centre = 0.5 + side * self.sway * np.sin(turn)
        lean = side * self.sway * 2 * np.pi * np.cos(turn)  # the slope of the centre, d centre / d v
        # 0 on the strand's axis, −1 and 1 at its edges; a leaning strand is wider along u.
        across = (u - centre) / (self.radius * np.sqrt(1 + lean * lean))
        body = np.sqrt(np.maximum(1 - across * across, 0))
        from_axis = np.abs(across)
        # The yarns of a stitch lie along lines that rise from the axis to both edges: a V.
        ridge = np.abs(np.cos(np.pi * (v * self.stitches - 0.9 * from_axis)))
        fade = np.sin(np.pi * np.clip(from_axis, 0, 1)) ** 0.5  # yarns end at the axis and at the edges
        yarn = self.yarn * (np.sqrt(ridge) * fade - 1)
        # The strand of side 1 is over the other where cos(turn) > 0, and under it elsewhere.
        height = 0.55 + 0.3 * side * np.cos(turn) + 0.6 * body + yarn
        return np.where(from_axis < 1, height, -1)

    def _ground(self, u: Array, v: Array) -> Array:
        """Heights (size, size) of rows of purl bumps, every other row shifted by half a bump.

        `u` and `v` are the places of the texels, see `grid`.
        """
        row = v * self.stitches
        column = u * self.bumps + 0.5 * (np.floor(row) % 2)
        x, y = 2 * (column % 1) - 1, 2 * (row % 1) - 1  # from −1 to 1 within a bump
        return 0.35 * np.sqrt(np.maximum(1 - 0.8 * x * x - 0.9 * y * y, 0))


@dataclass(frozen=True)
class Wicker:
    """Rods run along x, stakes along y. A rod passes over one stake and under the next; its neighbours do the other."""

    resolution: int = 256
    height: float = 0.09
    rods: int = 8  # in a tile; an even number, like the stakes
    stakes: int = 4
    roughness: float = 0.5
    willow_srgb: Colour = (182, 134, 78)
    bark_srgb: Colour = (96, 58, 30)

    def maps(self, seed: int) -> Maps:
        """At each texel the rod or the stake that is higher shows; each has its own share of bark."""
        rng = np.random.default_rng(seed)
        u, v = grid(self.resolution)
        rod, stake = np.floor(v * self.rods).astype(int), np.floor(u * self.stakes).astype(int)
        # Over one stake and under the next; the sign makes neighbouring rods do the other.
        sway = np.cos(np.pi * (u * self.stakes - 0.5)) * (-1.0) ** rod
        rod_top = 0.45 * sway + 0.5 * _cylinders(v * self.rods, 0.46)
        stake_top = 0.55 * _cylinders(u * self.stakes, 0.22)  # stakes are straight
        is_rod = rod_top >= stake_top
        top = np.maximum(rod_top, stake_top)
        rod_fibres = smooth(rng, self.resolution, 0.003, 0.08)  # noise stretched along the rod
        stake_fibres = smooth(rng, self.resolution, 0.08, 0.003)
        fibre = np.where(is_rod, rod_fibres, stake_fibres)
        piece_number = np.where(is_rod, rod, stake + self.rods)  # rods have the first numbers, stakes the others
        shade = rng.normal(0, 0.25, self.rods + self.stakes)[piece_number]
        bark = np.clip(0.35 + shade + 0.2 * fibre, 0, 1)
        colour = mix(srgb(*self.willow_srgb), srgb(*self.bark_srgb), bark)
        return Maps(
            height=self.height * (top + 0.02 * fibre),
            base_colour=np.clip(colour * (1 + 0.08 * fibre)[..., None], 0, 1),
            roughness=np.clip(self.roughness + 0.06 * fibre, 0.2, 1),
            anisotropy=0.3,
            angle=np.where(is_rod, np.pi / 2, 0.0),  # highlights stretch across the fibres
        )


def _cylinders(across: Array, half_width: float) -> Array:
    """The profile of a row of cylinders, one in each unit of `across`: 1 on top, 0 at the edges, −1 in the gaps.

    `half_width` is that of a cylinder, in units of `across`; at 1/2 they would touch.
    """
    x = (across % 1 - 0.5) / half_width
    return np.where(np.abs(x) < 1, np.sqrt(np.maximum(1 - x * x, 0)), -1.0)


@dataclass(frozen=True)
class Leather:
    """Pebbles are the cells of scattered points (Worley 1996): they rise with the distance from the borders."""

    resolution: int = 256
    height: float = 0.02
    cells: int = 10  # pebbles along a side
    crease: float = 0.9  # width of a crease, as a share of a pebble
    roughness: float = 0.38
    skin_srgb: Colour = (112, 58, 30)
    crease_srgb: Colour = (52, 24, 14)

    def maps(self, seed: int) -> Maps:
        """Coarse pebbles with finer ones on them; creases are darker and rougher, worn places lighter and smoother."""
        rng = np.random.default_rng(seed)
        coarse = self._pebbles(rng, self.cells, self.crease)
        fine = self._pebbles(rng, 3 * self.cells, crease=0.9)
        sag = smooth(rng, self.resolution, 0.1, 0.1)
        pores = smooth(rng, self.resolution, 0.005, 0.005)
        height = coarse * (0.85 + 0.08 * sag) + 0.15 * fine * coarse + 0.015 * pores
        wear = np.clip(0.5 + 0.25 * sag + 0.3 * (coarse - 0.6), 0, 1)
        colour = mix(srgb(*self.crease_srgb), srgb(*self.skin_srgb), np.clip(0.2 + 0.8 * coarse, 0, 1))
        return Maps(
            height=self.height * height,
            base_colour=np.clip(colour * (0.85 + 0.3 * wear)[..., None], 0, 1),
            roughness=np.clip(self.roughness + 0.2 * (1 - coarse) - 0.08 * wear, 0.05, 1),
        )

    def _pebbles(self, rng: np.random.Generator, cells: int, crease: float) -> Array:
        """Heights in [0, 1] of cells² pebbles: 0 on the border of two, rounded up to 1 inside.

        `crease` is the width of the slope, as a share of a pebble.
        """
        nearest, second = distances_to_points(rng, self.resolution, cells, jitter=0.42)
        # Both distances are equal on a border, so their difference grows from 0 there.
        inside = np.clip((second - nearest) * cells / crease, 0, 1)
        rounded = np.sqrt(1 - (1 - inside) ** 2)
        # Softens the sharp bottoms of the creases.
        return gaussian_filter(rounded, 0.007 * self.resolution, mode="wrap")


@dataclass(frozen=True)
class BrushedMetal:
    """Scratches are white noise stretched along x; they tilt the surface across, and change its roughness and tint."""

    resolution: int = 256
    height: float = 0.0012  # deviation of the scratches' depth
    roughness: float = 0.34
    anisotropy: float = 0.85
    metal_srgb: Colour = (222, 206, 184)

    def maps(self, seed: int) -> Maps:
        """Metal whose fibres, the scratches, run along x, so highlights stretch along y."""
        rng = np.random.default_rng(seed)
        # Short scratches and long ones.
        scratches = 0.7 * smooth(rng, self.resolution, 0.006, 0.12) + 0.5 * smooth(rng, self.resolution, 0.012, 0.4)
        shade = smooth(rng, self.resolution, 0.005, 0.2)
        wander = smooth(rng, self.resolution, 0.02, 0.1)  # of the scratches' direction
        return Maps(
            height=self.height * scratches,
            base_colour=np.clip(srgb(*self.metal_srgb) * (1 + 0.06 * shade)[..., None], 0, 1),
            roughness=np.clip(self.roughness + 0.08 * shade, 0.15, 0.8),
            metalness=1.0,
            anisotropy=self.anisotropy,
            angle=np.pi / 2 + 0.15 * wander,
        )


@dataclass(frozen=True)
class HammeredCopper:
    """Each dent is a bowl about one of many scattered points; the ridges between them catch the light in turn."""

    resolution: int = 256
    height: float = 0.018
    dents: int = 7  # along a side
    roughness: float = 0.34
    copper_srgb: Colour = (222, 148, 118)
    patina_srgb: Colour = (70, 116, 100)

    def maps(self, seed: int) -> Maps:
        """Copper that tarnishes toward the middle of each dent, where it is rougher and less of a metal."""
        rng = np.random.default_rng(seed)
        nearest, _ = distances_to_points(rng, self.resolution, self.dents, jitter=0.35)
        from_middle = nearest * self.dents  # of the dent, as a share of the mean width of a dent
        blotches = smooth(rng, self.resolution, 0.08, 0.08)
        grain = smooth(rng, self.resolution, 0.006, 0.006)
        patina = np.clip(1.1 - 1.6 * from_middle + 0.5 * blotches, 0, 1) * 0.6
        colour = mix(srgb(*self.copper_srgb), srgb(*self.patina_srgb), patina)
        return Maps(
            height=self.height * normalised(from_middle * from_middle + 0.01 * grain),
            base_colour=np.clip(colour, 0, 1),
            roughness=np.clip(self.roughness + 0.35 * patina + 0.03 * grain, 0.1, 1),
            metalness=1 - 0.8 * patina,
        )
