"""Texel-pairs a second of rendering each built-in material at 64², 25 × 25 pairs, maps made beforehand.

    python benchmarks/rendering.py [--size 64] [--repeat 5] [NAME ...]

Everything is inside: views traced, shadows cast, shading. Prints the fastest and the median run, the rate a second of
processor time (what one core would do if the machine were free) and the load average, because a busy machine divides
the first two figures. The aim is 5 M/s on two cores.
"""

import argparse
import os
import statistics
import time

from bench.data import materials
from bench.data.materials.renderer import SUB_POINTS, render
from bench.data.spec import Preparation


def seconds(name: str, size: int, repeat: int) -> list[tuple[float, float]]:
    """Wall and processor time of each run, after one to warm up."""
    maps = materials.recipe(name).maps(0)
    wo, wi = Preparation(views=25, lights=25, heldout=0).everything("", 0)
    taken = []
    for _ in range(repeat + 1):
        start, used = time.perf_counter(), time.process_time()
        render(maps, wo, wi, (size, size), SUB_POINTS)
        taken.append((time.perf_counter() - start, time.process_time() - used))
    return taken[1:]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", default=materials.names(), metavar="NAME")
    parser.add_argument("--size", type=int, default=64)
    parser.add_argument("--repeat", type=int, default=5)
    chosen = parser.parse_args()
    print(f"{'material':<14} {'best':>8} {'median':>8} {'per core':>9}  M texel-pairs/s   load")
    for name in chosen.names:
        wall, used = zip(*seconds(name, chosen.size, chosen.repeat), strict=True)
        rates = [25 * 25 * chosen.size**2 / t / 1e6 for t in (min(wall), statistics.median(wall), min(used))]
        print(f"{name:<14} {rates[0]:8.2f} {rates[1]:8.2f} {rates[2]:9.2f} {'':>17} {os.getloadavg()[0]:5.1f}")


if __name__ == "__main__":
    main()
