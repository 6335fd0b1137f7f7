"""Common parts of all figures: file name, style, axes, PNG and SVG output."""

import hashlib
import io
import re
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import matplotlib
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure as Drawing
from matplotlib.ticker import EngFormatter, FuncFormatter, LogLocator, NullFormatter

DPI = 110


@dataclass(frozen=True)
class Figure:
    """A drawn figure: the material it shows, its kind, its title, its PNG; its SVG, where that is kept too."""

    material: str
    kind: str
    title: str
    png: bytes
    svg: bytes = b""

    @property
    def name(self) -> str:
        """Its file's name: that of the material where it is fit for one, else with a digest that tells it apart."""
        plain = re.sub("[^A-Za-z0-9.=_-]+", "-", self.material)
        if plain != self.material:
            plain += f"-{hashlib.sha256(self.material.encode()).hexdigest()[:6]}"
        return f"{self.kind}-{plain}.png"


@contextmanager
def style() -> Iterator[None]:
    """Matplotlib as every figure here wants it: labels are words, not formulas, and any script may occur in them."""
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
        "svg.hashsalt": "",  # names inside an SVG are the same each time
        "axes.unicode_minus": True,
    }
    with matplotlib.rc_context(settings), warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing", UserWarning)
        yield


def new(width: float, height: float, **options: Any) -> Drawing:
    """An empty figure of that size in inches, known to no global list of figures."""
    drawing = Drawing(figsize=(width, height), dpi=DPI, **options)
    FigureCanvasAgg(drawing)
    return drawing


def png(drawing: Drawing) -> bytes:
    """The figure as PNG; the same drawing gives the same bytes."""
    out = io.BytesIO()
    drawing.savefig(out, format="png", metadata={"Software": None})
    return out.getvalue()


def svg(drawing: Drawing) -> bytes:
    """The figure as SVG; the same drawing gives the same bytes."""
    out = io.BytesIO()
    drawing.savefig(out, format="svg", metadata={"Date": None, "Creator": None})
    return out.getvalue()


def short(label: str, length: int = 34) -> str:
    """A label that fits, and that no legend takes for a hidden one."""
    label = label if len(label) <= length else label[: length - 1] + "…"
    return f" {label}" if label.startswith("_") else label


def grid_of(count: int, columns: int) -> tuple[int, int]:
    """(rows, columns) for so many small pictures."""
    columns = min(columns, max(1, count))
    return -(-count // columns), columns


def log_ticks(axis: Any, unit: str = "") -> None:
    """Ticks of a logarithmic axis, `20 kB`: at 1, 2 and 5 of each decade, at 1 and 3 where more than two are shown."""
    low, high = axis.get_view_interval()
    axis.set_major_locator(LogLocator(10, (1, 3) if high > 100 * low else (1, 2, 5), numticks=9))
    axis.set_major_formatter(EngFormatter(unit) if unit else FuncFormatter(lambda value, _: f"{value:,g}"))
    axis.set_minor_formatter(NullFormatter())


def legend(axes: Any, handles: Sequence[Any], labels: Sequence[str]) -> None:
    """A legend beside the axes, where it covers no data."""
    axes.legend(handles, list(map(short, labels)), loc="upper left", bbox_to_anchor=(1.02, 1.0), borderaxespad=0)
