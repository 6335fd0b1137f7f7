"""Pictures whose names carry the angles, `tlTTT plPPP tvTTT pvPPP` in whole degrees, as in the Bonn and Prague sets."""

import os
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from bench.btf import BTF
from bench.data.readers.checks import pairs_in_degrees, view_major
from bench.data.readers.files import Files, FolderFiles
from bench.data.readers.pictures import PictureSource
from bench.files.archive import ZipFiles
from bench.inputs.errors import InputError

# Bonn puts a running number (and at times the material) before the angles and uses spaces or underscores.
BONN = re.compile(r"(?:^|/)[^/]+[ _]tl(\d{3})[ _]pl(\d{3})[ _]tv(\d{3})[ _]pv(\d{3})\.[^/.]+$", re.ASCII)
PRAGUE = re.compile(r"(?:^|/)tl(\d{3})_pl(\d{3})_tv(\d{3})_pv(\d{3})\.[^/.]+$", re.ASCII)
MAX_DEPTH = 3


def matching(names: Iterable[str], pattern: re.Pattern[str]) -> list[str]:
    """The names that carry angles; hidden copies (`._name`, which some archivers add) are left out."""
    return [name for name in names if pattern.search(name) and not name.rsplit("/", 1)[-1].startswith(".")]


def list_folder(path: Path) -> list[str]:
    """Names of the files up to three levels below a folder, with forward slashes, sorted."""
    names = []
    for place, folders, files in os.walk(path):
        inner = Path(place).relative_to(path)
        if len(inner.parts) + 1 >= MAX_DEPTH:
            folders.clear()
        names += [(inner / name).as_posix() for name in files]
    return sorted(names)


def open_pictures(path: Path, pattern: re.Pattern[str], provenance: dict[str, Any], **options: Any) -> BTF:
    """The BTF of the pictures in a folder or zip whose names match; pairs sorted by view, then by light.

    Groups of the pattern are θ_i, φ_i, θ_o, φ_o in whole degrees; `options` go to `pictures.read_picture`. Raises
    `InputError` that names the picture if angles are out of range, a pair appears twice or sizes differ.
    """
    files: Files = FolderFiles(path) if path.is_dir() else ZipFiles(path)
    names = matching(list_folder(path) if isinstance(files, FolderFiles) else sorted(files.entries), pattern)
    if not names:
        raise InputError(f"{path}: it holds no picture named like tl000 pl000 tv000 pv000: give the folder that does")
    matches = [pattern.search(name) for name in names]
    degrees = np.array([[int(group) for group in match.groups()] for match in matches if match], np.float64)

    sides = (" of the light", " of the view")
    wi, wo = pairs_in_degrees(degrees, lambda index: files.label(names[index]), sides)
    order = view_major(wo, wi)
    source = PictureSource(files, [names[i] for i in order], **options)
    name = path.resolve().name if path.is_dir() else path.stem
    return BTF(name, wo[order], wi[order], source, provenance=provenance)
