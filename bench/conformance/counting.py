"""Counts the numbers in the textures of a file and of its decoder, to compare them with the codec's declaration."""

import math

from torch import Tensor, nn

from bench.material import Material


def texture_floats(texture: dict[str, Tensor]) -> range:
    """The number of numbers in the textures of a file: one count, or a range if indices are packed into bytes.

    Vectors of floats are not counted: they are scales, offsets and the like. A packed index has 1 to 32 bits.
    """
    counted = sum(values.numel() for values in texture.values() if values.ndim > 1)
    packed = 8 * sum(values.nbytes for values in texture.values() if values.ndim < 2 and not values.is_floating_point())
    return range(counted + math.ceil(packed / 32), counted + packed + 1)


def held_floats(material: Material) -> int:
    """Count the numbers of a decoder outside its network: textures, and the levels and copies made of them."""
    held, network = list(vars(material).values()), material.modules()
    values = [value for value in held if isinstance(value, Tensor)]
    plain = (value for value in held if isinstance(value, nn.Module) and value not in network)
    values += [buffer for module in plain for buffer in module.buffers()]
    return sum(value.numel() for value in values if value.is_floating_point())


def texture_channels(texture: dict[str, Tensor], size: tuple[int, int]) -> int | None:
    """Numbers a texel of the finest textures, by their shapes; None if one is packed or has another layout."""
    channels = [_channels(tuple(values.shape), size) for values in texture.values() if values.ndim != 1]
    packed = any(values.ndim == 1 and not values.is_floating_point() for values in texture.values())
    return None if packed or None in channels else sum(count for count in channels if count)


def _channels(shape: tuple[int, ...], size: tuple[int, int]) -> int | None:
    """The channels of one tensor: its shape contains (H, W), or its rows are the texels of all levels."""
    places = [i for i in range(len(shape) - 1) if shape[i : i + 2] == size]
    if places:
        return math.prod(shape) // math.prod(size)
    if len(shape) == 2 and shape[0] >= math.prod(size):
        return shape[1]
    coarser = len(shape) > 2 and math.prod(shape[:2]) < math.prod(size)
    return 0 if coarser else None
