"""The paper's table of quality, beside ours: its values, ours over all pairs, and `no data` where there are none."""

from bench.records import load_run
from reports import table_text
from reports.paper import PUBLISHED, paper_table


def test_ours_stand_beside_the_papers(made):
    made.start().job("neubtf recipe=paper", material="fabric01", psnr=27.5)
    made.job("pca components=8", material="fabric01")
    made.unfinished("unavailable", "there is no such file: ask UTIA", "neubtf recipe=paper", "fabric03")
    table = paper_table(load_run(made.folder))
    ours, pca, absent = table.rows
    assert ours[:2] == ["fabric01", "neubtf recipe=paper"]
    assert ours[2].startswith("27.5")
    assert "±" in ours[2]
    assert ours[3::2] == ["26.58 ± 1.820", "0.710 ± 0.108", "0.391 ± 0.047"]
    assert pca[3::2] == ["—"] * 3
    assert absent[2::2] == ["no data"] * 3
    assert absent[3] == "27.73 ± 4.711"


def test_the_default_of_a_codec_with_recipes_is_called_ours(made):
    made.start().job("neubtf steps=9", settings={"recipe": "ours"})
    made.job("neubtf recipe=paper", settings={"recipe": "paper"})
    text = table_text(made.folder, "markdown", "main")
    names = [line.split("|")[1].strip() for line in text.splitlines() if line.startswith("| neubtf")]
    assert names == ["neubtf (our recipe) steps=9", "neubtf recipe=paper"]


def test_a_run_of_other_materials_has_no_such_table(made):
    made.start().job("neubtf")
    assert paper_table(load_run(made.folder)) is None
    assert table_text(made.folder, kind="paper") == ""


def test_every_material_of_the_paper_is_in_its_suite():
    from bench.runs.suite import load_suite

    assert {spec.name for spec in load_suite("paper").materials} == set(PUBLISHED)
