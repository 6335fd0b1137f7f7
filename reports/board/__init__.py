"""Writes the board: a folder of pages, each whole by itself, from files of records and the pictures of runs at hand.

`index.html`, the front, has the results within budgets of bytes and time. The page of a material has every codec's rows
on it; that of a codec says what it is and where it stands.

The *record* of a job (a codec with its settings on one material, fitted with one seed) is its result, and a *row* is
the job in a table. A *source* of the board is a `Publication`: the records of one file, archive or run. A run *at hand*
is a folder of this machine that also has pictures and codec files. Results are *claimed* if only those who handed them
in have scored them.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from bench.files.atomic import replacing
from reports.board.pages import Board
from reports.board.sources import Codec, Publication, with_files

# How pages are written. Records may hold halves of letters (lone surrogates), which UTF-8 cannot: no reason to fail.
TEXT: Any = {"encoding": "utf-8", "errors": "replace", "newline": "\n"}


def write_site(
    records: Sequence[Publication], runs: Sequence[Publication], codecs: Mapping[str, Codec], folder: Path
) -> list[Path]:
    """Write the pages of some records into a folder, each file whole or not at all; returns them, the front first.

    `runs` are at hand with their files: their pictures are shown where the material's licence is known to permit it,
    and jobs that no records hold are shown beside them. `codecs` has by name what installed codecs say of themselves.
    Pages of an earlier site that are not written anew are removed.
    """
    board = Board(with_files(records, runs), codecs)
    files = []
    for name, pieces in board.pages():
        path = folder / name
        files.append(path)
        with replacing(path) as partial, open(partial, "w", **TEXT) as file:
            file.writelines(pieces)
    for kind in ("codec", "material"):
        for old_page in set(folder.glob(f"{kind}-*.html")) - set(files):
            old_page.unlink()
    return files
