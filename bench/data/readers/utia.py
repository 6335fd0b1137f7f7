"""The UTIA BTF database (Prague): folders `tv000_pv000` of PNG (sRGB) or OpenEXR (CIE XYZ under D65) pictures.

Format: http://btf.utia.cas.cz/?data_des
"""

from bench.btf import BTF
from bench.data.readers.candidate import Candidate
from bench.data.readers.checks import described
from bench.data.readers.named import PRAGUE, matching, open_pictures


def opened(seen: Candidate) -> BTF | None:
    """The BTF of a folder, or of a zip of PNGs, whose files are named like `tl000_pl000_tv000_pv000.png`, or None.

    PNG codes are decoded as sRGB, EXR is converted from XYZ to linear Rec. 709, where colours outside the gamut stay
    negative; radiance is as photographed. Pairs are sorted by view, then light. Errors as in `named.open_pictures`.
    """
    if not matching(seen.names, PRAGUE):
        return None
    provenance = described(
        "UTIA",
        "PNG decoded as sRGB to linear Rec. 709; EXR converted from CIE XYZ (D65)",
        clamp="none here; 8-bit codes end at 1, EXR does not",
        directions="nominal: the light of a pair with light = view was moved a little when measured",
    )
    return open_pictures(seen.path, PRAGUE, provenance, rgb_is_xyz=True)
