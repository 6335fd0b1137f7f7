"""How far the codecs of a run scatter over its seeds: the margins that a comparison will allow, and what they cost.

    neubtf-bench run ci --fresh --jobs 2 --out runs/seeds
    for seed in $(seq 3 11); do neubtf-bench run ci --seed $seed --jobs 2 --out runs/seeds; done
    python benchmarks/seeds.py runs/seeds [tests/bench/compare/seeds.json]

Prints, for each row whose seeds differ, the mean, the standard deviation s, 3 · s · √(2/3) of PSNR and of FLIP, and the
seconds of a fit. With a file, writes the scores of those rows, seed after seed, for the replays of the tests.
"""

import json
import math
import statistics
import sys
from pathlib import Path

from bench.compare.quantities import deciding
from bench.records import Record, load_run

CHANCE = 3 * math.sqrt(2 / 3)


def scores(job: Record) -> list[float]:
    """PSNR in dB and FLIP of the held-out pairs."""
    found = {quantity.name: quantity.value(job) for quantity in deciding(job)}
    return [value for name in ("PSNR", "FLIP") if (value := found[name]) is not None]


def main(run: str, out: str = "") -> None:
    """Print the table, and write the scores where a file is named."""
    rows: dict[str, list[Record]] = {}
    for job in load_run(run).jobs:
        rows.setdefault(f"{job['material']}/{job['label']}", []).append(job)
    measured = {name: [scores(job) for job in jobs] for name, jobs in rows.items()}
    scattered = {name: found for name, found in measured.items() if len({tuple(pair) for pair in found}) > 1}
    print(f"{'':<36}{'seeds':>6}{'PSNR':>8}{'s':>7}{'margin':>8}{'FLIP':>9}{'s':>9}{'margin':>9}{'fit, s':>8}")
    for name, found in scattered.items():
        (psnr, a), (flip, b) = ((statistics.fmean(v), statistics.stdev(v)) for v in zip(*found, strict=True))
        seconds = statistics.median(job["fit_seconds"] for job in rows[name])
        line = f"{name:<36}{len(found):>6}{psnr:>8.2f}{a:>7.3f}{CHANCE * a:>8.2f}"
        print(f"{line}{flip:>9.4f}{b:>9.4f}{CHANCE * b:>9.4f}{seconds:>8.1f}")
    if out:
        Path(out).write_text(json.dumps(scattered, indent=1) + "\n")


if __name__ == "__main__":
    main(*sys.argv[1:])
