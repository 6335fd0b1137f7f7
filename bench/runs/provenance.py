"""Where numbers come from: the revision of the code, the versions of packages, and the processor and system."""

import os
import platform
import subprocess
import sys
from dataclasses import asdict
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import version
from pathlib import Path

import torch

from bench.codecs.registry import codec_entries
from bench.inputs.plugins import source_of
from bench.records import Machine, RunStart
from bench.runs.suite import Suite

PACKAGES = ("neubtf-bench", "torch", "numpy", "scipy", "scikit-image", "OpenEXR", "safetensors", "torchinfo")


def new_run() -> str:
    """The name of a run that begins now."""
    return f"{datetime.now(UTC):%Y%m%dT%H%M%S.%f}"


def start_of(suite: Suite, run: str, device: str, jobs: list[str]) -> RunStart:
    """The record of the start of a run of a suite: what it plans, and where it runs; `jobs` are names."""
    start: RunStart = {"kind": "run", "run": run, "suite": suite.name, "text": suite.text}
    start |= {"device": device, "threads": suite.threads, "seeds": list(suite.seeds), "data": asdict(suite.data)}
    start |= {"materials": [asdict(material) for material in suite.materials], "jobs": jobs}
    return start | provenance()


def provenance() -> RunStart:
    """The fields of a run's start that say what measured it: Git revision, versions of packages and Python, machine.

    The revision is None outside a checkout.
    """
    capability = torch.backends.cpu.get_cpu_capability()
    cores = os.cpu_count()
    here: Machine = {"system": platform.platform(), "processor": processor(), "capability": capability, "cores": cores}
    packages: dict[str, str | None] = {name: version(name) for name in PACKAGES}
    return {"git": revision(), "packages": packages, "python": sys.version.split()[0], "machine": here}


@cache
def revision() -> str | None:
    """The git revision of the suite when this process started; None outside a checkout."""
    return _revision_of(Path(__file__).parent)


@cache
def codec_revision(name: str) -> str | None:
    """The git revision, when first asked for, of the repository that holds the module of an outside codec.

    None without a repository, for a codec of the suite's own one, and for an installed copy, which none tracks.
    """
    entry = codec_entries().get(name)
    path = source_of(entry.module) if entry else None
    if path is None:
        return None
    folder = path.parent
    repository = _git(folder, "rev-parse", "--show-toplevel")
    repository_of_suite = _git(Path(__file__).parent, "rev-parse", "--show-toplevel")
    tracked_files = _git(folder, "ls-files", "--", str(path))  # "" for an environment that lies inside a checkout
    if not tracked_files or repository == repository_of_suite:
        return None
    return _revision_of(folder)


def _revision_of(folder: Path) -> str | None:
    """The revision of the checkout around a folder, with `-dirty` if it has changes; None outside a checkout."""
    return _git(folder, "describe", "--always", "--dirty", "--abbrev=12", "--exclude=*")


def _git(folder: Path, *words: str) -> str | None:
    """What a command of git prints in a folder; None if it fails, as outside a checkout."""
    try:
        done = subprocess.run(["git", "-C", str(folder), *words], capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return None
    return done.stdout.strip()


@cache
def processor() -> str:
    """The name of the CPU type, such as "AMD EPYC 7763", on which the last bits of a fit, and so its bytes, depend."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    for line in lines:
        if line.startswith("model name"):
            return line.split(":", 1)[1].strip()
    return platform.machine()  # Linux names the model on x86 only


def revision_and_time(codec: str = "") -> dict[str, str | None]:
    """Git's revision of the suite (`git`) and the current time (`at`), for results that later runs may reuse.

    With the name of a `codec`, also `codec`, the revision of its own repository, if it has one.
    """
    stamp = {"git": revision(), "at": f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%SZ}"}
    if codec:
        revision_of_codec = codec_revision(codec)
        if revision_of_codec is not None:
            stamp["codec"] = revision_of_codec
    return stamp


def machine() -> Machine:
    """The host and processor that ran a job: the workers of a cluster differ."""
    return {"host": platform.node(), "processor": processor()}
