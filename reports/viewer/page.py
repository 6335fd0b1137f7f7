"""Writes the page of live materials: one HTML file that holds shaders, textures and the code that draws them."""

import base64
import json
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files

from reports.shaders.dialects import GLSL
from reports.shaders.generator import shader
from reports.shaders.program import Program
from reports.shaders.tables import WIDTH

PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<style>:root {{ color-scheme: light dark; }}
body {{ font: 16px/1.4 system-ui, sans-serif; margin: 1rem auto; max-width: 70rem; padding: 0 1rem; }}
{css}</style></head>
<body><h1>{title}</h1>
{html}
<script type="application/json" id="models">{data}</script>
<script>{code}
const data = JSON.parse(document.getElementById("models").textContent);
window.viewer = mountViewer(document.querySelector(".viewer"), data);
</script></body></html>
"""


@dataclass(frozen=True)
class Model:
    """A material to draw: its name, a line about it, its program, and the exposure that it is shown at."""

    label: str
    program: Program
    exposure: float
    note: str = ""


def model_data(model: Model) -> dict[str, object]:
    """What the page needs of a model. `InputError` where no shader can do its program."""
    made = shader(model.program, GLSL)
    textures = {"exact": made.exact, "half": made.half}
    encoded = {name: base64.b64encode(array.tobytes()).decode() for name, array in textures.items()}
    return {"label": model.label, "note": model.note, "shader": made.text, "exposure": model.exposure, **encoded}


def page(title: str, models: Sequence[Model]) -> str:
    """The whole page. `InputError` where no shader can do a program."""
    data = {"width": WIDTH, "models": [model_data(model) for model in models]}
    parts = {name: (files("reports.viewer") / f"viewer.{name}").read_text("utf-8") for name in ("css", "html", "js")}
    return PAGE.format(
        title=_escaped(title), css=parts["css"], html=parts["html"], code=parts["js"], data=as_json(data)
    )


def as_json(data: object) -> str:
    """JSON that stands inside a script element: no text of the data can end the element."""
    return json.dumps(data).replace("<", "\\u003c").replace("\u2028", "\\u2028").replace("\u2029", "\\u2029")


def _escaped(text: str) -> str:
    from html import escape

    return escape(text)
