"""The environment of Jinja2 that loads the templates of all pages, `reports/templates/`, and the filters for them.

Every text that a template writes is escaped, because names of codecs and materials come from outside. Excepted is what
a template marks as `safe`: the page's own scripts and data.
"""

import base64
import hashlib
import io

from jinja2 import Environment, PackageLoader, StrictUndefined
from PIL import Image

from bench.inputs.errors import visible
from reports.atlas import WEBP_SIDE, webp
from reports.figures.canvas import Figure


def _sha256(text: str) -> str:
    """The hash of an inline style or script, in base64, by which a content security policy permits it."""
    return base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()


def _figure_as_webp(figure: Figure) -> str:
    """A figure as the data URL of a WebP, half as large as its PNG; without loss, except for maps of texels.

    Maps of texels, the figures of kind `abrdf`, have many colours, so they would take far more without loss. A figure
    that is larger than a WebP can be is shrunk.
    """
    if figure.kind == "abrdf":
        options: dict[str, int] = {"quality": 90, "method": 4}
    else:
        # Without loss, `quality` (to 100) and `method` (to 6) are the effort to pack it: here little, which is fast.
        options = {"lossless": True, "quality": 30, "method": 1}
    with Image.open(io.BytesIO(figure.png)) as stored:
        picture = stored.convert("RGB")
    # Its longer side becomes `WEBP_SIDE` if it is more; the file of the figure keeps all pixels.
    picture.thumbnail((WEBP_SIDE, WEBP_SIDE))
    return webp(picture, **options)


# A variable that a template names but nobody gives is an error, not an empty text. Lines of tags leave no empty lines.
TEMPLATES = Environment(
    loader=PackageLoader("reports"),
    autoescape=True,
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
    keep_trailing_newline=True,
)
TEMPLATES.filters |= {"sha256": _sha256, "visible": visible, "webp": _figure_as_webp}
