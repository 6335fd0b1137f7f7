"""keep records beside a document, and write its tables from them

`results add RUN FILE` adds the records of a run, or of a run that `verify` wrote, to FILE, a .jsonl file small enough
to commit. `results write DOC` writes the tables of a Markdown file again. Each stands between two comments; the first
one is the command that makes it:

    <!-- neubtf-bench table summary docs/results/quick.jsonl -->
    …
    <!-- end -->

`results check DOC` changes nothing, and fails if a table differs from the output of its command.

examples:
  neubtf-bench results add runs/quick docs/results/quick.jsonl
  neubtf-bench results write docs/results.md README.md
"""

import argparse
import re
import shlex
from pathlib import Path

from bench.errors import FINE, NO, InputError, writable

_BLOCK = re.compile(r"(?P<start><!-- neubtf-bench (?P<words>[^\n]*?) -->\n)(?P<body>.*?)(?P<end><!-- end -->)", re.S)


def arguments(parser: argparse.ArgumentParser) -> None:
    actions = parser.add_subparsers(required=True, metavar="ACTION", dest="action")
    add = actions.add_parser("add", help="add the records of a run to a file to commit")
    add.add_argument("run", type=Path, help="the folder of a run")
    add.add_argument("file", type=Path, metavar="FILE", help="a .jsonl file; its own records stay")
    for action, about in (
        ("write", "write the tables again"),
        ("check", "fail if a table is out of date"),
    ):
        each = actions.add_parser(action, help=about)
        each.add_argument("documents", type=Path, nargs="+", metavar="DOC", help="a Markdown file")


def run(options: argparse.Namespace) -> int:
    if options.action == "add":
        return _add(options.run, options.file)
    stale = [path for path in options.documents if _written(path, options.action == "write")]
    if options.action == "check" and stale:
        names = " ".join(map(str, stale))
        print(f"tables differ from the records: {names}: `neubtf-bench results write {names}` mends them")
        return NO
    return FINE


def _add(run: Path, file: Path) -> int:
    from bench.atomic import write
    from bench.compare.results import published
    from bench.records import load_together

    if file.suffix != ".jsonl":
        raise InputError(f"{file}: the name of a file of records ends in .jsonl")
    whole = load_together([*([file] if file.exists() else []), run])
    text = published(whole)
    with writable(file, "choose another FILE"):
        write(file, text.encode())
    print(f"wrote {file}: {len(whole.jobs)} jobs, {len(text.encode()):,} bytes")
    return FINE


def _written(path: Path, writes: bool) -> bool:
    """Make the tables of a document again, and store it if `writes`; returns whether it changed."""
    from bench.atomic import write

    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read ({error})") from error
    if not _BLOCK.search(text):
        raise InputError(f"{path}: it has no table made by a command: see `neubtf-bench results --help`")
    new = _BLOCK.sub(lambda match: match["start"] + _table(path, match["words"]) + match["end"], text)
    if writes and new != text:
        write(path, new.encode())
        print(f"wrote {path}")
    return new != text


def _table(path: Path, words: str) -> str:
    """The output of a command as Markdown: plain text in a fence, or a Markdown table unchanged."""
    from reports import KINDS, WHY_EMPTY, table_text

    command, *rest = shlex.split(words)
    markdown = rest[-2:] == ["--format", "markdown"]
    rest = rest[:-2] if markdown else rest
    kinds, sources = [word for word in rest if word in KINDS], [word for word in rest if word not in KINDS]
    if command != "table" or len(kinds) > 1 or not sources or any(word.startswith("-") for word in sources):
        raise InputError(f"{path}: `neubtf-bench {words}`: write table [KIND] FILE… [--format markdown]")
    text = table_text(sources, "markdown" if markdown else "text", kinds[0] if kinds else None)
    if kinds and not text.strip():
        text = f"No such table yet: {WHY_EMPTY[kinds[0]]}"
    return f"{text}\n" if markdown else f"```\n{text}\n```\n"
