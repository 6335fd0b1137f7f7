import io
import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from bench.compare.frame import EAGER
from bench.records import load_run
from reports import figures
from reports.artefacts import arrays, program
from reports.figures import contact, latents
from reports.figures.canvas import Figure, Sheet
from reports.figures.pairs import pairs_figure
from reports.rungs import rungs_of
from reports.series import plots_of


@pytest.fixture
def made(made):
    plain = made.job

    def job(*words, **changes):
        store(made.folder / "drawing.npz")
        plain(*words, **({"drawing": "drawing.npz"} | changes))
        return made

    made.job = job
    return made


OF_ANY_RUN = [draw for kind, draw in figures.ALL.items() if kind not in ("ranks", "fronts")]  # of validation pairs


@pytest.mark.long
def test_fronts_hold_what_is_read_off_curves_and_the_rungs_within_times():
    run = load_run(Path(__file__).parents[3] / "docs/results/budgets.jsonl")
    drawn = {figure.kind: figure.drawing for figure in figures.ALL["fronts"](run)}
    rungs = rungs_of(run)
    kind, names = next(iter(rungs.kinds.items()))
    by_size, by_time = (
        [dict(zip(*line.get_data(), strict=True)) for line in axes.lines] for axes in drawn[f"fronts-{kind}"].axes
    )
    for codec in ("neubtf-direct", "pca"):
        read = {bits: rungs.read(bits).loc[codec, names].median(skipna=False) for bits in (8, 16, 32, 64)}
        reached = {bits: pytest.approx(value) for bits, value in read.items() if not np.isnan(value)}
        assert len(reached) > 1
        assert any(all(curve.get(bits) == value for bits, value in reached.items()) for curve in by_size)
        times = [budget for budget in rungs.limits if budget.kind == EAGER]
        ranked = {budget.most: rungs.ranked(budget, names).get(codec) for budget in times}
        assert {most: value for most, value in ranked.items() if value is not None} in by_time


def store(path):
    lookup = {"operation": "embedding_bag_forward_only", "shape": [1, 2], "kind": "float"}
    steps = [
        {"name": "row", "operation": "mul", "arguments": [{"of": "uv"}, 8.0], "shape": [1, 2], "kind": "float"},
        {"name": "found", "arguments": [{"of": "texture"}, {"of": "row"}, 1, [{"of": "row"}]]} | lookup,
        {"name": "lit", "arguments": [{"of": "lights"}, {"of": "wi"}]} | lookup,
    ]
    says = {"size": [8, 8], "steps": steps, "result": "found"}
    texture = np.zeros((64 + 16 + 4 + 1, 2), np.float32)  # a pyramid
    texture[:8, 1], texture[64:] = 1.0, 9.0
    content = {"program": np.frombuffer(json.dumps(says).encode(), np.uint8), "texture": texture}
    np.savez(path, **content, lights=np.ones((64, 2), np.float32))


def drawn(made, draw):
    return {figure.name: np.asarray(Image.open(io.BytesIO(figure.png)).convert("RGB")) for figure in draw(made)}


def run_of(made):
    return load_run(made.folder)


def test_a_contact_sheet_shows_every_texel_as_it_is_stored(made):
    run = run_of(made.job())
    sheet = drawn(run, figures.contact_sheets)["contact-satin.png"]
    truth = arrays(run.folder, run.jobs[0], "pictures")["truth"][0]
    cell = sheet[contact._TOP : contact._TOP + 128, contact._LEFT : contact._LEFT + 128]
    np.testing.assert_array_equal(cell[8::16, 8::16], truth)


def test_a_contact_sheet_leaves_out_codecs_of_other_pairs_and_names_them(made, monkeypatch):
    alone = drawn(run_of(made.job("one")), figures.contact_sheets)["contact-satin.png"]
    run = run_of(made.job("two"))
    path = run.folder / run.jobs[1]["pictures"]
    pictures = dict(np.load(path))
    texts = []
    write = Sheet.text

    def noted(sheet, x, y, text, **look):
        texts.append(text)
        write(sheet, x, y, text, **look)

    monkeypatch.setattr(Sheet, "text", noted)
    for other in ({"pairs": pictures["pairs"] + 1}, {name: array[:2] for name, array in pictures.items()}):
        np.savez(path, **pictures | other)
        assert drawn(run, figures.contact_sheets)["contact-satin.png"].shape == alone.shape
        assert any(text.endswith(": two") for text in texts)
        texts.clear()


def test_slices_without_scores_are_drawn_without_numbers(made):
    run = run_of(made.job())
    path = run.folder / run.jobs[0]["slices"]
    np.savez(path, pairs=np.load(path)["pairs"])  # of all arrays this one alone
    assert list(drawn(run, figures.contact_sheets)) == ["contact-satin.png"]
    assert pairs_figure(run, "satin", []).name == "pairs-satin.png"


@pytest.mark.parametrize("draw", OF_ANY_RUN)
def test_neither_odd_labels_nor_exact_codecs_stop_a_figure_and_what_is_gone_costs_only_its_own(made, draw):
    labels = ("_hidden $x^2$", "编码", "a" * 200, "%d {0}")
    for label in labels:
        made.job(label, material="50 % $m_1$").timing(label, material="50 % $m_1$")
    assert len(drawn(run_of(made), draw)) == 1
    made.folder = made.folder.parent / "exact"
    made.__init__(made.folder)
    list(draw(run_of(made.start().job("table", psnr=100.0).timing("table"))))  # nothing else is there
    made.job().job("vq").timing()
    assert len(drawn(run_of(made), draw)) == 1
    for path in [*made.folder.glob("*.npz"), *made.folder.glob("angular*")]:
        path.unlink()
    list(draw(run_of(made)))


def test_the_scale_of_polar_maps_begins_at_zero_even_without_any_error(made):
    made.job()
    (stored,) = made.folder.glob("angular*")
    stored.write_text(stored.read_text(encoding="utf-8").replace("0.25", "0.0"), encoding="utf-8")
    (figure,) = figures.ALL["polar"](run_of(made))
    (scale,) = figure.drawing.drawing.axes
    assert scale.get_ylim() == (0, 1)


@pytest.mark.parametrize("draw", OF_ANY_RUN)
def test_what_is_not_comparable_is_not_drawn(made, draw):
    made.job("vq", run="0", exposure=3.0).job("pca").job("neumip").timing("pca")
    alone = drawn(run_of(made), draw)
    (name, picture), *_ = alone.items()
    made.folder = made.folder.parent / "other"
    made.__init__(made.folder)
    other = drawn(run_of(made.start().job("pca").job("neumip").timing("pca")), draw)
    np.testing.assert_array_equal(other[name], picture)


def test_channels_are_those_of_textures_that_are_looked_up_by_the_place(made):
    run = run_of(made.job())
    (texture,) = latents.textures(program(run.folder / "drawing.npz"))
    assert texture.shape == (8, 8, 2)
    assert set(np.unique(texture)) == {0.0, 1.0}  # the finest level
    picture = drawn(run, figures.latent_channels)["latents-satin.png"]
    constant, other = (
        picture[latents._TOP : latents._TOP + 64, left : left + 64, 0]
        for left in (latents._LEFT, latents._LEFT + latents._CELL + latents._GAP)
    )
    assert set(np.unique(constant)) == {128}
    assert (other[:8] > other[8:].max()).all()  # its first row of texels is brighter
    assert not list(figures.latent_channels(run_of(made.job(drawing="gone.npz"))))


def test_the_interval_of_several_seeds_holds_those_of_all_in_the_one_series_of_figure_and_page(made):
    for seed, interval in enumerate(([90.0, 110.0], [100.0, 140.0])):
        made.job("pca", seed=seed, job=f"satin/pca/{seed}")
        made.timing("pca", job=f"satin/pca/{seed}", ns_per_sample=100.0 + 10 * seed, interval95_ns=interval)
    (plot,) = (plot for plot in plots_of(run_of(made)) if plot["kind"] == "speed")
    assert plot["series"][0]["points"] == [[105.0, 30.0, 90.0, 140.0]]


def test_a_sheet_gives_the_same_bytes_each_time_and_in_any_order():
    sheet = Sheet(40, 30)
    sheet.picture(5, 5, np.full((10, 20, 3), 90, np.uint8))
    sheet.text(20, 25, "text")
    figure = Figure("cloth", "made", "Made", sheet.png(), sheet)
    first = figure.vector("svg")
    figure.vector("pdf")
    assert figure.vector("svg") == first
    assert first.count(b"<image") == 1
    assert sheet.png() == figure.png
