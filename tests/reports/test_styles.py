import itertools
import tomllib
from pathlib import Path

from bench.records import load_run
from reports.styles import COLOURS, KNOWN, Styles


def look(styles, name):
    """What tells codecs of a figure apart: colour and marker. Lines, and hollow markers, tell settings apart."""
    style = styles.of_codec(name)
    return style["color"], style["marker"]


def test_a_codec_looks_the_same_in_every_run_and_material(made):
    made.job("vq").job("mine", material="brick").job("pca components=8").job("pca components=16")
    styles = Styles(load_run(made.folder))
    assert styles.of_codec("vq") == Styles(load_run(made.job("other").folder)).of_codec("vq")
    one, two = styles.of_codec("pca components=8"), styles.of_codec("pca components=16")
    assert (one["color"], one["marker"]) == (two["color"], two["marker"])
    assert (one["linestyle"], one["markerfacecolor"]) != (two["linestyle"], two["markerfacecolor"])
    assert look(styles, "mine") not in {look(styles, name) for name in KNOWN}
    assert styles.of_codec("pca") == styles.of_codec("pca components=8")  # a ladder of rates styles as its codec does


def test_no_two_of_the_codecs_look_alike(made):
    for i in range(40):
        made.job(f"outside{i}")
    styles = Styles(load_run(made.folder))
    names = [*KNOWN, *(f"outside{i}" for i in range(40))]
    assert len({look(styles, name) for name in names}) == len(names)
    compared = ("neubtf-direct", "neubtf", "neumip", "rainer2019", "relief", "pca")
    assert len({styles.of_codec(name)["color"] for name in compared}) == len(compared)


def test_every_codec_that_is_installed_here_has_a_look_of_its_own_in_every_run():
    with (Path(__file__).parents[2] / "pyproject.toml").open("rb") as file:
        assert set(tomllib.load(file)["project"]["entry-points"]["neubtf_bench.codecs"]) <= set(KNOWN)


def test_the_palette_is_told_apart_without_red_green_or_blue():
    """Distances of the colours as a viewer without one kind of cone sees them (Viénot, Brettel, Mollon, 1999)."""
    rgb = [[(int(colour[i : i + 2], 16) / 255) ** 2.2 for i in (1, 3, 5)] for colour in COLOURS]
    mixed = {
        "protan": lambda r, g, b: (0.11 * r + 0.89 * g, b),
        "deutan": lambda r, g, b: (0.29 * r + 0.71 * g, b),
    }
    for see in mixed.values():
        for one, other in itertools.combinations(rgb, 2):
            assert sum(abs(a - b) for a, b in zip(see(*one), see(*other), strict=True)) > 0.1
