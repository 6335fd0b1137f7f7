"""show the cache of rendered materials and scratch files, or remove it

examples:
  neubtf-bench cache
  neubtf-bench cache --clear
"""

import argparse

from bench.cli.commands import say_line
from bench.files.atomic import cache_dir, cached_files, clear_cache
from bench.inputs.errors import FINE


def arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--clear", action="store_true", help="remove every cached file, but no trained network")


def run(options: argparse.Namespace) -> int:
    """Print what the cache holds, or remove it; returns the exit code."""
    if options.clear:
        count, size = clear_cache()
        say_line(f"removed {count} files, {size / 1e6:.1f} MB, from {cache_dir()}")
        return FINE
    files = cached_files()
    size = sum(path.lstat().st_size for path in files)
    say_line(f"{cache_dir()}: {len(files)} files, {size / 1e6:.1f} MB")
    return FINE
