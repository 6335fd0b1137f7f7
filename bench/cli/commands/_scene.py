"""The options `--scene` and `--bsdf`: a scene whose demand, the queries of its pictures, judges or fits codecs."""

import argparse
from pathlib import Path

from bench.cli.console import Console
from bench.demand import overview
from bench.demand.collect import QUERIES, Caster, collect
from bench.demand.demand import load
from bench.demand.scene import named_scene
from bench.demand.text_scene import TextScene
from bench.files.atomic import make_folder
from bench.inputs.errors import InputError, installed


def scene_options(parser: argparse.ArgumentParser, words: str) -> None:
    """Add the options of a scene; `words` say what it is for."""
    kinds = "a scene of the suite, a TOML file, Mitsuba's XML, or the .npz that was written for one of these"
    parser.add_argument("--scene", help=f"{words}: {kinds}")
    parser.add_argument("--bsdf", metavar="ID", help="the id of the BSDF that is the material, in a Mitsuba scene")


def demand_file(options: argparse.Namespace, folder: Path, console: Console) -> Path | None:
    """The file of the demand of the scene that the options name; None without a scene.

    A demand that is no file yet is collected, written to `folder` as `demand-SCENE.npz`, drawn beside it and described.
    """
    if options.scene is None:
        if options.bsdf:
            raise InputError("--bsdf: only for a Mitsuba --scene: give it, or leave --bsdf out")
        return None
    given = Path(options.scene)
    if given.suffix == ".npz":
        refuse_mitsuba_options(options, "bsdf")  # the file has the queries of one material already
        load(given)  # a bad one is said before anything is fitted
        return given
    scene = _scene(options)
    demand = collect(scene, QUERIES, show=console.show)
    make_folder(folder)
    file = folder / f"demand-{scene.name}.npz"
    picture = file.with_suffix(".png")
    demand.save(file)
    overview.draw(demand, picture)
    console.say(f"{overview.summarise(demand).text()}\nwrote {file} and {picture}")
    return file


def is_mitsuba(scene: str) -> bool:
    """Whether the name of a scene is that of a Mitsuba file."""
    return scene.endswith(".xml")


def refuse_mitsuba_options(options: argparse.Namespace, *names: str) -> None:
    """Raise `InputError` for the first of these options that is given: they are for Mitsuba scenes alone."""
    for name in names:
        if getattr(options, name) is not None:
            raise InputError(f"--{name}: only for a Mitsuba scene, an .xml file: {options.scene} has one material")


def _scene(options: argparse.Namespace) -> Caster:
    """The scene that the options name: one of the suite or of a TOML file, or one of Mitsuba by its ending .xml."""
    path = Path(options.scene)
    if not is_mitsuba(options.scene):
        refuse_mitsuba_options(options, "bsdf")
        return TextScene(named_scene(options.scene))
    if not path.is_file():
        raise InputError(f"{path}: there is no such file: check the path")
    if not options.bsdf:
        raise InputError(f"{path}: say which BSDF is the material, with --bsdf ID")
    with installed(f"{path}: needs Mitsuba 3: pip install 'neubtf-bench[mitsuba]', or describe the scene in TOML"):
        from bench.demand.mitsuba.scene import MitsubaScene
    return MitsubaScene(path, options.bsdf)
