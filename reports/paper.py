"""The quality in the NeuBTF paper beside ours: its Table 1, mean ± deviation over the slices of all pairs.

Rodriguez-Pardo, Kazatzis, Lopez-Moreno, Garces: "NeuBTF", Computers & Graphics 114 (2023). LPIPS, which it also gives,
is left out, because its weights would have to be downloaded. For its Table 2 see `reports.parameters`.
"""

from collections.abc import Iterable, Iterator

from bench.records import FLIP, PSNR, SSIM, Record, Run, shown_label, stats_of
from reports.numbers import NONE, plus_minus, spread
from reports.table import Table

METHOD = "neubtf"  # the codec whose numbers the paper gives
NO_DATA = "no data"
# By material: mean and deviation, as printed.
PUBLISHED = {
    "fabric01": {PSNR: "26.58 ± 1.820", SSIM: "0.710 ± 0.108", FLIP: "0.391 ± 0.047"},
    "fabric03": {PSNR: "27.73 ± 4.711", SSIM: "0.729 ± 0.142", FLIP: "0.426 ± 0.105"},
    "ceramic": {PSNR: "29.19 ± 2.111", SSIM: "0.819 ± 0.110", FLIP: "0.365 ± 0.065"},
    "embroidery": {PSNR: "28.79 ± 1.831", SSIM: "0.652 ± 0.156", FLIP: "0.391 ± 0.115"},
}
_METRICS = ((PSNR, "PSNR", "dB ↑", 2), (SSIM, "SSIM", "↑", 3), (FLIP, "FLIP", "↓", 3))


def paper_table(run: Run) -> Table | None:
    """A row for each material of the paper's table and each codec of the run; None if the run has none of them.

    If a material is missing, its row says `no data` beside the paper's numbers.
    """
    rows = list(_rows(run.jobs))
    if not rows:
        return None
    headers = [("material", ""), ("codec", "")]
    for _, name, unit, _ in _METRICS:
        headers += [(name, f"{unit} ours"), (name, f"{unit} paper")]
    notes = [
        "Mean ± standard deviation over the slices of all pairs, including training pairs, as in the paper.",
        "The paper gives numbers of NeuBTF only, and does not say at which exposure it compared pictures.",
        f"{NO_DATA}: the measured data are not on this machine; `neubtf-bench table unfinished` says why.",
    ]
    return Table("paper", "Quality, beside Table 1 of NeuBTF (2023)", headers, rows, notes, words=2)


def _rows(jobs: Iterable[Record]) -> Iterator[list[str]]:
    for job in jobs:
        if job["material"] not in PUBLISHED:
            continue
        published = PUBLISHED[job["material"]] if job["label"].split()[0] == METHOD else {}
        cells = [job["material"], shown_label(job)]
        for family, _, _, digits in _METRICS:
            cells += [_ours(job, family, digits), published.get(family, NONE)]
        yield cells


def _ours(job: Record, family: str, digits: int) -> str:
    if job["status"] != "ok":
        return NO_DATA if job["status"] == "unavailable" else job["status"]
    value = spread(stats_of(job, family, "all"))
    return plus_minus(value, digits) if isinstance(value, tuple) else value or NONE
