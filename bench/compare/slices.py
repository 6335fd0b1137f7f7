"""Reads the PSNR of every slice of a job, from the file beside its record, or from a reference, which stores it packed.

The slices are those of the pairs that decide, in the order of the BTF. The number is the display PSNR in dB, at most
`MOST_DB`.
"""

import base64
from pathlib import Path

import numpy as np

from bench.btf import Array
from bench.files.archive import MAX_FILE, read_arrays
from bench.inputs.errors import InputError
from bench.metrics.psnr import psnr
from bench.records import MOST_DB, PSNR, Record, gate


def decibels(folder: Path, job: Record) -> Array | None:
    """The PSNR (n,) of each slice of the pairs that decide; None if it was not stored."""
    stored = job.get("slices")
    if isinstance(stored, dict):
        try:
            return unpacked(stored[PSNR]) if PSNR in stored else None
        except ValueError as error:
            raise InputError(f"{folder}: the slices of {job['job']} cannot be read ({error}): run it again") from error
    if not stored:
        return None
    path = folder / stored
    if not path.exists():
        return None
    try:
        arrays = read_arrays(path, MAX_FILE, (PSNR, "heldout"))
        raw, heldout = arrays[PSNR], arrays["heldout"]
        if raw.ndim != 1 or raw.shape != heldout.shape or (raw.dtype.kind, heldout.dtype.kind) != ("f", "b"):
            raise ValueError(f"{PSNR} and heldout are {raw.shape} {raw.dtype} and {heldout.shape} {heldout.dtype}")
    except (OSError, ValueError, KeyError) as error:
        raise InputError(f"{path}: the slices of {job['job']} cannot be read ({error}): run it again") from error
    raw = raw[heldout] if gate(job["scores"]) == "heldout" else raw
    return np.minimum(psnr(raw[~np.isnan(raw)]), MOST_DB)


def packed(values: Array) -> str:
    """Encode dB as text for a reference, in hundredths, two bytes each."""
    return base64.b64encode(np.round(100 * values).clip(-32768, 32767).astype("<i2").tobytes()).decode()


def unpacked(text: str) -> Array:
    """Decode the text of `packed`."""
    return np.minimum(np.frombuffer(base64.b64decode(text), "<i2") / 100, MOST_DB)
