import re

from bench.records import append, load_run
from reports import table_text, write_report
from reports.stress import stress_tables, summary, tables


def record(subject, extreme, verdict="pass", figure="", detail="", order=0, group="data", version=1):
    known = {"kind": "stress", "subject": subject, "extreme": extreme, "verdict": verdict, "figure": figure}
    known |= {"detail": detail, "order": order, "group": group, "version": version}
    return known | {"holds": "finite", "seconds": 0.1}


RECORDS = [
    record("vq", "sine", "n/a", "n/a", "has no sine", order=2, group="networks"),
    record("pca", "constant", "fail", "3.2%", "a value is off by 3.2 %", order=1),
    record("vq", "constant", order=1),
    record("pca", "zero", order=0),
    record("vq", "zero", order=0),
    record("vq", "fp16", figure="57 dB", order=2, group="networks"),
    record("vq", "reciprocity (reported)", figure="12%", order=3, group="invariants"),
    record("ssim", "one texel", "n/a", "n/a", "reference is 1 × 1, but SSIM needs at least 11 × 11", 9, "pictures"),
    record("psnr", "one texel", order=9, group="pictures"),
]


def test_extremes_are_rows_in_the_catalogue_s_order_and_codecs_columns():
    of_codecs, of_pictures = tables(RECORDS)
    assert [name for name, _ in of_codecs.headers] == ["extreme", "pca", "vq"]
    assert of_codecs.rows == [
        ["data:", "", ""],
        ["zero", "pass", "pass"],
        ["constant", "FAIL 3.2%", "pass"],
        ["networks:", "", ""],
        ["sine", "—", "n/a a"],
        ["fp16", "—", "pass 57 dB"],
        ["invariants:", "", ""],
        ["reciprocity (reported)", "—", "12%"],
    ]
    failed, again, reason = of_codecs.notes
    assert re.search(r"pca, constant: .*3\.2 %", failed)
    assert "neubtf-bench stress --codec" in again
    assert reason.startswith("a: ")
    assert of_pictures.rows == [["ssim", "n/a a"], ["psnr", "pass"]]
    assert [note[:3] for note in of_pictures.notes] == ["a: "]


def test_a_run_shows_its_own_records(made):
    made.job("pca components=8")
    for one in RECORDS:
        append(made.folder, one)
    append(made.folder, record("pca", "constant", order=1))
    text = table_text(made.folder, kind="stress")
    assert "FAIL" not in text  # the latest counts
    assert "7 pass, 0 fail, 2 " in table_text(made.folder)
    written = {file.name for file in write_report(made.folder).files}
    assert {"stress.md", "stress.tex"} <= written
    assert "Extremes" in (made.folder / "report.html").read_text(encoding="utf-8")


def test_what_was_tried_on_a_former_version_of_a_codec_is_not_shown_beside_the_newest(made):
    append(made.folder, record("pca", "constant", "fail", order=1, version=4))
    append(made.folder, record("pca", "zero", version=5))
    append(made.folder, record("vq", "constant", order=1))
    (table,) = stress_tables(load_run(made.folder))
    assert table.rows == [["data:", "", ""], ["zero", "pass", "—"], ["constant", "—", "pass"]]


def test_a_run_without_records_shows_those_beside_it_of_its_codecs_and_versions(made, tmp_path):
    made.job("pca components=8", fit_key={"version": 1})
    assert (stress_tables(load_run(made.folder)), summary(load_run(made.folder))) == ([], "")
    (tmp_path / "stress").mkdir()
    for one in (*RECORDS, record("pca", "sine", order=2, version=2)):
        append(tmp_path / "stress", one)
    (table,) = stress_tables(load_run(made.folder))
    assert table.rows == [["data:", ""], ["zero", "pass"], ["constant", "FAIL 3.2%"]]
    assert "1 pass, 1 fail, 0 " in summary(load_run(made.folder))


def test_the_reasons_have_letters_however_many_there_are():
    (table,) = tables([record("pca", f"extreme {i}", "n/a", detail=f"reason {i}", order=i) for i in range(28)])
    assert [row[1] for row in table.rows[-3:]] == ["n/a z", "n/a aa", "n/a bb"]
    assert table.notes[-1] == "bb: reason 27"
