import itertools
import math
import tomllib
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest

from bench.records import load_run
from reports.styles import COLOURS, KNOWN, MARKERS, OWN, Styles


def test_a_codec_looks_the_same_in_every_run_and_material(made):
    made.job("vq").job("mine", material="brick").job("pca components=8").job("pca components=16")
    styles = Styles(load_run(made.folder).jobs)
    assert styles.of_codec("vq") == Styles(load_run(made.job("other").folder).jobs).of_codec("vq")
    one, two = styles.of_codec("pca components=8"), styles.of_codec("pca components=16")
    assert (one["color"], one["marker"]) == (two["color"], two["marker"])
    assert (one["linestyle"], one["markerfacecolor"]) != (two["linestyle"], two["markerfacecolor"])
    assert styles.of_codec("mine")["color"] not in {styles.of_codec(name)["color"] for name in KNOWN}
    assert styles.of_codec("mine")["zorder"] > styles.of_codec("pca")["zorder"]
    assert styles.of_codec("pca") == styles.of_codec("pca components=8")  # a ladder of rates styles as its codec does


def test_no_two_of_the_codecs_look_alike(made):
    for i in range(40):
        made.job(f"outside{i}")
    styles = Styles(load_run(made.folder).jobs)
    names = [*KNOWN, *(f"outside{i}" for i in range(40))]
    looks = map(styles.of_codec, names)
    assert len({(look["color"], look["marker"]) for look in looks}) == len(names)  # lines tell settings apart
    assert len({styles.of_codec(name)["color"] for name in KNOWN}) == len(KNOWN)
    project = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert set(project["entry-points"]["neubtf_bench.codecs"]) <= set(KNOWN)


def linear(colour):
    return np.array([(int(colour[i : i + 2], 16) / 255 + 0.055) / 1.055 for i in (1, 3, 5)]) ** 2.4


def test_every_codec_has_a_colour_of_its_own():
    """CIELAB of CIE 15 under D65, where 2 is what an eye notices side by side."""
    white, to_xyz = [0.9505, 1, 1.089], [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
    x, y, z = np.cbrt([to_xyz @ linear(colour) / white for colour in (*COLOURS, *OWN)]).T
    places = zip(116 * y - 16, 500 * (x - y), 200 * (y - z), strict=True)
    assert len(COLOURS) == len(KNOWN)
    assert min(math.dist(*two) for two in itertools.combinations(places, 2)) > 20


@pytest.mark.parametrize("paper", ["#ffffff", "#16181c"])
def test_every_colour_is_seen_on_light_and_on_dark_paper(paper):
    """The contrast that WCAG 2.1 asks of graphics."""
    css = (files("reports") / "web/report.css").read_text()
    assert f"--paper: {paper};" in css.replace("#fff;", "#ffffff;")
    for colour in (*COLOURS, *OWN):
        light, dark = sorted(([0.2126, 0.7152, 0.0722] @ linear(each) + 0.05 for each in (colour, paper)), reverse=True)
        assert light / dark >= 3, colour


def test_markers_tell_apart_what_colours_do_not():
    """Distances of the colours as a viewer without one kind of cone sees them (Viénot, Brettel, Mollon, 1999)."""
    mixed = {"protan": lambda r, g, b: (0.11 * r + 0.89 * g, b), "deutan": lambda r, g, b: (0.29 * r + 0.71 * g, b)}
    looks = [(linear(colour), MARKERS[place % len(MARKERS)]) for place, colour in enumerate(COLOURS)]
    for see in mixed.values():
        for (one, marker), (other, another) in itertools.combinations(looks, 2):
            near = sum(abs(a - b) for a, b in zip(see(*one), see(*other), strict=True)) <= 0.1
            assert not near or marker != another
