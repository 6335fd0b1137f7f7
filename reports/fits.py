"""The convergence of fits, from the curves in their records.

A codec that is fitted in steps measures its PSNR at some of them; the points of that curve are the field `history` of
the job's record. A *goal* is a PSNR that a fit should reach soon. PSNR is in dB, of pictures as a display shows them.
"""

from collections.abc import Iterator, Sequence
from math import nan
from typing import NamedTuple

import pandas as pd

from bench.records import Job, Run, as_published, grouped, method_of
from reports.rows import materials
from reports.table import Table
from reports.values import Column, written

GOALS_DB = (30, 35)  # tables show how soon each is reached
NOTE = (
    "Display PSNR of training samples, which the fit measures at times: it reached the goal at the given step or "
    "earlier. Seconds hold for this machine, steps for any. Memory: the most at once, of a CPU's whole process with "
    "the BTF that it holds, or of a GPU. If there are several seeds, this is the first."
)


class FitCurve(NamedTuple):
    """One job's curve, from its beginning."""

    codec: str
    label: str  # the codec with its settings
    points: list[tuple[int, float, float]]  # step, seconds, display PSNR in dB
    direct: float  # share of the steps that NeuBTF's first stage takes, without its autoencoder; 0 without that stage
    published: bool  # whether it is by the recipe of the codec's paper
    memory: float  # bytes at most while it was fitted; NaN where nobody counted them
    stale: bool  # whether the installed version cannot make it again


def curves_by_material(run: Run) -> dict[str, list[FitCurve]]:
    """By name of a material: the curves of its fits, one a codec, of the first seed.

    Materials without any curve are absent.
    """
    by_material: dict[str, list[FitCurve]] = {}
    for material in materials(run):
        curves = []
        for row in material.shown:
            points = []
            for point in row.job.get("history", ()):
                if "seconds" in point and "psnr" in point:  # a codec may leave them out
                    points.append((point["step"], point["seconds"], point["psnr"]))
            if points:
                published = as_published(row.job)
                memory = row.job.get("fit_memory", nan)
                direct = _share_of_direct(row.job)
                stale = bool(row.values["stale"])
                curves.append(FitCurve(method_of(row.job), row.label, points, direct, published, memory, stale))
        if curves:
            by_material[material.name] = curves
    return by_material


def _share_of_direct(job: Job) -> float:
    """The share of a fit's steps before NeuBTF's autoencoder makes the texture; 0 for a fit without such a stage."""
    share = job.get("settings", {}).get("direct", 0)
    return share if isinstance(share, float) and not as_published(job) else 0.0


def stages_note(curves: Sequence[FitCurve]) -> str:
    """Why a curve drops in the middle of a fit, in words for a reader; "" where none has such a stage."""
    by_share = grouped([fit for fit in curves if fit.direct], lambda fit: fit.direct)
    drops = []
    for share, fits in by_share.items():
        codecs = dict.fromkeys(fit.codec for fit in fits)  # each once
        drops.append(f"{', '.join(codecs)}: quality drops after {100 * share:.0f} % of the steps")
    if not drops:
        return ""
    return f"{'; '.join(drops)}, where an untrained autoencoder takes the place of the texture."


def fit_tables(run: Run) -> Iterator[Table]:
    """A table for each material with curves: the end of each fit, then steps and seconds to each goal."""
    columns = [Column("codec", "", "codec"), Column("end", "dB ↑", "psnr", 2)]
    columns += [Column("steps", "", "steps", 0), Column("time", "s ↓", "seconds", -2)]
    columns.append(Column("memory", "MiB ↓", "memory", 0, ranked=False))
    for goal in GOALS_DB:
        columns.append(Column(f"to {goal} dB", "steps ↓", f"steps to {goal}", 0))
        columns.append(Column(f"to {goal} dB", "s ↓", f"seconds to {goal}", -2))
    for name, curves in curves_by_material(run).items():
        values = pd.DataFrame([_values_of_fit(fit) for fit in curves])
        yield written("fits", f"{name}: how soon a fit is good", values, columns, [NOTE], material=name)


def _values_of_fit(fit: FitCurve) -> dict[str, str | float]:
    """PSNR, steps, seconds and memory at the end of a fit, then steps and seconds to each goal; NaN without one."""
    steps, seconds, psnr = fit.points[-1]
    row: dict[str, str | float] = {"codec": fit.label, "psnr": psnr, "steps": steps, "seconds": seconds}
    row |= {"memory": fit.memory / 2**20, "stale": fit.stale}
    for goal in GOALS_DB:
        reached = [(step, second) for step, second, quality in fit.points if quality >= goal]
        row[f"steps to {goal}"], row[f"seconds to {goal}"] = reached[0] if reached else (nan, nan)
    return row
