"""Pictures whose names carry the angles, `tlTTT plPPP tvTTT pvPPP` in whole degrees: UTIA, UBO2003 and ATRIUM.

`tl` and `pl` are θ and φ of the light, `tv` and `pv` those of the view.

UTIA (Prague, http://btf.utia.cas.cz/?data_des) has folders `tv000_pv000` of PNG (sRGB) or OpenEXR (CIE XYZ under D65)
pictures; UBO2003 and ATRIUM (Bonn) are a zip of JPEG or Radiance pictures, 81 views × 81 lights.
"""

import re
from typing import Any

import numpy as np

from bench.btf import BTF
from bench.data.readers.checks import directions_of_degrees, provenance_of, view_major
from bench.data.readers.files import Candidate, Files, FolderFiles
from bench.data.readers.pictures import PictureSource
from bench.files.archive import ZipFiles

# Groups are θ_i, φ_i of the light, θ_o, φ_o of the view. Bonn puts a running number (and at times the material) before
# the angles and uses spaces or underscores.
BONN = re.compile(r"(?:^|/)[^/]+[ _]tl(\d{3})[ _]pl(\d{3})[ _]tv(\d{3})[ _]pv(\d{3})\.[^/.]+$", re.ASCII)
PRAGUE = re.compile(r"(?:^|/)tl(\d{3})_pl(\d{3})_tv(\d{3})_pv(\d{3})\.[^/.]+$", re.ASCII)
UTIA = provenance_of(
    "UTIA",
    "PNG decoded as sRGB to linear Rec. 709; EXR converted from CIE XYZ (D65)",
    clamp="none here; 8-bit codes end at 1, EXR does not",
    directions="nominal: the light of a pair with light = view was moved a little when measured",
)
UBO2003 = provenance_of(
    "UBO2003",
    "JPEG decoded as sRGB to linear Rec. 709; .hdr as stored",
    clamp="none here; 8-bit codes end at 1, .hdr does not",
)


def opened(seen: Candidate) -> BTF | None:
    """The BTF of a folder, or of a zip (nothing is extracted), of pictures with such names; None without any.

    8-bit codes are decoded as sRGB, `.hdr` is taken as stored, EXR of UTIA is converted from XYZ to linear Rec. 709,
    where colours outside the gamut stay negative; radiance is as photographed. The pairs are those of the existing
    files, by view, then light. Raises `InputError` that names the picture if angles are out of range, a pair appears
    twice or sizes differ.
    """
    # Some archivers add hidden copies, `._name`.
    names = [name for name in sorted(seen.names) if not name.rpartition("/")[2].startswith(".")]
    # No name fits both patterns: UTIA's begin with `tl`, Bonn's with other text.
    utia = _opened_as(seen, names, PRAGUE, UTIA, rgb_is_xyz=True)
    if utia is not None:
        return utia
    return _opened_as(seen, names, BONN, UBO2003, rgb_is_xyz=False)


def _opened_as(
    seen: Candidate, names: list[str], pattern: re.Pattern[str], provenance: dict[str, Any], rgb_is_xyz: bool
) -> BTF | None:
    """The BTF of the pictures among `names` that match `pattern`, sorted by view, then light; None if none does.

    The groups of `pattern` are θ_i, φ_i, θ_o, φ_o in degrees. Files of other names, such as notes, are left out.
    `rgb_is_xyz`: as for `read_picture`.
    """
    matches = list(filter(None, map(pattern.search, names)))
    if not matches:
        return None
    path = seen.path
    files: Files = FolderFiles(path) if seen.is_folder else ZipFiles(path)
    matched = [match.string for match in matches]
    degrees = np.array([match.groups() for match in matches], np.float64)
    labels = [files.label(name) for name in matched]
    # The light stands first in a name.
    wi, wo = directions_of_degrees(degrees, labels.__getitem__, (" of the light", " of the view"))
    order = view_major(wo, wi)
    source = PictureSource(files, [matched[i] for i in order], rgb_is_xyz=rgb_is_xyz)
    material_name = path.resolve().name if seen.is_folder else path.stem
    return BTF(material_name, wo[order], wi[order], source, provenance=provenance | source.conversions())
