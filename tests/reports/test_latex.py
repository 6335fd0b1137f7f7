import json
import re
import shutil
import subprocess
import unicodedata
from pathlib import Path

import pytest

from bench.records import load_run
from reports import table_text
from reports.table import Table
from reports.tables import all_tables
from reports.text import label, latex
from reports.text import latex_escaped as escaped


def test_special_characters_are_escaped():
    assert escaped("50 % of a_b & c # $ {x}") == r"50 \% of a\_b \& c \# \$ \{x\}"
    assert escaped("a\\b~^") == r"a\textbackslash{}b\textasciitilde{}\textasciicircum{}"
    shown = r"1 \ensuremath{\pm} 2 at \ensuremath{\theta_o}\ensuremath{>}60\ensuremath{^\circ}"
    assert escaped("1 ± 2 at θ_o>60°") == shown


def test_every_row_has_as_many_cells_as_the_table_has_columns(made):
    made.job("50%_a&b").unfinished("failed", "Error: {").timing("50%_a&b")
    text = table_text(made.folder, "latex")
    for columns, body in re.findall(r"\\begin\{tabular\}\{([^\n]*)\}\n(.*?)\\end\{tabular\}", text, re.S):
        count = len(re.sub(r"p\{.*\}", "p", columns.replace("@{}", "")))
        rows = [line for line in body.splitlines() if line.endswith(r"\\")]
        assert rows
        assert {len(re.split(r"(?<!\\)&", row)) for row in rows} == {count}


@pytest.mark.skipif(not shutil.which("pdflatex"), reason="pdflatex is not installed")
@pytest.mark.parametrize("options", ["", "twocolumn"])
def test_every_table_fits_an_article(made, tmp_path, options):
    long = "neubtf channels=14 guidance=albedo layers=3 steps=4000 width=32"
    made.job(long).job("100%_{a}&b", seed=1, psnr=100.0).unfinished("failed", "ValueError: $ # " + "no luck " * 30)
    text = table_text(made.timing(long).trade(long).folder, "latex")
    head = rf"\documentclass[{options}]{{article}}\usepackage{{booktabs,graphicx}}\begin{{document}}"
    (tmp_path / "a.tex").write_text(f"{head}\n{text}\n\\end{{document}}\n")
    command = ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "a.tex"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout[-2000:]
    assert "Overfull \\hbox" not in done.stdout


def test_a_first_cell_is_no_argument_of_the_line_before():
    rows = [["[12] PCA", "1"], ["*ours", "2"]]
    text = latex([Table("main", "a table", [("codec", ""), ("PSNR", "")], rows)])
    assert r"{}[12] PCA & 1 \\" in text
    assert r"{}*ours & 2 \\" in text


def test_labels_of_materials_of_similar_names_differ(made):
    for material in ("a_b", "a-b", "a b"):
        made.job(material=material)
    text = table_text(made.folder, "latex", "main")
    labels = re.findall(r"\\label\{(.*)\}", text)
    assert len(labels) == len(set(labels)) > 2


def test_a_letter_with_an_accent_does_not_split_a_word_of_a_label():
    assert label(Table("main", "Häuser 128 × 128 (dB)", [], [])) == "tab:main-hauser-128-128"


@pytest.mark.long
def test_pdflatex_knows_every_character_of_tables_of_budgets(tmp_path):
    """Beyond ASCII it knows only letters with accents and some signs, without a package."""
    published = Path(__file__).parents[2] / "docs/results/budgets.jsonl"
    lines = []  # of few codecs, which is fast
    for line in published.read_text().splitlines(keepends=True):
        record = json.loads(line)
        if record["kind"] != "job" or record.get("codec") in ("pca", "vq", "relief"):
            lines.append(line)
    (tmp_path / "few.jsonl").write_text("".join(lines))
    run = load_run(tmp_path / "few.jsonl")
    text = ""
    for kind in ("front", "curves", "budgets", "rungs", "ranks", "when", "summary", "main"):
        tables = [table for table in all_tables(run, narrow=True, kind=kind) if table]
        assert tables, kind
        text += latex(tables)
    for character in sorted(set(text)):
        is_letter = unicodedata.name(character, "").startswith("LATIN")
        assert character.isascii() or is_letter or character in "–—“”‘’…·§°±×÷µ", character
    assert r"\ensuremath{\geq}" in text


def test_signs_and_greek_letters_are_mathematics():
    assert escaped("≥35.2 → ∞†") == (
        r"\ensuremath{\geq}35.2 \ensuremath{\rightarrow} \ensuremath{\infty}\ensuremath{\dagger}"
    )
    assert escaped("σ² ω₀ 10⁻⁴") == (
        r"\ensuremath{\sigma}\ensuremath{^2} \ensuremath{\omega}\ensuremath{_0} 10\ensuremath{^-}\ensuremath{^4}"
    )
    assert escaped("4–8, ‘a’") == "4--8, `a'"


@pytest.mark.long
def test_a_papers_reader_is_sent_to_no_page_command_or_option(made):
    for note, kept in (
        ("Read off the hull (docs/metrics.md, “Curves”). —: none.", "Read off the hull. ---: none."),
        ("Counted (by torchinfo). See docs/trade.md.", "Counted (by torchinfo)."),
        ("Means. --material NAME chooses.", "Means."),
        ("`neubtf-bench run paper` fits it; `run paper-nearest` what anyone can get.", ""),
        ("So -- and a--b, of neubtf-bench 0.1.0, stay.", "So -- and a--b, of neubtf-bench 0.1.0, stay."),
    ):
        text = latex([Table("main", "title", [("codec", ""), ("PSNR", "dB")], [["pca", "1"]], [note])])
        below = text.partition(r"\scriptsize" + "\n")[2].partition("\n\\end{minipage}")[0]
        assert below == kept
    quick = Path(__file__).parents[2] / "docs" / "results"
    for records in (quick / "quick.jsonl", quick / "budgets.jsonl", quick / "paper-nearest.jsonl"):
        text = table_text(records, "latex")
        assert not re.search(r"docs/|(?<!`)`\w|(?<![-\w])--[a-z]", text), records
