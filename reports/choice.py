"""Tables for a paper: some of their codecs and columns, with other names."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from bench.inputs.errors import InputError, did_you_mean
from bench.records import Job, Records, Run, shown_label
from reports.table import Table


def new_names(words: Sequence[str]) -> dict[str, str]:
    """New names by old ones, of words `OLD=NEW`; the last `=` divides. `InputError` for a word without one."""
    names = {}
    for word in words:
        old, _, new = word.rpartition("=")
        if not old:
            raise InputError("--name: write WORD=NAME, such as 'neubtf-direct=NeuBTF, direct'")
        names[old] = new
    return names


@dataclass(frozen=True)
class Choice:
    """The codecs (names or labels), materials and columns to show (all if none are given), new names, and the codec or
    row that the summary sets the others against (`neubtf-direct` by default)."""

    codecs: Sequence[str] = ()
    columns: Sequence[str] = ()
    names: Mapping[str, str] = field(default_factory=dict)
    materials: Sequence[str] = ()
    against: str = ""

    def of_run(self, run: Run) -> Run:
        """The run with only the jobs of these codecs and materials, so that ranks and the best are among them."""
        if self.against and not any(self.against in _called(job) for job in run.jobs):
            labels = "; ".join(dict.fromkeys(map(shown_label, run.jobs)))
            raise InputError(f"--against {self.against}: this run has no such row: it has {labels}")
        if not (self.codecs or self.materials):
            return run
        there = {str(job["material"]) for job in run.jobs}
        for name in self.materials:
            if name not in there:
                raise InputError(f"--material {name}: this run does not have it{did_you_mean(name, there)}")
        jobs = Records({job["job"]: job for job in run.jobs if self._has(job)})
        known = {str(job.get("codec") or job["label"]) for job in run.jobs}
        known |= {shown_label(job) for job in run.jobs}
        for wanted in self.codecs:
            if not any(wanted in _called(job) for job in jobs):
                raise InputError(f"--codec {wanted}: this run does not have it{did_you_mean(wanted, known)}")
        starts = []
        for start in run.starts:
            planned = [name for name in start.get("jobs", []) if self._has(_planned(name))]
            starts.append(start | {"jobs": planned})
        return replace(run, jobs=jobs, starts=starts)

    def _has(self, job: Job) -> bool:
        """Whether a job is of a chosen material and codec; without a choice of either, each counts as chosen."""
        if self.materials and job["material"] not in self.materials:
            return False
        if not self.codecs:
            return True
        return any(wanted in _called(job) for wanted in self.codecs)

    def of_tables(self, tables: Sequence[Table]) -> list[Table]:
        """The tables with these columns, in this order, and names; those without any of the columns, and those of
        another material, are left out."""
        if self.materials:
            tables = [table for table in tables if not table.material or table.material in self.materials]
        if self.columns:
            every = [header for table in tables for header in table.headers[table.words :]]
            for wanted in self.columns:
                if not any(_matches(wanted, header) for header in every):
                    there = "; ".join(dict.fromkeys(map(_named, every)))
                    raise InputError(f"--column {wanted}: no such column: there are {there}")
            cut = [self._cut(table) for table in tables]
            tables = [table for table in cut if table]
        if self.names:
            return [self._renamed(table) for table in tables]
        return list(tables)

    def _cut(self, table: Table) -> Table | None:
        """The table with its words and the wanted columns; None if it has none of them."""
        places: dict[int, None] = {}
        for wanted in self.columns:
            for i in range(table.words, len(table.headers)):
                if _matches(wanted, table.headers[i]):
                    places[i] = None
        if not places:
            return None
        return table.of_columns([*range(table.words), *places])

    def _renamed(self, table: Table) -> Table:
        """The table with new names: of codecs and materials in the words at the left, the title and the notes, and of
        columns in the headers."""
        words: list[str] = []
        rows = []
        for row in table.rows:
            words += row[: table.words]
            rows.append([*map(self.said, row[: table.words]), *row[table.words :]])
        # In notes only names that this table has are replaced: that of another codec may be a plain word there.
        inside = {old for old in self.names if old == table.material or any(old in word for word in words)}
        headers = [self._renamed_header(header) for header in table.headers]
        notes = [self.said(note, inside) for note in table.notes]
        material = self.names.get(table.material, table.material)
        return replace(table, headers=headers, rows=rows, title=self.said(table.title), notes=notes, material=material)

    def _renamed_header(self, header: tuple[str, str]) -> tuple[str, str]:
        """A header, renamed if its name alone or its name with its unit has a new name; what a deviation is over
        stays."""
        name, unit = header
        line = _named(header)
        if line in self.names:
            _, sign, over = unit.partition("± ")  # of "dB ↑ ± seeds" keep "± seeds"
            return self.names[line], sign + over
        return self.names.get(name, name), unit

    def said(self, text: str, old: set[str] | None = None) -> str:
        """A text with new names in place of the old ones (all, or those in `old`) where they stand as whole words."""
        replaced = self.names if old is None else old
        words = sorted(replaced, key=len, reverse=True)  # of two that begin alike, the longer one is tried first
        if not words:
            return text
        pattern = "|".join(rf"(?<![\w-]){re.escape(word)}(?![\w-])" for word in words)
        return re.sub(pattern, lambda found: self.names[found[0]], text)


def _planned(name: str) -> Job:
    """What the name of a planned job, `MATERIAL/LABEL/SEED`, says of it."""
    material, _, rest = name.partition("/")
    label = rest.rpartition("/")[0]
    return {"job": name, "material": material, "label": label, "codec": label.split(" ")[0]}


def _called(job: Job) -> tuple[str, ...]:
    """The possible names of a codec: its name, its label, its label in tables."""
    return str(job.get("codec", "")), str(job.get("label", "")), shown_label(job)


def _named(header: tuple[str, str]) -> str:
    """A header on one line, name and unit, without what its deviation is over."""
    return " ".join(header).partition("±")[0].strip()


def _matches(wanted: str, header: tuple[str, str]) -> bool:
    """Whether a word names a column, in capitals or not: by the name alone, or by name and unit."""
    return wanted.lower() in (header[0].lower(), _named(header).lower())
