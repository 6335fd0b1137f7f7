from bench import cli
from bench.records import PSNR, load_run
from reports.paper import PUBLISHED, paper_table


def test_ours_stand_beside_the_papers_over_all_pairs_and_apart(made):
    made.start().job("neubtf recipe=paper", material="fabric01", psnr=27.5).job("pca components=8", material="fabric01")
    made.unfinished("unavailable", "there is no such file: ask UTIA", "neubtf recipe=paper", "fabric03")
    table = paper_table(load_run(made.folder))
    ours, fitted, held_out, pca, _, _, absent = table.rows
    assert ours[:5] == ["fabric01", "neubtf recipe=paper", "1", "all", "27.50 ± 1.50"]
    # The paper fits what it scores.
    assert ours[5::2] == fitted[5::2] == ["26.58 ± 1.820", "0.710 ± 0.108", "0.391 ± 0.047"]
    assert fitted[3] == "fitted"
    assert held_out[3::2] == ["held out", "", "", ""]
    assert (pca[5::2], absent[4::2], absent[5]) == (["—"] * 3, ["none yet"] * 3, "27.73 ± 4.711")
    assert "none yet: fabric03: there is no such file: ask UTIA." in table.notes


def test_the_nearest_materials_stand_for_the_paper_s_in_their_own_suite_alone(made, run_maker, tmp_path, capsys):
    made.start("2", suite="paper-nearest").job("neubtf", material="wool", run="2").job("neubtf", material="satin")
    table = paper_table(load_run(made.folder))
    assert [row[0] for row in table.rows] == ["wool, for fabric01"] * 3
    assert table.rows[0][5] == "26.58 ± 1.820"
    other = run_maker(tmp_path / "b").start("3", suite="budgets").job("neubtf", material="wool", run="3", btf="other")
    assert cli.main(["table", "paper", str(made.folder), str(other.folder)]) == 0
    assert capsys.readouterr().out.count("wool, for") == 3


def test_several_seeds_of_a_label_make_one_row_with_how_much_they_scatter(made):
    maker = made.start("2", suite="paper-nearest")
    for seed, psnr in enumerate((25.0, 26.0, 27.0)):
        maker.job("neubtf recipe=paper", material="wool", seed=seed, psnr=psnr, run="2")
    maker.job("neubtf", material="satin", psnr=30.0, run="2").job("neubtf", material="wool", psnr=28.0, run="2")
    rows = [row[:5] for row in paper_table(load_run(made.folder)).rows if row[3] == "all"]
    assert rows == [  # materials stay together
        ["wool, for fabric01", "neubtf recipe=paper", "3, ± 1.00", "all", "26.00 ± 1.50"],
        ["wool, for fabric01", "neubtf", "1", "all", "28.00 ± 1.50"],
        ["satin, for embroidery", "neubtf", "1", "all", "30.00 ± 1.50"],
    ]


def test_without_any_data_the_command_says_what_is_missing_and_where_to_get_it(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("NEUBTF_DATA", raising=False)
    assert cli.main(["table", "paper"]) == 0
    text = capsys.readouterr().out
    assert all(material in text and figures[PSNR] in text for material, figures in PUBLISHED.items())
    assert "http://btf.utia.cas.cz/" in text
