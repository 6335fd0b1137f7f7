"""Networks that a codec trains once for all materials: each a file of its own, named by hash in a material's file.

The file is a codec file of kind "shared": the network in its parts `decoder` and `encoder`, and in `other` two hashes
of each BTF it was trained on, the `fingerprint` and the `origin`. It lies as `CODEC.nbtf` in `$NEUBTF_SHARED`, else in
`shared/` under the cache folder; one that another takes the place of stays beside it under a name with its hash.
"""

import dataclasses
import hashlib
import json
import os
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bench.cache import cache_dir
from bench.codecs import container
from bench.errors import ContainerError, InputError, MissingDataError

if TYPE_CHECKING:
    from torch import Tensor

    from bench.btf import BTF
    from bench.codec import Fit, Parts, SharedNetwork


@dataclass(frozen=True)
class Shared:
    """A shared network, read from its file."""

    header: container.Header
    parts: "Parts"

    @property
    def origins(self) -> set[str]:
        """The `origin` of each BTF that it was trained on."""
        return {bytes(digest).hex() for digest in self.parts.other["origins"].tolist()}

    def refuse(self, btf: "BTF") -> None:
        """`InputError` where it was trained on this material, at whatever size and directions."""
        if origin(btf) in self.origins:
            raise InputError(
                f"{btf.name}: codec {self.header.codec} cannot be measured on it, as its shared network was trained "
                f"on it ({self.header.path}): choose another material, or pretrain without this one"
            )


def folder() -> Path:
    """Where shared networks lie."""
    chosen = os.environ.get("NEUBTF_SHARED")
    return Path(chosen) if chosen else cache_dir() / "shared"


def place(codec: str) -> Path:
    """The file of the network that a codec shares, which new materials are encoded with."""
    return folder() / f"{codec}{container.SUFFIX}"


def hashed_name(header: container.Header, sha256: str = "") -> str:
    """A shared file's name by its hash: that of `header`, or another of the same codec."""
    return f"{header.codec}-{(sha256 or header.sha256)[:12]}{container.SUFFIX}"


def read(path: Path) -> Shared:
    """A shared network's file. `ContainerError` says what is wrong."""
    header, parts = container.read_parts(path)
    if header.kind != container.SHARED:
        raise ContainerError(f"{path}: a material coded with {header.codec}, no network shared over materials")
    if not {"fingerprints", "origins"} <= parts.other.keys():
        raise ContainerError(f"{path}: does not say what it was trained on")
    return Shared(header, parts)


def find(codec: str, path: Path | None = None) -> Shared:
    """The network that a codec shares, at `path` or at its place. `MissingDataError` says how to get it."""
    path = path or place(codec)
    if not path.exists():
        raise missing(codec, path)
    found = read(path)
    if found.header.codec != codec:
        raise ContainerError(f"{path}: the network of codec {found.header.codec}, not of {codec}")
    return found


def missing(codec: str, path: Path | None = None) -> MissingDataError:
    """What to say where the network of a codec is not at `path`, or not at its place."""
    return MissingDataError(
        f"{path or place(codec)}: not there: codec {codec} needs the network that it shares over materials: make it "
        f"with `neubtf-bench pretrain {codec}`"
    )


def named_by(header: container.Header) -> Shared:
    """The network that a material's file names by its hash: beside it or in `folder()`, by that name or any of the
    codec's. `ContainerError` says where to put it."""
    names = (hashed_name(header, header.shared), f"{header.codec}{container.SUFFIX}")
    for path in (place / name for place in (header.path.parent, folder()) for name in names):
        if path.is_file() and container.read_header(path).sha256 == header.shared:
            return read(path)
    raise ContainerError(
        f"{header.path}: needs the network that codec {header.codec} shares over materials, sha256 {header.shared}: "
        f"put its file beside it, or into {folder()}, as {names[0]}; {place(header.codec)} is "
        + ("another one" if place(header.codec).exists() else f"not there (`neubtf-bench pretrain {header.codec}`)")
    )


def make(network: "SharedNetwork", btfs: Sequence["BTF"], fit: "Fit", path: Path) -> container.Header:
    """Train a network on some BTFs and write its file; another one that lies there keeps a name with its hash.

    A training that was killed goes on from its state, which lies beside the file as long as it is not finished.
    """
    before = container.read_header(path) if path.exists() else None  # what cannot be read stops here, not at the end
    path.parent.mkdir(parents=True, exist_ok=True)
    fingerprints, origins = [btf.fingerprint for btf in btfs], [origin(btf) for btf in btfs]
    state = path.with_name(f"{path.stem}-{_key(network, fit, fingerprints)[:12]}.state")
    parts = network.train(btfs, dataclasses.replace(fit, checkpoint=state))
    parts.other.update(fingerprints=_digests(fingerprints), origins=_digests(origins))
    if before:
        shutil.copyfile(path, path.with_name(hashed_name(before)))
    header = container.save(path, network, parts)
    state.unlink(missing_ok=True)
    return header


def _key(network: "SharedNetwork", fit: "Fit", fingerprints: list[str]) -> str:
    """All that shapes a shared file."""
    import torch

    from bench.codec import settings_dict

    known = [network.name, network.version, settings_dict(network), fit.seed, fit.device.type]
    known += [fit.threads, torch.__version__, fingerprints]
    return hashlib.sha256(json.dumps(known, sort_keys=True).encode()).hexdigest()


def _digests(digests: list[str]) -> "Tensor":
    import torch

    return torch.tensor([list(bytes.fromhex(digest)) for digest in digests], dtype=torch.uint8)


def origin(btf: "BTF") -> str:
    """A hex digest of the surface that a BTF shows, the same at every size and for all directions.

    Of a rendered material it is that of recipe, parameters and seed, of baked maps that of the names of folder and
    files, of measured data that of the whole source.
    """
    says = btf.provenance
    match says.get("source"):
        case "rendered by bench.materials":
            known: list[Any] = [says["recipe"], says["parameters"], says["seed"]]
        case "baked from maps by bench.bake":
            known = [btf.name, {role: text.partition(":")[0] for role, text in says["maps"].items()}]
        case _:
            known = [btf.source.fingerprint()]
    return hashlib.sha256(json.dumps(known, sort_keys=True).encode()).hexdigest()
