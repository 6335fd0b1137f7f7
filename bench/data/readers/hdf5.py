"""The HDF5 files of neural BTF codecs: `ground_color` (N, H, W, 3), `ground_camera_dir` and `ground_light` (N, 2).

The two directions of a picture are x and y of unit vectors away from the surface, as NeuralBTF writes and reads them
(https://github.com/mandyxmq/NeuralBTF-release). If a file called `…_full…` has one called `…_random…` beside it, the
pairs of the latter are held out, as in that code. There, and in NeuMIP (https://github.com/straintensor/NeuMIP), which
introduced these names, v and y both grow with the row, so row 0 is the bottom of the picture.

A data set is an array in the file; it may be stored in chunks, boxes of values that are compressed and read as a whole.

NeuMIP and the Hierarchical Architecture store a direction for each *pixel*, random or of a near camera, the way that
light travels. Such a file holds no picture of a single pair, and is refused. Biplane trains on EXR files instead.
"""

import hashlib
import math
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bench.btf import BTF, Array, Source, finite, in_float32
from bench.data.joined import appended
from bench.data.readers.checks import no_duplicates, provenance_of, unit_directions
from bench.data.readers.files import Candidate, file_digest
from bench.data.readers.pictures import MAX_PIXELS
from bench.files.archive import LEAST, MAX_FILE, RATIO
from bench.inputs.errors import InputError, installed, readable

SIGNATURE = b"\x89HDF\r\n\x1a\n"
COLOUR, VIEW, LIGHT = "ground_color", "ground_camera_dir", "ground_light"
TRAINING = re.compile(r"_full(?=[_.])")  # in the name of a file; with `HELDOUT` instead it is that of its held-out file
HELDOUT = "_random"
MAX_PAIRS = 1 << 20
AT_ONCE = 64 << 20  # bytes of pictures that share chunks and are read together


def opened(seen: Candidate) -> BTF | None:
    """The BTF of an HDF5 file in the order stored, or None; the pairs of its held-out file, if any, come last.

    Radiance is taken as linear Rec. 709 and as photographed. Pictures are read by windows, on demand. Raises
    `InputError` that names the file, the data set and the row.
    """
    if not seen.head.startswith(SIGNATURE):
        return None
    path = seen.path
    btf = _btf_of_file(path)
    heldout_path = path.with_name(TRAINING.sub(HELDOUT, path.name))  # the same path without `_full` in the name
    if heldout_path == path or not heldout_path.is_file():
        return btf
    heldout = _btf_of_file(heldout_path)
    if heldout.shape != btf.shape:
        (height, width), (btf_height, btf_width) = heldout.shape, btf.shape
        sizes = f"its pictures are {width} x {height}, those of {path.name} {btf_width} x {btf_height}"
        raise InputError(f"{heldout_path}: {sizes}: move it away")
    whole = appended(btf, heldout, "heldout", f"the {len(heldout)} pairs of {heldout_path.name}")
    labels = [f"{path}: pair {pair}" for pair in range(len(btf))]
    labels += [f"{heldout_path}: pair {pair}" for pair in range(len(heldout))]
    no_duplicates(whole.wo, whole.wi, labels.__getitem__)
    return whole


def _btf_of_file(path: Path) -> BTF:
    """The BTF of one HDF5 file, without the held-out file that may lie beside it.

    Directions are read, pictures are not. `InputError` for data sets of a wrong form.
    """
    with _open_hdf5(path) as file:
        colour = _float_data_set(path, file, COLOUR)
        view = _float_data_set(path, file, VIEW)
        light = _float_data_set(path, file, LIGHT)
        if colour.ndim != 4 or colour.shape[-1] != 3 or 0 in colour.shape:
            raise InputError(f"{path}: {COLOUR} is {colour.shape}: it must be (N, H, W, 3)")
        count, height, width = colour.shape[:3]
        if count > MAX_PAIRS or height * width > MAX_PIXELS:
            limit = f"{MAX_PAIRS} pairs" if count > MAX_PAIRS else f"{MAX_PIXELS} pixels"
            raise InputError(f"{path}: {COLOUR} of {colour.shape} is too large: the limit is {limit}: split it")
        wo = _directions(path, VIEW, view, count)
        wi = _directions(path, LIGHT, light, count)
        pictures_a_chunk = colour.chunks[0] if colour.chunks else 1  # without chunks each picture is read alone
        source = HDF5Source(path, colour.shape[:3], Window(0, 0, height, width), pictures_a_chunk)
    no_duplicates(wo, wi, lambda row: f"{path}: pair {row}")
    frame = "rows from the bottom up, directions away from the surface, as the code that reads these files"
    provenance = provenance_of("HDF5", "taken as linear Rec. 709", frame=frame)
    return BTF(path.stem, wo, wi, source, provenance=provenance)


@contextmanager
def _open_hdf5(path: Path) -> Iterator[Any]:
    """The open `h5py.File`. It is opened for each read, so threads and forks share no state of the library.

    No lock is set on it. Without h5py, or if the file is damaged, an `InputError`.
    """
    with installed(f"{path}: reading HDF5 needs h5py: pip install 'neubtf-bench[hdf5]'"):
        import h5py
    with readable(str(path)), h5py.File(path, "r", locking=False) as file:
        yield file


def _float_data_set(path: Path, file: Any, key: str) -> Any:
    """The data set `key` (`h5py.Dataset`): plain floats, all written, in this file, of a size that its bytes can hold.

    `InputError` if it is anything else.
    """
    import h5py

    _refuse_link(path, file, key)
    if not isinstance(file.get(key), h5py.Dataset):
        listed = ", ".join(sorted(file)[:5])[:200] or "nothing"
        raise InputError(f"{path}: no data set {key} (it holds {listed}): it needs {COLOUR}, {VIEW}, {LIGHT}")
    data = file[key]
    if data.is_virtual or data.external:  # the fingerprint covers this file alone
        raise InputError(f"{path}: {key} lies in other files: copy it into this one")
    if data.dtype.kind != "f" or data.shape is None:
        raise InputError(f"{path}: {key} is {data.shape} {data.dtype}: it must hold floats")
    claimed_bytes = math.prod(data.shape) * data.dtype.itemsize
    chunk_bytes = math.prod(data.chunks or ()) * data.dtype.itemsize
    # Compression may shrink values `RATIO` times at most; what claims more would fill the memory.
    believable_bytes = max(LEAST, RATIO * data.id.get_storage_size())
    if claimed_bytes > believable_bytes or chunk_bytes > MAX_FILE:
        fault = f"{key} of {data.shape} in chunks of {data.chunks} is more than its bytes can hold"
        raise InputError(f"{path}: {fault}: write the file again")
    _refuse_unwritten(path, key, data)
    return data


def _refuse_link(path: Path, file: Any, key: str) -> None:
    """Raise an `InputError` if `key` is a link in the file, which may lead to another file."""
    import h5py

    # What it leads to is not looked at, because that would open the other file.
    link = file.get(key, getlink=True)
    if isinstance(link, h5py.SoftLink | h5py.ExternalLink):
        where = f" in the file {link.filename}" if isinstance(link, h5py.ExternalLink) else ""
        remedy = f"copy the data set itself to {key}, as h5repack or h5copy does"
        raise InputError(f"{path}: {key} is a link to {link.path}{where}: {remedy}")


def _refuse_unwritten(path: Path, key: str, data: Any) -> None:
    """Raise an `InputError` if values of a data set were never written; the library would give its fill value."""
    if not data.size:  # no values; the caller checks the shape
        return
    if not data.id.get_storage_size():
        raise InputError(f"{path}: {key} was made, but no value was ever written to it: write the file again")
    if data.chunks:
        along_axes = -(-np.array(data.shape) // data.chunks)  # rounded up: the last chunk may be cut
        all_chunks = math.prod(along_axes.tolist())
        missing = all_chunks - data.id.get_num_chunks()
        if missing:
            fault = f"{missing:,} of the {all_chunks:,} chunks of {key} were never written"
            raise InputError(f"{path}: {fault}: write all pictures, or cut the data sets to those that were")


def _directions(path: Path, key: str, data: Any, count: int) -> Array:
    """Unit vectors (count, 3) float32 from a data set (count, 2) of x and y; z follows from the length 1.

    `InputError` for another shape, or for a vector that is too long or lies in the surface.
    """
    if data.ndim == 4:
        raise InputError(
            f"{path}: {key} is {data.shape}, a direction for each pixel, as NeuMIP's own files have: a BTF needs one "
            f"for each picture, ({count}, 2)"
        )
    if data.shape != (count, 2):
        raise InputError(f"{path}: {key} is {data.shape}: it must be ({count}, 2), x and y of a direction a picture")
    plane = np.asarray(data[()], np.float64)  # x and y
    with np.errstate(over="ignore", invalid="ignore"):
        z = np.sqrt(np.maximum(1 - (plane**2).sum(1), 0))
    return unit_directions(np.column_stack([plane, z]), lambda row: f"{path}: {key}[{row}]")


class Window(NamedTuple):
    """A rectangle of texels in a picture whose row 0 is on top."""

    top: int
    left: int
    height: int
    width: int


class HDF5Source(Source):
    """A window of the pictures of a file, cheap by slice.

    Scattered reads use the defaults of `Source`, which copy all pictures to a scratch file once.
    """

    def __init__(self, path: Path, file_shape: tuple[int, int, int], window: Window, pictures_a_chunk: int):
        """`file_shape` is (N, H, W) of the whole file, in which a chunk holds values of `pictures_a_chunk` pictures.

        Pictures of a chunk are best read together (`at_once`), as far as they fit into `AT_ONCE` bytes.
        """
        self.path = path
        self.file_shape = file_shape
        self.rectangle = window
        self.pictures_a_chunk = pictures_a_chunk
        self.count = file_shape[0]
        self.shape = (window.height, window.width)
        bytes_of_a_picture = 12 * window.height * window.width  # three float32 values a texel
        self.at_once = max(1, min(pictures_a_chunk, AT_ONCE // bytes_of_a_picture))

    def slices(self, pairs: Array) -> list[Array]:
        """As `Source.slices`: (H, W, 3) float32 each, row 0 on top.

        An `InputError` names the pair with a value that is too large for float32, a `NotFiniteError` the one with a
        value that is not finite.
        """
        top, left, height, width = self.rectangle
        bottom = self.file_shape[1] - top - height  # the file's row 0 is the bottom
        first, last = int(pairs.min()), int(pairs.max()) + 1  # `last` is behind the last pair
        stretches = [(first, last)]  # (start, end) of pictures that are read together
        # One stretch is fastest for neighbours, even with some pictures between them. Pairs that lie further apart are
        # read one by one: a stretch over all of them would hold far more pictures than were asked for.
        if last - first > 2 * self.at_once:
            stretches = [(int(pair), int(pair) + 1) for pair in pairs]
        stored: dict[int, Array] = {}  # pair → picture in the file's type, also of pairs between those asked for
        with _open_hdf5(self.path) as file:
            for start, end in stretches:
                values = file[COLOUR][start:end, bottom : bottom + height, left : left + width]
                stored |= dict(enumerate(values[:, ::-1], start))  # now row 0 is the top
        slices = []
        for pair in pairs.tolist():
            label = f"{self.path}: {COLOUR}[{pair}]"
            slices.append(finite(in_float32(stored[pair], label), label))
        return slices

    def window(self, top: int, left: int, height: int, width: int) -> Source:
        """As `Source.window`; a window within the pictures is read alone, without the texels around it."""
        if min(top, left) < 0 or top + height > self.shape[0] or left + width > self.shape[1]:
            # It reaches around the border: the default reads whole pictures and picks texels out of them.
            return super().window(top, left, height, width)
        window = Window(self.rectangle.top + top, self.rectangle.left + left, height, width)
        return HDF5Source(self.path, self.file_shape, window, self.pictures_a_chunk)

    def fingerprint(self) -> str:
        rectangle = tuple(self.rectangle)  # as text `(0, 0, 64, 64)`
        return hashlib.sha256(f"{file_digest(self.path)} {rectangle}".encode()).hexdigest()
