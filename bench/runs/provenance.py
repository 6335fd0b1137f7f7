"""The process and machine that numbers come from: code, packages, processor; and their settings, restored."""

import os
import platform
import subprocess
import sys
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import torch

from bench.records import Record

PACKAGES = ("neubtf-bench", "torch", "numpy", "scipy", "scikit-image", "OpenEXR", "safetensors", "torchinfo")


def provenance() -> dict[str, Any]:
    """Git revision of the suite (None outside a checkout), package versions, processor and operating system."""
    capability, cores = torch.backends.cpu.get_cpu_capability(), os.cpu_count()
    here = {"system": platform.platform(), "processor": processor(), "capability": capability, "cores": cores}
    packages = {name: version(name) for name in PACKAGES}
    return {"git": revision(), "packages": packages, "python": sys.version.split()[0], "machine": here}


@cache
def revision() -> str | None:
    """The git revision of the suite when this process started; None outside a checkout."""
    command = ["git", "-C", str(Path(__file__).parent), "describe", "--always", "--dirty", "--abbrev=12", "--exclude=*"]
    try:
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return None


@cache
def processor() -> str:
    """The name of the CPU type, on which bytes depend."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    names = (line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    return next(names, platform.machine())


def stamp() -> Record:
    """The revision of the suite and the current time, for results that later runs may reuse."""
    return {"git": revision(), "at": f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%SZ}"}


def machine() -> dict[str, str]:
    """The host and processor that ran a job: the workers of a cluster differ."""
    return {"host": platform.node(), "processor": processor()}
