"""pack a run for others, verify theirs, keep records beside a document, write its tables

`results add RUN FILE` adds the records of a run, or of a run that `results verify` wrote, to FILE, a .jsonl file small
enough to commit. `results write DOC` writes the tables of a Markdown file again. Each stands between two comments; the
first one is the command that makes it:

    <!-- neubtf-bench table summary docs/results/quick.jsonl -->
    …
    <!-- end -->

`results check DOC` changes nothing, and fails if a table differs from the output of its command.

`results pack RUN -o FILE` packs the records and codec files of a run into an archive. Anyone who has it can decode and
score every file again, so nobody has to trust you. The last lines printed are a text to hand it in with.

`results verify ARCHIVE` scores the files of an archive here, and says which numbers agree. Nothing in an archive is run
or installed. A codec from elsewhere must be installed here first; otherwise its jobs are listed with version and hash,
but not verified. Numbers that were measured here become a run, which `table`, `compare` and `results add` read; it has
no numbers that are only claimed, such as the seconds of a fit. Measured data must be under NEUBTF_DATA, or where
--material says.

examples:
  neubtf-bench results pack runs/mine -o mine.zip
  neubtf-bench results pack runs/quick --codec pca -o pca.zip
  neubtf-bench results verify mine.zip
  neubtf-bench results verify mine.zip --material carpet07.btf=data/carpet07.btf --out runs/theirs
  neubtf-bench results add runs/mine docs/results/quick.jsonl
  neubtf-bench results add runs/quick docs/results/quick.jsonl
  neubtf-bench results write docs/results.md README.md
"""

import argparse
import re
import shlex
from collections.abc import Iterator
from pathlib import Path

from bench.cli.commands import _archives, say_line, table
from bench.compare.publishing import published
from bench.compare.reference import check_whole, names_its_runs
from bench.files.atomic import locked, write
from bench.inputs.errors import FINE, NO, InputError, readable, writable
from bench.records import FILE, load_run, load_together
from reports import WHY_EMPTY, table_text

_START = "<!-- neubtf-bench "
_BLOCK = re.compile(
    rf"(?P<start>{_START}(?P<words>[^\n]*?) -->\n)(?P<body>(?:(?!{_START}).)*?)(?P<end><!-- end -->)", re.S
)


def arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command to its parser."""
    actions = parser.add_subparsers(required=True, metavar="ACTION", dest="action")
    add = actions.add_parser("add", help="add the records of a run to a file to commit")
    add.add_argument("run", type=Path, help="the folder of a run")
    add.add_argument("file", type=Path, metavar="FILE", help="a .jsonl file; its own records stay")
    rewrite = actions.add_parser("write", help="write the tables again")
    rewrite.add_argument("documents", type=Path, nargs="*", metavar="DOC", help="a Markdown file")
    check = actions.add_parser("check", help="fail if a table is out of date")
    check.add_argument("documents", type=Path, nargs="+", metavar="DOC", help="a Markdown file")
    _archives.pack_arguments(actions.add_parser("pack", help="pack a run into an archive that others can verify"))
    _archives.verify_arguments(actions.add_parser("verify", help="score the files of an archive here"))


def run(options: argparse.Namespace) -> int:
    """Do the action; returns `NO` if a checked table is out of date or a verified number differs."""
    if options.action == "pack":
        return _archives.pack_run(options)
    if options.action == "verify":
        return _archives.verify_archive(options)
    if options.action == "add":
        return _add_records(options.run, options.file)
    if not options.documents:
        raise InputError("results write: name a Markdown file")
    if options.action == "write":
        for path, text in list(_out_of_date(options.documents)):  # all or, after an error in one, none
            write(path, text.encode())
            say_line(f"wrote {path}")
        return FINE
    names = shlex.join(str(path) for path, _ in _out_of_date(options.documents))
    if names:
        say_line(f"tables differ from the records: {names}: `neubtf-bench results write {names}` mends them")
        return NO
    return FINE


def _add_records(run: Path, file: Path) -> int:
    """Add the records of a run to a file, where they replace those of the same jobs; returns the exit code."""
    if file.suffix != ".jsonl":
        raise InputError(f"{file}: the name of a file of records ends in .jsonl")
    if file.name == FILE:  # what a run keeps for itself would be lost
        raise InputError(f"{file}: the records of a run have this name: give another one")
    with writable(file, "choose another FILE"), locked(file):  # another process may add to it
        sources = [run]
        if file.exists():
            before = load_run(file)
            check_whole(before)  # its damaged records would be lost
            if before.starts and not names_its_runs(before):
                raise InputError(f"{file}: it is a reference: give another FILE")
            sources = [file, run]  # of jobs that both have, those of the later source count
        whole = load_together(sources)
        text = published(whole)
        write(file, text.encode())
    say_line(f"wrote {file}: {len(whole.jobs)} jobs, {len(text.encode()):,} bytes")
    return FINE


def _out_of_date(documents: list[Path]) -> Iterator[tuple[Path, str]]:
    """The documents of which a table differs from what its command makes now, each with its new text."""
    for path in documents:
        with readable(str(path), "name a Markdown file"):
            text = path.read_bytes().decode()
        line_end = "\r\n" if "\r\n" in text else "\n"
        new = _with_new_tables(path, text.replace("\r\n", "\n")).replace("\n", line_end)
        if new != text:
            yield path, new


def _with_new_tables(path: Path, text: str) -> str:
    """The text of a document with its tables as their commands make them now. `InputError` if it has none, and for one
    without its end."""
    starts = {block.start() for block in _BLOCK.finditer(text)}
    for start in re.finditer(_START, text):
        if start.start() not in starts:
            line = text.count("\n", 0, start.start()) + 1
            raise InputError(f"{path}, line {line}: this table has no `<!-- end -->` before the next one: add it")
    if not starts:
        raise InputError(f"{path}: it has no table made by a command: see `neubtf-bench results --help`")

    def made_again(block: re.Match[str]) -> str:
        """The block with the table that its command makes now."""
        return block["start"] + _printed_table(path, block["words"]) + block["end"]

    return _BLOCK.sub(made_again, text)


def _table_options(path: Path, words: str) -> tuple[argparse.Namespace, str | None, list[Path]]:
    """The options, the kind (None: all) and the files of the command `words` of a document. `InputError` unless it is
    a `table` of at most one kind and of files, as text or Markdown."""
    try:
        command, *rest = shlex.split(words)
    except ValueError as error:  # an open quote, or no word at all
        raise InputError(f"{path}: `neubtf-bench {words}` is no command: {error}") from error
    parser = argparse.ArgumentParser(add_help=False, exit_on_error=False)
    table.arguments(parser)
    try:
        options, unknown = parser.parse_known_args(rest)
    except argparse.ArgumentError as error:
        raise InputError(f"{path}: `neubtf-bench {words}`: {error}") from error
    kinds, sources = table.kinds_and_places(options.what)
    if command != "table" or len(kinds) > 1 or not sources or unknown or options.format not in ("text", "markdown"):
        raise InputError(f"{path}: `neubtf-bench {words}`: write table [KIND] FILE… [--format markdown]")
    return options, kinds[0] if kinds else None, sources


def _printed_table(path: Path, words: str) -> str:
    """What the command `words` of a document prints, as Markdown: text in a fence, or a Markdown table as it is."""
    options, kind, sources = _table_options(path, words)
    try:
        if kind == "parameters":
            text = table.parameters_table(sources, options.format, table.choice(options))
        else:
            text = table_text(sources, options.format, kind, table.choice(options), options.all)
    except InputError as error:
        raise InputError(f"{path}: `neubtf-bench {words}`: {error}") from error
    if kind and not text.strip():
        text = f"No such table yet: {WHY_EMPTY[kind]}"
    return f"{text}\n" if options.format == "markdown" else f"```\n{text}\n```\n"
