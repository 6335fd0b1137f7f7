"""Draws tables and figures from records and the arrays that they name; measures nothing.

docs/structure.md defines the words of tables.

The functions import what they need when they are called, so that `import reports` loads nothing that draws.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pandas as pd

    from bench.records import Job, Run, Stress
    from reports.choice import Choice
    from reports.parameters import TimedJob
    from reports.table import Table

_NO_NUMBERS = "no job of this run has numbers: `neubtf-bench table unfinished` says why"
_NO_VALIDATION = (
    "no codec has scores of validation pairs, by which settings are chosen, on each surface of this run: choose "
    "surfaces with --material, or measure with `validation = true` under [data], as `neubtf-bench run budgets` does"
)
# By kind of table, in the order of a report: why a run may have no table of that kind, in words for a reader.
WHY_EMPTY = {
    "front": _NO_VALIDATION,
    "curves": (
        "no codec has a curve on each surface of this run that reaches 32 bits a texel: that takes three settings of "
        "it, and scores of validation pairs, as `validation = true` under [data] gives them"
    ),
    "budgets": _NO_VALIDATION,
    "when": _NO_VALIDATION,
    "ranks": "fewer than two codecs have a rung at 32 bits a texel on each of three or more surfaces",
    "rungs": _NO_VALIDATION,
    "summary": (
        "fewer than two codecs have numbers that can be compared: `neubtf-bench table main` shows what there is, "
        "`neubtf-bench table unfinished` what failed"
    ),
    "main": _NO_NUMBERS,
    "slices": _NO_NUMBERS,
    "angular": _NO_NUMBERS,
    "radiance": _NO_NUMBERS,
    "footprints": _NO_NUMBERS,
    "scene": "the run has no scores in a scene: give `run` a --scene",
    "fits": "no fit recorded a curve: only codecs that are fitted in steps do",
    "times": "no setting was timed apart from a surface: `neubtf-bench time` does",
    "trade": "no trade was measured: `neubtf-bench trade` measures one, into the folder of its run",
    "paper": "this run has none of the materials of the paper's table: `neubtf-bench run paper` measures them",
    "parameters": "this run has none of the codecs of the paper's table",
    "ablation": "this run has nothing of the suite `ablation`: `neubtf-bench run ablation` measures it",
    "stress": "there is no stress test beside this run: `neubtf-bench stress` makes one",
    "unfinished": "every job has a result",
}
KINDS = tuple(WHY_EMPTY)
FORMATS = ("text", "markdown", "latex", "csv", "raw")
# The kinds that show only jobs with a score of validation pairs, by which they choose settings.
BY_BUDGET = ("front", "curves", "budgets", "when", "ranks", "rungs")
BY_MATERIAL = ("main", "slices", "angular", "radiance", "footprints", "scene")  # kinds of `reports.by_material`
OF_WORDS = ("stress", "unfinished")  # the kinds whose cells are words, such as verdicts


@dataclass(frozen=True)
class Report:
    """A report that was written: its tables for a terminal, and its files."""

    text: str
    files: list[Path]


def table_text(
    runs: str | Path | Sequence[str | Path],
    format: str = "text",
    kind: str | None = None,
    choice: "Choice | None" = None,
    whole: bool = False,
) -> str:
    """The tables of a run, or of several together, as `text`, `markdown`, `latex`, `csv` or `raw`.

    `runs` are folders of runs, or files of published records. Of a job that several have, the last counts.

    `kind` picks one kind of table in `KINDS`. By default all kinds are given; as text they are then in the shorter
    form for a terminal, unless there is a `choice`. A `choice` selects and renames codecs, materials and columns. With
    `whole`, the table `paper` is followed by one with a row for every fit, and `trade` has every choice.

    `csv` has the cells of the tables. `raw` is a CSV with unrounded numbers: one row a job with every number of its
    record, whatever the kind; but for the kind `trade`, one row for each codec, execution and precision that
    `neubtf-bench trade` timed.

    Raises `InputError` if the folder holds no run, or not what is chosen, and if a table has no rows and a line of the
    records is damaged, so that they may stand there; `ValueError` for an unknown format or kind.
    """
    from bench.records import refuse_damaged
    from reports.tables import all_tables
    from reports.terminal import terminal

    if format not in FORMATS:
        raise ValueError(f"format {format!r}: choose one of {', '.join(FORMATS)}")
    if kind not in (None, *KINDS):
        raise ValueError(f"kind {kind!r}: choose one of {', '.join(KINDS)}")
    run = _together(runs, kind)
    if choice:
        run = choice.of_run(run)
    if format == "text" and kind is None and not choice:
        return terminal(run)  # which says itself that lines are damaged
    if format == "raw":
        text = raw(run, kind)
    else:
        # A page of LaTeX is too narrow for all columns of a main table; a reader who picks columns decides that alone.
        narrow = format == "latex" and not (choice and choice.columns)
        against = choice.against if choice else ""
        text = _formatted(all_tables(run, narrow, kind, against, whole), format, choice)
    if not text.strip() and kind != "unfinished":  # what was planned, and has no result, is known without the records
        refuse_damaged(_folders(runs))
    return text


def table_values(kind: str, runs: str | Path | Sequence[str | Path]) -> "pd.DataFrame":
    """The numbers of a kind of table as a frame of floats: a row for each of its rows, NaN where it has no number.

    Its first columns, such as that of the codec, and those of words alone, have words. `attrs` has the `titles`, the
    `notes`, and by column the `units` and the `directions`, the better ends; of a column that several tables have, they
    are those of the last. Several tables of a kind stand one below the other, with the title of each as the first level
    of the index. `runs` are as for `table_text`.

    Raises `InputError` if there is no such table, perhaps because a line of the records is damaged, or the kind is one
    of `OF_WORDS`.
    """
    import pandas as pd

    from bench.inputs.errors import InputError
    from bench.records import refuse_damaged
    from reports.tables import all_tables

    of_numbers = [each for each in KINDS if each not in OF_WORDS]
    if kind not in of_numbers:
        raise InputError(f"table_values: not of the kind {kind!r}: choose one of {', '.join(of_numbers)}")
    tables = all_tables(_together(runs, kind), kind=kind)
    if not tables:
        refuse_damaged(_folders(runs))
        raise InputError(f"table_values: no such table: {WHY_EMPTY[kind]}")
    titles = [table.title for table in tables]
    frames = []
    notes: list[str] = []
    units: dict[str, str] = {}
    directions: dict[str, str] = {}
    for table in tables:
        assert table.values is not None  # every table of numbers has them
        frames.append(table.values)
        notes += map(str, table.notes)
        units |= table.values.attrs["units"]
        directions |= table.values.attrs["directions"]
    numbers = frames[0] if len(frames) == 1 else pd.concat(frames, keys=titles)
    numbers.attrs = {"titles": titles, "notes": list(dict.fromkeys(notes)), "units": units, "directions": directions}
    return numbers


def raw(run: "Run", kind: str | None = None) -> str:
    """As CSV, nothing rounded: a row a job with every number of its record, as in `bench.load_runs`; of the kind
    `trade` a row a choice."""
    import pandas as pd

    from bench.compare.frame import frame_of
    from bench.inputs.errors import visible

    frame = pd.DataFrame(run.choices) if kind == "trade" else frame_of(run)
    printable = frame.map(lambda value: visible(value) if isinstance(value, str) else value)
    return printable.to_csv(index=False, lineterminator="\n")


def _folders(runs: str | Path | Sequence[str | Path]) -> Sequence[str | Path]:
    """The folders or files of records that `runs` names: one, or several."""
    return [runs] if isinstance(runs, str | Path) else runs


def _together(runs: str | Path | Sequence[str | Path], kind: str | None) -> "Run":
    """The runs as one, of which tables of a kind are made."""
    from bench.compare.choosing import has_validation
    from bench.records import load_together

    # A job that tables of budgets cannot show must not replace one that they can. `beside`: a job on other data than
    # those of published records stands beside them, instead of raising an error.
    return load_together(_folders(runs), wanted=lambda job: kind not in BY_BUDGET or has_validation(job), beside=True)


def parameters_text(jobs: Sequence["TimedJob"], format: str = "text", choice: "Choice | None" = None) -> str:
    """The table of parameters alone: those of decoders and the channels of textures, beside the published numbers.

    It takes any records that say `codec`, `label`, `status`, `parameters` and `cost`. As `raw` it is the same as `csv`.
    """
    from reports.parameters import parameters_table

    return _formatted([parameters_table(jobs, choice)], format, choice)


def paper_text(
    run: "Run",
    absent: Mapping[str, str],
    format: str = "text",
    choice: "Choice | None" = None,
    whole: bool = False,
) -> str:
    """Only the table of our quality beside that of the NeuBTF paper; with `whole`, also a row for every fit.

    `absent` maps a material of that table that no job of the run names to words on where to get it.
    """
    from reports.tables import all_tables

    return _formatted(all_tables(run, kind="paper", whole=whole, absent=absent), format, choice)


def _formatted(tables: Iterable["Table | None"], format: str, choice: "Choice | None" = None) -> str:
    """The text of tables in one of `FORMATS`, after the choice is made; here `raw` is the same as `csv`.

    A table is None where there is nothing to show; it is left out.
    """
    from reports import text

    writers = {"text": text.plain, "markdown": text.markdown, "latex": text.latex}
    write = writers.get(format, text.table_csv)  # `csv` and `raw`
    made = [table for table in tables if table]
    if choice:
        made = choice.of_tables(made)
    return write(made)


def score_text(record: "Job") -> str:
    """The tables of a codec file that was scored outside a run: bytes, quality, errors by direction and footprint.

    The record has the fields that every job of a run has, such as `job` and `status`.
    """
    from bench.records import Records, Run
    from reports.terminal import scored

    run_of_one_job = Run(Path(), jobs=Records({record["job"]: record}))  # these tables read nothing of its folder
    return scored(run_of_one_job)


def stress_text(records: Sequence["Stress"], format: str = "text") -> str:
    """Only the tables of the stress test, which fits codecs to extreme materials; `records` are its results."""
    from reports.stress import tables

    return _formatted(tables(records), format)


def write_report(run_folder: str | Path, vector: bool = False) -> Report:
    """Write `tables/`, `figures/` and `report.html` into a run's folder, each file completely or not at all.

    `vector` also writes every figure as SVG and PDF. Without it, the formats that an earlier report wrote are drawn
    again, because a report removes the old figures.
    `InputError` if the folder holds no run.
    """
    from reports.write import write

    return write(Path(run_folder), vector)


def write_history(frame: "pd.DataFrame", folder: Path) -> list[Path]:
    """Draw quality, bytes and time of each codec over the code revisions at which runs were measured, given the frame
    of their jobs by `bench.load_runs`.

    Writes figures and `history.html` into the folder; returns the paths of the files, `history.html` last.
    """
    from reports.write import write_history

    return write_history(frame, folder)
