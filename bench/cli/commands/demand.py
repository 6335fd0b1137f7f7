"""find which texels, footprints and directions of a material a scene looks up

The scene is a TOML file (see docs/scenes.md), the name of a scene that ships with the suite, or a Mitsuba 3 XML file.

examples:
  neubtf-bench demand table-top -o table-top.npz
  neubtf-bench demand room.xml --bsdf sofa -o sofa.npz
"""

import argparse
from pathlib import Path

from bench.cli.commands import seed_option
from bench.cli.console import Console
from bench.demand import overview
from bench.demand.collect import Caster, checked, collect
from bench.demand.scene import named_scene
from bench.demand.text_scene import TextScene
from bench.inputs.errors import FINE, InputError, installed


def arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command to its parser."""
    add = parser.add_argument
    add("scene", help="a scene of the suite, a TOML file, or an XML file of Mitsuba 3")
    add("--bsdf", metavar="ID", help="the id of the BSDF that is the material, in a Mitsuba scene")
    add("--queries", type=int, default=250_000, help="the most queries to keep, up to 1000000 (default: 250000)")
    add("--seed", type=seed_option, default=0, help="seed of the samples of an environment (default: 0)")
    add("-o", "--out", type=Path, required=True, help="the .npz file to write; a .png is drawn beside it")


def run(options: argparse.Namespace) -> int:
    """Collect the demand of a scene, write it, and draw it beside; returns the exit code."""
    checked(options.queries, options.out)
    scene = _scene(options)
    with Console() as console:
        demand = collect(scene, options.queries, options.seed, console.show)
        demand.save(options.out)
        picture = options.out.with_suffix(".png")
        overview.draw(demand, picture)
        console.say(overview.summarise(demand).text())
        console.say(f"wrote {options.out} ({options.out.stat().st_size / 1e6:.1f} MB) and {picture}")
    return FINE


def _scene(options: argparse.Namespace) -> Caster:
    """The scene that the options name: one of the suite or of a TOML file, or one of Mitsuba by its ending .xml."""
    path = Path(options.scene)
    if path.suffix != ".xml":
        if options.bsdf:
            raise InputError(f"--bsdf: only for a Mitsuba scene, an .xml file: {path} has one material")
        return TextScene(named_scene(options.scene))
    if not path.is_file():
        raise InputError(f"{path}: there is no such file: check the path")
    if not options.bsdf:
        raise InputError(f"{path}: say which BSDF is the material, with --bsdf ID")
    with installed(f"{path}: needs Mitsuba 3: pip install 'neubtf-bench[mitsuba]', or describe the scene in TOML"):
        from bench.demand.mitsuba.scene import MitsubaScene
    return MitsubaScene(path, options.bsdf)
