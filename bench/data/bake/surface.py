"""Reads the maps of a folder as a surface to render: decodes, orients and resizes them for the bake.

The *code* of a texel is its stored number as a fraction of white. Albedo is decoded from sRGB; the codes of every other
map are used directly. A *role* is what a file is for, such as `albedo` or `packed` (`bench.data.bake.naming`). Pictures
are shrunk by area averages to the *working grid*, which has `SUB_POINTS` map texels along each side of a texel of the
bake, or as many as the maps have, if these are fewer. Normals are averaged as vectors and renormalised.

Normals that lean against the slopes, n ∝ (−∂h/∂x, −∂h/∂y, 1), agree with a displacement. Both possible mistakes change
signs: an inverted displacement (dark is high) flips both axes, a normal map with green downwards (DirectX) flips only
y. So the sign along x decides on the displacement, and then the sign along y on the normal map.
"""

import logging
from dataclasses import dataclass, field

import numpy as np

from bench.btf import Array
from bench.data.bake.naming import MapFiles
from bench.data.materials.maps import Maps, resize, resize_angle
from bench.data.readers.files import FolderFiles
from bench.data.readers.pictures import colour_note, picture_format, picture_size, read_alpha, read_picture
from bench.inputs.errors import InputError
from bench.metrics.display import encode_srgb

SUB_POINTS = 4  # points along each side of a texel; docs/baking.md compares 2 and 8
COMPARED = 256  # longest side at which normals and displacement are compared, for any size of the bake
CLEAR = 0.2  # from this correlation on, the maps decide instead of their names; maps of one asset reach 0.6 to 0.9
DEFAULT_DEPTH = 0.02  # of the relief, in widths of the picture
DEFAULT_ROUGHNESS = 0.5
RED, GREEN, BLUE, ALPHA = range(4)
# Where a map of one number a texel may come from: role of the file, channel, whether it is inverted, and all this in
# words, "" for a map of its own. The first of which the folder has the file is used.
_SOURCES = {
    "roughness": [
        ("roughness", RED, False, ""),
        ("smoothness", RED, True, "inverted"),  # a grey picture: no channel is worth telling
        ("packed", GREEN, False, "green"),
        ("metallic_smoothness", ALPHA, True, "alpha, inverted"),
    ],
    "metalness": [
        ("metalness", RED, False, ""),
        ("packed", BLUE, False, "blue"),
        ("metallic_smoothness", RED, False, "red"),
    ],
}
log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Surface:
    """A periodic surface ready to bake."""

    name: str
    shape: tuple[int, int]  # (H, W) of the bake; `maps` may be finer
    maps: Maps
    full_shape: tuple[int, int]  # (H, W) of the albedo in its file
    notes: dict[str, str] = field(default_factory=dict)  # map, or name of an unused picture → how it was used, in words


def read_surface(map_files: MapFiles, size: int, depth: float | None = None) -> Surface:
    """The surface of a folder's maps for a bake whose longer side has `size` texels; square map texels stay square.

    `depth` is the height of code 1 (white) over code 0 (black) of the displacement, in units of the picture's width. By
    default its slopes fit the normal map best; without a normal map it is 0.02. Raises `InputError` that names the file
    if pictures cannot be read, are no such maps or differ in proportion, and if `size` is below 1 or the depth is not
    between 0 and 1. Warns of pictures that may be maps but are not used.
    """
    if depth is not None and not 0 <= depth <= 1:
        raise InputError(f"depth must be between 0 and 1 widths of the picture, not {depth:g}")
    _warn_of_doubts(map_files)
    reader = _Reader(map_files, size)
    roughness = reader.channel("roughness", DEFAULT_ROUGHNESS)
    metalness = reader.channel("metalness", 0.0)
    normal, height = _relief(reader, depth)
    if normal is not None:
        # Shrinking lost the variance of the normals: α² grows by (1 − |n̄|) / |n̄| (Toksvig 2005), with |n̄| the length
        # of a mean normal, here at least 0.1, so that the quotient stays finite. α is roughness², so α² is roughness⁴.
        length = np.clip(np.linalg.norm(normal, axis=-1), 0.1, 1)
        alpha_squared = roughness**4 + (1 - length) / length
        roughness = np.minimum(alpha_squared**0.25, 1)
        normal = _unit(normal)
    anisotropy, angle = _anisotropy(reader)
    relief = 0.0 if height is None else height  # flat without a displacement
    albedo = reader.shrunk(reader.albedo)
    maps = Maps(relief, albedo, roughness, metalness, anisotropy=anisotropy, angle=angle, normal=normal)
    unused = {name: f"not used: {why}" for name, why in map_files.unused.items()}
    return Surface(map_files.folder.resolve().name, reader.shape, maps, reader.full_shape, reader.notes | unused)


def _warn_of_doubts(map_files: MapFiles) -> None:
    """Warn of pictures that may be maps but are not used, and of a folder without normals and displacement."""
    for name in map_files.doubtful:
        remedy = "name it like NAME_roughness.png, or give bake --map ROLE=FILE"
        log.warning("%s: not used, %s: %s", map_files.folder / name, map_files.unused[name], remedy)
    if not {"normal_gl", "normal_dx", "normal", "displacement", "depth"} & set(map_files.files):
        log.warning("%s: no normals and no displacement are recognised: the surface is flat", map_files.folder)


class _Reader:
    """Reads the maps of one folder at full size, and shrinks them to the working grid.

    `notes` (map → its file and how it is used, in words) grow as maps are read.
    """

    def __init__(self, map_files: MapFiles, size: int):
        """Read the albedo, whose shape all maps must have in proportion; `size` is that of `read_surface`.

        `InputError` for a size below 1, or an albedo outside [0, 1].
        """
        if size < 1:
            raise InputError(f"size must be at least 1, not {size}")
        self.files = FolderFiles(map_files.folder)
        self.roles = map_files.files  # role → file
        # Files of more than one map, and inverted ones, are listed under the maps that are taken from them.
        listed_elsewhere = ("packed", "metallic_smoothness", "smoothness")
        self.notes = {role: file for role, file in self.roles.items() if role not in listed_elsewhere}
        name = self.roles["albedo"]
        self.albedo = read_picture(self.files, name)
        conversion = colour_note(self.files, name)
        if conversion:
            self.notes["albedo"] += f": {conversion}"
        if self.albedo.min() < 0 or self.albedo.max() > 1:
            raise InputError(f"{self.files.label(name)}: an albedo must lie in [0, 1]: scale it")
        height, width = self.albedo.shape[:2]
        self.full_shape = (height, width)
        self.shape = _fitted_shape(self.full_shape, size)
        self.grid = self.limited_shape(SUB_POINTS * size)  # one map texel per sub-point, so no detail is skipped

    def limited_shape(self, longest: int) -> tuple[int, int]:
        """The maps' own shape (H, W), smaller in proportion if its longer side exceeds `longest`."""
        return _fitted_shape(self.full_shape, min(longest, max(self.full_shape)))

    def shrunk(self, picture: Array) -> Array:
        """A picture (H, W, ...) averaged to the working grid; as it is if it has that size, as small maps have."""
        return resize(picture, self.grid)

    def codes(self, role: str) -> Array | None:
        """A map that is not a colour, (H, W, 3) at full size: codes as fractions of white, EXR and `.hdr` as stored.

        None if no file has the role. `InputError` if its proportion is not that of the albedo.
        """
        if role not in self.roles:
            return None
        name = self.roles[role]
        height, width = picture_size(self.files, name)
        albedo_height, albedo_width = self.full_shape
        # Sizes are rounded to pixels, so proportions may differ a little.
        if abs(height * albedo_width / (width * albedo_height) - 1) > 0.01:
            other = f"the {albedo_width} x {albedo_height} of {self.files.label(self.roles['albedo'])}"
            fault = f"{width} x {height} pixels have another proportion than {other}"
            raise InputError(f"{self.files.label(name)}: {fault}: give both the same")
        picture = read_picture(self.files, name, is_colour=False)
        if self.is_stored(role):
            return picture
        return encode_srgb(picture).astype(np.float32)  # the codes again, which `read_picture` decoded

    def is_stored(self, role: str) -> bool:
        """Whether a map holds values instead of codes: EXR and `.hdr`."""
        return self.kind(role) in ("exr", "hdr")

    def kind(self, role: str) -> str | None:
        """The format of a map's file, which the folder must have: `jpeg`, `png`, `exr`, `hdr`, or None for others."""
        return picture_format(self.files.head(self.roles[role], 8))

    def channel(self, name: str, default: float) -> Array | float:
        """The map `name` of one number a texel, "roughness" or "metalness", on the working grid, in [0, 1].

        It comes from the first of its sources that the folder has; without any, it is the number `default`.
        """
        for role, channel, is_inverted, words in _SOURCES[name]:
            picture = self.codes(role)
            if picture is None:
                continue
            if channel == ALPHA:  # which `codes` leaves out
                values = read_alpha(self.files, self.roles[role])
            else:
                values = picture[..., channel]
            if words:  # a map of its own is already in the notes
                self.notes[name] = f"{self.roles[role]} ({words})"
            if is_inverted:
                values = 1 - values
            return np.clip(self.shrunk(values), 0, 1)
        self.notes[name] = f"{default:g} (no map)"
        return default


def _fitted_shape(shape: tuple[int, int], longest: int) -> tuple[int, int]:
    """The (H, W) with the proportion of `shape` (H, W) whose longer side is `longest`; each side is at least 1."""
    height, width = shape
    largest = max(shape)
    return max(1, round(height * longest / largest)), max(1, round(width * longest / largest))


def _relief(reader: _Reader, depth: float | None) -> tuple[Array | None, Array | None]:
    """Mean normals (H, W, 3) and displacement (H, W) in widths of the picture; None for each without a map.

    A mean normal is the shorter the more the normals vary within its texel. `depth` is that of `read_surface`.
    """
    # 1. Both maps at full size, as their codes say; a role is "" where there is no file.
    normal_role = _first_role(reader, ("normal_gl", "normal_dx", "normal"))
    height_role = _first_role(reader, ("displacement", "depth"))
    normal = _normals(reader, normal_role)
    picture = reader.codes(height_role)
    height = None if picture is None else picture[..., 0]
    # 2. Which way is up, by comparing them.
    correlations = Agreement()  # nothing to compare, unless there are both
    if normal is not None and height is not None:
        compared_shape = reader.limited_shape(COMPARED)
        correlations = agreement(resize(normal, compared_shape), resize(height, compared_shape))
    is_inverted, is_green_down = correlations.verdict(is_depth_by_name=height_role == "depth", normal_role=normal_role)
    # 3. Both the right way up, on the working grid.
    if normal is not None:
        green = "down (DX)" if is_green_down else "up (GL)"
        reader.notes[normal_role] += f": green {green}, {correlations.evidence(normal_role)}"
        if is_green_down:
            normal[..., 1] *= -1
        normal = reader.shrunk(normal)
    if height is not None:
        height = _displacement(reader, height_role, height, is_inverted, depth, correlations.depth)
    return normal, height


def _first_role(reader: _Reader, roles: tuple[str, ...]) -> str:
    """The first of some roles that the folder has a file for; "" if it has none."""
    return next((role for role in roles if role in reader.roles), "")


def _displacement(
    reader: _Reader, role: str, codes: Array, is_inverted: bool, user_depth: float | None, fitted_depth: float | None
) -> Array:
    """The displacement on the working grid, in widths of the picture, of a map's codes (H, W); inverted: dark is high.

    The depth, the height of code 1 over code 0, is the user's if given, else the one by which the slopes fit the
    normals best, else the default. Warns where the unit of stored heights is unknown. `InputError` if the depth is
    above 1.
    """
    label = reader.files.label(reader.roles[role])
    lowest, extent = 0.0, 1.0
    if reader.is_stored(role):
        lowest, extent = _range_of_unit(codes, fitted_depth)
    heights = (codes - np.float32(lowest)) / np.float32(extent)
    if user_depth is not None:
        depth, origin = user_depth, ""
    elif fitted_depth is not None:
        depth, origin = fitted_depth * extent, ", fitted to the normal map"  # the same relief, of heights up to 1
    else:
        depth, origin = DEFAULT_DEPTH, ""
        if reader.is_stored(role):
            relief = f"the relief is taken as {depth * float(np.ptp(heights)):.4f} of the width"
            fault = f"heights from {codes.min():g} to {codes.max():g} of unknown unit"
            log.warning("%s: %s: %s: give --depth", label, fault, relief)
    if depth > 1:
        raise InputError(f"{label}: by the normals its relief is {depth:.3g} widths deep: give --depth, from 0 to 1")
    reader.notes[role] += f": {'dark' if is_inverted else 'bright'} is high, depth {depth:.4f} of the width{origin}"
    return reader.shrunk(heights) * np.float32(-depth if is_inverted else depth)


def _range_of_unit(heights: Array, fitted_depth: float | None) -> tuple[float, float]:
    """The least of stored heights (H, W) and their extent, which bring any unit to [0, 1]; 0 and 1 if they lie there.

    A unit above one width of the picture, by `fitted_depth`, counts as any unit: heights then are tiny numbers.
    """
    lowest, highest = float(heights.min()), float(heights.max())
    is_large_unit = fitted_depth is not None and fitted_depth > 1
    if highest > lowest and (lowest < 0 or highest > 1 or is_large_unit):
        return lowest, highest - lowest
    return 0.0, 1.0


def _normals(reader: _Reader, role: str) -> Array | None:
    """Unit normals (H, W, 3) as a map's codes say, with y still negated if its green points down; None without a map.

    `InputError` for normals that are not of tangent space.
    """
    codes = reader.codes(role)
    if codes is None:
        return None
    normal = 2 * codes - 1  # codes from 0 to 1 stand for components from −1 to 1
    if reader.is_stored(role) and _is_signed(codes):
        normal = codes  # components as they are, not encoded
        reader.notes[role] += " (stored from -1 to 1)"
    if reader.kind(role) == "png":  # JPEG cannot hold the codes of flat exactly
        normal[_drawn_flat(codes), :2] = 0
    # In tangent space normals point away from the surface, toward +z, which is blue.
    if normal[..., 2].mean() < 0.3:
        fault = "its blue is too dark for a tangent-space normal map: bake it in tangent space"
        raise InputError(f"{reader.files.label(reader.roles[role])}: {fault}")
    return _unit(normal)


def _is_signed(values: Array) -> bool:
    """Whether stored values (H, W, 3) are the normals' own, from −1 to 1, and not (n + 1) / 2.

    Their own have negative values. Only a map that is nearly flat may have none; then the lengths tell, which are 1.
    """
    if values.min() < -0.01:  # lossy compression leaves noise below 0
        return True
    # How far the lengths are from 1, on average, in either form.
    off_as_stored = np.abs(np.linalg.norm(values, axis=-1) - 1).mean()
    off_decoded = np.abs(np.linalg.norm(2 * values - 1, axis=-1) - 1).mean()
    return bool(off_as_stored < 0.02 and off_as_stored < off_decoded)


def _drawn_flat(codes: Array) -> Array:
    """The mask (H, W) of texels that an 8-bit map means as flat although no code is 1/2.

    An exporter writes (128, 128, 255), or (127, 127, 255), wherever the surface is flat. Such a code is flat where it
    holds most of the texels within half a code of flat. In a scan the four pairs of 127 and 128 are about as frequent,
    and mean what they say. JPEG cannot hold these colours exactly.
    """
    scaled = codes[..., :2] * 255
    eight_bits = np.rint(scaled)
    if np.abs(eight_bits - scaled).max() > 1e-3:  # 16 bits have a code close enough to 1/2
        return np.zeros(codes.shape[:2], bool)
    nearly_flat = np.isin(eight_bits, (127, 128)).all(-1)
    for code in (127, 128):
        flat = (eight_bits == code).all(-1)
        if 2 * flat.sum() > nearly_flat.sum():
            return flat
    return np.zeros(codes.shape[:2], bool)


def _unit(normal: Array) -> Array:
    """Normals (H, W, 3) at length 1."""
    return normal / np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-6)


def _anisotropy(reader: _Reader) -> tuple[Array | float, Array | float]:
    """Strength in [0, 1] and angle in radians, as in `Maps`, on the working grid; the number 0 without a map.

    A coloured map packs both (glTF KHR_materials_anisotropy: direction in red and green, strength in blue). A grey one
    is the strength; the angle then has a map of its own, where white is one turn counter-clockwise (Substance).
    """
    picture = reader.codes("anisotropy")
    if picture is None:
        return 0.0, 0.0
    is_coloured = np.ptp(picture, axis=-1).max() > 0.02  # somewhere the channels differ
    if is_coloured:
        x, y = 2 * picture[..., 0] - 1, 2 * picture[..., 1] - 1
        strength = np.clip(reader.shrunk(picture[..., 2]), 0, 1)
        return strength, resize_angle(np.arctan2(y, x), reader.grid)
    strength = np.clip(reader.shrunk(picture[..., 0]), 0, 1)
    turns = reader.codes("anisotropy_angle")
    if turns is None:
        return strength, 0.0
    return strength, resize_angle(2 * np.pi * turns[..., 0], reader.grid)


@dataclass(frozen=True)
class Agreement:
    """How well a normal map and a displacement agree: correlations of the slopes that each of them states.

    Correlations are in [−1, 1], and 0 if there is nothing to compare; a negative one means an axis that is flipped.
    """

    x: float = 0.0
    y: float = 0.0
    # The height of white over black, in widths of the picture, with which the slopes fit the normals best; None if the
    # correlations are unclear.
    depth: float | None = None

    def verdict(self, is_depth_by_name: bool, normal_role: str) -> tuple[bool, bool]:
        """Whether the displacement is inverted (dark is high), and whether the normal map's green points down.

        Where the correlations are unclear the names decide: `is_depth_by_name` is whether the displacement's name says
        depth (dark is high), and `normal_role` is the role by the normal map's name.
        """
        is_down_by_name = normal_role == "normal_dx"
        # Only an inverted displacement changes the sign of x. It changes that of y, too, and so does green that points
        # down: with both, y is positive again.
        if abs(self.x) >= CLEAR:
            is_inverted = self.x < 0
            is_green_down = is_down_by_name
            if abs(self.y) >= CLEAR:
                is_green_down = (self.y < 0) != is_inverted
            return is_inverted, is_green_down
        if abs(self.y) >= CLEAR and normal_role != "normal":  # ridges only along x: believe the normal map's name
            y_if_green_is_up = -self.y if is_down_by_name else self.y
            return y_if_green_is_up < 0, is_down_by_name
        return is_depth_by_name, is_down_by_name

    def evidence(self, normal_role: str) -> str:
        """The evidence for where green points, in words: the correlations, the normal map's name, or none."""
        if min(abs(self.x), abs(self.y)) >= CLEAR:
            return f"told by the displacement (r = {self.x:+.2f}, {self.y:+.2f})"
        return "assumed" if normal_role == "normal" else "by its name"


def agreement(normal: Array, height: Array) -> Agreement:
    """Compare unit normals (H, W, 3), taken with green up, with a displacement (H, W), taken with bright high.

    Both are periodic, with square texels and row 0 at the top.
    """
    cell = 1 / height.shape[1]
    # Toward +x the column grows, toward +y the row falls.
    slope_x = (np.roll(height, -1, 1) - np.roll(height, 1, 1)) / (2 * cell)
    slope_y = (np.roll(height, 1, 0) - np.roll(height, -1, 0)) / (2 * cell)
    # The slopes (H, W, 2) that the normals state: −n_x / n_z and −n_y / n_z, up to 10 for the steepest.
    stated = -normal[..., :2] / np.maximum(normal[..., 2:], 0.1)
    x = _correlation(stated[..., 0], slope_x)
    y = _correlation(stated[..., 1], slope_y)
    if max(abs(x), abs(y)) < CLEAR:
        return Agreement(x, y)
    # Least squares of stated = depth · slope over both axes; either sign may be wrong, so absolute values are added.
    products = abs((stated[..., 0] * slope_x).mean()) + abs((stated[..., 1] * slope_y).mean())
    squares = (slope_x**2 + slope_y**2).mean()
    return Agreement(x, y, float(products / squares))


def _correlation(first: Array, second: Array) -> float:
    """Pearson's correlation of two pictures (H, W); 0 if one of them is flat."""
    first, second = first - first.mean(), second - second.mean()
    deviations = np.sqrt((first * first).mean() * (second * second).mean())
    if deviations <= 1e-9:
        return 0.0
    return float((first * second).mean() / deviations)
