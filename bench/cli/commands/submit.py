"""pack the records and codec files of a run into an archive that others can verify

Anyone who has the archive can score every file again with `neubtf-bench verify ARCHIVE`, so nobody has to trust
you. The last lines printed are a text to hand it in with.

examples:
  neubtf-bench submit runs/mine -o mine.zip
  neubtf-bench submit runs/standard --codec mine -o mine.zip
"""

import argparse
import shlex
from pathlib import Path
from typing import TYPE_CHECKING

from bench.cli.commands import out, several
from bench.inputs.errors import FINE, InputError

if TYPE_CHECKING:
    from bench.records import Run


def arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("run", type=Path, help="the folder of a run")
    several(parser, "--codec", "only this codec; repeatable")
    out(parser, "the .zip file to write", form="FILE")


def run(options: argparse.Namespace) -> int:
    from bench.compare.results import published
    from bench.records import load_run
    from bench.runs.archive import chosen, pack

    if options.out.suffix != ".zip":
        raise InputError(f"--out {options.out}: the name must end in .zip")
    run = chosen(load_run(options.run), options.codec)
    pack(run, published(run), options.out)
    print(f"wrote {options.out}: {len(run.jobs)} jobs, {options.out.stat().st_size:,} bytes")
    print(f"\nTo hand it in, send it with this text:\n\n{_request(run, options.out)}")
    return FINE


def _request(run: "Run", archive: Path) -> str:
    """What those who keep the board must know of an archive: which one, what is in it, how to verify it."""
    import hashlib

    with open(archive, "rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    keys = {(job["codec"], job["fit_key"]["version"], job["fit_key"]["code"][:12]) for job in run.jobs}
    codecs = "\n".join(f"- {name} version {version}, code {code}" for name, version, code in sorted(keys))
    materials = ", ".join(dict.fromkeys(job["material"] for job in run.jobs))
    suites = ", ".join(dict.fromkeys(str(start.get("suite")) for start in run.starts))
    return (
        f"Results for the board: {archive.name}, {len(run.jobs)} jobs of the suite {suites}\n"
        f"sha256 {digest}\n\n"
        f"Codecs:\n{codecs}\nMaterials: {materials}\n\n"
        "Install the codec with: (command, or “comes with the suite”)\n"
        f"Verify with: neubtf-bench verify {shlex.quote(archive.name)}\n"
        "Paper and code of the codec: (links)"
    )
