import re

import pytest

from bench import cli
from bench.inputs.errors import InputError
from bench.records import load_run
from reports import table_text
from reports.choice import Choice
from reports.rows import materials
from reports.series import plots_of
from reports.summary import summary_table


def summary(run, **more):
    return summary_table(run, materials(run), **more)


def test_a_summary_ranks_codecs_over_materials(made):
    for material, psnrs in {"satin": (30.0, 33.0, 28.0), "brick": (26.0, 25.0, 24.0)}.items():
        for label, psnr in zip(("pca", "neubtf", "mean-colour"), psnrs, strict=True):
            made.job(label, material=material, psnr=psnr).job(label, material=material, seed=1, psnr=psnr + 1)
    made.job("vq", psnr=40.0)
    table = summary(load_run(made.folder))
    rows = {row[0]: row for row in table.rows}
    assert [row[0] for row in table.rows] == ["neubtf", "pca", "mean-colour", "vq"]
    assert rows["neubtf"][1:5] == ["2 of 2", "1.5", "1", "29.50"]
    assert rows["pca"][1:5] == ["2 of 2", "1.5", "1", "28.50"]
    assert rows["vq"][1] == "1 of 2"
    assert set(rows["vq"][2:]) == {"—"}, "no mean over fewer materials beside the others"
    assert any("vq (not on brick)" in note and "--material" in note for note in table.notes)
    column = [name for name, _ in table.headers].index("PSNR")
    assert {row: mark for (row, at), mark in table.marks.items() if at == column} == {0: "bold", 1: "underlined"}
    assert not any(row == 3 for row, _ in table.marks)  # vq is not in the race
    assert "2 materials: satin, brick" in table_text(made.folder)


def test_a_summary_is_sorted_by_mean_rank_then_psnr_as_its_note_says(made):
    psnrs_of = {"satin": (40.0, 31.0, 30.0, 10.0), "brick": (20.0, 22.0, 23.0, 10.0), "wool": (20.0, 22.0, 21.0, 10.0)}
    for material, psnrs in psnrs_of.items():
        for label, psnr in zip(("high", "mid", "pca", "low"), psnrs, strict=True):
            made.job(label, material=material, psnr=psnr)
    table = summary(load_run(made.folder))
    rows = [(row[0], row[2], row[4]) for row in table.rows]
    assert rows == [("mid", "1.7", "25.00"), ("pca", "2.0", "24.67"), ("high", "2.3", "26.67"), ("low", "4.0", "10.00")]
    assert any("mean rank" in note for note in table.notes)


def test_a_codec_without_error_ranks_first_and_one_alone_has_no_summary(made):
    assert summary(load_run(made.job("table", psnr=100.0).folder)) is None
    table = summary(load_run(made.job("pca").folder))
    exact, other = table.rows
    assert (exact[:5], other[:5]) == (["table", "1 of 1", "1.0", "1", "48.13"], ["pca", "1 of 1", "2.0", "0", "30.00"])


def test_an_exact_codec_is_the_best_by_each_metric_and_counts_in_means(made):
    for material, psnrs in (("satin", (100.0, 100.0, 30.0)), ("brick", (100.0, 30.0, 30.0))):
        for label, psnr in zip(("table", "half", "pca"), psnrs, strict=True):
            made.job(label, material=material, psnr=psnr)
    table = summary(load_run(made.folder))
    names = [name for name, _ in table.headers]
    ssim = names.index("SSIM")
    rows = {row[0]: row for row in table.rows}
    assert rows["table"][ssim] == "exact"
    assert rows["half"][ssim] != "—", "exact slices have a number, too"
    assert table.marks[table.rows.index(rows["table"]), ssim] == "bold"


def test_codecs_are_told_apart_by_paired_differences_with_an_interval(made):
    for material in ("satin", "brick"):
        made.job("pca", material=material, psnr=30.0).job("vq", material=material, psnr=28.5)
        made.job("neubtf-direct", material=material, psnr=29.5)
    table = summary(load_run(made.folder))
    column = [name for name, _ in table.headers].index("against")
    vq = next(row for row in table.rows if row[0] == "vq")
    assert vq[column:] == ["−1.00", "−1.00 (−1.00 to −1.00)", "−1.00 (−1.00 to −1.00)"]
    assert [name for name, _ in table.headers[column:]] == ["against", "on satin", "on brick"]
    assert any("3 surfaces" in note for note in table.notes)
    for label, psnr in (("pca", 29.0), ("vq", 28.5), ("neubtf-direct", 29.5)):
        made.job(label, material="wool", psnr=psnr)
    table = summary(load_run(made.folder))
    against = {row[0]: row[column] for row in table.rows}
    assert (against["neubtf-direct"], against["vq"]) == ("—", "−1.00 *")
    assert not against["pca"].endswith("*")
    (note,) = (note for note in table.notes if note.startswith("Against neubtf-direct:"))
    assert re.search(r"1 of 2 .*\(\*\)", note)


def test_a_job_on_other_data_does_not_take_the_place_of_a_published_one_in_the_differences(run_maker, tmp_path):
    maker = run_maker(tmp_path / "all").start("1", suite="all")
    for material in ("satin", "brick"):
        maker.job("neubtf-direct", material=material, run="1", psnr=30.0)
        maker.job("pca", material=material, run="1", psnr=28.0)
    published = maker.folder / "published.jsonl"  # beside the slices that it names
    published.write_bytes((maker.folder / "records.jsonl").read_bytes())
    own = run_maker(tmp_path / "own").start("2", suite="own").job("pca", run="2", psnr=10.0, btf="other")
    text = table_text([published, own.folder], kind="summary")
    (row,) = (line for line in text.splitlines() if line.startswith("pca "))
    assert row.count("−2.00") == 1 + 3 + 3  # over both materials, then on each, with its interval


def test_one_codec_timed_again_leaves_the_times_of_the_others_and_has_a_star(made):
    for name in ("pca", "vq", "mine"):
        made.job(name).timing(name, run="0")
    made.timing("mine", run="1")
    run = load_run(made.folder)
    table = summary(run)
    times = {row[0]: row[[name for name, _ in table.headers].index("time")] for row in table.rows}
    assert {name for name, time in times.items() if time.endswith("*")} == {"mine"}
    assert "—" not in times.values()
    assert "star: mine on satin" in table.notes[-1]
    (speed,) = (plot for plot in plots_of(run) if plot["kind"] == "speed")
    assert len(speed["series"]) == 3


def test_from_ten_materials_the_mean_has_an_interval_and_no_material_a_column(made):
    for number in range(10):
        made.job("pca", material=f"m{number}", psnr=30.0).job("neubtf-direct", material=f"m{number}", psnr=31.0)
    table = summary(load_run(made.folder))
    assert table.headers[-1] == ("against", "neubtf-direct")
    assert table.rows[1][-1] == "−1.00 (−1.00 to −1.00) *"


def test_the_row_that_others_are_set_against_is_named_and_can_be_chosen(made, capsys):
    made.job("neubtf-direct width=8", psnr=28.0).job("neubtf-direct", psnr=30.0).job("pca", psnr=29.0)
    first = summary(load_run(made.folder))
    assert first.headers[-1] == ("against", "neubtf-direct width=8")
    assert any("neubtf-direct width=8 " in note and "--against" in note for note in first.notes)

    def against(label):
        table = summary(load_run(made.folder), against=label)
        return table.headers[-1][1], {row[0]: row[-1].partition(" ")[0] for row in table.rows}

    assert against("neubtf-direct")[1] == {"neubtf-direct": "—", "pca": "−1.00", "neubtf-direct width=8": "−2.00"}
    assert against("pca") == ("pca", {"neubtf-direct": "+1.00", "pca": "—", "neubtf-direct width=8": "−1.00"})
    with pytest.raises(InputError, match=r"--against pcb: .*neubtf-direct width"):
        summary(load_run(made.folder), against="pcb")
    assert cli.main(["table", "main", str(made.folder), "--against", "pca"]) == 2
    assert "table summary" in capsys.readouterr().err
    assert cli.main(["table", "summary", str(made.folder), "--against", "pca", "--format", "csv"]) == 0
    assert "against pca" in capsys.readouterr().out
    made.job("neubtf-direct width=9", psnr=28.0).job("vq a=1").job("vq a=2")
    with pytest.raises(InputError, match=r"--against vq: .*vq a=1; vq a=2"):
        summary(load_run(made.folder), against="vq")


def test_where_no_codec_has_all_materials_none_can_be_set_against_and_the_remedy_says_so(made):
    made.job("pca", material="satin").job("vq", material="brick")
    with pytest.raises(InputError, match=r"--against pca: no codec .* all materials: .*--material"):
        summary(load_run(made.folder), against="pca")


def test_materials_can_be_chosen(made, capsys):
    for material in ("satin", "brick", "wool"):
        made.job("pca", material=material).job("vq", material=material, psnr=28.0)
    made.job("mine", material="satin", psnr=35.0)
    chosen = Choice(materials=["satin"])
    assert table_text(made.folder, "csv", "summary", chosen).splitlines()[1].startswith("mine,1 of 1,1.0,1,35.00")
    words = [word for name in ("brick", "wool") for word in ("--material", name)]
    assert cli.main(["table", str(made.folder), *words]) == 0
    text = capsys.readouterr().out
    assert "2 materials: brick, wool" in text
    assert "satin" not in text
    assert cli.main(["table", str(made.folder), "--material", "satim"]) == 2
    assert re.search("--material satim: .*'satin'", capsys.readouterr().err)
