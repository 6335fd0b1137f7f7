"""list codecs, materials, suites, metrics and readers, or the settings of one codec

examples:
  neubtf-bench list
  neubtf-bench list codecs pca
"""

import argparse

from bench.cli.commands import say_line
from bench.inputs.errors import FINE, InputError


def arguments(parser: argparse.ArgumentParser) -> None:
    kinds = ["codecs", "materials", "suites", "metrics", "readers"]
    parser.add_argument("what", nargs="?", choices=kinds, help="only these")
    parser.add_argument("name", nargs="?", help="the name of a codec, to list its settings, defaults and limits")


def run(options: argparse.Namespace) -> int:
    """Print the listings, or the settings of one codec; returns the exit code."""
    from bench import metrics
    from bench.cli.console import Console
    from bench.codecs import registry
    from bench.data import materials, readers
    from bench.runs import suite

    if options.name:  # one codec in full
        return _settings(options.what, options.name)
    codecs = {}
    with Console() as console:
        entries = sorted(registry.codec_entries().items())
        outside = [name for name, _ in entries if registry.from_outside(name)]
        for name, entry in entries:
            # Each is tried in a process of its own, which imports PyTorch and so takes a while.
            if name in outside:
                console.show("trying codecs of other packages", outside.index(name), len(outside))
            codecs[name] = registry.listed(entry)
        if outside:
            console.show("trying codecs of other packages", len(outside), len(outside))
    listings: dict[str, dict[str, str]] = {
        "codecs": codecs,
        "materials": materials.describe(),
        "suites": {name: suite.parse_suite(name, text).description for name, text in suite.builtin_suites().items()},
        "metrics": metrics.listed(),
        "readers": readers.listed(),
    }
    for title, each in listings.items():
        if options.what in (None, title):
            width = max(map(len, each))
            print(f"{title}:")
            for name, text in each.items():
                say_line(f"  {name:<{width}}  {text}")
    return FINE


def _settings(what: str, name: str) -> int:
    """Print the settings of a codec, and of the network that it shares over materials if it has one."""
    from bench.codec import described_settings
    from bench.codecs.registry import codec_entries, describe, load_codec, origin
    from bench.inputs.settings import Setting, descriptions

    def table(settings: list[Setting]) -> None:
        """Print one line for each setting, in aligned columns."""
        head = ("setting", "default", "must be", "meaning")
        rows = [head, *((each.name, each.default, each.kind, each.meaning) for each in settings)]
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        for row in rows:
            cells = [f"{cell:<{width}}" for cell, width in zip(row, widths, strict=True)]
            say_line(f"  {'  '.join(cells)}".rstrip())

    if what != "codecs":
        raise InputError(f"list {what} {name}: only codecs have settings: list codecs NAME")
    codec = load_codec(name)
    entry = codec_entries()[name]
    versions = [f"version {codec.version}"]
    versions += [f"recipe={recipe} {version}" for recipe, version in codec.recipe_versions.items()]
    say_line(f"{name}, {', '.join(versions)}, of {origin(entry)}: {describe(entry)}")
    table(described_settings(codec))
    if codec.network:
        say_line(
            f"settings of the network that it shares over materials (neubtf-bench pretrain {name} --set KEY=VALUE):"
        )
        table(descriptions(codec.network.Settings))
    return FINE
