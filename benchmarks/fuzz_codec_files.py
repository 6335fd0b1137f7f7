"""Fuzzes codec files whose hash is sound: a `ContainerError` or a material that answers, never another exception.

    python benchmarks/fuzz_codec_files.py [--count 2000] [--seed 0] [--codec NAME ...]

Each mutation changes the JSON header, the metadata or the tensors of a small file, and the hash is computed again. Runs
under a limit of address space. Exit code 1 where one raises something else or takes over two seconds.
"""

import argparse
import hashlib
import json
import random
import resource
import struct
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

from bench.codec import Fit
from bench.codecs import container, loading
from bench.codecs.registry import codec_entries, load_codec
from bench.conformance.check import tiny_btf
from bench.conformance.stability.case import short
from bench.errors import InputError

SECONDS = 2.0
MEMORY = 2 << 30
VALUES = (-1, 0, 1, 255, 256, 10**9, 2**62, -(2**63), 10**30, 1.5, 1e308, True, None, "", "x", "é" * 99, [], {}, [[]])
TYPES = tuple(container.ITEM_BYTES)


def small(name: str, folder: Path) -> bytes | None:
    """The bytes of a small file of a codec; None where it needs a network that is shared over materials."""
    kind = load_codec(name)
    if kind.network is not None:
        return None
    codec = kind(**short(kind) | ({"steps": 1} if "steps" in short(kind) else {}))
    parts = codec.encode(tiny_btf(5, 3, 3), Fit(seed=1))
    return container.save(folder / f"small-{name}.nbtf", codec, parts).path.read_bytes()


def sealed(header: dict, says: dict, body: bytes) -> bytes:
    """A codec file of these parts, with its hash computed again."""
    header = header | {"__metadata__": {container.KEY: json.dumps(says | {"sha256": container.ZEROS.decode()})}}
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 8)
    data = struct.pack("<Q", len(text)) + text + body
    return data.replace(container.ZEROS, hashlib.sha256(data).hexdigest().encode(), 1)


def mutated(content: bytes, rng: random.Random) -> bytes:
    """The file with one to three changes that its author never made."""
    length = struct.unpack("<Q", content[:8])[0]
    header, body = json.loads(content[8 : 8 + length]), bytearray(content[8 + length :])
    says = json.loads(header.pop("__metadata__")[container.KEY])
    for _ in range(rng.randint(1, 3)):
        rng.choice((_field, _setting, _entry, _shape, _renamed, _bytes, _numbers))(header, says, body, rng)
    return sealed(header, says, bytes(body))


def _field(header: dict, says: dict, body: bytearray, rng: random.Random) -> None:
    says[rng.choice([*says, "scene", "shared", "kind", "provenance"])] = rng.choice(VALUES)


def _setting(header: dict, says: dict, body: bytearray, rng: random.Random) -> None:
    if isinstance(says["settings"], dict):
        says["settings"][rng.choice([*says["settings"], "zstd", "other"])] = rng.choice(VALUES)


def _entry(header: dict, says: dict, body: bytearray, rng: random.Random) -> None:
    name = rng.choice(list(header))
    if isinstance(header[name], dict):
        header[name][rng.choice(("dtype", "shape", "data_offsets"))] = rng.choice([*VALUES, *TYPES])


def _shape(header: dict, says: dict, body: bytearray, rng: random.Random) -> None:
    """Another shape or type of as many bytes, which only the codec can find wrong."""
    entry = header[rng.choice(list(header))]
    try:
        size = entry["data_offsets"][1] - entry["data_offsets"][0]
        entry["dtype"] = dtype = rng.choice(TYPES)
        count = size // container.ITEM_BYTES[dtype]
        factor = rng.choice([n for n in range(1, count + 1) if count % n == 0] or [1])
        entry["shape"] = rng.choice(
            ([count], [factor, count // factor], [count // factor, factor, 1], [1, 1, 1, count])
        )
    except (TypeError, KeyError, IndexError):
        pass


def _renamed(header: dict, says: dict, body: bytearray, rng: random.Random) -> None:
    name = rng.choice(list(header))
    part, _, rest = name.partition("/")
    header[rng.choice((f"texture/{rest}", f"other/{rest}", f"{part}/x", rest, "decoder/zstd", name + ".scale"))] = (
        header.pop(name)
    )


def _bytes(header: dict, says: dict, body: bytearray, rng: random.Random) -> None:
    for _ in range(rng.randint(1, 8)):
        if body:
            body[rng.randrange(len(body))] = rng.choice((0, 1, 127, 128, 254, 255))


def _numbers(header: dict, says: dict, body: bytearray, rng: random.Random) -> None:
    """One tensor filled with one value."""
    entry = header[rng.choice(list(header))]
    try:
        begin, end = entry["data_offsets"]
        body[begin:end] = bytes([rng.choice((0, 1, 63, 127, 128, 255))]) * (end - begin)
    except (TypeError, KeyError, ValueError, MemoryError):
        pass


def attempt(path: Path) -> str:
    """ "refused", or "read" where the file decodes and answers with numbers."""
    try:
        material = loading.load(path).material
        answer = material.slice((0.0, 0.0, 1.0), (0.6, 0.0, 0.8), (4, 4))
    except InputError:
        return "refused"
    if not answer.isfinite().all():
        raise ValueError("an answer is not finite")
    return "read"


def fuzz(name: str, count: int, seed: int, folder: Path) -> Counter[str]:
    """How often each outcome came; whatever else is raised names its mutation."""
    found: Counter[str] = Counter()
    content = small(name, folder)
    for number in range(count if content else 0):
        assert content is not None
        path = folder / "mutated.nbtf"
        path.write_bytes(mutated(content, random.Random(f"{name} {seed} {number}")))
        start = time.process_time()
        try:
            found[attempt(path)] += 1
        except Exception as error:
            raise AssertionError(f"{name}, seed {seed}, mutation {number}: {type(error).__name__}: {error}") from error
        if (seconds := time.process_time() - start) > SECONDS:
            raise AssertionError(f"{name}, seed {seed}, mutation {number}: {seconds:.1f} s")
    return found


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=2000, help="mutations a codec")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--codec", nargs="+", default=sorted(codec_entries()))
    options = parser.parse_args()
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY, used + MEMORY))
    failed = False
    with tempfile.TemporaryDirectory() as folder:
        for name in options.codec:
            try:
                print(name, dict(fuzz(name, options.count, options.seed, Path(folder))), flush=True)
            except AssertionError as error:
                failed = True
                print(f"FAILED {error}", flush=True)
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
