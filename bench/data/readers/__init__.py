"""Readers of measured BTFs. `open_btf` chooses one by what a file or folder holds, never by its extension."""

from pathlib import Path

from bench.btf import BTF
from bench.errors import InputError

SUPPORTED = (
    "a folder with pairs.csv, an RTI folder or .lp list, an .npz with radiance, wo, wi, a mean-ABRDF .npz, "
    "UBO2014 .btf, a UBO2003 or ATRIUM zip, a UTIA folder"
)


def open_btf(path: str | Path) -> BTF:
    """The BTF of a file or folder, lazily: what can be checked cheaply is checked now, values are read when asked.

    Raises `InputError` that names the file, what was seen and what to do.
    """
    path = Path(path)
    if path.is_dir():
        return _open_directory(path)
    if not path.is_file():
        raise InputError(f"{path}: no such file or folder: give {SUPPORTED}")
    try:
        with open(path, "rb") as stream:
            head = stream.read(4096)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}): check its permissions") from error
    return _open_file(path, head)


def _open_directory(path: Path) -> BTF:
    from bench.data.readers import folder, named, rti, ubo2003, utia

    try:
        if (path / folder.LIST).is_file():
            return folder.open_folder(path)
        if found := rti.find_list(path):
            return rti.open_rti(found)
        names = named.list_folder(path)
        if utia.is_utia(names):
            return utia.open_utia(path)
        if ubo2003.is_ubo2003(names):
            return ubo2003.open_ubo2003(path)
        seen = ", ".join(sorted(p.name for p in path.iterdir())[:3]) or "nothing"
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}): check its permissions") from error
    raise InputError(f"{path}: no BTF folder (it holds {seen}): add pairs.csv, or give {SUPPORTED}")


def _open_file(path: Path, head: bytes) -> BTF:
    if head[:4] == b"PK\x03\x04":
        return _open_zip(path)
    if head[:1] == b"!":
        from bench.data.readers import ubo2014

        return ubo2014.open_ubo2014(path)
    first = head.decode("utf-8-sig", "replace").lstrip().split("\n", 1)[0].strip()
    if first.isdecimal():
        from bench.data.readers import rti

        return rti.open_rti(path)
    if "theta_o_deg" in first:
        from bench.data.readers import folder

        return folder.open_folder(path.parent)
    raise InputError(f"{path}: begins with {head[:10]!r}, no BTF known here: give {SUPPORTED}")


def _open_zip(path: Path) -> BTF:
    from bench.data.readers import mean_abrdf, npz, ubo2003, utia
    from bench.data.readers.files import ZipFiles

    names = list(ZipFiles(path).entries)
    if "radiance.npy" in names:
        return npz.open_npz(path)
    if mean_abrdf.KEY + ".npy" in names:
        return mean_abrdf.open_mean_abrdf(path)
    if ubo2003.is_ubo2003(names):
        return ubo2003.open_ubo2003(path)
    if utia.is_utia(names):
        return utia.open_utia(path)
    seen = ", ".join(names[:3]) or "nothing"
    raise InputError(f"{path}: an archive of no BTF known here (it holds {seen}): give {SUPPORTED}")
