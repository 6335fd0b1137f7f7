import base64
import io
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image

from bench.codec import Fit
from bench.codecs.registry import load_codec
from bench.conformance.check import tiny_btf
from bench.directions.hemisphere import from_degrees
from bench.material import Material
from bench.metrics.display import to_display
from bench.runs.drawing import drawable
from reports.viewer.page import Shown, _rounded, as_json, page
from tests.baselines.surfaces import bumps

CODECS: dict[str, dict[str, Any]] = {
    "mean-colour": {},
    "neubtf-direct": {"steps": 20},
    "neumip": {"steps": 20},
    "pca": {},
    "relief": {"steps": 20, "batch": 256},
}
WO, WI = (from_degrees(*angles).astype(np.float32).ravel() for angles in ((35, 20), (50, 140)))


def test_no_text_of_the_data_ends_the_script() -> None:
    assert "</script" not in as_json({"label": "</script><script>alert(1)</script>"})


def test_a_page_runs_its_own_script_and_nothing_else() -> None:
    codec = load_codec("mean-colour")()
    material = codec.decode(codec.encode(tiny_btf(), Fit()), torch.device("cpu"))
    text = page("a", [Shown("a", drawable(material)[0], 1.0)])
    policy = re.search('<meta http-equiv="Content-Security-Policy" content="(.*?)">', text, re.S)
    assert policy is not None
    assert policy[1].startswith("default-src 'none';")
    assert "unsafe" not in policy[1]  # that both hashes are right, the browser says below


@pytest.fixture(scope="module")
def materials() -> dict[str, Material]:
    made = {name: load_codec(name)(**settings) for name, settings in CODECS.items()}
    device = torch.device("cpu")
    shown = {name: bumps()[0] if name == "relief" else tiny_btf() for name in made}
    found = {name: codec.decode(codec.encode(shown[name], Fit()), device) for name, codec in made.items()}
    assert vars(found["relief"])["relief"] is not None  # there is a height to march
    return found


@pytest.fixture(scope="module")
def opened(browser: Any, materials: dict[str, Material], tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    folder = tmp_path_factory.mktemp("page")
    programs = {name: drawable(material)[0] for name, material in materials.items()}
    models = [Shown(f"<b>{name}</b>", program, 1.0) for name, program in programs.items()]
    (folder / "view.html").write_text(page("a <b>page</b>", models), encoding="utf-8")
    tab = browser.new_page(viewport={"width": 240, "height": 320})
    tab.set_default_timeout(100_000)
    tab.problems = []
    tab.on("console", lambda message: tab.problems.append(message.text) if message.type == "error" else None)
    tab.on("pageerror", lambda error: tab.problems.append(str(error)))
    tab.goto((folder / "view.html").as_uri())
    tab.wait_for_function("window.viewer !== undefined")
    yield tab
    assert tab.problems == []


def probed(opened: Any, viewer: str, number: int, size: tuple[int, int]) -> np.ndarray:
    """The plane as a viewer of the page draws it, a pixel a texel, (H, W, 3) of 0 to 255, row 0 on top."""
    height, width = size
    flat = opened.evaluate(f"{viewer}.probe({number}, {WO.tolist()}, {WI.tolist()}, {width}, {height})")
    return np.array(flat, float).reshape(height, width, 4)[::-1, :, :3]


@pytest.mark.timeout(300)
@pytest.mark.parametrize("number", range(len(CODECS)), ids=list(CODECS))
def test_pixels_are_what_the_material_answers(opened: Any, materials: dict[str, Material], number: int) -> None:
    material = list(materials.values())[number]
    ours = probed(opened, "viewer", number, material.size)
    truth = 255 * to_display(material.slice(WO.tolist(), WI.tolist()).numpy(), 1.0)
    assert (np.abs(ours - truth) <= 2).mean() >= 0.999
    wrong = [truth[::-1], truth[:, ::-1], 255 * to_display(material.slice(WI.tolist(), WO.tolist()).numpy(), 1.0)]
    turned = wrong[:2] if material.cost.texture_channels == 3 else wrong  # mean colours know no direction
    assert all((np.abs(ours - other) <= 2).mean() < 0.99 for other in turned)


def picture_of(tab: Any, shown: dict[str, Any]) -> np.ndarray:
    """What the viewer draws with these settings, (H, W, 4) of 0 to 255."""
    tab.evaluate(f"(Object.assign(viewer.state, {json.dumps(shown)}), viewer.draw())")
    url = tab.evaluate("document.querySelector('canvas').toDataURL()")
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(url.split(",")[1]))).convert("RGBA"), float)


@pytest.mark.long
@pytest.mark.timeout(300)
def test_a_texture_that_is_not_square_is_not_squeezed(browser: Any, tmp_path: Path) -> None:
    codec = load_codec("mean-colour")()
    material = codec.decode(codec.encode(tiny_btf().crop(0, 0, 4, 8), Fit()), torch.device("cpu"))
    model = Shown("wide", drawable(material)[0], 1.0)
    (tmp_path / "view.html").write_text(page("wide", [model]), encoding="utf-8")
    tab = browser.new_page(viewport={"width": 300, "height": 500})
    tab.goto((tmp_path / "view.html").as_uri())
    shown = {"shape": "plane", "light": "sun", "view": [0.001, -np.pi / 2], "sun": [0.001, 0], "scale": 1, "zoom": 1}
    tab.wait_for_function("window.viewer !== undefined")
    pixels = picture_of(tab, shown)
    tab.close()
    inside = pixels[..., 3] == 255
    plane = pixels[inside.any(1)][:, inside.any(0), :3]
    quarter = len(plane) // 4

    def moved(picture: np.ndarray) -> float:
        return float(np.abs(picture[quarter:] - picture[:-quarter]).mean() / plane.std())

    assert moved(plane) < 0.15
    assert moved(plane.swapaxes(0, 1)) > 0.5


@pytest.mark.long
@pytest.mark.timeout(300)
def test_a_compiler_that_refuses_literals_is_given_a_uniform_buffer(
    opened: Any, materials: dict[str, Material]
) -> None:
    opened.evaluate("""async () => {
      const section = document.querySelector(".viewer").cloneNode(true);
      section.querySelectorAll("[name=left], [name=right]").forEach((list) => list.replaceChildren());
      const data = await unpacked("models");
      for (const number of [0, 1]) data.models[number].shader = "no shader";
      document.body.append(section);
      window.spare = mountViewer(section, data);
    }""")
    material = materials["neubtf-direct"]
    truth = 255 * to_display(material.slice(WO.tolist(), WI.tolist()).numpy(), 1.0)
    assert (np.abs(probed(opened, "spare", 1, material.size) - truth) <= 2).mean() >= 0.999
    assert opened.evaluate("spare.probe(0, [0, 0, 1], [0, 0, 1], 8, 8)") is None  # it has no weights, so one shader
    says = "document.querySelectorAll('[data-says]')[1].textContent"
    opened.wait_for_function(f"{says}.startsWith('<b>mean-colour</b>:')")
    opened.evaluate("document.querySelectorAll('.viewer')[1].remove()")


def test_the_wipe_follows_pointer_and_keys(opened: Any) -> None:
    opened.select_option("[name=left]", "1")
    opened.select_option("[name=right]", "3")
    opened.locator("[data-line]").hover()
    box = opened.locator("canvas").bounding_box()
    opened.mouse.down()
    opened.mouse.move(box["x"] + 0.25 * box["width"], box["y"] + 20)
    opened.mouse.up()
    assert abs(opened.evaluate("viewer.state.wipe") - 0.25) < 0.02
    assert abs(float(opened.input_value("[name=wipe]")) - 0.25) < 0.02
    opened.focus("[name=wipe]")
    opened.keyboard.press("End")
    assert opened.evaluate("viewer.state.wipe") == 1
    assert "neubtf-direct" in opened.locator("[data-left]").inner_text()
    assert "pca" in opened.locator("[data-right]").inner_text()


def test_each_slider_says_its_number(opened: Any) -> None:
    told = set()
    for name in ("wipe", "exposure", "tiling", "zoom"):
        opened.focus(f"[name={name}]")
        for key, end in (("Home", "min"), ("End", "max")):
            opened.keyboard.press(key)
            said = opened.locator(f"[data-of={name}]").inner_text()
            number = abs(float(opened.get_attribute(f"[name={name}]", end))) * (100 if name == "wipe" else 1)
            assert float(re.findall(r"[\d.]+", said)[0]) == number
            told.add(said)
    assert len(told) == 8


def test_slices_take_a_third_less_and_move_by_less_than_half_a_step_of_a_display() -> None:
    rng = np.random.default_rng(0)
    half = np.sort(rng.random(40_000).astype(np.float16) * np.float16(1.2))
    half[-1], half[0] = np.finfo(np.float16).max, 0
    rounded = _rounded(half)
    assert np.isfinite(rounded).all()
    assert rounded[0] == 0
    assert np.abs(255 * (to_display(half, 1.0) - to_display(rounded, 1.0))).max() < 0.5
    assert not (rounded.view(np.uint16) % 8).any()


def test_the_difference_of_a_model_to_itself_is_black_and_to_another_is_not(opened: Any) -> None:
    drawn = {}
    for right in (0, 1):
        shown = {"left": 0, "right": right, "show": "difference", "exposure": 2, "shape": "plane", "scale": 0.3}
        drawn[right] = picture_of(opened, shown)[..., :3]
    opened.evaluate("Object.assign(viewer.state, {left: 0, right: 1, show: 'sides', exposure: 0, shape: 'sphere'})")
    assert drawn[0].max() <= 2  # light is added up in half floats
    assert drawn[1].max() > 10


def test_dragging_turns_camera_or_light(opened: Any) -> None:
    def drag(button: str = "left") -> tuple[list[float], list[float]]:
        opened.evaluate("(viewer.state.view = [0.5, 0.5], viewer.state.sun = [0.5, 0.5])")
        opened.locator("canvas").scroll_into_view_if_needed()
        box = opened.locator("canvas").bounding_box()
        opened.mouse.move(box["x"] + 30, box["y"] + 60)
        opened.mouse.down(button=button)
        opened.mouse.move(box["x"] + 60, box["y"] + 60)
        opened.mouse.up(button=button)
        return opened.evaluate("viewer.state.view"), opened.evaluate("viewer.state.sun")

    turned, still = pytest.approx([0.5, 0.3]), [0.5, 0.5]
    assert drag() == (turned, still)
    assert drag("right") == (still, pytest.approx([0.5, 0.7]))
    opened.select_option("[name=drag]", "sun")
    assert drag() == (still, pytest.approx([0.5, 0.7]))


@pytest.mark.long
@pytest.mark.timeout(300)
def test_every_shape_and_light_draws_something(opened: Any) -> None:
    opened.select_option("[name=left]", "0")
    opened.evaluate("(viewer.state.wipe = 1, viewer.state.view = [0.9, -1.2], viewer.state.sun = [0.6, -1.2])")
    pictures = set()
    for shape in ("plane", "sphere", "drape"):
        for light in ("point", "sun", "environment"):
            opened.select_option("[name=shape]", shape)
            opened.select_option("[name=light]", light)
            opened.evaluate("(viewer.state.scale = 0.3, viewer.draw())")
            pictures.add(opened.evaluate("document.querySelector('canvas').toDataURL()"))
            assert " ns " in opened.locator("[data-says]").inner_text()
    assert len(pictures) == 9


def test_one_finger_turns_the_camera_and_two_the_light(opened: Any) -> None:
    touch = opened.context.new_cdp_session(opened)
    opened.select_option("[name=drag]", "view")
    for fingers, view, sun in ((1, [0.5, 0.3], [0.5, 0.5]), (2, [0.5, 0.5], [0.5, 0.7])):
        opened.evaluate("(viewer.state.view = [0.5, 0.5], viewer.state.sun = [0.5, 0.5])")
        opened.locator("canvas").scroll_into_view_if_needed()
        box = opened.locator("canvas").bounding_box()
        for kind, along in (("touchStart", 0), ("touchMove", 30), ("touchEnd", 0)):
            places = range(fingers if kind != "touchEnd" else 0)
            points = [{"x": box["x"] + 40 + along, "y": box["y"] + 60 + 50 * i, "id": i} for i in places]
            touch.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})
        assert opened.evaluate("viewer.state.view") == pytest.approx(view)
        assert opened.evaluate("viewer.state.sun") == pytest.approx(sun)
