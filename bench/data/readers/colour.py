"""The colour space that a picture states, and its conversion to linear Rec. 709.

A space has primaries and a white, stated as chromaticities x and y, and a curve from light to codes, the whole numbers
that a picture holds: often code = light ^ exponent.

What states nothing is sRGB. An ICC profile is applied by Little CMS, to 8-bit codes. A PNG may state its exponent
(gAMA), its primaries (cHRM) or both by number (cICP) instead; a camera states Adobe RGB in EXIF. What agrees with sRGB
changes no value. Colours outside the gamut of sRGB are clipped.

EXR and Radiance pictures hold light itself, and what states nothing is Rec. 709. They state primaries by
chromaticities, EXR also by the name of a space. Colours outside the gamut stay negative.
"""

import io
import struct
import warnings
from dataclasses import dataclass
from functools import lru_cache
from itertools import takewhile
from typing import Any

import numpy as np

from bench.btf import Array
from bench.data.readers import exr, radiance
from bench.data.readers.orientation import exif, png_chunks
from bench.inputs.errors import InputError

# Chromaticities: x and y of red, green, blue and white.
REC709 = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)
ADOBE_RGB = (0.64, 0.33, 0.21, 0.71, 0.15, 0.06, 0.3127, 0.3290)
DISPLAY_P3 = (0.68, 0.32, 0.265, 0.69, 0.15, 0.06, 0.3127, 0.3290)
REC2020 = (0.708, 0.292, 0.17, 0.797, 0.131, 0.046, 0.3127, 0.3290)
AP0 = (0.7347, 0.2653, 0.0, 1.0, 0.0001, -0.077, 0.32168, 0.33767)  # of ACES2065-1 (SMPTE ST 2065-1)
AP1 = (0.713, 0.293, 0.165, 0.83, 0.128, 0.044, 0.32168, 0.33767)  # of ACEScg (Academy S-2014-004)
ADOBE_EXPONENT = 256 / 563  # Adobe RGB (1998), 4.3.1.2: light = code ^ 2.19921875
SRGB_EXPONENT = 0.45455  # the gAMA that PNG gives to sRGB
# The primaries and curves of ITU-T H.273 by its numbers; the exponent 0 stands for the curve of sRGB.
_PRIMARIES = {1: REC709, 9: REC2020, 12: DISPLAY_P3}
_EXPONENTS = {4: 1 / 2.2, 8: 1.0, 13: 0.0}
# Names of linear spaces in EXR, in small letters and digits alone → primaries. They are those of the Color Interop
# Forum, like lin_ap1_scene, and of OpenColorIO's configurations, like ACEScg and Linear Rec.709 (sRGB).
_LINEAR = {"acescg": AP1, "aces20651": AP0, "linearrec709srgb": REC709}
for _word, _primaries in {
    "rec709": REC709,
    "srgb": REC709,
    "p3d65": DISPLAY_P3,
    "rec2020": REC2020,
    "adobergb": ADOBE_RGB,
    "ap0": AP0,
    "ap1": AP1,
}.items():
    _LINEAR |= {f"lin{_word}": _primaries, f"lin{_word}scene": _primaries, f"linear{_word}": _primaries}
_NAMES_NO_PRIMARIES = ("", "data", "raw", "unknown", "linear", "scenelinear")
# Attributes of EXR that speak of colour and change no value here: an absolute scale, and the white of a look.
_EXR_IGNORED = ("whiteLuminance", "adoptedNeutral")
# From CIE XYZ to the responses of three cones, in which one white is adapted to another.
_BRADFORD = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]])
# EXIF tags: of the two tables that are looked at, and of the colour space in the first.
_EXIF_IFD, _INTEROP_IFD, _COLOUR_SPACE = 0x8769, 0xA005, 0xA001


@dataclass(frozen=True)
class Colour:
    """A colour space that is not sRGB: an ICC profile, or else an exponent and chromaticities."""

    name: str  # in words, for provenances and errors
    profile: bytes = b""  # empty: the exponent and the chromaticities count
    exponent: float = 0.0  # code = light ^ exponent; 0 is the curve of sRGB
    # x and y of red, green, blue and white.
    chromaticities: tuple[float, ...] = REC709

    def linear(self, codes: Array, srgb: Array) -> Array:
        """Linear Rec. 709 (…, 3) float32 in [0, 1] of integer codes (…, 3); a profile is applied by `srgb_by_profile`.

        `srgb` (number of codes,) holds the linear value of each code in sRGB, for a space with the curve of sRGB.
        """
        fractions = np.arange(len(srgb)) / (len(srgb) - 1)  # of the largest code
        curve = fractions ** (1 / self.exponent) if self.exponent else srgb
        return np.clip(self.in_rec709(curve[codes]), 0, 1)  # colours outside the gamut of Rec. 709 leave [0, 1]

    def in_rec709(self, light: Array) -> Array:
        """Linear Rec. 709 (…, 3) float32 of linear RGB in these primaries (…, 3); outside the gamut it is negative."""
        if not _alike(self.chromaticities, REC709):
            with np.errstate(over="ignore", invalid="ignore"):  # what is not finite is refused when the picture is read
                light = light @ _to_rec709(self.chromaticities).T
        return np.asarray(light, np.float32)


def by_attributes(data: bytes, label: str) -> tuple[Colour | None, list[str]]:
    """The colour space of an EXR from the bytes of its header, None for linear Rec. 709, and the attributes of colour
    that are ignored.

    `InputError`, which names the picture by `label`, for a space that cannot be converted. By the Color Interop Forum
    colorInteropID supersedes chromaticities. Of the others none goes before another, so a contradiction is an
    `InputError`, too.
    """
    attributes, _ = exr.attributes_of(data, label)
    if attributes is None or exr.channels_to_read(attributes, label) == ("X", "Y", "Z"):
        return None, []  # X, Y, Z are of no primaries
    ignored = [name for name in _EXR_IGNORED if name in attributes]
    stated: list[Colour] = []
    for field in ("colorInteropID", "chromaticities", "oiio:ColorSpace"):
        if field not in attributes:
            continue
        space = "" if field == "chromaticities" else attributes[field].rstrip(b"\0").decode("utf-8", "replace")
        words = f"{field} {space[:60]}".strip()
        if stated and stated[0].name.startswith("colorInteropID"):
            ignored.append(words)
            continue
        primaries: tuple[float, ...] | None
        if field == "chromaticities":
            primaries = struct.unpack("<8f", attributes[field])
            _refuse_flat(primaries, label, field)
        else:
            primaries = _primaries_of(space, f"{label}: its {words}")
        if primaries is None:
            ignored.append(words)
        else:
            stated.append(Colour(words, chromaticities=primaries))
    for other in stated[1:]:
        if not _alike(stated[0].chromaticities, other.chromaticities):
            fault = f"its {stated[0].name} and its {other.name} state different colours"
            raise InputError(f"{label}: {fault}: leave the one that is right")
    is_rec709 = not stated or _alike(stated[0].chromaticities, REC709)
    return None if is_rec709 else stated[0], ignored


def _primaries_of(space: str, label: str) -> tuple[float, ...] | None:
    """The chromaticities of a linear space by its name in an EXR; None for a name that states none, such as `raw`.

    `InputError` for any other space; `label` says what names it.
    """
    key = "".join(letter for letter in space.lower() if letter.isalnum())
    if key in _NAMES_NO_PRIMARIES:
        return None
    if key not in _LINEAR:
        raise InputError(f"{label} is not converted: convert it to linear Rec. 709 (sRGB)")
    return _LINEAR[key]


def by_radiance(data: bytes, label: str) -> tuple[Colour | None, list[str]]:
    """The primaries of a Radiance picture, and the lines that are ignored, as `by_attributes` has them.

    A correction of colours is named with them; it is undone where the picture is read.
    """
    header = radiance.header(data, label)
    if header is None:
        return None, []
    used = []
    chromaticities: tuple[float, ...] = REC709
    if header.primaries:
        _refuse_flat(header.primaries, label, "PRIMARIES")
        if not _alike(header.primaries, REC709):
            chromaticities = header.primaries
            used.append("PRIMARIES " + " ".join(f"{value:g}" for value in chromaticities))
    if header.correction != (1, 1, 1):
        used.append("COLORCORR " + " ".join(f"{factor:g}" for factor in header.correction))
    if not used:
        return None, header.ignored
    return Colour(" and ".join(used), chromaticities=chromaticities), header.ignored


def of_codes(picture: Any, data: bytes, label: str) -> Colour | None:
    """The colour space of a JPEG or PNG, None for sRGB; `data` are the bytes of it that Pillow's image `picture` is of.

    `InputError`, which names the picture by `label`, for a space that cannot be converted.
    """
    chunks: dict[bytes, bytes] = {}
    # Pillow does not tell cICP, and does not tell the other chunks from texts of the same names.
    if picture.format == "PNG":
        chunks = dict(takewhile(lambda chunk: chunk[0] != b"IDAT", png_chunks(data)))
    # cICP comes before a profile, a profile before sRGB, and that before gAMA and cHRM. EXIF counts without these.
    if b"cICP" in chunks:
        return _by_number(chunks[b"cICP"], label)
    profile = picture.info.get("icc_profile", b"")
    is_behind_size = bool(getattr(picture, "icclist", []))  # Pillow applies none that stands there in a JPEG
    if not isinstance(profile, bytes) or is_behind_size:
        raise InputError(f"{label}: its ICC profile is damaged or stands at a wrong place: save it as sRGB")
    if profile:
        return _by_profile(profile, label)
    if b"sRGB" in chunks:
        return None
    if {b"gAMA", b"cHRM"} & set(chunks):
        return _by_chunks(chunks, label)
    return _by_exif(picture)


def _by_profile(profile: bytes, label: str) -> Colour | None:
    """The space of an ICC profile; None for sRGB. `InputError` for a profile that cannot be applied."""
    from PIL import ImageCms

    try:
        name = _name_unless_srgb(profile, _mode(profile, label))
    except (ImageCms.PyCMSError, OSError) as error:
        raise InputError(f"{label}: its ICC profile cannot be applied ({error}): save it as sRGB") from error
    return Colour(f"ICC profile {name}", profile) if name else None


def srgb_by_profile(image: Any, colour: Colour, label: str) -> Array:
    """The sRGB codes (H, W, 3) uint8 of a Pillow image in the colour space `colour`, an ICC profile.

    `InputError` if the profile does not fit the image `label`, or cannot be applied.
    """
    from PIL import ImageCms

    mode = _mode(colour.profile, label)
    # Pillow's modes of grey: of one bit, of 8, and with alpha. Converting colours to grey would lose them.
    if mode == "L" and image.mode not in ("1", "L", "LA"):
        raise InputError(f"{label}: its ICC profile is of grey, but it has colours: save it as sRGB")
    try:
        return np.asarray(ImageCms.applyTransform(image.convert(mode), _transform(colour.profile, mode)))
    except ImageCms.PyCMSError as error:
        raise InputError(f"{label}: its ICC profile cannot be applied ({error}): save it as sRGB") from error


def _by_number(content: bytes, label: str) -> Colour | None:
    """The space of the content of a PNG's chunk cICP: the numbers of its primaries and its curve (ITU-T H.273).

    None for sRGB; `InputError` for a number that is not converted.
    """
    primaries, curve = content[:2]
    # The next two bytes must be 0, no matrix, which means RGB, and 1, codes of full range.
    if primaries not in _PRIMARIES or curve not in _EXPONENTS or content[2:4] != b"\0\1":
        fault = f"its cICP chunk states colour space {', '.join(map(str, content[:4]))}, which is not converted"
        raise InputError(f"{label}: {fault}: save it as sRGB, or as linear EXR")
    exponent, chromaticities = _EXPONENTS[curve], _PRIMARIES[primaries]
    is_srgb = exponent == 0 and chromaticities == REC709
    if is_srgb:
        return None
    return Colour(f"cICP {primaries}, {curve}", b"", exponent, chromaticities)


def _by_chunks(chunks: dict[bytes, bytes], label: str) -> Colour | None:
    """The space of a PNG's chunks gAMA and cHRM, by name, both in units of 1e-5; None for sRGB.

    Without gAMA the curve is that of sRGB, without cHRM the primaries are. `InputError` for impossible primaries.
    """
    exponent = 0.0
    chromaticities: tuple[float, ...] = REC709
    if b"gAMA" in chunks:
        (in_units,) = struct.unpack(">I", chunks[b"gAMA"])
        exponent = in_units / 1e5  # 0 states nothing
    if b"cHRM" in chunks:
        white_first = np.array(struct.unpack(">8I", chunks[b"cHRM"])) / 1e5
        white_last = np.roll(white_first, -2)  # x and y of the white go behind those of the primaries
        chromaticities = tuple(float(value) for value in white_last)
        _refuse_flat(chromaticities, label, "cHRM chunk")
    has_srgb_curve = exponent == 0 or abs(exponent - SRGB_EXPONENT) < 1e-4
    has_srgb_primaries = _alike(chromaticities, REC709)
    if has_srgb_curve and has_srgb_primaries:
        return None
    chunks_used = []
    if exponent:
        chunks_used.append(f"gAMA {exponent:g}")
    if not has_srgb_primaries:
        chunks_used.append("cHRM")
    return Colour(" and ".join(chunks_used), b"", exponent, chromaticities)


def _refuse_flat(chromaticities: tuple[float, ...], label: str, field: str) -> None:
    """Raise an `InputError` if the primaries that `field` of a picture states lie on one line, or its white has a y
    near 0."""
    white_y = chromaticities[-1]
    if abs(white_y) < 1e-3:  # the white is divided by it
        raise InputError(f"{label}: the white of its {field} has no light (y = {white_y:g}): save it without")
    # The determinant is twice the area between the primaries in x and y: on one line, their matrix has no inverse.
    primaries, _ = _in_xyz(chromaticities)
    if abs(np.linalg.det(primaries)) < 1e-3:
        raise InputError(f"{label}: the primaries of its {field} span no colours: save it without")


def _by_exif(picture: Any) -> Colour | None:
    """Adobe RGB, if the camera's notes in a JPEG or PNG say so; else None, which is sRGB.

    By DCF 2.0 the interoperability index R03 says it; some cameras write the colour space 2 instead. Colour space 1 is
    sRGB, whatever the index.
    """
    notes = exif(picture)
    if notes is None:
        return None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            space = notes.get_ifd(_EXIF_IFD).get(_COLOUR_SPACE)
            index = str(notes.get_ifd(_INTEROP_IFD).get(1, "")).strip("\0 ")  # tag 1 of that table
        except Exception:  # damaged notes raise many types; they state nothing then
            return None
    is_adobe = space == 2 or (index == "R03" and space != 1)
    if not is_adobe:
        return None
    return Colour("Adobe RGB by EXIF", b"", ADOBE_EXPONENT, ADOBE_RGB)


@lru_cache(16)
def _name_unless_srgb(profile: bytes, mode: str) -> str:
    """The name of a profile for pictures of `mode` (RGB, or L for grey); "" if it is sRGB.

    It is applied to a grid of colours: the many versions of sRGB change a code by 1 at most. The result is cached,
    because the pictures of a folder share their profile.
    """
    from PIL import Image, ImageCms

    if mode == "L":
        grid = np.arange(256, dtype=np.uint8)[None]  # a picture of one row
        grid_as_rgb = np.repeat(grid[..., None], 3, 2)
    else:
        levels = np.linspace(0, 255, 9).round().astype(np.uint8)  # of each channel
        colours = np.stack(np.meshgrid(levels, levels, levels), -1)
        grid = grid_as_rgb = colours.reshape(27, 27, 3)  # 9³ colours as a picture
    converted = np.asarray(ImageCms.applyTransform(Image.fromarray(grid), _transform(profile, mode)))
    if np.abs(converted.astype(int) - grid_as_rgb).max() <= 1:
        return ""
    name = ImageCms.getProfileDescription(ImageCms.ImageCmsProfile(io.BytesIO(profile)))
    printable = "".join(letter for letter in name if letter.isprintable())
    return printable.strip()[:60] or "without a name"  # it goes into messages, so it must stay short


def _mode(profile: bytes, label: str) -> str:
    """Pillow's mode of the pictures that a profile is for: RGB, or L for grey. `InputError` for others, like CMYK."""
    space = profile[16:20]  # the field "data colour space" of its header
    if space not in (b"RGB ", b"GRAY"):
        raise InputError(f"{label}: its ICC profile is of {space.decode('latin-1').strip()!r}: save it as sRGB")
    return "L" if space == b"GRAY" else "RGB"


@lru_cache(16)
def _transform(profile: bytes, mode: str) -> Any:
    """The Pillow transform (`ImageCmsTransform`) of pictures of `mode` from a profile to 8-bit sRGB, cached."""
    from PIL import ImageCms

    # This intent keeps the colours that the profile means; others fit them to a medium, such as paper.
    intent = ImageCms.Intent.RELATIVE_COLORIMETRIC
    space = ImageCms.ImageCmsProfile(io.BytesIO(profile))
    return ImageCms.buildTransform(space, ImageCms.createProfile("sRGB"), mode, "RGB", intent)


def _alike(first: tuple[float, ...], second: tuple[float, ...]) -> bool:
    """Whether two sets of chromaticities (x and y of red, green, blue and white) are the same but for rounding."""
    return bool(np.allclose(first, second, atol=2e-3))


def _to_rec709(chromaticities: tuple[float, ...]) -> Array:
    """The matrix (3, 3) from linear RGB of some primaries and white to linear Rec. 709, for column vectors.

    Its white becomes that of Rec. 709: the responses of Bradford's three cones are scaled so that the whites agree.
    """
    source, target = _to_xyz(chromaticities), _to_xyz(REC709)
    source_white, target_white = source.sum(1), target.sum(1)  # the sums over the primaries
    gains = (_BRADFORD @ target_white) / (_BRADFORD @ source_white)  # factors (3,) of the cones
    adapted: Array = np.linalg.inv(_BRADFORD) @ np.diag(gains) @ _BRADFORD @ source
    return np.linalg.inv(target) @ adapted


def _to_xyz(chromaticities: tuple[float, ...]) -> Array:
    """The matrix (3, 3) from linear RGB to CIE XYZ: its columns, the primaries, add up to the white, whose Y is 1."""
    primaries, white = _in_xyz(chromaticities)
    amounts = np.linalg.solve(primaries, white)  # of each primary in the white
    return primaries * amounts


def _in_xyz(chromaticities: tuple[float, ...]) -> tuple[Array, Array]:
    """The primaries in CIE XYZ, the columns of (3, 3), each with X + Y + Z = 1, and the white (3,), with Y = 1."""
    xy = np.reshape(chromaticities, (4, 2))
    columns = np.stack([xy[:, 0], xy[:, 1], 1 - xy.sum(1)])
    return columns[:, :3], columns[:, 3] / xy[3, 1]
