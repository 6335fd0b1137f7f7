"""The parameters of decoders and the channels of textures, ours beside those published.

The execution `gpu` is the quickest on a GPU.

Those of NeuBTF, NeuMIP and both of Rainer's are from Table 2 of Rodriguez-Pardo, Kazatzis, Lopez-Moreno, Garces:
"NeuBTF", Computers & Graphics 114 (2023); the others follow from the layers in their papers or their authors' code.
"""

from collections.abc import Callable, Iterable
from itertools import chain
from math import nan
from typing import Any, NamedTuple, cast

import pandas as pd

from bench.records import Job, as_published, grouped, shown_label
from reports.choice import Choice
from reports.numbers import NONE
from reports.table import Note, Table
from reports.values import Column, Row, Stale, written

EXECUTIONS = ("eager", "fused", "gpu")


class Published(NamedTuple):
    """The numbers in a paper: of the parameters of its decoder, and of the channels of its texture.

    docs/metrics.md says which of a codec's values count as channels.
    """

    method: str
    parameters: int
    channels: int
    ns: str = NONE  # nanoseconds a sample, mean ± deviation as printed; a dash where the paper has none


class TimedJob(Job, total=False):
    """A job with times of a sample in ns by execution (`eager`, `fused`, `gpu`), and the GPU's name."""

    ns: dict[str, float]
    gpu: str


# By codec, in the order of the rows.
PUBLISHED = {
    "neubtf": Published("NeuBTF", 3_011, 14, "251.4 ± 44.8"),
    "neubtf-direct": Published("NeuBTF", 3_011, 14, "251.4 ± 44.8"),
    "neumip": Published("NeuMIP", 3_332, 14),
    "hierarchical": Published("Hierarchical", 8_026, 14),
    "rainer2019": Published("Rainer 2019", 35_725, 14),
    "rainer2020": Published("Rainer 2020", 38_269, 38),
    "zeltner2024": Published("Zeltner 2024", 1_923, 8),
    "triple-plane": Published("Triple plane", 3_011, 8),
    "biplane": Published("Biplane", 136_451, 18),
    "neuralbtf": Published("NeuralBTF", 556_038, 8),
}
_ZELTNER_CODE = Published("Zeltner 2024 (code)", 819, 8)  # the authors' of 2026: docs/recipes.md


def parameters_table(jobs: Iterable[TimedJob], choice: Choice | None = None) -> Table | None:
    """A row for each different decoder among finished jobs of the codecs in `PUBLISHED`; None if there is none.

    The rows of a codec begin with its published recipe; ours follows. A job without the field `run` was not measured:
    `bench.conformance.verdicts.job_of_counts` made it only to count its parameters.
    """
    # The jobs of each row.
    jobs = [*jobs]
    measured = {PUBLISHED[job["codec"]].method for job in jobs if job["status"] == "ok" and job["codec"] in PUBLISHED}
    if choice:
        jobs = [cast(TimedJob, job) for job in choice.of_jobs(jobs)]
    finished = [job for job in jobs if job["status"] == "ok" and job["codec"] in PUBLISHED]
    decoders = grouped(finished, _decoder)
    if not decoders:
        return None
    # By codec and recipe. Decoders that are equal in both stay in the order of the jobs, because sorting is stable.
    keys = sorted(decoders, key=lambda key: (key.place, key.is_our_recipe))
    jobs_of_rows = [decoders[key] for key in keys]  # for each row, the jobs with its decoder
    # The job that names a row has the shortest label, which has the fewest settings.
    chosen = [min(same_decoder, key=lambda job: len(job["label"])) for same_decoder in jobs_of_rows]
    counted = list(chain.from_iterable(jobs_of_rows))

    columns = [Column("method", "", "method"), Column("codec", "", "codec")]
    for quantity in ("param.", "channels"):
        columns += [Column(quantity, "ours", f"{quantity} ours", 0), Column(quantity, "paper", f"{quantity} paper", 0)]
        columns.append(Column(quantity, "diff.", f"{quantity} difference", 0, write=_difference(quantity)))

    # Title and notes.
    title = "Decoder parameters and texture channels, beside those published"
    notes = [
        "Ours: counted by torchinfo in what a codec file decodes to. Channels and inputs: docs/metrics.md, “Tables”."
    ]
    if any("run" not in job for job in counted):
        notes += ["recipe=paper is counted in a file of a single step, which changes no count; nothing else is of it."]
    absent = dict.fromkeys(paper.method for paper in PUBLISHED.values() if paper.method not in measured)
    if absent:
        notes.append(f"{NONE} {', '.join(absent)}: no codec of this method was measured.")

    # The counts, and to their right the times, if a job has any.
    stale = Stale(jobs)
    rows = []
    for job in chosen:
        paper = _published(job)
        row: dict[str, Any] = {"method": paper.method, "codec": shown_label(job), "ns paper": paper.ns}
        row |= _beside("param.", cast(int, job["parameters"]), paper.parameters)
        rows.append(row | _beside("channels", job["cost"]["texture_channels"], paper.channels))
    times = [_times(same_decoder) for same_decoder in jobs_of_rows]
    if any(times):
        gpus = sorted({job["gpu"] for job in counted if "gpu" in job})
        columns += [Column("a sample", "ns eager", "eager", 0), Column("a sample", "ns fused", "fused", 0)]
        if gpus:
            columns.append(Column("a sample", "ns GPU", "gpu", 1))
        columns.append(Column("a sample", "ns paper", "ns paper"))
        rows = [row | {name: ns.get(name, nan) for name in EXECUTIONS} for row, ns in zip(rows, times, strict=True)]
        about_times = "Times: ours of one CPU thread (docs/trade.md); the paper's of a GPU that it does not name."
        if gpus:
            about_times += f" GPU: {', '.join(gpus)}; the quickest execution in float32, of batches of 2^20."
        notes.append(Note((about_times, lambda name: name == "a sample")))
    values = pd.DataFrame(rows)
    values["stale"] = [stale.of(job.get("job", "") for job in same_decoder) for same_decoder in jobs_of_rows]
    return written("parameters", title, values, columns, notes, words=2)


class _Decoder(NamedTuple):
    """What tells decoders apart, a row for each; the first two also order the rows."""

    place: int  # of the codec in `PUBLISHED`
    is_our_recipe: bool
    parameters: int
    channels: int  # of the texture


def _decoder(job: Job) -> _Decoder:
    """The decoder of a job, as a key."""
    # A codec without the setting `recipe` has only the one that was published.
    is_our_recipe = "recipe" in job.get("settings", {}) and not as_published(job)
    place = list(PUBLISHED).index(job["codec"])
    return _Decoder(place, is_our_recipe, cast(int, job["parameters"]), job["cost"]["texture_channels"])


def _beside(quantity: str, ours: int, published: int) -> dict[str, int]:
    """The values of a quantity: our number, the published one, and ours − published."""
    return {f"{quantity} ours": ours, f"{quantity} paper": published, f"{quantity} difference": ours - published}


def _difference(quantity: str) -> Callable[[Row], str]:
    """A function that writes the difference of a quantity with its sign."""

    def write(row: Row) -> str:
        """The difference of a row; 0 has no sign."""
        difference = row[f"{quantity} difference"]
        return f"{difference:+,}" if difference else "0"

    return write


def _times(same_decoder: Iterable[TimedJob]) -> dict[str, float]:
    """The ns of a sample by execution, from all jobs with one decoder; if several jobs timed an execution, of the
    last."""
    times: dict[str, float] = {}
    for job in same_decoder:
        times |= job.get("ns", {})
    return times


def _published(job: Job) -> Published:
    """The numbers that belong beside a job: those of its codec's paper or, for edition=code, of the authors' code."""
    if job.get("settings", {}).get("edition") == "code":  # only zeltner2024 has this setting
        return _ZELTNER_CODE
    return PUBLISHED[job["codec"]]
