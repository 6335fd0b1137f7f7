"""Readers of measured BTFs. `open_btf` chooses one by the content of a file or folder, never by its extension.

A reader is a module that opens one file format as a BTF (`bench.btf`); one of this package is built in.

To add a reader, write one file with a function `opened(seen)` and add one line below. The function gets a
`bench.data.readers.files.Candidate` and returns the BTF, or None if the file or folder has another format. A reader of
another package is such a module, which an entry point names (`bench.data.readers.outside`).
"""

import importlib
import os
from pathlib import Path

from bench.btf import BTF
from bench.data.readers import outside
from bench.data.readers.checks import unit_note
from bench.data.readers.files import Candidate
from bench.inputs.errors import InputError

# Module → the format that it opens, in words. A module is named without this package, or, from elsewhere, by its full
# name with dots. They are tried in this order.
READERS = {
    "folder": "a folder with pairs.csv",
    "rti": "an RTI folder or .lp list",
    "ubo2003_pca": "UBO2003 as local PCA (meta.json)",
    "hdf5": "HDF5 with ground_color, ground_camera_dir, ground_light",
    "npz": "an .npz with radiance, wo, wi, a mean-ABRDF .npz",
    "ubo2014": "UBO2014 .btf",
    "named": "a UTIA folder, a UBO2003 or ATRIUM zip",
}


def open_btf(path: str | Path, angles: str = "") -> BTF:
    """Open a file or folder as a BTF, lazily: cheap checks are made now, values are read on demand. Raises `InputError`
    that names the file, the fault and the remedy.

    Some formats state angles in degrees. `angles`, "degrees" or "radians", says which unit such a file really has, ""
    that the user names none; a unit for a file that states no angles is an `InputError`.
    """
    path = Path(path)
    outside_readers = outside.entries(READERS)
    outside_formats = [f"data of reader {name}" for name in outside_readers]
    supported = ", ".join([*READERS.values(), *outside_formats])
    if not os.path.exists(path):  # False for a name too long, where Path.exists raises
        raise InputError(f"{path}: there is no such file or folder: give {supported}")
    try:
        seen = Candidate(path, angles)
        btf = _opened_by_built_in(seen)
        if btf is None:
            btf, faults = outside.opened(seen, outside_readers.values())
            if btf is None:
                raise InputError("; ".join([f"{path}: {_unknown_fault(seen, supported)}", *faults]))
        # A reader that used the unit says so in the provenance; without its note the option would do nothing. The file
        # may hold the note of another unit, from which it was converted.
        note = unit_note(angles)
        if note and btf.provenance.get("angles") != note["angles"]:
            raise InputError(f"{path}: it states no angles in degrees: leave out --{angles} (data.angles)")
        return btf
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error}): check its permissions") from error


def listed() -> dict[str, str]:
    """Name of each reader → words for the format that it opens, or for what is wrong with it.

    The readers of other packages, which are imported for their words, come last.
    """
    lines = dict(READERS)
    try:
        for name, entry in outside.entries(READERS).items():
            lines[name] = outside.description(entry)
    except InputError as error:  # two packages may use one name; the built-in readers are listed nevertheless
        lines["(other packages)"] = f"FAILS: {error}"
    return lines


def _opened_by_built_in(seen: Candidate) -> BTF | None:
    """The BTF of the first built-in reader that knows the format; None if none does."""
    for name in READERS:
        reader = importlib.import_module(f"{__name__}.{name}")
        btf: BTF | None = reader.opened(seen)
        if btf is not None:
            return btf
    return None


def _unknown_fault(seen: Candidate, supported: str) -> str:
    """Why no reader opens the file or folder, in words.

    A folder of pictures may be texture maps, from which `bench.data.bake` makes a BTF, or hold a folder of them. So it
    gets the words of `bake` on the names of the pictures. `supported` lists what readers open, in words.
    """
    if seen.is_folder:
        from bench.data.bake.naming import has_pictures, inner_maps, no_albedo_fault

        if has_pictures(os.listdir(seen.path)) or inner_maps(seen.path):
            return no_albedo_fault(seen.path)
        listed = ", ".join(sorted(os.listdir(seen.path))[:3]) or "nothing"
        remedy = "add pairs.csv, or names of maps like NAME_albedo.png, or give"
        return f"it is not a BTF folder (it holds {listed}): {remedy} {supported}"
    if seen.is_zip:
        listed = ", ".join(seen.names[:3]) or "nothing"
        return f"it is not an archive of a known BTF (it holds {listed}): give {supported}"
    return f"it begins with {seen.head[:10]!r}, like no known BTF: give {supported}"
