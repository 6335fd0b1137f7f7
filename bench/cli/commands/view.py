"""show codec files as live materials in the browser

The page shows a plane, a sphere or a drape, lets you drag camera and light, and compares two files, or a file and its
BTF, with a wipe between. It contains everything that it shows, and needs no server and no network.

examples:
  neubtf-bench view satin.nbtf --truth satin
  neubtf-bench view small.nbtf large.nbtf -o compare.html
"""

import argparse
import tempfile
import webbrowser
from pathlib import Path
from typing import NamedTuple

from bench.btf import BTF
from bench.cli.commands import assignments, say_line, several
from bench.cli.console import Console
from bench.codec import Progress
from bench.codecs.loading import Loaded, load
from bench.data.open import open_named
from bench.files import atomic
from bench.inputs.errors import FINE, InputError
from bench.metrics import stats_of
from bench.metrics.scoring import summarise
from bench.program import Program
from bench.records import PSNR, deciding_group
from bench.runs.drawing import BAKED, baked, drawable, drawable_truth
from bench.runs.evaluation import Slices
from bench.runs.library import require_same_size
from bench.runs.workbench import Workbench
from reports.shaders.dialects import GLSL
from reports.shaders.generator import shader
from reports.viewer.page import Shown, page


def arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command to its parser."""
    parser.add_argument("files", type=Path, nargs="+", metavar="FILE", help="the codec files to show")
    parser.add_argument("--truth", metavar="BTF", help="show this BTF, a built-in material or a path, beside them")
    several(parser, "--set", "how --truth is prepared", "data.KEY=VALUE")
    parser.add_argument("-o", "--out", type=Path, help="write the page here, and open nothing")


def run(options: argparse.Namespace) -> int:
    """Write the page, and open it in the browser unless a place is given; returns the exit code."""
    if options.set and not options.truth:
        raise InputError("--set: it says how --truth is prepared: give --truth, too")
    if options.out:
        atomic.refuse_other_kind(options.out, ".html", atomic.begins(b"<!DOCTYPE html>"))
    changes = assignments(options.set)
    with Console() as console:
        models = _models(options, changes, console.show)
        title = models[0].label.removesuffix(", truth") if options.truth else options.files[0].stem
        text = page(title, models)
    out = options.out or Path(tempfile.mkdtemp(prefix="neubtf-view-")) / "view.html"
    atomic.write(out, text.encode())
    say_line(f"{out}: {len(text) / 1e6:.1f} MB")
    if not options.out and not webbrowser.open(out.as_uri()):
        raise InputError(f"no browser could be opened: open {out} by hand, or choose a place with -o")
    return FINE


def _models(options: argparse.Namespace, changes: dict[str, str], show: Progress) -> list[Shown]:
    """The models of the page: the truth, if it is asked for, and the files; all at the exposure of the first."""
    models = []
    btf = None
    common_exposure = None
    if options.truth:
        btf = open_named(options.truth, changes, show)
        program, common_exposure = drawable_truth(btf, show)
        note = "truth: the training pairs, interpolated between directions"
        models.append(Shown(f"{btf.name}, truth", program, common_exposure, note, slices=True))
    for file in map(load, options.files):
        drawn = _drawn(file, show)
        common_exposure = drawn.exposure if common_exposure is None else common_exposure
        label = f"{file.header.path.stem}: {file.header.codec}, {file.header.file_bytes:,} bytes"
        if btf is not None:
            require_same_size(file.header.path.name, file.material.size, btf)
            label += f", {_psnr_in_words(file, btf, show)}"
        models.append(Shown(label, drawn.program, common_exposure, drawn.note, slices=drawn.slices))
    return models


def _psnr_in_words(file: Loaded, btf: BTF, show: Progress) -> str:
    """The number that decides, as a record has it: the mean display PSNR of a file at the deciding pairs of its BTF."""
    workbench = Workbench(btf, btf.name, metrics=(PSNR,))
    scores = workbench.scorer.score(workbench.deciding, Slices(workbench, file.material, show).slice)
    groups = {deciding_group(workbench.groups): workbench.deciding}
    summary = summarise(scores, btf.wo, btf.wi, groups)
    pairs = "held-out pairs" if "heldout" in groups else "all pairs"
    return f"{stats_of({'scores': summary}, PSNR)['mean']:.2f} dB at {pairs}"


class _Drawn(NamedTuple):
    """What the page draws of a file: a program, the exposure of its picture alone, and a note for the reader."""

    program: Program
    exposure: float
    note: str
    slices: bool  # whether the program interpolates slices


def _drawn(file: Loaded, show: Progress) -> _Drawn:
    """A file's material as a program; if no shader can evaluate it, slices that were decoded from it."""
    try:
        program, exposure = drawable(file.material)
        shader(program, GLSL)
    except InputError as error:
        name = file.header.path.stem
        note = f"{name} is baked to slices at {BAKED} × {BAKED} pairs, interpolated between directions, because {error}"
        program, exposure = drawable_truth(baked(file.material, name, show), show)
        return _Drawn(program, exposure, note, slices=True)
    return _Drawn(program, exposure, f"fitted to lights up to {file.material.lowest_light_deg:.0f}°", slices=False)
