"""The templates of all pages. They escape every text, save what they call `safe`: the page's own scripts and data."""

import base64
import hashlib
import io

from jinja2 import Environment, PackageLoader, StrictUndefined
from PIL import Image

from bench.inputs.errors import visible
from reports.atlas import webp
from reports.figures.canvas import Figure


def _sha256(text: str) -> str:
    """The hash by which a content security policy permits an inline style or script."""
    return base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()


def _webp(figure: Figure) -> str:
    """A figure as the data URL of a WebP, half as large as its PNG; without loss, except for maps of texels."""
    if figure.kind == "abrdf":
        options: dict[str, int] = {"quality": 90, "method": 4}
    else:
        options = {"lossless": True, "quality": 30, "method": 1}  # without loss, the last two are the effort to pack it
    with Image.open(io.BytesIO(figure.png)) as picture:
        return webp(picture.convert("RGB"), **options)


TEMPLATES = Environment(
    loader=PackageLoader("reports"),
    autoescape=True,
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
    keep_trailing_newline=True,
)
TEMPLATES.filters |= {"sha256": _sha256, "visible": visible, "webp": _webp}
