"""Assembles the board: records and archives of a folder, runs at hand, and what installed codecs say of themselves."""

import tempfile
from collections.abc import Sequence
from pathlib import Path

from bench.codec import described_settings
from bench.codecs import registry
from bench.inputs.errors import InputError
from bench.records import FILE, load_run
from reports.board import write_site
from reports.board.sources import Codec, Publication

_SUITE = """@software{neubtfbench,
  author = {{The NeuBTF bench authors}},
  title = {neubtf-bench: a benchmark of neural codecs of bidirectional texture functions}
}"""  # as CITATION.cff says


def write_board(records: Path, runs: Sequence[Path], site: Path) -> list[Path]:
    """Write the board of the files of records (`*.jsonl`) and archives (`*.zip`) in a folder; returns its pages.

    `runs` are folders of runs, or folders that hold some, whose pictures are shown where that is allowed. `InputError`
    if the folder has no file of records.
    """
    files = sorted(records.glob("*.jsonl"))
    if not files:
        remedy = "`neubtf-bench results add RUN FOLDER/NAME.jsonl` makes such a file of a run, and docs/results of the "
        remedy += "suite's repository has the published ones: give --records FOLDER"
        raise InputError(f"--records {records}: no file of records (*.jsonl) is there: {remedy}")
    with tempfile.TemporaryDirectory(prefix="neubtf-site-") as scratch:
        found = [Publication(path.stem, load_run(path)) for path in files]
        for path in sorted(records.glob("*.zip")):
            from bench.runs.archive import unpack  # loads PyTorch

            found.append(Publication(path.name, unpack(path, Path(scratch) / path.stem), claimed=True))
        at_hand = [Publication(folder.name, load_run(folder)) for folder in _folders(runs)]
        return write_site(found, at_hand, known_codecs(), site)


def _folders(runs: Sequence[Path]) -> list[Path]:
    """The folders of runs: each given one, or those inside it."""
    folders: list[Path] = []
    for run in runs:
        if (run / FILE).exists():
            folders.append(run)
            continue
        inside = sorted(path.parent for path in run.glob(f"*/{FILE}"))
        folders += inside or [run]
    return folders


def known_codecs() -> dict[str, Codec]:
    """What each installed codec says of itself; without its settings where it cannot be imported."""
    found = {}
    for name, entry in registry.codec_entries().items():
        about, cited = registry.describe(entry), registry.reference(entry)
        settings: list[tuple[str, str, str, str]] = []
        try:
            codec = registry.load_codec(name)
        except InputError:
            about += " It cannot be imported here."
        else:
            paper = codec.recipes.get("paper")
            published = {} if paper is None else {"recipe": "paper"} | dict(paper)
            for each in described_settings(codec):
                theirs = str(published.get(each.name, each.default)) if published else ""
                settings.append((each.name, each.meaning, each.default, theirs))
        if not cited["bibtex"] and not registry.from_outside(name):
            cited["bibtex"] = _SUITE  # of this suite, without a paper of its own
        found[name] = Codec(about, f"{entry.value} of {registry.origin(entry)}", **cited, settings=settings)
    return found
