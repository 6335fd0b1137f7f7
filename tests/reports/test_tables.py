import re

import pytest

from bench.records import OUTSIDE, SCENE_HELDOUT, load_run
from reports import table_text
from reports.rows import materials
from reports.table import BOLD
from reports.tables import all_tables

STATS = {"mean": 31.0, "std": 1.0, "pooled": 31.5, "exact": 0, "slices": 4}


def tables(made, kind):
    return [table for table in all_tables(load_run(made.folder)) if table.kind == kind]


def cells(table, row=0):
    """Cells by header; where two headers read alike, the unit tells them apart. It leaves out “± …”."""
    names = (f"{name} {unit}".partition("±")[0].strip() for name, unit in table.headers)
    return dict(zip(names, table.rows[row], strict=True))


def test_the_main_table_shows_the_numbers_of_the_record(made):
    (table,) = tables(made.job().timing(), "main")
    shown = cells(table)
    assert (shown["codec"], shown["total bytes ↓"]) == ("pca components=8", "36,110")
    assert (shown["decoder bytes"], shown["texture bytes"], shown["other bytes"]) == ("1,200", "34,567", "343")
    assert shown["bits per texel ↓"] == "4,514"  # 8 · 36110 / 64
    assert (shown["decoder param."], shown["PSNR pooled dB ↑"]) == ("3,011", "30.00")
    assert shown["SSIM ↑"] == "0.750 ± 0.125"
    assert (shown["time ns ↓"], shown["95 % interval ns"], shown["time × floor ↓"]) == ("123", "120 to 130", "1.75")
    assert table.title == "satin (8 × 8 texels, 8 training pairs, 4 held out)"


def test_a_codec_that_answers_texels_has_its_time_at_one_of_them(made):
    made.start().job("ntc").timing("ntc", ratio_to_floor=44.0, ratio_at_one_texel=12.5).job("pca").timing("pca")
    (table,) = tables(made, "main")
    (note,) = (note for note in table.notes if "one texel" in note)
    assert re.match(r"ntc .*12\.5", note)


def test_failed_jobs_stay_in_their_material_and_give_a_reason(made):
    made.job().job("vq", material="brick").unfinished("failed", "ValueError: no\nmore")
    (main, _), (why,) = tables(made, "main"), tables(made, "unfinished")
    assert main.rows[1][:3] == ["vq", "failed", "—"]
    assert why.rows == [["satin", "vq", "failed", "ValueError: no more"]]


def test_rows_that_measure_something_else_are_not_compared(made):
    made.job("metric", run="0", metrics={"psnr_display": 2}).job("exposure", run="0", exposure=2.0)
    made.job("data", run="0", btf="g").job("pairs", run="0", deciding="d").job("new", run="1")
    (table,) = tables(made, "main")
    reasons = "version 2", "exposure", "other data", "held-out pairs"
    for row, reason in zip(table.rows[1:], reasons, strict=True):
        assert set(row[1:]) == {"n/c"}
        assert any(note.startswith(f"n/c: {row[0]} ") and reason in note for note in table.notes)
    assert table.rows[0][0] == "new"
    assert "n/c" not in table.rows[0]


def test_times_of_other_conditions_are_not_compared_and_those_of_other_runs_are_marked(made):
    for label in ("a", "b", "c"):
        made.job(label)
    made.timing("a", run="2").timing("b", run="2", threads=1).timing("c", run="1")
    (table,) = tables(made, "main")
    times = [cells(table, row)["time ns ↓"] for row in range(3)]
    assert times[0] == "123"
    assert "n/c" in times
    assert "123*" in times


def test_seeds_are_one_row_mean_and_deviation_where_they_differ(made):
    made.job("vq", psnr=30.0).job("vq", seed=1, psnr=31.0).job("table", psnr=100.0).job("table", seed=1, psnr=100.0)
    made.job("pca").job("pca", seed=1).timing("pca").job("half", psnr=100.0).job("half", seed=1, psnr=28.0)
    (table,) = tables(made, "main")
    rows = {row[0]: cells(table, i) for i, row in enumerate(table.rows)}
    assert [row[0] for row in table.rows] == ["table", "half", "vq", "pca"]  # an exact slice is 48.13 dB
    assert rows["vq"]["PSNR pooled dB ↑"] == "30.50 ± 0.71"
    assert rows["vq"]["PSNR dB ↑"] == "30.50 ± 0.71"  # over seeds, as the pooled one
    assert rows["vq"]["total bytes ↓"] == rows["pca"]["total bytes ↓"] == "36,110"
    assert (rows["table"]["PSNR pooled dB ↑"], rows["pca"]["PSNR pooled dB ↑"]) == ("exact", "30.00")
    assert rows["pca"]["time ns ↓"] == "123"
    assert rows["half"]["PSNR dB ↑"] == rows["half"]["PSNR pooled dB ↑"] == "38.06 ± 14.23"  # of 48.13 and 28
    assert any(note.startswith("Seeds 0, 1") for note in table.notes)


def test_pairs_that_are_drawn_anew_for_each_seed_are_no_obstacle_but_older_ones_of_a_seed_are(made):
    for label in ("a", "b"):
        made.job(label, seed=0, btf="f0").job(label, seed=1, btf="f1")
    made.job("old", seed=0, btf="f0", run="0").job("old", seed=1, btf="f9", run="0")
    (table,) = tables(made, "main")
    assert {row[0]: row[1] for row in table.rows} == {"a": "3,011", "b": "3,011", "old": "3,011"}
    assert any(note.startswith("1 of 2") and "old" in note for note in table.notes)
    assert any(note.startswith("n/c: old seed=1 ") and "other data" in note for note in table.notes)


def test_the_best_of_a_column_is_bold_and_the_second_underlined(made):
    made.job("a", psnr=30.0).job("b", psnr=31.0).job("c", psnr=100.0).job("d", psnr=30.0, run="0", exposure=9.0)
    (table,) = tables(made, "main")
    column = [name for name, _ in table.headers].index("PSNR pooled")
    assert {row: mark for (row, at), mark in table.marks.items() if at == column} == {0: "bold", 1: "underlined"}
    assert not any(table.headers[at][0] == "texture" for _, at in table.marks)  # no end of it is better
    assert not any(table.headers[at][0] == "total" for _, at in table.marks)  # all are alike
    shown = {"markdown": ("**exact**", "<ins>31.00</ins>"), "latex": (r"\textbf{exact}", r"\underline{31.00}")}
    for name, marked in shown.items():
        assert all(words in table_text(made.folder, name, "main") for words in marked)
    text = table_text(made.folder, "text", "main")
    assert "<" not in text
    assert "•exact" in text
    assert "•:" in text


def test_an_unknown_format_is_refused(made):
    with pytest.raises(ValueError, match="'word'"):
        table_text(made.folder, "word")


def in_scene(held, frames, outside=20.0):
    """The fields of a job that was scored in a scene: PSNR at held-out pairs in it, of its frames, and outside it."""
    group, other = (
        {"slices": 4, "radiance": 0.1, "metrics": {"psnr_display": STATS | {"mean": mean}}} for mean in (held, outside)
    )
    says = {"name": "wall", "frames": [2, 30, 40], "queries": 9, "exposure": 1.0, "metrics": {"psnr_display": frames}}
    scores = {"heldout": other, "all": other, "scene": group, SCENE_HELDOUT: group, OUTSIDE: other}
    return {"scene": says, "scores": scores}


def of_scene(made, size=400, **scores):
    """A model of the scene, beside the whole one of the same settings."""
    sizes = {"decoder": 0, "texture": 0, "other": 0}
    made.job("pca", settings={"components": 8}, bytes=sizes | {"total": 8000}, **in_scene(30.0, 20.0))
    fitted = {"components": 8, "scene": True}
    return made.job("pca scene", codec="pca", settings=fitted, bytes=sizes | {"total": size}, **scores)


def test_what_a_model_of_a_scene_saves_and_gains_stands_in_one_line(made):
    of_scene(made, **in_scene(33.2, 29.5))
    (table,) = tables(made, "scene")
    shown = [(row[0], cells(table, i)["held out in the scene dB ↑"]) for i, row in enumerate(table.rows)]
    assert shown == [("pca scene", "33.20"), ("pca", "30.00")]
    (note,) = (note for note in table.notes if note.startswith("pca scene:"))
    assert re.search(r" 400 .* 8,000 .*5%.* \+3\.20 dB .* \+9\.50 dB ", note)


def test_models_of_a_scene_stand_last_without_marks_but_in_the_table_of_the_scene(made):
    of_scene(made, **in_scene(33.2, 29.5, outside=40.0)).job("vq", **in_scene(29.0, 19.0, outside=25.0))
    (main,) = tables(made, "main")
    assert [row[0] for row in main.rows] == ["vq", "pca", "pca scene"]
    assert {row for row, _ in main.marks} == {0, 1}
    assert any("stand last" in note for note in main.notes)
    (scene,) = tables(made, "scene")
    assert [row[0] for row in scene.rows] == ["pca scene", "pca", "vq"]
    best = {scene.headers[at][0] for (row, at), mark in scene.marks.items() if row == 0 and mark == BOLD}
    assert best == {"total", "held out in the scene", "frames PSNR"}
    assert not any("stand last" in note for note in scene.notes)


def test_models_of_a_scene_have_no_rank_and_change_that_of_no_other(made):
    of_scene(made, **in_scene(33.2, 29.5, outside=40.0)).job("vq", **in_scene(29.0, 19.0, outside=25.0))
    (table,) = tables(made, "summary")
    ranks = [(row[0], cells(table, i)["mean rank ↓"], cells(table, i)["PSNR dB ↑"]) for i, row in enumerate(table.rows)]
    assert ranks == [("vq", "1.0", "25.00"), ("pca", "2.0", "20.00"), ("pca scene", "—", "—")]
    assert any("stand last" in note for note in table.notes)
    assert not any("Without means" in note for note in table.notes)


def test_a_run_of_one_view_says_so(made):
    (one,) = materials(load_run(made.job(views=1).folder))
    assert one.split_in_words.rpartition("; ")[2].startswith("one view")
    (two,) = materials(load_run(made.job(views=2).folder))
    assert "view" not in two.split_in_words


def test_pairs_of_low_light_are_the_last_band_where_a_record_has_them(made):
    group = {"slices": 4, "radiance": 0.1, "metrics": {"psnr_display": STATS}}
    scores = dict.fromkeys(("all", "train", "heldout", "heldout, grazing light"), group)
    (plain,) = tables(made.job(scores=scores), "angular")
    assert not any("75°" in header for header in cells(plain))
    scores["low light"] = group | {"slices": 30, "metrics": {"psnr_display": STATS | {"mean": 12.5}}}
    (table,) = tables(made.job(scores=scores), "angular")
    assert list(cells(table).items())[-1] == ("low light dB ↑ (30)", "12.50")


def test_quality_between_texels_is_the_last_column_by_footprint_where_a_record_has_it(made):
    (plain,) = tables(made.job(), "footprints")
    assert not any("between" in header for header in cells(plain))
    (table,) = tables(made.job(between={"mean": 21.5, "centres": 30.0, "slices": 20}), "footprints")
    assert list(cells(table).items())[-1] == ("between texels dB ↑", "21.50")


def test_a_run_judged_by_a_scene_has_a_table_of_it(made):
    says = {"name": "wall", "frames": [2, 30, 40], "queries": 9, "exposure": 1.0}
    says["metrics"] = {"psnr_display": 28.125, "psnr_log1p": 27.0, "ssim": None, "flip_ldr_67ppd": 0.0625}
    group = {"slices": 4, "radiance": 0.1, "metrics": {"psnr_display": STATS}}
    scores = {"heldout": group, "all": group, "scene": group}
    key = {"btf": "f", "exposure": 1.5, "sha256": "0", "metrics": {}, "demand": "a"}
    made.job(scene=says, scores=scores, score_key=key)
    made.job("vq", scene=says, scores=scores, score_key=key | {"demand": "b"}, run="0")
    (table,) = tables(made, "scene")
    assert "wall" in table.title
    shown = cells(table)
    assert (shown["frames PSNR dB ↑"], shown["frames SSIM ↑"], shown["frames FLIP ↓"]) == ("28.12", "n/a", "0.062")
    assert (shown["weighted PSNR dB ↑"], shown["outside PSNR dB ↑"]) == ("31.50", "—")
    assert cells(table, 1)["frames PSNR dB ↑"] == "n/c"
    assert any("another demand" in note for note in table.notes)


def test_the_note_on_a_marched_height_says_of_what_a_file_stores_none(made):
    for label, latents in (("relief", 14), ("relief latents=13", 13)):  # the made record has 14 channels
        made.job(label, settings={"relief": True, "latents": latents}).timing(label)
    made.job("mine", settings={"relief": True}).timing("mine")  # a setting of that name of another codec
    (table,) = tables(made, "main")
    notes = dict(note.split(": ", 1) for note in table.notes if note.startswith("relief"))
    assert "stores no height" in notes["relief"]
    assert "stores a height" in notes["relief latents=13"]


def test_black_has_a_row_where_a_material_is_badly_exposed(made):
    """It scores above a codec there, and is neither ranked nor marked."""
    made.job("pca", psnr=30.0, black=41.0)
    (table,) = [table for table in all_tables(load_run(made.folder)) if table.kind == "main"]
    psnr = [name for name, _ in table.headers].index("PSNR")
    assert [row[0] for row in table.rows] == ["pca", "black"]
    assert table.rows[1][psnr] == "41.00"
    assert set(table.rows[1][1:psnr]) == {"—"}
