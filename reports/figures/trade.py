"""The trades of `trade.json`: quality against time and against bytes, the two fronts as lines."""

from collections.abc import Iterator, Sequence
from typing import Any

from bench.records import Record, Run, load_trade
from reports.figures.canvas import Figure, legend, log_ticks, plots, png, style
from reports.styles import Styles


def trade_fronts(run: Run) -> Iterator[Figure]:
    """One figure for each material whose choices were measured."""
    trade = load_trade(run.folder) or {"choices": []}
    for material in dict.fromkeys(row["material"] for row in trade["choices"]):
        rows = [r for r in trade["choices"] if r["material"] == material and r.get("psnr") is not None]
        if rows:
            with style():
                drawing = _fronts(material, rows, Styles(run))
                yield Figure(material, "trade", f"{material}: speed, accuracy and bytes", png(drawing), drawing)


def _fronts(material: str, rows: Sequence[Record], styles: Styles) -> Any:
    groups: dict[str, list[Record]] = {}
    for row in rows:
        how = "" if _plain(row) else f" [{row['execution']} {row['precision']}]"
        groups.setdefault(row["codec"] + how, []).append(row)
    drawing, (speed, rate) = plots(11.5, max(5.0, 1.4 + 0.2 * len(groups)), 2)
    handles = [_marks(speed, _look(styles, name), group, "ns_per_sample") for name, group in groups.items()]
    for name, group in groups.items():
        _marks(rate, _look(styles, name), list(filter(_plain, group)), "bytes")  # executions do not change bytes
    _front(speed, [row for row in rows if row["fastest"]], "ns_per_sample", "ns a sample (less is better)", "")
    _front(rate, [row for row in rows if row["smallest"]], "bytes", "size of the file (less is better)", "B")
    speed.set_ylabel("display PSNR, dB (held-out pairs; higher is better)")
    speed.set_title(f"{material}: speed and accuracy", loc="left")
    rate.set_title("rate and accuracy; grey: no other is as good for less", loc="left")
    legend(rate, handles, list(groups))
    return drawing


def _plain(row: Record) -> bool:
    return (row["execution"], row["precision"]) == ("eager", "float32")


def _look(styles: Styles, name: str) -> dict[str, Any]:
    """The codec's marker; hollow for other executions and precisions than the default."""
    return styles.of_codec(name) | {"linestyle": "none"} | ({"markerfacecolor": "white"} if "[" in name else {})


def _marks(axes: Any, look: dict[str, Any], group: Sequence[Record], cost: str) -> Any:
    return axes.plot([row[cost] for row in group], [row["psnr"] for row in group], **look, markersize=6)[0]


def _front(axes: Any, best: Sequence[Record], cost: str, label: str, unit: str) -> None:
    """The front as a stair, and the axis of its cost."""
    stair = sorted((row[cost], row["psnr"]) for row in best)
    axes.plot([x for x, _ in stair], [y for _, y in stair], color="0.4", linewidth=1, drawstyle="steps-post", zorder=0)
    axes.set_xscale("log")
    log_ticks(axes.xaxis, unit)
    axes.set_xlabel(label)
    axes.margins(0.08)
