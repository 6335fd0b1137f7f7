"""The times of settings, apart from any surface: what `neubtf-bench time` measured.

A *setting* is a codec with its settings, named by its label. A *sample* is one query of a decoder. A *batch* is the
number of samples of one call. A *variant* is an execution ("eager", "fused") with a precision ("float32"). Settings are
timed in turns with the floor, in *rounds*; `rounds` has the time as a multiple of it for each round on each surface.
The *limit* is the time of the arithmetic, or of the reads, at the machine's measured rates.
"""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from itertools import chain
from math import isnan, nan
from operator import itemgetter
from typing import Any

import pandas as pd

from bench.records import Run, Timing, conditions_in_words, grouped, timed_on, usual_batch, variant_of
from reports.numbers import NONE, significant
from reports.table import Table
from reports.values import Column, Row, written

_NOTE = (
    "Each setting in turns with the floor, one bilinear fetch of a colour, pooled over surfaces and rounds. Quality is "
    "of texels: where a query between texels takes longer, × floor is that at a texel. A setting has two rows where "
    "some surfaces need more of it, such as a height."
)


def times_tables(run: Run) -> Iterator[Table]:
    """Times of settings as budgets use them, and the tables of `variant_tables`. Each only if it has a row."""
    for conditions, timings in grouped(run.setting_timings, partial(_conditions, run)).items():
        yield _settings_table(conditions, timings)
    yield from variant_tables(run, "times")


def variant_tables(run: Run, kind: str) -> Iterator[Table]:
    """Up to four tables a device, as tables of a kind ("times" or "trade"): settings in each execution and precision,
    what these take of a GPU besides time, settings over batches, and steps of fits."""
    # Only timings of settings in each execution and precision are compared with float64.
    variants = [timing for timing in run.timings if "of_tolerance" in timing]
    steps = [timing for timing in run.timings if timing.get("execution") == "fit step"]
    tables: list[Table] = []
    for of_device in grouped(variants, _device_of).values():
        tables += chain(_variants_table(run, of_device), _gpu_table(of_device), _batches_table(of_device))
    for of_device in grouped(steps, _device_of).values():
        tables += _steps_table(run, of_device)
    for table in tables:
        yield replace(table, kind=kind)


def _device_of(timing: Timing) -> tuple[str, str]:
    """The device of a timing and, of a GPU, its name."""
    return timing["device"], timing.get("gpu", "")


def _settings_table(conditions: str, timings: list[Timing]) -> Table:
    """A table with a row a setting that was timed under these conditions, in words; the quickest first."""
    quickest_first = sorted(timings, key=lambda timing: float(timing["ratio_to_floor"]))
    columns = [
        Column("setting", "", "label"),
        Column("a query", "× floor ↓", "ratio_to_floor", -3, ranked=False),
        Column("rounds", "× floor", "least", -3, beside="most", pair=" to {}"),
        Column("between texels", "× floor ↓", "ratio_between_texels", -3, ranked=False),
        Column("a sample", "ns ↓", "ns_per_sample", -3, ranked=False),
        Column("operations", "a query", "flops", 0),
    ]
    values = pd.DataFrame([_values_of_setting(timing) for timing in quickest_first])
    return written("times", f"Times of settings: {conditions}", values, columns, [_NOTE])


def _values_of_setting(timing: Timing) -> dict[str, Any]:
    """The values of a setting: medians, and the quickest and the slowest round."""
    names = ("label", "ratio_to_floor", "ns_per_sample", "flops")
    row: dict[str, Any] = {name: timing.get(name) for name in names}
    row["ratio_between_texels"] = timing.get("ratio_between_texels", nan)  # only of settings that are timed at texels
    return row | {"least": min(timing["rounds"]), "most": max(timing["rounds"])}


def _variants_table(run: Run, timings: list[Timing]) -> Iterator[Table]:
    """A table with a row a setting, a column an execution and precision; no table if there are no timings.

    See `_time_and_limit` for its cells.
    """
    if not timings:
        return
    usual = usual_batch(timings)
    in_usual_batch = [timing for timing in timings if timing["batch"] == usual]  # others: see `_batches_table`
    variants = list(dict.fromkeys(map(variant_of, in_usual_batch)))
    rows = []
    for label, of_label in grouped(in_usual_batch, itemgetter("label")).items():
        timing_of_variant = {variant_of(timing): timing for timing in of_label}
        row: dict[str, Any] = {"setting": _without_steps(label)}
        for variant in variants:
            timing = timing_of_variant.get(variant, Timing())
            row[variant] = timing.get("ns_per_sample", nan)
            row[f"{variant} limit"] = timing.get("limit_ns", nan)
            row[f"{variant} off"] = timing.get("of_tolerance", 0.0) > 1  # of what is allowed from float64
        rows.append(row)
    columns = [Column("setting", "", "setting")]
    for variant in variants:
        columns.append(Column(variant, "ns, % of limit", variant, write=partial(_time_and_limit, variant)))
    shared_by_all = _conditions(run, in_usual_batch[0], variant="each variant")
    note = (
        "ns a sample, and the time that arithmetic or reads take at the machine's measured rates, as a share of it. "
        "!: answers differ from float64's by more than the precision allows (docs/trade.md)."
    )
    title = f"Executions and precisions: {shared_by_all}"
    yield written("times", title, pd.DataFrame(rows), columns, [note])


def _gpu_table(timings: list[Timing]) -> Iterator[Table]:
    """A table of bytes read, memory and energy, with a row a setting, execution and precision; none without a GPU."""
    if not timings:
        return
    usual = usual_batch(timings)
    on_gpu = [timing for timing in timings if "read_bytes" in timing and timing["batch"] == usual]
    if not on_gpu:
        return
    rows = []
    for timing in on_gpu:
        ns = timing["ns_per_sample"]
        row: dict[str, Any] = {"setting": _without_steps(timing["label"]), "variant": variant_of(timing)}
        row["rate"] = timing["read_bytes"] / ns  # bytes a ns are gigabytes a second
        row["memory"] = timing.get("memory", nan) / 2**20
        row["energy"] = timing.get("watts", nan) * ns  # a watt for a ns is a nanojoule
        rows.append(row)
    columns = [
        Column("setting", "", "setting"),
        Column("variant", "", "variant"),
        Column("read", "GB/s", "rate", -3, ranked=False),
        Column("memory", "MiB ↓", "memory", -3, ranked=False),
        Column("energy", "nJ a sample ↓", "energy", -3, ranked=False),
    ]
    note = (
        "Read: what a sample must read, over its time. Memory: at most, of PyTorch's tensors. Energy: of the whole GPU."
    )
    yield written("times", "Of the GPU besides time", pd.DataFrame(rows), columns, [note], words=2)


def _without_steps(label: str) -> str:
    """The label of a setting without the steps of its fit, which change no time."""
    return " ".join(word for word in label.split() if not word.startswith("steps="))


def _time_and_limit(variant: str, row: Row) -> str:
    """The ns of a sample in a variant, and how many per cent of this time the machine's limit is; “!” after the time if
    the answers are off: “12.3!, 45”. A dash without a time."""
    if isnan(row[variant]):
        return NONE
    percent = 100 * row[f"{variant} limit"] / row[variant]
    mark = "!" if row[f"{variant} off"] else ""
    return f"{significant(row[variant])}{mark}, {significant(percent, 2)}"


def _batches_table(timings: list[Timing]) -> Iterator[Table]:
    """A table with a row a setting and execution in float32, a column a batch: ns a sample. It has only what was timed
    at several batches; none if nothing was."""
    in_float32 = [timing for timing in timings if timing["dtype"] == "float32"]
    batches: set[int] = set()  # of the rows that are shown
    rows = []
    for (label, execution), of_row in grouped(in_float32, itemgetter("label", "execution")).items():
        ns_of_batch = {f"{timing['batch']:,}": timing["ns_per_sample"] for timing in of_row}
        if len(ns_of_batch) > 1:  # a single batch is in the table of `_variants_table`
            rows.append({"setting": _without_steps(label), "execution": execution, **ns_of_batch})
            batches.update(timing["batch"] for timing in of_row)
    if not rows:
        return
    columns = [Column("setting", "", "setting"), Column("execution", "", "execution")]
    columns += [Column(f"{batch:,}", "ns ↓", f"{batch:,}", -3, ranked=False) for batch in sorted(batches)]
    title = "Batches: ns a sample in float32, by the samples of a call"
    yield written("times", title, pd.DataFrame(rows), columns, [], words=2)


def _steps_table(run: Run, timings: list[Timing]) -> Iterator[Table]:
    """A table with a row a setting: milliseconds of a step of its fit, the quickest first; none without timings."""
    if not timings:
        return
    quickest_first = sorted(timings, key=lambda timing: float(timing["ns_per_sample"]))
    # Here a "sample" is one step.
    rows = [{"setting": timing["label"], "milliseconds": timing["ns_per_sample"] / 1e6} for timing in quickest_first]
    columns = [Column("setting", "", "setting"), Column("a step", "ms ↓", "milliseconds", -3, ranked=False)]
    place = timed_on(quickest_first[0], _processor(run, quickest_first[0]))
    yield written("times", f"Steps of fits: {place}", pd.DataFrame(rows), columns, [])


def _conditions(run: Run, timing: Timing, variant: str = "") -> str:
    """The conditions of a timing in words; `variant` stands in the place of its execution and precision, if given."""
    return conditions_in_words(timing, _processor(run, timing), variant)


def _processor(run: Run, timing: Timing) -> str:
    """The name of the processor of a timing; empty if it is not known."""
    return str(run.machine(timing).get("processor") or "")
