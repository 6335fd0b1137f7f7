import csv
import io

from bench.records import load_run
from reports import table_text


def test_a_csv_holds_the_numbers_of_the_record_to_the_last_digit(made):
    made.job('π=3, "4"', psnr=1 / 3, fit_seconds=0.1 + 0.2).timing('π=3, "4"', ns_per_sample=1e-17 + 2 / 3)
    (row,) = csv.DictReader(io.StringIO(table_text(made.folder, "raw")))
    job = load_run(made.folder).jobs[0]
    assert row["label"] == job["label"]
    assert float(row["bytes/total"]) == 36110
    assert float(row["fit_seconds"]) == job["fit_seconds"]
    assert float(row["scores/heldout/metrics/psnr_display/pooled"]) == 1 / 3
    assert float(row["scores/heldout, new view, grazing light/metrics/rmse_linear/relative"]) == 0.333
    assert float(row["timing/ns_per_sample"]) == 1e-17 + 2 / 3
    assert (float(row["timing/interval95_ns/0"]), float(row["timing/interval95_ns/1"])) == (120.5, 130.5)
    assert float(row["metric_version/ssim_periodic"]) == 1


def test_every_job_has_a_row_whatever_became_of_it(made):
    made.job("old", run="0", exposure=3.0).job("new").unfinished("failed", "why").unfinished(
        "unavailable", "where", material="far"
    )
    rows = list(csv.DictReader(io.StringIO(table_text(made.folder, "raw"))))
    assert [row["status"] for row in rows] == ["ok", "ok", "failed", "unavailable"]
    assert [row["not_comparable"] for row in rows] == ["another exposure", "", "", ""]
    assert rows[2]["error"] == "why"


def test_a_run_without_jobs_is_a_header(made):
    assert table_text(made.folder, "raw") == "job\n"


def test_the_csv_of_a_table_has_the_columns_that_it_shows(made):
    made.job("vq", psnr=30.125).job("pca", psnr=31.0).job("vq", material="brick").timing("vq")
    shown = table_text(made.folder, "csv", "main")
    assert shown.count("codec") == 1, "tables of the same columns are one"
    rows = list(csv.DictReader(io.StringIO(shown)))
    assert [(row["material"], row["codec"]) for row in rows] == [("satin", "vq"), ("satin", "pca"), ("brick", "vq")]
    assert len(rows[0]) < 30
    assert (rows[0]["PSNR pooled dB ↑"], rows[0]["total bytes ↓"]) == ("30.12", "36110")
    assert (rows[0]["time ns ↓"], rows[1]["time ns ↓"]) == ("123", "")
    rows = csv.DictReader(io.StringIO(table_text(made.folder, "csv", "summary")))
    assert {row["codec"]: row["PSNR dB ↑"] for row in rows}["pca"] == "31.00"
