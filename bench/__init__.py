"""The suite: what a BTF is, what a codec must do, how it is measured, run, stored and compared."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from bench.runs.history import load_runs as load_runs


def __getattr__(name: str) -> Any:
    """`bench.load_runs`, imported when it is asked for: `import bench` alone is instant."""
    if name == "load_runs":
        from bench.runs.history import load_runs

        return load_runs
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
