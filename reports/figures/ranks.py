"""The critical-difference diagram of Demšar (2006): mean ranks of codecs, and which are not told apart."""

from collections.abc import Iterator
from typing import Any

from bench.compare.choosing.budgets import ENOUGH, budgets
from bench.compare.ranks import Ranks
from bench.records import Run
from reports.budgets import in_words
from reports.figures.canvas import Figure, new, png, short, style
from reports.styles import Styles


def critical_differences(run: Run) -> Iterator[Figure]:
    """One figure, of the mean ranks of `table ranks`, if there are any."""
    if not (ranking := budgets(run).ranks()):
        return
    title = f"Mean ranks over surfaces at {in_words(ENOUGH)}"
    with style():
        drawing = new(9.6, 1.2 + 0.24 * len(ranking.mean))
        axes = drawing.add_axes((0.24, 0.14, 0.72, 0.74))
        _draw(axes, ranking, Styles(run))
        axes.set_title(f"{title}; critical difference {ranking.critical:.2f}", loc="left")
        yield Figure("", "ranks", title, png(drawing), drawing)


def _draw(axes: Any, ranking: Ranks, styles: Styles) -> None:
    """A row a codec, the best on top, and a bar to the right as long as the critical difference."""
    for row, (line, rank) in enumerate(ranking.mean.items()):
        look = styles.of_codec(line.partition(",")[0]) | {"linestyle": "none"}
        end = min(rank + ranking.critical, len(ranking.mean))
        axes.plot([rank, end], [row, row], color="0.8", linewidth=5, solid_capstyle="butt", zorder=0)
        axes.plot(rank, row, **look, markersize=7)
    axes.set_yticks(range(len(ranking.mean)), [short(line) for line in ranking.mean], fontsize=8)
    axes.set(ylim=(len(ranking.mean) - 0.4, -0.6), xlabel="mean rank (1: the best); grey: not told apart")
    axes.grid(axis="y", visible=False)
