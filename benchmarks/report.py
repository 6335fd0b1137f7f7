"""How long `report` and `compare` take on many records, made from those of a real run: same numbers, other names.

    python benchmarks/report.py RUN [RECORDS] [MATERIALS] [CODECS]

The aim, for 2,000 records on a quiet machine: a report in 20 s and 300 MB, a comparison in 3 s. On a busy one the
time of the processor says more, and decides: the exit code is 1 where it exceeds the aim.
"""

import os
import shutil
import sys
import tempfile
import time
from pathlib import Path

from bench.records import Run, append, load_run

REPORT_SECONDS, REPORT_MB, COMPARE_SECONDS = 20, 300, 3


def multiplied(run: Run, folder: Path, records: int, materials: int, codecs: int) -> None:
    """Write a run of so many jobs, with the artefacts of `run`; the last seeds may be incomplete."""
    made: list[dict[str, object]] = []
    known = [job for job in run.jobs if job["status"] == "ok"]
    labels = list(dict.fromkeys(job["label"] for job in known))
    sources = {
        (material, label): next(job for job in known if (job["material"], job["label"]) == (material, label))
        for material in dict.fromkeys(job["material"] for job in known)
        for label in labels
    }
    names = list(dict.fromkeys(job["material"] for job in known))
    for number in range(records):
        m, c, seed = number // codecs % materials, number % codecs, number // codecs // materials
        source = sources[names[m % len(names)], labels[c % len(labels)]]
        label = source["label"] + (f" variant={c // len(labels)}" if c >= len(labels) else "")
        material = f"{source['material']}-{m}"
        name = {"job": f"{material}/{label}/{seed}", "material": material, "label": label, "seed": seed}
        made.append(source | name)
        if timing := run.timing(source):
            made.append(timing | {"job": name["job"], "run": source["run"]})
    start = {"jobs": [record["job"] for record in made if record["kind"] == "job"], "run": known[0]["run"]}
    for record in (run.starts[-1] | start, *made):
        append(folder, record)
    for part in ("slices", "pictures", "angular", "files", "drawings"):
        if (run.folder / part).is_dir():
            shutil.copytree(run.folder / part, folder / part)


def took(*words: str) -> tuple[float, float, float]:
    """Seconds on the clock and of the processor, and peak megabytes, of a command of the suite."""
    start = time.perf_counter()
    child = os.posix_spawn(sys.executable, [sys.executable, "-m", "bench.cli", *words], os.environ, file_actions=_QUIET)
    _, status, usage = os.wait4(child, 0)
    if os.waitstatus_to_exitcode(status) not in (0, 1):
        sys.exit(f"{' '.join(words)} failed")
    return time.perf_counter() - start, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024


_QUIET = [(os.POSIX_SPAWN_OPEN, 1, os.devnull, os.O_WRONLY, 0)]


def main(folder: Path, records: int = 2000, materials: int = 10, codecs: int = 10) -> int:
    """Measure and print."""
    with tempfile.TemporaryDirectory(prefix="neubtf-report-") as place:
        multiplied(load_run(folder), Path(place), records, materials, codecs)
        report, compare = took("report", place), took("compare", place, place)
        page = (Path(place) / "report.html").stat().st_size / 1e6
    print(f"{records} records of {materials} materials and {codecs} codecs; a page of {page:.1f} MB\n")
    print(f"{'':<10}{'seconds':>9}{'processor':>11}{'MB':>7}")
    for name, found in (("report", report), ("compare", compare)):
        print(f"{name:<10}{found[0]:>9.1f}{found[1]:>11.1f}{found[2]:>7.0f}")
    return int(report[1] > REPORT_SECONDS or report[2] > REPORT_MB or compare[1] > COMPARE_SECONDS)


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), *map(int, sys.argv[2:])))
