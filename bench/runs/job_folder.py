"""Finds where a job keeps its files: the run's folder, or a local folder if the job cannot reach the run's."""

import hashlib
import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from bench import atomic
from bench.atomic import cache_dir
from bench.runs import lock


@dataclass
class JobFolder:
    """A folder with the layout of a run's folder, and the files that a job put there. Names are relative to it."""

    path: Path
    of_run: bool  # whether it is the run's own folder
    written: list[str] = field(default_factory=list)
    lent: list[str] = field(default_factory=list)

    @classmethod
    def reachable(cls, folder: Path, run: str, fresh: bool) -> "JobFolder":
        """The run's folder if its lock is there (another machine may have a folder of that name), else a local one."""
        if lock.reaches(folder, run):
            return cls(folder, True)
        digest = hashlib.sha256(f"{folder} {run if fresh else ''}".encode()).hexdigest()
        return cls(cache_dir() / "runs" / digest[:24], False)

    def keep(self, name: str, content: dict[str, Any]) -> str:
        """Store content that is too large for a record beside it, as .npz or .json; returns the name."""
        with atomic.replacing(self.path / name) as partial:
            if name.endswith(".json"):
                partial.write_text(json.dumps(content, allow_nan=False), encoding="utf-8")
            else:
                with open(partial, "wb") as file:
                    np.savez_compressed(file, **content)
        self.written.append(name)
        return name

    def put(self, name: str, content: bytes) -> Path:
        """Store a copy of a file of the run's folder here; returns its path."""
        path = self.path / name
        if not path.exists():
            atomic.write(path, content)
            self.lent.append(name)
        return path

    def parcel(self) -> dict[str, bytes]:
        """The files made outside the run's folder, for the process that writes there; deletes them here."""
        if self.of_run:
            return {}
        files = {name: (self.path / name).read_bytes() for name in self.written}
        for name in (*self.written, *self.lent):
            (self.path / name).unlink(missing_ok=True)
        return files
