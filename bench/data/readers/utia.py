"""The UTIA BTF database (Prague): folders `tv000_pv000` of PNG (sRGB) or OpenEXR (CIE XYZ under D65) pictures.

Format: http://btf.utia.cas.cz/?data_des
"""

from pathlib import Path

from bench.btf import BTF
from bench.data.readers.candidate import Candidate
from bench.data.readers.named import PRAGUE, matching, open_pictures


def opened(seen: Candidate) -> BTF | None:
    """The BTF of a folder or zip whose files are named like `tl000_pl000_tv000_pv000.png`, or None."""
    return open_utia(seen.path) if matching(seen.names, PRAGUE) else None


def open_utia(path: Path) -> BTF:
    """The BTF of a UTIA folder, or of a zip of PNGs.

    PNG codes are decoded as sRGB, EXR is converted from XYZ to linear Rec. 709, where colours outside the gamut stay
    negative; radiance as photographed. Pairs by view, then light. Errors as in `named.open_pictures`.
    """
    provenance = {
        "format": "UTIA",
        "colour": "PNG decoded as sRGB to linear Rec. 709; EXR converted from CIE XYZ (D65)",
        "cosine": "radiance as photographed: the cosine is the light's own fall on the surface",
        "clamp": "none here; 8-bit codes end at 1, EXR does not",
        "directions": "nominal: the light of a pair with light = view was moved a little when measured",
    }
    return open_pictures(path, PRAGUE, provenance, rgb_is_xyz=True)
