"""Compares the rate–distortion curve of each codec with that of log PCA, at equal quality.

One entry of a suite whose lists make several jobs gives a ladder of rates; its *curve* is named by the label without
the varied settings. The rate is the bytes of the whole file, the quality the pooled held-out PSNR in display space;
both are means over the seeds.
"""

from collections import defaultdict
from collections.abc import Iterator

import numpy as np

from bench.errors import InputError
from bench.metrics.bd import FEWEST, bd_psnr, bd_rate
from bench.records import PSNR, Record, stats_of

ANCHOR = "pca"


def rate_records(jobs: list[Record]) -> Iterator[Record]:
    """BD-rate in % and BD-PSNR in dB against the anchor, or why there is none, for each curve of one material's jobs.

    Yields nothing for curves of fewer than four rates, or if the anchor is missing.
    """
    curves = _curves(jobs)
    if ANCHOR not in curves:
        return
    for name, points in curves.items():
        if name == ANCHOR or len(points) < FEWEST:
            continue
        record: Record = {"kind": "rate", "curve": name, "anchor": ANCHOR, "metric": PSNR, "points": points.tolist()}
        try:
            rate, quality = bd_rate(curves[ANCHOR], points), bd_psnr(curves[ANCHOR], points)
        except InputError as error:
            yield record | {"error": str(error)}
        else:
            yield (
                record
                | {"bd_rate_percent": rate.value, "bd_psnr_db": quality.value}
                | {
                    "quality_db": [rate.low, rate.high],
                    "quality_overlap": rate.overlap,
                    "bytes": [quality.low, quality.high],
                    "bytes_overlap": quality.overlap,
                }
            )


def _curves(jobs: list[Record]) -> dict[str, np.ndarray]:
    """Points (n, 2) of bytes and quality by curve; jobs without a finite quality are left out."""
    seeds: dict[str, dict[str, list[tuple[float, float]]]] = defaultdict(lambda: defaultdict(list))
    for job in jobs:
        quality = stats_of(job, PSNR).get("pooled")
        if quality is not None:
            seeds[job["curve"]][job["label"]].append((job["bytes"]["total"], quality))
    return {curve: np.array([np.mean(points, 0) for points in labels.values()]) for curve, labels in seeds.items()}
