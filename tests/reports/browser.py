"""Starts the installed Chromium without a display, for tests of pages and shaders; skips them where there is none."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

NAMES = ("chromium", "chromium-browser", "google-chrome")
FLAGS = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox"]  # WebGL 2 without a GPU
WEBGPU = ["--enable-unsafe-webgpu", "--use-webgpu-adapter=swiftshader"]


@contextmanager
def chromium() -> Iterator[Any]:
    """A browser of Playwright with WebGL 2 and WebGPU in software."""
    playwright = pytest.importorskip("playwright.sync_api", reason="needs the extra neubtf-bench[browser]")
    found = next(filter(None, map(shutil.which, NAMES)), None)
    if not found:
        pytest.skip(f"none of {', '.join(NAMES)} is installed")
    with playwright.sync_playwright() as driver:
        launched = driver.chromium.launch(executable_path=found, args=[*FLAGS, *WEBGPU])
        yield launched
        launched.close()
