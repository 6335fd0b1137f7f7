"""The texture format BC1 (DXT1): 4 × 4 texels of three channels in 8 bytes, as a GPU decodes them while it fetches.

A block holds two colours of 5, 6 and 5 bits, low byte first, and for each texel two bits, row by row from the lowest
bit, that choose among four colours between the two. As Direct3D documents it, colours are widened to eight bits by
repeating their highest bits, then (2 a + b + 1) / 3 in whole numbers; processors may differ in the last bits.
"""

import torch
from torch import Tensor

SIDE, BYTES = 4, 8  # texels a side, bytes a block
BITS = (5, 6, 5)  # of each channel of a block's two colours
CODES = (0, 2, 3, 1)  # the format's code of each step from the first colour to the second, in blocks of four colours
SHIFTS = (11, 5, 0)  # lowest bit of each channel in a colour's 16


def widened(ends: Tensor) -> Tensor:
    """Colours (…, 3) of 5, 6, 5 bits as eight bits, int64."""
    channels = []
    for channel, bits in zip(ends.unbind(-1), BITS, strict=True):
        missing = 8 - bits
        # The bits move to the top of eight, and the highest of them repeat in the missing ones below.
        channels.append((channel << missing) | (channel >> (bits - missing)))
    return torch.stack(channels, -1)


def between(first: Tensor, second: Tensor, step: Tensor) -> Tensor:
    """The colour (…, 3) of eight bits, int64, at steps (…,) 0 … 3 from `first` to `second` (…, 3)."""
    step = step[..., None]
    three_times = (3 - step) * first + step * second
    return (three_times + 1) // 3  # by the + 1 rounded to the nearest


def write(ends: Tensor, steps: Tensor) -> Tensor:
    """Blocks (n, 8), uint8, of two colours each, `ends` (n, 2, 3) of 5, 6, 5 bits, and texels' steps (n, 16), 0 … 3
    from the first colour to the second, all int64.

    A block has four colours only if its first is the larger number. So where it is the smaller, both change places and
    steps run backwards; where both are equal, every texel takes the first.
    """
    colours = (ends << torch.tensor(SHIFTS)).sum(2)  # (n, 2): the bits of all channels in one number
    swapped = colours[:, :1] < colours[:, 1:]
    colours = torch.where(swapped, colours.flip(1), colours)
    steps = torch.where(swapped, 3 - steps, steps)
    steps = steps.masked_fill(colours[:, :1] == colours[:, 1:], 0)
    codes = torch.tensor(CODES)[steps]  # (n, 16) of two bits
    # (n, 1): the codes in one number of 32 bits, that of the first texel lowest.
    all_codes = (codes << (2 * torch.arange(16))).sum(1, keepdim=True)
    words = torch.cat([colours, all_codes & 0xFFFF, all_codes >> 16], 1)  # (n, 4) of 16 bits
    low_high = torch.stack([words & 255, words >> 8], 2)  # (n, 4, 2) bytes
    return low_high.flatten(1).to(torch.uint8)


def read(blocks: Tensor) -> Tensor:
    """The colours (n, 16, 3) of eight bits, int64, of the texels of blocks (n, 8), uint8.

    A block whose first colour is not the larger number has three colours, the third the mean of the two, and black.
    """
    low, high = blocks.long().unflatten(1, (4, 2)).unbind(2)  # (n, 4) each
    words = low | (high << 8)  # (n, 4) of 16 bits: two colours, then the codes of the texels
    colours = words[:, :2]
    # Each channel is shifted to the bottom, and its own 5 or 6 bits are kept.
    masks = 2 ** torch.tensor(BITS) - 1
    ends = (colours[..., None] >> torch.tensor(SHIFTS)) & masks  # (n, 2, 3)
    first, second = widened(ends).unbind(1)  # (n, 3)
    # Eight codes a word, the lowest bits first: (n, 2, 8), then (n, 16).
    codes = ((words[:, 2:, None] >> (2 * torch.arange(8))) & 3).flatten(1)
    step_of_code = torch.tensor(CODES).argsort()  # argsort inverts the permutation
    # The texels' colours (n, 16, 3) if the block has four colours, and if it has three and black.
    of_four = between(first[:, None], second[:, None], step_of_code[codes])
    palette = torch.stack([first, second, (first + second) // 2, torch.zeros_like(first)], 1)  # (n, 4, 3)
    of_three = palette.gather(1, codes[..., None].expand(-1, -1, 3))
    has_four = colours[:, :1] > colours[:, 1:]
    return torch.where(has_four[..., None], of_four, of_three)
