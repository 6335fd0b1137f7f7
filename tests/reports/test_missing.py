import re
from pathlib import Path

import pytest

from bench.inputs.errors import InputError
from bench.records import FILE, append, load_run
from reports import KINDS, table_text
from reports.notes import missing_note
from reports.rows import materials
from reports.summary import summary_table


def planned(made, *names):
    append(made.folder, {"kind": "run", "run": "1", "suite": "made", "device": "cpu", "machine": {}, "jobs": [*names]})
    return made


def test_what_was_planned_and_has_no_result_is_named_by_codec_and_material(made):
    every = [f"{m}/{c}/{s}" for m in ("brick", "satin") for c in ("pca", "vq components=4", "table") for s in (0, 1)]
    planned(made, *every).job("pca", material="brick").job("pca", material="brick", seed=1)
    made.job("pca", material="satin").job("table", material="satin").unfinished("failed", "why", "table", "brick")
    run = load_run(made.folder)
    says = missing_note(run)
    assert re.search(r"table on brick; vq components=4 on brick, satin\..* seeds: pca, table on satin\.", says)
    assert summary_table(run, materials(run)).notes[-1] == says
    shown = table_text(made.folder, "markdown", "unfinished")
    rows = [[cell.strip() for cell in line.split("|")[1:5]] for line in shown.splitlines() if "not run" in line]
    assert rows == [
        ["brick", "vq components=4", "not run", "seeds 0, 1"],
        ["brick", "table", "not run", "seed 1"],
        ["satin", "pca", "not run", "seed 1"],
        ["satin", "vq components=4", "not run", "seeds 0, 1"],
        ["satin", "table", "not run", "seed 1"],
    ]


NEVER_EMPTY = ("parameters", "paper", "unfinished")  # the last one's rows are those of jobs without a record


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind not in NEVER_EMPTY])
def test_a_table_without_rows_names_the_damaged_line_where_they_may_stand(made, kind):
    file = Path(made.folder) / FILE
    assert table_text(made.folder, "markdown", kind).strip() == ""  # sound records that have no rows
    made.job("pca", material="satin")
    first, second = file.read_bytes().splitlines(keepends=True)
    for damaged in (second[:-9], second.replace(b"pca", b"pcb")):
        file.write_bytes(first + damaged)
        with pytest.raises(InputError, match=r"records\.jsonl, line\(s\) 2: "):
            table_text(made.folder, "markdown", kind)
    file.write_bytes(first[:-9])
    with pytest.raises(InputError, match=r"records\.jsonl, line\(s\) 1: "):
        table_text(made.folder, "raw", kind)
