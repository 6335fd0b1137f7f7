import re
from dataclasses import replace

import pytest

from bench.records import append, load_run
from reports import table_text
from reports.notes import run_notes
from reports.series import plots_of
from reports.table import STALE, Table
from reports.tables import all_tables
from reports.terminal import terminal
from reports.text import plain

LONG = "neubtf channels=14 guidance=albedo layers=3 steps=4000 width=32"


def test_the_main_table_fits_a_terminal_and_notes_of_several_stand_once(made):
    for label in ("mean-colour", "pca components=32 precision=8bit", LONG):
        made.job(label, bytes={"decoder": 1, "texture": 2, "total": 15_375_476}).timing(label, ns_per_sample=17_419.5)
    main = terminal(load_run(made.folder)).split("where the error lies")[0]
    assert max(map(len, main.splitlines())) <= 120
    assert "15,375,476" in main
    first, last = table_text(made.job(LONG, material="leather").folder, kind="main").split("leather (")
    assert ("Bytes are" in first, last.count("Bytes are")) == (False, 1)


def test_lines_that_could_not_be_read_are_counted(made):
    with open(made.job().folder / "records.jsonl", "a") as file:
        file.write("{cut\n")
    assert re.search(r"1 line.* records .*: 3\.", table_text(made.folder))


def test_markdown_keeps_labels_as_they_are(made):
    text = table_text(made.job("a|b *c* _d_ x_y", material="<b>").folder, "markdown", "main")
    assert r"a\|b \*c\* \_d\_ x_y" in text
    assert r"### \<b>" in text
    lines = [line for line in text.splitlines() if line.startswith("|")]
    assert len({line.replace(r"\|", "").count("|") for line in lines}) == 1


def test_rows_that_another_revision_made_are_named(made):
    append(made.folder, {"kind": "run", "run": "2", "suite": "made", "git": "new", "machine": {}})
    made.job("pca components=8", fitted={"git": "old"}, scored={"git": "new"})
    made.job("vq", fitted={"git": "new"}, scored={"git": "new"})
    (note,) = run_notes(load_run(made.folder))[1:]
    assert re.search(" old, .* new: satin/pca components=8/0", note)


def test_a_revision_that_the_record_does_not_say_is_no_name_of_one(made):
    append(made.folder, {"kind": "run", "run": "2", "suite": "made", "git": "new", "machine": {}})
    made.job("vq", fitted={"git": None}, scored={"git": "old"})
    assert any("revision ?, scored by old: satin/vq/0" in note for note in run_notes(load_run(made.folder)))


def test_names_in_a_header_are_folded_between_words_alone():
    table = Table("summary", "short", [("codec", ""), ("against", "hierarchical")], [["pca", "+1.2"]])
    assert "hierarchical" in plain([table])


@pytest.mark.parametrize("format", ["text", "markdown", "latex", "csv", "raw"])
def test_a_name_steers_no_terminal_and_starts_no_line(made, format):
    made.job("pca", material="a\n::error file=x::b\x1b[2J\u202e").job("vq\r\x9b", material="satin")
    made.job("::error::vq", material="##[error] b ::error file=x::c ::error::d")
    made.unfinished("failed", "no\n::error::luck\x1b", label="b\x07", material="satin")
    text = table_text(made.folder, format)
    assert not [line for line in text.splitlines() if line.lstrip().startswith(("::", "##["))]
    assert {each for each in text if not each.isprintable()} == {"\n"}
    assert "x1b" in text


def test_what_every_label_of_a_table_says_stands_once_below_it(made):
    for label, psnr in (("neumip batch=64 steps=300", 30.0), ("neumip steps=300", 29.0), ("pca steps=300", 28.0)):
        made.job(label, psnr=psnr)
    table = next(table for table in all_tables(load_run(made.folder)) if table.kind == "main")
    short = table.with_short_labels()
    assert [row[0] for row in short.rows] == ["neumip batch=64", "neumip", "pca"]
    assert short.notes[-1].endswith(": steps=300.")
    for format, tables in (("text", 1), ("markdown", 1), ("latex", 2)):  # LaTeX has quality and cost in two
        assert table_text(made.folder, format, "main").count("steps=300") == tables, format
    assert table_text(made.folder, "csv", "main").count("steps=300") == 3  # it has no notes
    stale = replace(table, rows=[[row[0] + STALE, *row[1:]] for row in table.rows], notes=["pca steps=300: so."])
    assert stale.with_short_labels().notes[0] == "pca: so."
    made.job("vq")
    table = next(table for table in all_tables(load_run(made.folder)) if table.kind == "main")
    assert table.with_short_labels() == table


def test_a_label_is_the_same_in_tables_figures_and_options_whatever_its_recipe(made):
    made.job("neumip steps=3", settings={"recipe": "ours"}).job("neumip recipe=paper", settings={"recipe": "paper"})
    run = load_run(made.folder)
    labels = ["neumip steps=3", "neumip recipe=paper"]
    table = next(table for table in all_tables(run) if table.kind == "main")
    assert [row[0] for row in table.rows] == labels
    (rate,) = (plot for plot in plots_of(run) if plot["kind"] == "rate")
    assert sorted(entry["label"] for entry in rate["series"]) == sorted(labels)
