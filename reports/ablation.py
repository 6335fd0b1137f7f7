"""NeuBTF without one thing at a time: each codec of the suite `ablation` as it is, and what each change is worth."""

from collections.abc import Iterable
from statistics import fmean

from bench.records import PSNR, SSIM, Record, Run, stats_of
from reports.numbers import NONE, fixed, integer, signed
from reports.rows import of_suite
from reports.table import Table

SUITE = "ablation"


def ablation_table(run: Run) -> Table | None:
    """A row for each change; its quality on each material, a mean over seeds. None where the suite was not run."""
    jobs = [job for job in of_suite(run, SUITE) if job["status"] == "ok"]
    if not jobs:
        return None
    materials = list(dict.fromkeys(job["material"] for job in jobs))
    headers = [("codec", ""), ("change", ""), ("decoder", "param."), ("a sample", "FLOP")]
    for material in materials:
        headers += [(material, "dB ↑"), ("against as it is", "dB"), (material, "SSIM ↑")]
    notes = [
        "dB: mean display PSNR of the pairs held out to choose settings by; no test pair is among them.",
        "FLOP: of the decoder's network. A change is told by the settings that differ from the row “as it is”.",
    ]
    firsts: dict[str, Record] = {}
    base: dict[str, str] = {}  # of each codec the first label, which is the codec as it is
    for job in jobs:
        firsts.setdefault(job["label"], job)
        base.setdefault(job["codec"], job["label"])
    rows = []
    for label, job in firsts.items():
        whole = base[job["codec"]]
        changes = " ".join(word for word in label.split()[1:] if word not in whole.split())
        cost = [integer(job["parameters"]), integer(job["cost"].get("flops_per_sample"))]
        cells = [job["codec"], changes or "as it is", *cost]
        for material in materials:
            ours, theirs = (_mean(jobs, material, which, PSNR) for which in (label, whole))
            both = ours is not None and theirs is not None and label != whole
            cells += [fixed(ours, 2), signed(ours - theirs) if both else ""]  # type: ignore[operator]
            cells.append(fixed(_mean(jobs, material, label, SSIM), 3))
        rows.append(cells)
    if any(NONE in row for row in rows):
        notes.append(f"{NONE}: not measured.")
    title = f"{', '.join(materials)}: NeuBTF, one thing changed at a time"
    return Table("ablation", title, headers, rows, notes, words=2)


def _mean(jobs: Iterable[Record], material: str, label: str, family: str) -> float | None:
    """The mean over seeds of a mean over slices; None where there is no number."""
    means = (stats_of(job, family).get("mean") for job in jobs if (job["material"], job["label"]) == (material, label))
    return fmean(numbers) if (numbers := [mean for mean in means if mean is not None]) else None
