"""A Mitsuba 3 BSDF, `neubtf`, that answers from a codec file: any codec whose `evaluate` can be recorded.

    <bsdf type="neubtf" id="cloth">
        <string name="filename" value="satin.nbtf"/>
        <float name="repeat" value="4"/>
    </bsdf>

`repeat` is how often the texture repeats over the shape's uv; `two_sided` mirrors the material to the back, which is
black otherwise. The frame is the shape's: u along `dp_du`, the normal its shading normal. Where the integrator gives
ray differentials, their footprint in uv is averaged over. Directions are drawn by the cosine.
"""

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi

from bench.codecs.loading import load
from bench.codecs.program import program_of
from bench.codecs.traced import Traced
from bench.errors import InputError
from bench.llvm import unusable

NAME = "neubtf"
VARIANTS = ("llvm_ad_rgb", "cuda_ad_rgb")
Values = Any  # Dr.Jit arrays


def register() -> None:
    """Make the plug-in known to Mitsuba's present variant. `InputError` where that cannot run it."""
    variant = mi.variant() or ""
    if variant not in VARIANTS:
        raise InputError(f"Mitsuba's variant {variant or 'none'} cannot run a codec: set {' or '.join(VARIANTS)}")
    if variant.startswith("llvm") and (reason := unusable(plugins=True)):
        raise InputError(reason)
    mi.register_bsdf(NAME, _plugin(variant))


class _Answers:
    """What the plug-in does, whatever the variant; `_plugin` adds Mitsuba's own class."""

    m_flags: Any
    m_components: Any

    def __init__(self, props: Any):
        mi.BSDF.__init__(self, props)
        self.file = Path(str(props["filename"]))
        self.repeat = float(props.get("repeat", 1.0))
        self.two_sided = bool(props.get("two_sided", False))
        side = mi.BSDFFlags.FrontSide | (mi.BSDFFlags.BackSide if self.two_sided else mi.BSDFFlags.Empty)
        flags = mi.BSDFFlags.GlossyReflection | mi.BSDFFlags.SpatiallyVarying | side
        self.m_components, self.m_flags = [flags], flags
        self.answer = Traced(program_of(load(self.file).material), _arrays(mi.variant()))

    def sample(self, context: Any, si: Any, sample1: Any, sample2: Any, active: Any = True) -> Any:
        toward = mi.warp.square_to_cosine_hemisphere(sample2)
        if self.two_sided:
            toward.z = dr.mulsign(toward.z, si.wi.z)
        found = mi.BSDFSample3f(toward)
        found.pdf = self.pdf(context, si, toward, active)
        found.eta, found.sampled_component = 1.0, 0
        found.sampled_type = mi.UInt32(+mi.BSDFFlags.GlossyReflection)
        active = active & (found.pdf > 0)
        return found, dr.select(active, self.eval(context, si, toward, active) / found.pdf, 0)

    def eval(self, context: Any, si: Any, wo: Any, active: Any = True) -> Any:
        # Mitsuba's wi is toward the camera and its wo toward the light.
        view, light = mi.Vector3f(si.wi), mi.Vector3f(wo)
        if self.two_sided:
            view.z, light.z = abs(view.z), dr.mulsign(light.z, si.wi.z)
        active = active & (view.z > 0) & (light.z > 0)
        up = mi.Vector3f(0, 0, 1)
        view, light = dr.select(active, view, up), dr.select(active, light, up)
        uv = si.uv * self.repeat
        uv -= dr.floor(uv)
        side = self.repeat * dr.maximum(dr.norm(si.duv_dx), dr.norm(si.duv_dy))
        rgb = self.answer([uv.x, uv.y], [view.x, view.y, view.z], [light.x, light.y, light.z], side)
        return dr.select(active, dr.maximum(mi.Color3f(*rgb), 0), 0)

    def pdf(self, context: Any, si: Any, wo: Any, active: Any = True) -> Any:
        height = dr.mulsign(wo.z, si.wi.z) if self.two_sided else wo.z
        seen = (abs(si.wi.z) if self.two_sided else si.wi.z) > 0
        return dr.select(active & seen & (height > 0), height / dr.pi, 0)

    def eval_pdf(self, context: Any, si: Any, wo: Any, active: Any = True) -> Any:
        return self.eval(context, si, wo, active), self.pdf(context, si, wo, active)

    def traverse(self, callback: Any) -> None:
        """Nothing of a codec file can be changed in a scene."""

    def to_string(self) -> str:
        return f"{NAME}[{self.file.name}, repeat={self.repeat:g}, two_sided={self.two_sided}]"


@cache
def _plugin(variant: str) -> Callable[[Any], Any]:
    """The class of the plug-in: Mitsuba's classes are those of a variant, and take no second base."""
    return type("NeuBTF", (mi.BSDF,), {name: value for name, value in vars(_Answers).items() if callable(value)})


def _arrays(variant: str) -> Any:
    import drjit.cuda
    import drjit.llvm

    return drjit.cuda.ad if variant.startswith("cuda") else drjit.llvm.ad
