"""Keeps finished slices of a long bake on disk, so that a killed bake resumes from them."""

import hashlib
import shutil
from pathlib import Path

import numpy as np

from bench.btf import Array
from bench.files import atomic

COUNT = "finished"


class Partial:
    """Slices (N, H, W, 3) float32 in a hidden folder beside `out`; the first `done` of them are finished. `key` is made
    from everything that determines the values; slices under another key are not used."""

    def __init__(self, out: Path, key: str, shape: tuple[int, int, int, int]):
        self.out = out
        self.folder = out.with_name(f".{out.name}.{hashlib.sha256(key.encode()).hexdigest()[:16]}.baking")
        self.folder.mkdir(exist_ok=True)
        path = self.folder / "values.npy"
        try:
            self.done = int((self.folder / COUNT).read_text()) if path.exists() else 0
        except (OSError, ValueError):
            self.done = 0
        if not self.done:
            with atomic.replacing(path) as fresh:
                atomic.mapped(fresh, np.float32, shape)
        self.values = np.lib.format.open_memmap(path, "r+")

    def add(self, slices: Array) -> None:
        """Keep the next slices (n, H, W, 3); they are on disk before they count."""
        self.values[self.done : self.done + len(slices)] = slices
        self.values.flush()
        self.done += len(slices)
        atomic.write(self.folder / COUNT, str(self.done).encode())

    def remove(self) -> None:
        """Remove the folder, and those of other settings for the same `out`."""
        for folder in self.out.parent.iterdir():
            if folder.name.startswith(f".{self.out.name}.") and folder.suffix == ".baking":
                shutil.rmtree(folder, ignore_errors=True)
