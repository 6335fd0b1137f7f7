"""Time of the metrics, ours against the tools of the field, interleaved in one run: `python benchmarks/metrics.py`.

Ours and theirs take turns, so that whatever else the machine does falls on both; the ratio of the medians (of the
sums, for the long job) is what is promised. Exits with 1 where a promise is not kept.
"""

import statistics
import sys
import time
from collections.abc import Callable

import flip_evaluator  # type: ignore[import-untyped]
import numpy as np
from skimage.metrics import peak_signal_noise_ratio, structural_similarity

from bench.btf import BTF, ArraySource
from bench.metrics.display import LUMA, to_display
from bench.metrics.flip import LDR
from bench.metrics.scoring import Scorer

Array = np.ndarray


def main() -> int:
    rows = [
        ("FLIP LDR 512², one pair", *flip_single(), 1.0),
        ("FLIP LDR 512², a slice of 8 against one reference", *flip_batch(), 0.6),
        ("PSNR + SSIM + FLIP, a slice of 500 at 256²", *whole_btf(), 0.7),
    ]
    print(f"{'':52}{'ours':>10}{'theirs':>10}{'ratio':>8}{'promised':>10}")
    for name, ours, theirs, promised in rows:
        print(f"{name:52}{ours * 1e3:8.1f}ms{theirs * 1e3:8.1f}ms{ours / theirs:8.2f}{promised:10.2f}")
    return int(any(ours > promised * theirs for _, ours, theirs, promised in rows))


def flip_single() -> tuple[float, float]:
    reference, test = noisy_pair(512)
    metric = LDR()
    return interleaved(
        lambda: metric.score(metric.prepare(reference, 1.0), test), lambda: their_flip(reference, test), rounds=20
    )


def flip_batch(count: int = 8) -> tuple[float, float]:
    reference, test = noisy_pair(512)
    metric = LDR()

    def ours() -> None:
        state = metric.prepare(reference, 1.0)
        for _ in range(count):
            metric.score(state, test)

    def theirs() -> None:
        for _ in range(count):
            their_flip(reference, test)

    mine, other = interleaved(ours, theirs, rounds=5)
    return mine / count, other / count


def whole_btf(distinct: int = 25, rounds: int = 20) -> tuple[float, float]:
    """500 slices; theirs start from pictures already in display space, ours from radiance, nothing kept between."""
    rng = np.random.default_rng(0)
    values, decoded = np.stack([noisy_pair(256, seed) for seed in range(distinct)], 1)
    direction = np.tile(np.array([0, 0, 1], np.float32), (distinct, 1))
    btf = BTF("noise", direction, direction, ArraySource(values))
    shown = [[to_display(v, 1.0).astype(np.float32) for v in stack] for stack in (values, decoded)]
    scorer = Scorer(btf, ["psnr_display", "ssim", "flip_ldr_67ppd"], exposure=1.0, cache_bytes=0)
    pairs = rng.permutation(distinct)

    def theirs() -> None:
        for pair in pairs:
            their_three(shown[0][pair], shown[1][pair])

    mine, other = interleaved(lambda: scorer.score(pairs, lambda i: decoded[i]), theirs, rounds, total=True)
    return mine / distinct, other / distinct


def noisy_pair(size: int, seed: int = 0) -> Array:
    rng = np.random.default_rng(seed)
    reference = rng.random((size, size, 3), dtype=np.float32)
    noise = np.float32(0.05) * rng.standard_normal(reference.shape, dtype=np.float32)
    return np.stack([reference, np.clip(reference + noise, 0, 1)])


def their_flip(reference: Array, test: Array, encoded: bool = False) -> float:
    found, _, _ = flip_evaluator.evaluate(
        reference, test, "LDR", inputsRGB=encoded, applyMagma=False, computeMeanError=False
    )
    return float(found.mean(dtype=np.float64))


def their_three(reference: Array, test: Array) -> tuple[float, float, float]:
    luma = LUMA.astype(np.float32)
    return (
        peak_signal_noise_ratio(reference, test, data_range=1),
        structural_similarity(
            reference @ luma, test @ luma, gaussian_weights=True, sigma=1.5, use_sample_covariance=False, data_range=1
        ),
        their_flip(reference, test, encoded=True),
    )


def interleaved(
    ours: Callable[[], object], theirs: Callable[[], object], rounds: int, total: bool = False
) -> tuple[float, float]:
    """Seconds of each, taking turns after one warm-up: medians over the rounds, or means where `total`."""
    seconds: tuple[list[float], list[float]] = ([], [])
    ours(), theirs()
    for _ in range(rounds):
        for call, found in zip((ours, theirs), seconds, strict=True):
            start = time.perf_counter()
            call()
            found.append(time.perf_counter() - start)
    middle = statistics.fmean if total else statistics.median
    return middle(seconds[0]), middle(seconds[1])


if __name__ == "__main__":
    sys.exit(main())
