"""A height per texel: where a view ray meets it, how much it blocks a light, and its steps in a file.

Heights are in units of the picture's width above the reference plane z = 0; texels are square. The plane repeats with
the picture. Seen along ω_o, a texel p of a slice shows the surface point p + z · ω_o.xy / ω_o.z, where z is its height;
so a point of height z appears at its own place − z · ω_o.xy / ω_o.z.

Slices and costs over a range of heights are shifted to the place where each height shows a surface point.

uv (n, 2) are places in [0, 1)², u to the right and v upwards, while rows of a picture count downwards. A *cost* (Z, H,
W) says how badly the views agree if a texel had each of Z heights. *Along* (n, 2) is the change of uv per unit of
height on a ray. A *code* is a height in whole steps, as a file holds it.
"""

import itertools
import math

import torch
from torch import Tensor, nn

from bench.material import sample_texture

LEAST_COSINE = 0.2  # of a direction: nearer to the horizon (78.5°) its slope grows no further
FINENESS = 256  # texels a side of the searched height, about: a whole multiple of the stored ones, at least these
# Linear steps, then steps of the secant, of the search along the view; 16 and 2 gain .02 dB on the deepest relief.
VIEW_STEPS, SECANTS = 12, 1
LIGHT_STEPS = 12  # of the search toward the light
LEAST_FACING = 0.3  # least 1 − ∇h · along, which is 0 if a ray grazes the surface and a hit would move without bound
MOST_FINE = 1 << 25  # samples of the finer copy, padding included
BLOCK = 1 << 20  # samples of it that are made at once
STEP = 2 / 3  # texels by which a step of the height moves a look-up at the steepest slope; rounding moves half of it
MOST_CODES = 256  # steps of a height in a file, so that a code takes at most eight bits
MOST_PADDED = 32  # largest growth of a copy by padding; a picture far wider than high would grow by thousands
HEIGHTS, REACH = 41, 0.1  # heights tried, up to ± that many widths of the picture
BLUR = 0.7  # texels, σ of a Gaussian over the costs


def slope(direction: Tensor, shape: tuple[int, int]) -> Tensor:
    """Change of uv (n, 2) per unit of height along a ray with `direction` (n, 3), over a picture of `shape` (H, W)."""
    across = direction[:, :2] / direction[:, 2:].clamp_min(LEAST_COSINE)  # in widths of the picture, as heights are
    height, width = shape
    if height == width:
        return across
    # u counts widths and v heights of the picture, which are height / width of a width.
    return torch.cat([across[:, :1], across[:, 1:] * (width / height)], 1)


class Surface(nn.Module):
    """A height (H, W) and a finer copy for searching, padded so that no ray leaves it, or wrapped around.

    The copy is sampled bilinearly once, so that a search only reads its nearest samples. It does not learn: a height
    that a fit refines is given to `follow`.
    """

    def __init__(self, height: Tensor, renewable: bool = False):
        """Make the finer copy of a height (H, W), with a margin as wide as a ray can go sideways, or none if it would
        be too large.

        If it is `renewable`, `renew` gives it another height in the same memory: no size and no program depends on the
        height.
        """
        super().__init__()
        self.shape = (height.shape[0], height.shape[1])
        self.renewable = renewable
        low, high = float(height.min()), float(height.max())
        self.low: float | Tensor = self._bound(low)
        self.high: float | Tensor = self._bound(high)
        self.height = nn.Buffer(height.float()[..., None], persistent=False)  # (H, W, 1), a texture
        # Rows and columns of the finer copy without its margin: whole multiples of the height's.
        self.fine = [side * max(1, round(FINENESS / side)) for side in self.shape]
        if math.prod(self.fine) > MOST_FINE:  # one side is a few texels, the other very long: it is not made finer
            self.fine = [*self.shape]
        # A ray is followed over at most this height, so it leaves its place by at most `reach` widths of the picture.
        rise = max(high - low, abs(low), abs(high))
        reach = rise / LEAST_COSINE
        rows, cols = self.fine
        reach_in_rows = int(reach * (self.shape[1] / self.shape[0]) * rows)
        reach_in_cols = int(reach * cols)
        # Rows above and as many below, columns left and as many right; two more for rounding.
        self.margin = [reach_in_rows + 2, reach_in_cols + 2]
        # By how much the margin makes the copy larger.
        growth = (1 + 2 * self.margin[0] / rows) * (1 + 2 * self.margin[1] / cols)
        self.wraps = renewable or growth > MOST_PADDED or growth * math.prod(self.fine) > MOST_FINE
        if self.wraps:  # a look-up beyond an edge goes on at the opposite one
            self.margin = [0, 0]
        self.padded = nn.Buffer(self._padded(), persistent=False)

    @torch.no_grad()
    def renew(self, height: Tensor) -> None:
        """Be the surface of another height (H, W) of the same device, if this one is `renewable`."""
        assert isinstance(self.low, Tensor)
        assert isinstance(self.high, Tensor)
        self.low.copy_(height.min())
        self.high.copy_(height.max())
        self.height.copy_(height[..., None])
        self.padded.copy_(self._padded())

    def _bound(self, value: float) -> float | Tensor:
        """The lowest or the highest height: a number that programs know or, in a renewable surface, one in memory."""
        if not self.renewable:
            return value
        # In double precision, as Python's numbers are, so that a search has the same steps to the bit.
        return nn.Buffer(torch.tensor(value, dtype=torch.double), persistent=False)

    def _padded(self) -> Tensor:
        """The finer copy with its margin: heights (rows, columns) from the top row on, sampled bilinearly in blocks."""
        (rows, cols), (above, left) = self.fine, self.margin
        device = self.height.device
        v = 1 - (torch.arange(-above, rows + above, device=device) + 0.5) / rows
        u = (torch.arange(-left, cols + left, device=device) + 0.5) / cols
        padded = self.height.new_empty(len(v), len(u))
        # Rows and columns of a block of at most `BLOCK` samples.
        tall = max(1, BLOCK // len(u))
        wide = min(BLOCK, len(u))
        for row, col in itertools.product(range(0, len(v), tall), range(0, len(u), wide)):
            block = padded[row : row + tall, col : col + wide]
            block_v, block_u = torch.meshgrid(v[row : row + tall], u[col : col + wide], indexing="ij")
            uv = torch.stack([block_u, block_v], -1)  # (rows, columns, 2)
            heights = sample_texture(self.height, (uv - uv.floor()).flatten(0, 1))  # the plane is periodic
            block.copy_(heights.reshape(block.shape))
        return padded

    def _nearest(self, u: Tensor, v: Tensor) -> Tensor:
        """The nearest heights at u and v, of any one shape, within the margin around [0, 1); or anywhere, if it wraps.

        The copy is read as one flat row, at row · columns + column.
        """
        (rows, cols), (above, left) = self.fine, self.margin
        if self.wraps:
            row = ((1 - v) * rows).floor().int().remainder(rows)
            col = (u * cols).floor().int().remainder(cols)
            return self.padded.flatten().take((row * cols + col).long())
        col = (u * cols + left).int()  # of the copy with its margin, so never below 0
        row = ((1 - v) * rows + above).int()
        if torch.compiler.is_exporting():  # a shader wraps around: a margin would make its texture much larger
            inner = self.padded[above : above + rows, left : left + cols].flatten()
            row_start = (row - above).remainder(rows) * cols  # the place of the row's first sample
            inner_col = (col - left).remainder(cols)
            return inner.take((row_start + inner_col).long())
        place = row.mul_(self.padded.shape[1]).add_(col)  # in place, to save memory in a search
        return self.padded.view(-1).take(place.long())

    def meet(self, uv: Tensor, wo: Tensor) -> tuple[Tensor, Tensor]:
        """Where rays through uv (n, 2) in [0, 1) on the plane, toward wo (n, 3), first hit the surface from above.

        Returns the place (n, 2), wrapped into [0, 1), and its height (n, 1). A linear search finds the step that ends
        within the surface; steps of the secant then narrow it down.
        """
        along = slope(wo, self.shape)
        # The linear search, from the highest height down to the lowest.
        step = (self.high - self.low) / VIEW_STEPS
        step_ends = torch.arange(VIEW_STEPS + 1, device=uv.device, dtype=uv.dtype)
        heights = (self.high - step * step_ends)[:, None]  # (steps + 1, 1)
        # How far the surface is above the ray, (steps + 1, n): negative before the hit.
        gaps = self._nearest(*_uv_along(uv, along, heights)) - heights  # queries last: reductions over steps are fast
        # Step i leads from heights[i] to heights[i + 1]. Steps have falling ranks, VIEW_STEPS for step 0 to 1 for the
        # last, so the first step that ends within the surface has the highest rank of all such steps.
        rank = torch.arange(VIEW_STEPS, 0, -1, device=uv.device, dtype=torch.uint8)[:, None]
        highest_rank = ((gaps[1:] >= 0) * rank).amax(0, keepdim=True).long()  # (1, n); 0 if no step does
        # The last step ends at the lowest height, where only rounding can keep a ray from the surface.
        hit_step = (VIEW_STEPS - highest_rank).clamp_max(VIEW_STEPS - 1)
        # The heights at which this step begins and ends, and the gaps, how far the surface is above the ray there: all
        # (n, 1). The upper gap is at most 0, the lower one at least.
        upper = heights[hit_step[0]]
        lower = heights[hit_step[0] + 1]
        upper_gap = gaps.gather(0, hit_step).T.clamp_max(0)
        lower_gap = gaps.gather(0, hit_step + 1).T.clamp_min(0)
        # Steps of the secant.
        for _ in range(SECANTS):
            # Where the gap would be 0 if it were a line between both; this point replaces the end on its own side. With
            # both gaps 0, the least divisor keeps it at the lower end.
            middle = lower + (upper - lower) * lower_gap / (lower_gap - upper_gap).clamp_min(1e-9)
            surface_height = sample_texture(self.height, wrapped(uv + along * middle)).to(uv.dtype)
            gap = surface_height - middle
            inside = gap >= 0
            lower = torch.where(inside, middle, lower)
            lower_gap = torch.where(inside, gap, lower_gap)
            upper = torch.where(inside, upper, middle)
            upper_gap = torch.where(inside, upper_gap, gap)
        # Again where the gap would be 0 on a line between both ends.
        z = lower + (upper - lower) * lower_gap / (lower_gap - upper_gap).clamp_min(1e-9)
        return wrapped(uv + along * z), z

    def follow(self, height: Tensor, uv: Tensor, wo: Tensor) -> Tensor:
        """uv (n, 2), unchanged, where rays toward wo (n, 3) hit the surface, with a gradient to its refined height.

        `uv` is from `meet`; `height` (H, W) is the refined one, which may be some steps newer than this surface.
        A place moves by `along` with z, and z = h there: so z changes by dh / (1 − ∇h · along), uv by that · `along`.
        """
        along = slope(wo, self.shape)
        rise = sample_texture(height[..., None], uv)  # (n, 1)
        with torch.no_grad():
            # ∇h · along, by the change of height over as much of the ray as rises by a texel's width.
            half_step = along / (2 * self.shape[1])
            ahead = sample_texture(self.height, wrapped(uv + half_step))
            behind = sample_texture(self.height, wrapped(uv - half_step))
            change_of_height = (ahead - behind) * self.shape[1]
            facing = (1 - change_of_height).clamp_min(LEAST_FACING)
        # The difference is 0, and has the gradient of the rise.
        return uv + along * ((rise - rise.detach()) / facing)

    def excess(self, uv: Tensor, z: Tensor, wi: Tensor) -> Tensor:
        """The largest rise (n, 1) of the surface, in texels, above rays from uv at height z (n, 1) toward wi."""
        along = slope(wi, self.shape)
        # The middles of equal parts of the ray, from its start to the highest height.
        share = (torch.arange(LIGHT_STEPS, device=uv.device, dtype=uv.dtype) + 0.5) / LIGHT_STEPS  # (steps,)
        # How far the ray is above z at each step; beyond the highest height nothing can block it.
        rise = (self.high - z).clamp_min(0).T * share[:, None]  # (steps, n)
        gaps = self._nearest(*_uv_along(uv, along, rise)) - (z.T + rise)
        return gaps.amax(0)[:, None] * self.shape[1]


def _uv_along(uv: Tensor, along: Tensor, z: Tensor) -> tuple[Tensor, Tensor]:
    """u and v (steps, n), not wrapped, of rays through uv (n, 2) at heights z (steps, n) or (steps, 1) above it.

    `along` (n, 2) is the change of uv per unit of height.
    """
    u, v = uv.T.contiguous()  # (n,) each
    across, up = along.T.contiguous()
    return u + across * z, v + up * z


def wrapped(uv: Tensor) -> Tensor:
    """Places uv of the periodic plane, of any shape, moved by whole periods into [0, 1)."""
    # A tiny negative number rounds to 1, which is 0 again.
    inside = uv - uv.floor()
    return torch.where(inside < 1, inside, 0)


def stepped(height: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """A height (H, W) in steps, as a file holds it.

    Returns the codes (H, W), whole numbers from 0 as floats; `low_and_step` (2,), the lowest height and the step, in
    widths of the picture; and the height (H, W) as read back from both.
    """
    low, high = height.aminmax()
    # At the steepest slope, 1 / `LEAST_COSINE`, such a step moves a look-up by `STEP` texels, which hardly shows.
    fine_step = height.new_tensor(STEP * LEAST_COSINE / height.shape[1])
    # Larger ones if there would be more than `MOST_CODES`. A range of n steps takes up to n + 2 codes, because both of
    # its ends are rounded, and both are codes.
    coarse_step = (high - low) / (MOST_CODES - 2)
    step = torch.maximum(fine_step, coarse_step)
    codes = (height / step).round()  # steps from height 0, below 0 too
    lowest_code = codes.min()
    codes = codes - lowest_code
    low_and_step = torch.stack([lowest_code * step, step])
    return codes, low_and_step, restored(codes, low_and_step)


def restored(codes: Tensor, low_and_step: Tensor) -> Tensor:
    """The height (H, W) of codes (H, W), given the lowest height and the step (2,)."""
    return codes * low_and_step[1] + low_and_step[0]


def smoothed(picture: Tensor) -> Tensor:
    """A periodic picture (H, W) blurred with σ = 1 texel: neighbours share the few samples that move a height."""
    # Twice (1, 2, 1) / 4 along each side, whose variance is ½ texel² each time.
    for axis in (0, 1, 0, 1):
        picture = (picture.roll(1, axis) + 2 * picture + picture.roll(-1, axis)) / 4
    return picture


def shifted(slices: Tensor, view: Tensor, z: float) -> Tensor:
    """The values (L, H, W) of surface points in slices (L, H, W) of a view (3,), if all points have the height z."""
    x, y, cosine = view.tolist()
    # In texels, which are square: a unit of height is W of them. Rows count downwards, y upwards.
    cols = -z * x / cosine * slices.shape[2]
    rows = z * y / cosine * slices.shape[2]
    return _rolled(_rolled(slices, rows, axis=1), cols, axis=2)


def _rolled(slices: Tensor, texels: float, axis: int) -> Tensor:
    """Periodic slices, rolled back along an axis: place i shows what was at i + texels, linear between two texels."""
    whole = math.floor(texels)
    # A roll by −whole brings what was at i + whole to place i.
    before = slices.roll(-whole, axis)
    if texels == whole:  # nothing to interpolate
        return before
    after = before.roll(-1, axis)
    return torch.lerp(before, after, texels - whole)


def blurred(costs: Tensor) -> Tensor:
    """Costs (Z, H, W), each height's convolved over the texels with a periodic Gaussian of `BLUR` texels."""
    steps = torch.arange(-2, 3)  # in texels: the Gaussian is cut off at nearly three times its σ
    kernel = (-0.5 * (steps / BLUR).square()).exp()
    kernel = kernel / kernel.sum()
    for axis in (1, 2):
        weighted = [weight * costs.roll(int(step), axis) for weight, step in zip(kernel, steps, strict=True)]
        costs = torch.stack(weighted).sum(0)  # of (5, Z, H, W)
    return costs


def cheapest(costs: Tensor) -> Tensor:
    """Index (1, H, W) of the cheapest height at each texel, from costs (Z, H, W)."""
    return costs.argmin(0, keepdim=True)


def refined(costs: Tensor, heights: Tensor) -> Tensor:
    """The height (H, W) of least cost, on the CPU, from costs (Z, H, W) of evenly spaced heights (Z,).

    It is the lowest place of a parabola through the cheapest height and its two neighbours.
    """
    best = cheapest(costs).clamp(1, len(heights) - 2)  # (1, H, W), with a neighbour on each side
    below, at, above = (costs.gather(0, best + step)[0] for step in (-1, 0, 1))  # costs (H, W) each
    bend = (below - 2 * at + above).clamp_min(1e-9)  # 0 where all three are equal
    # In steps of height, at most half a step from the cheapest.
    place = best[0] + (0.5 * (below - above) / bend).clamp(-0.5, 0.5)
    return (heights[0] + place * (heights[1] - heights[0])).cpu()
