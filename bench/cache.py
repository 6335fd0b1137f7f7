"""The folder where the suite keeps what it can make again: rendered materials and transposed scratch files."""

import os
from pathlib import Path


def cache_dir() -> Path:
    """`$NEUBTF_CACHE`, else `$XDG_CACHE_HOME/neubtf-bench`, else `~/.cache/neubtf-bench`; made when missing."""
    if chosen := os.environ.get("NEUBTF_CACHE"):
        folder = Path(chosen)
    else:
        folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "neubtf-bench"
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def clear() -> tuple[int, int]:
    """Remove every cached file; return their number and their bytes."""
    count = total = 0
    for path in sorted(cache_dir().rglob("*"), reverse=True):
        if path.is_dir():
            path.rmdir()
        else:
            count, total = count + 1, total + path.stat().st_size
            path.unlink()
    return count, total
