"""write a run's tables and pictures again from its records

examples:
  neubtf-bench report runs/quick
"""

import argparse
from pathlib import Path

from bench.errors import FINE


def arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("run", type=Path, help="the folder of a run")


def run(options: argparse.Namespace) -> int:
    from reports import write_report

    written = write_report(options.run)
    print(written.text)
    print("\n".join(f"wrote {path}" for path in written.files))
    return FINE
