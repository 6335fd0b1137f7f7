"""Counts what a decoder holds and its file stores, and compares it with what its codec declares.

A file has a decoder part, the weights of networks and tables such as codebooks, and textures, numbers for each texel; a
decoder is what it decodes to. Every number of the file's decoder part is one of a network's parameters or one of a
table's; both are declared. So no number of a decoder is left out of the tables, whatever holds it: modules, frozen
weights or plain tensors.
"""

import math

import torch
from torch import Tensor, nn

from bench.codec import Parts
from bench.codecs.container import PARTS
from bench.material import Material, parameters

_OF_ROUNDING = {"scale", "low", "step", "size"}  # last parts of the names of tensors that tell how another is rounded
MANY = 1_000  # a number that a file repeats so often is worth a note


def fault(material: Material, parts: Parts) -> str:
    """What is wrong with the declared cost of a material, given the parts of its file; "" if it is right."""
    return _fault_of_decoder(material, parts.decoder) or _fault_of_textures(material, parts.texture)


def _fault_of_decoder(material: Material, decoder: dict[str, Tensor]) -> str:
    """What is wrong with the declared parameters and tables, given the file's decoder part; "" if they are right."""
    declared = material.cost
    held = parameters(material)  # in modules
    stored = decoder_floats(decoder)  # a range: from the fewest numbers that the part may hold to the most
    if declared.parameters < held:
        return f"declares {declared.parameters:,} parameters, holds {held:,}: {_remedy(held)}"
    explained = declared.parameters + declared.table_floats
    # Parameters outside modules are not held, but then the file must store them.
    if declared.parameters > held and explained >= stored.stop:
        return f"declares {declared.parameters:,} parameters, holds {held:,} in modules: {_remedy(held)}"
    if stored.start > explained:  # even the fewest numbers that the part may hold
        rest = stored.start - explained
        total = declared.table_floats + rest
        what = f"the file's decoder part stores {stored.start:,} numbers; {rest:,} of them are neither parameters nor"
        remedy = f"{_remedy(declared.parameters + rest)}, or table_floats={total} if they are a basis or a codebook"
        return f"{what} declared as tables: {remedy}"
    return ""


def _remedy(count: int) -> str:
    """What to write in the codec for so many parameters."""
    return f"declare DecoderCost(parameters={count})"


def _fault_of_textures(material: Material, texture: dict[str, Tensor]) -> str:
    """What is wrong with the declared textures, given those of the file; "" if they are right. The numbers in them may
    be those of the file or those in memory."""
    declared = material.cost
    held = held_floats(material)
    floats = texture_floats(texture)
    if declared.texture_floats not in floats and declared.texture_floats != held:
        fewest, most = floats[0], floats[-1]
        stores = f"{fewest:,}" if fewest == most else f"{fewest:,} to {most:,}"
        return f"declares {declared.texture_floats:,} numbers in textures, stores {stores} and holds {held:,}"
    channels = texture_channels(texture, material.size)
    if channels is not None and declared.texture_channels != channels:
        return f"declares {declared.texture_channels:,} texture channels, stores {channels:,}"
    return ""


def constant_bytes(parts: Parts) -> dict[str, int]:
    """By `part/name`: the bytes of each tensor of a file that holds one number alone, at least `MANY` times."""
    sizes = {}
    for part in PARTS:
        for name, values in getattr(parts, part).items():
            if values.numel() >= MANY and bool((values == values.flatten()[0]).all()):
                sizes[f"{part}/{name}"] = values.nbytes
    return sizes


def decoder_floats(decoder: dict[str, Tensor]) -> range:
    """The number of numbers in the decoder part of a file: one count, or a range.

    It is a range if codes are packed into bytes, or if equal tensors are stored twice, as those of tied layers are:
    they may count once. What tells how another tensor is rounded, such as `NAME.step` beside `NAME`, is not counted.
    """
    counted = {}
    for name, values in decoder.items():
        rounded_name, _, what = name.rpartition(".")
        if rounded_name not in decoder or what not in _OF_ROUNDING:
            counted[name] = values
    different: dict[str, Tensor] = {}  # those of `counted` without repetitions
    for name, values in counted.items():
        if not any(values.dtype == other.dtype and torch.equal(values, other) for other in different.values()):
            different[name] = values
    fewest = _with_packed(_plain_numbers(different), different)
    most = _with_packed(_plain_numbers(counted), counted)
    return range(fewest.start, most.stop)


def _plain_numbers(tensors: dict[str, Tensor]) -> int:
    """The numbers in all tensors but those that may be packed."""
    return sum(values.numel() for values in tensors.values() if not _may_be_packed(values))


def texture_floats(texture: dict[str, Tensor]) -> range:
    """The number of numbers in the textures of a file: one count, or a range if indices are packed into bytes.

    Single floats and vectors of floats are not counted: they are scales, offsets and the like.
    """
    counted = sum(values.numel() for values in texture.values() if values.ndim > 1)
    return _with_packed(counted, texture)


def _may_be_packed(values: Tensor) -> bool:
    """Whether a tensor may hold indices packed into bytes: a vector of whole numbers."""
    return values.ndim < 2 and not values.is_floating_point()


def _with_packed(counted: int, tensors: dict[str, Tensor]) -> range:
    """The range of `counted` numbers and those packed into vectors of bytes; a packed index has 1 to 32 bits."""
    bits = 8 * sum(values.nbytes for values in tensors.values() if _may_be_packed(values))
    fewest = counted + math.ceil(bits / 32)
    most = counted + bits
    return range(fewest, most + 1)


def held_floats(material: Material) -> int:
    """Count the numbers of a decoder outside its networks: textures, and the levels and copies made of them."""
    networks = material.modules()  # all modules that have parameters
    values: list[Tensor] = []
    for attribute in vars(material).values():
        if isinstance(attribute, Tensor):
            values.append(attribute)
        elif isinstance(attribute, nn.Module) and attribute not in networks:
            values += attribute.buffers()  # it has no parameters
    return sum(value.numel() for value in values if value.is_floating_point())


def texture_channels(texture: dict[str, Tensor], size: tuple[int, int]) -> int | None:
    """Numbers a texel of the finest textures, by their shapes; None if one is packed or has another layout.

    The finest textures are those of (H, W), or where every texture is coarser, the largest of them.
    """
    shapes = [tuple(values.shape) for values in texture.values() if values.ndim > 1]
    channels = [_channels_of_shape(shape, size) for shape in shapes]
    packed = any(_may_be_packed(values) for values in texture.values())
    if packed or None in channels:
        return None
    full = sum(count for count in channels if count)  # of textures of (H, W)
    if full or not shapes:
        return full
    # Every texture (h, w, …) is coarser: count the channels of those with the most texels.
    largest = max(math.prod(shape[:2]) for shape in shapes)
    return sum(math.prod(shape[2:]) for shape in shapes if math.prod(shape[:2]) == largest)


def _channels_of_shape(shape: tuple[int, ...], size: tuple[int, int]) -> int | None:
    """The numbers a texel of a tensor whose shape contains `size` (H, W), or whose rows are the texels of all levels.

    0 for a coarser texture, None for another layout.
    """
    pairs_of_sides = [shape[place : place + 2] for place in range(len(shape) - 1)]
    if size in pairs_of_sides:  # H and W follow each other
        return math.prod(shape) // math.prod(size)
    if len(shape) == 2 and shape[0] >= math.prod(size):
        return shape[1]
    coarser = len(shape) > 2 and math.prod(shape[:2]) < math.prod(size)
    return 0 if coarser else None
