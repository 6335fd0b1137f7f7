"""The times of settings, apart from any surface: what `neubtf-bench time` measured."""

from collections.abc import Iterator
from dataclasses import replace

from bench.compare.choosing import usual_batch
from bench.records import Machine, Run, Timing
from reports.numbers import NONE, significant
from reports.table import Table

_NOTE = (
    "Each setting in turns with the floor, one bilinear fetch of a colour, pooled over surfaces and rounds. Quality is "
    "of texels: where a query between texels takes longer, × floor is that at a texel. A setting has two rows where "
    "some surfaces need more of it, such as a height."
)


def times_tables(run: Run) -> Iterator[Table]:
    """Times of settings: as budgets use them, in each execution and precision, over batches, and of steps of fits."""
    yield from _settings(run, [timing for timing in run.timings if "rounds" in timing])
    yield from variant_tables(run, "times")


def variant_tables(run: Run, kind: str) -> Iterator[Table]:
    """Tables of a kind: times of settings in each execution and precision, over batches, and of steps of fits."""
    variants = [timing for timing in run.timings if "of_tolerance" in timing]
    steps = [timing for timing in run.timings if timing["execution"] == "fit step"]
    for table in (*_variants(run, variants), *_batches(run, variants), *_fits(run, steps)):
        yield replace(table, kind=kind)


def _settings(run: Run, timed: list[Timing]) -> Iterator[Table]:
    """A row a setting, the quickest first."""
    if not timed:
        return
    timed.sort(key=lambda timing: float(timing["ratio_to_floor"]))
    rows = [_row(timing) for timing in timed]
    headers = [("setting", ""), ("a query", "× floor ↓"), ("95 % interval", "× floor"), ("rounds apart", "%")]
    headers += [("between texels", "× floor ↓"), ("a sample", "ns ↓"), ("operations", "a query")]
    yield Table("times", f"Times of settings: {_conditions(run, timed[0])}", headers, rows, [_NOTE])


def _row(timing: Timing) -> list[str]:
    """The cells of a setting. “Rounds apart” is by how many per cent the slowest round takes longer than the
    quickest."""
    low, high = timing["ratio_interval95"]
    rounds = timing["rounds"]
    apart = 100 * (max(rounds) / min(rounds) - 1)
    between = timing.get("ratio_between_texels")
    cells = [timing["label"], significant(timing["ratio_to_floor"], 3)]
    cells += [f"{significant(low, 3)} to {significant(high, 3)}", significant(apart, 2)]
    cells += [significant(between, 3) if between else NONE, significant(timing["ns_per_sample"], 3)]
    return [*cells, f"{timing['flops']:,}"]


def _variants(run: Run, timed: list[Timing]) -> Iterator[Table]:
    """A row a setting, a column an execution and precision: ns a sample, and the machine's limit as a share of it."""
    if not timed:
        return
    usual = usual_batch(timed)
    timed = [timing for timing in timed if timing["batch"] == usual]  # others: see `_batches`
    names = list(dict.fromkeys(_variant(timing) for timing in timed))
    by_label: dict[str, dict[str, Timing]] = {}
    for timing in timed:
        by_label.setdefault(timing["label"], {})[_variant(timing)] = timing
    rows = []
    for label, known in by_label.items():
        cells = [_setting(label)]
        for name in names:
            cells.append(_share(known[name]) if name in known else NONE)
        rows.append(cells)
    headers = [("setting", ""), *((name, "ns, % of limit") for name in names)]
    place = _conditions(run, {**timed[0], "execution": "each", "dtype": "variant"})
    note = (
        "ns a sample, and the time that arithmetic or reads take at the machine's measured rates, as a share of it. "
        "!: answers differ from float64's by more than the precision allows (docs/trade.md)."
    )
    yield Table("times", f"Executions and precisions: {place}", headers, rows, [note])


def _setting(label: str) -> str:
    """The label of a setting without the steps of its fit, which change no time."""
    return " ".join(word for word in label.split() if not word.startswith("steps="))


def _variant(timing: Timing) -> str:
    return f"{timing['execution']} {timing['dtype']}"


def _share(timing: Timing) -> str:
    """A cell: ns a sample, “!” if its answers are off, and how many per cent of this time the machine's limit is."""
    share = 100 * timing["limit_ns"] / timing["ns_per_sample"]
    wrong = "!" if timing["of_tolerance"] > 1 else ""
    return f"{significant(timing['ns_per_sample'], 3)}{wrong}, {significant(share, 2)}"


def _batches(run: Run, timed: list[Timing]) -> Iterator[Table]:
    """A row a setting and execution in float32, a column a batch: ns a sample."""
    timed = [timing for timing in timed if timing["dtype"] == "float32"]
    batches = sorted({timing["batch"] for timing in timed})
    by_row: dict[tuple[str, str], dict[int, Timing]] = {}
    for timing in timed:
        by_row.setdefault((timing["label"], timing["execution"]), {})[timing["batch"]] = timing
    swept = {row: known for row, known in by_row.items() if len(known) > 1}  # timed at several batches
    if not swept:
        return
    rows = []
    for (label, execution), known in swept.items():
        cells = [_setting(label), execution]
        for batch in batches:
            cells.append(significant(known[batch]["ns_per_sample"], 3) if batch in known else NONE)
        rows.append(cells)
    headers = [("setting", ""), ("execution", ""), *((f"{batch:,}", "ns ↓") for batch in batches)]
    yield Table("times", "Batches: ns a sample in float32, by the samples of a query", headers, rows, [], words=2)


def _fits(run: Run, timed: list[Timing]) -> Iterator[Table]:
    """A row a codec: milliseconds of a step of its fit, the quickest first."""
    if not timed:
        return
    timed.sort(key=lambda timing: float(timing["ns_per_sample"]))
    rows = [[timing["label"], significant(timing["ns_per_sample"] / 1e6, 3)] for timing in timed]
    place = _conditions(run, timed[0]).partition(", fit step")[0]
    yield Table("times", f"Steps of fits: {place}", [("setting", ""), ("a step", "ms ↓")], rows, [])


def _conditions(run: Run, timing: Timing) -> str:
    """Where and how a timing was measured, in words."""
    starts = [start for start in run.starts if start["run"] == timing["run"]]
    machine = starts[0].get("machine", Machine()) if starts else Machine()
    place = timing.get("gpu") or machine.get("processor") or timing["device"]
    threads = "" if timing.get("gpu") else f", {timing['threads']} thread{'s' * (timing['threads'] > 1)}"
    return f"{place}{threads}, {timing['execution']} {timing['dtype']}, batches of {timing['batch']:,}"
