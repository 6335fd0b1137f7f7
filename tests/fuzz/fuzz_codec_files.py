"""Fuzzes codec files whose hash is sound: a `ContainerError` or a material that answers, never another exception.

    python tests/fuzz/fuzz_codec_files.py [--count 2000] [--seed 0] [--only CODEC ...] [--again N]

Each mutation changes the JSON header, the metadata or the tensors of a small file, and the hash is computed again. Of
a codec with a network for all materials either file is changed, and the material names the network by its new hash.
See `fuzzing.py` for limits and exit code.
"""

import hashlib
import json
import random
import struct
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from fuzzing import Reading, Target, main

from bench.cli.console import file_fields, file_lines
from bench.codec import Fit
from bench.codecs import container, loading, shared
from bench.codecs.registry import codec_entries, load_codec
from bench.conformance.check import tiny_btf
from bench.conformance.stress.case import short

VALUES = (-1, 0, 1, 255, 256, 10**9, 2**62, -(2**63), 10**30, 1.5, 1e308, True, None, "", "x", "é" * 99, [], {}, [[]])
TYPES = tuple(container.ITEM_BYTES)
SCENE: dict[str, Any] = {"name": "a", "demand": "1" * 64, "size": [5, 5], "window": [0, 0, 5, 5], "factor": 1}
SCENE |= {"pairs": 9, "finest": 0.1, "uniform": 0.1, "views": "f" * 64, "lights": "f" * 64}


def small(name: str, folder: Path) -> None:
    """Write a small file of a codec, and the network that it needs."""
    kind, fit = load_codec(name), Fit(seed=1)
    codec = kind(**short(kind) | ({"steps": 1} if "steps" in short(kind) else {}))
    if kind.network:
        network = kind.network(**short(kind.network) | {"steps": 1})
        shared.make(network, [tiny_btf(4, 3, 3)], fit, folder / f"{name}.nbtf")
        fit = Fit(seed=1, network=shared.read(folder / f"{name}.nbtf"))
    container.save(folder / f"small-{name}.nbtf", codec, codec.encode(tiny_btf(5, 3, 3), fit))


def sealed(header: dict, says: dict, body: bytes) -> bytes:
    """A codec file of these parts, with its hash computed again."""
    header = header | {"__metadata__": {container.KEY: json.dumps(says | {"sha256": container.ZEROS.decode()})}}
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 8)
    data = struct.pack("<Q", len(text)) + text + body
    return data.replace(container.ZEROS, hashlib.sha256(data).hexdigest().encode(), 1)


def parted(content: bytes) -> tuple[dict, dict, bytearray]:
    """The header, the metadata and the tensors of a codec file."""
    length = struct.unpack("<Q", content[:8])[0]
    header = json.loads(content[8 : 8 + length])
    return header, json.loads(header.pop("__metadata__")[container.KEY]), bytearray(content[8 + length :])


def resealed(path: Path, change: Callable[[dict, dict], object]) -> None:
    """Changes the metadata and the header of a codec file, and computes its hash again."""
    header, says, body = parted(path.read_bytes())
    change(says, header)
    path.write_bytes(sealed(header, says, bytes(body)))


def mutated(content: bytes, rng: random.Random) -> bytes:
    """The file with one to three changes that its author never made."""
    header, says, body = parted(content)
    for _ in range(rng.randint(1, 3)):
        rng.choice((_field, _setting, _entry, _shape, _renamed, _bytes))(header, says, body, rng)
    return sealed(header, says, bytes(body))


def _field(header: dict, says: dict, body: bytearray, rng: random.Random) -> None:
    if rng.random() < 0.3:  # a scene that is whole but for one field
        says["scene"] = SCENE | {rng.choice([*SCENE]): rng.choice([*VALUES, [10**9, 10**9], [0, 0, 5, 5]])}
        return
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
    """A few bytes changed, or a run of them filled with one value."""
    longest = rng.choice((1, 1, len(body)))
    for _ in range(rng.randint(1, 8) if body else 0):
        begin = rng.randrange(len(body))
        run = body[begin : begin + rng.randint(1, longest)]
        body[begin : begin + len(run)] = bytes([rng.choice((0, 1, 63, 127, 128, 254, 255))]) * len(run)


def attack(sample: Path, scratch: Path, rng: random.Random) -> Reading:
    """The reading of a mutated file, or of a sound one that needs a mutated network."""
    content = next(sample.glob("small-*.nbtf")).read_bytes()
    network = next((path for path in sample.glob("*.nbtf") if not path.name.startswith("small-")), None)
    path = scratch / "mutated.nbtf"
    if network and rng.random() < 0.5:
        changed = mutated(network.read_bytes(), rng)
        (scratch / network.name).write_bytes(changed)
        path.write_bytes(content)
        resealed(path, lambda says, header: says.update(shared=parted(changed)[1]["sha256"]))
        return partial(read, path)
    if network:
        (scratch / network.name).write_bytes(network.read_bytes())
    path.write_bytes(mutated(content, rng))
    return partial(read, path)


def read(path: Path) -> None:
    """Decode a file and ask it; raises where an answer is not finite."""
    material = loading.load(path).material
    file_lines(file_fields(container.read_header(path)))  # as `info` describes it
    answer = material.slice((0.0, 0.0, 1.0), (0.6, 0.0, 0.8), (4, 4))
    if not answer.isfinite().all():
        raise AssertionError("an answer is not finite")


TARGETS = [Target(name, partial(small, name), attack) for name in sorted(codec_entries())]

if __name__ == "__main__":
    sys.exit(main(TARGETS, __file__, __doc__))
