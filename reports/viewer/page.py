"""Writes the page of live materials: one HTML file that holds shaders, textures and the code that draws them.

A *live* material is drawn in the browser with WebGL 2, under lights that a reader moves. Its *shader* is a function in
GLSL with two textures, made from its program. A *model* is such a material as the page holds it.
"""

import base64
import dataclasses
import json
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files
from typing import NamedTuple

import numpy as np

from bench.program import Program
from reports.html import TEMPLATES
from reports.shaders.dialects import GLSL
from reports.shaders.generator import Shader, fallback, shader
from reports.shaders.writer import WIDTH

SCRIPTS = ("shapes.js", "passes.js", "controls.js", "viewer.js")  # of this folder; they share one scope
STYLE = """:root { color-scheme: light dark; }
body { font: 16px/1.4 system-ui, sans-serif; margin: 1rem auto; max-width: 70rem; padding: 0 1rem; }
h1 { overflow-wrap: anywhere; }
"""
START = """
unpacked("models").then((data) => { window.viewer = mountViewer(document.querySelector(".viewer"), data); }).catch(
  (error) => {
    document.querySelector("[data-says]").textContent = `This browser cannot show the material: ${error.message}`;
  },
);
"""
# Of a half's 11 significant bits, those that a page drops from slices: a value then moves by 0.2 % at most, less than
# half a step of an 8-bit display, and the deflated page is a third smaller.
DROPPED = 3


@dataclass(frozen=True)
class Shown:
    """A material to draw."""

    label: str  # its name on the page
    program: Program
    exposure: float  # the factor from radiance to what the page shows
    note: str = ""  # a line about it
    slices: bool = False  # whether its table of halves holds slices, which take far more than anything else


def model_data(model: Shown) -> dict[str, object]:
    """What the page needs of a model, by the names that its script uses, for `pack`: arrays are `bytes` objects.

    `InputError` where no shader can do its program.
    """
    full = shader(model.program, GLSL)
    if model.slices:
        full = dataclasses.replace(full, half=_rounded(full.half))
    spare = fallback(model.program, GLSL)
    data: dict[str, object] = {"label": model.label, "note": model.note, "exposure": model.exposure}
    data |= {"periods": model.program.periods, **_source_and_arrays(full)}
    if spare:  # for compilers that choke on literals
        # Only what differs, so that textures that are the same are not written twice.
        data["fallback"] = {key: value for key, value in _source_and_arrays(spare).items() if data[key] != value}
    return data


def _rounded(half: np.ndarray) -> np.ndarray:
    """Halves of at least 0 without their `DROPPED` last bits, rounded to the nearest; they deflate better."""
    codes = half.view(np.uint16).astype(np.uint32) + (1 << (DROPPED - 1))
    largest = np.finfo(np.float16).max.view(np.uint16)
    kept = np.minimum(codes, largest) >> DROPPED << DROPPED
    return kept.astype(np.uint16).view(np.float16)


def _source_and_arrays(source: Shader) -> dict[str, object]:
    """The text of a shader, and the bytes of its two textures and its uniforms."""
    arrays = {"exact": source.exact, "half": source.half, "uniforms": source.uniforms}
    return {"shader": source.text, **{name: array.tobytes() for name, array in arrays.items()}}


class Data(NamedTuple):
    """An element of a page that holds data: JSON, made by `as_json`, or base64 where its type is `text/plain`."""

    id: str
    text: str
    type: str = "application/json"


def fragment() -> tuple[str, str]:
    """The viewer's styles and script, once a page; each viewer is the template `viewer.html`.

    The script defines `mountViewer(section, data)`, which returns the viewer, or null if the browser cannot draw.
    """
    folder = files("reports.viewer")
    css = (folder / "viewer.css").read_text("utf-8")
    scripts = [(folder / name).read_text("utf-8") for name in SCRIPTS]
    # The scripts stand within one function, so that a page sees only one of their names.
    script = f"const mountViewer = (() => {{\n{''.join(scripts)}\nreturn mountViewer;\n}})();\n"
    return css, script


def unpacked() -> str:
    """The script of the function `unpacked(id)`, which reads what `pack` wrote into an element of a page."""
    return (files("reports") / "web" / "unpacked.js").read_text("utf-8")


def page(title: str, models: Sequence[Shown]) -> str:
    """The HTML of a whole page with these materials. `InputError` if no shader can compute a program."""
    css, script = fragment()
    data = Data("models", pack({"width": WIDTH, "models": list(map(model_data, models))}), "text/plain")
    styles = [STYLE + css]
    scripts = [unpacked() + script + START]
    return TEMPLATES.get_template("view.html").render(title=title, styles=styles, scripts=scripts, data=[data])


def as_json(data: object) -> str:
    """JSON that stands inside a script element: no text of the data can end the element.

    The line and paragraph separators of Unicode are escaped as well.
    """
    return json.dumps(data).replace("<", "\\u003c").replace("\u2028", "\\u2028").replace("\u2029", "\\u2029")


def pack(data: object) -> str:
    """Data of dicts, lists and `bytes` objects as one text for a page, which the page's function `unpacked` reads.

    The text is base64 of deflated bytes: the length of the JSON in four bytes, the JSON, then the `bytes` objects one
    after the other. In the JSON, {raw: [start, length]} stands in place of a `bytes` object. Its base64 inside the JSON
    would make the text larger, because base64 deflates badly.
    """
    places: dict[bytes, list[int]] = {}  # by `bytes` object, in order: where it starts after the JSON, and its length

    def placeholder(raw: bytes) -> object:
        """What stands for a `bytes` object in the JSON. Notes it in `places`; equal ones share a place."""
        start = sum(map(len, places))
        return {"raw": places.setdefault(raw, [start, len(raw)])}

    text = json.dumps(data, default=placeholder).encode()
    length = len(text).to_bytes(4, "little")
    packed = zlib.compress(length + text + b"".join(places), level=9)  # the smallest
    return base64.b64encode(packed).decode()
