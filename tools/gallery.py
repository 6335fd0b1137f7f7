"""Makes the pictures of docs by `neubtf-bench render`: built-in materials, truth beside codecs, and scenes.

    python tools/gallery.py WORK docs/images [MATERIAL ...]

The page of live materials is made by `neubtf-bench view` and photographed where Playwright and Chromium are there.
WORK keeps the fitted files and the rendered pictures; what is there is not made again. Codecs are fitted to the default
25 × 25 pairs at 64² texels, seed 0, with the settings of `CODECS`; the truth is interpolated between 49 × 49 pairs.
"""

import argparse
import io
import shutil
from pathlib import Path

from PIL import Image, ImageDraw, ImageFont

from bench import cli
from bench.data import materials
from bench.demand import still
from bench.files import atomic

CODECS = {
    "relief": {"steps": 400},
    "neubtf-direct": {"steps": 400},
    "neumip": {"steps": 400},
    "pca": {"components": 16},
    "mean-colour": {},
}
TRUTH = ("--set", "data.views=49", "--set", "data.lights=49")
LABEL = 22  # pixels
QUALITY = 86  # of WebP
BANNER = ("drape", "cable-knit", 300, ("relief", "neumip", "pca"))  # scene, material, width in pixels, codecs
SCENES = {  # of files of `relief`: scene, further words
    "leather": ["plane"],
    "satin": ["drape", "--lights", "environment"],
    "hammered-copper": ["sphere", "--lights", "environment", "--tiling", "2"],
    "cable-knit": ["table-top"],
}
LIVE = ("cable-knit", ("relief", "neubtf-direct"))  # material, codecs
# Of Chromium, so that it draws without a GPU, and runs as root.
FLAGS = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox"]


def done(words: list[str]) -> None:
    """Run a command of `neubtf-bench`; ends the program if it fails."""
    code = cli.main(words)
    if code:
        raise SystemExit(code)


def fitted(work: Path, material: str, codec: str) -> Path:
    """The file of a codec, fitted where it is not there."""
    path = work / f"{material}-{codec}.nbtf"
    if not path.exists():
        settings: list[str] = []
        for key, value in CODECS[codec].items():
            settings += ["--set", f"{key}={value}"]
        done(["encode", material, "--codec", codec, *settings, "-o", str(path)])
    return path


def body(path: Path) -> Image.Image:
    """A rendered picture without its captions."""
    picture = Image.open(path)
    return picture.crop((0, 0, picture.width, picture.height - still.CAPTION))


def strip(work: Path, material: str, codecs: tuple[str, ...], scene: str, width: int) -> Image.Image:
    """Truth and codecs side by side in a scene, each `width` pixels wide, with a line of names and bytes below."""
    files = [fitted(work, material, codec) for codec in codecs]
    path = work / f"{material}-{scene}-{width}.png"
    if not path.exists():
        shown = ["--scene", scene, "--width", str(width), "--rays", "3", "-o", str(path)]
        done(["render", *map(str, files), "--truth", material, *TRUTH, *shown])
    names = ["truth, interpolated"]
    for codec, file in zip(codecs, files, strict=True):
        names.append(f"{codec}, {file.stat().st_size / 1e3:.0f} kB")
    return labelled(body(path), names)


def labelled(picture: Image.Image, names: list[str]) -> Image.Image:
    """A picture of columns of one width with a line of their names below, and nothing transparent above and below."""
    _, top, _, bottom = picture.getbbox() or (0, 0, *picture.size)
    picture = picture.crop((0, top, picture.width, bottom))
    whole = Image.new("RGBA", (picture.width, picture.height + LABEL))
    whole.paste(picture, (0, 0))
    draw = ImageDraw.Draw(whole)
    font = ImageFont.load_default(size=LABEL * 0.62)
    width = picture.width / len(names)
    for number, name in enumerate(names):
        draw.text(((number + 0.5) * width, picture.height + LABEL / 2), name, still.GREY, font, anchor="mm")
    return whole


def scenes(work: Path) -> Image.Image:
    """One picture of `relief` in each scene, side by side, 240 pixels high."""
    pictures = []
    for material, (scene, *words) in SCENES.items():
        path = work / f"scene-{scene}.png"
        if not path.exists():
            wide = "427" if scene == "table-top" else "240"
            shown = ["--scene", scene, *words, "--width", wide, "--rays", "3", "-o", str(path)]
            done(["render", str(fitted(work, material, "relief")), *shown])
        pictures.append(body(path))
    width = sum(picture.width for picture in pictures)
    whole = Image.new("RGBA", (width, max(picture.height for picture in pictures)))
    left = 0
    for picture in pictures:
        whole.paste(picture, (left, 0))
        left += picture.width
    return whole


def live(work: Path) -> Image.Image | None:
    """A picture of the page that `view` makes; None where no browser can be driven."""
    browser = shutil.which("chromium") or shutil.which("google-chrome")
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        browser = None
    if not browser:
        return None
    material, codecs = LIVE
    done(["view", *(str(fitted(work, material, codec)) for codec in codecs), "-o", str(work / "view.html")])
    with sync_playwright() as driver:
        launched = driver.chromium.launch(executable_path=browser, args=FLAGS)
        tab = launched.new_page(viewport={"width": 900, "height": 760})
        tab.goto((work / "view.html").resolve().as_uri())
        tab.wait_for_function("window.viewer && document.querySelector('[data-says]').textContent.includes('frames')")
        tab.wait_for_timeout(3000)  # until nothing moves
        tab.evaluate("(viewer.state.scale = 1, viewer.draw())")
        picture = Image.open(io.BytesIO(tab.screenshot()))
        launched.close()
    return picture


def write(path: Path, picture: Image.Image) -> None:
    """Write a picture as WebP, and print its size."""
    stream = io.BytesIO()
    picture.save(stream, "webp", quality=QUALITY, method=6)
    atomic.write(path, stream.getvalue())
    print(f"{path}: {len(stream.getvalue()) / 1e3:.0f} kB")


def main() -> None:
    """Make the pictures of the materials that the command line names, and with those of all scenes the common ones."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("work", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("materials", nargs="*", metavar="MATERIAL", default=materials.names())
    parser.add_argument("--width", type=int, default=180, help="of one sphere, in pixels")
    chosen = parser.parse_args()
    chosen.work.mkdir(parents=True, exist_ok=True)
    for name in chosen.materials:
        write(chosen.out / f"gallery-{name}.webp", strip(chosen.work, name, tuple(CODECS), "sphere", chosen.width))
    scene, material, width, codecs = BANNER
    if set(SCENES) <= set(chosen.materials):
        write(chosen.out / "gallery-scenes.webp", scenes(chosen.work))
        if page := live(chosen.work):
            write(chosen.out / "gallery-live.webp", page)
        write(chosen.out / "gallery.webp", strip(chosen.work, material, codecs, scene, width))


if __name__ == "__main__":
    main()
