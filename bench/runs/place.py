"""Where a job keeps its files: the run's folder, or one of this machine where the run's is out of its reach."""

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
class Place:
    """A folder laid out as the run's, and what a job put there. Names are relative to it."""

    folder: Path
    of_run: bool  # it is the run's own
    made: list[str] = field(default_factory=list)
    lent: list[str] = field(default_factory=list)

    @classmethod
    def of(cls, folder: Path, run: str, fresh: bool) -> "Place":
        """The run's folder is that with the run's lock in it: another machine may have a folder of the same name."""
        if lock.reaches(folder, run):
            return cls(folder, True)
        digest = hashlib.sha256(f"{folder} {run if fresh else ''}".encode()).hexdigest()
        return cls(cache_dir() / "runs" / digest[:24], False)

    def keep(self, name: str, content: dict[str, Any]) -> str:
        """Store what is too much for a record beside it, as .npz or .json; returns the name."""
        with atomic.replacing(self.folder / name) as partial:
            if name.endswith(".json"):
                partial.write_text(json.dumps(content, allow_nan=False), encoding="utf-8")
            else:
                with open(partial, "wb") as file:
                    np.savez_compressed(file, **content)
        self.made.append(name)
        return name

    def put(self, name: str, content: bytes) -> Path:
        """Have a file here that the run's folder has, or shall have; returns its path."""
        path = self.folder / name
        if not path.exists():
            atomic.write(path, content)
            self.lent.append(name)
        return path

    def parcel(self) -> dict[str, bytes]:
        """What was made out of reach of the run's folder, for who can write there; nothing of it stays here."""
        if self.of_run:
            return {}
        files = {name: (self.folder / name).read_bytes() for name in self.made}
        for name in (*self.made, *self.lent):
            (self.folder / name).unlink(missing_ok=True)
        return files
