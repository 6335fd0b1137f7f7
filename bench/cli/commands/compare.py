"""compare two runs, or a run with a reference: what got worse by more than chance

Parameters and bytes must be the same. FLIP of held-out pairs, and the mean PSNR of slices (of held-out pairs, of those
at grazing directions, over footprints, and of training pairs) must be within a margin that the table shows: for each
row, for each codec over its materials, and for all codecs together. Other numbers are only shown; a longer time gives
advice. Exit codes: 0 nothing got worse; 1 a regression, or a row that vanished or is not comparable and that --allow
does not name; 2 BASE is damaged; 3 a job failed; 4 nothing can be compared. Two stress tests are compared cell by cell,
as text.

With --update, a reference is made from a run: FILE, or that of the run's suite inside the installed package (in a clone
that is not installed with -e, give --out bench/compare/references/SUITE.jsonl). What changed is printed. A reference
should have more seeds than a run, because they tell how far the results of a codec scatter: first add seeds to the
run's folder, with `neubtf-bench run SUITE --seed N --out RUN`. A reference that could not tell a loss of a decibel of
PSNR from chance guards nothing: it is refused without --wide.

examples:
  neubtf-bench compare runs/ci --update
  neubtf-bench compare runs/mine --update -o reference.jsonl
  neubtf-bench compare bench/compare/references/ci.jsonl runs/ci
  neubtf-bench compare runs/before runs/after --markdown verdict.md
"""

import argparse
from pathlib import Path

from bench.cli.commands import say_line, several, write_text
from bench.compare.comparison import compare, compare_extremes
from bench.compare.forms import annotations, junit, tracker
from bench.compare.reference import committed, limits, update
from bench.files.atomic import begins, refuse_other_kind
from bench.inputs.errors import FINE, InputError
from bench.records import Run, load_run
from bench.runs.suite import builtin_suites
from reports.comparison import markdown, terminal


def arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command to its parser."""
    add = parser.add_argument
    add("base", metavar="BASE", help="the folder of a run, or a file of records such as a reference")
    add("new", metavar="NEW", nargs="?", help="the folder or file of records to judge")
    several(parser, "--material", "only this material; repeatable")
    several(parser, "--codec", "only this codec; repeatable")
    gone = "accept that this codec, label, material, MATERIAL/LABEL or pattern is gone or incomparable; repeatable"
    several(parser, "--allow", gone, "NAME")
    add("--markdown", type=Path, metavar="FILE", help="write the verdict as GitHub Markdown")
    add("--junit", type=Path, metavar="FILE", help="write the verdict as JUnit XML")
    add("--tracker", type=Path, metavar="FOLDER", help="write the numbers of NEW for github-action-benchmark")
    add("--annotations", action="store_true", help="also print annotations for GitHub")
    add("--update", action="store_true", help="make a reference from BASE, a run, and print what changed")
    place = "with --update: the .jsonl file to write (default: that of the installed package)"
    add("-o", "--out", type=Path, metavar="FILE", help=place)
    add("--wide", action="store_true", help="with --update: also write one that hides losses of over 1 dB")


def run(options: argparse.Namespace) -> int:
    """Print the comparison, and write the files that are asked for; returns the exit code of the comparison."""
    if options.update:
        return _update_reference(options)
    if not options.new:
        raise InputError("compare: give NEW, the run to judge, or --update to make a reference from BASE")
    if options.out or options.wide:
        raise InputError("--out, --wide: only with --update: leave them out")
    base, new = load_run(options.base), load_run(options.new)
    for name, each in ((options.base, base), (options.new, new)):
        if each.jobs and each.stress:
            raise InputError(f"{name}: it holds jobs and a stress test: compare each from a file of its own")
    if base.stress:
        return _compare_stress_tests(base, new, options)
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


def _compare_stress_tests(base: Run, new: Run, options: argparse.Namespace) -> int:
    """Print the comparison of two stress tests as text; returns its exit code."""
    of_jobs = ("material", "markdown", "junit", "tracker", "annotations")
    ignored = [f"--{name}" for name in of_jobs if getattr(options, name)]
    if ignored:
        raise InputError(f"{', '.join(ignored)}: not for stress tests, which are compared as text: leave it out")
    text, code = compare_extremes(base, new, options.codec, options.allow)
    print(text)
    return code


def _update_reference(options: argparse.Namespace) -> int:
    """Write a reference again, and print what changed and what it cannot tell; returns the exit code."""
    of_verdicts = ("new", "material", "codec", "allow", "markdown", "junit", "tracker", "annotations")
    given = ["NEW" if name == "new" else f"--{name}" for name in of_verdicts if getattr(options, name)]
    if given:
        why = "a reference is made from one whole run"
        raise InputError(f"--update: not with {', '.join(given)}, because {why}: leave it out")
    measured = load_run(options.base)
    if not all("run" in start for start in measured.starts):
        raise InputError(f"{options.base}: it is a reference, not a run: give the folder of a run")
    path = options.out
    if path is None:
        suite = measured.starts[-1]["suite"] if measured.starts else ""
        if suite not in builtin_suites():
            raise InputError(f"{options.base}: not a run of a built-in suite: give --out FILE")
        path = committed(suite)
    made = update(measured, path, options.wide)
    print(terminal(compare(made.before or made.after, made.after)))
    say_line(f"wrote {path}: {len(made.after.jobs)} jobs, {path.stat().st_size:,} bytes")
    for line in limits(made):
        say_line(line)
    return FINE
