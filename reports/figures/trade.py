"""The trades of `trade.json`: PSNR against time, against bytes, and against the seconds of a fit; fronts as lines."""

import io
import re
from collections.abc import Iterator, Sequence
from typing import Any

from reports.figures.canvas import legend, log_ticks, look, new, png, style

Choice = dict[str, Any]


def figures(found: dict[str, Any]) -> Iterator[tuple[str, bytes]]:
    """File names and contents, each figure as PNG and as SVG."""
    for material in dict.fromkeys(row["material"] for row in found["choices"]):
        rows = [r for r in found["choices"] if r["material"] == material and r.get("psnr") is not None]
        fits = [fit for fit in found["training"] if fit["material"] == material]
        plain = re.sub("[^A-Za-z0-9.=_-]+", "-", material)
        with style():
            if rows:
                yield from _both(f"trade-{plain}", _fronts(material, rows))
            if fits:
                yield from _both(f"training-{plain}", _curves(material, fits))


def _both(name: str, drawing: Any) -> Iterator[tuple[str, bytes]]:
    yield f"{name}.png", png(drawing)
    out = io.StringIO()
    drawing.savefig(out, format="svg", metadata={"Date": None})
    yield f"{name}.svg", out.getvalue().encode()


def _fronts(material: str, rows: Sequence[Choice]) -> Any:
    drawing = new(11.5, 5.0, layout="constrained")
    groups: dict[str, list[Choice]] = {}
    for row in rows:
        variant = f"{row['execution']} {row['precision']}"
        groups.setdefault(row["codec"] + ("" if variant == "eager float32" else f" [{variant}]"), []).append(row)
    both = drawing.subplots(1, 2, sharey=True)
    sides = (("ns_per_sample", "fastest", "ns a sample (less is better)", ""),
             ("bytes", "smallest", "size of the file (less is better)", "B"))  # fmt: skip
    for axes, (cost, front, label, unit) in zip(both, sides, strict=True):
        handles = [_marks(axes, i, group, cost) for i, group in enumerate(groups.values())]
        best = sorted((row[cost], row["psnr"]) for row in rows if row[front])
        axes.plot(*zip(*best, strict=True), color="0.4", linewidth=1, drawstyle="steps-post", zorder=0)
        axes.set_xscale("log")
        log_ticks(axes.xaxis, unit)
        axes.set_xlabel(label)
        axes.margins(0.08)
    both[0].set_ylabel("display PSNR, dB (held-out pairs; higher is better)")
    both[0].set_title(f"{material}: speed and accuracy", loc="left")
    both[1].set_title("rate and accuracy; grey: nothing else is as good for less", loc="left")
    legend(both[1], handles, list(groups))
    return drawing


def _marks(axes: Any, index: int, group: Sequence[Choice], cost: str) -> Any:
    x, y = [row[cost] for row in group], [row["psnr"] for row in group]
    return axes.plot(x, y, **look(index), markersize=6, linestyle="none")[0]


def _curves(material: str, fits: Sequence[dict[str, Any]]) -> Any:
    drawing = new(8.2, 4.6, layout="constrained")
    axes = drawing.add_subplot()
    handles = []
    for i, fit in enumerate(fits):
        _, seconds, psnr = zip(*fit["curve"], strict=True)
        handles += axes.plot(seconds, psnr, **look(i), markersize=3, linewidth=1)
    axes.set(xlabel="seconds of the fit", ylabel="display PSNR, dB (training samples)")
    axes.set_title(f"{material}: how soon a fit is good", loc="left")
    legend(axes, handles, [fit["label"] for fit in fits])
    return drawing
