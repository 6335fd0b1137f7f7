"""Materials at the extremes: each is encoded, written and decoded, and compared with the original.

Most are made from the ordinary material. The bound of the catalogue is the mean colour of each texel, which any codec
can store: it must not be better.
"""

import math
import re
from collections.abc import Callable
from functools import cache, partial
from typing import Any

import numpy as np

from bench.btf import BTF, Array, ArraySource
from bench.conformance.check import CheckError, tiny_btf
from bench.conformance.stress.case import Case, Encoded, Measured, Subject, require
from bench.data.derived import repaired
from bench.directions.hemisphere import from_degrees
from bench.inputs.errors import InputError
from bench.material import HALF_MAX
from bench.metrics.display import LOG_SCALE, display_error, exposure_of, to_log1p
from bench.metrics.psnr import psnr

CONSTANT = 0.1  # share of a value; a codec that stores only the mean is off by 1.5
SAME_DB = 0.1  # two qualities within this count as the same
SAME_RATIO = 10 ** (SAME_DB / 10)  # and so do two mean squared errors, if one is at most so many times the other
EXACT_DB = 70.0  # a codec this good is exact except for the rounding of its halves, 2⁻¹² of a value, which may differ


@cache
def ordinary() -> BTF:
    """The conformance test's small material, 8 × 8 texels at 9 × 9 pairs."""
    return tiny_btf()


@cache
def values() -> Array:
    """The radiance (81, 8, 8, 3) of the ordinary material."""
    stacked = np.stack(list(ordinary()))
    stacked.setflags(write=False)
    return stacked


def material(radiance: Array, wo: Array | None = None, wi: Array | None = None) -> BTF:
    """A BTF with radiance (N, H, W, 3), by default at the pairs of the ordinary material."""
    views = ordinary().wo if wo is None else wo
    lights = ordinary().wi if wi is None else wi
    return BTF("extreme", views, lights, ArraySource(np.asarray(radiance, np.float32)), periodic=True)


def painted(radiance: Array, place: Any, value: float = HALF_MAX) -> BTF:
    """The material of a radiance (81, 8, 8, 3) with one value, by default the largest half, at an index `place`."""
    repainted = radiance.copy()
    repainted[place] = value
    return material(repainted)


def long_strip() -> BTF:
    """3 × 1,001 texels at 3 × 3 pairs: no side is a power of two, none a multiple of the pattern."""
    like = tiny_btf(views=3, lights=3)
    rows = np.stack(list(like))[:, :3]
    columns = np.arange(1001) % 8  # the pattern again and again
    return material(rows[:, :, columns], like.wo, like.wi)


def beyond_half() -> BTF:
    """1e6, too large for a half, at all pairs on 2 of 16 × 16 texels.

    Metrics expose a material by the 99th percentile of each slice, which so few texels do not change.
    """
    radiance = np.stack(list(tiny_btf(size=16)))
    radiance[:, [3, 11], [5, 8]] = 1e6
    return material(radiance)


def black_from_above() -> BTF:
    """Black except for a quarter of the texels at grazing views: in pictures from above, all texels look alike."""
    radiance = np.zeros_like(values())
    radiance[:, ::2, ::2] = values()[:, ::2, ::2]
    radiance[ordinary().wo[:, 2] > 0.5] = 0
    return material(radiance)


def two_constants() -> BTF:
    """Halves of 0.5 and 0.125: one bias cannot answer both."""
    return painted(np.full_like(values(), 0.5), np.s_[:, :, 4:], 0.125)


def firefly() -> BTF:
    """The ordinary material with one texel of one pair at the largest half."""
    return painted(values(), np.s_[40, 3, 5])


def negative_noise() -> BTF:
    """Black texels among the others, with noise between −1e-3 and 0."""
    radiance = values().copy()
    radiance[:, ::2] = 0
    return material(radiance - np.random.default_rng(0).uniform(0, 1e-3, radiance.shape))


def of_pairs(pairs: Array, side: int = 8) -> BTF:
    """Some pairs of the ordinary material, in pictures of `side`² texels."""
    return material(values()[pairs, :side, :side], ordinary().wo[pairs], ordinary().wi[pairs])


def grazing_lights() -> BTF:
    """Nine views, and nine lights at 89°, whose cosine is 0.017."""
    low = from_degrees(np.full(9, 89.0), np.arange(9) * 40.0)
    wi = np.tile(low, (9, 1))
    darker = wi[:, 2] / ordinary().wi[:, 2]  # (81,), because radiance contains the cosine of the light
    return material(values() * darker[:, None, None, None], wi=wi)


def not_finite() -> BTF:
    """The ordinary material with one NaN and two infinite values, at two pairs."""
    radiance = values().copy()
    radiance[40, 3, 5, 0] = np.nan
    radiance[40, 3, 6, 2] = np.inf
    radiance[41, 0, 0, 1] = -np.inf
    return material(radiance)


def mean_squares(encoded: Encoded, ours: Array) -> dict[str, tuple[float, float]]:
    """By space, `display` and `log`: the mean squared error of slices (N, H, W, 3), and the square of the peak."""
    exposure = exposure_of(encoded.truth)
    display = display_error(ours, encoded.truth, exposure)
    log = float(np.square(to_log1p(ours, exposure) - to_log1p(encoded.truth, exposure)).mean())
    return {"display": (display, 1.0), "log": (log, math.log1p(LOG_SCALE) ** 2)}


def decibels(mse: float, squared_peak: float) -> float:
    """The PSNR in dB of a mean squared error."""
    return float(psnr(mse / squared_peak, 1.0))


def require_valid_slices(encoded: Encoded) -> None:
    """Raise `CheckError` unless the decoded slices are of the material's size, finite and not negative."""
    size = encoded.truth.shape[1:3]
    decoded_size = encoded.decoded.shape[1:3]
    in_words = " × ".join(map(str, decoded_size))
    fault = f"decoded slices are {in_words} texels, those of the material {' × '.join(map(str, size))}"
    require(decoded_size == size, in_words, fault)
    bad = ~(np.isfinite(encoded.decoded) & (encoded.decoded >= 0))
    require(not bad.any(), f"{bad.sum()} bad", f"{bad.sum()} decoded values are negative or not finite")


def mean_colour_bound(encoded: Encoded) -> dict[str, float]:
    """The allowed mean squared error by space: that of mean-colour, or of half a step of 8 bits."""
    mean = np.broadcast_to(encoded.truth.mean(0, dtype=np.float64), encoded.truth.shape)
    allowed = {}
    for space, (mse, squared_peak) in mean_squares(encoded, mean).items():
        half_a_step = squared_peak / 510**2  # squared, too: one of 255 steps is two halves
        allowed[space] = max(mse * SAME_RATIO, half_a_step)
    return allowed


def no_worse_than_allowed(encoded: Encoded, allowed: dict[str, float]) -> Measured:
    """Measure the error as a share of the allowed error in each space; raise `CheckError` if it is larger."""
    require_valid_slices(encoded)
    used = 0.0
    for space, (mse, squared_peak) in mean_squares(encoded, encoded.decoded).items():
        reached = decibels(mse, squared_peak)
        detail = f"{space} PSNR {reached:.2f} dB, required {decibels(allowed[space], squared_peak):.2f} dB"
        require(mse <= allowed[space], f"{reached:.1f} dB", detail)
        used = max(used, mse / allowed[space])
    return Measured(used=used)


def no_worse(encoded: Encoded) -> Measured:
    """Check that the decoded slices are no worse than `mean_colour_bound`; `used` is their share of that error."""
    return no_worse_than_allowed(encoded, mean_colour_bound(encoded))


def others_no_worse(encoded: Encoded) -> Measured:
    """Judge the texels without a firefly by themselves."""
    require_valid_slices(encoded)
    without_firefly = encoded.truth.max((0, 3)) < HALF_MAX  # mask (H, W)
    # As one row of texels: (N, 1, texels, 3).
    truth = encoded.truth[:, without_firefly][:, None]
    decoded = encoded.decoded[:, without_firefly][:, None]
    return no_worse(Encoded(material(truth, encoded.btf.wo, encoded.btf.wi), decoded))


def constants_hold(encoded: Encoded) -> Measured:
    """Check that every value of `two_constants` is off by at most the share `CONSTANT` of itself."""
    require_valid_slices(encoded)
    worst = float((np.abs(encoded.decoded - encoded.truth) / encoded.truth).max())
    what = "of texels of 0.5 beside texels of 0.125, each the same at every pair, a value"
    require(worst <= CONSTANT, f"{worst:.1%}", f"{what} is off by {worst:.3%}")
    return Measured(used=worst / CONSTANT)


def same_quality(factor: float, subject: Subject) -> None:
    """Check that the ordinary material times a factor is stored neither better nor worse than without it."""
    unscaled = subject.usual
    scaled = subject.encode(material(values() * np.float32(factor)))
    require_valid_slices(scaled)
    errors_before = mean_squares(unscaled, unscaled.decoded)
    for space, error in mean_squares(scaled, scaled.decoded).items():
        before, now = decibels(*errors_before[space]), decibels(*error)
        gained = min(now, EXACT_DB) - min(before, EXACT_DB)
        detail = f"{space} PSNR {now:.2f} dB, {before:.2f} dB for the same data unscaled"
        require(abs(gained) <= SAME_DB, figure=f"{gained:+.1f} dB", detail=detail)


def refused(subject: Subject) -> None:
    """Check that values that are not finite are refused by an error with their count and the first place."""
    try:
        subject.encode(not_finite())
    except InputError as error:
        message = str(error)
        count = re.search(r"\d of [\d,]+ values", message)
        place = re.search(r"\(\d+, ", message)
        require(count and place, "unclear", f"the error gives no count and place: {message}")
        return
    raise CheckError("values that are not finite were encoded", "encoded")


def stored_or_refused(subject: Subject) -> Measured:
    """Check that highlights of 1e6 are stored, with five times the steps, or refused by an error that names them."""
    try:
        encoded = subject.encode(beyond_half(), stretch=5)
    except InputError as error:
        named = re.search(r"1e\+?0?6|1,?000,?000|65,?504", str(error))
        require(named, "unclear", f"the error gives no value and no limit: {error}")
        return Measured("refused", detail=str(error))
    return no_worse(encoded)


def mended(subject: Subject) -> Measured:
    """Check that a repair of values that are not finite says so, and that the rest is stored."""
    btf = repaired(not_finite())
    require("3 values" in str(btf.provenance), "silent", f"it does not say what was masked: {btf.provenance}")
    return no_worse(subject.encode(btf))


def one_pair_holds(subject: Subject) -> Measured:
    """Measure one picture of 5 × 5 texels, which a codebook of 32 entries can hold too.

    Its mean colours are exact, so the codec may also be as far off as on the ordinary material.
    """
    usual = subject.usual
    encoded = subject.encode(of_pairs(np.array([40]), 5), stretch=3)  # 40: of 81, the middle
    allowed = mean_colour_bound(encoded)
    usual_limits = mean_colour_bound(usual)  # where the codec is worse there, it may be as far off as mean-colour is
    for space, (usual_error, _) in mean_squares(usual, usual.decoded).items():
        allowed[space] = max(allowed[space], min(usual_error * SAME_RATIO, usual_limits[space]))
    return no_worse_than_allowed(encoded, allowed)


MEAN = "no worse than mean-colour"
NO_WORSE = f"{MEAN}, or closer than half a step of 8 bits"


def case(
    name: str,
    make: Callable[[], BTF],
    test: Callable[[Encoded], Measured] = no_worse,
    cheap: bool = False,
    holds: str = NO_WORSE,
    unphysical: bool = False,
) -> Case:
    """A case of this group: how its BTF is made, and the test of what it is decoded to; see `Case`."""
    return Case("data", name, holds, lambda subject: test(subject.encode(make())), cheap, unphysical)


OTHERS_NO_WORSE = "the other texels, by themselves, no worse than their mean colours"
STORED = f"{MEAN}, after five times the steps, or refused by an error that names them"
ONE_PAIR = f"{MEAN}, exact here, or than the codec on the ordinary material, after three times its steps"
SAME_UNSCALED = f"the quality of the same data unscaled, within {SAME_DB} dB (above {EXACT_DB:.0f} dB all are equal)"
CASES = (
    case("all zero", lambda: material(np.zeros_like(values())), cheap=True),
    case("two constants", two_constants, constants_hold, cheap=True, holds="every value within 10 %", unphysical=True),
    case("one texel", lambda: material(values()[:, :1, :1]), cheap=True),
    Case("data", "one pair", ONE_PAIR, one_pair_holds),
    case("one row", lambda: material(values()[:, :1])),
    case("3 × 1,001 texels", long_strip),
    case("rank one", lambda: material(values()[:1] * values()[:, 3:4, 4:5, 1:2])),
    *(
        # By powers of two, which change no digit: what differs then is the codec's, and no fit that went elsewhere.
        Case("data", f"scaled by 2^{power}", SAME_UNSCALED, partial(same_quality, 2.0**power))
        for power in (-27, -13, 13)
    ),
    # A quarter of the texels in eight views of nine.
    case("65,504 beside zeros", lambda: painted(np.zeros_like(values()), np.s_[:-9, ::2, ::2]), unphysical=True),
    case("random highlights of 65,504", lambda: painted(values(), np.random.default_rng(0).random((81, 8, 8)) < 0.5)),
    Case("data", "highlights of 1e6", STORED, stored_or_refused, unphysical=True),
    case("subnormal halves", lambda: material((values() * 2.0**-15).astype(np.float16))),  # in steps of 2⁻²⁴
    case("one firefly texel", firefly, others_no_worse, cheap=True, holds=OTHERS_NO_WORSE),
    case("negative noise below 1e-3", negative_noise, holds=f"negative radiance is answered as 0; else {MEAN}"),
    case("identical pairs twice", lambda: of_pairs(np.tile(np.arange(81), 2))),
    case("black seen from above", black_from_above),
    case("views only at the zenith", lambda: of_pairs(np.flatnonzero(ordinary().wo[:, 2] > 0.999))),
    # Brighter than Fresnel lets the base layer be at 89°.
    case("lights only at grazing", grazing_lights, unphysical=True),
    Case("data", "NaN and infinite texels", "an error that says how many and where", refused, cheap=True),
    Case("data", "NaN texels, repaired", f"masked, said so; {MEAN}", mended),
)
