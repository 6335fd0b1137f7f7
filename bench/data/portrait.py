"""Inspects a BTF before it is used: warns of likely faults, and draws an overview as a PNG.

It reads at most about 150 slices, so a table of 22 GB takes seconds; of a small BTF it reads all for the extremes:

- the lights at the view nearest the normal, and the views at the light nearest the normal: how brightness falls;
- a *contact sheet*: small pictures of evenly spread views × lights, for the overview;
- without a ring, pairs spread over the list, for the exponents and the half vectors (`bench.data.half_vectors`);
- a *ring*: views and lights of one θ, spread around the normal, for the *mean lobe*, which is how the mean of a slice
  depends on both azimuths. It tells whether the azimuths of views and of lights turn the same way: the answers of an
  isotropic surface depend on φ_i − φ_o, but on φ_i + φ_o if one of the two was measured clockwise and the other
  counter-clockwise.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bench.btf import BTF, Array, Layout, box_filter
from bench.data.half_vectors import LEAST_PAIRS, HalfVectors, half_vectors
from bench.data.materials import maps
from bench.data.readers.checks import codes_fault, negative_fault
from bench.directions.hemisphere import thin, to_degrees
from bench.files.atomic import replacing
from bench.files.plots import default_settings
from bench.inputs.errors import visible, writable
from bench.metrics.display import Exposed, exposed, exposure, exposure_of, to_display

SCATTERED = 96  # pairs for the half vectors
SMALL = 1 << 26  # values of a BTF of which all slices are read
LIGHTS = 24  # the most slices of the view nearest the normal; as many of the light nearest it
SHEET = (4, 6)  # views × lights of the contact sheet
STEEP = 0.45  # least cos θ of the sheet's directions if possible, about 63°: beyond, highlights outshine all else
TEXELS = 4096  # the most texels of a slice that are used
THUMB = 256  # a picture is shrunk for the sheet as far as its longest side keeps so many texels
FLAT = 0.35  # below this power of cos θ_i a cosine seems to be missing; Lambert has 1, measured fabrics about 0.7
# A BRDF is reciprocal, so f_r cos θ_i falls with θ_i by a power that is larger by 1 than with θ_o. Without the cosine
# the powers are equal; where views and lights are swapped the one of θ_o is larger by 1.
SWAPPED = 0.5
SEAM = 1.5  # from this ratio of the gradient across the border to that inside, a seam is visible
CLIPPED = 1e-3  # from this share of values exactly at the maximum, highlights are clipped
FEW = 10  # fewer values at the maximum are no clipping, whatever their share
AZIMUTHS = 6  # azimuths of views, and of lights: 36 slices are read
LEAST = 5  # azimuths of views, and of lights; with fewer the two cannot be told apart
HARMONICS = 2  # waves once and twice around, which are fitted to the lobe
LOWEST = 50.0  # degrees; nearer the normal, the lobe of a weave along one axis can follow the sum
CLEAR = (0.5, 2.0)  # for a mirrored side φ_i + φ_o explains at least this share, and this many times that of φ_i − φ_o


@dataclass(frozen=True)
class MeanLobe:
    """How the mean of slices depends on azimuths, at one θ of views and lights."""

    theta_deg: float
    difference_share: float  # the share of the variation that φ_i − φ_o explains, as it should
    sum_share: float  # the share of the variation that φ_i + φ_o explains, as if one side were mirrored
    peak_deg: float  # the φ_i − φ_o at which the mean is brightest

    @property
    def looks_mirrored(self) -> bool:
        """Whether φ_i + φ_o explains the variation so much better that one side seems to be mirrored."""
        least_share, times_better = CLEAR
        return self.theta_deg >= LOWEST and self.sum_share >= max(least_share, times_better * self.difference_share)


@dataclass(frozen=True)
class Look:
    """The findings from a few slices of a BTF."""

    btf: BTF
    layout: Layout  # the distinct views and lights of the training pairs, and whether they are a product
    sheet: dict[int, Array]  # the contact sheet: index of a pair → its picture, shrunk, (height, width, 3)
    values: Array  # (slices, n, 3), the same n texels of each slice
    power: float | None  # of cos θ_i, with which the median of a slice falls over lights; None from too few lights
    power_o: float | None  # of cos θ_o, over views; None from too few views
    # For the left–right and then the top–bottom border: the mean difference of texels across it, divided by that of
    # neighbours inside, and by that of the two neighbouring columns, or rows, inside that differ most.
    seams: list[tuple[float, float]]
    lobe: MeanLobe | None  # checks the azimuths; None if it cannot be found
    half_vectors: HalfVectors | None  # checks them instead of the lobe
    # The least and the largest value of all slices that were read, of a large BTF without those of the ring.
    extremes: tuple[float, float]
    read: int  # how many slices these are
    low_light: BTF  # the pairs of low light, at which nothing is looked; `btf` is without them
    exposed: Exposed  # the exposure of the training pairs and what it makes of the test pairs; of read slices if large

    @property
    def clipped(self) -> float:
        """The share of values that lie exactly at the maximum; 0 if they are few, or belong to a flat tile."""
        is_maximum = self.values == self.values.max()
        # If all values are at the maximum, the material is of one value.
        if not FEW <= is_maximum.sum() < is_maximum.size:
            return 0.0
        if self._is_flat_tile(is_maximum.any(2)):  # a tile of one colour, which is bright as a whole
            return 0.0
        return is_maximum.mean()

    def _is_flat_tile(self, is_maximum: Array) -> bool:
        """Whether texels at the maximum equal each other in most other slices, too, so that they show a flat tile.

        Clipped highlights differ from each other under other lights, where they are not clipped.
        `is_maximum` (slices, n) is the mask of texels with a channel at the maximum.
        """
        texels = is_maximum[is_maximum.sum(1).argmax()]  # the mask (n,) of the slice that has most of them
        other_slices = ~is_maximum[:, texels].any(1)  # in which none of these texels is at the maximum
        values = self.values[other_slices][:, texels]
        lit = values[values.any((1, 2))]  # the slices in which they are not all black
        if texels.sum() <= 1 or not len(lit):  # there is nothing that a texel could equal
            return False
        are_equal = (lit == lit[:, :1]).all((1, 2))
        return bool(are_equal.mean() > 0.5)

    def _fall_fault(self) -> str:
        """A sentence on brightness that falls with the wrong angle; "" if it falls with the light's, or if that cannot
        be told."""
        if self.power is None:
            return ""
        falls = f"brightness falls as cos(theta_i) to the power of {self.power:.2f}"
        if self.power < -FLAT and (self.power_o is None or self.power_o < SWAPPED):
            return f"{falls}, so it rises toward the horizon: theta seems to be measured from there: give 90 - theta"
        if self.power_o is None:  # one power alone does not tell the two causes apart
            if self.power >= FLAT:
                return ""
            causes = "the light's cosine seems to be missing, or views and lights are swapped"
            return f"{falls}: {causes}: look which before you multiply"
        falls += f", and as cos(theta_o) to the power of {self.power_o:.2f}"
        # Where they are swapped the view's power is the one near 1 or above.
        if self.power_o > SWAPPED and self.power_o - self.power > SWAPPED:
            return f"{falls}: views and lights seem to be swapped: exchange omega_o and omega_i"
        if self.power < FLAT:
            return f"{falls}: the light's cosine seems to be missing"
        return ""

    def warnings(self) -> list[str]:
        """One sentence for each likely fault, with its probable cause; none for sound data."""
        sentences = [self._fall_fault(), self._clipping_fault(), codes_fault(self.values), negative_fault(self.values)]
        sentences += [self._product_fault(), self._azimuths_fault(), self.exposed.fault, *self._seam_faults()]
        return [sentence for sentence in sentences if sentence]

    def _clipping_fault(self) -> str:
        """A sentence on clipped highlights; "" without any."""
        share = self.clipped
        if share < CLIPPED:
            return ""
        place = f"exactly at the maximum, {self.values.max():.4g}"
        return f"{share:.2%} of the values lie {place}: highlights are clipped"

    def _product_fault(self) -> str:
        """A sentence on the training pairs that a product of views and lights lacks; "" if it lacks none, or half of
        them or more, because the data then are not meant as a product."""
        views, lights, measured = len(self.layout.views), len(self.layout.lights), len(self.layout.view)
        missing = views * lights - measured
        if not 0 < missing < measured:
            return ""
        return f"{missing:,} pairs of the product of {views} views × {lights} lights are missing"

    def _azimuths_fault(self) -> str:
        """A sentence on azimuths that seem to be mirrored, by the lobe or the half vectors; "" if they do not."""
        fault = "the azimuths of the views or of the lights seem to be mirrored"
        if self.lobe and self.lobe.looks_mirrored:
            by_sum, by_difference = f"{self.lobe.sum_share:.0%}", f"{self.lobe.difference_share:.0%}"
            return f"the mean lobe follows phi_i + phi_o ({by_sum}), not phi_i - phi_o ({by_difference}): {fault}"
        if self.half_vectors and self.half_vectors.likely != "as given":
            frame, shares = self.half_vectors.likely, self.half_vectors.shares
            by_other, by_given = f"{shares[frame]:.0%}", f"{shares['as given']:.0%}"
            return f"half vectors explain {by_other} of the brightness with {frame}, and {by_given} as given: {fault}"
        return ""

    def _seam_faults(self) -> list[str]:
        """A sentence for each border at which a seam is visible."""
        remark = "although the data call it periodic" if self.btf.periodic else "it shows when repeated"
        faults = []
        for (to_mean, to_largest), border in zip(self.seams, ("left–right", "top–bottom"), strict=True):
            # A picture may have lines inside that differ as much as those at the border: that is no seam.
            if to_mean >= SEAM and to_largest >= 1:
                faults.append(f"a seam at the {border} border, {to_mean:.1f} times the gradient inside: {remark}")
        return faults


class _Slices:
    """What is kept of each slice that is read: values of some texels, ratios at its borders, and by pair the median and
    the mean brightness and the extremes; of a slice of the contact sheet also a shrunk picture."""

    def __init__(self, btf: BTF, sheet: Sequence[int]):
        """No slice is read yet; `sheet` are the pairs of the contact sheet."""
        self.btf = btf
        self.sheet = sheet
        self.texels = _some_texels(btf.shape[0] * btf.shape[1])
        self.values: list[Array] = []  # of each slice (n, 3)
        self.seams: list[tuple[maps.Seam, maps.Seam]] = []
        self.medians: dict[int, float] = {}
        self.means: dict[int, float] = {}
        self.extremes: dict[int, tuple[float, float]] = {}
        self.thumbs: dict[int, Array] = {}

    def read(self, pair: int) -> None:
        """Read the slice of a pair, and keep what the class says of it."""
        picture = self.btf[pair]
        texels = picture.reshape(-1, 3)
        self.values.append(texels[self.texels])
        self.seams.append(maps.seams(picture))
        self.medians[pair] = float(np.median(texels.mean(1)))
        self.means[pair] = float(texels.mean(dtype=np.float64))
        self.extremes[pair] = float(texels.min()), float(texels.max())
        if pair in self.sheet:
            self.thumbs[pair] = _thumb(picture)

    def read_extremes(self) -> None:
        """Read the extremes of all other slices."""
        for pair in range(len(self.btf)):
            if pair not in self.extremes:
                picture = self.btf[pair]
                self.extremes[pair] = float(picture.min()), float(picture.max())

    def medians_of(self, pairs: Sequence[int]) -> Array:
        """The median brightness (n,) of some pairs."""
        return np.array([self.medians[pair] for pair in pairs])


def look(btf: BTF) -> Look:
    """The findings from at most about 150 slices of a BTF, read one at a time; of a small BTF the extremes are those of
    all slices. Pairs of low light are not looked at."""
    low_light = btf.subset(btf.split().low_light)
    btf = btf.without_low_light()
    lobe = mean_lobe(btf)
    training, layout = _training_pairs(btf)
    of_one_view = _pairs_nearest_normal(btf.layout.view, btf.wo, btf.wi)
    of_one_light = _pairs_nearest_normal(btf.layout.light, btf.wi, btf.wo)
    sheet = _sheet_pairs(training, layout)
    scattered: list[int] = []  # where no ring was found
    if lobe is None and len(btf.layout.views) > 1:
        scattered = _spread_pairs(training, SCATTERED)
    slices = _Slices(btf, sheet)
    for pair in dict.fromkeys([*sheet, *of_one_view, *of_one_light, *scattered]):  # each pair once, in this order
        slices.read(pair)
    is_small = btf.shape[0] * btf.shape[1] * 3 * len(btf) <= SMALL
    if is_small:
        slices.read_extremes()

    # The z of a direction is the cosine of its θ.
    power = _power(btf.wi[of_one_view, 2], slices.medians_of(of_one_view))
    power_o = _power(btf.wo[of_one_light, 2], slices.medians_of(of_one_light))
    halves = None
    if scattered:
        wo, wi = btf.wo[scattered], btf.wi[scattered]
        halves = half_vectors(wo, wi, np.array([slices.means[pair] for pair in scattered]))
        if power is None and power_o is None:
            power, power_o = _powers(wi[:, 2], wo[:, 2], slices.medians_of(scattered))
    lows, highs = zip(*slices.extremes.values(), strict=True)
    return Look(
        btf=btf,
        layout=layout,
        sheet=slices.thumbs,
        values=np.stack(slices.values),
        power=power,
        power_o=power_o,
        seams=_seam_ratios(slices.seams),
        lobe=lobe,
        half_vectors=halves,
        extremes=(min(lows), max(highs)),
        read=len(lows),
        low_light=low_light,
        exposed=_exposed(btf, slices.values, is_small),
    )


def _exposed(btf: BTF, values: list[Array], is_small: bool) -> Exposed:
    """The exposure of a small BTF's training pairs and what it makes of the test pairs; of a large BTF the exposure of
    the `values` that were read, and what it makes of these."""
    if not is_small:
        return exposed(values, exposure_of(np.stack(values)))
    split = btf.split()
    test = np.concatenate([np.empty(0, int), *split.heldout.values()])
    if not len(test):
        test = np.arange(len(btf))
    return exposed((btf[int(pair)] for pair in test), exposure(btf.subset(split.train)))


def _some_texels(count: int) -> Array:
    """Indices of the texels that are used of each slice: all `count`, or `TEXELS` drawn with a fixed seed."""
    if count > TEXELS:
        return np.random.default_rng(0).integers(0, count, TEXELS)
    return np.arange(count)


def _thumb(picture: Array) -> Array:
    """A picture (H, W, 3) averaged over boxes, for the contact sheet."""
    size = picture.shape[:2]
    factor = min(max(size) // THUMB, *size)  # at most the short side of a strip, to leave something of it
    return box_filter(picture, max(1, factor))


def _seam_ratios(seams: list[tuple[maps.Seam, maps.Seam]]) -> list[tuple[float, float]]:
    """`Look.seams` of those of each slice, for the left–right and then the top–bottom border."""
    means = np.mean(seams, 0)  # (2, 3), over slices
    ratios = means[:, :1] / np.maximum(means[:, 1:], 1e-12)  # no division by 0 in flat pictures
    return [(to_mean, to_largest) for to_mean, to_largest in ratios.tolist()]


def _pairs_nearest_normal(index: Array, side: Array, other: Array) -> list[int]:
    """The pairs at that direction of one side which is nearest the normal: at most `LIGHTS`, spread over the other.

    `side` and `other` are the directions (N, 3) of both; `index` (N,) tells the distinct directions of `side` apart.
    """
    nearest = index[int(np.argmax(side[:, 2]))]
    pairs = np.flatnonzero(index == nearest)
    spread = thin(other[pairs], min(LIGHTS, len(pairs)))
    return [int(pair) for pair in pairs[spread]]


def _power(cos: Array, medians: Array) -> float | None:
    """The power of cos θ (n,) with which the medians (n,) of slices fall; None for few slices or too similar angles.

    It is the slope of a line through their logarithms, so each cos θ must be above 0.
    """
    lit = medians > 0  # a median of 0 has no logarithm
    if lit.sum() < 4 or np.ptp(cos[lit]) < 0.2:
        return None
    slope, _ = np.polyfit(np.log(cos[lit]), np.log(medians[lit]), deg=1)
    return float(slope)


def _powers(cos_i: Array, cos_o: Array, medians: Array) -> tuple[float | None, float | None]:
    """The powers of cos θ_i and of cos θ_o (n,) with which the medians (n,) of slices at scattered pairs fall; None for
    both of few slices or too similar angles."""
    lit = medians > 0
    if lit.sum() < LEAST_PAIRS or min(np.ptp(cos_o[lit]), np.ptp(cos_i[lit])) < 0.2:
        return None, None
    matrix = np.stack([np.log(cos_i[lit]), np.log(cos_o[lit]), np.ones(lit.sum())], -1)
    (power, power_o, _), *_ = np.linalg.lstsq(matrix, np.log(medians[lit]), rcond=None)
    return float(power), float(power_o)


def _spread_pairs(pairs: Array, count: int) -> list[int]:
    """At most `count` of some pairs, spread over their list."""
    places = np.unique(np.linspace(0, len(pairs) - 1, count).astype(int))
    return [int(pair) for pair in pairs[places]]


def _training_pairs(btf: BTF) -> tuple[Array, Layout]:
    """Indices of the pairs to train on, and their layout, to which random held-out pairs do not belong.

    These are all pairs if none are declared as held out: `split` would then hold out whole views and lights, which
    belong to the product.
    """
    pairs = np.arange(len(btf)) if btf.heldout is None else btf.split().train
    return pairs, Layout.of(btf.wo[pairs], btf.wi[pairs])


def _sheet_pairs(training: Array, layout: Layout) -> list[int]:
    """Pairs of the contact sheet: evenly spread views × lights of the training pairs, or if these are no product, pairs
    spread over their list."""
    count = SHEET[0] * SHEET[1]
    if layout.grid is None:  # not every view goes with every light
        return _spread_pairs(training, count)
    views = _spread_directions(layout.views, max(SHEET[0], count // len(layout.lights)))  # more if lights are few
    lights = _spread_directions(layout.lights, count // len(views))
    places = layout.grid[np.ix_(views, lights)].reshape(-1)
    return [int(pair) for pair in training[places]]


def _spread_directions(side: Array, count: int) -> Array:
    """Indices of at most `count` evenly spread directions (N, 3), without grazing ones if there are enough others."""
    indices = np.flatnonzero(side[:, 2] > STEEP)
    if len(indices) < count:
        indices = np.arange(len(side))
    return indices[thin(side[indices], min(count, len(indices)))]


def mean_lobe(btf: BTF) -> MeanLobe | None:
    """The lobe of slices' means at the outermost ring of directions that views and lights share.

    Each mean is divided by cos θ_i, and by the mean of its view and of its light; two harmonics of φ_i − φ_o, and of
    φ_i + φ_o, are fitted to the rest. None if the training pairs are no product of views and lights, there is no such
    ring, a mean is not above 0, or the means do not depend on both azimuths together. Reads the slices of the ring.
    """
    pairs, layout = _training_pairs(btf)
    if layout.grid is None:
        return None
    ring = _outermost_ring(layout)
    if ring is None:
        return None
    theta, views, lights = ring  # degrees, and indices into the layout's views and lights
    # 1. The means, without what depends on the view or on the light alone.
    ring_pairs = pairs[layout.grid[np.ix_(views, lights)]]  # (views, lights)
    means = np.array([[btf[int(pair)].mean(dtype=np.float64) for pair in row] for row in ring_pairs])
    if means.min() <= 0:  # no ratios to such means can be taken
        return None
    rest = _without_sides(means / layout.lights[lights, 2])
    total = float((rest**2).sum())
    if not total > 1e-9 * rest.size:  # views and lights change the means independently: only rounding is left
        return None
    # 2. How much of the rest waves of the difference, and of the sum, of both azimuths explain.
    _, phi_o_deg = to_degrees(layout.views[views])
    _, phi_i_deg = to_degrees(layout.lights[lights])
    phi_o, phi_i = np.radians(phi_o_deg), np.radians(phi_i_deg)
    by_difference, amplitudes = _explained(rest, phi_i - phi_o[:, None])
    by_sum, _ = _explained(rest, phi_i + phi_o[:, None])
    # 3. Where the fitted waves of the difference are highest, to a degree.
    degrees = np.arange(360.0)
    lobe = _waves(np.radians(degrees)) @ amplitudes
    peak = degrees[np.argmax(lobe)]
    return MeanLobe(theta, by_difference / total, by_sum / total, float(peak))


def _without_sides(means: Array) -> Array:
    """What is left of means (views, lights) once each view, and then each light, is divided by its mean, less 1."""
    of_lights = means / means.mean(1, keepdims=True)
    return of_lights / of_lights.mean(0) - 1


def _outermost_ring(layout: Layout) -> tuple[float, Array, Array] | None:
    """θ in degrees of the outermost ring that has directions of both sides, and the indices of views and of lights
    spread around it; None if no ring has `LEAST` of each."""
    theta_o, phi_o = to_degrees(layout.views)
    theta_i, phi_i = to_degrees(layout.lights)
    for degrees in range(85, 4, -1):  # whole degrees, from near the horizon to near the normal
        views = _spread_around(theta_o, phi_o, degrees)
        lights = _spread_around(theta_i, phi_i, degrees)
        if min(len(views), len(lights)) >= LEAST:
            return float(theta_o[views].mean()), views, lights
    return None


def _spread_around(theta: Array, phi: Array, degrees: int) -> Array:
    """Indices of at most `AZIMUTHS` directions within half a degree of θ = `degrees`, spread around the normal: each is
    the nearest to one of as many evenly spaced azimuths. `theta` and `phi` (N,) are in degrees."""
    ring = np.flatnonzero(np.abs(theta - degrees) <= 0.5)
    if not len(ring):
        return ring
    even_azimuths = phi[ring].min() + np.arange(AZIMUTHS) * 360.0 / AZIMUTHS
    distances = np.abs((phi[ring][:, None] - even_azimuths + 180) % 360 - 180)  # around the circle, at most 180°
    return ring[np.unique(distances.argmin(0))]


def _waves(angle: Array) -> Array:
    """The harmonics (..., 2 · HARMONICS) of angles (...): cos φ, sin φ, cos 2φ, sin 2φ."""
    return np.stack([wave(k * angle) for k in range(1, HARMONICS + 1) for wave in (np.cos, np.sin)], -1)


def _explained(rest: Array, angle: Array) -> tuple[float, Array]:
    """How much of the sum of squares of `rest` harmonics of an angle explain, and their amplitudes (2 · HARMONICS,).

    `rest` and `angle`, in radians, are (views, lights).
    """
    waves = _waves(angle)
    # `rest` has no mean over a view or over a light, so the waves must have none either.
    centred = waves - waves.mean(0) - waves.mean(1, keepdims=True) + waves.mean((0, 1))
    matrix = centred.reshape(rest.size, -1)  # (values, 2 · HARMONICS)
    amplitudes = np.linalg.lstsq(matrix, rest.reshape(-1), rcond=None)[0]
    unexplained = rest.reshape(-1) - matrix @ amplitudes
    return float((rest**2).sum() - (unexplained**2).sum()), amplitudes


@default_settings()
def draw(seen: Look, out: Path) -> None:
    """Write a PNG: the directions in polar plots, a histogram of the values, and the contact sheet with angles. Raises
    `InputError` if `out` cannot be written."""
    from matplotlib.figure import Figure

    # A row of three plots above the rows of the contact sheet.
    columns = SHEET[1]
    rows = math.ceil(len(seen.sheet) / columns)
    plots_height, sheet_height = 4, 2.2 * rows  # inches
    figure = Figure(figsize=(2 * columns, plots_height + sheet_height), layout="constrained")
    height, width = seen.btf.shape
    figure.suptitle(f"{visible(seen.btf.name)}: {height} × {width} texels, {len(seen.btf):,} pairs")
    top, bottom = figure.subfigures(2, 1, height_ratios=[plots_height, sheet_height])  # type: ignore[misc]
    _draw_directions(top.add_subplot(1, 3, 1, projection="polar"), seen, "views", seen.btf.wo)
    _draw_directions(top.add_subplot(1, 3, 2, projection="polar"), seen, "lights", seen.btf.wi)
    _draw_values(top.add_subplot(1, 3, 3), seen.values)
    factor = seen.exposed.exposure  # one for all pictures
    for place, (pair, thumb) in enumerate(seen.sheet.items()):
        axes = bottom.add_subplot(rows, columns, place + 1)
        axes.imshow(to_display(thumb, factor))
        directions = np.stack([seen.btf.wo[pair], seen.btf.wi[pair]])
        (theta_o, theta_i), (phi_o, phi_i) = to_degrees(directions)
        axes.set_title(f"o {theta_o:.0f}°, {phi_o:.0f}°   i {theta_i:.0f}°, {phi_i:.0f}°", fontsize=7)
        axes.set_axis_off()
    with writable(out), replacing(out) as partial:
        figure.savefig(partial, format="png", dpi=100)


def _draw_directions(axes: Any, seen: Look, title: str, directions: Array) -> None:
    """Draw one side's directions (N, 3), each distinct one once, in polar axes; the held-out ones in another colour."""
    heldout = seen.btf.heldout
    if heldout is None:
        heldout = np.zeros(len(directions), bool)
    for mask, label in ((heldout, "held out"), (~heldout, "training")):
        if mask.any():
            # A layout wants two sides; only its distinct views are used, so one side is given twice.
            distinct = Layout.of(directions[mask], directions[mask]).views
            theta, phi = to_degrees(distinct)
            axes.scatter(np.radians(phi), theta, s=8, label=label)
    axes.set_rlim(0, 90)
    axes.set_rgrids((30, 60, 90), angle=22.5, fontsize=7)  # each 10° would print numbers over one another
    axes.set_title(f"{title}: θ in degrees from the middle", fontsize=9)
    if heldout.any():
        axes.legend(fontsize=7, loc="lower left", bbox_to_anchor=(-0.15, -0.15))


def _draw_values(axes: Any, values: Array) -> None:
    """Draw a histogram of the values (..., 3) above 0 for each channel; its title tells how many are not."""
    lit = values[values > 0]
    if lit.size:
        # 80 logarithmic bins; they may not be empty where all values are equal.
        bins = np.geomspace(lit.min(), max(lit.max(), lit.min() * 1.01), 80)
        for channel, colour in enumerate(("tab:red", "tab:green", "tab:blue")):
            axes.hist(values[..., channel].ravel(), bins, histtype="step", color=colour, log=True)
        axes.set_xscale("log")
    title = "sampled values"
    dark = 1 - lit.size / values.size
    if dark >= 5e-4:  # else it would be shown as 0.0%
        title += f"; {dark:.1%} are 0 or less"
    axes.set_title(title, fontsize=9)
    axes.set_xlabel("linear radiance per unit irradiance")
