"""Measures the readers on a generated UBO2014 file of the real dimensions: 400 × 400 texels, 22,801 pairs.

    python benchmarks/readers.py [--rank 100] [--folder DIR]

The file is written to a temporary folder and removed. Exit code 1 where a figure misses its bound.
"""

import argparse
import os
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from bench.hemisphere import to_degrees, ubo2014
from bench.readers import open_btf
from bench.readers.ubo2014_write import write_ubo2014

SHAPE, SAMPLES, ABRDFS, SLICES = (400, 400), 65_536, 1_000, 30


def anonymous_bytes() -> int:
    """Anonymous resident memory of this process in bytes (memory-mapped files do not count)."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("RssAnon"):
            return int(line.split()[1]) * 1024
    return 0


def write_material(path: Path, rank: int, rng: np.random.Generator) -> None:
    """A DFMF of colour model 11 with smooth random factors, half floats."""
    directions = np.radians(np.stack(to_degrees(ubo2014()), -1))
    rows, cols = len(directions) ** 2, SHAPE[0] * SHAPE[1]
    factors = []
    for _ in range(3):
        decay = (1.0 / np.arange(1, rank + 1)).astype(np.float32)
        u = rng.standard_normal((rows, rank), np.float32) * 0.05
        factors.append(
            (u.astype(np.float16), (rng.standard_normal((cols, rank), np.float32) * decay).astype(np.float16))
        )
    write_ubo2014(path, directions, directions, SHAPE, factors)


def timed(work: Callable[[], object]) -> float:
    """Seconds that a call takes."""
    begin = time.perf_counter()
    work()
    return time.perf_counter() - begin


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rank", type=int, default=100)
    parser.add_argument("--folder", type=Path, help="where to write the file (default: the system's temporary folder)")
    options = parser.parse_args()
    rng = np.random.default_rng(0)
    with tempfile.TemporaryDirectory(dir=options.folder) as folder:
        path = Path(folder) / "generated.btf"
        write_material(path, options.rank, rng)
        return report(path, rng)


def report(path: Path, rng: np.random.Generator) -> int:
    """Measure and print; 1 where a bound is missed."""
    before = anonymous_bytes()
    opening = timed(lambda: open_btf(path))
    btf = open_btf(path)
    fingerprint = timed(lambda: btf.fingerprint)
    first = timed(lambda: btf[0])
    slices = [timed(lambda: btf[int(rng.integers(len(btf)))]) for _ in range(SLICES)]
    rows, cols = rng.integers(SHAPE[0], size=(2, SAMPLES))
    pair = rng.integers(len(btf), size=SAMPLES)
    gathers = [timed(lambda: btf.gather(pair, rows, cols)) for _ in range(5)]
    peak = anonymous_bytes() - before
    begin = time.perf_counter()
    block = btf.texels(rows[:ABRDFS], cols[:ABRDFS])
    abrdfs = time.perf_counter() - begin
    peak = max(peak, anonymous_bytes() - before)
    figures = [
        ("open", opening, 1.0, "s"),
        ("fingerprint", fingerprint, 1.0, "s"),
        ("first slice", first * 1e3, None, "ms"),
        ("random slice, median", statistics.median(slices) * 1e3, 50.0, "ms"),
        ("random slice, worst", max(slices) * 1e3, None, "ms"),
        (f"{ABRDFS} ABRDFs ({block.nbytes / 1e6:.0f} MB)", abrdfs, 2.0, "s"),
        (f"{SAMPLES} scattered samples, median", statistics.median(gathers), 0.2, "s"),
        ("anonymous memory, block included", peak / 1e9, 1.5, "GB"),
    ]
    print(f"{path.stat().st_size / 1e6:.0f} MB, rank {btf.provenance['native']['rank']}, {os.cpu_count()} CPUs")
    for name, value, bound, unit in figures:
        limit = "" if bound is None else f"  (bound {bound:g})"
        print(f"{name:40s} {value:9.3f} {unit}{limit}")
    return int(any(bound is not None and value > bound for _, value, bound, _ in figures))


if __name__ == "__main__":
    sys.exit(main())
