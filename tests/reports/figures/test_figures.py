import io

import numpy as np
import pytest
from PIL import Image

from bench.records import load_run
from reports import figures
from reports.artefacts import arrays
from reports.figures import contact


def drawn(made, draw):
    return {figure.name: np.asarray(Image.open(io.BytesIO(figure.png)).convert("RGB")) for figure in draw(made)}


def run_of(made):
    return load_run(made.folder)


def test_a_contact_sheet_has_a_cell_for_every_slice_of_every_codec(made):
    made.job("one").job("two")
    sheet = drawn(run_of(made), figures.contact_sheets)["contact-satin.png"]
    side, gap = 128, contact._GAP  # slices of 8 × 8 are enlarged 16 times
    height = contact._TOP + 3 * (side + gap) + contact._BOTTOM
    width = contact._LEFT + 3 * (2 * side + 2 * gap)
    assert sheet.shape == (height, width, 3)


def test_a_contact_sheet_shows_every_texel_as_it_is_stored(made):
    run = run_of(made.job())
    sheet = drawn(run, figures.contact_sheets)["contact-satin.png"]
    truth = arrays(run.folder, run.jobs[0], "pictures")["truth"][0]
    cell = sheet[contact._TOP : contact._TOP + 128, contact._LEFT : contact._LEFT + 128]
    np.testing.assert_array_equal(cell[8::16, 8::16], truth)


@pytest.mark.parametrize("draw", figures.ALL)
def test_twelve_codecs_fit_any_figure(made, draw):
    for i in range(12):
        made.job(f"codec{i} setting={i}", psnr=20.0 + i).timing(f"codec{i} setting={i}", ns_per_sample=100.0 * (i + 1))
    made.trade(*(f"codec{i} setting={i}" for i in range(12)))
    (picture,) = drawn(run_of(made), draw).values()
    assert max(picture.shape) < 2600


@pytest.mark.parametrize("draw", figures.ALL)
def test_odd_labels_are_drawn(made, draw):
    labels = ("_hidden $x^2$", "编码", "a" * 200, "%d {0}")
    for label in labels:
        made.job(label, material="50 % $m_1$").timing(label, material="50 % $m_1$")
    made.trade(*labels, material="50 % $m_1$")
    assert len(drawn(run_of(made), draw)) == 1


@pytest.mark.parametrize("draw", figures.ALL)
def test_exact_codecs_stop_no_figure(made, draw):
    made.job("table", psnr=None).timing("table").job().timing().trade("table", "pca")
    assert len(drawn(run_of(made), draw)) == 1
    list(draw(run_of(made)))


@pytest.mark.parametrize("draw", figures.ALL)
def test_nothing_but_exact_codecs_stops_no_figure_either(made, draw):
    list(draw(run_of(made.job("table", psnr=None).timing("table"))))


@pytest.mark.parametrize("draw", figures.ALL)
def test_artefacts_that_are_gone_cost_only_their_figure(made, draw):
    made.job()
    for path in [*made.folder.glob("*.npz"), *made.folder.glob("angular*")]:
        path.unlink()
    list(draw(run_of(made)))


@pytest.mark.parametrize("draw", figures.ALL)
def test_what_is_not_comparable_is_not_drawn(made, draw):
    made.job("vq", run="0", exposure=3.0).job("pca").timing("pca").trade("pca")
    alone = drawn(run_of(made), draw)
    (name, picture), *_ = alone.items()
    made.folder = made.folder.parent / "other"
    made.__init__(made.folder)
    other = drawn(run_of(made.start().job("pca").timing("pca").trade("pca")), draw)
    np.testing.assert_array_equal(other[name], picture)


@pytest.mark.parametrize("draw", figures.ALL)
def test_several_seeds_are_drawn_once(made, draw):
    for seed in (0, 1, 2):
        made.job("pca", seed=seed, psnr=30.0 + seed).timing("pca").job("table", seed=seed, psnr=None)
    assert len(drawn(run_of(made.trade("pca")), draw)) == 1
