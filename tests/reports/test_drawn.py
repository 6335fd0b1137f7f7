"""One figure for a paper: chosen rows, new names, a width, chosen pairs with insets."""

import io
import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from bench import cli
from bench.inputs.errors import InputError
from bench.records import load_run
from reports.drawn import KINDS, WHY_EMPTY
from reports.figures.pairs import FRAME, Inset, _with_inset, _worst_square, framed, pairs_figure


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    out = tmp_path_factory.mktemp("drawn") / "run"
    size = [word for key in ("size=12", "views=4", "lights=4", "heldout=6") for word in ("--set", f"data.{key}")]
    chosen = ["--material", "satin", "--codec", "pca", "--codec", "mean-colour", "--set", "pca.components=2"]
    assert cli.main(["run", "quick", "--out", str(out), *chosen, *size]) == 0
    return out


def drawn(folder, *words, out="figure.svg"):
    path = folder.parent / out
    assert cli.main(["figure", *words[:1], str(folder), "-o", str(path), *words[1:]]) == 0
    return path


@pytest.mark.long
def test_a_users_settings_of_matplotlib_reach_no_figure_and_no_report(folder, users_settings):
    def report_and_figures():
        assert cli.main(["report", str(folder)]) == 0
        figures = folder / "figures"
        found = {path.name: path.read_bytes() for path in [*figures.iterdir(), folder / "report.html"]}
        for kind in ("pairs", "rate"):
            for width in ([], ["--width", "8"]):
                for end in ("png", "pdf"):
                    found[kind, *width, end] = drawn(folder, kind, *width, out=f"a.{end}").read_bytes()
        return found

    plain = report_and_figures()
    with users_settings():
        again = report_and_figures()
    assert [name for name, content in plain.items() if again[name] != content] == []


def texts(svg):
    return re.findall(r"<!-- (.*?) -->", svg.read_text(encoding="utf-8"))


@pytest.mark.long
def test_a_figure_has_the_chosen_rows_under_their_new_names(folder):
    found = texts(drawn(folder, "pairs", "--codec", "pca", "--name", "pca=Linear"))
    assert "truth" in found
    assert any(text.startswith("Linear") for text in found)
    assert not any("pca" in text or "mean-colour" in text for text in found)
    found = texts(drawn(folder, "rate", "--name", "mean-colour=Mean"))
    assert "Mean" in found


@pytest.mark.long
def test_the_width_on_paper_is_what_was_asked_for(folder):
    for kind in ("pairs", "contact", "rate"):
        text = drawn(folder, kind, "--width", "8.5").read_text(encoding="utf-8")
        width = float(re.search(r'<svg[^>]* width="([\d.]+)pt"', text)[1])
        assert width == pytest.approx(8.5 / 2.54 * 72, abs=0.01)
    sizes = []
    for words in ([], ["--width", "4"]):
        with Image.open(drawn(folder, "pairs", *words, out="picture.png")) as picture:
            sizes.append(picture.size)
    assert sizes[0] == sizes[1]  # no pixel is lost
    assert drawn(folder, "pairs", out="a.pdf").read_bytes().startswith(b"%PDF")
    assert cli.main(["figure", "rate", str(folder), "-o", str(folder / "a.png"), "--width", "2"]) == 2


def test_pairs_are_chosen_by_their_index_and_others_are_listed(folder, capsys):
    run = load_run(folder)
    stored = np.load(folder / next(iter(run.jobs))["pictures"])["pairs"].tolist()
    one = Image.open(io.BytesIO(pairs_figure(run, "satin", stored[:1]).png))
    two = Image.open(io.BytesIO(pairs_figure(run, "satin", stored[:2]).png))
    assert two.size[1] - one.size[1] > 2 * 256  # a block has a slice and a FLIP map
    with pytest.raises(InputError, match=rf"pair 0 .* {stored[0]} "):
        pairs_figure(run, "satin", [0])
    for inset in (Inset(-1, 0, 4), Inset(10, 0, 4), Inset(0, 0, 1)):
        with pytest.raises(InputError, match="12 × 12"):
            pairs_figure(run, "satin", [], inset)
    for words, says in (
        (["pairs", "--inset", "1,2"], "ROW,COL,SIDE"),
        (["rate", "--pair", "3"], "figure pairs"),
        (["rat"], "'rate'"),
        (["rate", "--width", "0"], "200 cm"),
        (["pairs", "--codec", "pcb"], "'pca'"),
    ):
        assert cli.main(["figure", words[0], str(folder), "-o", "figure.png", *words[1:]]) == 2
        assert says in capsys.readouterr().err
    assert cli.main(["figure", "rate", str(folder), "-o", "figure.gif"]) == 2
    assert not Path("figure.png").exists()


def test_an_inset_shows_its_texels_in_a_frame(folder):
    run = load_run(folder)
    picture = np.asarray(Image.open(io.BytesIO(pairs_figure(run, "satin", [], Inset(2, 3, 4)).png)))
    marked = (picture == FRAME).all(2)
    assert marked.any()
    plain = np.zeros((20, 20, 3), np.uint8)
    framed(plain, 5, 6, 8)
    rows, cols = np.nonzero((plain == FRAME).all(2))
    assert (rows.min(), rows.max(), cols.min(), cols.max()) == (5, 12, 6, 13)
    assert not plain[8:10, 9:11].any()


def test_a_picture_one_texel_wide_has_no_inset():
    assert _worst_square([], 0, (1, 8)) is None
    assert _with_inset(np.zeros((1, 8, 3), np.uint8), None, 4).shape == (4, 32, 3)


def test_codecs_of_other_pairs_stand_beside_no_truth_of_the_first_and_are_named(made):
    run = load_run(made.job("one").folder)
    alone = np.asarray(Image.open(io.BytesIO(pairs_figure(run, "satin", []).png)))
    run = load_run(made.job("two").folder)
    path = run.folder / run.jobs[1]["pictures"]
    pictures = dict(np.load(path))
    for other in ({"pairs": pictures["pairs"] + 1}, {name: array[:1] for name, array in pictures.items()}):
        np.savez(path, **pictures | other)
        both = np.asarray(Image.open(io.BytesIO(pairs_figure(run, "satin", []).png)))
        np.testing.assert_array_equal(both[: len(alone)], alone)
        assert (both[len(alone) :] < 128).any(), "the words that name the codec"


def test_what_cannot_be_drawn_says_what_is_missing(made, capsys):
    run = made.unfinished("failed", "Error: no").folder
    assert {*WHY_EMPTY} == {*KINDS}
    for kind in KINDS:
        assert cli.main(["figure", kind, str(run), "-o", str(run / "figure.png")]) == 4
        assert WHY_EMPTY[kind] in capsys.readouterr().err, kind
    made.job("pca")
    assert cli.main(["figure", "fronts", str(run), "-o", str(run / "figure.png")]) == 4
    assert "validation" in capsys.readouterr().err
