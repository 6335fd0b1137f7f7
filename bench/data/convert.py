"""Cuts, shrinks or thins a BTF, and writes it as `.npz` or as a folder of EXR pictures with `pairs.csv`.

Slices are read and written one at a time, so memory stays small for any size. A result is first written under a
temporary name beside its final one, opened once to check that it can be read, and then renamed.
"""

from pathlib import Path

from bench.btf import BTF, Array
from bench.btf.npz import write_npz
from bench.codec import Progress, followed, silent
from bench.data.derived import thinned
from bench.data.readers import open_btf
from bench.data.readers.folder import write_folder
from bench.files import atomic
from bench.inputs.errors import InputError, writable


def changed(btf: BTF, crop: tuple[int, int, int, int] | None = None, downsample: int = 1, thin: int = 0) -> BTF:
    """The BTF without pairs of low light, lazily: thinned to about `thin` pairs evenly in angle (0: all), cropped to
    (row, col, height, width), and then averaged over boxes of downsample² texels in linear light.

    Raises `InputError`, in the words of the options of `convert`, for a number, window or factor that does not fit.
    """
    if thin < 0 or downsample < 1:
        raise InputError(f"--thin must be at least 0 and --downsample at least 1, not {thin}, {downsample}")
    btf = thinned(btf.without_low_light(), thin)  # pairs that `write_btf` leaves out do not count
    if crop:
        H, W = btf.shape
        row, col, height, width = crop
        if min(row, col) < 0 or min(height, width) < 1 or row + height > H or col + width > W:
            raise InputError(f"--crop {row},{col},{height},{width}: it does not fit into {H} x {W} texels")
        if (height, width) != (H, W):  # a crop is never periodic, but the whole picture may be
            btf = btf.crop(*crop)
    if downsample > min(btf.shape):
        raise InputError(f"--downsample {downsample}: the picture has {btf.shape[0]} x {btf.shape[1]} texels")
    return btf.downsample(downsample)


def write_btf(btf: BTF, out: Path, show: Progress = silent) -> None:
    """Write a BTF as one `.npz` (float32) if `out` has that ending, else as a folder of EXR pictures with `pairs.csv`.

    `show` is called for each slice. `out` appears only when it is complete; an existing `.npz` is replaced. Raises
    `InputError` as `check_place` does, and if `out` cannot be made.
    """
    check_place(out)
    btf = btf.without_low_light()  # no format of ours says which pairs these are, so a fit would train on them
    slices = followed(show, btf, "writing", len(btf))
    with writable(out, "is there room, and may you write?"), atomic.replacing(out) as partial:
        if out.suffix == ".npz":
            write_npz(btf, partial, slices)
        else:
            write_folder(btf, partial, slices)
        open_btf(partial)  # a result that readers would refuse must not look finished


def write_maps(maps: dict[str, Array], out: Path) -> None:
    """Write pictures (name → uint8 (H, W) or (H, W, 3)) as PNG files into a folder `out`; errors as of `write_btf`."""
    from PIL import Image

    check_place(out)
    with writable(out, "is there room, and may you write?"), atomic.replacing(out) as partial:
        atomic.make_folder(partial)
        for name, picture in maps.items():
            Image.fromarray(picture).save(partial / f"{name}.png", format="png", optimize=True)


def check_place(out: Path) -> None:
    """Raise `InputError` if `write_btf` could not write, before any work starts: without the folder around it, over
    another file or a folder that is not empty, or under the ending of a single picture."""
    if not out.absolute().parent.is_dir():
        raise InputError(f"{out}: there is no folder {out.parent}: make it first")
    if out.suffix == ".npz":  # a file, which may replace another
        if out.is_dir():
            raise InputError(f"{out}: it is a folder: choose another name")
        return
    if out.suffix.lower() in (".npz", ".exr", ".png", ".npy", ".btf"):
        raise InputError(f"{out}: it would be a folder of pictures: name it without this ending, or end it in .npz")
    is_taken = out.is_file() or (out.is_dir() and any(out.iterdir()))
    if is_taken:
        raise InputError(f"{out}: it exists and is not an empty folder: choose another name (a file ends in .npz)")
