"""the conformance test of a codec, yours or ours

examples:
  neubtf-bench check pca
  neubtf-bench check my-codec --set components=4
"""

import argparse

from bench.commands import assignments
from bench.errors import FINE, NO


def arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("codec")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="a codec setting")


def run(options: argparse.Namespace) -> int:
    from bench.conformance.verdicts import check, of
    from bench.console import Console

    failed = 0
    with Console() as console:
        codec = of(options.codec, assignments(options.set))
        for result in check(codec, show=console.show):
            failed += bool(result.failure)
            word = "FAIL" if result.failure else "n/a " if result.reason else "pass"
            said = (text for text in (result.failure, result.reason, result.note) if text)
            console.say(f"{word}  {result.name}" + "".join(f": {text}" for text in said))
        verdict = f"{failed} checks failed, and those after them were not tried" if failed else "every check passed"
        console.say(f"{options.codec}: {verdict}")
    return NO if failed else FINE
