"""show codec files as live materials, in a page for the browser

Plane, sphere and drape; camera and light to drag; two files, or a file and its BTF, side by side. The page holds
everything that it shows: it needs neither a server nor a network.

examples:
  neubtf-bench view satin.nbtf --truth satin
  neubtf-bench view small.nbtf large.nbtf -o compare.html
"""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from bench.commands import assignments
from bench.errors import FINE, InputError

if TYPE_CHECKING:
    from bench.codec import Progress
    from bench.material import Material
    from reports.shaders.program import Program


def arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("files", type=Path, nargs="+", metavar="FILE", help="codec files to look at")
    parser.add_argument("--truth", metavar="BTF", help="the BTF beside them: a built-in material or a path")
    parser.add_argument("--set", action="append", default=[], metavar="data.KEY=VALUE", help="how --truth is prepared")
    parser.add_argument("-o", "--out", type=Path, help="write the page here, and open nothing")


def run(options: argparse.Namespace) -> int:
    import tempfile
    import webbrowser

    from bench import atomic

    with tempfile.TemporaryDirectory(prefix="neubtf-view-") as folder:
        text = _page(options, Path(folder))
    out = options.out or Path(tempfile.mkdtemp(prefix="neubtf-view-")) / "view.html"
    atomic.write(out, text.encode())
    print(f"{out}: {len(text) / 1e6:.1f} MB")
    if not options.out and not webbrowser.open(out.as_uri()):
        raise InputError(f"no browser could be opened: open {out} by hand, or choose a place with -o")
    return FINE


def _page(options: argparse.Namespace, folder: Path) -> str:
    from bench.codecs.loading import load
    from bench.console import Console
    from bench.data.open import open_named
    from bench.runs.drawing import drawable_truth
    from reports.shaders.program import read
    from reports.viewer.page import Model, page

    if options.set and not options.truth:
        raise InputError("--set: says how --truth is prepared: name it, too")
    changes = assignments(options.set)
    with Console() as console:
        models, shown = [], None
        if options.truth:
            btf = open_named(options.truth, changes, console.show)
            truth = drawable_truth(btf, folder / "truth.npz", console.show)
            note = "truth: the training pairs, interpolated between directions"
            models, shown = [Model(f"{btf.name}, truth", read(truth.path), truth.exposure, note)], truth.exposure
        for number, file in enumerate(options.files):
            header, material, _ = load(file)
            program, exposure, note = _drawn(material, file.stem, folder / f"{number}.npz", console.show)
            shown = shown or exposure  # one exposure for all, so that brightness can be compared
            models.append(Model(f"{file.stem}: {header.codec}, {header.file_bytes:,} bytes", program, shown, note))
        return page(options.truth or options.files[0].stem, models)


def _drawn(material: "Material", name: str, path: Path, show: "Progress") -> "tuple[Program, float, str]":
    """The program of a material, its exposure and a note; of its baked slices where no shader can run it."""
    from bench.runs.drawing import BAKED, baked, drawable, drawable_truth
    from reports.shaders.dialects import GLSL
    from reports.shaders.generator import shader
    from reports.shaders.program import read

    try:
        drawing = drawable(material, path)
        program = read(drawing.path)
        shader(program, GLSL)
    except InputError as error:
        drawing = drawable_truth(baked(material, name, show), path, show)
        note = f"{name} is baked: its slices at {BAKED} × {BAKED} pairs, interpolated between directions, since {error}"
        return read(drawing.path), drawing.exposure, note
    return program, drawing.exposure, ""
