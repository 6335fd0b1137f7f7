import csv
import io

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
    assert [row["why"] for row in rows] == ["another exposure", "", "why", "where"]
    assert rows[2]["error"] == "why"


def test_numbers_are_written_for_programs_and_other_cells_stay():
    rows = [["a", "−1.2"], ["b", "1,234"], ["-", "+0.31 (−0.1 to +1.50)"]]
    text = table_csv([Table("main", "", [("codec", ""), ("gain", "")], rows)])
    assert text == "codec,gain\na,-1.2\nb,1234\n-,+0.31 (−0.1 to +1.50)\n"
