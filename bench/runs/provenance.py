"""Where numbers come from: the revision of the code, the versions of packages, and the processor and system."""

import os
import platform
import subprocess
import sys
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path

import torch

from bench.codecs.registry import codec_entries
from bench.records import Machine, RunStart

PACKAGES = ("neubtf-bench", "torch", "numpy", "scipy", "scikit-image", "OpenEXR", "safetensors", "torchinfo")


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
    path = _package_of(name)
    if path is None:
        return None
    folder = path if path.is_dir() else path.parent
    repository = _git(folder, "rev-parse", "--show-toplevel")
    repository_of_suite = _git(Path(__file__).parent, "rev-parse", "--show-toplevel")
    tracked_files = _git(folder, "ls-files", "--", str(path))  # "" for an environment that lies inside a checkout
    if not tracked_files or repository == repository_of_suite:
        return None
    return _revision_of(folder)


def _package_of(codec: str) -> Path | None:
    """The file or folder of the outermost package of a codec; None if there is none. Nothing is imported."""
    entry = codec_entries().get(codec)
    if entry is None:
        return None
    spec = find_spec(entry.module.partition(".")[0])
    if spec is None:
        return None
    places = [spec.origin]  # the file of a module or of a package's `__init__.py`; None for a package without one
    if spec.submodule_search_locations:  # the folders of a package
        places += spec.submodule_search_locations
    for place in places:
        if place and Path(place).exists():
            return Path(place)
    return None


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
