"""Reads a scene from a TOML file, without Mitsuba: one surface, a camera or a path of cameras, and lights.

description = "what it shows"

[camera]
width = 1280                     # of the picture, in pixels
height = 720
fov_deg = 45                     # horizontal
position = [0.0, -0.6, 0.5]      # scene units, z up unless `up` says otherwise
target = [0.0, 0.0, 0.0]
up = [0.0, 0.0, 1.0]
path = [{position = [...], target = [...]}, ...]   # one frame each, instead of `position` and `target`

[surface]
shape = "plane"                  # or "sphere", or "drape": a cloth over a ball, laid on the plane
centre = [0.0, 0.0, 0.0]
normal = [0.0, 0.0, 1.0]         # of a plane; of a sphere, its axis
up = [0.0, 1.0, 0.0]             # where the top of the texture points, on a plane
size = [1.0, 1.0]                # of a plane or a drape, along the texture's u and v; a sphere has radius = 0.5 instead
repeat = [4, 4]                  # times that the longer side of the texture fits along u and v; along its shorter
                                 # side the texture repeats more often, so that texels stay square

[[lights]]
kind = "directional"             # toward = [x, y, z], irradiance = [r, g, b] on a plane that faces it
[[lights]]
kind = "point"                   # position = [x, y, z], intensity = [r, g, b]: irradiance at distance 1
[[lights]]
kind = "environment"             # radiance = [r, g, b] from all around, and lamps = [{toward = [x, y, z],
                                 # cone_deg = 10, radiance = [r, g, b]}, ...]: discs of that half angle
samples = 8                      # of an environment, at each point
"""

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np

from bench.demand.demand import unit
from bench.inputs.errors import InputError, did_you_mean
from bench.inputs.settings import Range, fields, parse_toml, read_toml, shipped_toml, table

MOST = 100_000  # samples of lights over all frames
Length = Annotated[float, Range(1e-6, 1e6)]  # in scene units; beyond these limits, rounding is too coarse
Place = Annotated[float, Range(-1e6, 1e6)]
Vector = tuple[Place, Place, Place]
Power = Annotated[float, Range(0, 1e9)]
Colour = tuple[Power, Power, Power]
Pixels = Annotated[int, Range(1, 65_536)]


@dataclass(frozen=True)
class Camera:
    """A pinhole camera; its first pixel is at the top left."""

    position: Vector
    target: Vector
    up: Vector = (0.0, 0.0, 1.0)
    fov_deg: Annotated[float, Range(0.01, 179)] = 45.0
    width: Pixels = 1280
    height: Pixels = 720

    def __post_init__(self) -> None:
        """Raise `InputError` for a camera without a view, or without an up direction in its picture."""
        if not _span_a_plane(np.subtract(self.target, self.position), self.up):
            raise InputError("target - position and up must not be parallel, and neither may be 0")

    def ahead(self, column: np.ndarray, row: np.ndarray) -> np.ndarray:
        """Unit directions (n, 3) through points of the picture, `column` and `row` (n,) in pixels from its top left."""
        forward = unit(np.subtract(self.target, self.position))
        # Two unit axes of the picture, which is at distance 1.
        right = unit(np.cross(forward, self.up))
        down = np.cross(forward, right)
        # The side of a pixel at that distance.
        pixel = 2 * np.tan(np.radians(self.fov_deg) / 2) / self.width
        x = (column - self.width / 2) * pixel
        y = (row - self.height / 2) * pixel
        return unit(forward + x[:, None] * right + y[:, None] * down)


def _span_a_plane(one: Any, other: Any) -> bool:
    """Whether two vectors span a plane: neither is 0, and they are not parallel, up to rounding."""
    return bool(np.linalg.norm(np.cross(one, other)) > 1e-9 * np.linalg.norm(one) * np.linalg.norm(other))


@dataclass(frozen=True)
class Surface:
    """A plane, a sphere or a cloth over a ball, with a texture that repeats."""

    shape: Literal["plane", "sphere", "drape"] = "plane"
    centre: Vector = (0.0, 0.0, 0.0)
    normal: Vector = (0.0, 0.0, 1.0)
    up: Vector = (0.0, 1.0, 0.0)
    size: tuple[Length, Length] = (1.0, 1.0)
    radius: Length = 0.5
    repeat: tuple[Length, Length] = (1.0, 1.0)

    def __post_init__(self) -> None:
        """Raise `InputError` for a surface whose texture would have no top, or for a field of another shape."""
        if not _span_a_plane(self.normal, self.up):
            raise InputError("normal and up must not be parallel, and neither may be 0")
        if self.shape == "sphere" and self.size != Surface.size:
            raise InputError("a sphere has a radius, no size")
        if self.shape != "sphere" and self.radius != Surface.radius:
            raise InputError(f"a {self.shape} has a size, no radius")


@dataclass(frozen=True)
class Lamp:
    """A disc of light in an environment; `cone_deg` is its half angle in degrees."""

    toward: Vector
    cone_deg: Annotated[float, Range(0.01, 180)]
    radiance: Colour

    def __post_init__(self) -> None:
        """Raise `InputError` for a lamp without a direction."""
        _check_toward(self.toward)


@dataclass(frozen=True)
class LightSource:
    """A light; its fields depend on its kind, see the module."""

    kind: str
    toward: Vector | None = None
    irradiance: Colour | None = None
    position: Vector | None = None
    intensity: Colour | None = None
    radiance: Colour | None = None
    lamps: tuple[Lamp, ...] = ()
    samples: Annotated[int, Range(1, MOST)] = 8

    @property
    def samples_a_point(self) -> int:
        """How many directions it is sampled in at each point: those of an environment, and one of any other light."""
        return self.samples if self.kind == "environment" else 1

    def __post_init__(self) -> None:
        """Raise `InputError` for an unknown kind, a field that it lacks or does not have, a direction of 0, or a black
        environment."""
        needs = {"directional": ("toward", "irradiance"), "point": ("position", "intensity"), "environment": ()}
        if self.kind not in needs:
            raise InputError(f"there is no kind {self.kind!r}{did_you_mean(self.kind, needs)}")
        for name in needs[self.kind]:
            if getattr(self, name) is None:
                raise InputError(f"a {self.kind} light needs {name}")
        may_have = ("radiance", "lamps", "samples") if self.kind == "environment" else ()
        takes = {"kind", *needs[self.kind], *may_have}
        for field in dataclasses.fields(self):
            if field.name not in takes and getattr(self, field.name) != field.default:
                raise InputError(f"a light of kind {self.kind} has no {field.name}")
        if self.toward:
            _check_toward(self.toward)
        colours = [self.radiance or (0.0, 0.0, 0.0), *(lamp.radiance for lamp in self.lamps)]
        lit = any(any(colour) for colour in colours)
        if self.kind == "environment" and not lit:
            raise InputError("an environment needs radiance, lamps, or both, and not all may be 0")


def _check_toward(toward: Vector) -> None:
    """Raise `InputError` for a vector of 0, which is no direction."""
    if not any(toward):
        raise InputError("toward must not be 0")


@dataclass(frozen=True)
class Scene:
    """A scene as its TOML file describes it; see the module."""

    name: str
    cameras: tuple[Camera, ...]
    lights: tuple[LightSource, ...]
    surface: Surface = Surface()
    description: str = ""

    def __post_init__(self) -> None:
        """Raise `InputError` if frames differ in size, or if the lights of all would take too many samples."""
        sizes = {(camera.width, camera.height) for camera in self.cameras}
        if len(sizes) > 1:
            raise InputError("camera: all frames of a path have one width and one height: give them outside the path")
        # Each lamp takes time at each sample of its environment.
        samples = sum(light.samples_a_point * (1 + len(light.lamps)) for light in self.lights)
        if samples * len(self.cameras) > MOST:
            asked = f"{len(self.cameras):,} frames of {samples:,} samples of lights"
            raise InputError(f"lights: {asked}: the limit is {MOST:,} in all: give fewer samples, lamps or frames")


def shipped() -> dict[str, str]:
    """The text of each scene that ships with the suite, by name."""
    return shipped_toml("bench.demand.scenes")


def named_scene(name: str) -> Scene:
    """A scene that ships with the suite, by name, or the scene of a TOML file. `InputError` if there is neither."""
    texts = shipped()
    if name in texts:
        return parse_scene(name, texts[name])
    if not Path(name).suffix:
        raise InputError(f"scene {name!r} does not ship with the suite{did_you_mean(name, texts)}")
    return read_scene(Path(name))


def read_scene(path: Path) -> Scene:
    """The scene of a TOML file. `InputError` names the file and the wrong key."""
    text = read_toml(path)
    try:
        return parse_scene(path.stem, text)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def parse_scene(name: str, text: str) -> Scene:
    """The scene of a TOML text. `InputError` names the wrong key."""
    content = parse_toml("scene", text)
    for key in ("camera", "lights"):
        if not content.get(key):
            raise InputError(f"{key} is missing")
    cameras = tuple(table("camera", Camera, frame) for frame in _frames(content.pop("camera")))
    return Scene(name, cameras, **fields("scene", Scene, content, without=("name", "cameras")))


def _frames(camera: Any) -> list[Any]:
    """The tables of the cameras: one, or one for each entry of its path. `InputError` for a path without any."""
    if not isinstance(camera, dict) or "path" not in camera:
        return [camera]
    shared = {key: value for key, value in camera.items() if key != "path"}
    path = camera["path"]
    if not isinstance(path, list) or not path:
        raise InputError("camera: path has no frame: it must be a list of tables")
    frames = []
    for frame in path:
        if isinstance(frame, dict):  # anything else is refused where the camera is made
            frame = shared | frame
        frames.append(frame)
    return frames
