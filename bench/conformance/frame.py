"""Proves the frame, the order of channels and directions, and the units of a codec's answers against the truth.

The material has a closed form, so the truth is known in any arrangement, and no two arrangements look alike: quadrants,
channels, views and lights all differ. Answers are projected on the line from the truth T to each wrong arrangement W:
share = ⟨answers − T, W − T⟩ / ⟨W − T, W − T⟩ is 0 at T and 1 at W. The error of a codec that blurs or omits detail is
almost orthogonal to that line. A codec that ignores what W changes, such as a mean over all pairs, is half way.

A codec that can represent only a part of the truth may land nearer to W without a mistake. So no arrangement is
accused by its share alone: the codec is also given the truth with the mistake undone. With the mistake it answers the
truth then; without it the truth only gets farther away.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
import torch
from torch import Tensor

from bench.btf import BTF, ArraySource
from bench.directions.hemisphere import from_degrees, product
from bench.material import Material, texel_centres, texel_corners
from bench.metrics.display import LOG_SCALE, decode_srgb, encode_srgb, exposure, exposure_of

SHAPE = (8, 12)  # not square, so that height and width are told apart
WRONG, RIGHT = 0.65, 0.35  # a share above or below these decides; between them the codec does not separate the two
SAME_SCALE = 1.25  # a mean within this factor is not an error of units
PROVEN = 0.75  # a mistake is proven where undoing it leaves less than this share of the mean squared error
PHASES_U, PHASES_V = (0.03, 0.37, 0.66), (0.18, 0.52, 0.86)  # of the three channels
FAR_BELOW = 0.25  # the share of the truth's error that counts as far below it
WAVE = 0.2
ALBEDO = 0.45
LIGHT_DEG, VIEW_DEG, LIGHT_TILT, VIEW_TILT = 20.0, 140.0, 0.5, 0.35  # how radiance leans with the directions

Radiance = Callable[[Tensor, Tensor, Tensor], Tensor]  # uv (n, 2), ω_o and ω_i (n, 3) → RGB (n, 3)
Change = Callable[[Tensor, Tensor], tuple[Tensor, Tensor]]  # u and v (n,) → u and v (n,)
Curve = Callable[[np.ndarray], np.ndarray]


def truth(uv: Tensor, wo: Tensor, wi: Tensor) -> Tensor:
    """The radiance (n, 3) of the material, f_r · cos θ_i, at uv (n, 2), wo and wi (n, 3)."""
    across = torch.sin(2 * math.pi * (uv[:, :1] + torch.tensor(PHASES_U)))
    up = torch.sin(2 * math.pi * (uv[:, 1:] + torch.tensor(PHASES_V)))
    lean = 1 + LIGHT_TILT * _part_toward(wi, LIGHT_DEG) + VIEW_TILT * _part_toward(wo, VIEW_DEG)
    return (ALBEDO + WAVE * across + WAVE * up) * lean * wi[:, 2:]


def _part_toward(w: Tensor, phi_deg: float) -> Tensor:
    """The part (n, 1) of directions (n, 3) toward an azimuth in degrees, in the plane of the picture."""
    phi = math.radians(phi_deg)
    return w[:, :1] * math.cos(phi) + w[:, 1:2] * math.sin(phi)


def material(radiance: Radiance = truth) -> BTF:
    """A material as a BTF, all views times all lights: the zenith and two rings, which each turn maps to itself."""
    angles = [(0.0, 0.0)]  # θ and φ in degrees
    angles += [(30.0, 90.0 * number) for number in range(4)]
    angles += [(60.0, 45.0 * number) for number in range(8)]
    directions = np.stack([from_degrees(theta, phi) for theta, phi in angles])
    wo, wi = product(directions, directions)
    uv = texel_centres(*SHAPE)
    pictures = []
    for view, light in zip(torch.from_numpy(wo), torch.from_numpy(wi), strict=True):
        pictures.append(radiance(uv, view.expand(len(uv), 3), light.expand(len(uv), 3)))
    values = torch.stack(pictures).reshape(-1, *SHAPE, 3).numpy()
    return BTF("frame", wo, wi, ArraySource(values), periodic=True)


@dataclass(frozen=True)
class Mistake:
    """A possible mistake of a codec."""

    answers: Radiance  # what a codec with it answers when it is given the truth
    undone: Radiance  # what a codec with it must be given to answer the truth


def _at(change: Change) -> Radiance:
    """The radiance at other places, given by a function of u and v, each (n,)."""
    return lambda uv, wo, wi: truth(torch.stack(change(uv[:, 0], uv[:, 1]), 1), wo, wi)


def _moved(change: Change, back: Change | None = None) -> Mistake:
    """The picture asked at other places. `back` undoes `change`; None: `change` undoes itself."""
    return Mistake(_at(change), _at(back or change))


def _reshaped(stored: tuple[int, int], read: tuple[int, int]) -> Radiance:
    """The radiance (n, 3) of texels, row by row, of a picture `stored` (H, W) that is `read` in another shape."""

    def radiance(uv: Tensor, wo: Tensor, wi: Tensor) -> Tensor:
        """The four texels around each place (n, 2) of the picture as it is read, blended."""
        # (n, 4) each: the numbers of the texels, row by row, and their shares in bilinear blending.
        texel, weight = texel_corners(read, uv)
        centres = texel_centres(*stored)[texel]  # (n, 4, 2): where the texels of these numbers lie as stored
        total = torch.zeros(len(uv), 3)
        for corner in range(4):
            total = total + weight[:, corner : corner + 1] * truth(centres[:, corner], wo, wi)
        return total

    return radiance


def _channels(order: str) -> Mistake:
    """The channels in another order, like "BGR"."""
    places = ["RGB".index(channel) for channel in order]
    back = [order.index(channel) for channel in "RGB"]
    return Mistake(lambda *queries: truth(*queries)[:, places], lambda *queries: truth(*queries)[:, back])


def _turned(x: tuple[int, int], y: tuple[int, int], sides: str) -> Mistake:
    """Directions turned: their x and y are these whole multiples of the old x and y.

    `sides` is one of `SIDES`: whether ω_o, ω_i, or both are turned.
    """
    # A matrix multiplies a direction from the left; here directions are rows, so its transpose does from the right.
    turn = torch.tensor([[*x, 0], [*y, 0], [0, 0, 1]], dtype=torch.float32).T

    def radiance_by(turn: Tensor) -> Radiance:
        """The radiance with the chosen side or sides turned by a matrix (3, 3)."""
        view_turn = turn if sides in (BOTH, ONLY_WO) else torch.eye(3)
        light_turn = turn if sides in (BOTH, ONLY_WI) else torch.eye(3)
        return lambda uv, wo, wi: truth(uv, wo @ view_turn, wi @ light_turn)

    return Mistake(radiance_by(turn), radiance_by(turn.T))


def _through(curve: Curve) -> Radiance:
    """The radiance through a curve; values above 1 are not clamped."""
    return lambda uv, wo, wi: torch.from_numpy(curve(truth(uv, wo, wi).numpy()))


def _curved(curve: Curve, inverse: Curve) -> Mistake:
    """Values through a curve, with the curve that undoes it."""
    return Mistake(_through(curve), _through(inverse))


def _swapped(uv: Tensor, wo: Tensor, wi: Tensor) -> Tensor:
    """The radiance (n, 3) of views and lights in each other's place."""
    return truth(uv, wi, wo)


def _without_cosine(uv: Tensor, wo: Tensor, wi: Tensor) -> Tensor:
    """The radiance (n, 3) over the cosine of ω_i."""
    return truth(uv, wo, wi) / wi[:, 2:]


def _cosine_twice(uv: Tensor, wo: Tensor, wi: Tensor) -> Tensor:
    """The radiance (n, 3) times the cosine of ω_i."""
    return truth(uv, wo, wi) * wi[:, 2:]


HALF_U, HALF_V = 0.5 / SHAPE[1], 0.5 / SHAPE[0]  # half a texel
SIDES = BOTH, ONLY_WO, ONLY_WI = "ω_o and ω_i", "ω_o alone", "ω_i alone"
TURNS = (
    ("φ + 180° for φ (ω pointing the other way)", (-1, 0), (0, -1)),
    ("φ mirrored (−φ for φ)", (1, 0), (0, -1)),
    ("φ mirrored (180° − φ for φ)", (-1, 0), (0, 1)),
    ("φ + 90° for φ", (0, -1), (1, 0)),
    ("φ − 90° for φ", (0, 1), (-1, 0)),
    ("φ counted from +y clockwise", (0, 1), (1, 0)),
)
_LEFT, _RIGHT = (lambda u, v: (u + HALF_U, v)), (lambda u, v: (u - HALF_U, v))
_DOWN, _UP = (lambda u, v: (u, v + HALF_V)), (lambda u, v: (u, v - HALF_V))
_TO_LEFT, _TO_RIGHT = (lambda u, v: (v, 1 - u)), (lambda u, v: (1 - v, u))
MISTAKES: dict[str, Mistake] = {  # each possible mistake, by how a codec with it answers
    "with the picture upside down (v grows upwards, row 0 is the top)": _moved(lambda u, v: (u, 1 - v)),
    "with the picture mirrored left to right": _moved(lambda u, v: (1 - u, v)),
    "with the picture turned by 180°": _moved(lambda u, v: (1 - u, 1 - v)),
    "with u and v exchanged": _moved(lambda u, v: (v, u)),
    # Transposed rows and columns: u = col/W, v = 1 − row/H.
    "with the picture transposed, rows for columns": _moved(lambda u, v: (1 - v, 1 - u)),
    "with rows and columns counted for each other (reshape(W, H) for reshape(H, W))": Mistake(
        _reshaped(SHAPE, SHAPE[::-1]), _reshaped(SHAPE[::-1], SHAPE)
    ),
    "with the picture turned by 90° to the left": _moved(_TO_LEFT, _TO_RIGHT),
    "with the picture turned by 90° to the right": _moved(_TO_RIGHT, _TO_LEFT),
    "with the picture moved by half a texel to the left": _moved(_LEFT, _RIGHT),
    "with the picture moved by half a texel to the right": _moved(_RIGHT, _LEFT),
    "with the picture moved by half a texel down": _moved(_DOWN, _UP),
    "with the picture moved by half a texel up": _moved(_UP, _DOWN),
    **{f"with the channels in the order {order}": _channels(order) for order in ("BGR", "GRB", "RBG", "GBR", "BRG")},
    "with ω_o and ω_i exchanged": Mistake(_swapped, _swapped),
    **{f"with {words} in {sides}": _turned(x, y, sides) for sides in SIDES for words, x, y in TURNS},
    "as sRGB for linear radiance": _curved(encode_srgb, decode_srgb),
    "with sRGB undone twice": _curved(decode_srgb, encode_srgb),
    "without the cosine of ω_i": Mistake(_without_cosine, _cosine_twice),
    "with the cosine of ω_i twice": Mistake(_cosine_twice, _without_cosine),
}
# These lie so near the truth that a blurred answer leans toward them, too. So one is suspected only where the error
# toward it is far below that toward the truth.
LOGARITHM = "as log1p(radiance) for radiance (expm1 undoes it)"
OF_GAIN = "as log1p(gain · radiance) / gain for radiance (to_radiance undoes it)"
OF_GAIN_BARE = "as log1p(gain · radiance) for radiance (to_radiance undoes it)"
# What is wrong, and what to do, where the arrangement's name alone could be taken for advice.
REMEDIES = {
    "without the cosine of ω_i": "your answers lack the cosine of ω_i: multiply them by wi[:, 2:]",
    "with the cosine of ω_i twice": "your answers have the cosine of ω_i twice: multiply by it once only",
    "as sRGB for linear radiance": "your answers are sRGB: decode them to linear radiance",
    "with sRGB undone twice": "your answers had sRGB undone twice: decode it once only",
    LOGARITHM: "your answers are log1p(radiance): undo it by expm1",
    OF_GAIN: "your answers are log1p(gain · radiance) / gain: undo it by to_radiance(level, gain)",
    OF_GAIN_BARE: "your answers are log1p(gain · radiance): undo it by to_radiance(level, gain)",
}


@cache
def logarithms() -> dict[str, Mistake]:
    """The mistakes of codecs that predict a logarithm and do not undo it, by how they answer.

    A codec takes its gain g from the data: g · q is the same, c, for the bright quantile q of any data. Given
    y = expm1(h · x) / h it answers x by `OF_GAIN`, if its gain for y is h: then expm1(h · q) = c, so h = log1p(c) / q.
    By `OF_GAIN_BARE` it answers h · x, which no gain turns into x, but which is nearer to it.
    """
    gain = LOG_SCALE * exposure(material())
    c = LOG_SCALE * exposure_of(np.ones(1))  # of data that are 1, the gain is c
    given = gain * math.log1p(c) / c
    undone = _through(lambda values: np.expm1(given * values) / given)
    return {
        LOGARITHM: _curved(np.log1p, np.expm1),
        OF_GAIN: Mistake(_through(lambda values: np.log1p(gain * values) / gain), undone),
        OF_GAIN_BARE: Mistake(_through(lambda values: np.log1p(gain * values)), undone),
    }


@dataclass(frozen=True)
class FrameAnswers:
    """Answers at every texel and pair of the material, (n, 3) float64, and the queries: uv (n, 2), wo and wi (n, 3)."""

    answers: Tensor
    queries: tuple[Tensor, Tensor, Tensor]

    @classmethod
    def at_texel_centres(cls, decoded: Material, btf: BTF) -> "FrameAnswers":
        """Ask a decoded material at the texel centres, at every pair."""
        uv = texel_centres(*SHAPE)
        # All texels of the first pair, then all of the second, and so on.
        wo = torch.from_numpy(btf.wo).repeat_interleave(len(uv), 0)
        wi = torch.from_numpy(btf.wi).repeat_interleave(len(uv), 0)
        queries = uv.repeat(len(btf), 1), wo, wi
        return cls(decoded.query(*queries, footprint=1 / max(SHAPE)).double(), queries)

    @cached_property
    def right(self) -> Tensor:
        """The true answers (n, 3) to the queries, float64."""
        return truth(*self.queries).double()

    def share(self, wrong: Tensor) -> float:
        """How far the answers lie on the way from the truth, 0, to a wrong arrangement (n, 3), 1: see the module."""
        way = wrong.double() - self.right
        return float(((self.answers - self.right) * way).sum() / way.square().sum())

    def error(self, radiance: Radiance = truth) -> float:
        """The mean squared distance of the answers to an arrangement."""
        return float((self.answers - radiance(*self.queries)).square().mean())

    @property
    def scale(self) -> float:
        """The mean answer over the mean of the truth."""
        return float(self.answers.mean() / self.right.mean())

    def shares(self) -> dict[str, float]:
        """`share` of each wrong arrangement, by its description."""
        return {description: self.share(mistake.answers(*self.queries)) for description, mistake in MISTAKES.items()}

    def suspicions(self) -> list[tuple[str, Mistake]]:
        """The mistakes that the answers suggest, each with what to say of it, the likeliest first."""
        suspected = {name: MISTAKES[name] for name, share in self.shares().items() if share > WRONG}
        for description, mistake in logarithms().items():
            if self.error(mistake.answers) < FAR_BELOW * self.error():
                suspected[description] = mistake
        scale = self.scale
        if not 1 / SAME_SCALE <= scale <= SAME_SCALE and scale > 0:
            of_scale = _curved(lambda values: values * scale, lambda values: values / scale)
            suspected[f"as {scale:.3g} times the truth"] = of_scale
        likeliest = sorted(suspected.items(), key=lambda each: self.error(each[1].answers))
        return [(REMEDIES.get(name, f"your answers fit better {name}"), mistake) for name, mistake in likeliest]

    def undecided(self) -> list[str]:
        """The wrong arrangements to which the answers are about as near as to the truth, or nearer."""
        return [description for description, share in self.shares().items() if share > RIGHT]
