"""Samples a second of the path-traced bake: 64 × 64 texels of 4 × 4 sub-points, whole launches.

    python benchmarks/baking.py [--size 64] [--repeat 5] [--roughness 0.5] [--albedo 0.5]

A sample is one path of one sub-point for one pair, all its bounces and shadow rays included. The surface is the relief
of a photograph, 0.05 widths deep. Making the mesh and compiling are told apart. Prints the fastest and the median
launch, the rate a second of processor time (one core of a free machine), the load average, and how far the bake is
from the built-in renderer, with direct light alone and with all. Exit code 1 below the aim, 2 M samples/s on two cores
with LLVM: the fastest launch or, as a busy machine divides it, twice what a second of processor time gives.
"""

import argparse
import os
import statistics
import sys
import time

import numpy as np

from bench.data import materials
from bench.data.materials.maps import Maps
from bench.data.materials.renderer import render
from bench.data.spec import Preparation
from bench.demand.mitsuba.path_tracer import MAX_DEPTH, PathTracer, fastest_variant, launches, using

AIM = 2e6
SUB_POINTS = 4


def surface(roughness: float, albedo: float) -> Maps:
    """Gravel's relief 0.05 widths deep under one colour."""
    height = materials.recipe("gravel").maps(0).height
    return Maps(0.05 * (height - height.min()) / np.ptp(height), np.full((*height.shape, 3), albedo), roughness)


def rates(maps: Maps, size: int, repeat: int) -> list[tuple[float, float]]:
    """Samples a second of wall and of processor time of each launch, after one to compile."""
    wo, wi = Preparation(views=25, lights=25, heldout=0).everything("", 0)
    begin = time.perf_counter()
    tracer = PathTracer(maps, (size, size), SUB_POINTS, float(wo[:, 2].min()), float(wi[:, 2].min()))
    print(f"mesh and search tree: {time.perf_counter() - begin:.2f} s")
    taken, step = [], tracer.pairs_a_launch
    for launch in range(repeat + 1):
        chosen = np.arange(launch * step, (launch + 1) * step) % len(wo)
        begin, used = time.perf_counter(), time.process_time()
        tracer.slices(wo[chosen], wi[chosen], MAX_DEPTH)
        wall, used = time.perf_counter() - begin, time.process_time() - used
        samples = step * (size * SUB_POINTS) ** 2
        if launch:
            taken.append((samples / wall, samples / used))
        else:
            print(f"first launch, compiling: {wall:.2f} s for {step} pairs, {samples / 1e6:.1f} M samples")
    return taken


def agreement(maps: Maps) -> None:
    """Ratios of slice means to the built-in renderer's, at pairs up to 75°."""
    wo, wi = Preparation(views=5, lights=5, heldout=25, split="validation").everything("", 0)
    ours = render(maps, wo, wi, (64, 64), SUB_POINTS).mean((1, 2, 3))
    for name, depth in (("direct light", 2), ("all light", MAX_DEPTH)):
        traced = np.concatenate([*launches(maps, wo, wi, (64, 64), SUB_POINTS, depth=depth)])
        ratio = traced.mean((1, 2, 3)) / ours
        print(f"{name} over built-in, slice means: {ratio.mean():.4f} ({ratio.min():.4f} to {ratio.max():.4f})")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=int, default=64)
    parser.add_argument("--repeat", type=int, default=5)
    parser.add_argument("--roughness", type=float, default=0.5)
    parser.add_argument("--albedo", type=float, default=0.5)
    chosen = parser.parse_args()
    maps, variant = surface(chosen.roughness, chosen.albedo), fastest_variant()
    with using(variant):
        wall, used = zip(*rates(maps, chosen.size, chosen.repeat), strict=True)
    best, median, core = max(wall) / 1e6, statistics.median(wall) / 1e6, max(used) / 1e6
    print(f"{variant}: best {best:.2f}, median {median:.2f}, per core {core:.2f} M samples/s", end="")
    print(f" on {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}")
    agreement(maps)
    return 0 if max(max(wall), 2 * max(used)) >= AIM else 1


if __name__ == "__main__":
    sys.exit(main())
