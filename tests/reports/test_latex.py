import re
import shutil
import subprocess

import pytest

from reports import table_text
from reports.table import Table
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
    text = table_text(made.timing(long).trade("pca").folder, "latex")
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
