"""Fuzzes every reader: damaged input gives an `InputError` or a BTF that reads, never another exception or a hang.

    python tests/fuzz/fuzz_readers.py [--count 2000] [--seed 0] [--only READER ...] [--again N]

Bytes are damaged in files, in entries of archives and in headers of arrays; `fuzzing.py`: limits and exit code.
"""

import random
import shutil
import struct
import sys
import zipfile
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from fuzzing import Reading, Target, damaged, main, repacked, with_other_header
from ubo2003_pca_write import random_codes, write_ubo2003_pca
from ubo2014_write import write_ubo2014

from bench.btf import BTF, ArraySource
from bench.btf.npz import write_npz
from bench.data.readers import open_btf
from bench.data.readers.folder import write_folder
from bench.directions.hemisphere import from_degrees
from bench.files.exr import write_exr

H, W = 8, 9
ANGLES = [(0, 0), (15, 60)]


def picture(index: int) -> np.ndarray:
    return np.random.default_rng(index).integers(0, 256, (H, W, 3), np.uint8)


def small_btf() -> BTF:
    """A BTF of all pairs of `ANGLES`, with highlights above 1 and a pair held out."""
    directions = from_degrees(*np.transpose(ANGLES))
    count = len(ANGLES)
    view, light = np.divmod(np.arange(count**2), count)
    values = np.random.default_rng(0).gamma(1.0, 1.0, (count**2, H, W, 3)).astype(np.float32)
    return BTF("small", directions[view], directions[light], ArraySource(values), heldout=np.arange(count**2) == 1)


def save(path: Path, codes: np.ndarray) -> None:
    """Save codes as the name's extension says; .png of uint16 through pypng, .hdr flat or run-length coded."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.suffix == ".exr":
        write_exr(path, codes / np.float32(64))
    elif path.suffix == ".hdr":
        path.write_bytes(radiance(codes))
    elif codes.dtype == np.uint16:
        import png

        with open(path, "wb") as stream:
            png.Writer(codes.shape[1], codes.shape[0], greyscale=False, bitdepth=16).write(
                stream, codes.reshape(len(codes), -1)
            )
    else:
        from PIL import Image

        Image.fromarray(codes).save(path)


def radiance(codes: np.ndarray) -> bytes:
    """A Radiance picture with run-length coded lines of literal runs, columns first as in ATRIUM."""
    rgbe = np.concatenate([codes, np.full((*codes.shape[:2], 1), 130, np.uint8)], -1).swapaxes(0, 1)
    lines, length = rgbe.shape[:2]
    head = f"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n+X {lines} -Y {length}\n".encode()
    runs = []
    for line in rgbe:
        runs.append(struct.pack(">2BH", 2, 2, length))
        runs += [bytes([length]) + line[:, channel].tobytes() for channel in range(4)]
    return head + b"".join(runs)


def named_names(pattern: str) -> Iterator[str]:
    """Names of pictures of all pairs of `ANGLES`."""
    for index, ((tv, pv), (tl, pl)) in enumerate((view, light) for view in ANGLES for light in ANGLES):
        yield pattern.format(index=index, tl=tl, pl=pl, tv=tv, pv=pv)


def make_folder(root: Path, extension: str, dtype: type = np.uint8) -> Path:
    rows = ["file,theta_o_deg,phi_o_deg,theta_i_deg,phi_i_deg,split"]
    for index, (view, light) in enumerate((view, light) for view in ANGLES for light in ANGLES):
        codes = picture(index).astype(dtype) * (257 if dtype is np.uint16 else 1)
        save(root / f"{index}{extension}", codes)
        rows.append(
            f"{index}{extension},{view[0]},{view[1]},{light[0]},{light[1]},{'heldout' if index == 1 else 'train'}"
        )
    (root / "pairs.csv").write_text("\n".join(rows) + "\n")
    return root


def make_written_folder(root: Path) -> Path:
    write_folder(small_btf(), root)
    return root


def make_rti(root: Path, noted: int = 1) -> Path:
    from PIL import Image

    notes = Image.Exif()
    notes[0x0112] = noted
    lines = [str(len(ANGLES))]
    for index, angles in enumerate(ANGLES):
        Image.fromarray(picture(index)).save(root / f"image {index}.jpg", exif=notes)
        lines.append(f"image {index}.jpg " + " ".join(f"{x:.6f}" for x in from_degrees(*angles)))
    (root / "dirs.lp").write_text("\n".join(lines) + "\n")
    return root


def make_npz(root: Path, compressed: bool = False) -> Path:
    write_npz(small_btf(), root / "small.npz")
    if compressed:
        with np.load(root / "small.npz", allow_pickle=False) as arrays:
            np.savez_compressed(root / "small.npz", **dict(arrays))
    return root / "small.npz"


def make_mean_abrdf(root: Path) -> Path:
    theta, phi = np.array(ANGLES, np.float32).T
    values = np.random.default_rng(0).random((len(ANGLES), len(ANGLES), 3), np.float32)
    np.savez_compressed(root / "mean.npz", rgb_geomean=values, theta_deg=theta, phi_deg=phi)
    return root / "mean.npz"


def make_ubo2014(root: Path, model: int = 11, fmf: bool = False, scalar: int = 2, version: int = 4) -> Path:
    rng = np.random.default_rng(model)
    pairs, rank = len(ANGLES) ** 2, 4
    rows, matrices = (3 * pairs, 1) if fmf else (pairs, 3)
    factors = []
    for _ in range(matrices):
        u = rng.standard_normal((rows, rank)) * 0.4
        sv = rng.standard_normal((H * W, rank)) * 0.4
        factors.append((u, sv))
    kind: dict[str, Any] = {"colour_model": model, "scalar": scalar, "version": version, "rotations": 2, "xml": "<a/>"}
    write_ubo2014(root / "small.btf", np.radians(ANGLES), np.radians(ANGLES), (H, W), factors, **kind)
    return root / "small.btf"


def make_hdf5(root: Path) -> Path:
    """A file of NeuralBTF's kind, and beside it the file of a held-out pair."""
    btf, apart = small_btf(), from_degrees([[20]], [[10]])[0]
    pictures = np.stack(list(btf))
    write_hdf5(root / "real_a_full_factor1.hdf5", btf.wo, btf.wi, pictures)
    write_hdf5(root / "real_a_random_factor1.hdf5", apart, apart, pictures[:1])
    return root / "real_a_full_factor1.hdf5"


def write_hdf5(path: Path, wo: np.ndarray, wi: np.ndarray, pictures: np.ndarray, **options: object) -> None:
    """Write pictures (N, H, W, 3), whose row 0 is the top one, as NeuralBTF does: from the bottom row up."""
    import h5py

    with h5py.File(path, "w") as file:
        file.create_dataset("ground_color", data=pictures[:, ::-1], **options)
        file.create_dataset("ground_camera_dir", data=wo[:, :2])
        file.create_dataset("ground_light", data=wi[:, :2])


def make_named(root: Path, pattern: str, zipped: bool) -> Path:
    folder = root / "set"
    for index, name in enumerate(named_names(pattern)):
        save(folder / name, picture(index))
    if not zipped:
        return folder
    with zipfile.ZipFile(root / "set.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        for file in sorted(path for path in folder.rglob("*") if path.is_file()):
            archive.write(file, file.relative_to(folder))
    shutil.rmtree(folder)
    return root / "set.zip"


UBO2003 = "tv{tv:03d}_pv{pv:03d}/{index:05d} tl{tl:03d} pl{pl:03d} tv{tv:03d} pv{pv:03d}"
UTIA = "tv{tv:03d}_pv{pv:03d}/tl{tl:03d}_pl{pl:03d}_tv{tv:03d}_pv{pv:03d}"
READERS: dict[str, Callable[[Path], Path]] = {
    "folder-exr": make_written_folder,
    "folder-png": lambda root: make_folder(root, ".png"),
    "folder-png16": lambda root: make_folder(root, ".png", np.uint16),
    "folder-jpeg": lambda root: make_folder(root, ".jpg"),
    "rti": make_rti,
    "rti-turned": lambda root: make_rti(root, 6),
    "npz": make_npz,
    "npz-compressed": lambda root: make_npz(root, True),
    "mean-abrdf": make_mean_abrdf,
    "ubo2014-rgb": lambda root: make_ubo2014(root, 0, scalar=4, version=1),
    "ubo2014-yuv": lambda root: make_ubo2014(root, 11, scalar=2),
    "ubo2014-log": lambda root: make_ubo2014(root, 12, scalar=8, version=3),
    "ubo2014-fmf": lambda root: make_ubo2014(root, 12, fmf=True, version=2),
    "ubo2003": lambda root: make_named(root, UBO2003 + ".jpg", True),
    "atrium-hdr": lambda root: make_named(root, UBO2003 + ".hdr", True),
    "utia-png": lambda root: make_named(root, UTIA + ".png", False),
    "utia-exr": lambda root: make_named(root, UTIA + ".exr", False),
    "ubo2003-pca": lambda root: write_ubo2003_pca(root / "3_8", *random_codes(4)),
    "hdf5": make_hdf5,
}


def bad_entry(name: str, content: bytes, rng: random.Random) -> bytes:
    return with_other_header(content, rng) if name.endswith(".npy") and rng.random() < 0.6 else damaged(content, rng)


def damage(path: Path, rng: random.Random) -> None:
    """Damage a file, one file of a folder, or (half of the time) the entries of an archive."""
    if path.is_dir():
        files = sorted(p for p in path.rglob("*") if p.is_file())
        lists = [p for p in files if p.suffix in (".csv", ".lp", ".json")]
        damage(rng.choice(lists if lists and rng.random() < 0.4 else files), rng)
    elif zipfile.is_zipfile(path) and rng.random() < 0.7:
        repacked(path, rng, bad_entry)
    else:
        path.write_bytes(damaged(path.read_bytes(), rng))


def read(path: Path, pairs: random.Random) -> None:
    btf = open_btf(path)
    for pair in {0, pairs.randrange(len(btf)), len(btf) - 1}:
        values = btf[pair]
        if values.shape != (*btf.shape, 3) or values.dtype != np.float32 or not np.isfinite(values).all():
            raise AssertionError(f"a slice of {values.shape} {values.dtype}")
    if type(btf.source).__name__ in ("FactorSource", "LocalPCA"):
        btf.texels([0], [btf.shape[1] - 1])
        btf.gather([len(btf) - 1], [0], [0])
    split = btf.split()
    if np.intersect1d(split.train, np.concatenate([*split.heldout.values(), []])).size or not len(btf.fingerprint):
        raise AssertionError("the split is not disjoint")


def make(name: str, folder: Path) -> None:
    """Write the undamaged sample of a reader and the path to open, and read it."""
    data = folder / "data"
    data.mkdir(parents=True)
    path = READERS[name](data)
    read(path, random.Random(0))
    (folder / "SAMPLE").write_text(str(path.relative_to(data)))


def attack(sample: Path, scratch: Path, rng: random.Random) -> Reading:
    """The reading of a damaged copy of the sample."""
    shutil.copytree(sample / "data", scratch / "data")
    path = scratch / "data" / (sample / "SAMPLE").read_text()
    damage(path, rng)
    return partial(read, path, rng)


TARGETS = [Target(name, partial(make, name), attack) for name in READERS]

if __name__ == "__main__":
    sys.exit(main(TARGETS, __file__, __doc__))
