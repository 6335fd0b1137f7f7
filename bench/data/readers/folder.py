"""Reads and writes a folder of pictures with `pairs.csv`, the simplest exchange format.

`pairs.csv` lists one picture a line, with the view (o) and the light (i) it was taken at: the columns `file,
theta_o_deg, phi_o_deg, theta_i_deg, phi_i_deg`, in any order, and optionally `split` (`train` or `heldout`, which no
codec may train on). `btf.json`, which `write_folder` adds, keeps name and provenance, says whether the picture is
periodic (repeats without a seam), and says that the angles are degrees.
"""

import csv
import io
import json
import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from bench.btf import BTF, Array
from bench.data.readers.checks import (
    AS_STORED,
    directions_of_degrees,
    in_degrees,
    provenance_of,
    unit_note,
    view_major,
)
from bench.data.readers.files import Candidate, FolderFiles
from bench.data.readers.pictures import PictureSource
from bench.directions.hemisphere import to_degrees
from bench.files.archive import inside
from bench.files.atomic import make_folder
from bench.files.exr import write_exr
from bench.inputs.errors import InputError, readable

LIST, NOTES = "pairs.csv", "btf.json"
ANGLES = ("theta_o_deg", "phi_o_deg", "theta_i_deg", "phi_i_deg")
COLUMNS = ("file", *ANGLES)
MAX_LIST = 256 << 20  # the most bytes of `pairs.csv`, and of `btf.json`


def opened(seen: Candidate) -> BTF | None:
    """The BTF of a folder with `pairs.csv`, or of that list, or None; pairs sorted by view, then by light.

    Radiance is linear Rec. 709 f_r · cos θ_i as the pictures hold it: EXR and .hdr as stored, 8- and 16-bit codes
    decoded as sRGB. Raises `InputError` that names `pairs.csv` and the row of any fault.
    """
    path = _folder_of(seen)
    if path is None:
        return None
    rows = _read_rows(path / LIST)
    notes = _notes(path / NOTES)
    stated = np.array([_stated_angles(path, number, row) for number, row in rows])  # (N, 4)
    # What the user says comes first. A folder that the suite wrote says itself that its angles are degrees, so they may
    # be small.
    unit = seen.angles or str(notes.get("angles", ""))
    # The columns are θ_o, φ_o, θ_i, φ_i. All θ and all φ go in together, because both sides have the same unit.
    thetas, phis = in_degrees(stated[:, ::2], stated[:, 1::2], str(path / LIST), unit)
    angles = np.stack([thetas, phis], -1).reshape(len(rows), 4)  # the columns as before

    labels = [f"{path / LIST}, line {number}" for number, _ in rows]
    names = [inside(row["file"], label) for label, (_, row) in zip(labels, rows, strict=True)]
    wo, wi = directions_of_degrees(angles, labels.__getitem__, ("_o_deg", "_i_deg"))
    heldout = _heldout(path, rows)
    order = view_major(wo, wi)  # of the list's lines, which may stand in any order
    source = PictureSource(FolderFiles(path), [names[i] for i in order], [labels[i] for i in order])

    colour = "8- and 16-bit codes decoded as sRGB to linear Rec. 709; EXR and .hdr as stored"
    provenance = provenance_of("folder", colour, AS_STORED)
    provenance |= notes.get("provenance", {})  # what the folder says of itself replaces these words
    provenance |= source.conversions() | unit_note(seen.angles)
    name = str(notes.get("name", path.resolve().name))
    periodic = bool(notes.get("periodic", False))
    mask = None if heldout is None else heldout[order]
    return BTF(name, wo[order], wi[order], source, heldout=mask, periodic=periodic, provenance=provenance)


def _folder_of(seen: Candidate) -> Path | None:
    """The folder with a list that is given, or that holds the list that is given; None for anything else.

    `InputError` for a list with another name, such as one in another letter case, like `Pairs.csv`.
    """
    if not seen.is_folder:
        if ANGLES[0] not in seen.first_line.lower():  # of a header of such a list
            return None
        if seen.path.name != LIST:  # else the `pairs.csv` beside it would be read in its place
            raise InputError(f"{seen.path}: it is a list of pairs under another name: call it {LIST}")
        return seen.path.parent
    if (seen.path / LIST).is_file():
        return seen.path
    for name in os.listdir(seen.path):
        if name.lower() == LIST:
            raise InputError(f"{seen.path / name}: its name differs in letter case: call the list {LIST}")
    return None


def _read_rows(path: Path) -> list[tuple[int, dict[str, str]]]:
    """(line number, column → cell) of each line of `pairs.csv` below the header; lines without any text are left out.

    `InputError` if the list is too large, cannot be read, has no picture, or lacks a column or a cell.
    """
    with readable(str(path), "save it as plain comma-separated text in UTF-8"):
        if path.stat().st_size > MAX_LIST:
            raise InputError(f"{path}: it is larger than {MAX_LIST >> 20} MiB, too large for a list of pairs")
        reader = csv.reader(io.StringIO(path.read_text("utf-8-sig"), newline=""), skipinitialspace=True)
        lines = []  # line number and cells, the header first
        for line in reader:
            cells = [cell.strip() for cell in line]
            if any(cells):
                lines.append((reader.line_num, cells))
    if not lines:
        raise InputError(f"{path}: it is empty: give a header {','.join(COLUMNS)} and one line a picture")
    _, header = lines[0]
    _check_header(path, header)
    if len(lines) == 1:
        raise InputError(f"{path}: it lists no picture: add one line a picture below the header")
    rows = []
    for number, cells in lines[1:]:
        if len(cells) != len(header):
            raise InputError(f"{path}, line {number}: {len(cells)} cells under {len(header)} columns: mend the line")
        rows.append((number, dict(zip(header, cells, strict=True))))
    return rows


def _check_header(path: Path, header: list[str]) -> None:
    """Raise an `InputError` if the header of the list `path` lacks one of `COLUMNS`, or names a column twice."""
    missing = [name for name in COLUMNS if name not in header]
    twice = [name for name in header if header.count(name) > 1]  # only the last of such columns would count
    if not missing and not twice:
        return
    for separator, word in ((";", "semicolons"), ("\t", "tabs")):
        if separator in header[0]:
            raise InputError(f"{path}: its cells are separated by {word}: save it with commas, and numbers with points")
    in_other_case = [name for name in header if name not in COLUMNS and name.lower() in missing]
    if in_other_case:
        fault = f"with {', '.join(in_other_case)} in another letter case"
    elif missing:
        fault = f"without column {', '.join(missing)}"
    else:
        raise InputError(f"{path}: column {twice[0]!r} stands twice in its header: leave one out")
    raise InputError(f"{path}: a header {fault} ({','.join(header)[:100]!r}): it needs {','.join(COLUMNS)}")


def _stated_angles(path: Path, number: int, row: dict[str, str]) -> list[float]:
    """θ_o, φ_o, θ_i, φ_i of line `number`, as stated: in degrees, if the list is right. `InputError` for no number."""
    values = []
    for name in ANGLES:
        try:
            values.append(float(row[name]))
        except ValueError as error:
            fault = f"{name} = {row[name][:40]!r} is not a number: give degrees, like 22.5"
            raise InputError(f"{path / LIST}, line {number}: {fault}") from error
    return values


def _heldout(path: Path, rows: list[tuple[int, dict[str, str]]]) -> Array | None:
    """The mask (N,) of held-out pairs from the column `split`; None without that column, or if it holds nothing out.

    `InputError` for other words in it, or if it leaves nothing to train on.
    """
    _, first_row = rows[0]
    if "split" not in first_row:
        return None
    for number, row in rows:
        if row["split"] not in ("train", "heldout"):
            raise InputError(f"{path / LIST}, line {number}: split = {row['split'][:40]!r}: write train or heldout")
    mask = np.array([row["split"] == "heldout" for _, row in rows])
    if mask.all():
        raise InputError(f"{path / LIST}: every line is heldout: mark some lines train")
    return mask if mask.any() else None


def _notes(path: Path) -> dict[str, Any]:
    """The object in `btf.json`, as `write_folder` made it or someone wrote it by hand; {} without that file.

    `InputError` if the file is too large, damaged or of another form.
    """
    if not path.is_file():
        return {}
    with readable(str(path), "mend the file or remove it"):
        if path.stat().st_size > MAX_LIST:
            raise InputError(f"{path}: it is larger than {MAX_LIST >> 20} MiB: remove it")
        notes = json.loads(path.read_text("utf-8"))
    if not isinstance(notes, dict) or not isinstance(notes.get("provenance", {}), dict):
        raise InputError(f"{path}: it must hold an object with an object `provenance`: mend the file or remove it")
    if not isinstance(notes.get("periodic", False), bool):  # any text would count as true
        raise InputError(f"{path}: periodic = {str(notes['periodic'])[:40]!r}: write true or false")
    return notes


def write_folder(btf: BTF, path: str | Path, slices: Iterable[Array] | None = None) -> None:
    """Write a BTF as a folder: one EXR (float, R G B) a pair, `pairs.csv`, and `btf.json` with name and provenance.

    Slices are read one after another and written without loss; held-out pairs are told in the column `split`. The list
    is written last, so an unfinished folder is not a BTF. Raises `InputError` if the folder already holds one.
    `slices`: as for `bench.btf.npz.write_npz`.
    """
    folder = Path(path)
    if (folder / LIST).exists():
        raise InputError(f"{folder}: it already holds {LIST}: choose another folder")
    make_folder(folder)
    names = [f"{index:05d}.exr" for index in range(len(btf))]
    for name, picture in zip(names, btf if slices is None else slices, strict=True):
        write_exr(folder / name, picture)
    notes = {"name": btf.name, "periodic": btf.periodic, "provenance": btf.provenance, "angles": "degrees"}
    # What JSON does not know in a provenance, such as a path, is written as its text.
    (folder / NOTES).write_text(json.dumps(notes, indent=1, default=str), "utf-8")
    angles = np.stack([*to_degrees(btf.wo), *to_degrees(btf.wi)], -1)  # (N, 4): θ_o, φ_o, θ_i, φ_i
    with open(folder / LIST, "w", encoding="utf-8", newline="") as stream:
        out = csv.writer(stream, lineterminator="\n")
        out.writerow(COLUMNS if btf.heldout is None else [*COLUMNS, "split"])
        for index, name in enumerate(names):
            cells = [name, *(f"{angle:.8g}" for angle in angles[index])]
            if btf.heldout is not None:
                cells.append("heldout" if btf.heldout[index] else "train")
            out.writerow(cells)
