"""show how each codec did from run to run: a table, or plots over revisions

With `--plot` it draws quality, bytes and time of each codec over the revisions into a folder: a figure a material as
PNG and SVG, and a page, history.html. In Python, `bench.load_runs(paths)` has every number of every job as a pandas
frame, which `to_csv` writes.

examples:
  neubtf-bench history runs/*
  neubtf-bench history runs/* --plot plots
"""

import argparse
import math
import re
from pathlib import Path

import pandas as pd
from tabulate import tabulate

from bench.cli.commands import say_line
from bench.compare.frame import load_runs
from bench.inputs.errors import FINE, NOTHING, visible, writable
from bench.metrics import in_decibels, is_relative, label_of
from bench.records import grouped
from reports import write_history
from reports.numbers import NONE


def arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command to its parser."""
    parser.add_argument("runs", nargs="+", metavar="RUN", help="folders of runs, or files of records (.jsonl)")
    parser.add_argument("--plot", type=Path, metavar="FOLDER", help="draw each codec over the revisions")


def run(options: argparse.Namespace) -> int:
    """Print or plot the records of many runs; returns `FINE`, or `NOTHING` if they have no jobs."""
    frame = load_runs(options.runs)
    if frame.empty:
        print("these runs have no records of jobs")
        return NOTHING
    if not options.plot:
        print(_table_of_means(frame))
        return FINE
    with writable(options.plot, "choose another --plot"):
        written = write_history(frame, options.plot)
    for path in written:
        say_line(f"wrote {path}")
    return FINE


def _table_of_means(frame: pd.DataFrame) -> str:
    """Means over seeds: a line for each start of a run in which a codec was measured."""
    # The column of each revision: that of the suite, and of a codec that has a repository of its own.
    revisions = {"revision": "git"}
    if "fitted/codec" in frame and frame["fitted/codec"].notna().any():
        revisions["codec's revision"] = "fitted/codec"
    metrics, decibels = _heldout_scores(frame)
    forms = {"parameters": ",.0f", "bytes/total": ",.0f"}  # by column of numbers
    forms |= {metric: ".2f" if metric in decibels else ".4f" for metric in metrics}
    in_order = frame.assign(**metrics).sort_values(["material", "label", "started", "folder"], kind="stable")
    keys = ["material", "label", "folder", "started", *revisions.values()]
    rows = []
    for (material, label, folder, started, *of_code), jobs in in_order.groupby(keys, sort=False, dropna=False):
        cells = [visible(str(name)) for name in (material, label, folder)]
        cells.append(f"{started:%Y-%m-%d %H:%M}" if isinstance(started, pd.Timestamp) else NONE)  # a missing one is NaT
        cells += [revision if isinstance(revision, str) else NONE for revision in of_code]  # a missing one is NaN
        cells.append(f"{(jobs['status'] == 'ok').sum()} of {len(jobs)}")
        for column, form in forms.items():
            mean = jobs[column].mean() if column in jobs else math.nan
            cells.append(NONE if math.isnan(mean) else f"{mean:{form}}")
        rows.append(cells)
    headers = ["material", "codec", "run", "started", *revisions, "jobs", "parameters", "bytes", *metrics]
    aligned = ["left"] * (5 + len(revisions)) + ["right"] * len(forms)
    return tabulate(rows, headers, "simple", colalign=aligned, disable_numparse=True)


def _heldout_scores(frame: pd.DataFrame) -> "tuple[dict[str, pd.Series[float]], set[str]]":
    """The scores of held-out pairs by the metric's label, and the labels of those in decibels.

    A label may stand for several variants of a metric; each job has a score of the variant that it measured.
    """
    # The column of each metric: the mean over slices where a metric has one, else the score of all pairs pooled.
    chosen: dict[str, str] = {}
    for column in map(str, frame.columns):
        match = re.fullmatch("scores/heldout/metrics/(.*)/(mean|pooled)", column)
        if not match:
            continue
        name, kind = match.groups()
        if not is_relative(name) and (kind == "mean" or name not in chosen):
            chosen[name] = column
    numbers = {}
    for label, names in grouped(chosen, label_of).items():
        variants = frame[[chosen[name] for name in names]]
        numbers[label] = variants.bfill(axis=1).iloc[:, 0]  # the first variant that a job has
    decibels = {label_of(name) for name in chosen if in_decibels(name)}
    return numbers, decibels
