"""test whether a codec, yours or ours, keeps the rules

examples:
  neubtf-bench check pca
  neubtf-bench check my-codec --set half=false
"""

import argparse

from bench.cli.commands import assignments
from bench.cli.console import Console
from bench.conformance.verdicts import check, codec_to_check, planned
from bench.inputs.errors import FINE, NO


def arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command to its parser."""
    parser.add_argument("codec")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="a codec setting")


def run(options: argparse.Namespace) -> int:
    """Run the checks and print a line for each; returns `FINE`, or `NO` if one failed."""
    failed = tried = 0
    with Console() as console:
        codec = codec_to_check(options.codec, assignments(options.set))
        for result in check(codec, show=console.show):
            tried += 1
            if result.failure:
                failed += 1
                word = "FAIL"
            elif result.reason:
                word = "n/a "  # as wide as the others
            else:
                word = "pass"
            remarks = [text for text in (result.failure, result.reason, result.note) if text]
            console.say(": ".join([f"{word}  {result.name}", *remarks]))
        rest = planned() - tried
        untried = f", and the {rest} after them were not tried" if rest else ""
        verdict = f"{failed} of {tried} checks failed{untried}" if failed else "every check passed"
        console.say(f"{options.codec}: {verdict}")
    return NO if failed else FINE
