"""Renders still pictures of materials in a text scene, with the same rays and lights as its demand.

A text scene is one surface, cameras and lights, read from TOML.
"""

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bench.btf import BTF, Array
from bench.codec import Progress, silent
from bench.demand.collect import queries_of
from bench.demand.demand import Demand
from bench.demand.frame_scorer import truth
from bench.demand.scene import Colour, LightSource, Scene
from bench.demand.text_scene import TextScene
from bench.directions.hemisphere import from_degrees
from bench.files.atomic import replacing
from bench.files.exr import write_exr
from bench.inputs.errors import InputError, writable
from bench.material import Material
from bench.metrics.display import display_error, exposure_of, to_display
from bench.metrics.psnr import psnr

if TYPE_CHECKING:
    from PIL.Image import Image

RAYS = 65_536  # rays cast at once
SUFFIXES = (".png", ".exr")
CAPTION = 34  # pixels below a PNG, for two lines of text of up to 2/5 of it each
SMALLEST = 8  # of the text, in pixels; a caption that would need a smaller one is left out
GREY = (128, 128, 128, 255)  # of captions: read on a light page and on a dark one

Answers = Callable[[Demand], Array]  # the queries of a demand → linear radiance (n, 3)


def usual_lights(kind: str) -> tuple[LightSource, ...]:
    """Lights instead of a scene's own, all directional: one of the kind `sun`; of the kind `environment` another sun
    and six weaker lights, evenly spread around the surface's normal."""
    if kind == "sun":
        return (_directional(40, 120, (1.0, 1.0, 1.0)),)
    lights = [_directional(40, 120, (0.6, 0.58, 0.54))]
    for phi in range(0, 360, 120):  # a warm one and a cold one in turns
        lights.append(_directional(58, phi, (0.28, 0.25, 0.2)))
        lights.append(_directional(58, phi + 60, (0.1, 0.12, 0.16)))
    return tuple(lights)


def _directional(theta_deg: float, phi_deg: float, irradiance: Colour) -> LightSource:
    """A light from one direction, given by its angles in degrees."""
    x, y, z = from_degrees(theta_deg, phi_deg).tolist()
    return LightSource("directional", toward=(x, y, z), irradiance=irradiance)


def changed(scene: Scene, lights: str | None, tiling: float, width: int | None) -> Scene:
    """A scene with the `usual_lights` of a kind, its texture repeated `tiling` times as often, and pictures `width`
    pixels wide, of the same proportions. With None it keeps its own lights, or its width."""
    u, v = scene.surface.repeat
    surface = dataclasses.replace(scene.surface, repeat=(u * tiling, v * tiling))
    cameras = []
    for camera in scene.cameras:
        wide = width or camera.width
        high = max(1, round(camera.height * wide / camera.width))
        cameras.append(dataclasses.replace(camera, width=wide, height=high))
    sources = usual_lights(lights) if lights else scene.lights
    return dataclasses.replace(scene, cameras=tuple(cameras), surface=surface, lights=sources)


def of_material(material: Material) -> Answers:
    """The answers of a decoded material."""
    return lambda demand: material.query(*demand.queries(material.size))


def of_btf(btf: BTF) -> Answers:
    """The answers of a BTF itself, interpolated between its pairs, texels and levels of detail."""
    return lambda demand: truth(btf, demand)


def render(
    scene: Scene, sides: Sequence[Answers], frame: int = 0, rays: int = 2, seed: int = 0, show: Progress = silent
) -> Array:
    """The pictures (sides, H, W, 4) of one frame: linear RGB, and the share of the pixel that shows the surface.

    Each pixel is the mean of rays² rays through a regular grid in it; radiance beside the surface is 0. Surfaces cast
    no shadow on themselves. Raises `InputError` if no ray meets the surface.
    """
    caster = TextScene(scene)
    height, width = scene.cameras[frame].height, scene.cameras[frame].width
    rng = np.random.default_rng(seed)
    pictures = np.zeros((len(sides), height * width, 4))
    band = max(1, RAYS // (width * rays * rays))  # rows at once
    offsets = (np.arange(rays) + 0.5) / rays  # of the rays within a pixel, down and to the right
    for top in range(0, height, band):
        show("rendering", top, height)
        rows = np.arange(top, min(height, top + band))
        row, col, down, right = np.meshgrid(rows, np.arange(width), offsets, offsets, indexing="ij")
        points = caster.cast(frame, (col + right).ravel(), (row + down).ravel())
        if not len(points):
            continue
        pixel = (row * width + col).ravel()  # of each ray; `points.pixel` counts the rays of this band
        # Each ray that meets the surface adds its share to the pixel's alpha, of all sides alike.
        pictures[..., 3] += np.bincount(pixel[points.pixel], minlength=height * width) / rays**2
        queries: dict[str, Any] = queries_of(points, caster.lights(points, rng))
        queries["pixel"] = pixel[queries["pixel"]].astype(np.int32)  # so far it was the number of the ray
        demand = Demand(**queries, frames=(1, height, width))
        if not len(demand):  # nothing in this band is lit
            continue
        for side, answers in enumerate(sides):
            pictures[side, :, :3] += demand.pictures(answers(demand)).reshape(-1, 3) / rays**2
    show("rendering", height, height)
    if not pictures[..., 3].any():
        raise InputError(f"{scene.name}: no ray of the camera meets the surface: move the camera or the surface")
    return pictures.reshape(len(sides), height, width, 4)


def exposure_for(picture: Array) -> float:
    """The exposure of a picture (H, W, 4), from only the pixels that show nothing but the surface.

    `InputError` if there is none.
    """
    return exposure_of(picture[_covered(picture)][None, :, :3])


def _covered(picture: Array) -> Array:
    """Mask (H, W) of the pixels of a picture (H, W, 4) that show nothing but the surface. `InputError` if none does."""
    covered = picture[..., 3] > 0.999  # an alpha of 1, up to rounding
    if not covered.any():
        raise InputError("no pixel shows nothing but the surface: move the camera nearer, or make the picture larger")
    return np.asarray(covered)


def write(path: Path, picture: Array, exposure: float, captions: Sequence[str] = ()) -> None:
    """Write a picture (H, W, 4): linear floats, not exposed, as `.exr`; display-transformed 8 bits as `.png`. Pixels
    beside the surface are transparent. A PNG has the captions below, each under its share of the width, if they are
    legible there. Raises `InputError` for any other ending, and if the file cannot be written."""
    check_ending(path)
    with writable(path), replacing(path) as partial:
        if path.suffix == ".exr":
            write_exr(partial, picture.astype(np.float32))  # colours are weighted by alpha, as EXR has it
        else:
            _write_png(partial, picture, exposure, captions)


def psnr_in_frame(picture: Array, reference: Array, exposure: float) -> float:
    """The display PSNR in dB of a picture against a reference, both (H, W, 4), over the reference's pixels that show
    nothing but the surface; ∞ if they are equal there. `InputError` if there is no such pixel."""
    covered = _covered(reference)
    return float(psnr(display_error(picture[covered][:, :3], reference[covered][:, :3], exposure)))


def check_ending(path: Path) -> None:
    """Raise `InputError` unless the name of a picture ends in one of `SUFFIXES`."""
    if path.suffix not in SUFFIXES:
        raise InputError(f"{path}: the name of a picture must end in {' or '.join(SUFFIXES)}")


def _write_png(path: Path, picture: Array, exposure: float, captions: Sequence[str]) -> None:
    """Write a picture (H, W, 4) in 8 bits after the display transform; PNG wants colours not weighted by alpha."""
    from PIL import Image

    alpha = picture[..., 3:]
    shown = to_display(picture[..., :3] / np.maximum(alpha, 1e-9), exposure)
    pixels = np.round(255 * np.concatenate([shown, alpha], -1)).astype(np.uint8)
    image = Image.fromarray(pixels)
    if captions:
        image = _captioned(image, captions)
    image.save(path, format="png", optimize=True)


def _captioned(image: "Image", captions: Sequence[str]) -> "Image":
    """The image with captions below, in the largest text that fits; the image itself if none is legible."""
    from PIL import ImageDraw, ImageFont
    from PIL.Image import new

    width = image.width // len(captions)
    whole = new("RGBA", (image.width, image.height + CAPTION))
    whole.paste(image, (0, 0))
    draw = ImageDraw.Draw(whole)
    for size in range(CAPTION * 2 // 5, SMALLEST - 1, -1):
        font = ImageFont.load_default(size)
        widest = max(draw.multiline_textbbox((0, 0), caption, font)[2] for caption in captions)
        if widest < width:
            for number, caption in enumerate(captions):
                middle = ((number + 0.5) * width, image.height + CAPTION / 2)
                draw.multiline_text(middle, caption, GREY, font, anchor="mm", align="center")
            return whole
    return image
