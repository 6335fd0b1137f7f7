"""Checks that every reader makes before it returns a BTF: directions, duplicates, form and range of values.

An entry is what the data say of one pair or one direction, such as a line of a list. Its index among them is its row,
and `label(row)` gives the words that name it in an error: `pairs.csv, line 7`. θ is the angle from the normal (z), φ
the azimuth; pairs and slices are those of `bench.btf`.
"""

import logging
import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from bench.btf import BTF, Array
from bench.directions.hemisphere import from_angles, from_degrees, to_degrees
from bench.inputs.errors import InputError

HORIZON = 1e-6  # a direction lies above the surface if its z exceeds this
MANY_BELOW = 0.25  # a larger share of directions below the surface means other axes
LOOKED_AT = 24  # slices whose values are checked before a fit or a score; all of them may be many gigabytes
VALUES = 50_000  # the most values of each such slice from which a percentile is computed
LARGEST, SMALLEST = 1e12, 1e-12  # of the radiance that can be used; measured and rendered materials are around 1
NOISE = 1e-3  # negative values down to this share of the largest are noise
# How the radiance of a format contains the cosine of the light, in words for a provenance.
PHOTOGRAPHED = "radiance as photographed: the cosine is the light's own fall on the surface"
IN_THE_DATA = "in the data: f_r cos(theta_i)"
AS_STORED = "as stored: values are taken as f_r cos(theta_i)"

log = logging.getLogger(__name__)


def provenance_of(
    form: str, colour: str, cosine: str = PHOTOGRAPHED, clamp: str = "none", **more: Any
) -> dict[str, Any]:
    """The provenance of a BTF: its format, and how its colour, the light's cosine and highlights were read.

    All are words for a reader of `info`. `clamp` says where highlights end; `more` are further notes by key.
    """
    return {"format": form, "colour": colour, "cosine": cosine, "clamp": clamp} | more


def unit_note(angles: str) -> dict[str, str]:
    """The note for a provenance on the unit of angles that the user named, "degrees" or "radians"; {} for any other."""
    if angles not in ("degrees", "radians"):
        return {}
    return {"angles": f"taken as {angles}, as the user says"}


def unit_directions(vectors: Array, label: Callable[[int], str], tolerance: float = 1e-3) -> Array:
    """The vectors (N, 3) scaled to length 1, float32, if they are directions above the surface.

    `InputError` names the first row that is not finite, not of length 1 within `tolerance`, or not above the surface;
    if many are not above it, also the likely reason.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        vectors = np.asarray(vectors, np.float64)
        length = np.linalg.norm(vectors, axis=1)
        good = np.abs(length - 1) <= tolerance  # NaN and infinity are not
    if not good.all():
        row = int(np.argmin(good))
        raise InputError(f"{label(row)}: {_vector_words(vectors[row])} is not a unit vector: give x y z of length 1")
    above = vectors[:, 2] > HORIZON
    if not above.all():
        row = int(np.argmin(above))
        fault = f"{label(row)}: {_vector_words(vectors[row])} is not above the surface (z > 0)"
        raise InputError(f"{fault}: {_remedy_below(vectors)}")
    return (vectors / length[:, None]).astype(np.float32)


def _remedy_below(vectors: Array) -> str:
    """What to do about directions (N, 3) of which at least one is not above the surface.

    Many of them mean that the axes differ; all of them, that the sign does. One alone shows neither.
    """
    z = vectors[:, 2]
    below = int((z <= HORIZON).sum())
    if below > 1 and (z < -HORIZON).all():
        return f"all {below:,} are below it, so they seem to be negated: give the way from the surface, -1 times each"
    if below > max(1, MANY_BELOW * len(z)):
        return f"{below:,} of {len(z):,} are not, so the axes may differ: is y up in your data? z must be the normal"
    return "leave this entry out"


def different_directions(theta: Array, phi: Array, label: Callable[[int], str], suffix: str = "") -> Array:
    """Unit vectors (N, 3) float32 of angles θ, φ (N,) in radians, which must all be in range and different.

    `InputError` names the first fault by `label(row)`; `suffix` follows "theta" and "phi" in its text, like `_deg`.
    """
    refuse_out_of_range(theta, phi, label, suffix)
    directions = from_angles(theta, phi)
    no_duplicates(directions, directions, label)
    return directions


def directions_of_degrees(angles: Array, label: Callable[[int], str], suffixes: tuple[str, str]) -> tuple[Array, Array]:
    """The unit vectors of N pairs, (N, 3) float32 for each of the two sides, view and light, in the order of `angles`.

    `angles` (N, 4) are θ, φ of one side and θ, φ of the other, in degrees. `InputError` if an angle is out of range or
    a pair stands twice; in its text `suffixes` follow "theta" and "phi" of the two sides, like `_o_deg`.
    """
    theta_1, phi_1, theta_2, phi_2 = angles.T
    refuse_out_of_range(np.radians(theta_1), np.radians(phi_1), label, suffixes[0])
    refuse_out_of_range(np.radians(theta_2), np.radians(phi_2), label, suffixes[1])
    side_1 = from_degrees(theta_1, phi_1)
    side_2 = from_degrees(theta_2, phi_2)
    no_duplicates(side_1, side_2, label)
    return side_1, side_2


def refuse_out_of_range(theta: Array, phi: Array, label: Callable[[int], str], suffix: str = "") -> None:
    """Raise `InputError` unless every θ lies in [0°, 90°) and every φ in [−360°, 360°]; both are (N,) in radians.

    The error names the row by `label(row)`; `suffix` follows "theta" or "phi" in its text.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        theta_deg = np.degrees(np.asarray(theta, np.float64))
        phi_deg = np.degrees(np.asarray(phi, np.float64))
        # Limits leave room for rounding. NaN fails all of these tests, and so is refused. The cosine is the z of the
        # direction: just below 90° it may not exceed `HORIZON`.
        theta_is_good = (theta_deg >= -1e-4) & (np.cos(np.radians(theta_deg)) > HORIZON) & (theta_deg < 90.0)
        phi_is_good = np.abs(phi_deg) <= 360.001
    for is_good, symbol, degrees, bounds in (
        (theta_is_good, "theta", theta_deg, "[0, 90)"),
        (phi_is_good, "phi", phi_deg, "[-360, 360]"),
    ):
        if not is_good.all():
            row = int(np.argmin(is_good))
            fault = f"{symbol}{suffix} = {degrees[row]:g} degrees is outside {bounds}"
            raise InputError(f"{label(row)}: {fault}: correct the angle or leave the entry out")


def in_degrees(theta: Array, phi: Array, label: str, angles: str) -> tuple[Array, Array]:
    """θ and φ in degrees, from arrays of any shape that a file states as degrees.

    `angles` is the unit that the user names: "radians" converts them, "degrees" takes them as they are. If the user
    names neither, angles that seem to be radians are an `InputError`, and columns of them alone a warning. Arrays
    (N, 2) have a column of the view and one of the light.
    """
    if angles == "radians":
        return np.degrees(theta), np.degrees(phi)
    if angles == "degrees":
        return theta, phi
    if _seem_radians(theta, phi):
        fault = "every theta is below 1.6 degrees and every phi below 6.3, so these seem to be radians"
        raise InputError(f"{label}: {fault}: say which they are by --radians or --degrees (data.angles)")
    columns = {"theta": theta, "phi": phi}
    if theta.ndim == 2:
        columns = {"theta_o": theta[:, 0], "phi_o": phi[:, 0], "theta_i": theta[:, 1], "phi_i": phi[:, 1]}
    _warn_of_columns(columns, label)
    return theta, phi


def warn_of_radians(wo: Array, wi: Array, label: str) -> None:
    """Warn if directions (N, 3) all lie so near the normal that radians seem to have been taken for degrees, or if that
    holds for some of their angles alone, such as θ of the views."""
    if _seem_radians(*to_degrees(np.concatenate([wo, wi]))):
        fault = "every theta is below 1.6 degrees and every phi below 6.3, as if from radians taken for degrees"
        log.warning("%s: %s: multiply the angles by 180 / pi before you make vectors of them", label, fault)
        return
    columns: dict[str, Array] = {}
    for side, directions in (("o", wo), ("i", wi)):
        theta, phi = to_degrees(directions)
        columns |= {f"theta_{side}": theta, f"phi_{side}": phi[theta > 0.1]}  # φ means nothing at the normal
    _warn_of_columns(columns, label)


def _warn_of_columns(columns: dict[str, Array], label: str) -> None:
    """Warn of columns of angles in degrees (name, which begins with theta or phi → values) that seem to be radians."""
    suspect = [name for name, values in columns.items() if _column_seems_radians(values, name.startswith("theta"))]
    if suspect:
        fault = f"all numbers of {' and '.join(suspect)} are as small as radians, but not those of the others"
        log.warning("%s: %s: if they are radians, multiply these by 180 / pi", label, fault)


def _column_seems_radians(values: Array, is_theta: bool) -> bool:
    """Whether one column of angles in degrees may be radians: small numbers, and not all of them whole.

    Their spread must be that of radians, too: a camera that hardly moved has angles of a degree or so.
    """
    around_0 = values if is_theta else _around_0(values)
    if not around_0.size or np.allclose(around_0, np.round(around_0), atol=1e-3):
        return False
    low, high = float(around_0.min()), float(around_0.max())
    if is_theta:
        return bool(high < 1.6 and high - low > 0.3)
    return bool(high < 6.3 and high - low > 1.5)


def _seem_radians(theta: Array, phi: Array) -> bool:
    """Whether angles stated as degrees may be radians: no θ exceeds π / 2 as a number, and no φ 2 π.

    False if every θ is 0, which means the same in both units.
    """
    # Just above π / 2 = 1.571 and 2 π = 6.283.
    return bool(0 < theta.max() < 1.6 and _around_0(phi).max() < 6.3)


def _around_0(phi: Array) -> Array:
    """|φ| in degrees once φ is brought to [−180, 180), because 359 degrees are as near 0 as 1 degree is."""
    with np.errstate(invalid="ignore"):  # an infinite angle is refused later
        return np.asarray(np.abs((phi + 180) % 360 - 180))


def radiance_fault(shape: tuple[int, ...], dtype: np.dtype) -> str:
    """Words for what is wrong with the shape or type of radiance, and the remedy; "" where it is (N, H, W, 3) floats.

    An array without values is wrong, too.
    """
    if len(shape) == 4 and shape[-1] == 3 and 0 not in shape and dtype.kind == "f":
        return ""
    if len(shape) == 4 and shape[0] == 0:
        return "radiance has no pairs: give at least one"
    remedy = ""
    channels_come_second = len(shape) == 4 and shape[1] == 3 and shape[-1] != 3
    if channels_come_second:
        remedy = ": give radiance.transpose(0, 2, 3, 1)"
    elif dtype.kind in "iu":
        if dtype.itemsize <= 2:
            largest_code = f"{np.iinfo(dtype).max:,}"
        else:  # NumPy's arithmetic makes wide integers of codes that had fewer bits
            largest_code = "the largest code (255 of 8 bits, 65,535 of 16)"
        remedy = f": divide codes by {largest_code}, and convert sRGB to linear"
    return f"radiance is {shape} {dtype}: it must be (N, H, W, 3) floats{remedy}"


def codes_fault(values: Array) -> str:
    """A sentence on radiance (any shape) that is plainly 8-bit codes, for a warning; "" if it is not.

    Codes are whole numbers up to 255, or these over 255. Linear values decoded from sRGB do not lie on either grid.
    """
    top = float(values.max())
    scale = 255.0 if top <= 1 else 1.0
    in_codes = values.astype(np.float64) * scale
    is_on_grid = np.abs(in_codes - np.round(in_codes)).max() < 1e-3
    if not is_on_grid or top * scale > 255 or len(np.unique(np.round(in_codes))) < 16:
        return ""
    if scale == 1:
        return "every value is a whole number up to 255, as codes are: divide by 255, and convert sRGB to linear"
    return "every value is a whole number of 255ths, as sRGB codes are: convert sRGB to linear"


def negative_fault(values: Array) -> str:
    """A sentence on radiance (any shape) below 0, for a warning; "" if there is none, or only noise."""
    least = float(values.min())
    exceeds_noise = least < -NOISE * float(values.max())
    if not exceeds_noise:
        return ""
    return f"{(values < 0).mean():.2%} of the values are negative, the least {least:.4g}: radiance cannot be"


def refuse_extremes(btf: BTF) -> None:
    """Raise an `InputError` if radiance is too large or too small for float32 arithmetic, or for the stored results of
    a run, which hold no number above 1e18.

    It reads `LOOKED_AT` slices of the BTF. Too large is a matter of the largest value, too small of the 99th
    percentile, which a few stray bright values do not raise; of the largest value, too, where less than 1 % is lit.
    Black data are allowed.
    """
    largest, bright = _largest_and_bright(btf)
    if largest > LARGEST:
        extreme = largest
        fault = f"its largest value is {largest:.3g}, above {LARGEST:g}"
    elif 0 < bright < SMALLEST:
        extreme = bright
        which = "its largest value" if bright == largest else "the 99th percentile of its values"
        fault = f"{which} is {bright:.3g}, below {SMALLEST:g}"
    else:
        return
    factor = 10.0 ** -round(math.log10(extreme))  # brings that value near 1
    raise InputError(f"{btf.name}: {fault}, too far from 1 for float32: multiply it by {factor:g} in float64")


def _largest_and_bright(btf: BTF) -> tuple[float, float]:
    """The largest value of some slices, and the 99th percentile; the largest for both where less than 1 % is lit."""
    largest = 0.0
    samples = []  # one-dimensional, some values of each slice
    for picture in some_slices(btf):
        largest = max(largest, float(picture.max()))
        step = math.ceil(picture.size / VALUES)  # rounded up, so that at most `VALUES` values are taken
        if step % 3 == 0:  # red, green and blue take turns: such steps would meet one of them alone
            step += 1
        samples.append(picture.reshape(-1)[::step])
    values = np.maximum(np.concatenate(samples), 0)  # what is below 0 is noise
    return largest, float(np.percentile(values, 99)) or largest


def some_slices(btf: BTF) -> Iterator[Array]:
    """At most `LOOKED_AT` slices (H, W, 3) of a BTF, evenly spread over its pairs."""
    for pair in np.unique(np.linspace(0, len(btf) - 1, LOOKED_AT).astype(int)):
        yield btf[int(pair)]


def no_duplicates(wo: Array, wi: Array, label: Callable[[int], str]) -> None:
    """Raise `InputError` if two of the pairs (wo[i], wi[i]), each (N, 3), are equal to 6 decimals; it names both.

    A BTF has one picture for each pair.
    """
    rows = np.round(np.concatenate([wo, wi], 1).astype(np.float64), 6) + 0.0  # the sum makes 0 of −0
    order = np.lexsort(rows.T[::-1])  # sorted by all six coordinates, so that equal rows are neighbours
    equals_next = (rows[order[1:]] == rows[order[:-1]]).all(1)
    if equals_next.any():
        place = int(np.argmax(equals_next))
        first, second = sorted((int(order[place]), int(order[place + 1])))
        raise InputError(f"{label(second)}: it has the same view and light as {label(first)}: leave one of the two out")


def view_major(wo: Array, wi: Array) -> Array:
    """The indices (N,) that sort pairs by view, then by light, each by θ and then φ."""
    keys = []  # `np.lexsort` sorts by its last key first: by θ_o, then φ_o, θ_i, φ_i
    for side in (wi, wo):
        theta, phi = to_degrees(side)
        theta, phi = np.round(theta, 3), np.round(phi, 3)  # the last bit must not decide the order
        phi = np.where(theta == 0, 0.0, phi % 360.0)  # at the pole φ means nothing
        keys += [phi, theta]
    return np.lexsort(keys)


def _vector_words(vector: Array) -> str:
    """A vector in words: `(0, 0.6, 0.8)`."""
    return "(" + ", ".join(f"{value:g}" for value in vector) + ")"
