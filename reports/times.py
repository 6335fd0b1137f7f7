"""The times of settings, apart from any surface: what `neubtf-bench time` measured.

A *setting* is a codec with its settings, `pca components=8`, which is its *label*; a *surface* is a material. A
*sample* is one query of a decoder: a place, a view and a light direction, a footprint. A *batch* is the number of
samples of one call. A *variant* is an execution ("eager", "fused") with a precision ("float32"). The *floor* is the
time of one bilinear fetch of a colour. Settings are timed in turns with it, in *rounds*; `rounds` has the time as a
multiple of the floor for each round on each surface. The *limit* is the time of the arithmetic, or of the reads, at the
machine's measured rates.
"""

from collections.abc import Iterator
from dataclasses import replace

from bench.compare.choosing import usual_batch
from bench.records import Machine, Run, Timing, conditions_in_words, timed_on
from reports.numbers import NONE, significant
from reports.table import Table

_NOTE = (
    "Each setting in turns with the floor, one bilinear fetch of a colour, pooled over surfaces and rounds. Quality is "
    "of texels: where a query between texels takes longer, × floor is that at a texel. A setting has two rows where "
    "some surfaces need more of it, such as a height."
)


def times_tables(run: Run) -> Iterator[Table]:
    """Up to four tables: times of settings as budgets use them, and those of `variant_tables`. Each only if it has a
    row."""
    # Only the times that budgets use are pooled over rounds.
    yield from _settings(run, [timing for timing in run.timings if "rounds" in timing])
    yield from variant_tables(run, "times")


def variant_tables(run: Run, kind: str) -> Iterator[Table]:
    """Up to three tables, as tables of a kind ("times" or "trade"): settings in each execution and precision, settings
    over batches, and steps of fits."""
    # Only timings of settings in each execution and precision are compared with float64.
    variants = [timing for timing in run.timings if "of_tolerance" in timing]
    steps = [timing for timing in run.timings if timing["execution"] == "fit step"]
    for table in (*_variants(run, variants), *_batches(variants), *_fits(run, steps)):
        yield replace(table, kind=kind)


def _settings(run: Run, timings: list[Timing]) -> Iterator[Table]:
    """A table with a row a setting, the quickest first; none without timings. Sorts `timings` in place."""
    if not timings:
        return
    timings.sort(key=lambda timing: float(timing["ratio_to_floor"]))
    rows = [_row(timing) for timing in timings]
    # Below these stand the cells of `_row`.
    headers = [("setting", ""), ("a query", "× floor ↓"), ("rounds", "× floor")]
    headers += [("between texels", "× floor ↓"), ("a sample", "ns ↓"), ("operations", "a query")]
    yield Table("times", f"Times of settings: {_conditions(run, timings[0])}", headers, rows, [_NOTE])


def _row(timing: Timing) -> list[str]:
    """The cells of a setting, in the order of the headers of `_settings`: the median, and the quickest and the slowest
    round."""
    rounds = timing["rounds"]
    between_texels = timing.get("ratio_between_texels")
    return [
        timing["label"],
        significant(timing["ratio_to_floor"], 3),
        f"{significant(min(rounds), 3)} to {significant(max(rounds), 3)}",
        significant(between_texels, 3) if between_texels else NONE,  # only of settings that are timed at texels
        significant(timing["ns_per_sample"], 3),
        f"{timing['flops']:,}",
    ]


def _variants(run: Run, timings: list[Timing]) -> Iterator[Table]:
    """A table with a row a setting, a column an execution and precision; no table if there are no timings.

    See `_time_and_limit` for its cells.
    """
    if not timings:
        return
    usual = usual_batch(timings)
    timings = [timing for timing in timings if timing["batch"] == usual]  # other batches: see `_batches`
    variants = list(dict.fromkeys(_variant(timing) for timing in timings))
    timings_of_label: dict[str, dict[str, Timing]] = {}  # by label, then by variant
    for timing in timings:
        timings_of_label.setdefault(timing["label"], {})[_variant(timing)] = timing
    rows = []
    for label, timing_of_variant in timings_of_label.items():
        cells = [_setting(label)]
        for variant in variants:
            timing_or_none = timing_of_variant.get(variant)
            cells.append(_time_and_limit(timing_or_none) if timing_or_none else NONE)
        rows.append(cells)
    headers = [("setting", ""), *((variant, "ns, % of limit") for variant in variants)]
    shared_by_all = _conditions(run, timings[0], variant="each variant")
    note = (
        "ns a sample, and the time that arithmetic or reads take at the machine's measured rates, as a share of it. "
        "!: answers differ from float64's by more than the precision allows (docs/trade.md)."
    )
    yield Table("times", f"Executions and precisions: {shared_by_all}", headers, rows, [note])


def _setting(label: str) -> str:
    """The label of a setting without the steps of its fit, which change no time."""
    return " ".join(word for word in label.split() if not word.startswith("steps="))


def _variant(timing: Timing) -> str:
    """The execution and precision, as “fused float32”."""
    return f"{timing['execution']} {timing['dtype']}"


def _time_and_limit(timing: Timing) -> str:
    """A cell: ns a sample, and how many per cent of this time the machine's limit is; “!” after the time if the answers
    are off: “12.3!, 45”."""
    percent = 100 * timing["limit_ns"] / timing["ns_per_sample"]
    mark = "!" if timing["of_tolerance"] > 1 else ""  # the largest difference from float64, over what is allowed
    return f"{significant(timing['ns_per_sample'], 3)}{mark}, {significant(percent, 2)}"


def _batches(timings: list[Timing]) -> Iterator[Table]:
    """A table with a row a setting and execution in float32, a column a batch: ns a sample. It has only what was timed
    at several batches; none if nothing was."""
    in_float32 = [timing for timing in timings if timing["dtype"] == "float32"]
    batches = sorted({timing["batch"] for timing in in_float32})
    ns_of_row: dict[tuple[str, str], dict[int, float]] = {}  # by label and execution, then by batch
    for timing in in_float32:
        ns_of_row.setdefault((timing["label"], timing["execution"]), {})[timing["batch"]] = timing["ns_per_sample"]
    rows = []
    for (label, execution), ns_of_batch in ns_of_row.items():
        if len(ns_of_batch) > 1:  # a single batch is in the table of `_variants`
            numbers = [significant(ns_of_batch.get(batch), 3) for batch in batches]
            rows.append([_setting(label), execution, *numbers])
    if not rows:
        return
    headers = [("setting", ""), ("execution", ""), *((f"{batch:,}", "ns ↓") for batch in batches)]
    yield Table("times", "Batches: ns a sample in float32, by the samples of a query", headers, rows, [], words=2)


def _fits(run: Run, timings: list[Timing]) -> Iterator[Table]:
    """A table with a row a setting: milliseconds of a step of its fit, the quickest first; none without timings. Sorts
    `timings` in place."""
    if not timings:
        return
    timings.sort(key=lambda timing: float(timing["ns_per_sample"]))
    rows = []
    for timing in timings:
        milliseconds = timing["ns_per_sample"] / 1e6  # here a "sample" is one step
        rows.append([timing["label"], significant(milliseconds, 3)])
    place = timed_on(timings[0], _processor(run, timings[0]))
    yield Table("times", f"Steps of fits: {place}", [("setting", ""), ("a step", "ms ↓")], rows, [])


def _conditions(run: Run, timing: Timing, variant: str = "") -> str:
    """The conditions of a timing in words; `variant` stands in the place of its execution and precision, if given."""
    return conditions_in_words(timing, _processor(run, timing), variant)


def _processor(run: Run, timing: Timing) -> str:
    """The name of the processor of a timing, which the start of its run has; empty if it is not known."""
    starts = [start for start in run.starts if start.get("run", "") == timing["run"]]
    machine = starts[0].get("machine", Machine()) if starts else Machine()
    return str(machine.get("processor") or "")
