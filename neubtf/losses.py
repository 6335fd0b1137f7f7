"""NeuBTF's losses of whole slices, besides the pixel loss: style and spectrum.

Both see linear radiance in the display's range [0, 1], because the paper compresses only the pixel term, and because
one highlight would otherwise outweigh every Gram matrix and spectrum. Pictures (B, 3, H, W) are periodic.
"""

import torch
from torch import Tensor, nn
from torch.nn import functional

from bench.metrics.display import LOG_SCALE

FILTERS = 24  # filters of each scale
KERNEL = 5  # texels a side at each scale
SCALES = 3  # full, half and quarter resolution
BANK_SEED = 0x57  # the bank is the same for every fit: it is part of the loss, not of the network


def shown(log_radiance: Tensor) -> Tensor:
    """Linear radiance × exposure in [0, 1] of log1p(8 · exposure · radiance), any shape."""
    return (log_radiance.expm1() / LOG_SCALE).clamp(0, 1)


class Style(nn.Module):
    """The distance of two pictures' textures: the squared difference of Gram matrices (Gatys et al. 2016), averaged.

    The features are those of Ustyuzhaninov et al., "What does it take to generate natural textures?", 2017: one layer
    of fixed random filters at several scales, rectified, so that no trained weights are needed.
    """

    bank: Tensor  # (SCALES, FILTERS, 3, KERNEL, KERNEL)

    def __init__(self) -> None:
        super().__init__()
        generator = torch.Generator().manual_seed(BANK_SEED)
        bank = torch.empty(SCALES, FILTERS, 3 * KERNEL * KERNEL)
        for scale in bank:
            nn.init.orthogonal_(scale, generator=generator)
        self.register_buffer("bank", bank.reshape(SCALES, FILTERS, 3, KERNEL, KERNEL), persistent=False)

    def forward(self, ours: Tensor, theirs: Tensor, periodic: tuple[bool, bool] = (True, True)) -> Tensor:
        """The distance of pictures that repeat, or not, in rows and in columns, at scales that fit the filters."""
        distances = list[Tensor]()
        for scale, filters in enumerate(self.bank):
            if scale:
                ours, theirs = (functional.avg_pool2d(x, 2, ceil_mode=True) for x in (ours, theirs))
            sides = zip(ours.shape[2:], periodic, strict=True)
            if all(wraps or side >= KERNEL for side, wraps in sides):
                distances.append(functional.mse_loss(_gram(ours, filters, periodic), _gram(theirs, filters, periodic)))
        return torch.stack(distances).mean() if distances else torch.zeros((), device=ours.device)


def _gram(pictures: Tensor, filters: Tensor, periodic: tuple[bool, bool]) -> Tensor:
    """(B, F, F): the mean over texels of products of rectified responses; of inner texels if it does not repeat."""
    half = KERNEL // 2
    for dim, wraps in zip((2, 3), periodic, strict=True):
        size = pictures.shape[dim]
        if wraps:
            pictures = pictures.index_select(dim, torch.arange(-half, size + half, device=pictures.device) % size)
    responses = functional.conv2d(pictures, filters).relu().flatten(2)
    return responses @ responses.mT / responses.shape[2]


def focal_frequency(ours: Tensor, theirs: Tensor) -> Tensor:
    """Focal frequency loss (Jiang et al., "Focal frequency loss for image reconstruction and synthesis", 2021), α = 1.

    The mean of w · |F − F'|² over the orthonormal spectra F, F' of both pictures, with w = |F − F'| over its maximum in
    each channel of each picture, held constant.
    """
    difference = torch.fft.fft2(ours - theirs, norm="ortho")
    squared = difference.real.square() + difference.imag.square()
    with torch.no_grad():
        weight = squared.sqrt()
        weight = weight / weight.amax((2, 3), keepdim=True).clamp_min(torch.finfo(weight.dtype).tiny)
    return (weight * squared).mean()
