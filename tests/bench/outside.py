"""Installs a distribution of codecs, metrics or readers into a folder, for tests of what comes from outside."""

from pathlib import Path


def install(
    site: Path, name: str, places: dict[str, str], modules: dict[str, str], group: str = "neubtf_bench.codecs"
) -> Path:
    """A folder for `sys.path`: the distribution, version 1.0, its entry points (name → "module:Class"), its modules'
    text."""
    info = site / f"{name}-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    entries = "\n".join(f"{each} = {place}" for each, place in places.items())
    (info / "entry_points.txt").write_text(f"[{group}]\n{entries}\n")
    for module, text in modules.items():
        (site / f"{module}.py").write_text(text)
    return site
