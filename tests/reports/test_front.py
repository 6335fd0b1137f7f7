import re

import pytest

from bench.records import load_run
from reports import figures, table_text
from reports.front import TABLES

SIZE = 8 * 8 // 8  # bytes of one bit a texel


@pytest.fixture
def ladder(made):
    def job(label, material, size, validation, psnr):
        known = made._group(psnr)
        scores = {"heldout": known, "train": known}
        if validation:
            scores["validation"] = made._group(validation)
        settings = {"label": label} | ({"recipe": "paper"} if "recipe=paper" in label else {})
        more = {"bytes": {"total": size * SIZE}, "scores": scores, "settings": settings, "fit_seconds": 0.0}
        made.job(label, material, psnr=psnr, **more)

    for material, more in (("satin", 0.0), ("brick", 1.0)):  # measured, since nothing says that they were rendered
        job("pca components=2", material, 16, 25.0, 24.0 + more)
        job("pca components=4", material, 33, 26.0, 25.0 + more)
        job("relief bits=2", material, 30, 28.0, 29.0 + more)
        job("relief", material, 50, 30.0, 31.0 + 2 * more)
        job("relief recipe=paper", material, 60, 27.0, 26.0 + more)
    job("vq", "satin", 20, None, 40.0)
    return made.folder


GOLDEN = """\
Budgets on 2 measured surfaces (satin, brick): test PSNR, dB

codec                   4 bits    8 bits  16 bits  32 bits  64 bits  128 bits
                      0.032 kB  0.064 kB  0.13 kB  0.26 kB  0.51 kB    1.0 kB
--------------------  --------  --------  -------  -------  -------  --------
relief                       —         —        —   •≥29.5   •≥32.0    •≥32.0
pca                          —         —    ≥24.5    ≥24.5    ≥25.5     ≥25.5
relief, as published         —         —        —        —    ≥26.5     ≥26.5
"""


def test_the_headline_is_a_row_a_codec_and_a_column_a_budget(ladder):
    text = table_text(ladder, kind="budgets")
    assert text[: len(GOLDEN)] == GOLDEN
    assert "1 of made" in text
    assert "≥:" in text


def test_with_three_rungs_a_size_is_read_off_the_curve_and_the_front_has_the_lead_at_equal_bytes(made):
    def job(label, bits, psnr):
        scores = {"heldout": made._group(psnr), "validation": made._group(psnr)}
        made.job(label, bytes={"total": bits * SIZE}, scores=scores, psnr=psnr, settings={"label": label})

    for rung, bits in enumerate((8, 24, 96)):
        job(f"neubtf-direct x={rung}", bits, 20.0 + 6.0 * rung)  # 6 dB a factor of 3 or 4
        job(f"neumip x={rung}", bits, 21.0 + 6.0 * rung)
    job("pca", 24, 28.0)
    (table,) = TABLES["budgets"](load_run(made.folder))
    at = {row[0]: dict(zip((name for name, _ in table.headers[1:]), row[1:], strict=True)) for row in table.rows}
    assert at["neubtf-direct"]["4 bits"] == "—"  # nothing is extrapolated
    assert at["neubtf-direct"]["8 bits"] == "20.0"
    assert at["neubtf-direct"]["16 bits"] == "23.8"  # 20 + 6 log(2) / log(3), not the 20 of the rung within it
    assert at["neubtf-direct"]["128 bits"] == "—"
    assert (at["pca"]["16 bits"], at["pca"]["32 bits"]) == ("—", "≥28.0")
    (front,) = TABLES["front"](load_run(made.folder))
    lead = front.headers.index(("lead", "dB ↑"))
    assert {row[0]: row[lead] for row in front.rows} == {"neubtf-direct": "", "neumip": "+1.0", "pca": "+2.0°"}
    assert any("10 surfaces" in note for note in front.notes)


def test_no_best_is_marked_at_a_size_where_a_codec_whose_curve_ends_before_has_more(made):
    def job(label, bits, psnr):
        scores = {"heldout": made._group(psnr), "validation": made._group(psnr)}
        made.job(label, bytes={"total": bits * SIZE}, scores=scores, psnr=psnr, settings={"label": label})

    for rung, bits in enumerate((8, 16, 32)):
        job(f"relief x={rung}", bits, 30.0 + rung)
    for codec, at_first in (("neumip", 20.0), ("ntc", 19.0)):
        for rung, bits in enumerate((16, 32, 64)):
            job(f"{codec} x={rung}", bits, at_first + rung)
    (table,) = TABLES["budgets"](load_run(made.folder))
    names = [name for name, _ in table.headers]
    marked = {names[column] for (_, column), mark in table.marks.items() if mark == "bold"}
    assert {"16 bits", "32 bits"} <= marked
    assert "64 bits" not in marked
    assert any("No best" in note for note in table.notes)


def test_no_best_is_marked_where_a_codec_leads_on_the_surfaces_that_it_has(made):
    """Of relief, the first file on brick is of 64 bits: at 32 bits it has a value on two of three surfaces alone."""
    for material in ("satin", "wool", "brick"):
        for rung, bits in enumerate((16, 32, 64)):
            for label, own_bits, psnr in (
                ("relief", bits * (4 if material == "brick" else 1), 33.0),
                ("ntc", bits, 30.0),
            ):
                scores = {"heldout": made._group(psnr + rung), "validation": made._group(psnr + rung)}
                size = {"total": own_bits * SIZE}
                made.job(f"{label} x={rung}", material, bytes=size, scores=scores, psnr=psnr, settings={"x": rung})
    run = load_run(made.folder)
    (front,) = TABLES["front"](run)
    (budgets,) = TABLES["budgets"](run)
    (when,) = TABLES["when"](run)
    for table, column in ((front, "measured, 3"), (budgets, "32 bits")):
        place = [name for name, _ in table.headers].index(column)
        assert {row[0]: row[place] for row in table.rows} == {"relief": "—", "ntc": "31.0"}
        assert not any(marked == place for _, marked in table.marks)
        assert any("relief leads" in note for note in table.notes)
    asked = [row[0] for row in when.rows if "quality in" in row[0]]
    assert not any("32 bits" in question for question in asked)
    assert any("64 bits" in question for question in asked)
    assert any("No answer" in note and "16 bits" in note for note in when.notes)


def test_the_rungs_are_named_by_material(ladder):
    _, satin, _ = TABLES["rungs"](load_run(ladder))
    assert satin.material == "satin"
    assert satin.rows == [
        ["pca", "components=2", "16–32", "128", "25.00", "24.00", "0.750", "0.750"],
        ["pca", "components=4", "64–128", "264", "26.00", "25.00", "0.750", "0.750"],
        ["relief", "bits=2", "32", "240", "28.00", "29.00", "0.750", "0.750"],
        ["relief", "default", "64–128", "400", "30.00", "31.00", "0.750", "0.750"],
        ["relief, as published", "default", "64–128", "480", "27.00", "26.00", "0.750", "0.750"],
    ]


def test_ladders_that_differ_from_surface_to_surface_are_rows_of_their_own(made):
    def job(label, material, bits, seed=0):
        scores = {"heldout": made._group(30.0), "validation": made._group(30.0)}
        made.job(label, material, bytes={"total": bits * SIZE}, scores=scores, settings={"x": label}, seed=seed)

    for material in ("satin", "brick", "wool"):
        for label, bits in (("pca x=1", 8), ("pca x=2", 16)):
            job(label, material, bits)
        job("pca x=2", material, 18, seed=1)
        job("vq x=1", material, 8)
    job("vq x=2", "wool", 32)
    for material, bits in (("satin", 8), ("brick", 8), ("linen", 500)):  # the last is within no budget
        scores = {"heldout": made._group(30.0), "validation": made._group(30.0)}
        made.job("hsh", material, bytes={"total": bits * SIZE}, scores=scores, fit_seconds=0.0)
    ladders, *_ = TABLES["rungs"](load_run(made.folder))
    assert ladders.rows == [
        ["pca", "all 3", "2", "8.0, 17", "1, 2"],
        ["vq", "satin, brick", "1", "8.0", "1"],
        ["vq", "wool", "2", "8.0, 32", "1, 1"],
        ["hsh", "satin, brick, linen", "1", "8.0", "1"],
    ]


def test_each_kind_of_surface_has_a_table_and_all_together_have_one(made):
    rendered = {"renderer_version": 3}
    for material, provenance in (("wool", {}), ("rock", rendered | {"path_version": 1}), ("satin", rendered)):
        for label, psnr in (("pca", 25.0), ("neubtf-direct", 28.0)):
            scores = {"heldout": made._group(psnr), "validation": made._group(psnr)}
            size = {"total": 8 * SIZE}
            made.job(label, material, bytes=size, scores=scores, provenance=provenance, psnr=psnr, fit_seconds=0.0)
    tables = list(TABLES["budgets"](load_run(made.folder)))
    kinds = {"1 measured": "wool", "1 path-traced": "rock", "1 rendered": "satin", "3 surfaces": "wool, rock, satin"}
    for (kind, surfaces), table in zip(kinds.items(), tables, strict=True):
        assert f" {kind} " in table.title
        assert f"({surfaces})" in table.title
    assert tables[3].rows[1] == ["pca", "—", *["≥25.0"] * 5]
    (front,) = TABLES["front"](load_run(made.folder))
    assert [row[0] for row in front.rows] == ["neubtf-direct", "pca"]
    assert front.rows[1][1:] == [*["≥25.0"] * 3, "—", ""]


def test_times_that_tell_codecs_apart_on_three_surfaces_are_marked(made):
    for material in ("wool", "rock", "satin"):
        for label, psnr in (("pca", 25.0), ("neubtf-direct", 28.0)):
            scores = {"heldout": made._group(psnr), "validation": made._group(psnr)}
            made.job(label, material, bytes={"total": 8 * SIZE}, scores=scores, psnr=psnr, fit_seconds=0.0)
            made.timing(label, material, ratio_to_floor=3.5)
    (table,) = TABLES["budgets"](load_run(made.folder))
    (told,) = (note for note in table.notes if note.startswith("*:"))
    assert "neubtf-direct" in told
    column = table.headers.index(("4 × floor", "eager"))
    assert table.rows[1][column] == "25.0*"
    assert not any("Not timed" in note for note in table.notes)


def test_settings_that_were_not_timed_are_named(made):
    for label in ("pca components=1", "pca components=2"):
        scores = {"heldout": made._group(25.0), "validation": made._group(25.0)}
        made.job(label, "satin", bytes={"total": 8 * SIZE}, scores=scores, psnr=25.0)
    made.timing("pca components=1", "satin", ratio_to_floor=3.5)
    (table,) = TABLES["budgets"](load_run(made.folder))
    assert any(note.startswith("Not timed") and note.endswith(": pca components=2.") for note in table.notes)


def test_ranks_are_of_three_surfaces_and_name_who_is_not_told_apart(made):
    for material in ("wool", "rock", "satin"):
        for rank, label in enumerate(("pca", "vq", "neubtf-direct", "relief")):
            psnr = 25.0 + rank
            scores = {"heldout": made._group(psnr), "validation": made._group(psnr)}
            made.job(label, material, bytes={"total": 8 * SIZE}, scores=scores, psnr=psnr)
    (table,) = TABLES["ranks"](load_run(made.folder))
    ranks = {"relief": "1.00", "neubtf-direct": "2.00", "vq": "3.00", "pca": "4.00"}
    assert {row[0]: row[1] for row in table.rows} == ranks
    assert table.rows[0][2] == "neubtf-direct, vq"  # the critical difference of four codecs on three surfaces is 2.71
    (figure,) = figures.ALL["ranks"](load_run(made.folder))
    assert figure.name == "ranks.png"


def test_a_job_on_other_data_leaves_published_rows_in_their_table(run_maker, tmp_path):
    def measured(folder, label, run, size, **changes):
        maker = run_maker(tmp_path / folder).start(run, suite=folder)
        scores = {"heldout": maker._group(30.0), "validation": maker._group(30.0)}
        return maker.job(label, run=run, scores=scores, bytes={"total": size * SIZE}, **changes)

    measured("all", "pca", "1", 16)
    measured("all", "vq", "1", 16, psnr=29.0)
    published = tmp_path / "published.jsonl"
    published.write_bytes((tmp_path / "all" / "records.jsonl").read_bytes())
    for seed in (0, 7):  # of seed 7 the published rows have nothing
        name = f"own{seed}"
        own = measured(name, "mine", "2", 16, btf="other", seed=seed, shape=[16, 16])
        for sources in ([published, own.folder], [own.folder, published]):
            text = table_text(sources, kind="front")
            assert [line.split()[0] for line in text.splitlines() if "≥" in line][:2] == ["pca", "vq"]
            assert f"1 of {name} (satin/mine)" in text
    same = measured("same", "pca", "2", 16, btf="other", psnr=50.0).timing("pca", ratio_to_floor=9.0)
    for sources in ([published, same.folder], [same.folder, published]):
        text = table_text(sources, kind="front")
        assert next(line.split()[:3] for line in text.splitlines() if "≥" in line) == ["pca", "≥30.0", "—"]
        assert "9.00" not in text, "nor the time of the other"
        assert "1 of same (satin/pca)" in text
        assert re.search("n/c: pca .*other data", table_text(sources, kind="main"))
    assert "n/c: mine seed=7 " in table_text([published, own.folder], kind="main")


@pytest.mark.parametrize("kind", TABLES)
def test_a_run_that_was_fitted_to_a_scene_alone_has_no_such_table(made, kind):
    scores = {"heldout": made._group(30.0), "validation": made._group(30.0)}
    made.job("pca scene=true", scores=scores, settings={"scene": True})
    assert list(TABLES[kind](load_run(made.folder))) == []


def test_a_codec_that_lacks_a_surface_and_is_behind_hides_no_best(made):
    """relief has a curve on one of two surfaces, below that of ntc, whose best rung of vq is better than both."""
    for material in ("satin", "wool"):
        for rung, bits in enumerate((16, 32, 64)):
            for label, psnr in (("relief", 29.0), ("ntc", 30.0)):
                if (label, material) != ("relief", "wool"):
                    scores = {"heldout": made._group(psnr + rung), "validation": made._group(psnr + rung)}
                    size = {"total": bits * SIZE}
                    made.job(f"{label} x={rung}", material, bytes=size, scores=scores, psnr=psnr, settings={"x": rung})
    (front,) = TABLES["front"](load_run(made.folder))
    assert front.marks == {}  # one codec alone has a value, which is no distinction; relief hides nothing
    assert not any("No best" in note for note in front.notes)


def test_bytes_in_memory_have_curves_of_their_own(made):
    """Of equal files, the decoder that takes half as much memory has more at equal bytes there."""
    for rung, bits in enumerate((64, 256, 1024)):
        for codec, factor in (("neubtf-direct", 1), ("neumip", 0.5)):
            scores = {"heldout": made._group(30.0 + rung), "validation": made._group(30.0 + rung)}
            more = {
                "bytes": {"total": (rung + 4) * SIZE},
                "resident": int(factor * bits * SIZE),
                "settings": {"x": rung},
            }
            made.job(f"{codec} x={rung}", scores=scores, psnr=30.0, **more)
    *_, table = TABLES["curves"](load_run(made.folder))
    assert re.search("memory.* 256 bits", table.title)
    assert [row[:3] for row in table.rows] == [["neumip", "31.5", "+0.5"], ["neubtf-direct", "31.0", ""]]


def test_the_best_of_the_front_is_marked(ladder):
    (front,) = TABLES["front"](load_run(ladder))
    psnr = front.headers.index(("measured, 2", "dB ↑"))
    assert front.marks[0, psnr] == "bold"
    assert front.rows[0][psnr] == "≥29.5"
