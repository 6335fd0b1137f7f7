"""Quality against the angle of view, which shows the loss toward the horizon."""

import numpy as np

from bench.metrics.psnr import psnr
from bench.records import PSNR, Run
from reports.artefacts import Arrays, of_shown
from reports.figures.canvas import Figure, legend, of_each_material, plots, png
from reports.rows import MaterialRows, Row
from reports.styles import Styles

EDGES_DEG = np.arange(0.0, 91.0, 15.0)
_READ = {PSNR, "heldout", "wo_deg", "wi_deg"}


@of_each_material
def angle_curves(run: Run, material: MaterialRows) -> Figure | None:
    """Display PSNR, pooled over rings of 15° in θ_o and in θ_i, of the pairs that decide."""
    curves, styles = of_shown(run, material, "slices", _READ), Styles(run)
    if not curves:
        return None
    title = f"{material.name}: quality by angle"
    drawing, panels = plots(10, max(4.0, 1.6 + 0.2 * len(curves)), 2)
    for axes, side, name in zip(panels, ("wo_deg", "wi_deg"), ("view, θₒ", "light, θᵢ"), strict=True):
        handles = [
            axes.plot(*_rings(row, scores, side), **styles.of_codec(row.label), markersize=5, linewidth=1.2)[0]
            for row, scores in curves
        ]
        axes.set(xlabel=f"{name} in degrees", xlim=(0, 90), xticks=EDGES_DEG)
    panels[0].set_ylabel(f"display PSNR, dB ({material.deciding}; higher is better)")
    panels[0].set_title(f"{title}\n{material.split}", loc="left")
    names = [f"{row.label} (no error)" if row.psnr is None else row.label for row, _ in curves]
    legend(panels[1], handles, names)
    return Figure(material.name, "angles", title, png(drawing), drawing)


def _rings(row: Row, scores: Arrays, side: str) -> tuple[np.ndarray, np.ndarray]:
    """Centres of the rings that hold a pair, and PSNR of the mean squared error there; no point if the error is 0."""
    chosen = scores["heldout"] if row.gate == "heldout" else np.ones(len(scores["heldout"]), bool)
    error, theta = scores[PSNR][chosen], scores[side][chosen, 0]
    ring = np.clip(np.searchsorted(EDGES_DEG, theta + 1e-4, side="right") - 1, 0, len(EDGES_DEG) - 2)
    means = {int(i): error[ring == i].mean() for i in np.unique(ring)}
    centres = np.array([EDGES_DEG[i] + 7.5 for i, mean in means.items() if mean > 0])
    return centres, psnr(np.array([mean for mean in means.values() if mean > 0]))
