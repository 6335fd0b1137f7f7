"""show what a codec file, a BTF or the cache of rendered materials holds

examples:
  neubtf-bench info satin.nbtf
  neubtf-bench info material.btf --picture material.png
  neubtf-bench info satin.nbtf --json satin.json
  neubtf-bench info --cache
"""

import argparse
from pathlib import Path

from bench.cli.commands import json_option, json_writer, read_as, reading_options, say_line
from bench.cli.console import fields_text, file_fields
from bench.codecs.container import MAGIC, SUFFIX, read_header
from bench.data.described import btf_fields
from bench.data.open import open_named
from bench.data.portrait import draw, look
from bench.files.atomic import PNG, begins, cache_dir, cached_files, clear_cache, refuse_other_kind
from bench.inputs.errors import FINE, InputError


def arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command to its parser."""
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument("path", nargs="?", help="a codec file, a built-in material or the path of a BTF")
    what.add_argument("--cache", action="store_true", help="show the cache of rendered materials and scratch files")
    what.add_argument("--remove-cache", action="store_true", help="remove every cached file, but no trained network")
    reading_options(parser)
    parser.add_argument("--picture", type=Path, metavar="OUT.png", help="draw a BTF: directions, values, contact sheet")
    json_option(parser)


def run(options: argparse.Namespace) -> int:
    """Print what a codec file, a BTF or the cache holds, and draw a BTF if asked to; returns the exit code."""
    if (options.cache or options.remove_cache) and (options.picture or options.json):
        raise InputError("info: --picture and --json are of a codec file or a BTF: leave them out, or give its path")
    if options.remove_cache:
        count, size = clear_cache()
        say_line(f"removed {count} files, {size / 1e6:.1f} MB, from {cache_dir()}")
        return FINE
    if options.cache:
        files = cached_files()
        say_line(f"{cache_dir()}: {len(files)} files, {sum(path.lstat().st_size for path in files) / 1e6:.1f} MB")
        return FINE
    write_json = json_writer(options.json)
    path = Path(options.path)
    if path.is_file() and _is_codec_file(path):
        if options.picture:
            raise InputError(f"{path}: --picture draws a BTF, and this is a codec file: decode it and draw the result")
        file = file_fields(read_header(path))
        print(fields_text(file))
        write_json(file)
        return FINE

    if options.picture:
        refuse_other_kind(options.picture, ".png", begins(PNG))
    portrait = look(open_named(options.path, read_as(options)))
    btf = btf_fields(portrait)
    print(fields_text(btf))
    if options.picture:
        draw(portrait, options.picture)
        say_line(f"wrote {options.picture}")
    write_json(btf)
    return FINE


def _is_codec_file(path: Path) -> bool:
    """Whether a file is a codec file, by its name or by its first bytes."""
    return path.suffix == SUFFIX or begins(MAGIC)(path)
