"""compare two runs, or a run with a reference: what got worse by more than chance

Parameters and bytes must be the same. FLIP of held-out pairs, and the mean PSNR of slices (of held-out pairs, of those
at grazing directions, over footprints, and of training pairs) must be within a margin that the table shows: for each
row, for each codec over its materials, and for all codecs together. Other numbers are only shown; a longer time gives
advice. Exit codes: 0 nothing got worse; 1 a regression, or a row that vanished or is not comparable and that --allow
does not name; 2 BASE is damaged; 3 a job failed; 4 nothing can be compared. Two stress tests are compared cell by cell,
as text.

examples:
  neubtf-bench compare bench/compare/references/ci.jsonl runs/ci
  neubtf-bench compare runs/before runs/after --markdown verdict.md
"""

import argparse
from pathlib import Path

from bench.cli.commands import several, write_text
from bench.compare.comparison import compare, compare_extremes
from bench.compare.forms import annotations, junit, tracker
from bench.files.atomic import begins, refuse_other_kind
from bench.inputs.errors import InputError
from bench.records import load_run
from reports.comparison import markdown, terminal


def arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command to its parser."""
    add = parser.add_argument
    add("base", metavar="BASE", help="the folder of a run, or a file of records such as a reference")
    add("new", metavar="NEW", help="the folder or file of records to judge")
    several(parser, "--material", "only this material; repeatable")
    several(parser, "--codec", "only this codec; repeatable")
    gone = "accept that this codec, label, material, MATERIAL/LABEL or pattern is gone or incomparable; repeatable"
    several(parser, "--allow", gone, "NAME")
    add("--markdown", type=Path, metavar="FILE", help="write the verdict as GitHub Markdown")
    add("--junit", type=Path, metavar="FILE", help="write the verdict as JUnit XML")
    add("--tracker", type=Path, metavar="FOLDER", help="write the numbers of NEW for github-action-benchmark")
    add("--annotations", action="store_true", help="also print annotations for GitHub")


def run(options: argparse.Namespace) -> int:
    """Print the comparison, and write the files that are asked for; returns the exit code of the comparison."""
    base, new = load_run(options.base), load_run(options.new)
    for name, each in ((options.base, base), (options.new, new)):
        if each.jobs and each.stress:
            raise InputError(f"{name}: it holds jobs and a stress test: compare each from a file of its own")
    if base.stress:
        of_jobs = ("material", "markdown", "junit", "tracker", "annotations")
        ignored = [f"--{name}" for name in of_jobs if getattr(options, name)]
        if ignored:
            raise InputError(f"{', '.join(ignored)}: not for stress tests, which are compared as text: leave it out")
        text, code = compare_extremes(base, new, options.codec, options.allow)
        print(text)
        return code
    if options.markdown:
        refuse_other_kind(options.markdown, ".md", begins(b"### neubtf-bench"))
    if options.junit:
        refuse_other_kind(options.junit, ".xml", begins(b"<?xml"))
    comparison = compare(base, new, options.material, options.codec, options.allow)
    print(terminal(comparison))
    if options.annotations:
        print(annotations(comparison))
    if options.markdown:
        write_text(options.markdown, markdown(comparison))
    if options.junit:
        write_text(options.junit, junit(comparison))
    if options.tracker:
        for name, text in tracker(new).items():
            write_text(options.tracker / name, text)
    return comparison.exit_code
