import base64
import io
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image

import reports
from bench.codec import Fit
from bench.codecs.registry import load_codec
from bench.conformance.check import tiny_btf
from bench.metrics.display import to_display
from bench.program.recording import program_of
from bench.records import PSNR, load_run
from bench.runs.drawing import sparse_truth
from reports import write_report
from reports.atlas import Atlases
from reports.figures.canvas import Figure
from reports.html import TEMPLATES
from reports.live import _slices_as_webp, live
from reports.page import _what_was_measured
from reports.rows import materials
from reports.series import plots_of
from reports.table import Table

HOSTILE = ('"><script>bad()</script>', "</script><script>bad()</script>", "' onerror='bad()", "名 ünï‮code")

WEB = Path(reports.__file__).parent / "web"
# What the scripts need of a page, here without codecs.
EMPTY = (
    '<script type="application/json" id="data">{"codecs": []}</script><p id="codecs"></p><button id="theme"></button>'
)


def page_of(made: Any) -> str:
    write_report(made.folder)
    return str((made.folder / "report.html").read_text(encoding="utf-8"))


def data_of(page: str, name: str = "data") -> Any:
    (found,) = re.findall(rf'<script type="application/json" id="{name}">(.*?)</script>', page, re.S)
    return json.loads(found)


def test_names_stay_text_whatever_they_are(made):
    for name in HOSTILE:
        made.job(f"pca {name}", material=name).timing(f"pca {name}", material=name)
    page = page_of(made)
    markup = re.sub(r"<script[^>]*>.*?</script>", "", page, flags=re.S)
    assert "<script" not in markup
    assert '"><script' not in markup
    assert not re.search(r"""<[^<>"']*("[^"]*"[^<>"']*)*\sonerror=""", markup)
    assert {plot["material"] for plot in data_of(page)["plots"]} - {""} == set(HOSTILE)


def test_scripts_run_by_their_hash_alone(made):
    page = page_of(made.job())
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', page)[1]
    assert "default-src 'none'" in policy
    assert policy.count("'sha256-") == page.count("<script>") + page.count("<style>")
    assert "unsafe" not in policy
    assert not re.search(r"\son\w+=|\sstyle=", page.partition("<script>")[0])


def test_records_that_have_no_room_are_said_to_be_elsewhere(made, monkeypatch):
    monkeypatch.setattr("reports.page.RECORDS_BUDGET", 9_000)
    page = page_of(made.job("one").job("two").job("three").job("four"))
    left = page.count('<details id="r0')
    assert 0 < left < 4
    assert f"{4 - left} more rows" in page


def test_a_model_of_a_scene_is_live_beside_the_whole_one_and_the_rest_says_why(made, monkeypatch):
    monkeypatch.setattr("reports.live._packed", lambda run, row, room: row.label)
    made.job("pca components=8", psnr=30.0).job("pca components=4", psnr=28.0)
    made.job("pca scene", codec="pca", psnr=20.0, settings={"scene": True})
    run = load_run(made.folder)
    (found,) = live(run, materials(run)).values()
    assert list(found.models) == ["pca components=8", "pca scene"]
    assert list(found.missing) == ["pca components=4"]
    assert re.search("pca components=8.*`neubtf-bench view`", found.missing["pca components=4"])


def test_a_model_of_a_scene_stands_in_no_plot_of_whole_material_scores(made):
    made.job("pca components=8", psnr=30.0).job("pca components=4", psnr=28.0)
    made.job("pca scene", codec="pca", psnr=20.0, settings={"scene": True})
    plots = [
        plot for plot in plots_of(load_run(made.folder)) if plot["kind"] in ("rate", "cost", "slices", "footprints")
    ]
    assert {plot["kind"] for plot in plots} >= {"rate", "cost"}
    for plot in plots:
        assert "pca scene" not in [each["label"] for each in plot["series"]] + plot["missing"]


def test_where_settings_are_many_lines_show_each_codec_at_its_best(made, monkeypatch):
    monkeypatch.setattr("reports.series.MOST_LINES", 2)
    made.job("pca components=8", psnr=30.0).job("pca components=4", psnr=28.0).job("vq codes=4", codec="vq", psnr=20.0)
    plots = {plot["kind"]: plot for plot in plots_of(load_run(made.folder)) if plot["material"]}
    assert {each["label"] for each in plots["rate"]["series"]} == {"pca components=8", "pca components=4", "vq codes=4"}
    assert {each["label"] for each in plots["slices"]["series"]} == {"pca components=8", "vq codes=4"}
    assert plots["slices"]["title"].endswith("best setting")


def test_test_pairs_do_not_choose_the_setting_of_a_line(made, monkeypatch):
    monkeypatch.setattr("reports.series.MOST_LINES", 1)
    for label, test, validation in (("pca components=8", 30.0, 25.0), ("pca components=4", 28.0, 26.0)):
        scores = {"heldout": made._group(test), "validation": made._group(validation)}
        made.job(label, psnr=test, scores=scores)
    plots = {plot["kind"]: plot for plot in plots_of(load_run(made.folder)) if plot["material"]}
    assert [each["label"] for each in plots["slices"]["series"]] == ["pca components=4"]


@pytest.mark.long
def test_a_run_for_a_scene_leads_with_the_gain_and_pictures_of_the_scene(made):
    group = {"slices": 4, "radiance": 0.1, "metrics": {"psnr_display": {"mean": 25.0, "exact": 0, "slices": 4}}}

    def job(label, grey, psnr, **more):
        frames = {name: np.full((2, 30, 40, 3), value, np.uint8) for name, value in (("truth", 200), ("decoded", grey))}
        np.savez(made.folder / f"frames-{grey}.npz", **frames)
        says = {"name": "wall", "frames": [2, 30, 40], "queries": 9, "exposure": 1.0}
        scores = {"heldout": group, "all": group, "scene": group}
        more |= {"scene": says | {"metrics": {"psnr_display": psnr}}, "scores": scores}
        made.job(label, frames=f"frames-{grey}.npz", **more)

    job("vq", 10, 30.0)
    job("pca", 60, 20.0, settings={"components": 8})
    job("pca scene", 180, 29.5, settings={"components": 8, "scene": True})
    page = page_of(made)
    section = page[page.index('<h2 id="m0">') :]
    assert section.index("+9.50 dB") < section.index("<img")
    assert section.index("<img") < section.index("scores in") < section.index('<div class="plots"')
    assert section.count("+9.50 dB") == 1
    pictures = re.findall(r'<figure><img alt="([^"]*)" src="data:image/webp;base64,([^"]*)">', section)
    captions = ["the reference table", "pca: 20.00 dB, 36,110 bytes", "pca scene: 29.50 dB, 36,110 bytes"]
    assert [words for words, _ in pictures] == 2 * captions
    for (_, data), grey in zip(pictures, (200, 60, 180, 200, 60, 180), strict=True):
        assert np.abs(np.asarray(Image.open(io.BytesIO(base64.b64decode(data)))).astype(int) - grey).max() <= 2


def test_frames_that_are_missing_are_said_to_be(made):
    group = {"slices": 4, "radiance": 0.1, "metrics": {"psnr_display": {"mean": 25.0, "exact": 0, "slices": 4}}}
    says = {"name": "wall", "frames": [2, 30, 40], "queries": 9, "exposure": 1.0, "metrics": {"psnr_display": 20.0}}
    page = page_of(made.job(scene=says, scores={"heldout": group, "all": group, "scene": group}))
    assert "no pictures" in page
    assert "scores in" in page


def test_a_model_that_is_surely_too_large_is_not_read(made, monkeypatch):
    (made.folder / "drawing.npz").write_bytes(bytes(1000))
    monkeypatch.setattr("reports.live.LARGEST", 700)
    monkeypatch.setattr("reports.live.program", lambda path: pytest.fail(f"{path} was read"))
    assert "Not live: pca: " in page_of(made.job("pca", drawing="drawing.npz"))


def test_slices_of_many_pairs_take_less_room_at_less_quality(made, monkeypatch):
    first = load_run(made.job("first").folder).jobs[0]
    (made.folder / first["pictures"]).unlink()  # as if its run were not at hand
    run = load_run(made.job().job("vq").folder)
    whole = Atlases(run, materials(run)).slices_of(materials(run)[0])
    assert (whole["quality"], len(whole["wo"])) == (None, 3)
    monkeypatch.setattr("reports.atlas.BUDGET", 2000)
    less = Atlases(run, materials(run), share=0.1).slices_of(materials(run)[0])
    assert (less["quality"], len(less["wo"]), len(less["codecs"][0]["psnr"])) == (60, 2, 2)


def test_pictures_that_no_webp_can_hold_are_fewer_smaller_or_left_out(made, monkeypatch):
    rows, width, pairs = 6000, 2, 9  # in a grid of 3 × 3 they would be 18,000 high
    pictures = np.zeros((pairs, rows, width, 3), np.uint8)
    content = dict.fromkeys(("truth", "decoded", "flip"), pictures) | {"pairs": np.arange(pairs)}
    content |= {"wo_deg": np.full((pairs, 2), 40.0), "wi_deg": np.full((pairs, 2), 40.0)}
    np.savez(made.folder / "high.npz", **content)
    run = load_run(made.job("high", pictures="high.npz").folder)
    atlases = Atlases(run, materials(run))
    assert (atlases.step, len(atlases.slices_of(materials(run)[0])["wo"])) == (2, 5)
    np.savez(made.folder / "high.npz", **content | dict.fromkeys(("truth", "decoded"), np.zeros((9, 17_000, 1, 3))))
    atlases = Atlases(run, materials(run))
    assert (atlases.step, atlases.quality) == (1, None)  # what no WebP holds costs others nothing
    found = atlases.slices_of(materials(run)[0])
    assert found == {"codecs": [], "left_out": ["high"]}

    half = np.zeros((17_000, 4), np.float16).tobytes()
    assert _slices_as_webp(half, (1000, 1)) is None
    assert _slices_as_webp(half, (1000, 17)) is not None

    png = io.BytesIO()
    Image.new("L", (20_000, 40)).save(png, "png")
    url = TEMPLATES.filters["webp"](Figure("satin", "abrdf", "title", png.getvalue()))
    shown = Image.open(io.BytesIO(base64.b64decode(url.partition(",")[2])))
    assert shown.size == (16_383, 33)


def test_codecs_that_were_seen_at_other_pairs_are_left_out_of_the_slices(made):
    made.job("one").job("two")
    path = made.folder / load_run(made.folder).jobs[1]["pictures"]
    pictures = dict(np.load(path))
    np.savez(path, **pictures | {"pairs": pictures["pairs"] + 1})
    found = data_of(page_of(made), "slices0")
    assert ([codec["label"] for codec in found["codecs"]], found["left_out"]) == (["one"], ["two"])


@pytest.fixture(scope="module")
def opened(browser: Any, tmp_path_factory: pytest.TempPathFactory, run_maker: Any) -> Any:
    made = run_maker(tmp_path_factory.mktemp("run") / "run").start()
    (made.folder / "drawings").mkdir()
    codec = load_codec("pca")()
    material = codec.decode(codec.encode(tiny_btf(), Fit()), torch.device("cpu"))
    np.savez(made.folder / "drawings/pca.npz", **program_of(material).arrays())
    np.savez(made.folder / "drawings/truth-f.npz", **sparse_truth(tiny_btf()).arrays())
    made.job("pca", psnr=30.0, drawing="drawings/pca.npz").timing("pca")
    made.job("vq", psnr=9.0).timing("vq").job("<b>mine</b>", psnr=21.5).job("vq", material="brick", psnr=12.0)
    write_report(made.folder)
    tab = browser.new_page(viewport={"width": 1000, "height": 800})
    tab.set_default_timeout(100_000)
    problems: list[str] = []
    tab.on("console", lambda message: problems.append(message.text) if message.type in ("error", "warning") else None)
    tab.on("pageerror", lambda error: problems.append(str(error)))
    tab.on("request", lambda request: problems.append(request.url) if request.url.startswith("http") else None)
    tab.goto((made.folder / "report.html").as_uri())
    tab.wait_for_selector(".plot polygon")
    yield tab
    assert problems == []


def wait(tab: Any, condition: str) -> None:
    """Wait until an expression holds. The page's policy lets Playwright's own `wait_for_function` evaluate nothing."""
    for _ in range(600):
        if tab.evaluate(f"Boolean({condition})"):
            return
        tab.wait_for_timeout(100)
    raise AssertionError(condition)


def expect_first_cells(table: Any, *texts: str) -> None:
    from playwright.sync_api import expect

    expect(table.locator("tbody tr:not([hidden]) td:first-child")).to_have_text(texts)


def test_a_table_is_sorted_by_click_and_key_its_rows_are_filtered_and_columns_hidden(opened):
    table = opened.locator('table[aria-label^="satin: quality"]')
    header = table.get_by_role("button", name="PSNR pooled")
    header.click()
    expect_first_cells(table, "vq", "<b>mine</b>", "pca")
    header.focus()
    opened.keyboard.press("Enter")
    expect_first_cells(table, "pca", "<b>mine</b>", "vq")
    assert table.locator("[aria-sort=descending]").inner_text().startswith("PSNR pooled")
    tools = opened.locator(".tools").filter(has=opened.get_by_label(re.compile("rows: satin: quality")))
    tools.locator("[type=search]").fill("mine")
    expect_first_cells(table, "<b>mine</b>")
    tools.locator("[type=search]").fill("")
    assert table.locator("tbody tr:not([hidden])").count() == 3
    tools.locator("summary").click()
    tools.get_by_label("PSNR train").uncheck()
    assert not table.get_by_text("PSNR train").is_visible()
    assert table.get_by_text("PSNR pooled").is_visible()


@pytest.mark.parametrize(("unit", "best_first"), [("dB ↑", False), ("of 1 ↓", True)])
def test_bounds_are_sorted_as_numbers_and_exact_is_the_best_in_either_direction(browser, unit, best_first):
    table = Table("main", "bounds", [("codec", ""), ("made", unit)], [["≥35.2"], ["exact"], ["4"], ["—"], ["36.0"]])
    for row in table.rows:
        row.append(row[0])
    parts = [f"<script>{(WEB / name).read_text('utf-8')}</script>" for name in ("unpacked.js", "core.js", "tables.js")]
    tab = browser.new_page()
    tab.set_default_timeout(20_000)
    tab.set_content("".join([EMPTY, TEMPLATES.get_template("parts.html").module.table(table), *parts]))
    tab.get_by_role("button", name="made").click()
    numbers = ["exact", "4", "≥35.2", "36.0"] if best_first else ["4", "≥35.2", "36.0", "exact"]
    expect_first_cells(tab.locator("table"), *numbers, "—")
    tab.close()


@pytest.mark.long
def test_a_codec_is_ticked_off_in_all_plots(opened):
    opened.locator("#codecs summary").click()
    box = opened.locator("#codecs").get_by_label("vq")
    count = "[...document.querySelectorAll('.plot')].map((each) => each.querySelectorAll('polygon').length)"
    for plot in opened.locator(".plot").all():  # each is drawn when it comes near the window
        plot.scroll_into_view_if_needed()
        plot.locator("polygon").first.wait_for(state="attached")
    before = opened.evaluate(count)
    box.focus()
    opened.keyboard.press("Space")
    after = opened.evaluate(count)
    box.check()
    assert opened.evaluate(count) == before
    assert any(b > a for a, b in zip(after, before, strict=True))
    assert opened.evaluate("document.querySelectorAll('[data-plots=brick] polygon').length") > 0
    assert all(a < b for a, b in zip(after, before, strict=True) if b)


def test_a_table_that_the_window_cuts_off_says_so(opened):
    tools = opened.locator(".tools").filter(has=opened.get_by_label(re.compile("rows: satin: quality")))
    seen = "[...document.querySelectorAll('.scroll')].filter((each) => each.checkVisibility())"
    cut = f"{seen}.map((each) => each.scrollWidth > each.clientWidth)"
    said = f"{seen}.map((each) => !each.previousElementSibling.querySelector('.more').hidden)"
    for width in (390, 1000):
        opened.set_viewport_size({"width": width, "height": 800})
        opened.wait_for_timeout(200)
        assert opened.evaluate(said) == opened.evaluate(cut)
        assert tools.locator(".more").is_visible() or width == 1000


@pytest.mark.long
@pytest.mark.timeout(120)
def test_every_codec_is_named_however_near_the_points_are(browser, tmp_path, made):
    labels = [f"{letter}-codec" for letter in "abcdefghijklmn"]
    for number, label in enumerate(labels):
        made.job(label, psnr=30.0 + 0.01 * number, bytes={"total": 1000 + number}).timing(label)
    made.job("far", psnr=20.0, bytes={"total": 9_000_000})
    write_report(made.folder)
    tab = browser.new_page(viewport={"width": 400, "height": 800})
    tab.goto((made.folder / "report.html").as_uri())
    plot = tab.locator('[data-kind="rate"]').first
    plot.locator("polygon").first.wait_for()
    assert sorted(plot.locator("text.name").all_text_contents()) == sorted(["far", *labels])
    tab.close()


def test_a_point_is_told_by_pointer_and_key(opened):
    plot = opened.locator('[data-plots="satin"] [data-kind="speed"]')
    plot.scroll_into_view_if_needed()
    plot.locator("polygon").first.hover()
    assert "30 dB at 123.4 ns (120.5 to 130.5 ns)" in plot.locator(".tip").inner_text()
    opened.mouse.move(0, 0)
    assert not plot.locator(".tip").is_visible()
    plot.locator("svg").focus()
    opened.keyboard.press("ArrowRight")
    first = plot.locator(".tip").inner_text()
    opened.keyboard.press("ArrowRight")
    assert plot.locator(".tip").inner_text() != first


@pytest.mark.long
def test_slices_are_wiped_and_chosen_by_mouse_and_key(opened):
    root = opened.locator('[data-slices="slices0"]')
    root.scroll_into_view_if_needed()
    canvas = root.locator(".stage canvas")
    wait(opened, "document.querySelector('[data-slices=slices0]').slices?.sides")

    def picture() -> str:
        return str(canvas.evaluate("(canvas) => canvas.toDataURL()"))

    seen = [picture()]
    canvas.focus()
    opened.keyboard.press("ArrowRight")
    seen.append(picture())
    box = canvas.bounding_box()
    opened.mouse.click(box["x"] + box["width"] * 0.2, box["y"] + 20)
    seen.append(picture())
    assert canvas.get_attribute("aria-valuenow") == "20"

    def see_another() -> None:
        shown = json.dumps(seen[-1])
        wait(opened, f"document.querySelector('[data-slices=slices0] canvas').toDataURL() !== {shown}")
        seen.append(picture())

    for what, value in (("show", "difference"), ("show", "flip"), ("right", "-1")):
        root.locator(f"[name={what}]").select_option(value)
        see_another()
    root.locator("[role=slider][aria-label^=view]").focus()
    opened.keyboard.press("ArrowRight")
    see_another()
    assert (root.locator("[name=pair]").input_value(), len(set(seen))) == ("1", len(seen))


def test_a_stored_slice_is_shown_as_it_is(opened):
    """Texel by texel: the pictures are without loss, and none is turned or taken from another place of the grid."""
    root = opened.locator('[data-slices="slices0"]')
    root.scroll_into_view_if_needed()
    found = root.evaluate(
        "async (root) => { const all = []; for (let i = 0; i < 3; i++) { root.slices.state.pair = i;"
        "all.push(Array.from((await root.slices.slice(root.slices.data.truth)).data)); } return all; }"
    )
    truth = np.random.default_rng(2).integers(0, 256, (3, 8, 8, 3), np.uint8)
    shown = np.array(found, np.uint8).reshape(3, 8, 8, 4)[..., :3]
    np.testing.assert_array_equal(shown, truth)


def test_a_codec_without_flip_maps_shows_none_and_says_so(opened):
    root = opened.locator('[data-slices="slices1"]')
    root.scroll_into_view_if_needed()
    wait(opened, "document.querySelector('[data-slices=slices1]').slices?.sides")
    root.evaluate("(root) => { root.slices.data.codecs[0].flip = null; }")
    root.locator("[name=show]").select_option("flip")
    root.get_by_text("no FLIP map").wait_for()
    empty = (
        "[...document.querySelectorAll('[data-slices=slices1] .sheet canvas')].map((canvas) => {"
        "const blank = document.createElement('canvas'); [blank.width, blank.height] = [canvas.width, canvas.height];"
        "return canvas.toDataURL() === blank.toDataURL(); })"
    )
    wait(opened, f"{empty}[1]")
    assert opened.evaluate(empty) == [False, True]  # the truth has none either, and stays
    root.locator("[name=right]").select_option("-1")
    root.get_by_text("truth | truth").wait_for()


@pytest.mark.timeout(120)
def test_a_plot_is_drawn_however_narrow(opened):
    plot = opened.locator('[data-plots="satin"] [data-kind="rate"]')
    plot.scroll_into_view_if_needed()
    plot.locator("polygon").first.wait_for()
    plot.evaluate("(plot) => { plot.style.width = '50px'; }")
    wait(opened, "document.querySelector('[data-plots=satin] [data-kind=rate] svg').viewBox.baseVal.width === 50")
    plot.evaluate("(plot) => { plot.style.width = ''; }")


def test_a_record_opens_where_a_number_leads(opened):
    opened.locator('table[aria-label^="satin: quality"]').get_by_role("link", name="pca").click()
    record = opened.locator("#r0-0")
    wait(opened, "document.querySelector('#r0-0 pre').textContent.length > 100")
    (found,) = json.loads(record.locator("pre").inner_text())
    assert (found["job"]["parameters"], found["timing"]["ns_per_sample"]) == (3011, 123.4)


@pytest.mark.long
@pytest.mark.timeout(300)
def test_a_live_material_changes_with_its_light(opened):
    root = opened.locator("[data-live]")
    assert root.count() == 1
    root.get_by_role("button", name="Start").click()
    wait(opened, "document.querySelector('[data-live]').viewer")
    look = (
        "(() => { const { viewer } = document.querySelector('[data-live]'); viewer.state.scale = 0.1; viewer.draw();"
        "return document.querySelector('[data-live] canvas').toDataURL(); })()"
    )
    first = opened.evaluate(look)
    assert root.locator("[name=left] option").all_inner_texts() == ["truth", "pca"]
    btf = tiny_btf()
    for pair in btf.split().train[[9, 40]]:
        wo, wi = btf.wo[pair].tolist(), btf.wi[pair].tolist()
        flat = opened.evaluate(f"document.querySelector('[data-live]').viewer.probe(0, {wo}, {wi}, 8, 8)")
        drawn = np.array(flat, float).reshape(8, 8, 4)[::-1, :, :3]
        truth = 255 * to_display(btf[pair], 1.5)
        right, *wrong = (np.abs(drawn - each).mean() for each in (truth, truth[::-1], truth[:, ::-1], truth[..., ::-1]))
        assert right < 10, "WebP halves the resolution of colours, and these change at every texel"
        assert right < 0.5 * min(wrong)
    root.locator("canvas").focus()
    for _ in range(4):
        opened.keyboard.press("Shift+ArrowRight")
    assert opened.evaluate(look) != first


def test_the_first_sentence_names_the_pairs_of_all_materials(made):
    known = {"all": made._group(30.0), "train": made._group(30.0)}
    made.job("pca", "satin").job("pca", "brick", scores=known, pairs={"all": 12, "train": 12})
    held_out, whole = materials(load_run(made.folder))
    assert _what_was_measured([held_out]).endswith("with the held-out pairs.")
    assert _what_was_measured([held_out, whole]).endswith("with the held-out pairs or, without any, all pairs.")


def test_a_file_of_scores_without_those_of_psnr_costs_the_numbers_alone(made):
    made.job("pca")
    run = load_run(made.folder)
    file = made.folder / run.jobs.latest("satin/pca/0")["slices"]
    np.savez(file, **{name: array for name, array in np.load(file).items() if name != PSNR})
    (codec,) = Atlases(run, materials(run)).slices_of(materials(run)[0])["codecs"]
    assert codec.keys() == {"label", "decoded", "flip"}
