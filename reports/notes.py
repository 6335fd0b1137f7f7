"""Footnotes of tables: the meaning of the numbers, omissions, and the conditions of timings."""

from collections.abc import Iterable, Iterator, Sequence
from statistics import fmean

from bench.metrics import label_of
from bench.records import PSNR, Record, Run, gate, grouped, shown_columns
from reports.numbers import significant
from reports.rows import MaterialRows, Row
from reports.table import Note, Part

_BYTES = ("decoder", "texture", "other", "total", "shared", "resident", "bits per")
_TIMES = ("time", "95 % interval", "fused")
_COST = {*_BYTES, *_TIMES, "tex.", *(name for name, _, _ in shown_columns().values())}


def about_quality(text: str) -> Part:
    """A note about the columns that show quality."""
    return text, lambda name: name not in _COST


def about_times(text: str) -> Note:
    """A note about the columns of times."""
    return Note((text, _TIMES.__contains__))


def main_notes(material: MaterialRows) -> list[str]:
    """The footnotes of a main table."""
    return list(dict.fromkeys([*quality_notes(material), *cost_notes(material)]))


def quality_notes(material: MaterialRows) -> list[str]:
    """Footnotes that define the quality columns."""
    if (job := material.first) is None:
        return []
    held = f"the {job['split']} pairs" if "split" in job else "the held-out pairs"
    pairs = held if gate(job["scores"]) == "heldout" else "all pairs, none being held out"
    text = f"Quality is measured at {pairs} (“train”: training pairs), decoded from the file, as a mean over slices."
    return [Note(about_quality(text)), *_metrics(material), *common_notes(material)]


def cost_notes(material: MaterialRows) -> list[str]:
    """Footnotes that define the columns of size and time."""
    bytes_note = Note(("Bytes are those of the whole file; “other” includes the header.", _BYTES.__contains__))
    times = map(about_times, [*_timing(material), *height_notes([material]), *_programs(material)])
    notes = [bytes_note, *_shared(material), *times, *_not_comparable(material)]
    return notes if material.first else []


def _shared(material: MaterialRows) -> Iterator[str]:
    """Footnotes for codecs whose file also needs the file of a shared network."""
    shared = [row for row in material.measured if "shared" in row.job["bytes"]]
    for size, rows in grouped(shared, lambda row: row.job["bytes"]["shared"]).items():
        names = ", ".join(dict.fromkeys(row.label for row in rows))
        needs = f"the decoder also needs the shared network, {size:,} bytes for all materials, not in the total."
        yield Note((f"{names}: {needs}", _BYTES.__contains__))


def common_notes(material: MaterialRows) -> list[str]:
    """Footnotes common to all tables of a material: on exact slices, a dominant slice, and rows left out."""
    return [*_exact(material), *_not_comparable(material)]


def run_notes(run: Run) -> list[str]:
    """Footnotes on the origin of the numbers, and on unreadable records."""
    notes = [_provenance(run.starts[-1]), *_older(run)] if run.starts else []
    if run.unreadable:
        lines = ", ".join(map(str, run.unreadable[:10])) + (", …" if len(run.unreadable) > 10 else "")
        notes.append(f"{len(run.unreadable)} line(s) of records.jsonl could not be read: {lines}.")
    return notes


def _metrics(material: MaterialRows) -> Iterator[str]:
    """Full names of the metrics of the columns, with unit, direction, space and version."""
    if material.metrics:
        parts = (_metric(name, each) for name, each in material.metrics.items())
        yield Note(*parts, around=("Metrics: ", "; ", "."))


def _metric(name: str, described: Record) -> Part:
    words = [word for word in (described["unit"], described.get("space")) if word and word != "1"]
    text = ", ".join([f"{name} version {described['version']}", *words, f"{described['direction']} is better"])
    derived = {"PSNR train", "train", "worst tenth", "PSNR pooled"} if name == PSNR else set()
    return text, {label_of(name), *derived}.__contains__


def _timing(material: MaterialRows) -> Iterator[str]:
    timed = [row for row in material.measured if row.timing and not row.timing_obstacle]
    if timed and (state := timed[0].timing):
        fetch = "texture fetch included" if state.get("texture_fetch") else "without the texture fetch"
        yield (
            f"Time a sample: median of a batch of {state.get('batch'):,}, {state.get('dtype')}, "
            f"{state.get('threads')} CPU thread(s), {state.get('device')}, {state.get('execution')}, {fetch}; "
            "floor: one bilinear fetch of a colour, timed before and after each codec in every turn."
        )
    yield from one_texel_notes(timed)
    if any(row.fused for row in material.measured):
        yield "Fused: the whole query as one kernel, by `neubtf-bench trade`, in multiples of the floor timed with it."
    apart = (row for row in material.measured if row.timing_obstacle)
    for reason, rows in grouped(apart, lambda row: row.timing_obstacle).items():
        yield f"{', '.join(row.name for row in rows)}: {reason}."


def one_texel_notes(rows: Iterable[Row]) -> Iterator[str]:
    """Gives the time of codecs that answer texels if one drawn texel, instead of four, answers a query."""
    by_label: dict[str, list[float]] = {}
    for row in rows:
        if row.timing and "ratio_at_one_texel" in row.timing:
            by_label.setdefault(row.label, []).append(row.timing["ratio_at_one_texel"])
    for label, ratios in by_label.items():
        yield f"{label} with stochastic filtering, one texel a query: {significant(fmean(ratios))} × floor."


def height_notes(materials: Sequence[MaterialRows]) -> Iterator[str]:
    """Says for which materials the timed files of a codec store a height; marching it takes most of their time."""
    found: dict[str, dict[bool, dict[str, None]]] = {}
    for material in materials:
        for row in material.measured:
            settings = row.job.get("settings", {})
            if settings.get("relief") and (row.timing or row.fused):
                holds = row.job["cost"]["texture_channels"] == settings["latents"] + 1  # the height is one more channel
                found.setdefault(row.label, {}).setdefault(holds, {})[material.name] = None
    words = {True: "a height on", False: "none on"}
    for label, by in found.items():
        held = "; ".join(f"{words[holds]} {', '.join(by[holds])}" for holds in (True, False) if holds in by)
        yield f"{label}: its file stores {held}; rays are marched through a height, which takes time."


def _programs(material: MaterialRows) -> Iterator[str]:
    """Footnotes on the time of codecs that are programs, which includes exchanging files."""
    for codec in material.codecs:
        if times := [row.job["program"]["ns_per_query"] for row in codec.measured if "program" in row.job]:
            yield (
                f"{codec.label}: its program took {fmean(times):,.0f} ns of wall time a query while it was scored, "
                "including the exchange of files: do not compare it with a column of times."
            )


def _exact(material: MaterialRows) -> Iterator[str]:
    for row in material.measured:
        stats = row.stats(row.gate, PSNR)
        if stats.get("exact"):
            counted = f"{stats['exact']:,} of {stats['slices']:,} slices"
            yield Note(about_quality(f"{row.name}: {counted} have no error in display space; they count as 100 dB."))


def _not_comparable(material: MaterialRows) -> Iterator[str]:
    for row in material.rows:
        if row.obstacle:
            yield f"n/c: {row.name} is not comparable with the other rows: {row.obstacle}."


def _older(run: Run) -> Iterator[str]:
    """Footnotes on rows that were fitted or scored by another revision than that of the latest start."""
    older: dict[tuple[str, str], list[str]] = {}
    for job in run.jobs:
        revisions = {step: (job.get(step) or {}).get("git") for step in ("fitted", "scored")}
        if job["status"] == "ok" and set(revisions.values()) - {run.starts[-1].get("git"), None}:
            older.setdefault((str(revisions["fitted"]), str(revisions["scored"])), []).append(job["job"])
    for (fitted, scored), jobs in older.items():
        listed = ", ".join(jobs[:5]) + (f" and {len(jobs) - 5} more" if len(jobs) > 5 else "")
        yield f"Fitted by revision {fitted}, scored by {scored}: {listed}."


def _provenance(start: Record) -> str:
    machine, packages = start.get("machine", {}), start.get("packages", {})
    parts = [f"Suite {start.get('suite', '?')}", f"run {start.get('run', '?')}"]
    parts += [f"revision {start['git']}"] if start.get("git") else []
    parts += [f"{name} {packages[name]}" for name in ("neubtf-bench", "torch", "numpy") if name in packages]
    parts += [f"{machine.get('processor', '?')}, {machine.get('cores', '?')} cores, device {start.get('device', '?')}"]
    return ", ".join(parts) + "."
