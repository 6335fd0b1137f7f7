"""Tables for a paper: some of their codecs, materials and columns, with other names, as options of a command ask for.

A *header* is the name of a column and, on a second line, its unit: ("PSNR", "dB ↑ ± seeds").
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

from bench.inputs.errors import InputError, did_you_mean
from bench.records import Job, Run, method_of, planned_jobs
from reports.table import OfData, Spread, Table


def new_names(words: Sequence[str]) -> dict[str, str]:
    """A dict from old names to new ones, from words `OLD=NEW`; `InputError` for a word without an old name, and
    for an old name that is given twice.

    The last `=` divides, because an old name may be a label with settings, `neubtf steps=100`.
    """
    names = {}
    for word in words:
        old, _, new = word.rpartition("=")
        if not old:
            raise InputError("--name: write WORD=NAME, such as 'neubtf-direct=NeuBTF, direct'")
        if old in names:
            raise InputError(f"--name {word}: {old} is given twice: give it once")
        names[old] = new
    return names


@dataclass(frozen=True)
class Choice:
    """What to show of tables, and under which names. Without codecs, columns or materials, all of them are shown."""

    codecs: Sequence[str] = ()  # names or labels
    columns: Sequence[str] = ()  # names of columns, or names with units: "PSNR", "PSNR dB ↑"
    names: Mapping[str, str] = field(default_factory=dict)  # new names by old ones
    materials: Sequence[str] = ()
    against: str = ""  # the codec or label that the summary compares the others with; "": `neubtf-direct`

    def of_run(self, run: Run) -> Run:
        """The run with only the jobs of these codecs and materials, so that ranks and the best are among them.

        `InputError` if the run has no job of a chosen codec, of a chosen material, or of `against`.
        """
        # Checked for any table, although only the summary uses it: a name with a typing error is always reported.
        if self.against and not any(self.against in _codec_names(job) for job in run.jobs):
            labels = "; ".join(dict.fromkeys(job["label"] for job in run.jobs))
            raise InputError(f"--against {self.against}: this run has no such row: it has {labels}")
        if not (self.codecs or self.materials):
            return run
        jobs = run.jobs.only(lambda job: self._chosen(job["material"], _codec_names(job)))
        self._refuse_absent(run, jobs)
        if self.against and not any(self.against in _codec_names(job) for job in jobs):
            remedy = f"give --codec {self.against}, too" if self.codecs else "choose a material that it was measured on"
            raise InputError(f"--against {self.against}: not among the chosen rows: {remedy}")
        # A start of the run names the jobs that it planned. Those that are not chosen are removed there, too, so that
        # tables do not list them as not run.
        starts = []
        for start in run.starts:
            planned = [job for job in planned_jobs(start) if self._chosen(job.material, (job.method, job.label))]
            starts.append(start | {"jobs": [job.name for job in planned]})
        return replace(run, jobs=jobs, starts=starts)

    def _refuse_absent(self, run: Run, chosen: Iterable[Job]) -> None:
        """Raise `InputError` for a material that the run lacks, or a codec that none of the `chosen` jobs has."""
        materials_of_run = {str(job["material"]) for job in run.jobs}
        for name in self.materials:
            if name not in materials_of_run:
                raise InputError(f"--material {name}: this run does not have it{did_you_mean(name, materials_of_run)}")
        self._refuse_absent_codecs(run.jobs, chosen)

    def _refuse_absent_codecs(self, jobs: Iterable[Job], chosen: Iterable[Job]) -> None:
        """Raise `InputError` for a codec that none of the `chosen` jobs has; `jobs` are those of any choice."""
        names = {name for job in chosen for name in _codec_names(job)}
        for codec in self.codecs:
            if codec in names:
                continue
            if any(codec in _codec_names(job) for job in jobs):
                remedy = "choose a material that it was measured on"
                raise InputError(f"--codec {codec}: this run does not have it on the chosen materials: {remedy}")
            others = {name for job in jobs for name in _codec_names(job)}
            raise InputError(f"--codec {codec}: this run does not have it{did_you_mean(codec, others)}")

    def of_jobs(self, jobs: Sequence[Job]) -> list[Job]:
        """The jobs of the chosen codecs, of any material. `InputError` for a codec that none has."""
        chosen = [job for job in jobs if self._has_codec(_codec_names(job))]
        self._refuse_absent_codecs(jobs, chosen)
        return chosen

    def _chosen(self, material: str, codec_names: Sequence[str]) -> bool:
        """Whether a job of this material, with a codec of these names, is chosen. Where none is given, all are."""
        return (not self.materials or material in self.materials) and self._has_codec(codec_names)

    def _has_codec(self, codec_names: Sequence[str]) -> bool:
        """Whether a codec of these names is chosen, as all are where none is given."""
        return not self.codecs or any(codec in codec_names for codec in self.codecs)

    def of_tables(self, tables: Sequence[Table]) -> list[Table]:
        """The tables with only the chosen columns, in the order of the choice, and with the new names.

        Tables without any of the columns, and those of a material that is not chosen, are left out. `InputError` for a
        column, and for a name to be replaced, that no table has.
        """
        # A table with the material "" is about all of them.
        chosen = [table for table in tables if not self.materials or table.material in ("", *self.materials)]
        if self.columns:
            chosen = self._with_columns(chosen)
        for old, new in self.names.items():
            alone = replace(self, names={old: new})
            if chosen and old != new and all(alone._renamed(table) == table for table in chosen):
                raise InputError(f"--name {old}={new}: no table has {old!r} as a codec, row, column or material")
        return [self._renamed(table) for table in chosen]

    def _with_columns(self, tables: Sequence[Table]) -> list[Table]:
        """The tables that have chosen columns, with only these; `InputError` for a column that no table has."""
        # Of all columns of numbers. The first `table.words` columns have words, such as the codec: they always stay.
        headers: list[tuple[str, str]] = []
        for table in tables:
            headers += table.headers[table.words :]
        for column in self.columns:
            if not any(_matches(column, header) for header in headers):
                columns_of_tables = "; ".join(dict.fromkeys(map(_name_and_unit, headers))) or "none"
                raise InputError(f"--column {column}: no such column: there are {columns_of_tables}")
        cut_tables = [self._cut(table) for table in tables]
        return [table for table in cut_tables if table]

    def _cut(self, table: Table) -> Table | None:
        """The table with its columns of words and the chosen columns of numbers; None if it has none of these."""
        chosen_places: dict[int, None] = {}  # of columns, in the order of the choice, each once
        for column in self.columns:
            for place in range(table.words, len(table.headers)):
                if _matches(column, table.headers[place]):
                    chosen_places[place] = None
        if not chosen_places:
            return None
        return table.of_columns([*range(table.words), *chosen_places])

    def _renamed(self, table: Table) -> Table:
        """The table with new names: of codecs and materials in the words at the left, the title and the notes, and of
        columns in the headers."""
        # Headers may name a material or a codec, too.
        word_cells: list[str] = [word for header in table.headers for word in header if isinstance(word, OfData)]
        rows = []
        for row in table.rows:
            words, numbers = row[: table.words], row[table.words :]
            word_cells += words
            rows.append([*map(self.with_new_names, words), *numbers])
        # In notes only names that this table has are replaced: that of another codec may be a plain word there.
        names_of_table = set()
        for old in self.names:
            if old == table.material or any(old in cell for cell in word_cells):
                names_of_table.add(old)
        headers = [self._renamed_header(header) for header in table.headers]
        notes = [self.with_new_names(note, names_of_table) for note in table.notes]
        title = self.with_new_names(table.title)
        material = self.names.get(table.material, table.material)
        return replace(table, headers=headers, rows=rows, title=title, notes=notes, material=material)

    def _renamed_header(self, header: tuple[str, str]) -> tuple[str, str]:
        """A header with its new name, which may be given for its name alone or for its name with its unit.

        A new name for "PSNR dB ↑" replaces name and unit: ("PSNR", "dB ↑ ± seeds") becomes ("quality", "± seeds"). A
        new name for "PSNR" replaces the name alone.
        """
        name, unit = header
        name_and_unit = _name_and_unit(header)
        if name_and_unit in self.names:
            return self.names[name_and_unit], unit.over if isinstance(unit, Spread) else ""
        new_name = self.with_new_names(name) if isinstance(name, OfData) else self.names.get(name, name)
        return new_name, self.with_new_names(unit) if isinstance(unit, OfData) else unit

    def with_new_names(self, text: str, old_names: set[str] | None = None) -> str:
        """A text with new names in place of old ones where these stand as whole words.

        All old names are replaced, or only those in `old_names`.
        """
        replaced = self.names if old_names is None else old_names
        longest_first = sorted(replaced, key=len, reverse=True)  # of two that begin alike, the longer is tried first
        if not longest_first:
            return text
        # A hyphen is part of a word, as in `neubtf-direct`.
        pattern = "|".join(rf"(?<![\w-]){re.escape(name)}(?![\w-])" for name in longest_first)
        return re.sub(pattern, lambda match: self.names[match[0]], text)


def _codec_names(job: Job) -> tuple[str, ...]:
    """The names by which a choice may call the codec of a job: its name, its label."""
    return method_of(job), job["label"]


def _name_and_unit(header: tuple[str, str]) -> str:
    """A header on one line without what its deviation is over: "PSNR dB ↑" of ("PSNR", "dB ↑ ± seeds")."""
    name, unit = header
    return f"{name} {unit.unit if isinstance(unit, Spread) else unit}".strip()


def _matches(column: str, header: tuple[str, str]) -> bool:
    """Whether a reader's word for a column means this header: its name, or its name and unit, in capitals or not, with
    or without an arrow."""
    wanted = column.lower().rstrip(" ↑↓")
    return wanted in (header[0].lower(), _name_and_unit(header).lower().rstrip(" ↑↓"))
