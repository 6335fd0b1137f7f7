"""The times of settings, apart from any surface: what `neubtf-bench time` measured."""

from collections.abc import Iterator

from bench.records import Record, Run
from reports.numbers import NONE, significant
from reports.table import Table

_NOTE = (
    "Each setting in turns with the floor, one bilinear fetch of a colour, pooled over surfaces and rounds. Quality is "
    "of texels: where a query between texels takes longer, × floor is that at a texel. A setting has two rows where "
    "some surfaces need more of it, such as a height."
)


def times_tables(run: Run) -> Iterator[Table]:
    """A row a setting, the quickest first."""
    timed = [timing for timing in run.timings if "label" in timing]
    if not timed:
        return
    timed.sort(key=lambda timing: float(timing["ratio_to_floor"]))
    rows = [_row(timing) for timing in timed]
    headers = [("setting", ""), ("a query", "× floor ↓"), ("95 % interval", "× floor"), ("rounds apart", "%")]
    headers += [("between texels", "× floor ↓"), ("a sample", "ns ↓"), ("operations", "a query")]
    yield Table("times", f"Times of settings: {_conditions(run, timed[0])}", headers, rows, [_NOTE])


def _row(timing: Record) -> list[str]:
    low, high = timing["ratio_interval95"]
    rounds = timing["rounds"]
    apart = 100 * (max(rounds) / min(rounds) - 1)
    between = timing.get("ratio_between_texels")
    cells = [timing["label"], significant(timing["ratio_to_floor"], 3)]
    cells += [f"{significant(low, 3)} to {significant(high, 3)}", significant(apart, 2)]
    cells += [significant(between, 3) if between else NONE, significant(timing["ns_per_sample"], 3)]
    return [*cells, f"{timing['flops']:,}"]


def _conditions(run: Run, timing: Record) -> str:
    """Where and how they were measured, in words."""
    start: Record = next((each for each in run.starts if each["run"] == timing["run"]), {})
    machine = start.get("machine", {})
    place = timing.get("gpu") or machine.get("processor") or timing["device"]
    threads = "" if timing.get("gpu") else f", {timing['threads']} thread{'s' * (timing['threads'] > 1)}"
    return f"{place}{threads}, {timing['execution']} {timing['dtype']}, batches of {timing['batch']:,}"
