"""pack the records and codec files of a run into an archive that others can verify

Anyone who has the archive can score every file again with `neubtf-bench verify ARCHIVE`, so nobody has to trust
you. The last lines printed are a text to hand it in with.

examples:
  neubtf-bench submit runs/mine -o mine.zip
  neubtf-bench submit runs/quick --codec pca -o pca.zip
"""

import argparse
import hashlib
import shlex
from pathlib import Path

from bench.cli.commands import say_line, several
from bench.compare.reference import published
from bench.inputs.errors import FINE, InputError
from bench.records import load_run
from bench.runs.archive import jobs_with_results, pack


def arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("run", type=Path, help="the folder of a run")
    several(parser, "--codec", "only this codec; repeatable")
    parser.add_argument("-o", "--out", type=Path, required=True, metavar="FILE", help="the .zip file to write")


def run(options: argparse.Namespace) -> int:
    """Pack the archive, and print the text to send with it; returns the exit code."""
    if options.out.suffix != ".zip":
        raise InputError(f"--out {options.out}: the name must end in .zip")
    run = jobs_with_results(load_run(options.run), options.codec)
    pack(run, published(run), options.out)
    say_line(f"wrote {options.out}: {len(run.jobs)} jobs, {options.out.stat().st_size:,} bytes")
    # The text to send with it: what it holds, and how to check it.
    with open(options.out, "rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    keys = {(job["codec"], job["fit_key"]["version"], job["fit_key"]["code"][:12]) for job in run.jobs}
    materials = ", ".join(dict.fromkeys(job["material"] for job in run.jobs))
    suites = ", ".join(dict.fromkeys(str(start.get("suite")) for start in run.starts))
    lines = ["", "To hand it in, send it with this text:", ""]
    lines += [f"Results for the board: {options.out.name}, {len(run.jobs)} jobs of the suite {suites}"]
    lines += [f"sha256 {digest}", "", "Codecs:"]
    lines += [f"- {name} version {version}, code {code}" for name, version, code in sorted(keys)]
    lines += [f"Materials: {materials}", "", "Install the codec with: (command, or “comes with the suite”)"]
    lines += [f"Verify with: neubtf-bench verify {shlex.quote(options.out.name)}"]
    lines += ["Paper and code of the codec: (links)"]
    for line in lines:
        say_line(line)
    return FINE
