"""Which codecs are told apart: paired differences to one of them, slice by slice, and mean ranks over surfaces.

The *difference* of two codecs is that of their PSNR in dB on the same slices, as a mean with a 95 % interval. Two
codecs are told apart only on `FEWEST` materials or more. The *rank* of a line on a surface is its place by what it
reaches within a budget of bytes, see `reports.rungs`.
"""

from collections.abc import Iterator, Mapping
from typing import Any

from bench.compare.paired import Interval
from bench.compare.statistics import FEWEST
from bench.records import Run
from reports.figures.canvas import Figure, new, png, short, style
from reports.front import mean_ranks
from reports.numbers import interval
from reports.of_rungs import in_words
from reports.ranking import against_one, ranked, with_rank
from reports.rows import materials
from reports.rungs import ENOUGH, rungs_of
from reports.styles import Styles

Differences = Mapping[str, Interval]  # by label, a codec with its settings: its difference to one other codec


def significance(run: Run) -> Iterator[Figure]:
    """A figure of the paired differences to one codec over all materials, if there are several, then one for each.

    Materials where nothing can be compared have none.
    """
    rows = materials(run)
    against = against_one(run, rows, with_rank(rows, ranked(rows)))
    styles = Styles(run.jobs)
    parts = {material.name: against.on[material.name] for material in rows if material.name in against.on}
    if len(parts) > 1:
        yield _figure("", f"all {len(parts)} materials", against.first, against.over, styles)
    for name, part in parts.items():
        yield _figure(name, name, against.first, part, styles)


def _figure(material: str, where: str, first: str, differences: Differences, styles: Styles) -> Figure:
    """A figure of differences to the codec `first`, which stands on top, then the others from the best on.

    `material` is "" over several; `where` says of which materials it is, in words.
    """
    title = f"{where}: mean paired difference to {short(first, length=40)}"
    from_best = sorted(differences.items(), key=lambda item: -item[1].mean)
    with style():
        height = 1.45 + 0.24 * (len(differences) + 1)  # inches: the head and the foot, and each row
        drawing = new(9.6, height)
        # Left, bottom, width and height as shares of the figure: labels stand left of the axes, numbers right of them.
        axes = drawing.add_axes((0.27, 0.95 / height, 0.46, 1 - 1.25 / height))
        # Row 0 is the codec itself, at 0.
        axes.axvline(0, color="0.6", linewidth=0.8, zorder=0)
        axes.plot(0, 0, **styles.of_codec(first) | {"linestyle": "none"}, markersize=6)
        # A text with these has x as a share of the axes and y in rows.
        beside: Any = {"transform": axes.get_yaxis_transform(), "fontsize": 8, "va": "center"}
        for row, (label, difference) in enumerate(from_best, 1):
            look = styles.of_codec(label) | {"linestyle": "none"}
            ends = [difference.low, difference.high]
            axes.plot(ends, [row, row], color=look["color"], linewidth=2.2, solid_capstyle="butt")
            axes.plot(difference.mean, row, **look, markersize=6)
            remark = ""
            if difference.materials >= FEWEST and not difference.apart:  # fewer materials say nothing about others
                remark = ", not told apart"
            axes.text(1.02, row, interval(difference) + remark, **beside)
        axes.set_yticks(range(len(differences) + 1), [short(label) for label in (first, *dict(from_best))], fontsize=8)
        rows = (len(differences) + 0.6, -0.6)  # from the bottom to the top: row 0 stands on top
        axes.set(ylim=rows, xlabel="dB a slice of display PSNR (right of 0: better)")
        axes.grid(axis="y", visible=False)
        drawing.text(0.012, 1 - 0.18 / height, title, va="center")
        drawing.text(0.012, 0.1 / height, _caption(differences), fontsize=8, color="0.3", va="bottom")
        return Figure(material, "significance", title, png(drawing), drawing)


def _caption(differences: Differences) -> str:
    """How the intervals are made and from how many materials and seeds, in words for a reader.

    Codecs may have different numbers; the largest are given.
    """
    materials = max(each.materials for each in differences.values())
    seeds = max(each.seeds for each in differences.values())
    counts = []
    if materials > 1:
        counts.append(f"{materials} materials")
    if seeds > 1:
        counts.append(f"{seeds} seeds")
    caveat = ""
    if materials > 1:
        words = "by Student's t over material means"
    elif seeds > 1:
        words = "of a bootstrap over seeds and pairs, of this material only"
    else:
        words = "of a bootstrap over pairs, of this material only"
        caveat = " With one seed, it does not include the scatter of fits."
    if counts:
        words = f"{words}: {', '.join(counts)}"
    return f"Bars: 95 % interval {words}.{caveat}\nBoth codecs at the same pairs."


def critical_differences(run: Run) -> Iterator[Figure]:
    """The diagram of Demšar (2006), if there are ranks: a row a line at its mean rank, with a bar as long as the
    critical difference, which covers the lines of worse rank from which it is not told apart.

    There are ranks if two lines or more reach the budget `ENOUGH` on each of three surfaces or more.
    """
    ranking = mean_ranks(rungs_of(run))
    if not ranking:
        return
    title = f"Mean ranks over surfaces at {in_words(ENOUGH)}"
    styles = Styles(run.jobs)
    count = len(ranking.mean)
    with style():
        drawing = new(9.6, 1.2 + 0.24 * count)
        axes = drawing.add_axes((0.24, 0.14, 0.72, 0.74))
        for row, (line, rank) in enumerate(ranking.mean.items()):
            look = styles.of_line(line) | {"linestyle": "none"}
            end = min(rank + ranking.critical, count)  # there is no rank beyond the last
            axes.plot([rank, end], [row, row], color="0.8", linewidth=5, solid_capstyle="butt", zorder=0)
            axes.plot(rank, row, **look, markersize=7)
        axes.set_yticks(range(count), list(map(short, ranking.mean)), fontsize=8)
        axes.set(ylim=(count - 0.4, -0.6), xlabel="mean rank (1: the best); grey: not told apart")
        axes.grid(axis="y", visible=False)
        axes.set_title(f"{title}; critical difference {ranking.critical:.2f}", loc="left")
        yield Figure("", "ranks", title, png(drawing), drawing)
