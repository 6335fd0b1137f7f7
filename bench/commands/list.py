"""list codecs, materials, suites and metrics"""

import argparse

from bench.exits import FINE


def arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("what", nargs="?", choices=["codecs", "materials", "suites", "metrics"])


def run(options: argparse.Namespace) -> int:
    from bench import metrics
    from bench.codecs import registry
    from bench.data import materials
    from bench.runs import suite

    listings: dict[str, dict[str, str]] = {
        "codecs": {name: registry.describe(entry) for name, entry in sorted(registry.codec_entries().items())},
        "materials": materials.describe(),
        "suites": {name: suite.parse_suite(name, text).description for name, text in suite.builtin_suites().items()},
        "metrics": {
            m.name: f"{m.unit}, {m.direction} is better, {m.space}, version {m.version}" for m in metrics.registered()
        },
    }
    for title, entries in listings.items():
        if options.what in (None, title):
            width = max(map(len, entries))
            print(f"{title}:")
            print("\n".join(f"  {name:<{width}}  {text}" for name, text in entries.items()))
    return FINE
