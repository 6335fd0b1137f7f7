"""The whole records in a page: for each number the job that measured it, and the provenance of the run."""

import json
from collections.abc import Iterator, Sequence
from html import escape
from typing import Any

from bench.records import ARTEFACT, RESULTS, Run, field_names, kept
from reports.html_tables import note
from reports.rows import CodecRows, MaterialRows

BUDGET = 6_000_000  # characters of JSON; deflated, a quarter of it


class PageRecords:
    """The records of a run, by material and codec, each with its timing, until the budget is spent."""

    def __init__(self, run: Run, materials: Sequence[MaterialRows]):
        self.run = run
        self.records: list[Any] = list(run.starts[-1:])  # in the order of their elements
        self.places: dict[tuple[str, str], str] = {}
        self.names: list[tuple[str, str, str]] = []  # id, title, the fit in words
        self.left_out = 0
        paths = set(field_names(ARTEFACT)) - {"file"}  # of this machine, where several runs are read together
        left = BUDGET
        for m, material in enumerate(materials):
            for c, codec in enumerate(material.codecs):
                jobs = [{name: value for name, value in row.job.items() if name not in paths} for row in codec.rows]
                times = [{"timing": kept(row.timing, RESULTS)} if row.timing else {} for row in codec.rows]
                record = [{"job": job} | time for job, time in zip(jobs, times, strict=True)]
                left -= len(json.dumps(record))
                if left < 0:
                    self.left_out += 1
                    continue
                self.places[material.name, codec.label] = f"#r{m}-{c}"
                self.names.append((f"r{m}-{c}", f"{material.name}, {codec.label}", _fit_in_words(codec)))
                self.records.append(record)

    def place(self, material: str, label: str) -> str:
        """A link to a record's element, without a material to the codec's first one; "" where there is none."""
        if material:
            return self.places.get((material, label), "")
        return next((place for (_, other), place in self.places.items() if other == label), "")

    def html(self) -> Iterator[str]:
        """An element for each record, filled when it is opened."""
        yield '<h2 id="records">Records and provenance</h2>'
        yield note("The records behind each row, as in records.jsonl, without the raw timing samples.")
        start = [("provenance", "the run: machine, packages, revision, suite", "")] if self.run.starts else []
        yield from (_folded(*name, number) for number, name in enumerate([*start, *self.names]))
        if self.left_out:
            more = f"{self.left_out} more rows have their records only in records.jsonl"
            yield note(f"{more}: this page has no room for them.")


def _fit_in_words(codec: CodecRows) -> str:
    """Seeds, revision and file of a codec's fits, or the status of a failed one."""
    job = codec.rows[0].job
    if job["status"] != "ok":
        return str(job["status"])
    fitted, digest = job.get("fitted") or {}, str(job["score_key"].get("sha256", ""))[:12]
    seeds = f"{len(codec.rows)} seeds" if len(codec.rows) > 1 else ""
    revision = f"fitted by {fitted['git']}" if fitted.get("git") else ""
    return ", ".join(filter(None, [seeds, revision, f"file {digest}"]))


def _folded(place: str, title: str, remark: str, number: int) -> str:
    more = f' <small class="notes">{escape(remark)}</small>' if remark else ""
    return f'<details id="{place}" data-record="{number}"><summary>{escape(title)}{more}</summary><pre></pre></details>'
