"""The loss `display`: errors as the display shows them, each slice counted relative to its own error.

The metric that decides is the mean over slices of PSNR after the display transform (docs/metrics.md). Its gradient is
that of the squared error of displayed values, divided by the error of the sample's slice, here a running mean. In its
first half a fit minimises `both`, so that no sample starts where the display clips it; a share of `both` stays.
"""

import torch
from torch import Tensor, nn

from bench.metrics.display import LOG_SCALE

SHOWN_FROM = 0.5  # share of the steps after which the display counts
LOG_SHARE = 0.1  # of the loss `both`, which goes on beside it: highlights that the display clips still count
WEIGHT = 0.3  # of the displayed error over its slice's, which is 1 on average
DECAY = 0.99  # of the running sums, each step
LEAST_ERROR = 1e-5  # of a slice; smaller ones, over 50 dB, count no more
HIGHEST = 20.0  # log radiance: above, the display clips by far, and an exponential could be infinite


def displayed(level: Tensor) -> Tensor:
    """Displayed values, sRGB in [0, 1], of log radiance, with a gradient; any shape."""
    linear = (level.clamp(max=HIGHEST).expm1() / LOG_SCALE).clamp(0, 1)
    curved = 1.055 * linear.clamp_min(0.0031308) ** (1 / 2.4) - 0.055
    return torch.where(linear <= 0.0031308, 12.92 * linear, curved)


class DisplayLoss(nn.Module):
    """The running squared error of displayed values at each of so many `directions`, and the loss that it weights."""

    def __init__(self, directions: int):
        super().__init__()
        self.error = nn.Buffer(torch.zeros(directions))  # running sum of the squared errors of a direction's samples
        self.count = nn.Buffer(torch.zeros(directions))  # and of their number

    def forward(self, ours: Tensor, target: Tensor, direction: Tensor, both: Tensor, progress: float) -> Tensor:
        """The loss of log radiances `ours` (n, 3) against their `target` (n, 3) at directions (n,).

        `both` is their mean loss of that name (`fitting.distance`), which counts alone in the first half of a fit;
        `progress` is the share of the fit that is done, 0 to 1.
        """
        is_shown = progress >= SHOWN_FROM
        with torch.set_grad_enabled(is_shown and torch.is_grad_enabled()):
            error = (displayed(ours) - displayed(target)).square().mean(1)
        with torch.no_grad():  # the sums run from the first step on, so that they are known when they begin to count
            self.error.mul_(DECAY).index_add_(0, direction, error)
            self.count.mul_(DECAY).index_add_(0, direction, torch.ones_like(error))
            mean = self.error.sum() / self.count.sum()
            # As if each direction had one more sample, with the mean error: one with few samples so far counts as that.
            of_slice = (self.error[direction] + mean) / (self.count[direction] + 1)
        if not is_shown:
            return both
        return WEIGHT * (error / of_slice.clamp_min(LEAST_ERROR)).mean() + LOG_SHARE * both
