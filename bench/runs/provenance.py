"""The process and machine that numbers come from: code, packages, processor; and their settings, restored."""

import os
import platform
import random
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
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


@contextmanager
def restored_process_state() -> Iterator[None]:
    """Restore the working directory, settings and global generators of PyTorch and NumPy when the block ends: a codec
    may change them, and the next job and the scores must not depend on that."""
    folder, dtype, device = os.getcwd(), torch.get_default_dtype(), torch.get_default_device()
    threads, gradients = torch.get_num_threads(), torch.is_grad_enabled()
    exact, precision = torch.get_deterministic_debug_mode(), torch.get_float32_matmul_precision()
    complaints = np.geterr()
    drawn = torch.get_rng_state(), np.random.get_state(), random.getstate()
    try:
        yield
    finally:
        with suppress(OSError):  # the folder may be gone
            os.chdir(folder)
        torch.set_default_dtype(dtype)
        if torch.get_default_device() != device:  # setting it, even to the same device, slows every call down
            torch.set_default_device(None if device.type == "cpu" else device)
        torch.set_num_threads(threads)
        torch.set_grad_enabled(gradients)
        torch.set_deterministic_debug_mode(exact)  # the other setter imports the compiler
        torch.set_float32_matmul_precision(precision)
        np.seterr(**complaints)
        torch.set_rng_state(drawn[0])
        np.random.set_state(drawn[1])
        random.setstate(drawn[2])
