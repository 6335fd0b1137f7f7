"""The trades of `trade.json`: quality against time and against bytes, the two fronts as lines."""

from collections.abc import Iterator, Sequence
from typing import Any

from bench.records import Run, load_trade
from reports.figures.canvas import Figure, legend, log_ticks, look, new, png, style, svg

Choice = dict[str, Any]


def trade_fronts(run: Run) -> Iterator[Figure]:
    """One figure for each material whose choices were measured."""
    found = load_trade(run.folder) or {"choices": []}
    for material in dict.fromkeys(row["material"] for row in found["choices"]):
        rows = [r for r in found["choices"] if r["material"] == material and r.get("psnr") is not None]
        if rows:
            with style():
                drawing = _fronts(material, rows)
                yield Figure(material, "trade", f"{material}: speed, accuracy and bytes", png(drawing), svg(drawing))


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
