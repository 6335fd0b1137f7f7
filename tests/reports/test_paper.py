import re
from pathlib import Path

import pytest

from bench import cli
from bench.codecs.registry import current_versions
from bench.records import PSNR, load_run
from reports import table_text, write_report
from reports.paper import PUBLISHED, paper_tables
from reports.rows import materials
from reports.tables import all_tables

RESULTS = Path(__file__).parents[2] / "docs" / "results" / "paper-nearest.jsonl"
PAPER = "neubtf recipe=paper"


def short(made, **more):
    run = load_run(made.folder)
    (table,) = paper_tables(run, materials(run), **more)
    return table


def full(made):
    run = load_run(made.folder)
    _, table = paper_tables(run, materials(run), whole=True)
    return table


def cells(table):
    return {row[0]: row[1:] for row in table.rows}


def test_print_ours_and_the_difference_stand_in_a_column_for_each_material(made):
    made.start().job(PAPER, material="fabric01", psnr=27.5)
    table = short(made)
    assert table.headers[:3] == [("metric", ""), ("fabric01", "fabric01"), ("fabric03", "—")]
    assert [row[0] for row in table.rows[:3]] == ["PSNR ↑, print", "PSNR ↑, ours", "PSNR, ours − print"]
    of_fabric = {name: row[0] for name, row in cells(table).items()}
    assert [*of_fabric.values()] == [
        *("26.58 ± 1.820", "27.50 ± 1.500", "+0.92"),
        *("0.710 ± 0.108", "0.750 ± 0.125", "+0.040"),
        *("0.391 ± 0.047", "0.750 ± 0.125", "+0.359"),
        "not computed",
    ]
    values = table.values.set_index("metric")["fabric01"]
    assert values["PSNR, ours − print"] == pytest.approx(0.92)
    assert values.isna().to_list() == [False] * 9 + [True]


def test_ours_is_over_the_fitted_pairs_the_longest_fit_by_the_papers_recipe(made):
    made.start("2", suite="paper-nearest")
    for label, psnr, steps in ((PAPER, 25.0, 5), (f"{PAPER} steps=20", 28.0, 20), (f"{PAPER} steps=10", 27.0, 10)):
        made.job(label, material="wool", run="2", psnr=psnr, settings={"steps": steps})
    made.job("neubtf steps=90", material="wool", run="2", psnr=31.0, settings={"steps": 90})
    made.job("neumip recipe=paper steps=90", material="wool", run="2", psnr=32.0, settings={"steps": 90})
    fitted = made._group(26.5)  # of the longest fit, over its fitted pairs
    scores = {"all": made._group(24.0), "train": fitted, "heldout": made._group(20.0)}
    made.job(f"{PAPER} steps=30", material="wool", run="2", scores=scores, settings={"slices": 4, "steps": 30})
    table = short(made)
    assert table.headers[1] == ("fabric01", "wool")
    assert cells(table)["PSNR ↑, ours"][0] == "26.50 ± 1.500"
    assert "wool, 8 pairs, steps=30, slices=4, 1 seed" in table.notes[1]


def test_a_material_of_the_paper_itself_comes_before_the_nearest_one(made):
    made.start("2", suite="paper-nearest").job(PAPER, material="fabric01", psnr=25.0, settings={"steps": 5})
    made.job(f"{PAPER} steps=9", material="wool", run="2", psnr=29.0, settings={"steps": 9})
    table = short(made)
    assert table.headers[1] == ("fabric01", "fabric01")
    assert cells(table)["PSNR ↑, ours"] == ["25.00 ± 1.500", "—", "—", "—"]


def test_seeds_are_averaged_and_a_note_says_how_much_they_scatter(made):
    made.start("2", suite="paper-nearest")
    for seed, psnr in enumerate((25.0, 26.0, 27.0)):
        made.job(PAPER, material="bricks", seed=seed, psnr=psnr, run="2", shape=[4, 8], settings={"steps": 7})
    table = short(made)
    assert cells(table)["PSNR ↑, ours"][2] == "26.00 ± 1.500"
    assert "bricks 4 × 8, 8 pairs, steps=7, 3 seeds, ± 1.00 dB." in table.notes[1]


def test_a_material_that_was_not_measured_has_dashes_and_a_note_says_where_to_get_it(made):
    made.start().job(PAPER, material="fabric01").job("pca components=8", material="ceramic")
    made.unfinished("unavailable", "there is no such file: ask UTIA", PAPER, "fabric03")
    table = short(made, absent={"embroidery": "nowhere", "fabric01": "here"})
    dashes = {name for name, row in cells(table).items() if row[1:] == ["—"] * 3}
    of_metrics = [(f"{metric}, ours", f"{metric[:-2]}, ours − print") for metric in ("PSNR ↑", "SSIM ↑", "FLIP ↓")]
    assert dashes == {name for names in of_metrics for name in names}
    assert not any("—" in row for name, row in cells(table).items() if name not in dashes)
    notes = [note for note in table.notes if note.startswith("—")]
    for note, name, reason in zip(
        notes, ("fabric03", "ceramic", "embroidery"), ("ask UTIA", PAPER, "nowhere"), strict=True
    ):
        assert re.match(f"—: {name}: .*{reason}", note)


def test_the_nearest_materials_stand_for_the_paper_s_in_their_own_suite_alone(made, run_maker, tmp_path, capsys):
    made.start("2", suite="paper-nearest").job("neubtf", material="wool", run="2").job("neubtf", material="satin")
    table = full(made)
    assert [row[0] for row in table.rows] == ["wool, for fabric01"] * 3
    assert table.rows[0][5] == "26.58 ± 1.820"
    other = run_maker(tmp_path / "b").start("3", suite="budgets").job("neubtf", material="wool", run="3", btf="other")
    assert cli.main(["table", "paper", str(made.folder), str(other.folder), "--all"]) == 0
    assert capsys.readouterr().out.count("wool, for") == 3


def test_every_fit_has_rows_over_all_pairs_fitted_and_held_out_ones(made):
    made.start().job(PAPER, material="fabric01", psnr=27.5).job("pca components=8", material="fabric01")
    made.unfinished("failed", "why", "neubtf steps=3", "fabric01")
    made.unfinished("unavailable", "there is no such file: ask UTIA", PAPER, "fabric03")
    table = full(made)
    ours, fitted, held_out, pca, _, _, failed, absent = table.rows
    assert ours[:5] == ["fabric01", PAPER, "1", "all", "27.50 ± 1.50"]
    # The paper fits what it scores.
    assert ours[5::2] == fitted[5::2] == ["26.58 ± 1.820", "0.710 ± 0.108", "0.391 ± 0.047"]
    assert fitted[3] == "fitted"
    assert held_out[3::2] == ["held out", "", "", ""]
    assert (pca[5::2], absent[4::2], absent[5]) == (["—"] * 3, ["none yet"] * 3, "27.73 ± 4.711")
    assert failed[3:5] == ["all", "failed"]
    assert any(re.match("none yet: fabric03: .*ask UTIA", note) for note in table.notes)


def test_several_seeds_of_a_label_make_one_row_with_how_much_they_scatter(made):
    maker = made.start("2", suite="paper-nearest")
    for seed, psnr in enumerate((25.0, 26.0, 27.0)):
        maker.job(PAPER, material="wool", seed=seed, psnr=psnr, run="2")
    maker.job("neubtf", material="satin", psnr=30.0, run="2").job("neubtf", material="wool", psnr=28.0, run="2")
    rows = [row[:5] for row in full(made).rows if row[3] == "all"]
    assert rows == [  # materials stay together
        ["wool, for fabric01", PAPER, "3, ± 1.00", "all", "26.00 ± 1.50"],
        ["wool, for fabric01", "neubtf", "1", "all", "28.00 ± 1.50"],
        ["satin, for embroidery", "neubtf", "1", "all", "30.00 ± 1.50"],
    ]


def test_rows_of_an_older_version_are_marked_in_both_tables(made):
    made.job(PAPER, material="fabric01", fit_key=current_versions("neubtf", "paper") | {"version": 1})
    grid, every = all_tables(load_run(made.folder), kind="paper", whole=True)
    assert [unit.endswith(" †") for _, unit in grid.headers] == [False, True, False, False, False]
    assert {row[1] for row in every.rows} == {f"{PAPER} †"}
    assert all(table.notes[-1].startswith("†: stale") for table in (grid, every))


def test_of_the_published_records_it_fits_80_columns_and_12_rows():
    text = table_text(RESULTS, kind="paper")
    lines = text.partition("\n\n")[2].partition("\nMean ±")[0].splitlines()
    rows = [line for line in lines if not line.startswith("---")]  # with the two of headers
    assert len(rows) <= 12
    assert max(map(len, lines)) <= 80


def test_all_adds_every_fit_to_this_table_alone(made, capsys):
    made.start().job(PAPER, material="fabric01")
    assert cli.main(["table", "paper", str(made.folder)]) == 0
    assert "held out" not in capsys.readouterr().out
    assert cli.main(["table", "paper", str(made.folder), "--all"]) == 0
    printed = capsys.readouterr().out
    assert "PSNR, ours − print" in printed
    assert "held out" in printed
    for kind in (["main"], []):
        assert cli.main(["table", *kind, str(made.folder), "--all"]) == 2
        assert "--all" in capsys.readouterr().err


def test_a_report_has_both_tables_in_one_file(made):
    made.start().job(PAPER, material="fabric01")
    write_report(made.folder)
    for suffix in ("md", "tex"):
        text = (made.folder / "tables" / f"paper.{suffix}").read_text(encoding="utf-8")
        assert 0 < text.index("ours") < text.index("held out")


def test_names_of_materials_are_replaced_in_headers_and_notes(made, capsys):
    made.start("2", suite="paper-nearest").job(PAPER, material="wool", run="2")
    assert cli.main(["table", "paper", str(made.folder), "--name", "wool=Loden"]) == 0
    printed = capsys.readouterr().out
    assert printed.count("Loden") == 2
    assert "wool" not in printed


def test_without_any_data_the_command_says_what_is_missing_and_where_to_get_it(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("NEUBTF_DATA", raising=False)
    assert cli.main(["table", "paper"]) == 0
    text = capsys.readouterr().out
    for material, published in PUBLISHED.items():
        mean, deviation = published[PSNR]
        assert material in text
        assert f"{mean:.2f} ± {deviation:.3f}" in text
    assert "http://btf.utia.cas.cz/" in text
