"""Three tables on the NeuBTF paper: its quality beside ours, in short and in full, and one change of its method a row.

The short one is laid out as Table 1 of Rodriguez-Pardo, Kazatzis, Lopez-Moreno, Garces: "NeuBTF", Computers & Graphics
114 (2023): a column for each of its materials. The full one has a row for every fit and group of pairs.
(`reports.parameters` has the paper's Table 2.) The third shows the suite `ablation`: each codec as it is, and what each
change of a setting is worth.

The *family* of a metric is its name without its variant: `ssim` of `ssim_periodic`. The suite `paper-nearest` has for
each material of the paper the *nearest* one that anyone can get.
"""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from functools import partial
from itertools import product
from math import isnan, nan
from operator import eq
from typing import Any

import pandas as pd

from bench.codecs.alike import stale
from bench.compare.frame import settings_in
from bench.metrics import all_exact, mean_over
from bench.records import FLIP, PSNR, SSIM, Job, Run, Statistics, as_published, grouped, method_of
from reports.numbers import EXACT, NONE, NOT_APPLICABLE, fixed, signed
from reports.rows import MaterialRows
from reports.rows import Row as MaterialRow
from reports.table import STALE, STALE_NOTE, Note, OfData, Table
from reports.values import Column, Row, written

NONE_YET = "none yet"  # a cell of ours for a material that could not be had
METHOD, RECIPE = "neubtf", "recipe=paper"  # the codec whose numbers the paper states, with the setting that it needs
# By material, then by family of metric: mean and deviation, as printed.
PUBLISHED = {
    "fabric01": {PSNR: (26.58, 1.820), SSIM: (0.710, 0.108), FLIP: (0.391, 0.047)},
    "fabric03": {PSNR: (27.73, 4.711), SSIM: (0.729, 0.142), FLIP: (0.426, 0.105)},
    "ceramic": {PSNR: (29.19, 2.111), SSIM: (0.819, 0.110), FLIP: (0.365, 0.065)},
    "embroidery": {PSNR: (28.79, 1.831), SSIM: (0.652, 0.156), FLIP: (0.391, 0.115)},
}
NEAREST_SUITE = "paper-nearest"
# By material of that suite: the material of the paper that it stands for.
NEAREST = {"wool": "fabric01", "corduroy": "fabric03", "bricks": "ceramic", "satin": "embroidery"}
# By family of metric: its name and unit in headers, and the decimals of a mean and, in the full table, of a deviation.
_METRICS = {PSNR: ("PSNR", "dB ↑", 2), SSIM: ("SSIM", "↑", 3), FLIP: ("FLIP", "↓", 3)}
_DIGITS = 3  # of deviations, as the paper prints them
# Groups of pairs: as records name them, and in words. The paper fits every pair that it scores, so its numbers stand
# beside ours of the fitted pairs and of all.
_PAIRS = {"all": "all", "train": "fitted", "heldout": "held out"}
_PUBLISHED_PAIRS = ("all", "train")
_UNLIKE = (
    "The paper does not state its exposure (docs/metrics.md, “Tables”), so a gap below a decibel means nothing; SSIM "
    "and FLIP depend on resolution, too. LPIPS is not computed, by design."
)
_NOTES = (
    "Mean ± standard deviation over slices; with several seeds the means of both over seeds. “seeds”: how many, and ± "
    "the standard deviation of the mean PSNR over them.",
    "Rows without recipe=paper are fitted by this suite's recipe, not by that of a paper.",
)
_HOW_TO_GET = "`neubtf-bench run paper` fits what is there; `run paper-nearest` what anyone can get."
SUITE = "ablation"  # whose jobs `ablation_table` shows


def paper_tables(
    run: Run, materials: Sequence[MaterialRows], absent: Mapping[str, str] | None = None, whole: bool = False
) -> list[Table]:
    """The paper's Table 1 beside ours and, with `whole`, the full table below it; none without anything to show.

    `absent` says by material where to get it, for materials that no job of the run names.
    """
    numbers = _numbers(run, materials)
    available = set(numbers["material"][numbers["status"] != "unavailable"])
    is_available = numbers["material"].isin(available)  # of each row
    missing = {name: where for name, where in (absent or {}).items() if name not in available}
    for row in numbers[~is_available].to_dict("records"):
        missing[row["material"]] = row["why"]
    numbers = numbers[is_available]
    if numbers.empty and not missing:
        return []
    tables = [_short_table(numbers, missing), _full_table(numbers, missing) if whole else None]
    return [table for table in tables if table]


def _short_table(numbers: pd.DataFrame, missing: Mapping[str, str]) -> Table:
    """By metric the paper's numbers, ours and the differences of the means; a column for each of its materials.

    Ours are means over seeds, over the fitted pairs, of one fit by the paper's recipe. A fit on the material itself is
    taken before one on the nearest material, then one that is not stale, then the one with the most fitted pairs, then
    that with the most steps. Without a fit ours are dashes, and a note says where to get the material; `missing` says
    so by the name of each that could not be had. `numbers` are rows of `_numbers`.
    """
    fits = numbers[numbers["by_recipe"] & (numbers["status"] == "ok") & (numbers["group"] == "train")]
    fits = fits.assign(fresh=~fits["stale"])
    best_first = fits.sort_values(["itself", "fresh", "fitted", "steps"], ascending=False, kind="stable")
    chosen = best_first.drop_duplicates(["paper", "family"])  # the first of each
    ours = {(fit["paper"], fit["family"]): fit for fit in chosen.to_dict("records")}
    fits_of_psnr = {material: fit for (material, family), fit in ours.items() if family == PSNR}
    columns = [Column("metric", "", "codec")]
    for material in PUBLISHED:
        fit = fits_of_psnr.get(material)
        below = NONE
        if fit:
            below = fit["material"] + (STALE if fit["stale"] else "")
        columns.append(Column(OfData(material), OfData(below), material, write=partial(_cell_of_material, material)))
    values = pd.DataFrame(_short_rows(ours), dtype=object)
    notes = _short_notes(fits_of_psnr, missing)
    stale = {material for material, fit in fits_of_psnr.items() if fit["stale"]}
    if stale:
        notes.append(Note((STALE_NOTE, stale.__contains__)))
    return written("paper", "Table 1 of NeuBTF (2023), and ours", values, columns, notes)


def _short_rows(ours: Mapping[tuple[str, str], Mapping[Any, Any]]) -> list[dict[str, Any]]:
    """The values of the short table, three rows for each metric.

    `ours` has by material of the paper and family the row of `_numbers` that is shown.
    """
    rows: list[dict[str, Any]] = []
    for family, (name, unit, digits) in _METRICS.items():
        printed: dict[str, Any] = {"codec": f"{name} {unit[-1]}, print", "digits": digits}
        of_fits: dict[str, Any] = {"codec": f"{name} {unit[-1]}, ours", "digits": digits}
        difference = of_fits | {"codec": f"{name}, ours − print", "signed": True}
        for material, published in PUBLISHED.items():
            printed[material], printed[f"{material} ±"] = published[family]
            fit = ours.get((material, family), {"mean": nan, "std": nan})
            of_fits[material], of_fits[f"{material} ±"] = fit["mean"], fit["std"]
            difference[material] = fit["mean"] - printed[material]
        rows += [printed, of_fits, difference]
    rows.append({"codec": "LPIPS ↓", **dict.fromkeys(PUBLISHED, "not computed")})
    return rows


def _short_notes(fits: Mapping[str, Mapping[Any, Any]], missing: Mapping[str, str]) -> list[str]:
    """The notes of the short table: which fits are ours, by material of the paper, and why others are missing."""
    notes = ["Mean ± standard deviation over the slices of fitted pairs, because the paper fits what it scores."]
    # Each is about the column of its material alone.
    fits_in_words = [(_fit_in_words(fits[name]), partial(eq, name)) for name in PUBLISHED if name in fits]
    if fits_in_words:
        notes.append(Note(*fits_in_words, around=(f"Ours: {METHOD} {RECIPE}: ", "; ", ".")))
    notes.append(_UNLIKE)
    for material in PUBLISHED:
        if material in fits:
            continue
        candidates = [material, *(name for name, paper in NEAREST.items() if paper == material)]
        reasons = [f"{NONE}: {name}: {missing[name]}." for name in candidates if name in missing]
        notes += reasons or [f"{NONE}: {material}: no fit of {METHOD} {RECIPE}."]
    if len(fits_in_words) < len(PUBLISHED):
        notes.append(_HOW_TO_GET)
    return notes


def _cell_of_material(material: str, row: Row) -> str:
    """The cell of a material in a row of the short table; each row has its own decimals."""
    signed_row = row["signed"] is True
    beside = f"{material} ±"
    return Column("", "", material, row["digits"], signed_row, beside=beside, beside_digits=_DIGITS).cell(row)


def _fit_in_words(fit: Mapping[Any, Any]) -> str:
    """A row of `_numbers` as a fit: "corduroy, slices=4, steps=20000, 3 seeds, ± 0.07 dB", the deviation of PSNR over
    them."""
    settings = settings_in(fit["label"])
    for name in ("slices", "steps"):  # what a fit has seen; no label has a default
        if fit[name] and not any(word.startswith(f"{name}=") for word in settings):
            settings.append(f"{name}={fit[name]}")
    seeds = f"{fit['seeds']} seed{'s' if fit['seeds'] > 1 else ''}"
    words = [f"{fit['material']} {fit['size']}".strip(), f"{fit['fitted']:,} pairs", *settings, seeds]
    if not isnan(fit["over_seeds"]):
        words.append(f"± {fixed(fit['over_seeds'], 2)} dB")
    return ", ".join(words)


def _full_table(numbers: pd.DataFrame, missing: Mapping[str, str]) -> Table | None:
    """Three rows for each label on each material, as means over seeds; None without any row.

    They are over all pairs, over those that were fitted, and over held-out ones. A label without numbers has one row,
    with its status. A material of the paper that could not be had has one with the paper's numbers beside `none yet`; a
    nearest one has none. A note says of either where to get it. The arguments are as for `_short_table`.
    """
    rows = []
    for _, of_group in numbers.groupby(["material", "label", "status", "fitted", "group"], sort=False):
        fits = of_group.to_dict("records")
        if fits[0]["status"] == "ok" or fits[0]["group"] == "all":
            rows.append(_full_row(fits))
    for material in [name for name in missing if name in PUBLISHED]:
        row = {"material": material, "codec": f"{METHOD} {RECIPE}", "seeds": "", "pairs": "all", "stale": False}
        rows.append(row | dict.fromkeys(_METRICS, NONE_YET) | _printed(material))
    if not rows:
        return None
    columns = [Column(name, "", name) for name in ("material", "codec", "seeds", "pairs")]
    for family, (name, unit, digits) in _METRICS.items():
        ours = Column(name, f"{unit} ours", family, digits, beside=f"{family} ±")
        field = f"{family} print"
        columns += [ours, Column(name, f"{unit} paper", field, digits, beside=f"{field} ±", beside_digits=_DIGITS)]
    notes = [*_NOTES, _UNLIKE, *(f"{NONE_YET}: {material}: {where}." for material, where in missing.items())]
    if missing:
        notes.append(_HOW_TO_GET)
    values = pd.DataFrame(rows, dtype=object)
    return written("paper", "Quality of every fit, beside Table 1 of NeuBTF (2023)", values, columns, notes, words=4)


def _full_row(fits: Sequence[Mapping[Any, Any]]) -> dict[str, Any]:
    """The values of a row of the full table, from its rows of `_numbers`, one for each family of metric."""
    first = fits[0]
    name = first["material"] if first["itself"] else f"{first['material']}, for {first['paper']}"
    spread = "" if isnan(first["over_seeds"]) else f", ± {fixed(first['over_seeds'], 2)}"
    row: dict[str, Any] = {"material": ", ".join(filter(None, [name, first["size"]])), "codec": first["label"]}
    row |= {"seeds": f"{first['seeds']}{spread}", "pairs": _PAIRS[first["group"]], "stale": first["stale"]}
    for fit in fits:
        family = fit["family"]
        row |= {family: fit["why"] if isnan(fit["mean"]) else fit["mean"], f"{family} ±": fit["std"]}
    row |= _printed(first["paper"] if first["codec"] == METHOD else "")  # of other codecs it states none
    if first["group"] not in _PUBLISHED_PAIRS:
        row |= dict.fromkeys([f"{family} print" for family in _METRICS], "")
    return row


def _printed(material: str) -> dict[str, float]:
    """The paper's numbers of a material as values of the full table; NaN of another material."""
    values = {}
    for family, numbers in PUBLISHED.get(material, dict.fromkeys(_METRICS, (nan, nan))).items():
        values[f"{family} print"], values[f"{family} print ±"] = numbers
    return values


def _names_of_starts(run: Run, suite: str) -> set[str | None]:
    """The names of the starts of this suite, because a run's folder may have starts of several suites."""
    return {start.get("run") for start in run.starts if start.get("suite") == suite}


def _numbers(run: Run, materials: Sequence[MaterialRows]) -> pd.DataFrame:
    """What both tables show: a row for each material, label, version of the codec, status, number of fitted pairs,
    group of pairs and family.

    `material` is ours and `paper` the one that it stands for, or is `itself`; `by_recipe` says whether the fit is by
    the paper's method and recipe. `mean` and `std` are the mean and the deviation over slices, both averaged over the
    `seeds`; `over_seeds` is the deviation of the mean over these, NaN for a single seed. Without a number `mean` is
    NaN, and `why` says why: “exact”, “n/a”, a dash if it was not measured, the status, or where to get the material.
    """
    # A nearest material counts only in its suite: other suites measure these materials, too.
    starts = _names_of_starts(run, NEAREST_SUITE)
    fits = [fit for material in materials if material.name in PUBLISHED for fit in material.rows]
    nearest = [fit for material in materials if material.name in NEAREST for fit in material.rows]
    fits += [fit for fit in nearest if fit.job.get("run") in starts]
    rows = [_number_of_job(fit, group, family) for fit, group, family in product(fits, _PAIRS, _METRICS)]
    keys = ["material", "paper", "codec", "label", "version", "status", "fitted", "group", "family"]
    frame = pd.DataFrame(rows, columns=[*keys, "by_recipe", "stale", "slices", "steps", "size", "why", "mean", "std"])
    numbers = (
        frame.astype({"mean": float, "std": float})
        .groupby(keys, sort=False, as_index=False)
        .agg(
            mean=("mean", "mean"),
            std=("std", "mean"),
            over_seeds=("mean", lambda means: means.std(skipna=False)),
            seeds=("mean", "size"),
            stale=("stale", "any"),
            **{name: (name, "first") for name in ("by_recipe", "slices", "steps", "size", "why")},
        )
    )
    numbers["itself"] = numbers["material"] == numbers["paper"]
    return numbers


def _number_of_job(fit: MaterialRow, group: str, family: str) -> dict[str, Any]:
    """The row of one job, group and family, before `_numbers` takes the seeds together."""
    job = fit.job
    settings = job.get("settings", {})
    height, width = job.get("shape", (0, 0))  # texels; a job without a result has none
    stats = fit.stats(group, family) if job["status"] == "ok" else Statistics()
    exact = all_exact(stats)
    return {
        "material": job["material"],
        "paper": NEAREST.get(job["material"], job["material"]),
        "codec": job["codec"],
        "label": fit.label,
        "version": job.get("fit_key", {}).get("version", 0),
        "status": job["status"],
        "group": group,
        "family": family,
        "fitted": job.get("pairs", {}).get("train", 0),
        "by_recipe": job["codec"] == METHOD and as_published(job),
        "stale": job["status"] == "ok" and bool(fit.values["stale"]),
        "slices": settings.get("slices", 0),
        "steps": settings.get("steps", 0),
        "size": f"{height} × {width}" if height != width else "",  # the paper's are square
        "mean": nan if exact else stats.get("mean"),
        "std": nan if exact else stats.get("std"),
        "why": _why_no_number(job, stats),
    }


def _why_no_number(job: Job, stats: Statistics) -> str:
    """Why a job has no number of a metric, whose statistics are empty if it was not measured; "" if it has one."""
    if job["status"] == "unavailable":
        return str(job.get("error", ""))
    if job["status"] != "ok":
        return str(job["status"])
    if all_exact(stats):
        return EXACT
    if not stats:
        return NONE
    return NOT_APPLICABLE if stats.get("mean") is None else ""


def ablation_table(run: Run) -> Table | None:
    """A row for each label of the suite `ablation`: a codec as it is, or with one change. None if it was not run.

    On each material a row has its PSNR, the gain against the codec as it is, and SSIM, as means over seeds.
    """
    starts = _names_of_starts(run, SUITE)
    of_suite = [job for job in run.jobs if job.get("run") in starts]
    jobs = [job for job in of_suite if job["status"] == "ok"]
    if not jobs:
        return None
    materials = list(dict.fromkeys(job["material"] for job in jobs))

    columns = [Column("codec", "", "codec"), Column("change", "", "change")]
    columns += [Column("decoder", "param.", "parameters", 0), Column("a sample", "FLOP", "flops", 0)]
    for material in materials:
        columns.append(Column(material, "dB ↑", f"{material} psnr", 2, ranked=False))
        columns.append(Column("against as it is", "dB", f"{material} gain", write=partial(_gain_cell, material)))
        columns.append(Column(material, "SSIM ↑", f"{material} ssim", 3, ranked=False))
    notes = [
        "dB: mean display PSNR of validation pairs; no test pair is among them.",
        Note(("FLOP: of the decoder's network.", lambda name: name == "a sample")),  # of that column alone
        "A change is told by the settings that differ from the row “as it is”.",
    ]

    values = pd.DataFrame(_ablation_rows(of_suite, materials, stale(run.jobs)))
    if values.filter(regex=" psnr$| ssim$").isna().any(axis=None) or values["flops"].isna().any():
        notes.append(f"{NONE}: not measured.")
    title = f"{', '.join(materials)}: NeuBTF, one thing changed at a time"
    return written("ablation", title, values, columns, notes, words=2)


def _ablation_rows(
    of_suite: Sequence[Job], materials: Sequence[str], older: Collection[str]
) -> Iterator[dict[str, Any]]:
    """The values of each label of a finished job; its parameters and FLOP are those of its first one.

    `of_suite` are all jobs of the suite in its order, because the codec as it is may be unfinished.
    """
    unchanged: dict[str, str] = {}  # by codec: its first label in the suite, which is the codec as it is
    for job in of_suite:
        unchanged.setdefault(method_of(job), job["label"])
    jobs = [job for job in of_suite if job["status"] == "ok"]
    for label, of_label in grouped(jobs, lambda job: str(job["label"])).items():
        job = of_label[0]
        unchanged_label = unchanged[method_of(job)]
        settings, usual = label.split()[1:], unchanged_label.split()[1:]  # after the codec
        names = {setting.partition("=")[0] for setting in settings}
        changes = [setting for setting in settings if setting not in usual]
        changes += [f"without {setting}" for setting in usual if setting.partition("=")[0] not in names]
        row: dict[str, Any] = {"codec": job["codec"], "change": " ".join(changes) or "as it is"}
        row |= {"parameters": job["parameters"], "flops": job["cost"].get("flops_per_sample", nan)}
        row["stale"] = any(each["job"] in older for each in of_label)
        for material in materials:
            psnr = _mean_over_seeds(jobs, material, label, PSNR)
            row[f"{material} psnr"] = psnr
            row[f"{material} ssim"] = _mean_over_seeds(jobs, material, label, SSIM)
            row[f"{material} gain"] = nan  # that of the codec as it is would be 0
            if label != unchanged_label:
                row[f"{material} gain"] = psnr - _mean_over_seeds(jobs, material, unchanged_label, PSNR)
        yield row


def _gain_cell(material: str, row: Row) -> str:
    """The gain of a row on a material in dB, with its sign; "" without one."""
    gain = row[f"{material} gain"]
    return "" if isnan(gain) else signed(gain)


def _mean_over_seeds(jobs: Iterable[Job], material: str, label: str, family: str) -> float:
    """The mean of a metric over slices, then over the seeds of a label on a material; NaN where there is no number."""
    mean = mean_over([job for job in jobs if (job["material"], job["label"]) == (material, label)], family)
    return nan if mean is None else mean
