from pathlib import Path

from bench import cli
from bench.records import load_run
from reports import parameters_text, table_text
from reports.parameters import parameters_table


def job(codec, parameters, channels, label="", run="1", **settings):
    counts = {"parameters": parameters, "cost": {"texture_channels": channels}, "settings": settings}
    label = label or codec
    return {"status": "ok", "job": label, "codec": codec, "label": label} | counts | ({"run": run} if run else {})


def test_ours_stand_beside_the_paper_s_with_the_difference():
    jobs = [job("rainer2020", 38_269, 38), job("neubtf", 3_011, 14), job("pca", 0, 16), job("neumip", 3_254, 14)]
    table = parameters_table(jobs)
    assert table.rows == [
        ["NeuBTF", "neubtf", "3,011", "3,011", "0", "14", "14", "0"],
        ["NeuMIP", "neumip", "3,254", "3,332", "-78", "14", "14", "0"],
        ["Rainer 2020", "rainer2020", "38,269", "38,269", "0", "38", "38", "0"],
    ]
    page = (Path(__file__).parents[2] / "docs" / "metrics.md").read_text(encoding="utf-8")
    assert "Rainer 2020: 32 latents, and the mean and the deviation" in " ".join(page.split())
    assert table.notes[-1].endswith(
        "Rainer 2019, Zeltner 2024, Triple plane, Biplane, NeuralBTF: no codec of this method was measured."
    )


def test_the_paper_s_recipe_comes_first_and_the_page_says_why_ours_differs():
    ours = job("neumip", 3_457, 14, recipe="ours", directions="xyzh")
    paper = job("neumip", 3_332, 14, "neumip recipe=paper", run=None, recipe="paper", directions="xy")
    measured = job("neumip", 3_332, 14, "neumip recipe=paper steps=9", recipe="paper", directions="xy")
    table = parameters_table([ours, measured, paper])
    assert [(row[1], row[4]) for row in table.rows] == [("neumip recipe=paper", "0"), ("neumip (our recipe)", "+125")]
    notes = " ".join(table.notes)
    page = (Path(__file__).parents[2] / "docs" / "metrics.md").read_text(encoding="utf-8")
    assert "inputs more than published, z of both directions and the half vector" in " ".join(page.split())
    assert "counted in a file of a single step" in notes
    assert "single step" not in " ".join(parameters_table([ours, measured]).notes)


def test_the_code_of_zeltner_s_authors_is_held_against_its_own_count():
    jobs = [job("zeltner2024", 819, 8, recipe="paper", edition="code"), job("zeltner2024", 2_115, 8, recipe="ours")]
    assert [row[3:5] for row in parameters_table(jobs).rows] == [["819", "0"], ["1,923", "+192"]]


def test_decoders_that_differ_are_told_apart_and_equal_ones_are_one_row():
    jobs = [
        job("neumip", 3_332, 14, "neumip steps=9"),
        job("neumip", 3_332, 14),
        job("neumip", 3_254, 14, "neumip outputs=3"),
    ]
    assert [row[1:3] for row in parameters_table(jobs).rows] == [["neumip", "3,332"], ["neumip outputs=3", "3,254"]]


def test_every_count_of_the_papers_is_met_by_a_recipe_as_published(monkeypatch, capsys):
    monkeypatch.chdir(Path(__file__).parents[2])
    files = map(str, Path("docs/results").glob("*.jsonl"))
    assert cli.main(["table", "parameters", *files, "--format", "csv"]) == 0
    rows = [line.split(",") for line in capsys.readouterr().out.splitlines()[1:] if line.count(",") == 7]
    first = {row[0]: row for row in reversed(rows)}
    assert {method: row[2] for method, row in first.items() if row[4] == "0"} == {
        "NeuBTF": "3011",
        "NeuMIP": "3332",
        "Rainer 2019": "35725",
        "Rainer 2020": "38269",
        "Zeltner 2024 (code)": "819",
        "Triple plane": "3011",
        "Biplane": "136451",
        "Hierarchical": "8026",
        "NeuralBTF": "556038",
    }


def test_it_is_one_of_a_run_s_tables_and_has_every_format(made):
    made.start().job("neubtf-direct").job("pca components=8")
    text = table_text(made.folder, kind="parameters")
    assert text.count("3,011") == 2
    jobs = load_run(made.folder).jobs
    assert parameters_text(jobs) == text
    assert parameters_text(jobs, "csv").splitlines()[1] == "NeuBTF,neubtf-direct,3011,3011,0,14,14,0"
    assert "| NeuBTF" in parameters_text(jobs, "markdown")
    assert "3,011" in parameters_text(jobs, "latex")


def test_a_run_without_such_codecs_has_no_such_table(made):
    made.start().job()
    assert table_text(made.folder, kind="parameters").strip() == ""
