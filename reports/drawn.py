"""Draws one kind of figure of a run for a paper: chosen codecs and materials, new names, and a width on paper.

There are two sorts of figures. *Plots* are Matplotlib axes: at another width they are laid out anew, and their texts
keep their size in points. *Pictures* stand on a `Sheet`, which is addressed in pixels: it is scaled as a whole. Lengths
here are in inches, as Matplotlib has them, unless a name or comment says otherwise.
"""

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from matplotlib.figure import Figure as Drawing
from matplotlib.text import Text

import reports
from bench.inputs.errors import InputError, did_you_mean
from bench.records import load_together
from reports import figures
from reports.choice import Choice
from reports.figures.canvas import Figure, Sheet, png, style
from reports.figures.pairs import Inset, pairs_figure

PAIRS = "pairs"  # the kind of figure that shows the slices of chosen pairs
KINDS = (*figures.ALL, PAIRS)
_NOT_STORED = "no job of this run stored {}: published records have numbers alone, so give the folder of a run"
# By kind: why a run may have no figure of that kind, in words for a reader.
WHY_EMPTY = {
    "significance": reports.WHY_EMPTY["summary"],
    "ranks": reports.WHY_EMPTY["ranks"],
    "fronts": reports.WHY_EMPTY["curves"],
    "contact": _NOT_STORED.format("pictures of slices"),
    "rate": reports.WHY_EMPTY["main"],
    "speed": "no job of this run has a PSNR and a time of a query: `neubtf-bench run` measures both",
    "fits": reports.WHY_EMPTY["fits"],
    "footprints": "no job of this run was scored at two or more footprints: `neubtf-bench run` does",
    "angles": _NOT_STORED.format("the errors of its slices"),
    "polar": _NOT_STORED.format("errors by direction"),
    "abrdf": _NOT_STORED.format("the errors of its texels"),
    "latents": _NOT_STORED.format("a texture that its decoder reads, in a drawing"),
    PAIRS: reports.WHY_EMPTY["main"],
}
CM = 1 / 2.54  # a centimetre in inches
# The margins of plots whose width is chosen, in inches:
LEFT = 0.75
RIGHT = 0.1
LEAST_AXES = 0.35  # between them
TITLE = 0.6  # above, with room for two lines of words
LABELS = 0.55  # below, with room for two lines of words
PLOT = 0.75  # the height of a plot as a share of its width without the left margin
LETTER = 0.55  # mean width of a letter, as a share of the size of its text


@dataclass(frozen=True)
class Wanted:
    """Which figure to draw, and how; `pairs` and `inset` are only for figures of the kind `pairs`."""

    kind: str
    choice: Choice  # codecs, materials and new names
    width: float | None = None  # in cm; None: as in a report
    pairs: Sequence[int] = ()  # indices of pairs of the BTF; without any, those of the contact sheet
    inset: tuple[int, int, int] | None = None  # the square to magnify: first row and column, and side, in texels


def drawn(runs: Sequence[Path], wanted: Wanted) -> list[Figure]:
    """The figures of a kind, mostly one for each material that has one, drawn from runs that are read as one.

    An empty list if there is nothing to draw. `InputError` for an unknown kind, for a choice that the run does not
    have, and for a pair or an inset that a material does not have.
    """
    if wanted.kind not in KINDS:
        raise InputError(f"figure {wanted.kind}: no such kind{did_you_mean(wanted.kind, KINDS)}")
    # `beside`: a job on other data than those of published records stands beside them, instead of raising an error.
    run = wanted.choice.of_run(load_together(list(runs), beside=True))
    if wanted.kind == PAIRS:
        names = dict.fromkeys(str(job["material"]) for job in run.jobs if job["status"] == "ok")  # each once
        inset = Inset(*wanted.inset) if wanted.inset else None
        figures_of_kind = [pairs_figure(run, name, wanted.pairs, inset) for name in names]
    else:
        figures_of_kind = list(figures.ALL[wanted.kind](run))
    return [_with_names_and_width(figure, wanted) for figure in figures_of_kind]


def _with_names_and_width(figure: Figure, wanted: Wanted) -> Figure:
    """The figure with the new names of the choice, at the wanted width on paper, and with its new PNG.

    Changes the drawing of the figure in place.
    """
    sheet = figure.drawing if isinstance(figure.drawing, Sheet) else None  # of pictures; other figures are plots
    drawing = sheet.drawing if sheet else figure.drawing
    assert isinstance(drawing, Drawing)
    texts = [text for text in drawing.findobj(Text) if isinstance(text, Text)]  # the condition is for the type checker
    with style():  # a layout and a PNG need it as well
        for text in texts:
            text.set_text(wanted.choice.with_new_names(text.get_text()))
        if wanted.width and sheet:
            _scale(drawing, wanted.width * CM, texts)
        elif wanted.width:
            _narrow(drawing, wanted.width * CM)
        content = sheet.png() if sheet else png(drawing)
    return replace(figure, png=content)


def _scale(drawing: Drawing, width: float, texts: Sequence[Text]) -> None:
    """Scale a drawing to a width in inches, in place.

    Texts keep their proportion to pictures, and pictures their pixels.
    """
    old_width, height = drawing.get_size_inches()
    scale = width / old_width
    drawing.set_size_inches(width, scale * height)
    drawing.set_dpi(drawing.get_dpi() / scale)  # as many pixels as before, on fewer or more inches
    for text in texts:
        text.set_fontsize(scale * float(text.get_fontsize()))


def _narrow(drawing: Drawing, width: float) -> None:
    """Lay plots out at a width in inches, in place: texts keep their size in points, legends move below the axes.

    Beside axes that are narrower than in a report there is no room for a legend. `InputError` for no room for axes.
    """
    least = LEFT + RIGHT + LEAST_AXES
    if width < least:
        raise InputError(f"--width {width / CM:g}: plots need at least {least / CM:.1f} cm")
    legends = [legend for legend in (axes.get_legend() for axes in drawing.axes) if legend is not None]
    drawing.set_figwidth(width)
    # The height: room for the title, the axes, their labels, and below these the largest legend.
    renderer = drawing.canvas.get_renderer()  # type: ignore[attr-defined]
    legend_heights = [legend.get_window_extent(renderer).height / drawing.dpi for legend in legends]  # in inches
    legend_height = max(legend_heights, default=0.0)
    axes_height = PLOT * (width - LEFT)
    height = TITLE + axes_height + LABELS + legend_height
    drawing.set_figheight(height)
    bottom = (LABELS + legend_height) / height  # Matplotlib takes margins as shares of the whole drawing
    drawing.subplots_adjust(left=LEFT / width, right=1 - RIGHT / width, bottom=bottom, top=1 - TITLE / height)
    for legend in legends:
        legend.set_loc("upper left")
        # In units of the first axes: at their left edge, and as far below them as their labels take.
        legend.set_bbox_to_anchor((0, -LABELS / axes_height), transform=drawing.axes[0].transAxes)
    # Words that are wider than the axes go on in another line.
    for axes in drawing.axes:
        for text in axes.get_children():  # its titles, and words beside points, which are short
            if isinstance(text, Text):
                text.set_text(_folded(text, width - LEFT))
        axes.yaxis.label.set_text(_folded(axes.yaxis.label, axes_height))  # it runs upwards


def _folded(text: Text, width: float) -> str:
    """The words of a text on lines that fit into a width in inches, by the mean width of a letter of its size."""
    letter_points = LETTER * float(text.get_fontsize())
    width_points = width * 72  # 72 points an inch
    letters = max(8, int(width_points / letter_points))  # not less than a short word, whatever the width
    lines = []
    for line in text.get_text().split("\n"):
        lines += textwrap.wrap(line, letters)
    return "\n".join(lines)
