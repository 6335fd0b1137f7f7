import csv
import io

import pytest

from bench.records import load_run
from reports import table_text
from reports.table import Table
from reports.text import table_csv


def test_a_csv_holds_the_numbers_of_the_record_to_the_last_digit(made):
    made.job('π=3, "4"', psnr=1 / 3, fit_seconds=0.1 + 0.2).timing('π=3, "4"', ns_per_sample=1e-17 + 2 / 3)
    (row,) = csv.DictReader(io.StringIO(table_text(made.folder, "raw")))
    job = load_run(made.folder).jobs[0]
    assert (row["label"], float(row["bytes/total"])) == (job["label"], 36110)
    assert float(row["fit_seconds"]) == job["fit_seconds"]
    assert float(row["scores/heldout/metrics/psnr_display/pooled"]) == 1 / 3
    assert float(row["scores/heldout, new view, grazing light/metrics/rmse_linear/relative"]) == 0.333
    assert float(row["timing/ns_per_sample"]) == 1e-17 + 2 / 3
    assert (float(row["timing/interval95_ns/0"]), float(row["timing/interval95_ns/1"])) == (120.5, 130.5)
    assert float(row["metric_version/ssim_periodic"]) == 1


def test_every_job_has_a_row_whatever_became_of_it(made):
    made.job("old", run="0", exposure=3.0).job("new").unfinished("failed", "why")
    made.unfinished("unavailable", "where", material="far")
    rows = list(csv.DictReader(io.StringIO(table_text(made.folder, "raw"))))
    assert [row["status"] for row in rows] == ["ok", "ok", "failed", "unavailable"]
    assert [row["not_comparable"] for row in rows] == ["another exposure", "", "", ""]
    assert rows[2]["error"] == "why"


def test_no_cell_is_a_formula_and_numbers_stay_numbers(made):
    formulas = ['=HYPERLINK("http://x")', "+cmd|x", "@SUM(1)", "-2+3", "\t=1+1", "=1"]
    for name in formulas:
        made.job(name, material=name)
    for format in ("csv", "raw"):
        for row in csv.reader(io.StringIO(table_text(made.folder, format, "main"))):
            for cell in row:
                assert not cell.lstrip().startswith(("=", "@", "+", "-2+3")), cell
    rows = [["'a", "−1.2"], ["-", "+0.31 (−0.1 to +1.50)"]]
    text = table_csv([Table("main", "", [("codec", ""), ("gain", "")], rows)])
    assert text == "codec,gain\n'a,-1.2\n-,+0.31 (−0.1 to +1.50)\n"


@pytest.mark.parametrize("cell", ["-1 +cmd|' /C calc'!A0", '+1 +HYPERLINK("http://x")', "+1 %-cmd|x", "+1 to =1"])
def test_a_formula_behind_a_number_is_none(cell):
    text = table_csv([Table("main", "", [("codec", "")], [[cell]])])
    assert list(csv.reader(io.StringIO(text)))[1] == [f"'{cell}"]


@pytest.mark.parametrize(
    "cell", ["+0.31 ± 0.02", "-1.50 (−1.62 to −1.41) *", "+0.3 to +1.2", "+3 of 9", "+0.31 *", "+12 %", "-1,234.5 dB"]
)
def test_what_tables_write_after_a_number_makes_no_formula(cell):
    text = table_csv([Table("main", "", [("codec", ""), ("gain", "")], [["a", cell]])])
    assert list(csv.reader(io.StringIO(text)))[1] == ["a", cell]
