"""Two tables on the NeuBTF paper: its quality beside ours, and its method with one thing changed at a time.

The first sets Table 1 of Rodriguez-Pardo, Kazatzis, Lopez-Moreno, Garces: "NeuBTF", Computers & Graphics 114 (2023),
beside our numbers: mean ± deviation over the slices of all, of fitted and of held-out pairs, as means over seeds.
(`reports.parameters` has its Table 2.) The second shows the suite `ablation`: each codec as it is, and what each change
of a setting is worth.

A *slice* is one picture of a material: all texels at one *pair* of view and light directions. A *job* is one codec with
its settings on one material, fitted with one seed; its *label* is the codec with these settings, `neubtf recipe=paper`.
The *family* of a metric is its name without its variant: `ssim` of `ssim_periodic`. The suite
`paper-nearest` has for each material of the paper the *nearest* one that anyone can get.
"""

from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from statistics import fmean, stdev

from bench.metrics import stats_of
from bench.records import FLIP, PSNR, SSIM, Job, Run, codec_of, grouped, shown_label
from reports.numbers import NONE, fixed, integer, plus_minus, signed, stated
from reports.rows import of_suite
from reports.table import Note, Table

METHOD = "neubtf"  # the codec whose figures the paper states
NONE_YET = "none yet"  # a cell of ours for a material that could not be had
# By material, then by family of metric: mean and deviation, as printed.
PUBLISHED = {
    "fabric01": {PSNR: "26.58 ± 1.820", SSIM: "0.710 ± 0.108", FLIP: "0.391 ± 0.047"},
    "fabric03": {PSNR: "27.73 ± 4.711", SSIM: "0.729 ± 0.142", FLIP: "0.426 ± 0.105"},
    "ceramic": {PSNR: "29.19 ± 2.111", SSIM: "0.819 ± 0.110", FLIP: "0.365 ± 0.065"},
    "embroidery": {PSNR: "28.79 ± 1.831", SSIM: "0.652 ± 0.156", FLIP: "0.391 ± 0.115"},
}
NEAREST_SUITE = "paper-nearest"
# By material of that suite: the material of the paper that it stands for.
NEAREST = {"wool": "fabric01", "corduroy": "fabric03", "bricks": "ceramic", "satin": "embroidery"}
# Each metric of the table: its family, its name and unit in the header, and the decimals of our numbers.
_METRICS = ((PSNR, "PSNR", "dB ↑", 2), (SSIM, "SSIM", "↑", 3), (FLIP, "FLIP", "↓", 3))
# Groups of pairs: in words, and as records name them. The paper fits every pair that it scores, so its figures stand
# beside ours of the fitted pairs and of all.
_PAIRS = (("all", "all"), ("fitted", "train"), ("held out", "heldout"))
_PUBLISHED_PAIRS = ("all", "train")
_NOTES = (
    "Mean ± standard deviation over slices; with several seeds the means of both over seeds. “seeds”: how many, and ± "
    "the standard deviation of the mean PSNR over them; on rendered surfaces each has held-out pairs of its own.",
    "A row without recipe=paper is fitted by the recipe of neubtf-bench.",
    "The paper fits every pair that it scores, at an exposure that it does not state (docs/metrics.md, “Tables”). "
    "LPIPS, its fourth row, is not computed here, by design; SSIM and FLIP depend on resolution.",
)
SUITE = "ablation"  # whose jobs `ablation_table` shows


def paper_table(run: Run, absent: Mapping[str, str] | None = None) -> Table | None:
    """Three rows for each label on a material of the paper's table, or on one that is nearest to it; None without any
    row.

    They are over all pairs, over those that were fitted, and over held-out ones, as means over seeds. A material of the
    paper that could not be had has one row with the paper's figures beside `none yet`; a nearest one has no row. A note
    says of either where to get it. `absent` says where by material, for materials that no job of the run names.
    """
    # The jobs to show. A nearest material counts only in its suite: other suites measure these materials, too.
    jobs = [job for job in run.jobs if job["material"] in PUBLISHED]
    jobs += [job for job in of_suite(run, NEAREST_SUITE) if job["material"] in NEAREST]
    available = {job["material"] for job in jobs if job["status"] != "unavailable"}  # materials that could be had
    missing = _missing(jobs, available, absent or {})
    # The rows, and the notes.
    rows: list[list[str]] = []
    jobs_of_rows: list[list[str]] = []
    seeds_of: dict[str, dict[tuple[str, str], list[Job]]] = {}  # by material, then by label and status
    for job in jobs:
        if job["material"] in available:
            labels = seeds_of.setdefault(job["material"], {})
            labels.setdefault((job["label"], job["status"]), []).append(job)
    for labels in seeds_of.values():
        for seeds in labels.values():
            of_seeds = list(_rows(seeds))
            rows += of_seeds
            jobs_of_rows += [[job["job"] for job in seeds]] * len(of_seeds)
    for material in missing:
        if material in PUBLISHED:  # the paper has figures of no other
            cells = [material, f"{METHOD} recipe=paper", "", "all"]
            for family, *_ in _METRICS:
                cells += [NONE_YET, PUBLISHED[material][family]]
            rows.append(cells)
            jobs_of_rows.append([])
    if not rows:
        return None
    headers = [("material", ""), ("codec", ""), ("seeds", ""), ("pairs", "")]
    for _, name, unit, _ in _METRICS:
        headers += [(name, f"{unit} ours"), (name, f"{unit} paper")]
    notes = [*_NOTES, *(f"{NONE_YET}: {material}: {where}." for material, where in missing.items())]
    if missing:
        notes.append("`neubtf-bench run paper` fits what is there; `run paper-nearest` what anyone can get.")
    title = "Quality, beside Table 1 of NeuBTF (2023)"
    return Table("paper", title, headers, rows, notes, words=4, jobs=jobs_of_rows)


def _missing(jobs: Iterable[Job], available: Container[str], absent: Mapping[str, str]) -> dict[str, str]:
    """By material that could not be had: where to get it, in words. For `absent` see `paper_table`."""
    missing = {name: where for name, where in absent.items() if name not in available}
    for job in jobs:
        if job["material"] not in available:
            missing[job["material"]] = str(job.get("error", ""))  # the error of such a job says where
    return missing


def _rows(jobs: Sequence[Job]) -> Iterator[list[str]]:
    """The rows of the seeds of one label on one material; those over the pairs of the paper have its figures beside.

    Jobs without numbers have the first row alone, with their status in place of our numbers.
    """
    first = jobs[0]
    material = str(first["material"])
    name = material if material in PUBLISHED else f"{material}, for {NEAREST[material]}"
    height, width = first.get("shape", (0, 0))  # texels; a job without a result has none
    if height != width:  # the paper's are square
        name += f", {height} × {width}"
    published: Mapping[str, str] = {}  # by metric; the paper has figures of its own method alone
    if codec_of(first["label"]) == METHOD:
        published = PUBLISHED[NEAREST.get(material, material)]
    measured = first["status"] == "ok"
    pairs_of_rows = _PAIRS if measured else _PAIRS[:1]
    for pairs, group in pairs_of_rows:
        cells = [name, shown_label(first), _seeds_in_words(jobs, group), pairs]
        for family, _, _, digits in _METRICS:
            cells.append(_quality(jobs, family, group, digits) if measured else first["status"])
            cells.append(published.get(family, NONE) if group in _PUBLISHED_PAIRS else "")
        yield cells


def _seeds_in_words(jobs: Sequence[Job], group: str) -> str:
    """How many seeds there are, and the deviation of their PSNR over a group of pairs: "3, ± 0.05".

    Without the deviation if there is one seed, or one without a number.
    """
    means = []
    for job in jobs:
        mean = stats_of(job, PSNR, group).get("mean")
        if mean is not None:
            means.append(mean)
    if len(means) < max(2, len(jobs)):
        return str(len(jobs))
    return f"{len(jobs)}, ± {fixed(stdev(means), 2)}"


def _quality(jobs: Sequence[Job], family: str, group: str, digits: int) -> str:
    """Mean ± deviation of a metric over the slices of a group of pairs, as means over the jobs that have them.

    If none has: “exact” if no slice of the first has an error, “n/a” if the metric does not apply, a dash if it was not
    measured.
    """
    values = [stated(stats_of(job, family, group), "mean", "std") for job in jobs]
    numbers = [value for value in values if isinstance(value, tuple)]
    if not numbers:
        return values[0] or NONE  # a word in place of a number, such as “exact”, or None
    means_over_jobs = tuple(fmean(values) for values in zip(*numbers, strict=False))
    return plus_minus(means_over_jobs, digits)


def ablation_table(run: Run) -> Table | None:
    """A row for each label of the suite `ablation`: a codec as it is, or with one change. None if it was not run.

    On each material a row has its PSNR, the gain against the codec as it is, and SSIM, as means over seeds.
    """
    jobs = [job for job in of_suite(run, SUITE) if job["status"] == "ok"]
    if not jobs:
        return None
    materials = list(dict.fromkeys(job["material"] for job in jobs))

    headers = [("codec", ""), ("change", ""), ("decoder", "param."), ("a sample", "FLOP")]
    for material in materials:
        headers += [(material, "dB ↑"), ("against as it is", "dB"), (material, "SSIM ↑")]
    notes = [
        "dB: mean display PSNR of validation pairs; no test pair is among them.",
        Note(("FLOP: of the decoder's network.", lambda name: name == "a sample")),  # of that column alone
        "A change is told by the settings that differ from the row “as it is”.",
    ]

    # A row for each label; its parameters and FLOP are those of its first job.
    by_label = grouped(jobs, lambda job: str(job["label"]))
    unchanged: dict[str, str] = {}  # by codec: its first label in the suite, which is the codec as it is
    for job in jobs:
        unchanged.setdefault(job["codec"], job["label"])
    rows = []
    for label, (job, *_) in by_label.items():
        unchanged_label = unchanged[job["codec"]]
        settings = label.split()[1:]  # after the codec
        changes = " ".join(setting for setting in settings if setting not in unchanged_label.split())
        cost = [integer(job["parameters"]), integer(job["cost"].get("flops_per_sample"))]
        cells = [job["codec"], changes or "as it is", *cost]
        for material in materials:
            psnr = _mean(jobs, material, label, PSNR)
            unchanged_psnr = _mean(jobs, material, unchanged_label, PSNR)
            gain = ""  # also of the codec as it is, which would have 0
            if psnr is not None and unchanged_psnr is not None and label != unchanged_label:
                gain = signed(psnr - unchanged_psnr)
            ssim = _mean(jobs, material, label, SSIM)
            cells += [fixed(psnr, 2), gain, fixed(ssim, 3)]
        rows.append(cells)
    if any(NONE in row for row in rows):
        notes.append(f"{NONE}: not measured.")
    title = f"{', '.join(materials)}: NeuBTF, one thing changed at a time"
    jobs_of_rows = [[job["job"] for job in of_label] for of_label in by_label.values()]
    return Table("ablation", title, headers, rows, notes, words=2, jobs=jobs_of_rows)


def _mean(jobs: Iterable[Job], material: str, label: str, family: str) -> float | None:
    """The mean of a metric over slices, then over the seeds of a label on a material; None where there is no number."""
    numbers = []
    for job in jobs:
        if job["material"] == material and job["label"] == label:
            mean = stats_of(job, family).get("mean")
            if mean is not None:
                numbers.append(mean)
    return fmean(numbers) if numbers else None
