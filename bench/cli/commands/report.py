"""write a run's tables and pictures again from its records

examples:
  neubtf-bench report runs/quick
  neubtf-bench report runs/quick --vector
"""

import argparse
from pathlib import Path

from bench.cli.commands import say_line
from bench.inputs.errors import FINE
from reports import write_report


def arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command to its parser."""
    parser.add_argument("run", type=Path, help="the folder of a run")
    parser.add_argument(
        "--vector", action="store_true", help="write every figure as SVG and PDF too; later reports draw them again"
    )


def run(options: argparse.Namespace) -> int:
    """Write the report of a run; returns the exit code."""
    written = write_report(options.run, options.vector)
    print(written.text)
    for path in written.files:
        say_line(f"wrote {path}")
    return FINE
