"""Fuzzes every reader: damaged input gives an `InputError` or a BTF that reads, never another exception or a hang.

    python benchmarks/fuzz_readers.py [--count 2000] [--seed 0] [--reader NAME ...]

Each reader runs in processes of its own, under an address-space limit, so that a crash in a decoder is seen and named
by its seed. Exit code 1 where one fails.
"""

import argparse
import json
import resource
import shutil
import signal
import struct
import subprocess
import sys
import tempfile
import time
import traceback
import warnings
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FrameType

import numpy as np
from ubo2014_write import write_ubo2014

from bench.btf import BTF, ArraySource
from bench.data.readers import open_btf
from bench.data.readers.folder import write_exr, write_folder
from bench.data.readers.npz import write_npz
from bench.errors import InputError
from bench.hemisphere import from_degrees

SECONDS, MEMORY, CHUNK = 2.0, 1 << 30, 500
H, W = 8, 9
ANGLES = [(0, 0), (15, 60)]
NUMBERS = [0, 1, 2, 0x7F, 0xFF, 0x7FFF, 0xFFFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, 1 << 20, 1 << 24]
TOKENS = [b"nan", b"-1", b"1e999", b"", b"../../etc/passwd", b"/", b",", b"\n", b"\xff", b"\0", b"9" * 40, b"(", b"'"]


class Hang(BaseException):
    """A read that took longer than `SECONDS`; no reader can catch it by accident."""


def picture(index: int) -> np.ndarray:
    """Codes (H, W, 3) uint8 of a small picture."""
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
    runs = [
        struct.pack(">2BH", 2, 2, length) + b"".join(bytes([length]) + line[:, c].tobytes() for c in range(4))
        for line in rgbe
    ]
    return head + b"".join(runs)


def named_names(pattern: str) -> Iterator[str]:
    """Names of pictures of all pairs of `ANGLES`."""
    for index, ((tv, pv), (tl, pl)) in enumerate((view, light) for view in ANGLES for light in ANGLES):
        yield pattern.format(index=index, tl=tl, pl=pl, tv=tv, pv=pv)


def make_folder(root: Path, extension: str, dtype: type = np.uint8) -> Path:
    """A folder with pairs.csv and pictures of one kind."""
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


def make_rti(root: Path) -> Path:
    lines = [str(len(ANGLES))]
    for index, angles in enumerate(ANGLES):
        save(root / f"image {index}.jpg", picture(index))
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
    rows, rank = len(ANGLES) ** 2 * (3 if fmf else 1), 4
    factors = [
        (rng.standard_normal((rows, rank)) * 0.4, rng.standard_normal((H * W, rank)) * 0.4)
        for _ in range(1 if fmf else 3)
    ]
    angles = np.radians(ANGLES)
    path = root / "small.btf"
    write_ubo2014(
        path,
        angles,
        angles,
        (H, W),
        factors,
        colour_model=model,
        scalar=scalar,
        version=version,
        rotations=2,
        xml="<a/>",
    )
    return path


def make_named(root: Path, pattern: str, zipped: bool) -> Path:
    folder = root / "set"
    for index, name in enumerate(named_names(pattern)):
        save(folder / name, picture(index))
    if not zipped:
        return folder
    pack(folder, root / "set.zip")
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
}


def mutate(data: bytes, rng: np.random.Generator) -> bytes:
    """Damage bytes in one to four places; half of the places lie in the first 512 bytes, where headers are."""
    out = bytearray(data)
    for _ in range(int(rng.integers(1, 5))):
        at = int(rng.integers(min(len(out), 512) if rng.random() < 0.5 else len(out))) if out else 0
        kind = int(rng.integers(8))
        if kind == 0:
            out[at : at + 1] = bytes([(out[at] if out else 0) ^ (1 << int(rng.integers(8)))])
        elif kind == 1:
            out[at : at + 1] = rng.bytes(1)
        elif kind == 2:
            out[at : at + 4] = struct.pack(
                "<I" if rng.random() < 0.5 else ">I", NUMBERS[int(rng.integers(len(NUMBERS)))]
            )
        elif kind == 3:
            del out[at : at + int(rng.integers(1, 64))]
        elif kind == 4:
            out[at:at] = out[at : at + int(rng.integers(1, 64))]
        elif kind == 5:
            out[at : at + int(rng.integers(0, 8))] = TOKENS[int(rng.integers(len(TOKENS)))]
        elif kind == 6:
            out[at : at + 8] = struct.pack("<d", [np.nan, np.inf, -1e300, 1e-300][int(rng.integers(4))])
        elif rng.random() < 0.3:
            del out[at:]
    return bytes(out)


def pack(folder: Path, path: Path) -> None:
    """Zip a folder's files."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for file in sorted(folder.rglob("*")):
            if file.is_file():
                archive.write(file, file.relative_to(folder))


def damage(path: Path, rng: np.random.Generator) -> None:
    """Damage a file, one file of a folder, or (half of the time) one entry of an archive that is then packed anew."""
    if path.is_dir():
        files = sorted(p for p in path.rglob("*") if p.is_file())
        lists = [p for p in files if p.suffix in (".csv", ".lp", ".json")]
        damage(lists[0] if lists and rng.random() < 0.4 else files[int(rng.integers(len(files)))], rng)
    elif zipfile.is_zipfile(path) and rng.random() < 0.5:
        inner = path.with_suffix(".inner")
        with zipfile.ZipFile(path) as archive:
            archive.extractall(inner)
        damage(inner, rng)
        pack(inner, path)
        shutil.rmtree(inner)
    else:
        path.write_bytes(mutate(path.read_bytes(), rng))


def read(path: Path, rng: np.random.Generator) -> str:
    """Open and read a BTF: `read`, or `refused` with an `InputError`; anything else passes through."""
    try:
        btf = open_btf(path)
        for pair in {0, int(rng.integers(len(btf))), len(btf) - 1}:
            values = btf[pair]
            if values.shape != (*btf.shape, 3) or values.dtype != np.float32 or not np.isfinite(values).all():
                raise AssertionError(f"a slice of {values.shape} {values.dtype}")
        if type(btf.source).__name__ == "FactorSource":
            btf.texels([0], [btf.shape[1] - 1])
            btf.gather([len(btf) - 1], [0], [0])
        split = btf.split()
        if np.intersect1d(split.train, np.concatenate([*split.heldout.values(), []])).size or not len(btf.fingerprint):
            raise AssertionError("the split is not disjoint")
    except InputError as error:
        if "\n" in str(error):
            raise AssertionError("a message of several lines") from error
        return "refused"
    return "read"


def expire(_signal: int, _frame: FrameType | None) -> None:
    raise Hang(f"longer than {SECONDS} s")


def trial(name: str, index: int, seed: int, original: Path, scratch: Path) -> tuple[str, float]:
    """Damage a copy of the reader's sample and read it: the outcome and its seconds."""
    rng = np.random.default_rng([seed, index, list(READERS).index(name)])
    root = scratch / f"{index}"
    relative = Path((original / "SAMPLE").read_text())
    shutil.copytree(original / "data", root)
    try:
        damage(root / relative, rng)
        begin = time.perf_counter()
        signal.setitimer(signal.ITIMER_REAL, 4 * SECONDS)
        try:
            outcome = read(root / relative, rng)
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0)
        return outcome, time.perf_counter() - begin
    finally:
        shutil.rmtree(root)


def prepare(name: str, folder: Path) -> None:
    """Write the undamaged sample of a reader and the path to open."""
    data = folder / "data"
    data.mkdir(parents=True)
    (folder / "SAMPLE").write_text(str(READERS[name](data).relative_to(data)))


def fuzz(name: str, indices: range, seed: int, folder: Path) -> dict[str, float]:
    """Run trials in this process: how many were read and refused, and the slowest. Raises on the first failure."""
    original = folder / "original"
    prepare(name, original)
    if read(original / "data" / (original / "SAMPLE").read_text(), np.random.default_rng(0)) != "read":
        raise AssertionError(f"{name}: the undamaged sample is refused")
    signal.signal(signal.SIGALRM, expire)
    total: dict[str, float] = {"read": 0, "refused": 0, "slowest": 0.0}
    for index in indices:
        (folder / "LAST").write_text(str(index))
        try:
            outcome, seconds = trial(name, index, seed, original, folder)
        except BaseException as error:
            raise AssertionError(f"{name}, mutation {index}, seed {seed}: {type(error).__name__}: {error}") from error
        total[outcome] += 1
        total["slowest"] = max(total["slowest"], seconds)
    return total


def work(name: str, start: int, stop: int, seed: int, folder: Path) -> int:
    """One worker process: trials under a limit of address space, the result as JSON on stdout."""
    warnings.simplefilter("error")
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + (2 << 30), used + (2 << 30)))
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    try:
        total = fuzz(name, range(start, stop), seed, folder)
    except AssertionError:
        traceback.print_exc()
        return 1
    total["memory"] = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) * 1024
    print(json.dumps(total))
    return 0


def run_reader(name: str, count: int, seed: int) -> bool:
    """Fuzz one reader in chunks, each in a process of its own; print a line; True where all went well."""
    sums = {"read": 0.0, "refused": 0.0, "slowest": 0.0, "memory": 0.0}
    for start in range(0, count, CHUNK):
        with tempfile.TemporaryDirectory() as folder:
            stop = min(count, start + CHUNK)
            command = [sys.executable, __file__, "--work", name, str(start), str(stop), "--seed", str(seed), folder]
            done = subprocess.run(command, capture_output=True, text=True, check=False)
            if done.returncode:
                last = Path(folder, "LAST").read_text() if Path(folder, "LAST").exists() else "none"
                print(f"{name}: FAILED with exit code {done.returncode} at mutation {last}\n{done.stderr[-3000:]}")
                return False
            result = json.loads(done.stdout.splitlines()[-1])  # decoders print words of their own
            sums = {k: (sums[k] + v if k in ("read", "refused") else max(sums[k], v)) for k, v in result.items()}
    good = sums["slowest"] <= SECONDS and sums["memory"] <= MEMORY
    print(
        f"{name:16s} {count} mutations: {sums['refused']:.0f} refused, {sums['read']:.0f} read, slowest "
        f"{sums['slowest']:.2f} s, memory +{sums['memory'] / 1e6:.0f} MB{'' if good else '  OVER THE LIMIT'}",
        flush=True,
    )
    return good


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=2000, help="mutations a reader")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--reader", nargs="+", choices=READERS, default=list(READERS))
    parser.add_argument("--work", nargs=3, help=argparse.SUPPRESS)
    parser.add_argument("folder", nargs="?", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.work:
        name, start, stop = options.work
        return work(name, int(start), int(stop), options.seed, options.folder)
    return int(sum(not run_reader(name, options.count, options.seed) for name in options.reader) > 0)


if __name__ == "__main__":
    sys.exit(main())
