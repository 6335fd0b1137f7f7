from bench.records import load_run
from reports import table_text
from reports.series import plots_of
from reports.summary import summary_table


def test_a_summary_ranks_codecs_over_materials(made):
    for material, psnrs in {"satin": (30.0, 33.0, 28.0), "brick": (26.0, 25.0, 24.0)}.items():
        for label, psnr in zip(("pca", "neubtf", "mean-colour"), psnrs, strict=True):
            made.job(label, material=material, psnr=psnr).job(label, material=material, seed=1, psnr=psnr + 1)
    made.job("vq", psnr=40.0)
    table = summary_table(load_run(made.folder))
    rows = {row[0]: row for row in table.rows}
    assert [row[0] for row in table.rows] == ["neubtf", "pca", "mean-colour", "vq"]
    assert rows["neubtf"][1:5] == ["2 of 2", "1.5", "1", "29.50"]
    assert rows["pca"][1:5] == ["2 of 2", "1.5", "1", "28.50"]
    assert rows["vq"][1:5] == ["1 of 2", "—", "—", "40.00"]
    column = [name for name, _ in table.headers].index("PSNR")
    assert {row: mark for (row, at), mark in table.marks.items() if at == column} == {0: "bold", 1: "underlined"}
    assert not any(row == 3 for row, _ in table.marks)  # vq is not in the race
    assert "Summary over 2 materials: satin, brick" in table_text(made.folder)


def test_a_codec_without_error_ranks_first_and_one_alone_has_no_summary(made):
    assert summary_table(load_run(made.job("table", psnr=100.0).folder)) is None
    table = summary_table(load_run(made.job("pca").folder))
    exact, other = table.rows
    assert (exact[:5], other[:5]) == (["table", "1 of 1", "1.0", "1", "exact"], ["pca", "1 of 1", "2.0", "0", "30.00"])


def test_codecs_are_told_apart_by_paired_differences_with_an_interval(made):
    for material in ("satin", "brick"):
        made.job("pca", material=material, psnr=30.0).job("vq", material=material, psnr=28.5)
        made.job("neubtf-direct", material=material, psnr=29.5)
    table = summary_table(load_run(made.folder))
    assert {row[0]: row[-1] for row in table.rows}["vq"] == "−1.00 (−1.00 to −1.00)"
    assert any(note.endswith("On fewer than 3 surfaces nothing is told apart.") for note in table.notes)
    for label, psnr in (("pca", 29.0), ("vq", 28.5), ("neubtf-direct", 29.5)):
        made.job(label, material="wool", psnr=psnr)
    table = summary_table(load_run(made.folder))
    against = {row[0]: row[-1] for row in table.rows}
    assert (against["neubtf-direct"], against["vq"]) == ("—", "−1.00 (−1.00 to −1.00) *")
    assert not against["pca"].endswith("*")
    (note,) = (note for note in table.notes if note.startswith("Against neubtf-direct: the mean paired difference"))
    assert "1 of 2 told apart (*), by Holm's correction over the rows" in note


def test_one_codec_timed_again_leaves_the_times_of_the_others_and_has_a_star(made):
    for name in ("pca", "vq", "mine"):
        made.job(name).timing(name, run="0")
    made.timing("mine", run="1")
    run = load_run(made.folder)
    table = summary_table(run)
    times = {row[0]: row[[name for name, _ in table.headers].index("time")] for row in table.rows}
    assert {name for name, time in times.items() if time.endswith("*")} == {"mine"}
    assert "—" not in times.values()
    assert table.notes[-1] == "Times with a star: mine on satin (timed in another start than the other rows)."
    (speed,) = (plot for plot in plots_of(run) if plot["kind"] == "speed")
    assert len(speed["series"]) == 3
