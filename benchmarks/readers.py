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
from ubo2014_write import write_ubo2014

from bench.data.readers import open_btf
from bench.hemisphere import to_degrees, ubo2014

PROCESSOR: list[float] = []
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
    """Seconds that a call takes; its processor time goes to `PROCESSOR`, for machines that others use too."""
    begin, processor = time.perf_counter(), time.process_time()
    work()
    PROCESSOR.append(time.process_time() - processor)
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
    rows, cols = rng.integers(SHAPE[0], size=(2, SAMPLES))
    held: list[np.ndarray] = []
    figures = [
        measured("open", 1, 1.0, lambda: open_btf(path)),
    ]
    btf = open_btf(path)
    pair = rng.integers(len(btf), size=SAMPLES)
    figures += [
        measured("fingerprint", 1, 1.0, lambda: btf.fingerprint),
        measured("first slice", 1, 1.0, lambda: btf[0]),
        measured("random slice, median", SLICES, 0.05, lambda: btf[int(rng.integers(len(btf)))]),
        measured(f"{SAMPLES} scattered samples, median", 5, 0.2, lambda: btf.gather(pair, rows, cols)),
        measured(f"{ABRDFS} ABRDFs", 1, 2.0, lambda: held.append(btf.texels(rows[:ABRDFS], cols[:ABRDFS]))),
    ]
    memory = anonymous_bytes() - before
    print(f"anonymous memory {memory / 1e9:.2f} GB (bound 1.5), of which {held[0].nbytes / 1e9:.2f} GB are the ABRDFs")
    print(f"{path.stat().st_size / 1e6:.0f} MB, rank {btf.provenance['native']['rank']}, {os.cpu_count()} CPUs")
    return int(not all(figures) or memory > 1.5e9)


def measured(name: str, repeats: int, bound: float, work: Callable[[], object]) -> bool:
    """Print the median wall and processor time of a call; True within the bound of wall time."""
    PROCESSOR.clear()
    wall = statistics.median(timed(work) for _ in range(repeats))
    print(f"{name:34s} {wall:8.3f} s (bound {bound:g}), processor {statistics.median(PROCESSOR):7.3f} s")
    return wall <= bound


if __name__ == "__main__":
    sys.exit(main())
