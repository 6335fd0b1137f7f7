"""The page of live materials, in a real browser: it draws what `Material.query` answers, the right way round."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
import torch

from bench.codec import Fit
from bench.codecs.registry import load_codec
from bench.conformance.check import tiny_btf
from bench.hemisphere import from_degrees
from bench.material import Material
from bench.metrics.display import to_display
from bench.runs.drawing import drawable
from reports.shaders.program import read
from reports.viewer.page import Model, as_json, page
from tests.baselines.surfaces import bumps
from tests.reports.browser import chromium

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


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with chromium() as launched:
        yield launched


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
    """The page with every material at exposure 1, and what it said on the console."""
    folder = tmp_path_factory.mktemp("page")
    programs = {name: read(drawable(material, folder / f"{name}.npz").path) for name, material in materials.items()}
    models = [Model(f"<b>{name}</b>", program, 1.0) for name, program in programs.items()]
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


@pytest.mark.timeout(300)
@pytest.mark.parametrize("number", range(len(CODECS)), ids=list(CODECS))
def test_pixels_are_what_the_material_answers(opened: Any, materials: dict[str, Material], number: int) -> None:
    material = list(materials.values())[number]
    height, width = material.size
    flat = opened.evaluate(f"viewer.probe({number}, {WO.tolist()}, {WI.tolist()}, {width}, {height})")
    ours = np.array(flat, float).reshape(height, width, 4)[::-1, :, :3]
    truth = 255 * to_display(material.slice(WO.tolist(), WI.tolist()).numpy(), 1.0)
    assert (np.abs(ours - truth) <= 2).mean() >= 0.999
    wrong = [truth[::-1], truth[:, ::-1], 255 * to_display(material.slice(WI.tolist(), WO.tolist()).numpy(), 1.0)]
    turned = wrong[:2] if material.cost.texture_channels == 3 else wrong  # mean colours know no direction
    assert all((np.abs(ours - other) <= 2).mean() < 0.99 for other in turned)


@pytest.mark.timeout(300)
def test_the_picture_follows_light_and_choice(opened: Any) -> None:
    def picture() -> str:
        return opened.evaluate(
            "(viewer.state.scale = 0.2, viewer.draw(), document.querySelector('canvas').toDataURL())"
        )

    opened.select_option("[name=shape]", "plane")
    opened.select_option("[name=left]", "1")
    opened.select_option("[name=right]", "1")
    first = picture()
    opened.focus("canvas")
    for _ in range(4):
        opened.keyboard.press("Shift+ArrowRight")
    second = picture()
    opened.select_option("[name=left]", "2")
    assert len({first, second, picture()}) == 3


def test_names_are_text(opened: Any) -> None:
    assert opened.locator("h1").inner_text() == "a <b>page</b>"
    assert opened.locator("[name=left] option").first.inner_text() == "<b>mean-colour</b>"
