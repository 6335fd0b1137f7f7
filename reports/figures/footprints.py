"""Level of detail: quality against the footprint of a query, for each codec."""

from collections.abc import Iterator

from matplotlib.ticker import NullLocator

from bench.records import Run
from reports.figures.canvas import Figure, legend, plots, png, style
from reports.rows import MaterialRows, footprint_curves, materials
from reports.styles import Styles


def footprint_plots(run: Run) -> Iterator[Figure]:
    """For each material: display PSNR against truth that is averaged over the same footprint, means over seeds."""
    styles = Styles(run)
    for material in materials(run):
        curves = {codec.label: curve for codec in material.codecs if (curve := footprint_curves(codec))}
        if any(len(curve) > 1 for curve in curves.values()):
            with style():
                yield _figure(material, curves, styles)


def _figure(material: MaterialRows, curves: dict[str, list[tuple[int, float]]], styles: Styles) -> Figure:
    title = f"{material.name}: level of detail"
    drawing, (axes,) = plots(8.2, max(4.2, 1.6 + 0.2 * len(curves)))
    handles = [
        axes.plot(*zip(*curve, strict=True), **styles.of_codec(label), markersize=6, linewidth=1, alpha=0.9)[0]
        for label, curve in curves.items()
    ]
    sides = sorted({side for curve in curves.values() for side, _ in curve})
    axes.set_xscale("log", base=2)
    axes.set_xticks(sides, list(map(str, sides)))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.set(xlabel="footprint in texels a side", ylabel=f"display PSNR, dB ({material.deciding}; higher is better)")
    axes.set_title(f"{title}\n{material.split}", loc="left")
    if absent := [codec.label for codec in material.codecs if codec.exact and codec.measured]:
        drawing.supxlabel("not drawn, without any error: " + ", ".join(absent), fontsize=8)
    legend(axes, handles, list(curves))
    return Figure(material.name, "footprints", title, png(drawing), drawing)
