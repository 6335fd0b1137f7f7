"""PCA at size: time against torch.svd_lowrank, memory of a 2 GB BTF, error against the best, and the speed of a query.

    python benchmarks/pca.py time | memory | error | query

`time` and `query` interleave what they compare and print ratios: on a shared machine only those mean anything.
"""

import argparse
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import torch

from baselines.mean_colour import MeanColour
from baselines.pca import PCA
from baselines.table import Table
from bench import hemisphere
from bench.btf import BTF, ArraySource, Source
from bench.codec import Fit
from bench.training import truncated_svd


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


def anonymous_bytes() -> int:
    """RssAnon of this process."""
    line = next(row for row in Path("/proc/self/status").read_text().splitlines() if row.startswith("RssAnon"))
    return int(line.split()[1]) * 1024


def peak_anonymous(work: Callable[[], object]) -> int:
    """The largest RssAnon while `work` runs, sampled every 2 ms."""
    peak, done = 0, threading.Event()

    def watch() -> None:
        nonlocal peak
        while not done.wait(0.002):
            peak = max(peak, anonymous_bytes())

    thread = threading.Thread(target=watch)
    thread.start()
    try:
        work()
    finally:
        done.set()
        thread.join()
    return peak


SHAPES = {"256": (256, 51, 51), "512": (512, 26, 25), "1024": (1024, 13, 12)}  # side, views, lights: 2 GB each


def mapped(side: int, count: int, folder: Path) -> ArraySource:
    """A memory-mapped half-float file whose slices are 2 GB together as float32."""
    path = folder / "values.npy"
    out = np.lib.format.open_memmap(path, "w+", np.float16, (count, side, side, 3))
    source = Generated(count, (side, side))
    for pair in range(count):
        out[pair] = source.slice(pair)
    out.flush()
    return ArraySource(np.load(path, mmap_mode="r"))


def encode_large(shape: str, kind: str) -> None:
    """One measurement of memory, in a process of its own."""
    side, views, lights = SHAPES[shape]
    with tempfile.TemporaryDirectory() as folder:
        count = views * lights
        source = mapped(side, count, Path(folder)) if kind == "mapped" else Generated(count, (side, side))
        btf = BTF("large", *grid(views, lights), source)
        before = anonymous_bytes()
        peak = peak_anonymous(lambda: PCA().encode(btf, Fit()))
    raw = count * side * side * 12
    print(f"{side}² × {count} pairs, {raw / 1e9:.2f} GB raw, {kind}: peak {peak / 1e9:.2f} GB anonymous, "
          f"{before / 1e9:.2f} GB of it before the encoding", flush=True)  # fmt: skip


def measure_memory() -> None:
    for shape in SHAPES:
        for kind in ("mapped", "generated"):
            subprocess.run([sys.executable, __file__, "memory-of", shape, kind], check=True)


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


def measure_query(rounds: int = 20, batch: int = 65_536) -> None:
    """Time of a query over that of mean-colour, least of all rounds."""
    rng = np.random.default_rng(0)
    btf = BTF("made", *grid(25, 25), ArraySource(rng.random((625, 64, 64, 3), np.float32)))
    codecs = {"mean-colour": MeanColour(), "table": Table()}
    codecs |= {f"pca {d} {k}": PCA(components=k, domain=d) for d in ("rgb", "log") for k in (8, 16, 32, 64)}
    materials = {name: codec.decode(codec.encode(btf, Fit()), torch.device("cpu")) for name, codec in codecs.items()}
    uv = torch.as_tensor(rng.random((batch, 2), np.float32))
    wo, wi = (torch.as_tensor(hemisphere.uniform(rng, batch)) for _ in range(2))
    least = dict.fromkeys(materials, float("inf"))
    for _ in range(rounds):
        for name, material in materials.items():
            least[name] = min(least[name], seconds(lambda material=material: material.query(uv, wo, wi)))
    for name, taken in least.items():
        print(f"{name}: {taken / batch * 1e9:.0f} ns a sample, {taken / least['mean-colour']:.1f} × mean-colour")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", choices=["time", "memory", "error", "query", "memory-of"])
    parser.add_argument("rest", nargs="*", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.what == "memory-of":
        encode_large(*arguments.rest)
    else:
        {"time": measure_time, "memory": measure_memory, "error": measure_error, "query": measure_query}[
            arguments.what
        ]()


if __name__ == "__main__":
    main()
