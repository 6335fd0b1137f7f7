"""Renews the guard: the reference of the suite `ci`, what its tests replay, and how well it guards, measured.

    python tests/bench/compare/gate.py [--out runs/gate] [--seeds 9] [--jobs 2] [--codec NAME] [--only-read]

Runs the suite with so many seeds, three of them again as other processors compute, and with faults planted in fits:
half of the steps, and ReLU for the sine. Then it writes `bench/compare/references/ci.jsonl` and
`tests/bench/compare/seeds.json`, and prints three tables: the margin of each row, which is the smallest loss that it
sees; how often a run that lost nothing would be stopped, estimated on seeds that the reference does not hold; and what
became of the planted faults. Finished jobs are not done again; `--only-read` runs nothing and reads what is there. With
`--codec` only that codec is run and its rows are renewed; the others stand as they are in both files.
"""

import argparse
import json
import os
import random
import subprocess
import sys
from pathlib import Path
from typing import Any

from bench.compare.comparison import Comparison, compare
from bench.compare.quantities import deciding
from bench.compare.reference import committed, reference
from bench.compare.verdicts import Verdict
from bench.records import Record, Run, load_run
from bench.runs.suite import load_suite

SUITE = "ci"
REPLAYS = Path(__file__).with_name("seeds.json")
# Besides the machine's own: what makes it compute as another. PyTorch's kernels obey the first variable, the matrix
# products of oneDNN and MKL each their own.
PROCESSORS = {
    "avx2": {"ATEN_CPU_CAPABILITY": "avx2", "ONEDNN_MAX_CPU_ISA": "AVX2", "MKL_ENABLE_INSTRUCTIONS": "AVX2"},
    "default": {"ATEN_CPU_CAPABILITY": "default", "ONEDNN_MAX_CPU_ISA": "SSE41", "MKL_ENABLE_INSTRUCTIONS": "SSE4_2"},
}
COMPARED = (0, 1, 2)  # the seeds of the suite, which a change is judged by
RELU = ("neubtf-direct", "neubtf")  # codecs of a sine
TRIALS = 200


def main() -> None:
    """See the module."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--out", type=Path, default=Path("runs/gate"))
    parser.add_argument("--seeds", type=int, default=9)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--codec", help="renew the rows of this codec alone")
    parser.add_argument("--only-read", action="store_true")
    options = parser.parse_args()
    only = ("--codec", options.codec) if options.codec else ()
    if not options.only_read:
        drawing = [word for codec in (*_steps(), "vq") for word in ("--codec", codec)]
        for seed in range(options.seeds):
            _run(options.out / "native", seed, options.jobs, *(only or (drawing if seed not in COMPARED else ())))
        for name, words in _planted(options.codec).items():
            for seed in COMPARED:
                _run(options.out / name, seed, options.jobs, *words)
        for name in PROCESSORS:
            for seed in COMPARED:
                _run(options.out / name, seed, options.jobs, *only, processor=name)
    runs = {path.name: load_run(path) for path in sorted(options.out.iterdir()) if (path / "records.jsonl").is_file()}
    native = runs.pop("native")
    faults = {name: _relabelled(runs.pop(name), native) for name in _planted(options.codec) if name in runs}
    text, values = reference(native), _values(native, runs, faults)
    if options.codec:
        text = _renewed(committed(SUITE).read_text(), text, options.codec)
        before = json.loads(REPLAYS.read_text())
        renewed = {name: _merged(before[name], values[name], options.codec) for name in before.keys() & values.keys()}
        values = {name: renewed.get(name, rows) for name, rows in before.items()}
    committed(SUITE).write_text(text)
    REPLAYS.write_text(json.dumps(values, indent=None, separators=(",", ":")) + "\n")
    base = load_run(committed(SUITE))
    _print_margins(base)
    _print_alarms(base, runs)
    for name, run in faults.items():
        print(f"\nplanted, {name}: " + _words(compare(_only(base, run), run)))


def _steps() -> dict[str, int]:
    """The codecs of the suite that are fitted step by step, with their steps."""
    return {spec.codec: spec.settings["steps"] for spec in load_suite(SUITE).codecs if "steps" in spec.settings}


def _planted(only: str | None) -> dict[str, list[str]]:
    """By name, how a fault is planted, in `only` or in all: choices of codecs and settings on the command line."""
    steps = {codec: count for codec, count in _steps().items() if only in (None, codec)}
    half = [word for codec in steps for word in ("--codec", codec)]
    half += [word for codec, count in steps.items() for word in ("--set", f"{codec}.steps={count // 2}")]
    relu = [word for codec in RELU if only in (None, codec) for word in ("--codec", codec)]
    planted = {"half": half, "relu": [*relu, "--set", "activation=relu"] if relu else []}
    return {name: words for name, words in planted.items() if words}


def _run(folder: Path, seed: int, jobs: int, *words: str, processor: str = "") -> None:
    command = [sys.executable, "-m", "bench.cli", "run", SUITE, "--seed", str(seed), "--jobs", str(jobs), *words]
    print(" ".join(command[3:]), processor, flush=True)
    environment = os.environ | PROCESSORS.get(processor, {})
    subprocess.run([*command, "--out", str(folder)], env=environment, check=True, stdout=subprocess.DEVNULL)


def _renewed(before: str, now: str, codec: str) -> str:
    """The text of a reference whose rows of one codec are those of another reference, in their old places."""
    old, new = ([json.loads(line) for line in text.splitlines()] for text in (before, now))

    def rows(line: Record) -> bool:
        return line["kind"] != "run" and line["job"].split("/")[1].split()[0] == codec

    places: dict[tuple[str, str], int] = {}
    for line in [*old, *new]:
        places.setdefault(_place(line), len(places))
    # The other rows were timed in another start of the suite, whose floor is not this one's.
    fresh = []
    for line in new:
        if rows(line):
            fresh.append(line | {"run": codec} if line["kind"] == "timing" else line)
    lines = sorted([*(line for line in old if not rows(line)), *fresh], key=lambda line: places[_place(line)])
    return "".join(json.dumps(line, sort_keys=True, separators=(",", ":")) + "\n" for line in lines)


def _merged(before: dict[str, Any], now: dict[str, Any], codec: str) -> dict[str, Any]:
    """The rows of a run, of one codec those of now, of the others those of before."""

    def of_codec(rows: dict[str, Any], wanted: bool) -> dict[str, Any]:
        return {row: values for row, values in rows.items() if (row.split("/")[1].split()[0] == codec) == wanted}

    return of_codec(before, False) | of_codec(now, True)


def _place(line: Record) -> tuple[str, str]:
    """Its kind and its row, by which a reference is ordered."""
    return line["kind"], line.get("job", "").rpartition("/")[0]


def _relabelled(run: Run, native: Run) -> Run:
    """A run with a planted fault, under the names of the rows that it was planted in."""
    labels = {job["codec"]: job["label"] for job in native.jobs}
    return _with(run, ({**job, "label": labels[job["codec"]]} for job in run.jobs))


def _with(run: Run, jobs: Any) -> Run:
    made = Run(run.folder)
    for job in jobs:
        made.jobs.put(f"{job['material']}/{job['label']}/{job['seed']}", job)
    return made


def _only(base: Run, run: Run) -> Run:
    """The rows of the reference that a run has."""
    rows = {(job["material"], job["label"]) for job in run.jobs}
    return _with(base, (job for job in base.jobs if (job["material"], job["label"]) in rows))


def _values(native: Run, others: dict[str, Run], faults: dict[str, Run]) -> dict[str, Any]:
    """By run, row and quantity: the values of the seeds in order, of what decides and may scatter."""
    found: dict[str, Any] = {}
    for name, run in {"native": native, **others, **faults}.items():
        rows = found.setdefault(name, {})
        for job in sorted(run.jobs, key=lambda job: job["seed"]):
            values = rows.setdefault(f"{job['material']}/{job['label']}", {})
            for quantity in deciding(job):
                if quantity.metric and (value := quantity.value(job)) is not None:
                    values.setdefault(quantity.name, []).append(round(value, 6))
    return found


def _print_margins(base: Run) -> None:
    """The margins for three new seeds, which are the smallest losses that a row sees."""
    found = compare(base, _shifted(base))
    print(
        f"{'smallest loss seen':<60}"
        + "".join(f"{name:>12}" for name in ("PSNR", "train", "grazing", "footprints", "FLIP"))
    )
    for row in (*found.rows, *found.means):
        margins = {change.quantity.name: change.margin or 0.0 for change in row.deciding}
        numbers = [f"{margins.get(name, 0):>12.2f}" for name in ("PSNR", "train", "grazing", "footprints")]
        print(f"{row.name:<60}" + "".join(numbers) + f"{margins.get('FLIP', 0):>12.4f}")


def _shifted(base: Run) -> Run:
    """The last three seeds of each row as its first: they stand for new ones, as those would be the same again."""
    rows: dict[tuple[str, str], list[Record]] = {}
    for job in base.jobs:
        rows.setdefault((job["material"], job["label"]), []).append(job)
    last = (jobs[-len(COMPARED) :] for jobs in rows.values())
    return _with(base, (job | {"seed": seed} for jobs in last for seed, job in enumerate(jobs)))


def _print_alarms(base: Run, others: dict[str, Run]) -> None:
    """How often nothing that was lost is taken for a loss: three seeds against references of the others."""
    rows: dict[tuple[str, str], list[Record]] = {}
    for job in base.jobs:
        rows.setdefault((job["material"], job["label"]), []).append(job)
    if max(map(len, rows.values())) < 3 * len(COMPARED):
        print("\nfalse alarms: too few seeds to leave three of them out")
    else:
        rng = random.Random(0)
        stopped = [found for found in (_replay(base, rows, rng) for _ in range(TRIALS)) if found.exit_code]
        print(f"\nfalse alarms, three seeds against a reference of the others: {len(stopped)} of {TRIALS} runs")
        for found in stopped[:5]:
            print("  " + _words(found))
    for name, run in others.items():
        print(f"run as on {name}: " + _words(compare(_only(base, run), run)))


def _replay(base: Run, rows: dict[tuple[str, str], list[Record]], rng: random.Random) -> Comparison:
    """Three drawn seeds of each row against the others; rows that do not draw have no others, and stand as they are."""
    old, new = [], []
    for jobs in rows.values():
        drawn = rng.sample(jobs, len(jobs)) if len(jobs) > len(COMPARED) else jobs
        rest = drawn[len(COMPARED) :] or drawn
        old += [_bare(job) | {"seed": seed} for seed, job in enumerate(rest)]
        new += [_bare(job) | {"seed": seed} for seed, job in enumerate(drawn[: len(COMPARED)])]
    return compare(_with(base, old), _with(base, new))


def _bare(job: Record) -> Record:
    """Without its slices, whose intervals decide nothing and take long."""
    return {key: value for key, value in job.items() if key != "slices"}


def _words(found: Comparison) -> str:
    worse = [
        f"{row.name} ({'; '.join(row.reasons())})"
        for row in (*found.rows, *found.means)
        if row.verdict == Verdict.WORSE
    ]
    return f"exit code {found.exit_code}" + "".join(f"\n  {text}" for text in worse)


if __name__ == "__main__":
    main()
