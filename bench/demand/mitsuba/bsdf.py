"""A Mitsuba 3 BSDF, `neubtf`, that answers from a codec file: any codec whose `evaluate` can be recorded.

    <bsdf type="neubtf" id="cloth">
        <string name="filename" value="satin.nbtf"/>
        <float name="repeat" value="4"/>
    </bsdf>

`repeat` is the number of times that the longer side of the texture fits in a unit of the shape's uv; the shorter side
repeats more often, so texels are square if uv keep the proportions of the surface. `two_sided` mirrors the material to
the back, which is black otherwise. The frame is the shape's: u along `dp_du`, v to the side of `dp_dv`, and its shading
normal. Answers are averaged over the footprint of a pixel: from the derivatives of uv if an integrator gives them (in
the differentiable variants it does not), else from `pixel_angle`, in radians, and the length of the ray. Directions are
drawn by the cosine, or from the file's lobes if `neubtf-bench export --lobes` has fitted some.
"""

from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import torch
from torch import Tensor

from bench.btf import periods
from bench.codecs.container import read_parts
from bench.codecs.loading import load
from bench.demand.demand import FARTHEST
from bench.demand.mitsuba.lobes import Lobe, checked
from bench.inputs.errors import InputError
from bench.program.kernel import Kernel
from bench.program.llvm import unusable
from bench.program.recording import program_of

NAME = "neubtf"
VARIANTS = ("llvm_ad_rgb", "cuda_ad_rgb")  # those that compute many rays at once, as a recorded codec needs


def register() -> type:
    """Register the plug-in in Mitsuba's current variant; returns its class. `InputError` if that cannot run it."""
    variant = mi.variant() or ""
    if variant not in VARIANTS:
        raise InputError(f"Mitsuba's variant {variant or 'none'} cannot run a codec: set {' or '.join(VARIANTS)}")
    reason = unusable(plugins=True) if variant.startswith("llvm") else ""
    if reason:
        raise InputError(reason)
    mi.register_bsdf(NAME, _plugin(variant))
    return _plugin(variant)


class _Lobes:
    """The lobes of a file, drawn from by Mitsuba's own GGX; see `bench.demand.mitsuba.lobes`.

    In its methods `si` is Mitsuba's interaction of rays with a surface; views and lights are vectors in the frame of
    the texture, z along the normal. All are Dr.Jit arrays with an entry for each ray.
    """

    def __init__(self, stored: np.ndarray, repeat: tuple[float, float]):
        """Lobes as a file stores them (cells, cells, 5), and how often the texture fits in a unit of u and of v."""
        self.cells = len(stored)  # along each side of the texture
        self.repeat = repeat
        lobe = Lobe.from_stored(torch.from_numpy(stored).reshape(-1, stored.shape[2]))
        # Twelve numbers of each cell: share, two roughnesses, then x, y and z of the three axes.
        columns = [lobe.share, lobe.along, lobe.across]
        for axis in lobe.axes:
            columns += axis.T.unbind()
        self.columns = [mi.Float(column.numpy()) for column in columns]

    def _lobe_at(self, si: Any) -> tuple[Any, Any, Any, list[Any]]:
        """Share, roughnesses and axes at the place where the texture is looked up."""
        uv = _wrapped(si, self.repeat)
        column = dr.minimum(mi.UInt32(uv.x * self.cells), self.cells - 1)
        row = dr.minimum(mi.UInt32((1 - uv.y) * self.cells), self.cells - 1)
        cell = row * self.cells + column
        share, along, across, *axis_numbers = [dr.gather(mi.Float, column, cell) for column in self.columns]
        axes = [mi.Vector3f(*axis_numbers[first : first + 3]) for first in (0, 3, 6)]
        return share, along, across, axes

    def share(self, si: Any, view: Any) -> Any:
        """The probability of the lobe: 0 for a view from behind its normal."""
        share, _, _, axes = self._lobe_at(si)
        _, _, normal = axes
        return dr.select(dr.dot(view, normal) > 1e-4, share, 0)

    def drawn(self, si: Any, view: Any, sample: Any) -> Any:
        """A direction toward the light; it may lie below the horizon."""
        _, along, across, axes = self._lobe_at(si)
        view_in_frame = _in_frame(axes, view)
        normal, _ = _ggx(along, across).sample(view_in_frame, sample)
        light = 2 * dr.dot(view_in_frame, normal) * normal - view_in_frame
        return light.x * axes[0] + light.y * axes[1] + light.z * axes[2]

    def density(self, si: Any, view: Any, light: Any) -> Any:
        """The density of the drawn direction over solid angle."""
        _, along, across, axes = self._lobe_at(si)
        view_in_frame, light_in_frame = _in_frame(axes, view), _in_frame(axes, light)
        half = dr.normalize(view_in_frame + light_in_frame)
        met = dr.dot(view_in_frame, half)
        # From half vectors to the directions that they reflect to, solid angles grow by 4 cos of view and half vector.
        density = _ggx(along, across).pdf(view_in_frame, half) / (4 * met)
        return dr.select((view_in_frame.z > 1e-4) & (met > 1e-4) & (half.z > 0), density, 0)


def _in_frame(axes: list[Any], direction: Any) -> Any:
    """A direction in the frame of three axes."""
    return mi.Vector3f(*(dr.dot(direction, axis) for axis in axes))


def _wrapped(si: Any, repeat: tuple[float, float]) -> Any:
    """The place in one period of the texture, which fits `repeat` times in a unit of the surface's u and v."""
    uv = mi.Point2f(si.uv.x * repeat[0], si.uv.y * repeat[1])
    return uv - dr.floor(uv)


def _uv_of(si: Any, step: Any) -> Any:
    """The change of uv for a step in the surface's frame, by least squares; 0 if the surface has no uv."""
    step = si.sh_frame.to_world(step)
    # The normal equations: products of the two derivatives with each other, and with the step.
    dot_uu, dot_uv, dot_vv = dr.squared_norm(si.dp_du), dr.dot(si.dp_du, si.dp_dv), dr.squared_norm(si.dp_dv)
    step_u, step_v = dr.dot(step, si.dp_du), dr.dot(step, si.dp_dv)
    determinant = dot_uu * dot_vv - dot_uv * dot_uv
    change = mi.Point2f(step_u * dot_vv - step_v * dot_uv, step_v * dot_uu - step_u * dot_uv)
    return dr.select(determinant > 0, change / determinant, 0)


def _ggx(along: Any, across: Any) -> Any:
    """Mitsuba's GGX distribution of visible normals, with two roughnesses."""
    return mi.MicrofacetDistribution(mi.MicrofacetType.GGX, along, across, True)  # True: visible ones


class _Answers:
    """The plug-in in any variant; `_plugin` adds Mitsuba's own class."""

    m_flags: Any
    m_components: Any

    def __init__(self, props: Any):
        """Load the codec file that the properties name, and record its program."""
        mi.BSDF.__init__(self, props)
        self.file = Path(str(props["filename"]))
        self.repeat = float(props.get("repeat", 1.0))
        self.two_sided = bool(props.get("two_sided", False))
        self.pixel_angle = float(props.get("pixel_angle", 0.0))
        side = mi.BSDFFlags.FrontSide | (mi.BSDFFlags.BackSide if self.two_sided else mi.BSDFFlags.Empty)
        flags = mi.BSDFFlags.GlossyReflection | mi.BSDFFlags.SpatiallyVarying | side
        # Mitsuba reads what a BSDF can do from these two: it has one component.
        self.m_components = [flags]
        self.m_flags = flags
        file = load(self.file)
        across, up = periods(file.material.size)
        self.periods = self.repeat * across, self.repeat * up
        arrays = import_module("drjit.cuda.ad" if str(mi.variant()).startswith("cuda") else "drjit.llvm.ad")
        self.answer = Kernel(program_of(file.material), arrays)
        _, parts = read_parts(self.file)
        self.draw_from(checked(self.file, parts.sampling))

    def draw_from(self, lobes: Tensor | None) -> None:
        """Draw directions from lobes (cells, cells, 5) instead of the file's, or by the cosine for None."""
        self.lobes = None if lobes is None else _Lobes(lobes.float().numpy(), self.periods)

    def sample(self, context: Any, si: Any, sample1: Any, sample2: Any, active: Any = True) -> Any:
        """A direction toward the light, and f_r · cos θ_i over its density, as Mitsuba's interface asks: `sample1`
        chooses between the cosine and the lobe, `sample2` draws from it."""
        view = self._turned(si, si.wi)
        toward = mi.warp.square_to_cosine_hemisphere(sample2)
        if self.lobes:
            toward = dr.select(sample1 < self.lobes.share(si, view), self.lobes.drawn(si, view, sample2), toward)
        drawn = mi.BSDFSample3f(self._turned(si, toward))
        drawn.pdf = self.pdf(context, si, drawn.wo, active)
        drawn.eta = 1.0
        drawn.sampled_component = 0
        drawn.sampled_type = mi.UInt32(+mi.BSDFFlags.GlossyReflection)
        active = active & (drawn.pdf > 0)
        return drawn, dr.select(active, self.eval(context, si, drawn.wo, active) / drawn.pdf, 0)

    def _turned(self, si: Any, direction: Any) -> Any:
        """A direction of the surface's frame in the texture's, or back."""
        # On Mitsuba's spheres v runs against the frame's y: the texture is mirrored, and its relief with it.
        mirrored = dr.dot(dr.cross(si.dp_du, si.dp_dv), si.sh_frame.n) < 0
        turned = mi.Vector3f(direction.x, dr.select(mirrored, -direction.y, direction.y), direction.z)
        if self.two_sided:
            turned.z = dr.mulsign(turned.z, si.wi.z)
        return turned

    def eval(self, context: Any, si: Any, wo: Any, active: Any = True) -> Any:
        """f_r · cos θ_i toward the camera, of light from `wo`; 0 for directions below the surface."""
        # Mitsuba's wi is toward the camera and its wo toward the light.
        view, light = self._turned(si, si.wi), self._turned(si, wo)
        active = active & (view.z > 0) & (light.z > 0)
        # Inactive lanes may hold NaN; an index computed from NaN can be 0, and a division by it kills the process.
        up = mi.Vector3f(0, 0, 1)
        view, light = dr.select(active, view, up), dr.select(active, light, up)
        uv = dr.select(active, _wrapped(si, self.periods), 0)
        side = dr.select(active, dr.minimum(self.repeat * self._footprint(si), FARTHEST), 0)
        rgb = self.answer([uv.x, uv.y], [view.x, view.y, view.z], [light.x, light.y, light.z], side)
        return dr.select(active, dr.maximum(mi.Color3f(*rgb), 0), 0)

    def _footprint(self, si: Any) -> Any:
        """The longer side of a ray's footprint in uv: from its derivatives, or from a cone as wide as a pixel."""
        side = dr.maximum(dr.norm(si.duv_dx), dr.norm(si.duv_dy))
        if not self.pixel_angle:
            return side
        # A circle around the ray is an ellipse on the surface, longer by 1 / cosine away from the viewer.
        slant = dr.maximum(dr.hypot(si.wi.x, si.wi.y), 1e-6)
        away = mi.Vector3f(si.wi.x, si.wi.y, 0) / slant
        across = mi.Vector3f(-si.wi.y, si.wi.x, 0) / slant
        # A view from the zenith has no direction away from it: any two axes do.
        away = dr.select(slant > 1e-6, away, mi.Vector3f(1, 0, 0)) / dr.maximum(abs(si.wi.z), 1e-6)
        across = dr.select(slant > 1e-6, across, mi.Vector3f(0, 1, 0))
        for step in (away, across):
            side = dr.maximum(side, dr.norm(_uv_of(si, si.t * self.pixel_angle * step)))
        return side

    def pdf(self, context: Any, si: Any, wo: Any, active: Any = True) -> Any:
        """The density over solid angle with which `sample` draws `wo`."""
        view, light = self._turned(si, si.wi), self._turned(si, wo)
        density = light.z / dr.pi
        if self.lobes:
            share = self.lobes.share(si, view)
            density = (1 - share) * density + share * self.lobes.density(si, view, light)
        return dr.select(active & (view.z > 0) & (light.z > 0), density, 0)

    def eval_pdf(self, context: Any, si: Any, wo: Any, active: Any = True) -> Any:
        """What `eval` and `pdf` give, as a pair: Mitsuba's interface asks for both at once, too."""
        return self.eval(context, si, wo, active), self.pdf(context, si, wo, active)

    def traverse(self, callback: Any) -> None:
        """Mitsuba asks here for parameters that a scene may change; a codec file has none."""

    def to_string(self) -> str:
        """The text that Mitsuba prints for this BSDF."""
        return f"{NAME}[{self.file.name}, repeat={self.repeat:g}, two_sided={self.two_sided}]"


@cache
def _plugin(variant: str) -> type:
    """The class of the plug-in in the current `variant`: Mitsuba's classes belong to one, and allow no second base."""
    return type("NeuBTF", (mi.BSDF,), {name: value for name, value in vars(_Answers).items() if callable(value)})
