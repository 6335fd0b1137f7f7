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
shape = "plane"                  # or "sphere"
centre = [0.0, 0.0, 0.0]
normal = [0.0, 0.0, 1.0]         # of a plane; of a sphere, its axis
up = [0.0, 1.0, 0.0]             # where the top of the texture points, on a plane
size = [1.0, 1.0]                # of a plane, along the texture's u and v; of a sphere: radius = 0.5
repeat = [4, 4]                  # periods of the texture over the whole surface, along u and v

[[lights]]
kind = "directional"             # toward = [x, y, z], irradiance = [r, g, b] on a plane that faces it
[[lights]]
kind = "point"                   # position = [x, y, z], intensity = [r, g, b]: irradiance at distance 1
[[lights]]
kind = "environment"             # radiance = [r, g, b] from all around, and lamps = [{toward = [x, y, z],
                                 # cone_deg = 10, radiance = [r, g, b]}, ...]: discs of that half angle
samples = 8                      # of an environment, at each point
"""

import tomllib
from dataclasses import dataclass, field, fields
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from bench.demand.demand import unit
from bench.errors import InputError, did_you_mean

Vector = tuple[float, float, float]


@dataclass(frozen=True)
class Camera:
    """A pinhole camera; its first pixel is at the top left."""

    position: Vector
    target: Vector
    up: Vector = (0.0, 0.0, 1.0)
    fov_deg: float = 45.0
    width: int = 1280
    height: int = 720

    def __post_init__(self) -> None:
        across = np.cross(np.subtract(self.target, self.position), self.up)
        if not np.linalg.norm(across) > 1e-9:
            raise InputError("camera: target - position and up must not be parallel, nor either of them 0")
        if not (0 < self.fov_deg < 180 and min(self.width, self.height) >= 1):
            raise InputError("camera: fov_deg must lie between 0 and 180, width and height be at least 1")

    def ahead(self, column: np.ndarray, row: np.ndarray) -> np.ndarray:
        """Unit directions (n, 3) through points of the picture, in pixels from its top left corner."""
        forward = unit(np.subtract(self.target, self.position))
        right = unit(np.cross(forward, self.up))
        down = np.cross(forward, right)
        pixel = 2 * np.tan(np.radians(self.fov_deg) / 2) / self.width
        x, y = (column - self.width / 2) * pixel, (row - self.height / 2) * pixel
        return unit(forward + x[:, None] * right + y[:, None] * down)


@dataclass(frozen=True)
class Surface:
    """A plane or a sphere with a texture that repeats."""

    shape: str = "plane"
    centre: Vector = (0.0, 0.0, 0.0)
    normal: Vector = (0.0, 0.0, 1.0)
    up: Vector = (0.0, 1.0, 0.0)
    size: tuple[float, float] = (1.0, 1.0)
    radius: float = 0.5
    repeat: tuple[float, float] = (1.0, 1.0)

    def __post_init__(self) -> None:
        if self.shape not in ("plane", "sphere"):
            raise InputError(f"surface: shape {self.shape!r} is neither 'plane' nor 'sphere'")
        if not np.linalg.norm(np.cross(self.normal, self.up)) > 1e-9:
            raise InputError("surface: normal and up must not be parallel, nor either of them 0")
        if not min(*self.size, self.radius, *self.repeat) > 0:
            raise InputError("surface: size, radius and repeat must be above 0")


@dataclass(frozen=True)
class LightSource:
    """A light; which fields it needs is its kind's, see the module."""

    kind: str
    toward: Vector | None = None
    irradiance: Vector | None = None
    position: Vector | None = None
    intensity: Vector | None = None
    radiance: Vector | None = None
    lamps: list[dict[str, Any]] = field(default_factory=list)
    samples: int = 8

    def __post_init__(self) -> None:
        needs = {"directional": ("toward", "irradiance"), "point": ("position", "intensity"), "environment": ()}
        if self.kind not in needs:
            raise InputError(f"lights: no kind {self.kind!r}{did_you_mean(self.kind, needs)}")
        for name in needs[self.kind]:
            if getattr(self, name) is None:
                raise InputError(f"lights: a {self.kind} light needs {name}")
        if self.kind == "environment" and not (self.lamps or self.radiance):
            raise InputError("lights: an environment needs radiance, lamps, or both")
        for lamp in self.lamps:
            if set(lamp) != {"toward", "cone_deg", "radiance"}:
                raise InputError("lights: a lamp of an environment has toward, cone_deg and radiance, and no more")


@dataclass(frozen=True)
class Scene:
    """See the module."""

    name: str
    cameras: tuple[Camera, ...]
    surface: Surface
    lights: tuple[LightSource, ...]
    description: str = ""


def shipped() -> dict[str, str]:
    """The text of each scene that ships with the suite, by name."""
    found = (file for file in files("bench.demand.scenes").iterdir() if file.name.endswith(".toml"))
    return {file.name.removesuffix(".toml"): file.read_text(encoding="utf-8") for file in sorted(found, key=str)}


def named_scene(name: str) -> Scene:
    """A scene that ships with the suite, by name, or the one of a TOML file."""
    texts = shipped()
    if name in texts:
        return parse_scene(name, texts[name])
    if not Path(name).suffix:
        raise InputError(f"scene {name!r} does not ship with the suite{did_you_mean(name, texts)}")
    return read_scene(Path(name))


def read_scene(path: Path) -> Scene:
    """The scene of a TOML file. `InputError` names the file and the key that is wrong."""
    try:
        return parse_scene(path.stem, path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read ({error})") from error
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def parse_scene(name: str, text: str) -> Scene:
    """The scene of a TOML text."""
    try:
        says = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"not TOML ({error})") from error
    _known("scene", says, {"description", "camera", "surface", "lights"})
    for key in ("camera", "lights"):
        if not says.get(key):
            raise InputError(f"{key} is missing")
    return Scene(
        name,
        _cameras(dict(says["camera"])),
        _made("surface", Surface, says.get("surface", {})),
        tuple(_made("lights", LightSource, light) for light in says["lights"]),
        str(says.get("description", "")),
    )


def _cameras(says: dict[str, Any]) -> tuple[Camera, ...]:
    path = says.pop("path", None)
    if path is None:
        return (_made("camera", Camera, says),)
    if not path:
        raise InputError("camera: path names no frame")
    return tuple(_made("camera", Camera, says | frame) for frame in path)


def _made(where: str, kind: Any, says: dict[str, Any]) -> Any:
    """An object of a dataclass, from a TOML table: vectors become tuples of finite numbers."""
    if not isinstance(says, dict):
        raise InputError(f"{where} must be a table")
    _known(where, says, {f.name for f in fields(kind)})
    default = {f.name: f.default for f in fields(kind)}
    values = {name: _value(where, name, value, default[name]) for name, value in says.items()}
    try:
        return kind(**values)
    except TypeError as error:
        raise InputError(f"{where}: {str(error).split('()')[-1].strip()}") from error


def _value(where: str, name: str, value: Any, default: Any) -> Any:
    if name in ("lamps",):
        return [{k: _value(where, f"lamps.{k}", v, None) for k, v in lamp.items()} for lamp in value]
    if isinstance(value, list):
        length = 2 if name in ("size", "repeat") else 3
        numbers = all(isinstance(v, int | float) and np.isfinite(v) for v in value)
        if len(value) != length or not numbers:
            raise InputError(f"{where}: {name} must be {length} numbers, not {value!r}")
        return tuple(float(v) for v in value)
    if isinstance(default, str) or name == "kind":
        if not isinstance(value, str):
            raise InputError(f"{where}: {name} must be a word, not {value!r}")
        return value
    if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
        raise InputError(f"{where}: {name} must be a number, not {value!r}")
    return value


def _known(where: str, says: dict[str, Any], known: set[str]) -> None:
    for key in says:
        if key not in known:
            raise InputError(f"{where}: no key {key!r}{did_you_mean(key, known)}")
