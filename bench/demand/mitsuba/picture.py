"""Path-traces a Mitsuba scene, an XML file, in which one BSDF is replaced by a codec file."""

from pathlib import Path
from xml.etree import ElementTree

import mitsuba as mi
import numpy as np

from bench.demand.mitsuba.bsdf import NAME, register
from bench.demand.mitsuba.scene import loaded, sample_angle, set_variant
from bench.inputs.errors import InputError, did_you_mean, readable


def path_traced(scene: Path, bsdf: str, file: Path, repeat: float = 1.0, samples: int | None = None) -> np.ndarray:
    """The picture (H, W, 4) of the scene's first sensor, linear RGB and an alpha of 1, by the scene's own integrator.

    The BSDF with the id `bsdf` answers from the codec file; the longer side of its texture fits `repeat` times in a
    unit of the shapes' uv. `samples` a pixel default to the scene's. Each sample covers its share of the pixel's area,
    over which the texture is averaged. `InputError` says what is wrong with the scene.
    """
    text = replaced(scene, bsdf, file, repeat)
    set_variant()
    plugin = register()
    mi.file_resolver().prepend(str(scene.absolute().parent))
    content = loaded(scene, lambda: mi.load_string(text))
    for shape in content.shapes():
        if isinstance(shape.bsdf(), plugin):
            shape.bsdf().pixel_angle = sample_angle(content.sensors()[0], samples)
    colours = np.asarray(mi.render(content, spp=samples or 0))[..., :3]
    return np.concatenate([colours, np.ones_like(colours[..., :1])], 2)


def replaced(scene: Path, bsdf: str, file: Path, repeat: float) -> str:
    """The text of the scene with the BSDF of that id replaced. `InputError` if it has none, or is no readable XML."""
    with readable(str(scene), "give a Mitsuba scene, an XML file"):
        root = ElementTree.parse(scene).getroot()
    bsdfs = {node.get("id", ""): node for node in root.iter("bsdf") if node.get("id")}
    if bsdf not in bsdfs:
        raise InputError(f"{scene}: it has no BSDF with the id {bsdf!r}{did_you_mean(bsdf, bsdfs)}")
    node = bsdfs[bsdf]
    node.clear()
    node.attrib.update(type=NAME, id=bsdf)
    ElementTree.SubElement(node, "string", name="filename", value=str(file.absolute()))
    ElementTree.SubElement(node, "float", name="repeat", value=repr(float(repeat)))
    return ElementTree.tostring(root, encoding="unicode")
