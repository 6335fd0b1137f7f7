"""Common parts of all figures: file name, style, axes, PNG, SVG and PDF output.

A `Figure` is what the project calls a figure: a PNG with its name. A *drawing* is the figure of Matplotlib, of which
the PNG is made. A `Sheet` is a drawing made of pictures, placed by pixels.
"""

import hashlib
import io
import math
import re
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import matplotlib
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.figure import Figure as Drawing
from matplotlib.ticker import EngFormatter, FuncFormatter, LogLocator, NullFormatter
from PIL import Image

from bench.files.plots import default_settings
from bench.records import Run
from reports.rows import MaterialRows, materials

DPI = 110  # pixels an inch of every PNG


@dataclass(frozen=True)
class Figure:
    """A drawn figure, as PNG, with what its SVG or PDF is made of."""

    material: str  # the one that it shows; "" for all
    kind: str  # such as "contact" or "fronts-measured"; the name of its file begins with it
    title: str
    png: bytes
    drawing: "Drawing | Sheet | None" = None  # None: `vector` cannot be called

    @property
    def name(self) -> str:
        """The name of its file: the material's name, changed and with a digest if a file cannot have that name."""
        plain = re.sub("[^A-Za-z0-9.=_-]+", "-", self.material)
        if plain != self.material:
            digest = hashlib.sha256(self.material.encode()).hexdigest()
            plain += f"-{digest[:6]}"  # two materials may be alike in their plain letters
        return f"{self.kind}-{plain}.png" if self.material else f"{self.kind}.png"

    def vector(self, format: str) -> bytes:
        """The figure in the format "svg" or "pdf", of its drawing; the same drawing gives the same bytes."""
        assert self.drawing
        with style():
            if isinstance(self.drawing, Sheet):
                with self.drawing.layered() as drawing:
                    return _saved(drawing, format)
            return _saved(self.drawing, format)


def _saved(drawing: Drawing, format: str) -> bytes:
    """The file of a drawing in the format "svg" or "pdf"; the same drawing gives the same bytes."""
    # What Matplotlib would write of itself and of the time. A value of None leaves it out, so that bytes stay the same.
    left_out = ("Date", "Creator") if format == "svg" else ("CreationDate", "Creator", "Producer")
    out = io.BytesIO()
    drawing.savefig(out, format=format, metadata=dict.fromkeys(left_out))
    return out.getvalue()


@contextmanager
def style() -> Iterator[None]:
    """Within it, Matplotlib draws in the style of every figure here: labels are words in any script, not formulas."""
    settings: dict[Any, Any] = {
        "font.family": "DejaVu Sans",
        "font.size": 9,
        "axes.titlesize": 9,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.grid": True,
        "grid.alpha": 0.25,
        "legend.frameon": False,
        "text.parse_math": False,
        "svg.hashsalt": "",  # makes names inside an SVG reproducible
        "pdf.fonttype": 42,  # journals refuse fonts of type 3
        "axes.unicode_minus": True,
    }
    with default_settings(), matplotlib.rc_context(settings), warnings.catch_warnings():
        # A label may have letters that the font lacks.
        warnings.filterwarnings("ignore", "Glyph .* missing", UserWarning)
        yield


def of_each_material(draw: Callable[[Run, MaterialRows], Figure | None]) -> Callable[[Run], Iterator[Figure]]:
    """Make of a function that draws one material of a run one that draws them all, for `reports.figures.ALL`.

    `draw` takes the run and the rows of a material, and returns None where there is nothing to show.
    """

    def figures(run: Run) -> Iterator[Figure]:
        """The figures of a run, one for each material for which `draw` returns one, in the style of all figures."""
        for material in materials(run):
            with style():
                figure = draw(run, material)
            if figure:
                yield figure

    return figures


def new(width: float, height: float, **options: Any) -> Drawing:
    """An empty drawing of that size in inches, which Matplotlib does not keep in a global list.

    `options` are further arguments of Matplotlib's `Figure`.
    """
    drawing = Drawing(figsize=(width, height), dpi=DPI, **options)
    FigureCanvasAgg(drawing)  # becomes the drawing's canvas
    return drawing


class Sheet:
    """A figure addressed in pixels from its top left corner: pictures keep their pixels, and cost no axes."""

    def __init__(self, width: int, height: int):
        """Make a white sheet of this size in pixels."""
        self.width, self.height = width, height
        # Matplotlib 3.8 cuts a width of 953.9999 pixels, which a division may give, to 953.
        self.drawing = new((width + 1e-6) / DPI, (height + 1e-6) / DPI)
        self.pixels = np.full((height, width, 3), 255, np.uint8)  # all pictures; texts and scales are in the drawing

    def picture(self, left: int, top: int, picture: np.ndarray) -> None:
        """Put a picture, uint8, on the sheet: (H, W, 3), or (H, W, 4) to be blended in. Parts outside are cut off.

        `left` and `top` are the pixel of its upper left corner, neither of them negative.
        """
        place = self.pixels[top : top + picture.shape[0], left : left + picture.shape[1]]  # a view, written below
        inside = picture[: place.shape[0], : place.shape[1]]
        place[:] = _blended(inside, place) if inside.shape[-1] == 4 else inside

    def text(self, x: float, y: float, text: str, **look: Any) -> None:
        """Write a text at pixels from the top left corner; `y` is its middle unless `look` says otherwise.

        `look` are arguments of Matplotlib's `text`, such as `ha`, `va`, `color` and `fontsize`.
        """
        merged: dict[str, Any] = {"fontsize": 8, "va": "center"} | look
        self.drawing.text(x / self.width, 1 - y / self.height, text, **merged)

    def scale(self, left: int, top: int, size: tuple[int, int], colours: str, **look: Any) -> Any:
        """Draw the colours of a scale as upright axes, `left` and `top` pixels from the corner.

        `size` is their width and height in pixels, `colours` the name of a colour map; `look` may have the `norm` from
        values to colours. Returns Matplotlib's colour bar, whose axes a caller labels.
        """
        width, height = size
        # Matplotlib takes left, bottom, width and height as shares of the sheet, from its bottom left corner.
        box = (left / self.width, 1 - (top + height) / self.height, width / self.width, height / self.height)
        return self.drawing.colorbar(ScalarMappable(cmap=colours, **look), cax=self.drawing.add_axes(box))

    def png(self, mode: str = "RGB") -> bytes:
        """The sheet as PNG; the same sheet gives the same bytes. `mode` is one of Pillow's: "RGB", or "L" for grey."""
        self.drawing.patch.set_alpha(0)  # its white ground would cover the pictures, here and in `layered`
        self.drawing.canvas.draw()
        # Texts and scales (H, W, 4), which are blended over the pictures.
        overlay = np.asarray(self.drawing.canvas.buffer_rgba())  # type: ignore[attr-defined]
        covered = overlay[..., 3] > 0  # mask (H, W)
        pixels = self.pixels.copy()
        pixels[covered] = _blended(overlay[covered], pixels[covered])
        out = io.BytesIO()
        Image.fromarray(pixels).convert(mode).save(out, "png", compress_level=4)
        return out.getvalue()

    @contextmanager
    def layered(self) -> Iterator[Drawing]:
        """Within the `with`, the sheet as one drawing: its pictures, unchanged, below its texts.

        Afterwards they are removed from the sheet's own drawing, whose next file would else have them twice.
        """
        axes = self.drawing.add_axes((0, 0, 1, 1), zorder=-1)
        axes.imshow(self.pixels, interpolation="none", aspect="auto")
        axes.set_axis_off()
        try:
            yield self.drawing
        finally:
            axes.remove()


def _blended(over: np.ndarray, ground: np.ndarray) -> np.ndarray:
    """Pixels (…, 4) laid over others (…, 3), as their opacity says; all uint8."""
    alpha = over[..., 3:] / 255
    return np.round(over[..., :3] * alpha + ground * (1 - alpha)).astype(np.uint8)


def coloured(values: np.ndarray, colours: str, norm: Any) -> np.ndarray:
    """Values (H, W) as a picture (H, W, 4), uint8; those that are not finite are transparent.

    `colours` is the name of a colour map, `norm` Matplotlib's mapping of values to its range, 0 to 1.
    """
    masked = np.ma.masked_invalid(values)
    return matplotlib.colormaps[colours](norm(masked), bytes=True)


def factor_to(least: int, size: Sequence[int]) -> int:
    """The whole factor that makes the longer side of a picture (height, width) `least` pixels long or more."""
    return math.ceil(least / max(size))


def enlarged(picture: np.ndarray, factor: int) -> np.ndarray:
    """A picture (H, W, …) with every pixel enlarged to a square of `factor` pixels a side."""
    return picture.repeat(factor, 0).repeat(factor, 1)


def png(drawing: Drawing) -> bytes:
    """A drawing as PNG; the same drawing gives the same bytes."""
    out = io.BytesIO()
    drawing.savefig(out, format="png", metadata={"Software": None}, pil_kwargs={"compress_level": 4})
    return out.getvalue()


def short(label: str, length: int = 38) -> str:
    """A label cut to `length` characters; a space goes before an underscore, because legends hide labels that begin
    with one."""
    cut = label if len(label) <= length else label[: length - 1] + "…"
    return f" {cut}" if cut.startswith("_") else cut


def grid_of(count: int, columns: int) -> tuple[int, int]:
    """The (rows, columns) of a grid for `count` small pictures, with at most `columns` columns; of none, (0, 1)."""
    used_columns = min(columns, max(1, count))
    return math.ceil(count / used_columns), used_columns


def log_ticks(axis: Any, unit: str = "") -> None:
    """Set the ticks of a logarithmic axis: at 1, 2 and 5 of each decade, at 1 and 3 if it spans more than two.

    With a unit, "B", they read `20 kB`; without, plain numbers.
    """
    low, high = axis.get_view_interval()
    digits = (1, 3) if high > 100 * low else (1, 2, 5)
    axis.set_major_locator(LogLocator(10, digits, numticks=9))
    axis.set_major_formatter(EngFormatter(unit) if unit else FuncFormatter(lambda value, _: f"{value:,g}"))
    axis.set_minor_formatter(NullFormatter())


def legend(axes: Any, handles: Sequence[Any], labels: Sequence[str]) -> None:
    """Draw a legend right of the last axes of `plots`, and make all axes narrower, so that it fits.

    `handles` are what Matplotlib's `plot` returned, one for each label.
    """
    beside = (1.02, 1.0)  # the upper left corner of the legend, in widths and heights of the axes
    box = axes.legend(handles, list(map(short, labels)), loc="upper left", bbox_to_anchor=beside, borderaxespad=0)
    drawing = axes.figure
    pixels = box.get_window_extent(drawing.canvas.get_renderer()).width
    inches = pixels / drawing.dpi + 0.3  # with its margins
    right = 1 - inches / drawing.get_figwidth()  # where the axes end, as a share of the figure
    drawing.subplots_adjust(right=max(0.4, right))  # however long the labels, something of the axes is left


def plots(width: float, height: float, count: int = 1) -> tuple[Drawing, list[Any]]:
    """A drawing of that size in inches, and `count` axes side by side that share their y axis."""
    drawing = new(width, height)
    axes = drawing.subplots(1, count, sharey=True, squeeze=False)[0]  # the only row
    # Margins in inches, as shares of the figure. Matplotlib would find them by measuring all texts, which takes longer
    # than drawing them.
    drawing.subplots_adjust(left=0.7 / width, top=1 - 0.5 / height, bottom=0.65 / height, wspace=0.1)
    return drawing, list(axes)
