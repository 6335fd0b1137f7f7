"""what a scene asks of a material: which texels, how large, seen and lit from where

The scene is a TOML file (see docs/scenes.md) or one that ships with the suite, by name.
"""

import argparse
from pathlib import Path

from bench.exits import FINE


def arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("scene", help="a scene of the suite, or a TOML file")
    parser.add_argument("--queries", type=int, default=250_000, help="at most (default: 250000, no more than 1000000)")
    parser.add_argument("--seed", type=int, default=0, help="of the samples of an environment (default: 0)")
    parser.add_argument("-o", "--out", type=Path, required=True, help="the demand, .npz; a .png is drawn beside it")


def run(options: argparse.Namespace) -> int:
    from bench.console import Console
    from bench.demand import portrait
    from bench.demand.collect import checked, collect
    from bench.demand.scene import named_scene
    from bench.demand.text_scene import TextScene

    checked(options.queries, options.out)
    with Console() as console:
        demand = collect(TextScene(named_scene(options.scene)), options.queries, options.seed, console.show)
        demand.save(options.out)
        picture = options.out.with_suffix(".png")
        portrait.draw(demand, picture)
        console.say(portrait.summarise(demand).text())
        console.say(f"wrote {options.out} ({options.out.stat().st_size / 1e6:.1f} MB) and {picture}")
    return FINE
