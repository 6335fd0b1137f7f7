"""Reflectance transformation imaging: one view, many lights, listed in an `.lp` file.

The first line of the list is the count; each line after it is `image-name x y z` with the unit vector to the light,
x right, y up, z toward the camera: the frame of the suite.
"""

from pathlib import Path

import numpy as np

from bench.btf import BTF
from bench.data.readers.checks import described, no_duplicates, unit_directions, view_major
from bench.data.readers.files import Candidate, FolderFiles
from bench.data.readers.pictures import PictureSource
from bench.inputs.errors import InputError, readable

MAX_LIST = 16 << 20


def opened(seen: Candidate) -> BTF | None:
    """The BTF of an `.lp` list or of its folder, or None: one view (0, 0, 1), lights sorted by θ, then φ.

    Codes are decoded as sRGB to linear Rec. 709. Radiance is as photographed, so it contains the cosine of the light;
    its scale is the camera's exposure. Raises `InputError` that names the list and the line.
    """
    path = seen.path
    if seen.is_folder:
        lists = sorted(p for p in path.iterdir() if p.suffix.lower() == ".lp" and p.is_file())
        if len(lists) > 1:
            held = ", ".join(p.name for p in lists[:5])
            raise InputError(f"{path}: it holds several lists ({held}): give the path of one")
        if not lists:
            return None
        path = lists[0]
    elif not seen.first_line.isdecimal():
        return None
    files = FolderFiles(path.parent)
    names, labels, vectors = _read_list(path)
    pictures = [_picture(files, name, label) for name, label in zip(names, labels, strict=True)]
    wi = unit_directions(vectors, labels.__getitem__, tolerance=0.05)
    wo = np.tile(np.array([0, 0, 1], np.float32), (len(wi), 1))
    no_duplicates(wo, wi, labels.__getitem__)
    order = view_major(wo, wi)
    source = PictureSource(files, [pictures[i] for i in order], [labels[i] for i in order])
    clamp = "none here; 8-bit codes end at 1, so highlights are clipped in the photographs"
    provenance = described("RTI", "8- and 16-bit codes decoded as sRGB to linear Rec. 709", clamp=clamp)
    provenance |= {"list": path.name, "scale": "the camera's exposure; not calibrated"} | source.conversions()
    return BTF(path.parent.resolve().name, wo[order], wi[order], source, provenance=provenance)


def _read_list(path: Path) -> tuple[list[str], list[str], np.ndarray]:
    """Image names, the lines that they stand on and the vectors (N, 3) float64 of a list."""
    with readable(str(path), "save it as plain text"):
        if path.stat().st_size > MAX_LIST:
            raise InputError(f"{path}: it is larger than {MAX_LIST >> 20} MiB, too large for a list of lights")
        text = path.read_text("utf-8-sig")
    lines = [(number, line.strip()) for number, line in enumerate(text.splitlines(), 1) if line.strip()]
    if not lines or not lines[0][1].isdecimal():
        raise InputError(f"{path}: its first line is not the count of images: write the count there")
    labels = [f"{path}, line {number}" for number, _ in lines[1:]]
    entries = [_entry(label, line) for label, (_, line) in zip(labels, lines[1:], strict=True)]
    if len(entries) != int(lines[0][1][:18]) or not entries:
        raise InputError(f"{path}: line 1 says {lines[0][1][:18]} images, {len(entries)} are listed: correct it")
    return [name for name, _ in entries], labels, np.array([vector for _, vector in entries])


def _entry(label: str, line: str) -> tuple[str, list[float]]:
    """Image name (it may hold spaces) and vector of one line."""
    cells = line.rsplit(None, 3)
    try:
        return cells[0], [float(cell) for cell in cells[1:4] + [""] * (4 - len(cells))]
    except ValueError as error:
        raise InputError(f"{label}: {line[:60]!r} is not `image-name x y z`: mend the line") from error


def _picture(files: FolderFiles, listed: str, label: str) -> str:
    """The picture of a line: by its listed path in the folder, else (paths are often foreign) by its bare name."""
    tidy = listed.replace("\\", "/")
    bare = tidy.rsplit("/", 1)[-1]
    with readable(label):
        direct = ".." not in tidy.split("/") and not tidy.startswith("/") and tidy[1:2] != ":"
        for name in [tidy, bare] if direct else [bare]:
            if name not in ("", ".", "..") and files.has(name):
                return name
    raise InputError(f"{label}: {bare[:100]} is missing: add the picture, or leave the line out and correct the count")
