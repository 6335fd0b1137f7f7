"""UBO2003 and ATRIUM of the Bonn BTF database: a zip of JPEG or Radiance pictures, 81 views × 81 lights."""

from bench.btf import BTF
from bench.data.readers.candidate import Candidate
from bench.data.readers.checks import described
from bench.data.readers.named import BONN, matching, open_pictures


def opened(seen: Candidate) -> BTF | None:
    """The BTF of a zip (nothing is extracted) or its folder of files like `00008 tl000 pl000 tv000 pv000.jpg`, or None.

    JPEG codes are decoded as sRGB, `.hdr` is taken as stored: linear Rec. 709, radiance as photographed. The pairs are
    those of the existing files, by view, then light. Errors as in `named.open_pictures`.
    """
    if not matching(seen.names, BONN):
        return None
    clamp = "none here; 8-bit codes end at 1, .hdr does not"
    provenance = described("UBO2003", "JPEG decoded as sRGB to linear Rec. 709; .hdr as stored", clamp=clamp)
    return open_pictures(seen.path, BONN, provenance)
