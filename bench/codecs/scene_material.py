"""A material fitted to a scene: maps queries of the whole texture to the stored window, and warns of those outside."""

import logging
from typing import Any

import torch
from torch import Tensor

from bench.codecs.window import Window, cell_of, from_hex
from bench.material import Material, Wrapped

log = logging.getLogger(__name__)

FINER = 2.0  # a footprint smaller than the finest demanded one by this factor is far outside


class SceneMaterial(Wrapped):
    """Wraps the decoded material of a window of the texture; see `bench.demand.needed_part`.

    A query is far outside the scene's demand if its direction is over a map cell away from every demanded one, or its
    position or footprint was left out. Such queries get the nearest stored answer, and are reported once.
    """

    def __init__(self, inner: Material, scene: dict[str, Any], name: str):
        """Take the window from the facts `scene` of a file. `ValueError` if the decoded texture has another size."""
        height, width = map(int, scene["size"])  # of the whole texture, in texels
        top, left, window_height, window_width = map(int, scene["window"])
        window = Window((height, width), top, left, window_height, window_width, int(scene["factor"]))
        if inner.size != tuple(side // window.factor for side in window.sides):
            raise ValueError(f"a window of {window.sides} texels over {window.factor} is not {inner.size}")
        super().__init__(inner)
        # Of the whole texture, in boxes of texels, since queries are for the whole.
        self.size = height // window.factor, width // window.factor
        self.window = window
        self.name = name  # of the file, for the warning
        self.finest = float(scene["finest"]) / FINER  # the smallest footprint that is not far outside
        # Whether each cell of the map of directions was demanded: (CELLS²,) bool, indexed by `cell_of`.
        self.views = torch.from_numpy(from_hex(scene["views"])).flatten()
        self.lights = torch.from_numpy(from_hex(scene["lights"])).flatten()
        self.reports = True  # until the first warning

    def to(self, device: torch.device | str | None = None, dtype: torch.dtype | None = None) -> Material:
        self.inner.to(device, dtype)
        return super().to(device, dtype)

    def evaluate(self, uv: Tensor, wo: Tensor, wi: Tensor, footprint: Tensor) -> Tensor:
        if self.reports and not torch.compiler.is_compiling():  # a warning is no part of what is compiled
            self._warn_outside(uv, wo, wi, footprint)
        return self.inner.evaluate(self.window.within(uv), wo, wi, footprint * self.window.stretch)

    def _warn_outside(self, uv: Tensor, wo: Tensor, wi: Tensor, footprint: Tensor) -> None:
        """Warn, once, if some of the queries are far outside."""
        # A direction is inside if its cell of the map was demanded.
        inside = self.views.index_select(0, cell_of(wo)) & self.lights.index_select(0, cell_of(wi))
        if not self.window.full:
            inside &= self.window.holds(uv)
        # Without boxes of texels the file is as fine as the texture, so no footprint is too small for it.
        if self.window.factor > 1:
            inside &= footprint >= self.finest
        outside = len(uv) - int(inside.count_nonzero())
        if outside:
            self.reports = False
            fault = f"{outside} of {len(uv)} queries lie far outside the scene that it was fitted to"
            remedy = "take the full model, or fit it to the demand of this scene"
            log.warning("%s: %s, and more may follow: %s", self.name, fault, remedy)


def without_warnings(material: Material) -> Material:
    """The same material without the warning, for callers that query everything on purpose."""
    if isinstance(material, SceneMaterial):
        material.reports = False
    return material
