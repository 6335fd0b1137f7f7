"""Writes the board: a folder of pages, each whole by itself, from files of records and the pictures of runs at hand.

`index.html` has the budgets, a page a material every codec's rows on it, a page a codec what it is and where it stands.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from bench.files.atomic import replacing
from reports.board.pages import Board
from reports.board.sources import Codec, Publication, with_files

TEXT: Any = {"encoding": "utf-8", "errors": "replace", "newline": "\n"}  # halves of letters are no reason to fail


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
