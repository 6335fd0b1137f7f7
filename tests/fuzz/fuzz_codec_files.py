"""Fuzzes codec files whose hash is sound: a `ContainerError` or a material that answers, never another exception.

    python tests/fuzz/fuzz_codec_files.py [--count 2000] [--seed 0] [--only CODEC ...] [--again N]

Each mutation changes the fields, the list of tensors or the numbers of a small file, and the hash is computed again. Of
a codec with a network for all materials either file is changed, and the material names the network by its new hash.
See `fuzzing.py` for limits and exit code.
"""

import hashlib
import json
import math
import random
import sys
import zlib
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from fuzzing import Reading, Target, main

from bench.cli.console import fields_text, file_fields
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


def sealed(tensors: object, says: dict, body: bytes) -> bytes:
    """A codec file of these parts, with its hash computed again."""
    return sealed_text(json.dumps(says | {"tensors": tensors}).encode(), body)


def sealed_text(text: bytes, body: bytes, garbage: bytes = b"", claimed: int | None = None) -> bytes:
    """A codec file of a header's bytes, with garbage behind the stream, or another size claimed than that of it."""
    deflater = zlib.compressobj(wbits=-15)
    deflated = deflater.compress(text) + deflater.flush() + garbage
    lengths = container.LENGTHS.pack(len(deflated), len(text) if claimed is None else claimed)
    return rehashed(container.MAGIC + bytes([container.FORMAT]) + lengths + bytes(32) + deflated + body)


def rehashed(data: bytes) -> bytes:
    """A codec file with its hash computed again."""
    start, rest = data[: container.HASH_AT], data[container.START :]
    return start + hashlib.sha256(start + bytes(32) + rest).digest() + rest


def parted(content: bytes) -> tuple[dict, dict, bytearray]:
    """The tensors by part, as the header lists them, its other fields, and the numbers of a codec file."""
    end = container.START + container.LENGTHS.unpack(content[5 : container.HASH_AT])[0]
    says = json.loads(zlib.decompress(content[container.START : end], wbits=-15))
    return says.pop("tensors"), says, bytearray(content[end:])


def resealed(path: Path, change: Callable[[dict, dict], object]) -> None:
    """Changes the fields and the list of tensors of a codec file, and computes its hash again."""
    tensors, says, body = parted(path.read_bytes())
    change(says, tensors)
    path.write_bytes(sealed(tensors, says, bytes(body)))


def mutated(content: bytes, rng: random.Random) -> bytes:
    """The file with one to three changes that its author never made."""
    tensors, says, body = parted(content)
    for _ in range(rng.randint(1, 3)):
        rng.choice((_field, _setting, _entry, _shape, _renamed, _bytes))(tensors, says, body, rng)
    return sealed(tensors, says, bytes(body))


def _field(tensors: dict, says: dict, body: bytearray, rng: random.Random) -> None:
    if rng.random() < 0.3:  # a scene that is whole but for one field
        says["scene"] = SCENE | {rng.choice([*SCENE]): rng.choice([*VALUES, [10**9, 10**9], [0, 0, 5, 5]])}
        return
    says[rng.choice([*says, "scene", "shared", "kind", "provenance"])] = rng.choice(VALUES)


def _setting(tensors: dict, says: dict, body: bytearray, rng: random.Random) -> None:
    if isinstance(says["settings"], dict):
        says["settings"][rng.choice([*says["settings"], "other"])] = rng.choice(VALUES)


def _entry(tensors: dict, says: dict, body: bytearray, rng: random.Random) -> None:
    """Another value in place of a part, of a tensor's entry, of its dtype or of a side; or one side more."""
    part = rng.choice(list(tensors))
    if not isinstance(tensors[part], dict) or not tensors[part] or rng.random() < 0.1:
        tensors[part] = rng.choice(VALUES)
        return
    name = rng.choice(list(tensors[part]))
    entry = tensors[part][name]
    if not isinstance(entry, list) or not entry or rng.random() < 0.1:
        tensors[part][name] = rng.choice([*VALUES, ["U8"] + [0, 2**47] * 3, ["U8"] + [1] * 99])
    elif rng.random() < 0.2:
        entry.append(rng.choice(VALUES))
    else:
        entry[rng.randrange(len(entry))] = rng.choice([*VALUES, *TYPES])


def _shape(tensors: dict, says: dict, body: bytearray, rng: random.Random) -> None:
    """Another shape or type of as many bytes, which only the codec can find wrong."""
    try:
        entry = rng.choice([entry for named in tensors.values() for entry in named.values()])
        size = container.ITEM_BYTES[entry[0]] * math.prod(entry[1:])
        dtype = rng.choice(TYPES)
        count = size // container.ITEM_BYTES[dtype]
        factor = rng.choice([n for n in range(1, min(count, 10_000) + 1) if count % n == 0] or [1])
        shapes = ([count], [factor, count // factor], [count // factor, factor, 1], [1, 1, 1, count])
        entry[:] = [dtype, *rng.choice(shapes)]
    except (AttributeError, TypeError, KeyError, IndexError):  # an earlier change left no such entry
        pass


def _renamed(tensors: dict, says: dict, body: bytearray, rng: random.Random) -> None:
    part = rng.choice(list(tensors))
    if not isinstance(tensors[part], dict) or not tensors[part]:
        tensors[rng.choice(("texture", "other", "x"))] = tensors.pop(part)
        return
    name = rng.choice(list(tensors[part]))
    entry = tensors[part].pop(name)
    new_part, new_name = rng.choice(
        (("texture", name), ("other", name), (part, "x"), ("x", name), (part, name + ".scale"))
    )
    if isinstance(tensors.setdefault(new_part, {}), dict):
        tensors[new_part][new_name] = entry


def _bytes(tensors: dict, says: dict, body: bytearray, rng: random.Random) -> None:
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
        digest = changed[container.HASH_AT : container.START].hex()
        resealed(path, lambda says, tensors: says.update(shared=digest))
        return partial(read, path)
    if network:
        (scratch / network.name).write_bytes(network.read_bytes())
    path.write_bytes(mutated(content, rng))
    return partial(read, path)


def read(path: Path) -> None:
    """Decode a file and ask it; raises where an answer is not finite."""
    material = loading.load(path).material
    fields_text(file_fields(container.read_header(path)))  # as `info` describes it
    answer = material.slice((0.0, 0.0, 1.0), (0.6, 0.0, 0.8), (4, 4))
    if not answer.isfinite().all():
        raise AssertionError("an answer is not finite")


TARGETS = [Target(name, partial(small, name), attack) for name in sorted(codec_entries())]

if __name__ == "__main__":
    sys.exit(main(TARGETS, __file__, __doc__))
