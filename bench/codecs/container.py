"""The codec file: a short header, deflated JSON that says what the file holds, and the tensors, one after another.

    bytes 0-3    NBTF
    byte  4      the format, 2
    bytes 5-12   two u32, little-endian: the bytes of the deflated JSON, and those of the JSON itself
    bytes 13-44  the sha256 of the whole file, with zeros in place of these 32 bytes: every changed byte is detected
    then         the JSON, as a raw stream of deflate
    then         the numbers of the tensors, little-endian, in the order of the JSON, without gaps

The JSON holds {codec, version, settings, tensors}; `tensors` is {part: {name: [dtype, sides of the shape …]}}. A part
is a group of tensors that tables count apart: `decoder`, `texture`, and the rest of `PARTS`. All settings are there,
also those that have their defaults, so a file explains itself without the code that wrote it. `lowest_light` is cos θ
of the lowest light that was fitted (`Material.faded`). `provenance` is there if the file was made from others. If a
codec shares a network over materials, `shared` is the hash of the network's file, whose own `kind` is "shared". If a
file was fitted to a scene, `scene` says which part of the BTF it holds. Nothing is ever unpickled.
"""

import hashlib
import json
import math
import struct
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bench.files import atomic
from bench.inputs.errors import ContainerError, EncodeError, answered, refuse_pipe, shown
from bench.records import fields as record_fields
from bench.records.schema import FileMetadata

if TYPE_CHECKING:
    from torch import Tensor

    from bench.codec import Codec, Parts, SharedNetwork

    Encoder = Codec | SharedNetwork

MAGIC = b"NBTF"
FORMAT = 2
LENGTHS = struct.Struct("<II")  # of the deflated JSON, and of the JSON
HASH_AT = len(MAGIC) + 1 + LENGTHS.size
HASH_BYTES = 32
START = HASH_AT + HASH_BYTES  # where the deflated JSON begins
HEADER_LIMIT = 1 << 22  # bytes, of the JSON deflated or not: what a parser makes of them must not fill the memory
SUFFIX = ".nbtf"
MATERIAL, SHARED = "material", "shared"  # kinds of file: a material, or a network shared over materials
PARTS = ("decoder", "texture", "encoder", "sampling", "other")
# The dtypes that a codec may write, by the name in a file: the bytes of one number, and PyTorch's name.
ITEM_BYTES = {"F64": 8, "F32": 4, "F16": 2, "BF16": 2, "I64": 8, "I32": 4, "I16": 2, "I8": 1, "U8": 1, "BOOL": 1}
NAME_IN_TORCH = {
    "F64": "float64",
    "F32": "float32",
    "F16": "float16",
    "BF16": "bfloat16",
    "I64": "int64",
    "I32": "int32",
    "I16": "int16",
    "I8": "int8",
    "U8": "uint8",
    "BOOL": "bool",
}
MOST_SIDES = 64  # of a tensor, the limit of PyTorch
Entry = tuple[str, tuple[int, ...], int]  # dtype, shape, number of bytes of a tensor


@dataclass(frozen=True)
class Header:
    """The header of a codec file, read without PyTorch and checked against its hash."""

    path: Path
    codec: str
    version: int
    settings: dict[str, Any]
    sha256: str
    tensors: dict[str, Entry]  # by "part/name", in the order of the file
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
    """The bytes of a codec file. The same parts give the same bytes, with the same version of zlib.

    `EncodeError` if no file can hold the parts.
    """
    from bench.codec import SharedNetwork, settings_dict

    _check_parts(codec, parts)
    tensors: dict[str, dict[str, Tensor]] = {part: getattr(parts, part) for part in PARTS if getattr(parts, part)}
    settings = settings_dict(codec)
    fields: dict[str, Any] = {"codec": codec.name, "version": codec.version_of(settings), "settings": settings}
    if isinstance(codec, SharedNetwork):
        fields["kind"] = SHARED
    if parts.lowest_light:
        fields["lowest_light"] = parts.lowest_light
    if parts.network:
        fields["shared"] = parts.network.sha256
    if parts.scene:
        fields["scene"] = parts.scene
    if provenance:
        fields["provenance"] = provenance
    lengths, *body = _packed(fields, tensors)
    start = MAGIC + bytes([FORMAT]) + lengths
    return b"".join((start, _digest(start, *body), *body))


def _packed(fields: dict[str, Any], tensors: "dict[str, dict[str, Tensor]]") -> list[bytes]:
    """The two lengths, the deflated JSON of the fields and of {part: {name: tensor}}, and the bytes of each tensor."""
    import torch

    name_in_file = {name_in_torch: name for name, name_in_torch in NAME_IN_TORCH.items()}
    listed: dict[str, dict[str, list[str | int]]] = {}
    payload = []
    for part in sorted(tensors):  # the order in which JSON with sorted keys has them
        listed[part] = {}
        for name, tensor in sorted(tensors[part].items()):
            listed[part][name] = [name_in_file[str(tensor.dtype).removeprefix("torch.")], *tensor.shape]
            payload.append(tensor.detach().cpu().contiguous().reshape(-1).view(torch.uint8).numpy().tobytes())
    text = json.dumps(fields | {"tensors": listed}, sort_keys=True, separators=(",", ":")).encode()
    deflater = zlib.compressobj(9, zlib.DEFLATED, -zlib.MAX_WBITS)  # negative: without the header of zlib
    deflated = deflater.compress(text) + deflater.flush()
    longest = max(len(text), len(deflated))
    if longest > HEADER_LIMIT:
        raise EncodeError(f"a header of {longest:,} bytes, but the limit is {HEADER_LIMIT:,}: store fewer tensors")
    return [LENGTHS.pack(len(deflated), len(text)), deflated, *payload]


def _digest(start: bytes, *body: bytes | memoryview) -> bytes:
    """The hash of a file: of what precedes it, of zeros in its own place, and of what follows it."""
    digest = hashlib.sha256(start + bytes(HASH_BYTES))
    for piece in body:
        digest.update(piece)
    return digest.digest()


def _check_parts(codec: "Encoder", parts: object) -> None:
    """Raise an `EncodeError` unless these are `Parts` of tensors by name that a file can hold.

    The error names the function of the codec that made them.
    """
    from torch import Tensor

    from bench.codec import Parts, SharedNetwork

    encode: Callable[..., object] = codec.train if isinstance(codec, SharedNetwork) else codec.encode
    if not isinstance(parts, Parts):
        raise answered(encode, parts, "Parts of tensors, as Parts(texture={...})", EncodeError)
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
            fault = _fault_of_tensor(value)
            if fault:
                raise EncodeError(f"codec {codec.name}: {full} {fault}")


def _encodable(name: str) -> bool:
    """Whether a file can hold a name: a byte that is not UTF-8, as in some file names, cannot be written."""
    # Encoding with "ignore" drops every character that UTF-8 cannot write, so such a name comes back shorter.
    return name == name.encode("utf-8", "ignore").decode()


def _fault_of_tensor(tensor: "Tensor") -> str:
    """Why a file cannot hold a tensor, and what to store instead; "" if it can."""
    import torch

    dtype = str(tensor.dtype).removeprefix("torch.")
    if tensor.is_nested:
        return "is nested: store its values and their lengths as two tensors"
    if tensor.layout != torch.strided:
        return "is sparse: store its values and its indices as two tensors"
    if tensor.device.type == "meta":
        return "is on the device meta, so it has no values: store a tensor with values"
    if dtype not in NAME_IN_TORCH.values():
        known = ", ".join(NAME_IN_TORCH.values())
        return f"is of type {dtype}, which a file does not hold: convert it to one of {known}"
    if tensor.is_floating_point() and not tensor.isfinite().all():
        bad = int((~tensor.isfinite()).sum())
        return f"holds {bad:,} of {tensor.numel():,} numbers that are not finite: guard the fit against them"
    return ""


def read_header(path: Path) -> Header:
    """Check a codec file against its own hash and read its header. `ContainerError` says what is wrong."""
    header, _ = _header_and_payload(Path(path), _read(Path(path)))
    return header


def read_parts(path: Path) -> "tuple[Header, Parts]":
    """Check a codec file against its own hash and read its tensors. `ContainerError` says what is wrong."""
    from bench.codec import Parts

    header, payload = _header_and_payload(Path(path), _read(Path(path)))
    parts = Parts(lowest_light=header.lowest_light)
    for full, tensor in _tensors_of(str(path), header.tensors, payload).items():
        part, name = full.split("/", 1)
        getattr(parts, part)[name] = tensor
    return header, parts


def _tensors_of(label: str, entries: Mapping[str, Entry], payload: memoryview) -> "dict[str, Tensor]":
    """The tensors of a payload by "part/name", each a copy in memory of its own. `label` names the file in errors.

    `ContainerError` if numbers are not finite, or a truth value is neither 0 nor 1: no codec writes these.
    """
    import torch

    tensors = {}
    begin = 0
    for name, (dtype, shape, size) in entries.items():
        tensor = torch.empty(shape, dtype=getattr(torch, NAME_IN_TORCH[dtype]))
        numbers = tensor.reshape(-1).view(torch.uint8)
        numbers.numpy().data[:] = payload[begin : begin + size]
        begin += size
        if tensor.is_floating_point() and not tensor.isfinite().all():
            raise ContainerError(f"{label}: tensor {name} holds numbers that are not finite: encode it again")
        if tensor.dtype == torch.bool and (numbers > 1).any():
            raise ContainerError(f"{label}: tensor {name} holds truth values other than 0 and 1: encode it again")
        tensors[name] = tensor
    return tensors


def _read(path: Path) -> bytes:
    """The bytes of a file. `ContainerError` if it cannot be read; a pipe is refused."""
    refuse_pipe(path)
    try:
        return path.read_bytes()
    except FileNotFoundError as error:
        raise ContainerError(f"{path}: there is no such file: check the path") from error
    except OSError as error:
        raise ContainerError(f"{path}: cannot be read ({error.strerror}): give a file that can be read") from error


def _header_and_payload(path: Path, data: bytes) -> tuple[Header, memoryview]:
    """The header of a file's bytes, and the bytes of its tensors.

    `ContainerError` if they are no codec file, or not as it was written.
    """
    _check_start(path, data)
    body = memoryview(data)[START:]
    fields, entries, payload = _parsed(str(path), data[len(MAGIC) + 1 : HASH_AT], body)
    digest = data[HASH_AT:START]
    if _digest(data[:HASH_AT], body) != digest:
        raise ContainerError(f"{path}: altered or damaged since it was written (its hash differs): copy it again")
    fault = record_fields.fault_of(FileMetadata, fields)  # "" if it has every field, each of its type
    if fault:
        raise ContainerError(f"{path}: its header is not sound: {fault}: encode it again")
    return Header(
        path=path,
        codec=fields["codec"],
        version=fields["version"],
        settings=fields["settings"],
        sha256=digest.hex(),
        tensors=entries,
        file_bytes=len(data),
        kind=fields.get("kind", MATERIAL),
        lowest_light=fields.get("lowest_light", 0.0),
        scene=fields.get("scene", {}),
        network=fields.get("shared", ""),
        provenance=fields.get("provenance", {}),
    ), payload


def _check_start(path: Path, data: bytes) -> None:
    """`ContainerError` unless bytes begin as a codec file of this format."""
    if not data.startswith(MAGIC):
        fault = f"not a codec file (it does not begin with {MAGIC.decode()})"
        raise ContainerError(f"{path}: {fault}: `neubtf-bench encode` makes one of a BTF")
    if len(data) < START:
        short = f"it has {len(data)} bytes, but the start of a codec file needs {START}"
        raise ContainerError(f"{path}: truncated: {short}: copy it again")
    file_format = data[len(MAGIC)]
    if file_format > FORMAT:
        raise ContainerError(f"{path}: format {file_format} is newer than this version reads ({FORMAT}): upgrade")
    if file_format < FORMAT:
        fault = f"not a codec file (no format {file_format} begins with {MAGIC.decode()})"
        raise ContainerError(f"{path}: {fault}: `neubtf-bench encode` makes one of a BTF")


def _parsed(label: str, lengths: bytes, body: memoryview) -> tuple[dict[str, Any], dict[str, Entry], memoryview]:
    """The fields of the JSON other than the tensors, an entry for each tensor by "part/name", and the tensors' bytes.

    `body` is all that follows the lengths and the hash. `ContainerError` unless it is exactly as long as the lengths
    and the entries say; `label` names the file in it.
    """
    deflated, expanded_bytes = LENGTHS.unpack(lengths)
    longest = max(deflated, expanded_bytes)
    if longest > HEADER_LIMIT:
        fault = f"a header of {longest:,} bytes, but the limit is {HEADER_LIMIT:,}"
        raise ContainerError(f"{label}: {fault}: copy it again")
    if deflated > len(body):
        short = f"its header has {len(body)} of {deflated} bytes"
        raise ContainerError(f"{label}: truncated: {short}: copy it again")
    fields = _json_header(label, body[:deflated], expanded_bytes)
    entries = _entries(label, fields.pop("tensors", None))
    payload = body[deflated:]
    missing = sum(size for _, _, size in entries.values()) - len(payload)
    if missing > 0:
        raise ContainerError(f"{label}: truncated: {missing} bytes are missing at its end: copy it again")
    if missing < 0:
        raise ContainerError(f"{label}: {-missing} bytes follow its last tensor: copy it again")
    return fields, entries, payload


def _json_header(label: str, deflated: memoryview, size: int) -> dict[str, Any]:
    """The object of a deflated JSON of exactly `size` bytes. `ContainerError` if it is damaged."""
    inflater = zlib.decompressobj(-zlib.MAX_WBITS)
    try:
        text = inflater.decompress(deflated, size + 1)  # one more byte at most, which would say that the size is wrong
        if len(text) != size or not inflater.eof or inflater.unused_data:
            raise ValueError(f"not {size} bytes of JSON")
        fields = json.loads(text, object_pairs_hook=_without_duplicates)
        if not isinstance(fields, dict):
            raise ValueError("no object")
    except (zlib.error, ValueError, RecursionError) as error:
        raise ContainerError(f"{label}: its header is not sound ({error!s:.80}): copy it again") from error
    return fields


def _without_duplicates(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """An object of JSON; `ValueError` if it has a name twice."""
    values = dict(pairs)
    if len(values) < len(pairs):
        raise ValueError("a name occurs twice")
    return values


def _entries(label: str, tensors: object) -> dict[str, Entry]:
    """The entry of each tensor by "part/name", of {part: {name: [dtype, sides of the shape …]}}.

    `ContainerError` if there is no such part, or a dtype or a shape is not possible.
    """
    if not isinstance(tensors, dict):
        raise ContainerError(f"{label}: its header lists no tensors: encode it again")
    entries = {}
    for part, named in tensors.items():
        if part not in PARTS or not isinstance(named, dict):
            raise ContainerError(f"{label}: its header has an unknown part {shown(part)}: encode it again")
        for name, listed in named.items():
            full = f"{part}/{name}"
            try:
                if not _encodable(name):
                    raise ValueError
                entries[full] = _entry(listed)
            except (KeyError, ValueError, TypeError) as error:
                raise ContainerError(f"{label}: tensor {full!r:.60} is not sound: encode it again") from error
    return entries


def _entry(listed: object) -> Entry:
    """The dtype, shape and number of bytes of [dtype, sides of the shape …]; an error of Python's if it is not so."""
    if not isinstance(listed, list):
        raise TypeError
    dtype, *shape = listed
    if len(shape) > MOST_SIDES or not all(map(_is_size, shape)):
        raise ValueError
    # Not even the sides beside a side of 0 may be beyond all measure: PyTorch's strides would overflow.
    if not _is_size(ITEM_BYTES[dtype] * math.prod(max(side, 1) for side in shape)):
        raise ValueError
    return dtype, tuple(shape), ITEM_BYTES[dtype] * math.prod(shape)


def _is_size(value: object) -> bool:
    """Whether a value of JSON is a whole number from 0 to below 2^48, the range of sizes."""
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value < 1 << 48
