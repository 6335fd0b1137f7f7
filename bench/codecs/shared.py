"""Networks that a codec trains once for all materials: each has its own file, which a material's file names by hash.

The file is a codec file of kind "shared": the network in its parts `decoder` and `encoder`, and in `other` two hashes
of each BTF it was trained on, the `fingerprint` and the `origin`. A codec may ship one. A user's own network is stored
as `CODEC.nbtf` in `$NEUBTF_SHARED`, else in `shared/` under the cache folder, and is preferred; a replaced file stays
beside it under a name with its hash.
"""

import dataclasses
import hashlib
import json
import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import torch

from bench.btf import BAKED, BTF, RENDERED
from bench.codec import Codec, Fit, Parts, SharedNetwork, TrainedNetwork, settings_dict
from bench.codecs import container
from bench.files import atomic
from bench.files.atomic import SHARED, cache_dir, make_folder
from bench.inputs.errors import ContainerError, InputError, MissingDataError


def folder() -> Path:
    """The folder of the user's own shared networks."""
    folder_of_user = os.environ.get("NEUBTF_SHARED")
    return Path(folder_of_user) if folder_of_user else cache_dir() / SHARED


def place(codec: str) -> Path:
    """The path of the user's own network of a codec."""
    return folder() / f"{codec}{container.SUFFIX}"


def hashed_name(codec: str, sha256: str) -> str:
    """The name of a shared network's file by its hash."""
    return f"{codec}-{sha256[:12]}{container.SUFFIX}"


def read(path: Path) -> TrainedNetwork:
    """Read a shared network's file. `ContainerError` says what is wrong."""
    return _network_of_file(*container.read_parts(path))


def _network_of_file(header: container.Header, parts: Parts) -> TrainedNetwork:
    """The shared network that a file holds. `ContainerError` if the file is a material, or is not complete."""
    remedy = f"make one with `neubtf-bench pretrain {header.codec}`"
    if header.kind != container.SHARED:
        raise ContainerError(f"{header.path}: it is a material of codec {header.codec}, not a shared network: {remedy}")
    if not {"fingerprints", "origins"} <= parts.other.keys():
        raise ContainerError(f"{header.path}: it does not say what it was trained on: {remedy}")
    return TrainedNetwork(header.path, header.codec, header.settings, header.sha256, header.file_bytes, parts)


def find(codec: str, path: Path | None = None) -> TrainedNetwork:
    """Read a codec's shared network from `path` or its default place.

    `MissingDataError` says how to get it; `ContainerError` if the file is damaged, or holds something else.
    """
    file = path or place(codec)
    if not file.exists():
        raise missing_network(codec, file)
    network = read(file)
    if network.codec != codec:
        fault = f"this is the network of codec {network.codec}, not of {codec}"
        raise ContainerError(f"{file}: {fault}: make that with `neubtf-bench pretrain {codec}`")
    return network


def find_for(codec: Codec | type[Codec]) -> TrainedNetwork | None:
    """Read the network that a codec encodes with: the user's own, else the shipped one; None if it uses none."""
    if codec.network is None:
        return None
    shipped = codec.network.shipped  # the file of the network that comes with the codec; None if none does
    if shipped is not None and not place(codec.name).exists():
        return find(codec.name, shipped)
    return find(codec.name)


def missing_network(codec: str, path: Path | None = None) -> MissingDataError:
    """The error, to be raised, for a shared network that is missing at `path`, or at its default place."""
    return MissingDataError(
        f"{path or place(codec)}: missing: codec {codec} needs the network that it shares over materials: make it "
        f"with `neubtf-bench pretrain {codec}`"
    )


def find_named_by(header: container.Header, shipped: Path | None) -> TrainedNetwork:
    """Find the network that a material's file names by hash.

    It is looked for beside the file, then in `folder()`, each time under the name with its hash and under the codec's
    name; at last the `shipped` one is tried. `ContainerError` says where to put it.
    """
    hashed = hashed_name(header.codec, header.network)
    plain = f"{header.codec}{container.SUFFIX}"
    beside = header.path.parent
    users = folder()
    paths = [beside / hashed, beside / plain, users / hashed, users / plain]
    if shipped:
        paths.append(shipped)
    for path in paths:
        if not path.is_file():
            continue
        header_of_network, parts = container.read_parts(path)
        if header_of_network.sha256 == header.network:
            return _network_of_file(header_of_network, parts)
    users_own = place(header.codec)
    what = "another one" if users_own.exists() else f"missing (`neubtf-bench pretrain {header.codec}`)"
    raise ContainerError(
        f"{header.path}: it needs the shared network of codec {header.codec}, sha256 {header.network}: "
        f"put its file beside it, or into {users}, as {hashed}; {users_own} is {what}"
    )


def make(network: SharedNetwork, btfs: Sequence[BTF], fit: Fit, path: Path) -> container.Header:
    """Train a network on some BTFs and write its file; a copy of an existing file stays beside it under its hash.

    An interrupted training resumes from its state, which is kept beside the file until it is finished.
    """
    if path.exists():
        container.read_header(path)  # an unreadable file fails now, not after hours of training
    make_folder(path.parent)
    state = path.with_name(f"{path.stem}-{_training_key(network, btfs, fit)}.state")
    parts = network.train(btfs, dataclasses.replace(fit, checkpoint=state))
    parts.other["fingerprints"] = _bytes_of(btf.fingerprint for btf in btfs)
    parts.other["origins"] = _bytes_of(map(origin, btfs))
    if path.exists():  # codec files may need it; another training may have replaced it meanwhile
        replaced = container.read_header(path)
        atomic.write(path.with_name(hashed_name(replaced.codec, replaced.sha256)), path.read_bytes())
    header = container.save(path, network, parts)
    state.unlink(missing_ok=True)
    return header


def _training_key(network: SharedNetwork, btfs: Sequence[BTF], fit: Fit) -> str:
    """A hash of all that determines the file of a network: a training resumes only from a state with the same."""
    seen = [btf.fingerprint for btf in (*btfs, *fit.unseen)]  # `unseen` are those of the curve of the training
    determining = [network.name, network.version, settings_dict(network), fit.seed, fit.device.type]
    determining += [fit.threads, torch.__version__, seen]
    return hashlib.sha256(json.dumps(determining, sort_keys=True).encode()).hexdigest()[:12]


def _bytes_of(digests: Iterable[str]) -> torch.Tensor:
    """Hex digests as bytes, a row of 32 for each, (n, 32)."""
    return torch.tensor([list(bytes.fromhex(digest)) for digest in digests], dtype=torch.uint8)


def origin(btf: BTF) -> str:
    """A hex digest of the surface that a BTF shows, equal for all sizes and directions.

    A rendered material is hashed by recipe, parameters and seed; baked maps by the names of folder and files; measured
    data by the whole source.
    """
    provenance = btf.provenance
    if provenance.get("source") == RENDERED:
        identity: list[Any] = [provenance["recipe"], provenance["parameters"], provenance["seed"]]
    elif provenance.get("source") == BAKED:
        # A map is described as "file: how it was read"; the file's name stays the same for all sizes.
        file_of_role = {role: text.partition(":")[0] for role, text in provenance["maps"].items()}
        identity = [btf.name, file_of_role]
    else:
        identity = [btf.source.fingerprint()]
    return hashlib.sha256(json.dumps(identity, sort_keys=True).encode()).hexdigest()


def refuse_training_material(network: TrainedNetwork | None, btf: BTF) -> None:
    """Raise `InputError` if a network was trained on this material, at any size and directions; without one, pass."""
    if network is not None and origin(btf) in network.origins:
        raise InputError(
            f"{btf.name}: codec {network.codec} cannot be measured on it, because its shared network was trained "
            f"on it ({network.path}): choose another material, or pretrain without this one"
        )
