"""list codecs, materials, suites, metrics and readers, or the settings of one codec

examples:
  neubtf-bench list
  neubtf-bench list codecs pca
  neubtf-bench list codecs pca --json pca.json
"""

import argparse
from typing import Any

from bench.cli.commands import json_option, json_writer, say_line
from bench.inputs.errors import FINE, InputError


def arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command to its parser."""
    kinds = ["codecs", "materials", "suites", "metrics", "readers"]
    parser.add_argument("what", nargs="?", choices=kinds, help="only these")
    parser.add_argument("name", nargs="?", help="the name of a codec, to list its settings, defaults and limits")
    json_option(parser)


def run(options: argparse.Namespace) -> int:
    """Print the listings, or the settings of one codec; returns the exit code."""
    from bench import metrics
    from bench.codecs import registry
    from bench.data import materials, readers
    from bench.runs import suite

    write_json = json_writer(options.json)
    if options.name:  # one codec in full
        if options.what != "codecs":
            raise InputError(f"list {options.what} {options.name}: only codecs have settings: list codecs NAME")
        codec = _codec_fields(options.name)
        _say_codec(codec)
        write_json(codec)
        return FINE
    codecs = {name: registry.listed(entry) for name, entry in sorted(registry.codec_entries().items())}
    listings: dict[str, dict[str, str]] = {
        "codecs": codecs,
        "materials": materials.describe(),
        "suites": {name: suite.parse_suite(name, text).description for name, text in suite.builtin_suites().items()},
        "metrics": metrics.listed(),
        "readers": readers.listed(),
    }
    if options.what:
        listings = {options.what: listings[options.what]}
    for title, each in listings.items():
        width = max(map(len, each))
        print(f"{title}:")
        for name, text in each.items():
            say_line(f"  {name:<{width}}  {text}")
    write_json(listings)
    return FINE


def _codec_fields(name: str) -> dict[str, Any]:
    """A codec with its settings, and the settings of the network that it shares over materials if it has one."""
    from bench.codec import described_settings
    from bench.codecs.registry import describe, entry_of, load_codec
    from bench.inputs.plugins import origin
    from bench.inputs.settings import Setting, descriptions

    def by_name(settings: list[Setting]) -> dict[str, dict[str, str]]:
        """The fields of each setting, by its name."""
        return {each.name: {"default": each.default, "kind": each.kind, "meaning": each.meaning} for each in settings}

    codec = load_codec(name)
    entry = entry_of(name)
    fields: dict[str, Any] = {
        "codec": name,
        "version": codec.version,
        "recipe_versions": codec.recipe_versions,
        "package": origin(entry),
        "description": describe(entry),
        "settings": by_name(described_settings(codec)),
    }
    if codec.network:
        fields["network_settings"] = by_name(descriptions(codec.network.Settings))
    return fields


def _say_codec(codec: dict[str, Any]) -> None:
    """Print a codec by its `_codec_fields`."""
    name = codec["codec"]
    versions = [f"version {codec['version']}"]
    versions += [f"recipe={recipe} {version}" for recipe, version in codec["recipe_versions"].items()]
    say_line(f"{name}, {', '.join(versions)}, of {codec['package']}: {codec['description']}")
    _say_settings(codec["settings"])
    if "network_settings" in codec:
        say_line(
            f"settings of the network that it shares over materials (neubtf-bench pretrain {name} --set KEY=VALUE):"
        )
        _say_settings(codec["network_settings"])


def _say_settings(settings: dict[str, dict[str, str]]) -> None:
    """Print one line for each setting, in aligned columns."""
    rows = [("setting", "default", "must be", "meaning")]
    rows += [(name, each["default"], each["kind"], each["meaning"]) for name, each in settings.items()]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows:
        cells = [f"{cell:<{width}}" for cell, width in zip(row, widths, strict=True)]
        say_line(f"  {'  '.join(cells)}".rstrip())
