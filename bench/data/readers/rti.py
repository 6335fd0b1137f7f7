"""Reflectance transformation imaging: one view, many lights, listed in an `.lp` file.

The first line of the list is the count of images, which may be missing; each line after it is `image-name x y z` with
the unit vector to the light, x right, y up, z toward the camera, as in `bench.btf`. `label` names a line in errors:
`dirs.lp, line 7`.
"""

import logging
import unicodedata
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np

from bench.btf import BTF
from bench.data.readers.checks import no_duplicates, provenance_of, unit_directions, view_major
from bench.data.readers.files import Candidate, FolderFiles, list_folder, text_of
from bench.data.readers.pictures import PictureSource
from bench.inputs.errors import InputError, readable
from bench.records.meaning import grouped

MAX_LIST = 16 << 20  # bytes of a list
# Lists may be rounded, and two digits move a length by up to 1 %. This leaves room for coarser ones; a vector that is
# further off is likelier mistyped than rounded.
LENGTH_TOLERANCE = 0.05
log = logging.getLogger(__name__)


def opened(seen: Candidate) -> BTF | None:
    """The BTF of an `.lp` list or of its folder, or None: one view (0, 0, 1), lights sorted by θ, then φ.

    Codes are decoded as sRGB to linear Rec. 709. Radiance is as photographed, so it contains the cosine of the light;
    its scale is the camera's exposure. Raises `InputError` that names the list and the line.
    """
    path = seen.path
    if seen.is_folder:
        lists = [place for place in sorted(path.iterdir()) if place.suffix.lower() == ".lp" and place.is_file()]
        lists = [place for place in lists if not place.name.startswith(".")]  # macOS adds hidden files, `._name`
        if len(lists) > 1:
            listed = ", ".join(place.name for place in lists[:5])
            raise InputError(f"{path}: it holds several lists ({listed}): give the path of one")
        if not lists:
            return None
        path = lists[0]
    elif not seen.first_line.isdecimal() and not _is_entry(seen.first_line):
        return None
    entries = _read_list(path)
    folder = _Pictures(FolderFiles(path.parent))
    pictures = [folder.file_of(entry) for entry in entries]
    labels = [entry.label for entry in entries]
    wi = unit_directions(np.array([entry.vector for entry in entries]), labels.__getitem__, tolerance=LENGTH_TOLERANCE)
    wo = np.tile(np.array([0, 0, 1], np.float32), (len(wi), 1))
    no_duplicates(wo, wi, labels.__getitem__)
    order = view_major(wo, wi)
    source = PictureSource(folder.files, [pictures[i] for i in order], [labels[i] for i in order])
    clamp = "none here; 8-bit codes end at 1, so highlights are clipped in the photographs"
    provenance = provenance_of("RTI", "8- and 16-bit codes decoded as sRGB to linear Rec. 709", clamp=clamp)
    list_name = path.name.encode("utf-8", "backslashreplace").decode()  # a record holds no other bytes
    provenance |= {"list": list_name, "scale": "the camera's exposure; not calibrated"} | source.conversions()
    return BTF(path.parent.resolve().name, wo[order], wi[order], source, provenance=provenance)


class _Entry(NamedTuple):
    """A line of a list."""

    label: str
    picture: str  # the image's name as listed
    vector: list[float]  # x, y, z of the light


def _read_list(path: Path) -> list[_Entry]:
    """The entries of a list, in its order.

    Warns if the list has no count. `InputError` if a line is no entry, or the count is wrong.
    """
    with readable(str(path), "save it as plain text"):
        if path.stat().st_size > MAX_LIST:
            raise InputError(f"{path}: it is larger than {MAX_LIST >> 20} MiB, too large for a list of lights")
        text = text_of(path.read_bytes())
    lines = [(number, line.strip()) for number, line in enumerate(text.splitlines(), 1) if line.strip()]
    if not lines:
        raise InputError(f"{path}: it is empty: give the count of images, and a line for each")
    count = None
    first_number, first_line = lines[0]
    if first_line.isdecimal():  # the count; else it is an entry already
        count = int(first_line[:18])  # longer numbers are wrong anyway, and would take long to convert
        del lines[0]
    entries = [_entry(f"{path}, line {number}", line) for number, line in lines]
    if count is None:
        log.warning("%s: its first line is not the count of images: all %d lines are taken", path, len(entries))
    elif not entries:
        raise InputError(f"{path}: it lists no image: add a line for each")
    elif count != len(entries):
        raise InputError(f"{path}: line {first_number} says {count} images, {len(entries)} are listed: correct it")
    return entries


def _is_entry(line: str) -> bool:
    """Whether a line of a file is `image-name x y z`, where the name has a suffix.

    Without the suffix, any file that begins with a word and three numbers would count as a list.
    """
    if not line.strip():
        return False
    try:
        entry = _entry("", line)
    except InputError:
        return False
    suffix = Path(entry.picture).suffix.removeprefix(".")
    return suffix.isalnum() and not suffix.isdecimal()  # which would be the decimals of a number


def _entry(label: str, line: str) -> _Entry:
    """The entry of one line `image-name x y z`; `InputError` for any other line."""
    name, *coordinates = line.rsplit(None, 3)  # from the right, because the name may hold spaces
    try:
        # Empty texts for missing coordinates: they raise the same error as one that is no number.
        missing = [""] * (3 - len(coordinates))
        return _Entry(label, name, [float(text) for text in coordinates + missing])
    except ValueError as error:
        raise InputError(f"{label}: {line[:60]!r} is not `image-name x y z`: mend the line") from error


class _Pictures:
    """Finds the pictures of a list in its folder.

    After a copy from another system a name may differ from its file in case, or in the form of its accents. If there is
    only one such file, it is taken.
    """

    def __init__(self, files: FolderFiles):
        self.files = files

    @cached_property
    def by_folded_name(self) -> dict[str, list[str]]:
        """Folded name → the files that have it. The folder is listed at the first use, for a name that is not there."""
        return grouped(list_folder(self.files.root), _folded)

    def file_of(self, entry: _Entry) -> str:
        """The file of an entry; `InputError` if there is none, or more than one."""
        candidates = _possible_names(entry.picture)
        with readable(entry.label):
            existing = [name for name in candidates if self.files.has(name)]
        if existing:
            return existing[0]
        alike: list[str] = []  # files whose names fold like that of a candidate; the first candidate with any counts
        for name in candidates:
            alike = alike or self.by_folded_name.get(_folded(name), [])
        if len(alike) == 1:
            return alike[0]
        _, _, bare_name = entry.picture.replace("\\", "/").rpartition("/")
        remedy = "add the picture, or leave the line out and correct the count"
        if alike:
            remedy = f"it may be {' or '.join(alike)}: correct the name"
        raise InputError(f"{entry.label}: {bare_name[:100]} is missing: {remedy}")


def _possible_names(listed_name: str) -> list[str]:
    """The names that a listed picture may have in the folder, with forward slashes, the likelier first.

    They are its path, if it stays in the folder, and its bare name, because paths are often those of another machine.
    A name that could only be a folder is left out.
    """
    path = listed_name.replace("\\", "/")
    _, _, bare_name = path.rpartition("/")
    has_drive = path[1:2] == ":"  # as in C:/
    stays_in_folder = ".." not in path.split("/") and not path.startswith("/") and not has_drive
    candidates = [path, bare_name] if stays_in_folder else [bare_name]
    return [name for name in candidates if name not in ("", ".", "..")]


def _folded(name: str) -> str:
    """A name without the differences of case and of composed or separate accents: names that are alike fold alike."""
    return unicodedata.normalize("NFC", name).casefold()
