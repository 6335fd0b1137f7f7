from pathlib import Path

from bench.codecs.registry import current_versions
from bench.records import load_run
from reports import table_text
from reports.tables import all_tables
from reports.text import latex_escaped


def test_a_row_of_an_older_version_is_marked_in_every_table(made):
    now = current_versions("pca")
    made.job("pca", fit_key=now).job("vq", fit_key=current_versions("vq") | {"version": 1})
    tables = [table for table in all_tables(load_run(made.folder)) if table.kind in ("summary", "main", "slices")]
    assert len(tables) == 3
    for table in tables:
        assert {row[0] for row in table.rows} == {"pca", "vq †"}
        assert table.notes[-1].startswith("†: stale")
    assert latex_escaped("vq †") in table_text(made.folder, "latex", "main")


def test_an_older_version_of_a_recipe_marks_no_row_of_another(made):
    older = current_versions("neumip", "paper") | {"version": 1}
    made.job("neumip", fit_key=current_versions("neumip", "ours"), settings={"recipe": "ours"})
    made.job("neumip recipe=paper", fit_key=older, settings={"recipe": "paper"})
    tables = [table for table in all_tables(load_run(made.folder)) if table.kind in ("summary", "main", "slices")]
    assert len(tables) == 3
    for table in tables:
        assert {row[0] for row in table.rows} == {"neumip", "neumip recipe=paper †"}


def test_a_seed_of_an_older_version_that_is_left_out_marks_no_row(made):
    now = current_versions("pca")
    made.start(run="2").job("vq", fit_key=current_versions("vq"), run="2")
    made.job("pca", seed=0, fit_key=now | {"version": 1}).job("pca", seed=1, fit_key=now, run="2")
    (table,) = all_tables(load_run(made.folder), kind="slices")
    assert [row[0] for row in table.rows] == ["vq", "pca"]


def test_the_papers_table_does_not_mix_versions(run_maker, tmp_path):
    now = current_versions("neubtf", "paper")
    settings = {"recipe": "paper", "steps": 100}
    made = run_maker(tmp_path / "nearest").start(suite="paper-nearest")
    for seed, (version, psnr) in enumerate(((1, 10.0), (now["version"], 30.0))):
        fit_key = now | {"version": version}
        made.job("neubtf recipe=paper", "wool", seed=seed, psnr=psnr, fit_key=fit_key, settings=settings)
    (table,) = all_tables(load_run(made.folder), kind="paper")
    assert any("30.0" in cell for row in table.rows for cell in row)
    assert not any("20.0" in cell for row in table.rows for cell in row)


def test_a_choice_of_a_trade_is_as_old_as_its_file(made):
    made.job("pca", fit_key=current_versions("pca")).job("vq", fit_key=current_versions("vq") | {"version": 1})
    (table,) = all_tables(load_run(made.trade("pca", "vq").folder), kind="trade")
    assert {row[0] for row in table.rows} == {"pca", "vq †", "floor"}


def test_no_stale_row_stands_on_the_front_page():
    assert "†" not in (Path(__file__).parents[2] / "README.md").read_text(encoding="utf-8")
