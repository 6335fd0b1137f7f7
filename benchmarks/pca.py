"""PCA at size: time against torch.svd_lowrank, memory of a 2 GB BTF, and error against the best.

    python benchmarks/pca.py time | error | memory [256 | 512 | 1024]

`time` interleaves what it compares and prints ratios: on a shared machine only those mean anything. `memory` is of a
BTF of so many texels a side, whose slices are made one by one; by default 512.
"""

import argparse
import resource
import time
from collections.abc import Callable, Iterator

import numpy as np
import torch

from baselines.pca import PCA
from bench import hemisphere
from bench.btf import BTF, ArraySource, Source
from bench.codec import Fit
from bench.training.svd import truncated_svd


def grid(views: int, lights: int) -> tuple[np.ndarray, np.ndarray]:
    """wo and wi of a product of evenly thinned directions."""
    directions = hemisphere.ubo2014()
    wo, wi = (directions[hemisphere.thin(directions, n)] for n in (views, lights))
    return np.repeat(wo, lights, 0), np.tile(wi, (views, 1))


def seconds(work: Callable[[], object], clock: Callable[[], float] = time.perf_counter) -> float:
    start = clock()
    work()
    return clock() - start


def measure_time(rounds: int = 5) -> None:
    """16384 texels × 6000 numbers, 40 components: the whole encoding over torch.svd_lowrank(niter=7).

    Processor time of one thread, which neighbours on a shared machine hardly change; then elapsed time of all threads.
    """
    rng = np.random.default_rng(0)
    values = np.einsum("pk,kt->pt", rng.random((6000, 60), np.float32), rng.random((60, 16384), np.float32) ** 3)
    values = values.reshape(2000, 3, 128, 128).transpose(0, 2, 3, 1).copy()
    btf = BTF("made", *grid(40, 50), ArraySource(values))
    matrix = torch.from_numpy(values.reshape(2000, -1, 3)).permute(1, 0, 2).reshape(16384, 6000)
    centred = matrix - matrix.mean(0)
    threads = torch.get_num_threads()
    for count, clock in ((1, time.process_time), (threads, time.perf_counter)):
        torch.set_num_threads(count)
        ratios: dict[str, list[float]] = {"rgb": [], "log": []}
        for _ in range(rounds):
            reference = seconds(lambda: torch.svd_lowrank(centred, q=40, niter=7), clock)
            for domain, taken in ratios.items():
                codec = PCA(components=40, domain=domain)
                taken.append(seconds(lambda codec=codec: codec.encode(btf, Fit()), clock) / reference)
        for domain, taken in ratios.items():
            spread = f"least {min(taken):.2f}, most {max(taken):.2f}"
            print(f"{domain}, {clock.__name__}, {count} threads: {np.median(taken):.2f} × svd_lowrank ({spread})")


class Generated(Source):
    """Slices made one by one; all of them together are never held."""

    def __init__(self, count: int, shape: tuple[int, int]):
        self.count, self.shape = count, shape
        self.patterns = np.random.default_rng(0).random((8, *shape, 3), np.float32)

    def slice(self, pair: int) -> np.ndarray:
        rng = np.random.default_rng(pair)
        return np.tensordot(rng.random(8, np.float32), self.patterns, 1) + 0.01 * rng.random(
            (*self.shape, 3), np.float32
        )

    def gather(self, pair: np.ndarray, row: np.ndarray, col: np.ndarray) -> np.ndarray:
        return self.patterns[pair % 8, row, col]


SHAPES = {256: (51, 51), 512: (26, 25), 1024: (13, 12)}  # views and lights of 2 GB, by texels a side


def measure_memory(side: int) -> None:
    """The peak of an encoding over what the process held before."""
    views, lights = SHAPES[side]
    btf = BTF("large", *grid(views, lights), Generated(views * lights, (side, side)))
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    PCA().encode(btf, Fit())
    taken = 1024 * (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)  # Linux counts memory in KiB
    raw = len(btf) * side * side * 12
    print(f"{side}² × {len(btf)} pairs, {raw / 1e9:.2f} GB raw: {taken / 1e9:.2f} GB at the peak")


def matrices() -> Iterator[tuple[str, torch.Tensor]]:
    """Matrices (1500, 4096) of several spectra."""
    generator = torch.Generator().manual_seed(0)
    left, right = torch.randn(1500, 200, generator=generator), torch.randn(200, 4096, generator=generator)
    steps = torch.arange(200.0)
    noise = torch.randn(1500, 4096, generator=generator)
    yield "1/n and noise", (left / (1 + steps)) @ right + 0.05 * noise
    yield "2^(-n/2)", (left * 2 ** (-steps / 2)) @ right
    yield "flat", noise


def measure_error() -> None:
    """Error at rank k over the best there is, less one, by passes."""
    for name, matrix in matrices():
        centred = matrix.double() - matrix.double().mean(1, keepdim=True)
        energy = torch.linalg.eigvalsh(centred @ centred.T).flip(0).clamp_min(0)
        for rank in (4, 16, 40):
            best, row = energy[rank:].sum().sqrt(), []
            for passes in (2, 3, 4, 5, 6):
                # Large enough not to be decomposed exactly.
                blocks = lambda _, matrix=matrix: iter(matrix.clone().split(300))  # noqa: E731
                generator = torch.Generator().manual_seed(0)
                found = truncated_svd(blocks, (1500, 4096), rank, passes, generator, torch.device("cpu"))
                rebuilt = found.basis.double() @ found.coefficients.double() + found.mean.double()[:, None]
                row.append(f"{passes}: {float((rebuilt - matrix).norm() / best) - 1:.1e}")
            print(f"{name}, rank {rank} ({float(best / energy.sum().sqrt()):.1e} of the norm left): {', '.join(row)}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", choices=["time", "memory", "error"])
    parser.add_argument("side", nargs="?", type=int, choices=SHAPES, default=512)
    chosen = parser.parse_args()
    if chosen.what == "memory":
        measure_memory(chosen.side)
    else:
        {"time": measure_time, "error": measure_error}[chosen.what]()


if __name__ == "__main__":
    main()
