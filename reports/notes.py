"""Footnotes of tables: the meaning of the numbers, what has none or cannot be compared, the conditions of timings.

An *obstacle* is the reason, in words, why a row's numbers must not be compared with those of the others; such a row is
shown as `n/c`.

A `Note` knows which columns each of its parts is about, so that a table with fewer columns drops the parts that it does
not need. A plain text stays below every table.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import chain
from statistics import fmean

from bench.metrics import label_of
from bench.records import (
    MOST_DB,
    PSNR,
    Job,
    Machine,
    Run,
    RunStart,
    conditions_in_words,
    grouped,
    planned_jobs,
    shown_columns,
)
from reports.numbers import significant
from reports.rows import MaterialRows, Row
from reports.table import Note, Part

_LISTED = 5  # jobs that a note names
_LINES = 10  # numbers of unreadable lines that a note names
# Names of columns, as `reports.by_material` has them: those of bytes, of times, and all that do not show quality.
_BYTES = ("decoder", "texture", "other", "total", "shared", "resident", "bits per")
_TIMES = ("time", "95 % interval", "fused")
_COST = {*_BYTES, *_TIMES, "tex.", *(name for name, _, _ in shown_columns().values())}


def about_quality(text: str) -> Part:
    """A part of a note: a text, and the function that says of a column's name whether it shows quality."""
    return text, lambda name: name not in _COST


def about_times(text: str) -> Note:
    """A note about the columns of times, of one part."""
    return Note((text, _TIMES.__contains__))


def main_notes(material: MaterialRows) -> list[str]:
    """The footnotes of a main table, which shows quality and cost. Notes that both have stand once."""
    return list(dict.fromkeys([*quality_notes(material), *cost_notes(material)]))


def quality_notes(material: MaterialRows) -> list[str]:
    """Footnotes that define the quality columns; the material has a measured row."""
    job = material.measured[0].job
    if material.deciding_group != "heldout":
        pairs = "all pairs, none being held out"
    elif "split" in job:  # which held-out pairs they are: "test" or "validation"
        pairs = f"the {job['split']} pairs"
    else:
        pairs = "the held-out pairs"
    defined = Note(
        about_quality(f"Quality is measured at {pairs}"),
        (" (“train”: training pairs)", {"train", "PSNR train"}.__contains__),
        about_quality(", decoded from the file, as a mean over slices."),
        around=("", "", ""),
    )
    return [defined, *dark_notes([material]), *recipe_notes([material]), *_metrics(material), *common_notes(material)]


def recipe_notes(materials: Iterable[MaterialRows]) -> list[str]:
    """The note on what the label of a codec with recipes means, if there is one with its default."""
    settings = [row.job.get("settings", {}) for material in materials for row in material.measured]
    if any(of_job.get("recipe") == "ours" for of_job in settings):
        text = "Rows without recipe=paper are fitted by this suite's recipe, not by that of a paper."
        return [Note(about_quality(text))]
    return []


def cost_notes(material: MaterialRows) -> list[str]:
    """Footnotes that define the columns of size and time."""
    bytes_note = Note(
        ("Bytes are those of the whole file", _BYTES.__contains__),
        ("; “other” includes the header", {"other"}.__contains__),
        (". They may differ by a few between processors.", _BYTES.__contains__),
        around=("", "", ""),
    )
    time_texts = [*_timing(material), *height_notes([material]), *_programs(material)]
    return [bytes_note, *_shared_notes(material), *map(about_times, time_texts), *_not_comparable(material)]


def _shared_notes(material: MaterialRows) -> Iterator[Note]:
    """Notes on codecs whose files also need that of a network, which is not in the total: all materials share it."""
    with_shared = [row for row in material.measured if "shared" in row.job["bytes"]]
    for size, rows in grouped(with_shared, lambda row: row.job["bytes"]["shared"]).items():
        names = ", ".join(dict.fromkeys(row.label for row in rows))
        needs = f"the decoder also needs the shared network, {size:,} bytes for all materials, not in the total."
        yield Note((f"{names}: {needs}", _BYTES.__contains__))


def common_notes(material: MaterialRows) -> list[str]:
    """Footnotes of each table that shows the quality of a material: on exact slices, which have no error, so that their
    PSNR would be infinite, and on rows that cannot be compared."""
    exact_notes: list[str] = []
    for row in material.measured:
        stats = row.stats(row.deciding_group, PSNR)
        exact = stats.get("exact")  # the number of slices without error
        if exact:
            counted = f"{exact:,} of {stats['slices']:,} slices"
            text = f"{row.name}: {counted} have no error in display space; they count as {MOST_DB} dB."
            exact_notes.append(Note(about_quality(text)))
    return [*exact_notes, *_not_comparable(material)]


SCENE_LAST = (
    "Models of a scene stand last and are not ranked: they answer for their scene alone. Their quality is in the table "
    "of scores in the scene."
)


def dark_notes(measured: Iterable[MaterialRows]) -> list[str]:
    """A note on each material that is exposed so badly that black scores well; its decibels say little.

    Each material has a measured row.
    """
    notes: list[str] = []
    for material in measured:
        job = material.measured[0].job
        if "black" in job:
            score = f"an all-black answer scores {job['black']:.1f} dB"
            notes.append(Note(about_quality(f"On {material.name} {score}: nearly all slices are dark.")))
    return notes


def scene_notes(materials: Iterable[MaterialRows]) -> list[str]:
    """The note on why models of a scene stand last, if there are any: codecs fitted to what a scene asks for."""
    return [SCENE_LAST] if any(codec.of_scene for material in materials for codec in material.codecs) else []


def run_notes(run: Run) -> list[str]:
    """Footnotes on the origin of the numbers, and on unreadable lines of the file of records."""
    # The latest start stands for all; rows of older revisions are named apart.
    notes = [_provenance(run.starts[-1]), *_older(run)] if run.starts else []
    if run.unreadable:
        lines = ", ".join(map(str, run.unreadable[:_LINES]))
        if len(run.unreadable) > _LINES:
            lines += ", …"
        notes.append(f"{len(run.unreadable)} line(s) of the records could not be read: {lines}.")
    return notes


def _metrics(material: MaterialRows) -> Iterator[Note]:
    """One note, if there are metrics: the full name of each, its version, unit, space and better end.

    It has a part for each metric, about the columns that show it.
    """
    parts: list[Part] = []
    for name, facts in material.metrics.items():
        words = [f"{name} version {facts.get('version', '?')}"]
        if facts["unit"] and facts["unit"] != "1":  # "1": it has no unit
            words.append(facts["unit"])
        space = facts.get("space")  # in which errors are measured, such as `display`
        if space and space != "1":  # "1": in none
            words.append(space)
        words.append(f"{facts['direction']} is better")
        columns = {label_of(name)}
        if name == PSNR:  # several columns show it under other names, and need its definition as well
            columns |= {"PSNR train", "train", "worst tenth", "PSNR pooled"}
        is_about = columns.__contains__  # of the name of a column
        parts.append((", ".join(words), is_about))
    if parts:
        yield Note(*parts, around=("Metrics: ", "; ", "."))


def _timing(material: MaterialRows) -> Iterator[str]:
    """Footnotes on times: their conditions, one texel a query, fused queries, and rows that were timed otherwise.

    A `timing_obstacle` is the reason why a row's time cannot be compared with the others'.
    """
    timed_rows = [row for row in material.measured if row.timing and not row.timing_obstacle]
    timing = timed_rows[0].timing if timed_rows else None  # all of them have the same conditions
    if timing:
        yield (
            f"Time a sample: median; {conditions_in_words(timing)}, texture fetch included; floor: one bilinear fetch "
            "of a colour, timed before and after each codec in every turn."
        )
    yield from one_texel_notes(timed_rows)
    if any(row.fused for row in material.measured):
        yield "Fused: the whole query as one kernel, in multiples of the floor timed with it (`neubtf-bench trade`)."
    apart = (row for row in material.measured if row.timing_obstacle)
    for reason, rows in grouped(apart, lambda row: row.timing_obstacle).items():
        yield f"{', '.join(row.name for row in rows)}: {reason}."


def one_texel_notes(rows: Iterable[Row]) -> Iterator[str]:
    """Notes on the time of codecs that answer at texels, if one texel, drawn at random, answers a query.

    A query between texels is else a bilinear mean of the four around it.
    """
    by_label: dict[str, list[float]] = {}  # times, × floor, one for each seed and material
    for row in rows:
        if row.timing and "ratio_at_one_texel" in row.timing:
            by_label.setdefault(row.label, []).append(row.timing["ratio_at_one_texel"])
    for label, ratios in by_label.items():
        yield f"{label} with stochastic filtering, one texel a query: {significant(fmean(ratios))} × floor."


def height_notes(materials: Iterable[MaterialRows]) -> Iterator[str]:
    """Notes on the materials for which timed files of a codec store a height; marching it takes most of their time.

    Only the codec `relief` does; with its setting `relief` a fit stores a height for each texel only where it pays.
    """
    timed = [row for material in materials for row in material.measured if row.timing or row.fused]
    with_relief = [row for row in timed if row.job["codec"] == "relief" and row.job.get("settings", {}).get("relief")]
    for label, rows in grouped(with_relief, lambda row: row.label).items():
        stored = []
        for height, of_height in sorted(grouped(rows, _height_in_words).items()):
            stored.append(f"{height} on {', '.join(dict.fromkeys(row.job['material'] for row in of_height))}")
        yield f"{label}: its file stores {'; '.join(stored)}; rays are marched through a height, which takes time."


def _height_in_words(row: Row) -> str:
    """Whether a file of `relief` stores a height: its texture has a channel for each latent number, then the height."""
    has_height = row.job["cost"]["texture_channels"] == int(row.job["settings"]["latents"]) + 1
    return "a height" if has_height else "no height"


def _programs(material: MaterialRows) -> Iterator[str]:
    """Footnotes on the time of codecs that are external programs: it includes exchanging files with them."""
    for codec in material.codecs:
        times = [row.job["program"]["ns_per_query"] for row in codec.measured if "program" in row.job]
        if times:
            yield (
                f"{codec.label}: its program took {fmean(times):,.0f} ns of wall time a query while it was scored, "
                "including the exchange of files: do not compare it with a column of times."
            )


def _not_comparable(material: MaterialRows) -> Iterator[str]:
    """A footnote on each row that is not comparable, with the reason."""
    for row in material.rows:
        if row.obstacle:
            yield f"n/c: {row.name} is not comparable with the other rows: {row.obstacle}."


def _older(run: Run) -> Iterator[str]:
    """Footnotes on rows that were fitted or scored by another revision of the code than that of the latest start;
    “?” for one that the record does not say."""
    latest = run.starts[-1].get("git")
    finished = [job for job in run.jobs if job["status"] == "ok"]  # a failed job has no numbers to explain
    for revisions, jobs in grouped(finished, _revisions).items():
        if {*revisions} - {latest, None}:  # None: the record does not say
            listed = ", ".join(job["job"] for job in jobs[:_LISTED])
            if len(jobs) > _LISTED:
                listed += f" and {len(jobs) - _LISTED} more"
            fitted, scored = (revision or "?" for revision in revisions)
            yield f"Fitted by revision {fitted}, scored by {scored}: {listed}."


def _revisions(job: Job) -> tuple[str | None, str | None]:
    """The revisions of the code that fitted a job and that scored it."""
    return job.get("fitted", {}).get("git"), job.get("scored", {}).get("git")


def _provenance(start: RunStart) -> str:
    """Where the numbers of a start come from, in a sentence: suite, versions and machine; “?” for what it does not
    say."""
    machine = start.get("machine", Machine())
    packages = start.get("packages", {})
    parts = [f"Suite {start.get('suite', '?')}", f"run {start.get('run', '?')}"]
    if start.get("git"):
        parts.append(f"revision {start['git']}")
    for name in ("neubtf-bench", "torch", "numpy"):
        if name in packages:
            parts.append(f"{name} {packages[name]}")
    parts += [
        str(machine.get("processor", "?")),
        f"{machine.get('cores', '?')} cores",
        f"device {start.get('device', '?')}",
    ]
    return ", ".join(parts) + "."


def not_run(run: Run) -> Iterator[tuple[str, str, list[int]]]:
    """Material, label in tables, and seeds of the planned jobs of a run that have no record.

    A start lists the jobs that it plans before it fits any: those of a run that was broken off have no record.
    """
    seeds_of: dict[tuple[str, str], list[int]] = {}  # by material and label in tables
    planned = dict.fromkeys(job for start in run.starts for job in planned_jobs(start))  # each once
    for job in planned:
        if run.job(job.name) is None and job.seed is not None:
            seeds_of.setdefault((job.material, job.label), []).append(job.seed)
    for (material, label), seeds in seeds_of.items():
        yield material, label, seeds


def missing_note(run: Run) -> str:
    """Sentences on the codecs and materials without any result, and those that lack some seeds; "" if none do.

    A *cell* is a material and a label.
    """
    done = {(job["material"], job["label"]) for job in run.jobs if job["status"] == "ok"}
    lacking = [(job["material"], job["label"]) for job in run.jobs if job["status"] != "ok"]
    lacking += [(material, label) for material, label, _ in not_run(run)]
    without_result = [cell for cell in lacking if cell not in done]
    with_fewer_seeds = [cell for cell in lacking if cell in done]
    sentences = []
    if without_result:
        sentences.append(f"No result: {_by_codec(without_result)}.")
    if with_fewer_seeds:
        sentences.append(f"Fewer seeds: {_by_codec(with_fewer_seeds)}.")
    return " ".join(sentences)


def lacking_notes(measured: Sequence[MaterialRows]) -> list[str]:
    """A list of one note on the codecs without means, with the materials that each lacks; empty without such codecs."""
    labels_on: dict[str, list[str]] = {}  # by name of a material: the labels of models of the whole material
    for material in measured:
        labels_on[material.name] = [codec.label for codec in material.codecs if codec.measured and not codec.of_scene]
    labels = dict.fromkeys(chain.from_iterable(labels_on.values()))
    by_lack = grouped(labels, lambda label: tuple(name for name, present in labels_on.items() if label not in present))
    words = [f"{', '.join(alike)} (not on {', '.join(lacks)})" for lacks, alike in by_lack.items() if lacks]
    if not words:
        return []
    return [f"Without means, which would be over fewer materials: {'; '.join(words)}. --material NAME chooses."]


def standard_in_words(run: Run) -> str:
    """The jobs with which the others of a run must agree to be comparable."""
    return "the published ones" if run.published else "the newest"


def left_out_notes(run: Run, materials: Iterable[MaterialRows]) -> Iterator[str]:
    """Notes on codecs and materials whose numbers, or times, cannot be compared, and why.

    Rows are comparable if they agree with the newest jobs or, if there are any, with the published ones. An *obstacle*
    is the reason why a row does not: why none of its numbers can be compared, or only not its time. A time of another
    start of the run is shown all the same, with a star. A row whose numbers are left out is not named for its time,
    too.
    """
    rows = [row for material in materials for row in material.rows]
    left_out = [row for row in rows if row.obstacle]
    with_star = [row for row in rows if not row.obstacle and row.timed_apart]
    without_time = [row for row in rows if not row.obstacle and row.time_left_out]
    beginning = f"Left out, as not comparable with {standard_in_words(run)}"
    yield from _reasons_note(beginning, grouped(left_out, lambda row: row.obstacle))
    for beginning, timed in (("Times left out", without_time), ("Times with a star", with_star)):
        yield from map(about_times, _reasons_note(beginning, grouped(timed, lambda row: row.timing_obstacle)))


def _reasons_note(beginning: str, rows_by_reason: Mapping[str, list[Row]]) -> Iterator[str]:
    """A note on rows by the reason why something of them is left out; none without rows."""
    words = []
    for why, rows in rows_by_reason.items():
        words.append(f"{_by_codec((row.job['material'], row.label) for row in rows)} ({why})")
    if words:
        yield f"{beginning}: {'; '.join(words)}."


def _by_codec(cells: Iterable[tuple[str, str]]) -> str:
    """Cells, each a material and a label, in words: `neubtf, neumip on brick; vq on satin`.

    Codecs with the same materials stand together.
    """
    cells_of_label = grouped(dict.fromkeys(cells), lambda cell: cell[1])
    materials_of = {label: sorted(material for material, _ in of_label) for label, of_label in cells_of_label.items()}
    labels_by_materials = grouped(materials_of, lambda label: tuple(materials_of[label]))
    parts = [f"{', '.join(labels)} on {', '.join(names)}" for names, labels in labels_by_materials.items()]
    return "; ".join(parts)
