"""Casts the rays of a scene that was read from a text, see `bench.demand.scene`, at its plane, sphere or drape."""

from typing import NamedTuple

import numpy as np

from bench.btf import Array
from bench.demand.collect import Light, Points
from bench.demand.demand import unit
from bench.demand.scene import Lamp, LightSource, Scene, Surface

STEPS, HALVINGS = 96, 24  # steps of the search for a drape along a ray
DRAPE_HALF = 1.1  # half the side of the cloth in the units of `_height`
DRAPE_LOW, DRAPE_HIGH = -0.35, 0.6  # bounds of all heights


class TextScene:
    """A scene of one surface that answers what its camera sees, and which light reaches it."""

    def __init__(self, scene: Scene):
        """Count what the scene has: frames, pixels, and samples of light at a point."""
        self.scene = scene
        self.name = scene.name
        self.frames = len(scene.cameras)
        self.picture = (scene.cameras[0].height, scene.cameras[0].width)
        self.samples = sum(light.samples_a_point for light in scene.lights)

    def cast(self, frame: int, col: Array, row: Array) -> Points:
        """The points of the surface that the rays of a frame hit, through the places `col`, `row` (n,), in pixels.

        The `pixel` of a point is the number of its ray.
        """
        camera = self.scene.cameras[frame]
        ahead = camera.ahead(col, row)
        eye = np.asarray(camera.position, np.float64)
        far = distance(self.scene.surface, eye, ahead)
        hit = np.flatnonzero(np.isfinite(far))
        position = eye + ahead[hit] * far[hit, None]
        lie = texture(self.scene.surface, position)
        inside = lie.inside  # a ray may meet a plane beyond the surface's edge
        hit = hit[inside]
        return Points(
            pixel=hit,  # the numbers of the rays that hit; one is cast through each cell of the frame
            uv=lie.uv[inside],
            position=position[inside],
            normal=lie.normal[inside],
            dp_du=lie.dp_du[inside],
            dp_dv=lie.dp_dv[inside],
            eye=np.broadcast_to(eye, (len(hit), 3)),
            ahead_x=camera.ahead(col[hit] + 1, row[hit]),
            ahead_y=camera.ahead(col[hit], row[hit] + 1),
        )

    def lights(self, points: Points, rng: np.random.Generator) -> list[Light]:
        """Every light that may reach the points; for an environment, a few samples at each."""
        lights: list[Light] = []
        for source in self.scene.lights:
            lights += _light_of(source, points, rng)
        return lights


def _light_of(source: LightSource, points: Points, rng: np.random.Generator) -> list[Light]:
    """The light of one source at each point, shadows left aside: once, or in the samples of an environment."""
    ones = np.ones((len(points), 1))
    match source.kind:
        case "directional":
            return [Light(ones * unit(np.asarray(source.toward)), ones * np.asarray(source.irradiance))]
        case "point":
            offset = np.asarray(source.position) - points.position
            square = np.maximum((offset**2).sum(1, keepdims=True), 1e-12)  # not 0, in case a point is at the light
            return [Light(offset / np.sqrt(square), np.asarray(source.intensity) / square)]
        case _:  # an environment
            return [_environment_sample(source, points, rng) for _ in range(source.samples)]


def _environment_sample(source: LightSource, points: Points, rng: np.random.Generator) -> Light:
    """One sample of an environment at each point: the sphere, or one of the lamps, in proportion to their power.

    Its direction is drawn evenly from the chosen lamp, and its irradiance is divided by the chance of the lamp, so the
    samples of a point add up to the light of the whole environment on average.
    """
    toward = np.zeros((len(points), 3))
    irradiance = np.zeros((len(points), 3))
    # The light from all around is a lamp of half angle 180°, toward whatever direction; black if there is none.
    lamps = [Lamp((0.0, 0.0, 1.0), 180.0, source.radiance or (0.0, 0.0, 0.0)), *source.lamps]
    angles = np.radians([lamp.cone_deg for lamp in lamps])
    solid = 2 * np.pi * (1 - np.cos(angles))  # solid angle of each lamp
    power = solid * [np.mean(lamp.radiance) for lamp in lamps]
    shares = power / power.sum()
    chosen = rng.choice(len(lamps), len(points), p=shares)
    for index, lamp in enumerate(lamps):
        lit = np.flatnonzero(chosen == index)  # the points that this lamp lights in this sample
        if len(lit):
            toward[lit] = _in_cone(unit(np.asarray(lamp.toward)), angles[index], len(lit), rng)
            irradiance[lit] = np.asarray(lamp.radiance) * solid[index] / shares[index]
    return Light(toward, irradiance / source.samples)


def _in_cone(axis: Array, angle: float, count: int, rng: np.random.Generator) -> Array:
    """Directions (count, 3) uniform in solid angle, within an angle, in radians, of an axis (3,)."""
    # On a sphere equal steps of the cosine hold equal areas, so the cosine is drawn uniformly.
    cos = 1 - rng.random(count) * (1 - np.cos(angle))
    phi = rng.random(count) * 2 * np.pi
    sin = np.sqrt(np.maximum(1 - cos**2, 0))
    other_than_axis = [0.0, 0.0, 1.0] if abs(axis[2]) < 0.9 else [1.0, 0.0, 0.0]
    across = unit(np.cross(axis, other_than_axis))
    other = np.cross(axis, across)
    return cos[:, None] * axis + (sin * np.cos(phi))[:, None] * across + (sin * np.sin(phi))[:, None] * other


def distance(surface: Surface, eye: Array, ahead: Array) -> Array:
    """The distance (n,) from an eye (3,) to a surface along unit directions (n, 3), infinite if they miss it."""
    if surface.shape == "drape":
        return _drape_distance(surface, eye, ahead)
    offset = np.asarray(surface.centre) - eye
    with np.errstate(divide="ignore", invalid="ignore"):
        if surface.shape == "plane":
            _, _, normal = _axes(surface)
            along = offset @ normal / (ahead @ normal)
        else:
            # |along · ahead − offset| = radius is quadratic in `along`. The smaller root is the nearer of the two
            # crossings, for a camera outside; it is NaN where the ray misses the sphere.
            half = ahead @ offset
            along = half - np.sqrt(half**2 - (offset @ offset - surface.radius**2))
    return np.where(along > 0, along, np.inf)


class Texture(NamedTuple):
    """How the texture lies at points of a surface. A unit of uv is the longer side of the texture."""

    uv: Array  # (n, 2), not wrapped
    normal: Array  # (n, 3) unit
    dp_du: Array  # (n, 3) derivative of the position by u
    dp_dv: Array  # (n, 3) derivative of the position by v
    inside: Array  # (n,) whether a point lies within the edges of the surface


def texture(surface: Surface, position: Array) -> Texture:
    """How the texture lies at points of a surface, given their positions (n, 3)."""
    axes = np.stack(_axes(surface), 1)  # (3, 3), an axis a column
    local = (position - np.asarray(surface.centre)) @ axes
    if surface.shape == "sphere":
        return _sphere_texture(surface, position, local)
    size, repeat = np.asarray(surface.size), np.asarray(surface.repeat)
    uv = (local[:, :2] / size + 0.5) * repeat
    inside = (np.abs(local[:, :2]) <= size / 2).all(1)
    slope = np.zeros((len(position), 2)) if surface.shape == "plane" else _slopes(surface, local[:, :2])
    one = np.ones(len(position))
    nothing = np.zeros(len(position))
    # Tangents that go one scene unit along an axis of the plane, and rise by the slope.
    along_u = np.stack([one, nothing, slope[:, 0]], 1) @ axes.T
    along_v = np.stack([nothing, one, slope[:, 1]], 1) @ axes.T
    normal = unit(np.cross(along_u, along_v))
    per_u, per_v = size / repeat  # scene units in a unit of u, and of v
    return Texture(uv, normal, along_u * per_u, along_v * per_v, inside)


def _axes(surface: Surface) -> tuple[Array, Array, Array]:
    """Unit vectors along +u, +v and the normal of a plane; for a sphere, two across its axis, and the axis."""
    normal = unit(np.asarray(surface.normal, np.float64))
    x = unit(np.cross(surface.up, normal))
    return x, np.cross(normal, x), normal


def _sphere_texture(surface: Surface, position: Array, local: Array) -> Texture:
    """What `texture` gives, for points of a sphere: u goes east, v north.

    `position` (n, 3) are the points in the scene, and `local` (n, 3) the same from the centre, along the sphere's axes.
    """
    x, y, _ = _axes(surface)
    repeat = np.asarray(surface.repeat)
    east_angle = np.arctan2(local[:, 1], local[:, 0])
    height = local[:, 2] / surface.radius
    north_angle = np.arcsin(np.clip(height, -1, 1))
    uv = np.stack([east_angle / (2 * np.pi) + 0.5, north_angle / np.pi + 0.5], 1) * repeat
    east = -np.sin(east_angle)[:, None] * x + np.cos(east_angle)[:, None] * y
    normal = unit(position - np.asarray(surface.centre))
    north = np.cross(normal, east)
    # The poles have no direction of u, so a disc of a thousandth of the radius around them is left out.
    ring = np.hypot(local[:, 0], local[:, 1]) / surface.radius
    per_u = 2 * np.pi * surface.radius * ring / repeat[0]  # (n,) scene units in a unit of u
    dp_dv = north * np.pi * surface.radius / repeat[1]
    return Texture(uv, normal, east * per_u[:, None], dp_dv, ring > 1e-3)


def _height(place: Array) -> Array:
    """The height (…) of a drape at places (…, 2) within ± `DRAPE_HALF`: it lies over a ball and falls in folds."""
    x, y = place[..., 0], place[..., 1]
    square = x * x + y * y
    radius = np.sqrt(square)
    ball = 0.75 * np.exp(-2.2 * square)
    # Seven waves around the middle. They begin flat there, where the angle jumps, and fade out.
    folds = 0.11 * np.sin(7 * np.arctan2(y, x)) * np.minimum(1, square) * np.exp(-0.4 * radius)
    return np.asarray(ball + folds - 0.25)


def _unit_of(surface: Surface) -> Array:
    """Scene units (3,) of one unit of `_height` along u, v and the normal."""
    across = np.asarray(surface.size) / (2 * DRAPE_HALF)
    return np.array([*across, across.mean()])


def _slopes(surface: Surface, place: Array) -> Array:
    """The slopes (n, 2) of the cloth along u and v at places (n, 2) of the plane."""
    scale = _unit_of(surface)
    middle = place / scale[:2]  # in the units of `_height`
    step = 1e-5
    rise = [_height(middle + move) - _height(middle - move) for move in step * np.eye(2)]  # central differences
    return np.stack(rise, 1) / (2 * step) * scale[2] / scale[:2]  # a ratio of scene units


def _drape_box(start: Array, way: Array) -> tuple[Array, Array]:
    """Where rays from a start (3,) along ways (n, 3) enter and leave the box around the cloth: (n,) each, as multiples
    of the way. Start and ways are in the units of `_height`. A ray that misses the box leaves it before it enters."""
    low = np.array([-DRAPE_HALF, -DRAPE_HALF, DRAPE_LOW])
    high = np.array([DRAPE_HALF, DRAPE_HALF, DRAPE_HIGH])
    # A ray is inside once it has passed the nearer plane of each of the three pairs, and until it passes the first of
    # the farther ones. It is infinitely far from planes that it runs along, or NaN if it lies in one.
    with np.errstate(divide="ignore", invalid="ignore"):
        sides = np.stack([(low - start) / way, (high - start) / way])  # (2, n, 3)
    enter = np.maximum(np.nanmax(sides.min(0), 1), 0)
    leave = np.nanmin(sides.max(0), 1)
    return enter, leave


def _drape_distance(surface: Surface, eye: Array, ahead: Array) -> Array:
    """As `distance`, of a cloth: the first crossing of each ray. The eye may be on either side of the cloth."""
    axes = np.stack(_axes(surface), 1)  # (3, 3), an axis a column
    scale = _unit_of(surface)
    # Rays in the units of `_height`; distances along them stay in scene units.
    start = (eye - np.asarray(surface.centre)) @ axes / scale
    way = ahead @ axes / scale
    enter, leave = _drape_box(start, way)
    distances = np.full(len(way), np.inf)
    meeting = np.flatnonzero(enter < leave)  # the rays that meet the box
    distances[meeting] = _first_crossing(start, way[meeting], enter[meeting], leave[meeting])
    return distances


def _first_crossing(start: Array, way: Array, enter: Array, leave: Array) -> Array:
    """Where rays from a start (3,) along ways (n, 3) first cross the cloth between two multiples of the way, (n,) each;
    infinite for a ray that does not. Start and ways are in the units of `_height`."""

    def above(along: Array) -> Array:
        """Whether each ray is above the cloth at a multiple of its way, (n,) each."""
        place = start + way * along[:, None]
        return np.asarray(place[:, 2] > _height(place[:, :2]))

    first = above(enter)
    step = (leave - enter) / STEPS
    # The step at whose end a ray is first on the other side than at the start; infinite if it stays on one side.
    crossed = np.full(len(way), np.inf)
    for number in range(STEPS, 0, -1):  # from far to near, so that the nearest crossing is kept
        crossed[above(enter + step * number) != first] = number
    hit = np.isfinite(crossed)
    near = np.where(hit, enter + step * (crossed - 1), 0)  # 0 for rays that cross nowhere, which are not used
    far = np.where(hit, enter + step * crossed, 0)
    for _ in range(HALVINGS):
        middle = (near + far) / 2
        is_before_crossing = above(middle) == first
        near = np.where(is_before_crossing, middle, near)
        far = np.where(is_before_crossing, far, middle)
    return np.where(hit, far, np.inf)
