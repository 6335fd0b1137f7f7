import csv
import io
import re
import shlex
from pathlib import Path

import pytest

from bench import cli
from bench.inputs.errors import InputError
from reports import table_text
from reports.choice import Choice

PAGE = Path(__file__).parents[2] / "docs" / "reports.md"


@pytest.fixture
def folder(made):
    made.job("vq", psnr=29.0).job("neubtf-direct steps=9", psnr=31.0).job("pca", psnr=30.0)
    return made.timing("pca").folder


def test_the_command_of_the_page_prints_what_it_says(folder, capsys):
    (line,) = re.findall("^neubtf-bench table summary .*--name.*$", PAGE.read_text(encoding="utf-8"), re.M)
    words = shlex.split(line.partition(">")[0])[1:]
    assert cli.main([str(folder) if word == "runs/quick" else word for word in words]) == 0
    text = capsys.readouterr().out
    assert r"\label{tab:summary}" in text
    body = text.partition(r"\midrule")[2].partition(r"\bottomrule")[0]
    rows = [[cell.strip() for cell in row.removesuffix(r"\\").split("&")] for row in body.strip().splitlines()]
    assert rows == [["NeuBTF, direct steps=9", r"\textbf{31.00}", "36,110"], ["pca", r"\underline{30.00}", "36,110"]]
    assert "vq" not in text
    assert "neubtf-direct" not in text, "nor in the notes"


def test_columns_stand_in_the_order_given_and_are_renamed(folder):
    choice = Choice(["vq", "pca"], ["time", "psnr pooled"], {"time ns ↓": "ns", "satin": "Satin"})
    assert table_text(folder, "text", "main", choice).startswith("Satin (")
    header, *rows = csv.reader(io.StringIO(table_text(folder, "csv", "main", choice)))
    assert header == ["material", "codec", "ns", "time × floor ↓", "PSNR pooled dB ↑"]
    assert [row[1:3] for row in rows] == [["pca", "123"], ["vq", ""]]
    assert "vq" not in table_text(folder, "csv", "main", Choice(columns=["time ns ↓"])), "its cells are empty there"


def test_a_note_on_a_column_that_is_not_chosen_is_left_out(folder):
    assert "training pairs)" in table_text(folder, "text", "main")
    assert "training pairs)" in table_text(folder, "text", "main", Choice(columns=["PSNR", "PSNR train"]))
    alone = table_text(folder, "text", "main", Choice(columns=["PSNR"]))
    assert "decoded from" in alone
    assert "“train”" not in alone


def test_a_codec_or_column_that_is_not_there_is_an_error_that_says_which_are(folder, run_maker, capsys):
    with pytest.raises(InputError, match=r"--codec pcb: .*'pca'"):
        table_text(folder, choice=Choice(["pcb"]))
    made = run_maker(folder).job("vq", material="wool")
    with pytest.raises(InputError, match=r"--codec pca: .* not .* on the chosen materials: choose"):
        table_text(made.folder, choice=Choice(["pca"], materials=["wool"]))
    with pytest.raises(InputError, match=r"--column LPIPS: .*SSIM ↑"):
        table_text(folder, kind="main", choice=Choice(columns=["LPIPS"]))
    assert cli.main(["table", str(folder), "--name", "pca"]) == 2
    assert "--name: " in capsys.readouterr().err
    assert cli.main(["table", str(folder), "--name", "pcs=PCA"]) == 2
    assert "'pcs'" in capsys.readouterr().err


def test_a_row_to_set_others_against_must_be_in_the_run_even_if_no_table_uses_it(folder, capsys):
    for kind in (["main"], []):
        assert cli.main(["table", *kind, str(folder), "--against", "nope"]) == 2
        assert "--against nope" in capsys.readouterr().err
    with pytest.raises(InputError, match=r"--against nope: .*vq; neubtf-direct steps=9"):
        table_text(folder, "text", None, Choice(against="nope"))


def test_a_new_name_reaches_the_codec_and_the_materials_that_headers_of_differences_name(made):
    for material in ("satin", "brick"):
        made.job("neubtf-direct steps=9", material).job("pca", material, psnr=31.0)
    names = {"neubtf-direct": "Ours", "pca": "Linear", "satin": "Silk", "PSNR": "quality"}
    header, *rows = csv.reader(io.StringIO(table_text(made.folder, "csv", "summary", Choice(names=names))))
    assert not any(
        old in cell for old in ("neubtf-direct", "pca", "satin") for line in (header, *rows) for cell in line
    )
    assert {"against Ours", "on Silk dB", "on brick dB", "quality dB ↑"} <= {*header}
    choice = Choice(names={"pca": "Linear"}, against="pca")
    assert "against Linear" in next(csv.reader(io.StringIO(table_text(made.folder, "csv", "summary", choice))))


def test_a_row_to_set_others_against_that_is_not_chosen_is_refused_with_the_option_that_adds_it(folder):
    with pytest.raises(InputError, match=r"--against pca: .*--codec pca"):
        table_text(folder, "text", "summary", Choice(codecs=["vq", "neubtf-direct"], against="pca"))
    chosen = Choice(codecs=["vq", "pca"], against="pca")
    assert "against pca" in table_text(folder, "csv", "summary", chosen)


def test_a_choice_of_every_codec_changes_no_number(run_maker, tmp_path):
    for name, validated in (("a", True), ("b", False)):
        made = run_maker(tmp_path / name).start()
        known = made._group(30.0 if validated else 25.0)
        scores = {"heldout": known, "train": known} | ({"validation": known} if validated else {})
        made.job("pca", scores=scores, fit_seconds=1.0)
    folders = [tmp_path / "a", tmp_path / "b"]
    whole = table_text(folders, kind="budgets")
    assert "30.0" in whole
    assert table_text(folders, kind="budgets", choice=Choice(["pca"])) == whole
