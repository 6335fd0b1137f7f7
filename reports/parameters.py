"""The parameters of decoders and the channels of textures, ours beside those published.

Published numbers of NeuBTF, NeuMIP and both of Rainer's are from Table 2 of Rodriguez-Pardo, Kazatzis, Lopez-Moreno,
Garces: "NeuBTF", Computers & Graphics 114 (2023); the others follow from the layers in their papers or their authors'
code.
"""

from collections.abc import Collection, Iterable, Sequence
from functools import partial
from math import nan
from typing import Any, NamedTuple, cast

import pandas as pd

from bench.codecs.alike import stale
from bench.records import Job, as_published, grouped
from reports.choice import Choice
from reports.numbers import NONE
from reports.table import Note, Table
from reports.values import Column, Row, written

EXECUTIONS = ("eager", "fused", "gpu")  # `gpu`: the quickest on a GPU


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
    all_jobs = [*jobs]
    chosen_jobs = [cast(TimedJob, job) for job in choice.of_jobs(all_jobs)] if choice else all_jobs
    counted = _finished(chosen_jobs)
    if not counted:
        return None
    older = stale(chosen_jobs)
    jobs_of_decoder = grouped(counted, _decoder)
    # By codec and recipe. Decoders that are equal in both stay in the order of the jobs, because sorting is stable.
    in_order = sorted(jobs_of_decoder, key=lambda decoder: (decoder.place, decoder.is_our_recipe))
    values = pd.DataFrame([_values_of_decoder(jobs_of_decoder[decoder], older) for decoder in in_order])
    gpus = sorted({job["gpu"] for job in counted if "gpu" in job})

    columns = [Column("method", "", "method"), Column("codec", "", "codec")]
    for quantity in ("param.", "channels"):
        columns += [Column(quantity, "ours", f"{quantity} ours", 0), Column(quantity, "paper", f"{quantity} paper", 0)]
        columns.append(Column(quantity, "diff.", f"{quantity} difference", write=partial(_difference_cell, quantity)))
    notes = _notes_on_counts(counted, methods={PUBLISHED[job["codec"]].method for job in _finished(all_jobs)})
    if any(job.get("ns") for job in counted):  # the times stand to the right of the counts
        columns += _time_columns(gpus)
        notes.append(_note_on_times(gpus))
    title = "Decoder parameters and texture channels, beside those published"
    return written("parameters", title, values, columns, notes, words=2)


def _finished(jobs: Iterable[TimedJob]) -> list[TimedJob]:
    """The finished jobs of the codecs in `PUBLISHED`."""
    return [job for job in jobs if job["status"] == "ok" and job["codec"] in PUBLISHED]


def _values_of_decoder(same_decoder: Sequence[TimedJob], older: Collection[str]) -> dict[str, Any]:
    """The values of the row of some jobs with one decoder: the counts, and the times in ns, NaN where none was timed.

    The job that names the row has the shortest label, which has the fewest settings. `older` are names of stale jobs.
    """
    job = min(same_decoder, key=lambda job: len(job["label"]))
    paper = _published(job)
    ns: dict[str, float] = {}  # by execution: of the job that names the row or, without one, of the first that has it
    for each in (job, *same_decoder):
        ns = each.get("ns", {}) | ns
    return {
        "method": paper.method,
        "codec": job["label"],
        "ns paper": paper.ns,
        **_ours_and_published("param.", cast(int, job["parameters"]), paper.parameters),
        **_ours_and_published("channels", job["cost"]["texture_channels"], paper.channels),
        **{name: ns.get(name, nan) for name in EXECUTIONS},
        "stale": any(each.get("job") in older for each in same_decoder),
    }


def _notes_on_counts(counted: Iterable[TimedJob], methods: Collection[str]) -> list[str]:
    """How the jobs of the table were counted, and which methods are not among the `methods` that were measured."""
    notes = [
        "Ours: counted by torchinfo in what a codec file decodes to. Channels and inputs: docs/metrics.md, “Tables”."
    ]
    if any("run" not in job for job in counted):
        notes.append(
            "recipe=paper is counted in a file of a single step, which changes no count; nothing else is of it."
        )
    absent = dict.fromkeys(paper.method for paper in PUBLISHED.values() if paper.method not in methods)
    if absent:
        notes.append(f"{NONE} {', '.join(absent)}: no codec of this method was measured.")
    return notes


def _time_columns(gpus: Sequence[str]) -> list[Column]:
    """The columns of the times of a sample; `gpus` are the names of the GPUs on which some were timed."""
    columns = [Column("a sample", "ns eager", "eager", 0), Column("a sample", "ns fused", "fused", 0)]
    if gpus:
        columns.append(Column("a sample", "ns GPU", "gpu", 1))
    return [*columns, Column("a sample", "ns paper", "ns paper")]


def _note_on_times(gpus: Sequence[str]) -> Note:
    """The note on the columns of `_time_columns`."""
    text = "Times: ours of one CPU thread (docs/trade.md); the paper's of a GPU that it does not name."
    if gpus:
        text += f" GPU: {', '.join(gpus)}; the quickest execution in float32, of batches of 2^20."
    return Note((text, lambda name: name == "a sample"))


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


def _ours_and_published(quantity: str, ours: int, published: int) -> dict[str, int]:
    """The values of a quantity: our number, the published one, and ours − published."""
    return {f"{quantity} ours": ours, f"{quantity} paper": published, f"{quantity} difference": ours - published}


def _difference_cell(quantity: str, row: Row) -> str:
    """The difference of a quantity with its sign; 0 has none."""
    difference = row[f"{quantity} difference"]
    return f"{difference:+,}" if difference else "0"


def _published(job: Job) -> Published:
    """The numbers that belong beside a job: those of its codec's paper or, for edition=code, of the authors' code."""
    if job.get("settings", {}).get("edition") == "code":  # only zeltner2024 has this setting
        return _ZELTNER_CODE
    return PUBLISHED[job["codec"]]
