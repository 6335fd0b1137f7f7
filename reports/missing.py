"""Finds planned codecs and materials for which a run has no numbers, and numbers that cannot be compared."""

from collections.abc import Iterator

from bench.records import Run, grouped, shown_label
from reports.rows import materials


def not_run(run: Run) -> Iterator[tuple[str, str, list[int]]]:
    """Material, codec and seeds of the planned jobs of a run without a record."""
    labels = {str(job.get("label")): shown_label(job) for job in run.jobs}
    cells: dict[tuple[str, str], list[int]] = {}  # the seeds of each material and codec
    for name in dict.fromkeys(name for start in run.starts for name in start.get("jobs", [])):
        material, _, rest = name.partition("/")
        label, _, seed = rest.rpartition("/")
        if run.job(name) is None and seed.isdecimal():
            cells.setdefault((material, labels.get(label, label)), []).append(int(seed))
    yield from ((*cell, seeds) for cell, seeds in cells.items())


def missing_note(run: Run) -> str:
    """The codecs and materials without any result, and those that lack some seeds; "" if there are none."""
    done = {(job["material"], shown_label(job)) for job in run.jobs if job["status"] == "ok"}
    lacking = [(job["material"], shown_label(job)) for job in run.jobs if job["status"] != "ok"]
    lacking += [cell[:2] for cell in not_run(run)]
    without = _grouped([cell for cell in lacking if cell not in done])
    fewer = _grouped([cell for cell in lacking if cell in done])
    words = [f"No result: {without}." if without else "", f"Fewer seeds: {fewer}." if fewer else ""]
    return " ".join(filter(None, words))


def left_out_notes(run: Run) -> Iterator[str]:
    """Notes on codecs and materials whose numbers, or times, cannot be compared with the newest, and why."""
    starts = ("Left out, as not comparable with the newest job", "Times left out", "Times with a star")
    found: dict[str, dict[str, list[tuple[str, str]]]] = {start: {} for start in starts}
    for material in materials(run):
        for row in material.rows:
            if why := row.obstacle or row.timing_obstacle:
                start = starts[0 if row.obstacle else 1 + row.timed_apart]
                found[start].setdefault(why, []).append((material.name, row.label))
    for start, reasons in found.items():
        if reasons:
            yield f"{start}: {'; '.join(f'{_grouped(cells)} ({why})' for why, cells in reasons.items())}."


def _grouped(cells: list[tuple[str, str]]) -> str:
    """Codecs that lack the same materials together: `neubtf, neumip on brick; vq on satin`."""
    materials: dict[str, dict[str, None]] = {}
    for material, label in cells:
        materials.setdefault(label, {})[material] = None
    labels = grouped(materials, lambda label: tuple(sorted(materials[label])))
    return "; ".join(f"{', '.join(alike)} on {', '.join(lacks)}" for lacks, alike in labels.items())
