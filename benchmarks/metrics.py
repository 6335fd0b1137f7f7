"""Time of the metrics, ours against the tools of the field, in turns: `python benchmarks/metrics.py [ROUNDS]`.

Whatever else the machine does falls on both; the ratio is what is promised. Theirs start from pictures in display
space, ours from radiance, and nothing is kept between. Exits with 1 where a promise is not kept.
"""

import sys
import time
from collections.abc import Callable

import flip_evaluator  # type: ignore[import-untyped]
import numpy as np
from skimage.metrics import peak_signal_noise_ratio, structural_similarity

from bench.btf import BTF, ArraySource
from bench.metrics.display import LUMA, to_display
from bench.metrics.scoring import Scorer

Array = np.ndarray
PSNR, SIMILARITY, FLIP = "psnr_display", "ssim", "flip_ldr_67ppd"


def their_flip(reference: Array, test: Array) -> None:
    flip_evaluator.evaluate(reference, test, "LDR", inputsRGB=True, applyMagma=False, computeMeanError=False)


def their_three(reference: Array, test: Array) -> None:
    gray = (reference @ LUMA.astype(np.float32), test @ LUMA.astype(np.float32))
    peak_signal_noise_ratio(reference, test, data_range=1)
    structural_similarity(*gray, gaussian_weights=True, sigma=1.5, use_sample_covariance=False, data_range=1)
    their_flip(reference, test)


def seconds_a_slice(
    metrics: list[str], theirs: Callable[[Array, Array], None], size: int, count: int, rounds: int
) -> Array:
    """Seconds (2,) a slice of ours and of theirs."""
    rng = np.random.default_rng(0)
    values = rng.random((count, size, size, 3), dtype=np.float32)
    decoded = np.clip(values + np.float32(0.05) * rng.standard_normal(values.shape, dtype=np.float32), 0, 1)
    up = np.tile(np.array([0, 0, 1], np.float32), (count, 1))
    shown = [[to_display(v, 1.0).astype(np.float32) for v in stack] for stack in (values, decoded)]
    scorer = Scorer(BTF("noise", up, up, ArraySource(values)), metrics, exposure=1.0, cache_bytes=0)
    calls = (
        lambda: scorer.score(np.arange(count), lambda i: decoded[i]),
        lambda: [theirs(*pair) for pair in zip(*shown, strict=True)],
    )
    turns = [[seconds(call) for call in calls] for _ in range(rounds + 1)]
    return np.mean(turns[1:], 0) / count  # the first round warms up


def seconds(call: Callable[[], object]) -> float:
    start = time.perf_counter()
    call()
    return time.perf_counter() - start


def main(rounds: int) -> int:
    kept = True
    for name, promised, case in (
        ("FLIP LDR, 512²", 1.0, ([FLIP], their_flip, 512, 1, rounds)),
        ("PSNR + SSIM + FLIP, 256²", 0.7, ([PSNR, SIMILARITY, FLIP], their_three, 256, 25, rounds)),
    ):
        ours, theirs = 1e3 * seconds_a_slice(*case)
        kept &= ours <= promised * theirs
        print(f"{name}: ours {ours:.1f} ms, theirs {theirs:.1f} ms, ratio {ours / theirs:.2f}, promised {promised}")
    return int(not kept)


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1]) if len(sys.argv) > 1 else 20))
