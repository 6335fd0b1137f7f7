"""the conformance test of a codec, yours or ours

examples:
  neubtf-bench check pca
  neubtf-bench check my-codec --set components=4
"""

import argparse

from bench.arguments import assignments
from bench.errors import FINE, NO


def arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("codec")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="a codec setting")


def run(options: argparse.Namespace) -> int:
    from bench.codecs.registry import load_codec
    from bench.conformance.verdicts import check

    failed = 0
    for result in check(load_codec(options.codec)(**assignments(options.set))):
        failed += bool(result.failure)
        word = "FAIL" if result.failure else "n/a " if result.reason else "pass"
        print(f"{word}  {result.name}" + "".join(f": {more}" for more in (result.failure, result.reason) if more))
    print(f"{options.codec}: " + (f"{failed} checks failed" if failed else "every check passed"))
    return NO if failed else FINE
