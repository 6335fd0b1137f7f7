"""Writes the board: a folder of pages, each whole by itself, from files of records and the pictures of runs at hand.

`index.html`, the front, has the results within budgets of bytes and time. The page of a material has every codec's rows
on it; that of a codec says what it is and has every row of it.

`reports.board.sources` says what a board is made of.
"""

import tempfile
from collections.abc import Callable, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Any

from bench.files.atomic import refuse_other_kind, replacing
from bench.inputs.errors import InputError
from bench.records import FILE, Run, load_run
from reports.board.pages import Board
from reports.board.sources import Codec, Publication, with_files

# How pages are written. Names of files may hold halves of letters (lone surrogates), which UTF-8 cannot.
TEXT: Any = {"encoding": "utf-8", "errors": "replace", "newline": "\n"}
HEAD = 10_000  # bytes of a page, within which its mark stands
RECORDS, ARCHIVE = ".jsonl", ".zip"  # how the names of files of records and of archives end


def write_board(
    places: Sequence[Path], codecs: Mapping[str, Codec], unpack: Callable[[Path, Path], Run], folder: Path
) -> list[Path]:
    """Write the board of what lies at some places: files of records, archives, folders of runs, and folders of these.

    `unpack` unpacks an archive into a folder and reads its run; the rest is as for `write_site`. `InputError` for a
    place without any of them.
    """
    records: list[Publication] = []
    runs: list[Publication] = []
    # Pages read the files of an unpacked run, so it is kept until they are written.
    with tempfile.TemporaryDirectory(prefix="neubtf-site-") as scratch:
        for path in chain.from_iterable(map(_sources_at, places)):
            if path.suffix == ARCHIVE:
                run = unpack(path, Path(scratch) / str(len(records)))
                records.append(Publication(path.name, run, claimed=True))
            elif path.suffix == RECORDS:
                records.append(Publication(path.stem, load_run(path)))
            else:
                runs.append(Publication(path.resolve().name, load_run(path)))
        return write_site(records, runs, codecs, folder)


def _sources_at(place: Path) -> list[Path]:
    """The sources at a place: itself, if it is a file or a run; of another folder its files of records and archives or,
    without any, the runs in it."""
    if not place.is_dir() or (place / FILE).exists():
        return [place]
    files = [*sorted(place.glob(f"*{RECORDS}")), *sorted(place.glob(f"*{ARCHIVE}"))]
    inside = files or sorted(path.parent for path in place.glob(f"*/{FILE}"))
    if not inside:
        remedy = "`neubtf-bench results add RUN FOLDER/NAME.jsonl` makes a file of records of a run"
        raise InputError(f"{place}: no run, no file of records (*.jsonl) and no archive (*.zip) is there: {remedy}")
    return inside


def write_site(
    records: Sequence[Publication], runs: Sequence[Publication], codecs: Mapping[str, Codec], folder: Path
) -> list[Path]:
    """Write the pages of some records into a folder, each file whole or not at all; returns them, the front first.

    `runs` are at hand with their files: their pictures are shown where the material's licence is known to permit it,
    and jobs that no records hold are shown beside them. `codecs` has by name what installed codecs say of themselves.
    Pages of an earlier site that are not written anew are removed. `InputError` if a file that is no such page has the
    name of one.
    """
    board = Board(with_files(records, runs), codecs)
    files = []
    for name, pieces in board.pages():
        path = folder / name
        refuse_other_kind(path, "", _is_page)
        files.append(path)
        with replacing(path) as partial, open(partial, "w", **TEXT) as file:
            file.writelines(pieces)
    for kind in ("codec", "material"):
        for old_page in set(folder.glob(f"{kind}-*.html")) - set(files):
            if _is_page(old_page):
                old_page.unlink()
    return files


def _is_page(path: Path) -> bool:
    """Whether a file is a page that this program wrote, by the mark in its head."""
    with open(path, "rb") as file:
        return b'<meta name="generator" content="neubtf-bench">' in file.read(HEAD)
