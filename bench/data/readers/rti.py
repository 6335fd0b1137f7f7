"""Reflectance transformation imaging: one view, many lights, listed in an `.lp` file.

The first line of the list is the count, which may be missing; each line after it is `image-name x y z` with the unit
vector to the light, x right, y up, z toward the camera: the frame of the suite.
"""

import logging
import unicodedata
from pathlib import Path

import numpy as np

from bench.btf import BTF
from bench.data.readers.checks import no_duplicates, provenance_of, unit_directions, view_major
from bench.data.readers.files import Candidate, FolderFiles, list_folder, text_of
from bench.data.readers.pictures import PictureSource
from bench.inputs.errors import InputError, readable

MAX_LIST = 16 << 20
log = logging.getLogger(__name__)


def opened(seen: Candidate) -> BTF | None:
    """The BTF of an `.lp` list or of its folder, or None: one view (0, 0, 1), lights sorted by θ, then φ.

    Codes are decoded as sRGB to linear Rec. 709. Radiance is as photographed, so it contains the cosine of the light;
    its scale is the camera's exposure. Raises `InputError` that names the list and the line.
    """
    path = seen.path
    if seen.is_folder:
        lists = sorted(p for p in path.iterdir() if p.suffix.lower() == ".lp" and p.is_file())
        lists = [p for p in lists if not p.name.startswith(".")]  # macOS adds hidden files, `._name`
        if len(lists) > 1:
            held = ", ".join(p.name for p in lists[:5])
            raise InputError(f"{path}: it holds several lists ({held}): give the path of one")
        if not lists:
            return None
        path = lists[0]
    elif not seen.first_line.isdecimal() and not _is_entry(seen.first_line):
        return None
    files = FolderFiles(path.parent)
    names, labels, vectors = _read_list(path)
    pictures = _pictures(files, names, labels)
    wi = unit_directions(vectors, labels.__getitem__, tolerance=0.05)
    wo = np.tile(np.array([0, 0, 1], np.float32), (len(wi), 1))
    no_duplicates(wo, wi, labels.__getitem__)
    order = view_major(wo, wi)
    source = PictureSource(files, [pictures[i] for i in order], [labels[i] for i in order])
    clamp = "none here; 8-bit codes end at 1, so highlights are clipped in the photographs"
    provenance = provenance_of("RTI", "8- and 16-bit codes decoded as sRGB to linear Rec. 709", clamp=clamp)
    list_name = path.name.encode("utf-8", "backslashreplace").decode()  # a record holds no other bytes
    provenance |= {"list": list_name, "scale": "the camera's exposure; not calibrated"} | source.conversions()
    return BTF(path.parent.resolve().name, wo[order], wi[order], source, provenance=provenance)


def _read_list(path: Path) -> tuple[list[str], list[str], np.ndarray]:
    """The image names of a list, a label with the line of each, and the vectors to the lights (N, 3) float64."""
    with readable(str(path), "save it as plain text"):
        if path.stat().st_size > MAX_LIST:
            raise InputError(f"{path}: it is larger than {MAX_LIST >> 20} MiB, too large for a list of lights")
        text = text_of(path.read_bytes())
    lines = [(number, line.strip()) for number, line in enumerate(text.splitlines(), 1) if line.strip()]
    if not lines:
        raise InputError(f"{path}: it is empty: give the count of images, and a line for each")
    count = None
    _, first = lines[0]
    if first.isdecimal():
        count = int(first[:18])  # longer ones are wrong anyway, and would take long to convert
        del lines[0]
    labels = [f"{path}, line {number}" for number, _ in lines]
    entries = [_entry(label, line) for label, (_, line) in zip(labels, lines, strict=True)]
    if count is None:
        log.warning("%s: its first line is not the count of images: all %d lines are taken", path, len(entries))
    elif count != len(entries) or not entries:
        raise InputError(f"{path}: line 1 says {count} images, {len(entries)} are listed: correct it")
    return [name for name, _ in entries], labels, np.array([vector for _, vector in entries])


def _is_entry(line: str) -> bool:
    """Whether a line names a picture, with a suffix, and a vector."""
    cells = line.rsplit(None, 3)
    try:
        return len([float(cell) for cell in cells[1:]]) == 3 and "." in cells[0]
    except ValueError:
        return False


def _entry(label: str, line: str) -> tuple[str, list[float]]:
    """Image name (it may hold spaces) and vector of one line."""
    cells = line.rsplit(None, 3)
    try:
        # Empty texts for missing coordinates: they raise the same error as one that is no number.
        missing = [""] * (4 - len(cells))
        return cells[0], [float(cell) for cell in cells[1:4] + missing]
    except ValueError as error:
        raise InputError(f"{label}: {line[:60]!r} is not `image-name x y z`: mend the line") from error


def _pictures(files: FolderFiles, names: list[str], labels: list[str]) -> list[str]:
    """The file of each line of a list, by its name in the folder.

    After a copy from another system a name may differ from its file in case, or in the form of its accents. If there is
    only one such file, it is taken.
    """
    by_folded: dict[str, list[str]] | None = None  # made only if a name is not there
    found = []
    for listed, label in zip(names, labels, strict=True):
        wanted = _possible(listed)
        with readable(label):
            there = [name for name in wanted if files.has(name)]
        if there:
            found.append(there[0])
            continue
        if by_folded is None:
            by_folded = _by_folded(files)
        several = [by_folded[_folded(name)] for name in wanted if _folded(name) in by_folded]
        alike = several[0] if several else []
        if len(alike) != 1:
            _, _, bare = listed.replace("\\", "/").rpartition("/")
            remedy = "add the picture, or leave the line out and correct the count"
            if alike:
                remedy = f"it may be {' or '.join(alike)}: correct the name"
            raise InputError(f"{label}: {bare[:100]} is missing: {remedy}")
        found.append(alike[0])
    return found


def _by_folded(files: FolderFiles) -> dict[str, list[str]]:
    """The files of a folder by folded name; several may share one."""
    by_folded: dict[str, list[str]] = {}
    for name in list_folder(files.root):
        by_folded.setdefault(_folded(name), []).append(name)
    return by_folded


def _possible(listed: str) -> list[str]:
    """The names that a listed picture may have in the folder, the likelier first.

    They are its path, if it stays in the folder, and its bare name, because paths are often those of another machine.
    """
    tidy = listed.replace("\\", "/")
    _, _, bare = tidy.rpartition("/")
    # A colon at the second place is a drive letter's, as in C:/.
    direct = ".." not in tidy.split("/") and not tidy.startswith("/") and tidy[1:2] != ":"
    possible = [tidy, bare] if direct else [bare]
    return [name for name in possible if name not in ("", ".", "..")]


def _folded(name: str) -> str:
    """A name without the differences of case and of composed or separate accents."""
    return unicodedata.normalize("NFC", name).casefold()
