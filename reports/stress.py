"""The tables of the stress test: extremes × codecs, and metrics × extreme pictures.

The stress test tries every codec, metric and loss, its *subjects*, on *extremes*: inputs that break renderers, such as
grazing angles or highlights, in *groups* of one sort. A record is one extreme on one subject: its *verdict* ("pass",
"fail", "n/a" if the extreme does not apply), a *figure* for its cell as text ("57 dB"; "" for none), a *detail* as a
sentence, and in `used` which share of what is allowed was used. Only codecs have versions.
"""

from collections import Counter
from collections.abc import Iterable
from string import ascii_lowercase

from bench.records import FILE, STRESS, Run, Stress, grouped, load_run
from reports.numbers import NONE
from reports.table import Table

PICTURES = "pictures"  # the group whose subjects are metrics and losses
WORDS = {"pass": "pass", "fail": "FAIL"}  # of a cell, by verdict
REPORTED = "(reported)"  # ends the name of an extreme whose figure has no verdict
FOLD = 36  # columns of a terminal for the name of an extreme


def stress_tables(run: Run) -> list[Table]:
    """The tables of what was tried for a run."""
    return tables(_records_for(run))


def _records_for(run: Run) -> list[Stress]:
    """A run's own stress records, of the newest version of each codec, or if it has none, some of the stress test in
    the folder beside the run.

    Those are the records of the codecs that the run measured, in the same version: others are of other code.
    """
    if len(run.stress):
        newest: dict[str, int] = {}
        for record in run.stress:
            newest[record["subject"]] = max(record.get("version") or 0, newest.get(record["subject"], 0))
        return [record for record in run.stress if (record.get("version") or 0) == newest[record["subject"]]]
    folder = run.folder.parent / STRESS
    is_this_run = folder.resolve() == run.folder.resolve()  # which has no records, see above
    if is_this_run or not (folder / FILE).is_file():
        return []
    finished = [job for job in run.jobs if job["status"] == "ok"]
    measured = {(job["codec"], (job.get("fit_key") or {}).get("version")) for job in finished}
    return [record for record in load_run(folder).stress if (record["subject"], record.get("version")) in measured]


def tables(records: Iterable[Stress]) -> list[Table]:
    """A table of extremes × codecs, and one of metrics and losses × extreme pictures; each only if it has a record."""
    ordered = sorted(records, key=lambda record: record["order"])  # the order of the catalogue
    of_codecs = [record for record in ordered if record["group"] != PICTURES]
    of_metrics = [record for record in ordered if record["group"] == PICTURES]
    tables = []
    if of_codecs:
        tables.append(_codecs_table(of_codecs))
    if of_metrics:
        tables.append(_metrics_table(of_metrics))
    return tables


def summary(run: Run) -> str:
    """One line that counts the verdicts of the tables; "" if nothing was tried."""
    # A codec or metric and an extreme that were tried again count once, as last tried.
    verdicts = {(record["subject"], record["extreme"]): record["verdict"] for record in _records_for(run)}
    if not verdicts:
        return ""
    count = Counter(verdicts.values())
    return f"Extremes (table stress): {count['pass']} pass, {count['fail']} fail, {count['n/a']} not applicable."


def _codecs_table(records: list[Stress]) -> Table:
    """A row an extreme, below a row that names its group; a column a codec."""
    cells = _Cells(records)
    codecs = sorted({record["subject"] for record in records})
    rows = []
    for group, of_group in grouped(records, lambda record: record["group"]).items():
        rows.append([f"{group}:", *[""] * len(codecs)])
        for extreme in dict.fromkeys(record["extreme"] for record in of_group):  # each once, in order
            rows.append([extreme, *(cells.text(codec, extreme) for codec in codecs)])
    return _table("Extremes that codecs must survive", "extreme", codecs, rows, cells)


def _metrics_table(records: list[Stress]) -> Table:
    """A row a metric or loss, a column an extreme picture."""
    cells = _Cells(records)
    extremes = list(dict.fromkeys(record["extreme"] for record in records))
    rows = []
    for subject in dict.fromkeys(record["subject"] for record in records):
        rows.append([subject, *(cells.text(subject, extreme) for extreme in extremes)])
    return _table("Extreme pictures for metrics and losses", "metric or loss", extremes, rows, cells)


def _table(title: str, corner: str, columns: list[str], rows: list[list[str]], cells: "_Cells") -> Table:
    """A table of these rows of text; `corner` is the header of the column that names them. Its notes are of `cells`."""
    headers = [(corner, ""), *((column, "") for column in columns)]
    return Table("stress", title, headers, rows, cells.notes(), fold=FOLD)


class _Cells:
    """Cells by subject and extreme. Where an extreme does not apply, the cell has a letter, and a note the reason."""

    def __init__(self, records: list[Stress]):
        self.records = {(record["subject"], record["extreme"]): record for record in records}
        reasons = dict.fromkeys(record["detail"] for record in records if record["verdict"] == "n/a")
        self.letters: dict[str, str] = {}  # by reason: a, b, …, z, aa, bb, …
        for number, reason in enumerate(reasons):
            rounds, place = divmod(number, 26)
            self.letters[reason] = ascii_lowercase[place] * (1 + rounds)

    def text(self, subject: str, extreme: str) -> str:
        """The text of a cell: the verdict with its figure, as “pass 31.2 dB”; `n/a` with the letter of the reason; a
        dash if the extreme was not tried. An extreme without a verdict, see `REPORTED`, shows its figure alone."""
        record = self.records.get((subject, extreme))
        if record is None:
            return NONE
        if record["verdict"] == "n/a":
            return f"n/a {self.letters[record['detail']]}"
        if record["verdict"] == "pass" and extreme.endswith(REPORTED):
            return record["figure"]
        word = WORDS[record["verdict"]]
        return f"{word} {record['figure']}" if record["figure"] else word

    def notes(self) -> list[str]:
        """The notes of a table: what failed, what came closest to failing each extreme, and the reasons by letter."""
        failed = [record for record in self.records.values() if record["verdict"] == "fail"]
        notes = [f"FAIL {record['subject']}, {record['extreme']}: {record['detail']}" for record in failed]
        if any(record["group"] != PICTURES for record in failed):  # the command's option names a codec, not a metric
            notes.append('To try one cell again: neubtf-bench stress --codec CODEC --case "EXTREME"')
        # Of each extreme, the one that used the largest share of what is allowed.
        with_share = [record for record in self.records.values() if record.get("used") is not None and record["detail"]]
        for extreme, of_extreme in grouped(with_share, lambda record: record["extreme"]).items():
            worst = max(of_extreme, key=lambda record: record.get("used") or 0.0)
            notes.append(f"{extreme}, worst of all: {worst['subject']}: {worst['detail']}")
        notes += [f"{letter}: {reason}" for reason, letter in self.letters.items()]
        return notes
