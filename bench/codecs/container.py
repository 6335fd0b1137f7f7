"""The codec file: safetensors, tensors named `part/name`, one metadata key of canonical JSON, one hash over all.

A part is a group of tensors that tables count apart: `decoder`, `texture`, and the rest of `PARTS`. The JSON holds
{format, codec, version, settings, sha256}, and `provenance` if a file was made from others. If a codec shares a network
over materials, `shared` is the hash of the network's file, whose own `kind` is "shared". If a file was fitted to a
scene, `scene` says which part of the BTF it holds. The hash covers the whole file, with its own 64 digits replaced by
zeros, so every changed byte is detected. Nothing is ever unpickled. If the setting `zstd` is true, each part is one
uint8 tensor `part/zstd`: the bytes of a safetensors file of its tensors, compressed by Zstandard.
"""

import hashlib
import json
import math
import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

from bench.files import atomic
from bench.inputs.errors import ContainerError, EncodeError, answered, installed, refuse_pipe, shown
from bench.records import fields as record_fields
from bench.records.schema import FileMetadata

if TYPE_CHECKING:
    from torch import Tensor

    from bench.codec import Codec, Parts, SharedNetwork

    Encoder = Codec | SharedNetwork

FORMAT = 1
KEY = "neubtf"
SUFFIX = ".nbtf"
MATERIAL, SHARED = "material", "shared"  # kinds of file: a material, or a network shared over materials
ZEROS = b"0" * 64  # in place of the hash while the file is hashed
LENGTH_BYTES = 8  # at the start of a safetensors file: the length of its header
HEADER_LIMIT = 1 << 24  # bytes
LEVEL = 19  # of Zstandard
# All expanded parts of a file together may have this multiple of the file's bytes, or this many bytes if that is more.
MOST_EXPANSION = 16
LEAST_EXPANDED = 64 << 20  # 64 MiB
PARTS = ("decoder", "texture", "encoder", "sampling", "other")
# The dtypes that a codec may write. `ITEM_BYTES`: by safetensors' name, the bytes of one number. `HELD`: PyTorch's
# names of the same dtypes, in the same order.
ITEM_BYTES = {"F64": 8, "F32": 4, "F16": 2, "BF16": 2, "I64": 8, "I32": 4, "I16": 2, "I8": 1, "U8": 1, "BOOL": 1}
HELD = ("float64", "float32", "float16", "bfloat16", "int64", "int32", "int16", "int8", "uint8", "bool")


@dataclass(frozen=True)
class Header:
    """The header of a codec file, read without PyTorch and checked against its hash."""

    path: Path
    codec: str
    version: int
    settings: dict[str, Any]
    sha256: str
    tensors: dict[str, tuple[str, tuple[int, ...], int]]  # "part/name" → dtype, shape, number of bytes
    file_bytes: int
    kind: str = MATERIAL
    lowest_light: float = 0.0  # cos θ of the lowest light that was fitted
    scene: dict[str, Any] = field(default_factory=dict)  # the demand it was fitted to: see `bench.demand.needed_part`
    network: str = ""  # the hash of the shared network's file, if one is needed to decode
    provenance: dict[str, Any] = field(default_factory=dict)  # the sources of the file other than a BTF

    def __repr__(self) -> str:
        """A line such as `<Header satin.nbtf: pca 4, 28,972 bytes, 11 tensors>`."""
        size = f"{self.file_bytes:,} bytes, {len(self.tensors)} tensors"
        return f"<Header {self.path}: {self.codec} {self.version}, {size}>"

    def part_bytes(self) -> dict[str, int]:
        """Bytes of tensors by part, `encoder` and `sampling` if it has them, and of `header`, the rest of the file."""
        sums = {"decoder": 0, "texture": 0, "other": 0}
        for name, (_, _, size) in self.tensors.items():
            part, _ = name.split("/", 1)
            sums[part] = sums.get(part, 0) + size
        return sums | {"header": self.file_bytes - sum(sums.values())}


def refuse_other_file(path: Path) -> None:
    """Raise an `InputError` if a file of another kind has this name, such as a measurement, or a folder or a device."""
    atomic.refuse_other_kind(path, SUFFIX, _is_codec_file)


def _is_codec_file(path: Path) -> bool:
    """Whether a file has the header of a codec file."""
    try:
        read_header(path)
    except ContainerError:
        return False
    return True


def save(path: Path, codec: "Encoder", parts: "Parts", provenance: dict[str, Any] | None = None) -> Header:
    """Write a codec file completely or not at all (a temporary name, then a rename), and read its header back."""
    refuse_other_file(Path(path))
    atomic.write(Path(path), to_bytes(codec, parts, provenance))
    return read_header(path)


def to_bytes(codec: "Encoder", parts: "Parts", provenance: dict[str, Any] | None = None) -> bytes:
    """The bytes of a codec file. The same parts give the same bytes."""
    from safetensors.torch import save as serialise

    from bench.codec import ZSTD, SharedNetwork, settings_dict

    _check_parts(codec, parts)
    tensors: dict[str, Tensor] = {}
    for part in PARTS:
        tensors_of_part = {name: tensor.detach().cpu().contiguous() for name, tensor in getattr(parts, part).items()}
        if codec.zstd and tensors_of_part:
            tensors_of_part = {ZSTD: compressed(serialise(tensors_of_part))}
        for name, tensor in tensors_of_part.items():
            tensors[f"{part}/{name}"] = tensor
    settings = settings_dict(codec)
    version = codec.version_of(settings)
    metadata = {"format": FORMAT, "codec": codec.name, "version": version, "settings": settings}
    metadata["sha256"] = ZEROS.decode()
    if isinstance(codec, SharedNetwork):
        metadata["kind"] = SHARED
    if parts.lowest_light:
        metadata["lowest_light"] = parts.lowest_light
    if parts.network:
        metadata["shared"] = parts.network.sha256
    if parts.scene:
        metadata["scene"] = parts.scene
    if provenance:
        metadata["provenance"] = provenance
    data = serialise(tensors, {KEY: json.dumps(metadata, sort_keys=True, separators=(",", ":"))})
    # The hash of the file with zeros in place of the hash; its 64 digits then replace the zeros. The header precedes
    # the tensors, so the first such zeros are those of the header.
    digits = hashlib.sha256(data).hexdigest().encode()
    return data.replace(ZEROS, digits, 1)


def _check_parts(codec: "Encoder", parts: object) -> None:
    """Raise an `EncodeError` unless these are `Parts` of tensors by name that a file can hold.

    The error names the function of the codec that made them.
    """
    from torch import Tensor

    from bench.codec import Parts, SharedNetwork

    encode: Callable[..., object] = codec.train if isinstance(codec, SharedNetwork) else codec.encode
    if not isinstance(parts, Parts):
        raise answered(encode, parts, "Parts of tensors, as Parts(texture={...})", EncodeError)
    stored: dict[str, Tensor] = {}  # those checked so far, by "part/name"
    for part in PARTS:
        tensors_of_part = getattr(parts, part)
        if not isinstance(tensors_of_part, dict):
            what = f"Parts whose {part} is of type {type(tensors_of_part).__name__}"
            raise answered(encode, what, "a dictionary of tensors by name", EncodeError)
        for name, value in tensors_of_part.items():
            if not (isinstance(name, str) and _encodable(name)):
                what = f"a tensor of {part} has the name {shown(name)}, which a file does not hold"
                raise EncodeError(f"codec {codec.name}: {what}: give it a name of Unicode characters")
            full = f"{part}/{name}"
            if not isinstance(value, Tensor):
                due = "a tensor (torch.from_numpy makes one of an array)"
                raise answered(encode, f"Parts whose {full} is of type {type(value).__name__}", due, EncodeError)
            fault = _fault(value)
            if fault:
                raise EncodeError(f"codec {codec.name}: {full} {fault}")
            for other, earlier in stored.items():
                if _overlap(value, earlier):
                    remedy = "store one of them, or a .clone()"
                    raise EncodeError(f"codec {codec.name}: {full} shares its memory with {other}: {remedy}")
            stored[full] = value


def _encodable(name: str) -> bool:
    """Whether a file can hold a name: a byte that is not UTF-8, as in some file names, cannot be written."""
    # Encoding with "ignore" drops every character that UTF-8 cannot write, so such a name comes back shorter.
    return name == name.encode("utf-8", "ignore").decode()


def _overlap(tensor: "Tensor", other: "Tensor") -> bool:
    """Whether two contiguous tensors overlap in memory. Any other tensor is copied before it is written, so False."""
    if not (tensor.is_contiguous() and other.is_contiguous() and tensor.numel() and other.numel()):
        return False
    begin, begin_of_other = tensor.data_ptr(), other.data_ptr()  # addresses in memory
    return begin < begin_of_other + other.nbytes and begin_of_other < begin + tensor.nbytes


def _fault(tensor: "Tensor") -> str:
    """Why a file cannot hold a tensor, and what to store instead; "" if it can."""
    import torch

    dtype = str(tensor.dtype).removeprefix("torch.")
    if tensor.is_nested:
        return "is nested: store its values and their lengths as two tensors"
    if tensor.layout != torch.strided:
        return "is sparse: store its values and its indices as two tensors"
    if tensor.device.type == "meta":
        return "is on the device meta, so it has no values: store a tensor with values"
    if dtype not in HELD:
        return f"is of type {dtype}, which a file does not hold: convert it to one of {', '.join(HELD)}"
    if tensor.is_floating_point() and not tensor.isfinite().all():
        bad = int((~tensor.isfinite()).sum())
        return f"holds {bad:,} of {tensor.numel():,} numbers that are not finite: guard the fit against them"
    return ""


def read_header(path: Path) -> Header:
    """Check a codec file against its own hash and read its header. `ContainerError` says what is wrong."""
    data = _read(Path(path))
    return _checked_header(Path(path), data)


def read_parts(path: Path) -> "tuple[Header, Parts]":
    """Check a codec file against its own hash and read its tensors. `ContainerError` says what is wrong."""
    from safetensors import SafetensorError
    from safetensors.torch import load as deserialise

    from bench.codec import ZSTD, Parts

    data = _read(Path(path))
    header = _checked_header(Path(path), data)
    parts = Parts(lowest_light=header.lowest_light)
    # Bytes that the remaining parts may still expand to: a small damaged file must not fill the memory.
    budget = max(LEAST_EXPANDED, MOST_EXPANSION * len(data))
    try:
        stored = deserialise(data)
    except (SafetensorError, ValueError) as error:
        raise ContainerError(f"{path}: its safetensors header is not sound ({error})") from error
    for full, tensor in stored.items():
        part, name = full.split("/", 1)
        if header.settings.get(ZSTD):  # the tensor is a compressed file of all tensors of this part
            tensors = expanded(tensor, Path(path), budget)
        else:
            tensors = {name: tensor}
        budget -= sum(values.nbytes for values in tensors.values())
        bad = _not_finite(tensors)
        if bad:  # no codec writes such numbers
            raise ContainerError(f"{path}: tensor {part}/{bad} holds numbers that are not finite")
        getattr(parts, part).update(tensors)
    return header, parts


def _not_finite(tensors: "dict[str, Tensor]") -> str:
    """The name of the first tensor with a number that is not finite; "" if there is none."""
    for name, tensor in tensors.items():
        if tensor.is_floating_point() and not tensor.isfinite().all():
            return name
    return ""


def _read(path: Path) -> bytes:
    """The bytes of a file. `ContainerError` if it cannot be read; a pipe is refused."""
    refuse_pipe(path)
    try:
        return path.read_bytes()
    except OSError as error:
        raise ContainerError(f"{path}: cannot be read ({error.strerror})") from error


def _checked_header(path: Path, data: bytes) -> Header:
    """The header of a file's bytes. `ContainerError` if they are no codec file, or not as it was written."""
    header = _json_header(path, data)
    metadata = _taken_metadata(path, header)  # what is left in `header` is an entry for each tensor
    digits = str(metadata["sha256"]).encode()
    # The file was hashed with zeros in place of the digits: see `to_bytes`.
    if hashlib.sha256(data.replace(digits, ZEROS, 1)).hexdigest().encode() != digits:
        raise ContainerError(f"{path}: altered or damaged since it was written (its hash differs): copy it again")
    tensors = {name: _tensor_entry(path, name, entry) for name, entry in header.items()}
    return Header(
        path=path,
        codec=metadata["codec"],
        version=metadata["version"],
        settings=metadata["settings"],
        sha256=metadata["sha256"],
        tensors=tensors,
        file_bytes=len(data),
        kind=metadata.get("kind", MATERIAL),
        lowest_light=metadata.get("lowest_light", 0.0),
        scene=dict(metadata.get("scene", {})),
        network=metadata.get("shared", ""),
        provenance=metadata.get("provenance", {}),
    )


def _json_header(path: Path, data: bytes) -> dict[str, Any]:
    """The safetensors header: 8 bytes of length, then JSON of name → {dtype, shape, data_offsets}."""
    length = 0
    if len(data) >= LENGTH_BYTES:
        (length,) = struct.unpack("<Q", data[:LENGTH_BYTES])  # a little-endian unsigned integer
    end_of_header = LENGTH_BYTES + length
    shortest = len(b"{}")
    if not shortest <= length <= HEADER_LIMIT or not data.startswith(b"{", LENGTH_BYTES):
        raise ContainerError(f"{path}: not a codec file (no safetensors header)")
    if end_of_header > len(data):
        short = f"it has {len(data)} bytes, but its header needs {end_of_header}"
        raise ContainerError(f"{path}: truncated: {short}: copy it again")
    try:
        header = json.loads(data[LENGTH_BYTES:end_of_header])
        end = 0  # where the last tensor ends, in bytes after the header
        for name, entry in header.items():
            if name == "__metadata__":
                continue
            begin_of_tensor, end_of_tensor = entry["data_offsets"]
            if not (_is_size_or_place(begin_of_tensor) and _is_size_or_place(end_of_tensor)):
                raise ValueError
            end = max(end, end_of_tensor)
        missing = end_of_header + end - len(data)
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise ContainerError(f"{path}: not a codec file (its safetensors header is not sound)") from error
    if missing > 0:
        raise ContainerError(f"{path}: truncated: {missing} bytes are missing at its end: copy it again")
    return header


def _taken_metadata(path: Path, header: dict[str, Any]) -> FileMetadata:
    """The suite's own metadata; takes it out of the safetensors header, so that only tensors are left there."""
    try:
        metadata = json.loads(header.pop("__metadata__")[KEY])
        newer = isinstance(metadata["format"], int) and metadata["format"] > FORMAT
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise ContainerError(f"{path}: a safetensors file, but not one of this suite (no {KEY!r} metadata)") from error
    if newer:
        raise ContainerError(
            f"{path}: format {metadata['format']} is newer than this version reads ({FORMAT}): upgrade"
        )
    fault = record_fields.fault_of(FileMetadata, metadata)  # "" if it has every field, each of its type
    if fault:
        raise ContainerError(f"{path}: its {KEY!r} metadata is not sound: {fault}: encode it again")
    return metadata


def _is_size_or_place(value: object) -> bool:
    """Whether a value of JSON is a whole number from 0 to below 2^48, the range of sizes and of places in a file."""
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value < 1 << 48


def _tensor_entry(path: Path, name: str, entry: dict[str, Any]) -> tuple[str, tuple[int, ...], int]:
    """The dtype, shape and number of bytes of a tensor, from its entry in the header.

    `ContainerError` if they contradict each other, or if the name is not that of a part and a tensor.
    """
    try:
        begin, end = entry["data_offsets"]
        shape = tuple(entry["shape"])
        part, slash, _ = name.partition("/")
        if part not in PARTS or not slash or not all(map(_is_size_or_place, shape)):
            raise ValueError
        if end - begin != ITEM_BYTES[entry["dtype"]] * math.prod(shape):
            raise ValueError
    except (KeyError, ValueError, TypeError) as error:
        raise ContainerError(f"{path}: tensor {name!r:.60} is not sound") from error
    return entry["dtype"], shape, end - begin


def compressed(data: bytes) -> "Tensor":
    """Compress bytes into a tensor (n,) uint8."""
    import torch

    packed = _zstandard("zstd = true").ZstdCompressor(level=LEVEL).compress(data)
    return torch.frombuffer(bytearray(packed), dtype=torch.uint8)


def expanded(payload: "Tensor", path: Path, most: int) -> "dict[str, Tensor]":
    """Expand a compressed safetensors file of at most `most` bytes. `ContainerError` if it is damaged."""
    from safetensors import SafetensorError
    from safetensors.torch import load

    zstandard = _zstandard(str(path))
    if str(payload.dtype) != "torch.uint8":
        raise ContainerError(f"{path}: a compressed part is {payload.dtype}, not bytes")
    data = payload.numpy().tobytes()
    try:
        if not 0 <= zstandard.frame_content_size(data) <= most:
            raise ContainerError(f"{path}: a compressed part gives no size, or one far too large for the file")
        return load(zstandard.ZstdDecompressor().decompress(data))
    except (zstandard.ZstdError, SafetensorError) as error:
        raise ContainerError(f"{path}: a compressed part is not sound ({error})") from error


def _zstandard(what: str) -> ModuleType:
    """The package zstandard, which is optional. If it is missing, an `InputError` says that `what` needs it."""
    with installed(f"{what}: needs the package zstandard: pip install 'neubtf-bench[zstd]'"):
        import zstandard
    return zstandard
