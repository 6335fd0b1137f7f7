"""print the tables of one run, or of several runs together

`table parameters` sets decoder parameters and texture channels beside those of the NeuBTF paper, each codec by the
paper's recipe first, counted in a small file that is made for it: so it needs no run. `table paper` sets quality beside
the paper's, of runs/paper and runs/paper-nearest if no run is given, and says where to get the data that are missing;
with `--all` a row for every fit stands below it.

examples:
  neubtf-bench table
  neubtf-bench table budgets runs/budgets
  neubtf-bench table main runs/quick --format latex
  neubtf-bench table summary docs/results/quick.jsonl runs/mine
  neubtf-bench table summary runs/quick --format latex --codec neubtf-direct --codec pca --column PSNR
  neubtf-bench table summary runs/quick --material satin --against pca
  neubtf-bench table main runs/quick --name neubtf-direct="NeuBTF, direct" --name "total=bytes"
"""

import argparse
import difflib
import sys
from pathlib import Path
from typing import cast

from bench.cli.commands import several
from bench.codecs.registry import codec_entries
from bench.compare.frame import fused_times, gpu_times
from bench.inputs.errors import FINE, NOTHING, InputError, did_you_mean, visible
from bench.machine.devices import is_gpu
from bench.records import FILE, STRESS, Run, Timing, load_together, require
from reports import FORMATS, KINDS, WHY_EMPTY, paper_text, parameters_text, table_text
from reports.choice import Choice, new_names
from reports.parameters import PUBLISHED, TimedJob


def arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command to its parser."""
    what = f"one kind of table ({', '.join(KINDS)}; default: all), and folders of runs or files of records (default: "
    parser.add_argument("what", nargs="*", metavar="KIND|RUN", help=f"{what}the newest run under runs/)")
    form = "the format; raw is a CSV of every number of every job (default: text)"
    parser.add_argument("--format", default="text", choices=FORMATS, help=form)
    several(parser, "--codec", "only this codec, or this row; repeatable")
    several(parser, "--material", "only this material; repeatable")
    against = "the row of the summary that the others are set against, by its label (default: of neubtf-direct)"
    parser.add_argument("--against", default="", metavar="LABEL", help=against)
    parser.add_argument(
        "--all", action="store_true", help="table paper with every fit below it, table trade with every choice"
    )
    several(parser, "--column", "only this column, by its header; repeatable")
    renamed = "rename a codec, row, column or material in rows, headers, title and notes; repeatable"
    several(parser, "--name", renamed, "WORD=NAME")


def run(options: argparse.Namespace) -> int:
    """Print the tables; returns `FINE`, or `NOTHING` if there is no such table."""
    kinds, folders = kinds_and_places(options.what)
    chosen = choice(options)
    _check_kinds(kinds, options)
    kind = kinds[0] if kinds else None
    if kind == "parameters":  # it needs no run
        print(parameters_table(folders, options.format, chosen))
        return FINE
    if kind == "paper" and options.format != "raw":  # nor does this
        print(_paper_table(folders, options.format, chosen, options.all))
        return FINE
    folders = folders or [_newest_run(kind)]
    text = table_text(folders, options.format, kind, chosen, options.all)
    if not text.strip():
        names = ", ".join(map(str, folders))
        name = f"table {kind}" if kind else "table"
        print(f"neubtf-bench: {visible(names)}: no {name}: {WHY_EMPTY[kind or 'main']}", file=sys.stderr)
        return FINE if kind == "unfinished" else NOTHING
    print(text)
    return FINE


def _check_kinds(kinds: list[str], options: argparse.Namespace) -> None:
    """Raise `InputError` for several kinds of tables, a misspelt one, and options that the kind does not have."""
    if not kinds and options.what:  # the first word may be a kind, misspelt
        word = options.what[0]
        if difflib.get_close_matches(word, KINDS, n=1) and not Path(word).exists():
            raise InputError(f"table: {word!r} is neither a kind of table nor a folder{did_you_mean(word, KINDS)}")
    if len(kinds) > 1:
        raise InputError(f"table: give one kind of table, not {' and '.join(kinds)}")
    if options.against and kinds not in ([], ["summary"]):
        raise InputError(f"--against {options.against}: the table {kinds[0]} sets none against it: give table summary")
    if options.all and kinds not in (["paper"], ["trade"]):
        raise InputError("--all: only the tables paper and trade have further rows: give table paper or table trade")
    if options.material and kinds == ["parameters"]:
        raise InputError("--material: not with the table of parameters, which no material changes: leave it out")


def kinds_and_places(words: list[str]) -> tuple[list[str], list[Path]]:
    """The kinds of tables among the words of the command, and the other words: folders of runs or files of records."""
    kinds = [word for word in words if word in KINDS]
    places = [Path(word) for word in words if word not in KINDS]
    return kinds, places


def choice(options: argparse.Namespace) -> Choice | None:
    """The rows, columns and names that the options choose; None if they choose none."""
    if not (options.codec or options.material or options.against or options.column or options.name):
        return None
    if options.against and options.format == "raw":
        raise InputError("--against: not with --format raw, which has the numbers of every job alone")
    if options.column and options.format == "raw":
        raise InputError("--column: not with --format raw, which has every number: choose --format csv")
    if options.name and options.format == "raw":
        raise InputError("--name: not with --format raw, which has the names of records: choose --format csv")
    return Choice(options.codec, options.column, new_names(options.name), options.material, options.against)


def parameters_table(folders: list[Path], format: str, chosen: Choice | None = None) -> str:
    """The table of parameters: a row for every codec as published, and one for each job of the runs.

    Without folders it is of the newest run, if there is one. A job has the times of a sample that its run measured.
    """
    folders = folders or _runs()[-1:]
    # Each folder is loaded alone, so that no job takes the place of another one of the same name.
    runs = [load_together([folder], wanted=lambda job: False) for folder in folders]
    on_gpu: dict[str, Timing] = {}  # by label
    for run in runs:
        on_gpu |= gpu_times(run)
    jobs: list[TimedJob] = []
    for run in runs:
        jobs += _timed_jobs(run, on_gpu)
    from bench.conformance.verdicts import job_of_counts  # it imports PyTorch, which no other table needs

    counted = [cast(TimedJob, job_of_counts(name)) for name in PUBLISHED if name in codec_entries()]
    return parameters_text([*counted, *jobs], format, chosen)


def _timed_jobs(run: Run, on_gpu: dict[str, Timing]) -> list[TimedJob]:
    """The jobs of a run that have a result, with the times of a sample that were measured: `on_gpu` by label."""
    fused_by_job = fused_times(run)
    jobs = []
    for job in run.jobs:
        if job["status"] != "ok":
            continue
        require(job, "tables", run.folder)
        quickest = on_gpu.get(job["label"])
        of_processor = {"eager": run.timing(job), "fused": fused_by_job.get(job["job"])}
        times = {name: time for name, time in of_processor.items() if time and _is_of_one_thread(time)}
        if quickest:
            times["gpu"] = quickest
        timed = cast(TimedJob, {**job, "ns": {key: time["ns_per_sample"] for key, time in times.items()}})
        if quickest:
            timed["gpu"] = quickest["gpu"]
        jobs.append(timed)
    return jobs


def _is_of_one_thread(timing: Timing) -> bool:
    """Whether a time is of one thread of a processor, as the table says of its times."""
    return not is_gpu(timing["device"]) and timing["threads"] == 1


def _paper_table(folders: list[Path], format: str, chosen: Choice | None, whole: bool) -> str:
    """The table of quality beside the paper's, and for each material that is not measured what is to be done.

    Without folders it is of runs/paper and runs/paper-nearest, as far as they are there.
    """
    from bench.runs.suite import load_suite  # which no other table needs

    folders = folders or [folder for folder in (Path("runs/paper"), Path("runs/paper-nearest")) if folder.is_dir()]
    # As in the table of parameters, none takes another's place: of other suites, the same names have other data.
    run = load_together(folders, wanted=lambda job: False) if folders else Run(Path())
    absent = {}
    for spec in load_suite("paper").materials:
        there = f"{spec.path} is there: `neubtf-bench run paper` measures it"
        absent[spec.name] = there if spec.existing_path() else f"{spec.path} is not there: {spec.where}"
    if chosen:
        run = chosen.of_run(run)
    return paper_text(run, absent, format, chosen, whole)


def _newest_run(kind: str | None) -> Path:
    """The newest folder of a run under runs/; for the kind `stress` that of the stress test, if it is there."""
    folders = _runs()
    if kind == STRESS and (Path("runs") / STRESS / FILE).is_file():
        return Path("runs") / STRESS
    if not folders:
        raise InputError("table: there is no run under runs/: give the folder that `neubtf-bench run` wrote")
    return folders[-1]


def _runs() -> list[Path]:
    """The folders of runs under runs/, without the stress test's, newest last."""
    files = [path for path in Path("runs").glob(f"*/{FILE}") if path.parent.name != STRESS]
    return [path.parent for path in sorted(files, key=lambda path: path.stat().st_mtime)]
