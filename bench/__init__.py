"""The suite: defines BTFs and codecs, and measures, runs, stores and compares them.

Scripts call `bench.open`, `from_arrays`, `encode`, `load`, `score`, `run`, `check` and `load_runs`: see docs/api.md.
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from bench.compare.frame import load_runs as load_runs
    from bench.conformance.verdicts import check as check
    from bench.data.open import from_arrays as from_arrays
    from bench.runs.library import SceneGoal as SceneGoal
    from bench.runs.library import encode as encode
    from bench.runs.library import encode_for_scene as encode_for_scene
    from bench.runs.library import load as load
    from bench.runs.library import open as open
    from bench.runs.library import run as run
    from bench.runs.library import score as score

    __version__: str

_OF_LIBRARY = ("open", "encode", "encode_for_scene", "load", "run", "score", "SceneGoal")
_LAZY = dict.fromkeys(_OF_LIBRARY, "bench.runs.library") | {
    "check": "bench.conformance.verdicts",
    "from_arrays": "bench.data.open",
    "load_runs": "bench.compare.frame",
}


def __getattr__(name: str) -> Any:
    """Import a public name when it is used, so that `import bench` alone is instant, and imports no PyTorch."""
    if name == "__version__":
        from importlib.metadata import version

        return version("neubtf-bench")
    if name in _LAZY:
        return getattr(importlib.import_module(_LAZY[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*globals(), "__version__", *_LAZY])
