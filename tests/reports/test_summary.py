import json

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
    assert {at: mark for at, mark in table.marks.items() if at[1] == column} == {
        (0, column): "bold",
        (1, column): "underlined",
    }
    assert not any(row == 3 for row, _ in table.marks)  # vq is not in the race
    assert "Summary over 2 materials: satin, brick" in table_text(made.folder)


def test_a_codec_without_error_ranks_first_and_one_alone_has_no_summary(made):
    assert summary_table(load_run(made.job("table", psnr=100.0).folder)) is None
    table = summary_table(load_run(made.job("pca").folder))
    assert [row[:5] for row in table.rows] == [
        ["table", "1 of 1", "1.0", "1", "exact"],
        ["pca", "1 of 1", "2.0", "0", "30.00"],
    ]


def test_the_summary_comes_first_in_every_report(made):
    made.job("pca").job("vq", psnr=28.0)
    text = table_text(made.folder, "markdown")
    assert text.startswith("### Summary over 1 material: satin")
    assert "as papers report it" in text


def test_papers_report_mean_and_deviation_over_slices(made):
    text = table_text(made.job("pca").job("vq", psnr=28.0).folder, "markdown", "slices")
    assert "| pca" in text
    assert "**30.00 ± 1.50**" in text
    assert "0.750 ± 0.125" in text


def test_times_have_a_column_fused(made):
    made.job("pca").timing("pca").job("vq", psnr=28.5).timing("vq")
    table = summary_table(load_run(made.folder))
    assert [head for head in table.headers if head[1] == "× floor ↓"] == [("time", "× floor ↓")]
    made.trade("pca")
    trade = json.loads((made.folder / "trade.json").read_text())
    fused = trade["choices"][0] | {"execution": "fused", "job": "satin/pca/0", "ratio_to_floor": 0.5}
    trade["choices"].append(fused)
    (made.folder / "trade.json").write_text(json.dumps(trade))
    table = summary_table(load_run(made.folder))
    column = [name for name, _ in table.headers].index("fused")
    assert [row[column] for row in table.rows] == ["0.500", "—"]


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


def test_on_one_material_the_interval_is_of_its_pairs_and_tells_nothing_apart(made):
    for seed in (0, 1):
        made.job("pca", seed=seed).job("vq", seed=seed, psnr=28.5)
    table = summary_table(load_run(made.folder))
    assert table.rows[1][-1] == "−1.50 (−1.50 to −1.50)"
    assert any("by a bootstrap over seeds and pairs." in note for note in table.notes)


def test_published_records_whose_exposure_is_rounded_stand_beside_a_new_run(made):
    made.job("pca", exposure=1.525512, run="0").job("mine", psnr=28.0, exposure=1.5255121042830542)
    table = summary_table(load_run(made.folder))
    assert [row[0] for row in table.rows] == ["pca", "mine"]
    assert not any("left out" in note for note in table.notes)


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


def test_a_summary_says_what_it_leaves_out_and_why(made):
    for material in ("satin", "brick"):
        made.job("pca", material=material).job("mine", material=material)
        made.job("old", material=material, psnr=40.0, run="0", exposure=9.0)
    made.job("older", psnr=41.0, run="0", btf="g")
    table = summary_table(load_run(made.folder))
    assert [row[0] for row in table.rows] == ["pca", "mine"]
    assert table.notes[-1] == (
        "Left out, as not comparable with the newest job: old on brick, satin (another exposure); older on satin "
        "(other data (their fingerprint differs))."
    )


def test_times_say_where_a_file_holds_a_height(made):
    settings = {"relief": True, "latents": 14}
    for material, channels in (("brick", 15), ("satin", 14), ("rock", 15)):
        made.job("relief", material, settings=settings, cost={"texture_channels": channels}).timing("relief", material)
        made.job("vq", material, settings={"latents": 13}).timing("vq", material)
    made.job("relief seed", "satin", settings=settings)  # not timed
    (note,) = [note for note in summary_table(load_run(made.folder)).notes if "height" in note]
    end = "; rays are marched through a height, which takes time."
    assert note == f"relief: its file stores a height on brick, rock; none on satin{end}"
    assert f"relief: its file stores a height on brick{end}" in table_text(made.folder, "markdown", "main")
