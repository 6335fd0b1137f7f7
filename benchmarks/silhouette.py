"""Shows what a BTF keeps of a surface and what it loses: a ball with its real relief beside codecs on a smooth ball.

    python benchmarks/silhouette.py [--material cable-knit] [--size 64] [--picture docs/images/silhouette.jpg]

The left ball is the material's own height field as a displaced mesh with the reflectance of the suite's renderer, lit
directly, by Mitsuba. On the others, which are round, codecs answer for the material. First the reflectance is held to
the suite's renderer on a plane without height. Needs the extra [mitsuba].
"""

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from PIL import Image

import bench
from bench.data.materials import recipe
from bench.data.materials.maps import Maps
from bench.data.materials.renderer import render
from bench.demand.mitsuba.brdf import reflect, shading
from bench.demand.mitsuba.bsdf import register
from bench.demand.mitsuba.scene import set_variant
from bench.hemisphere import uniform
from bench.metrics.display import exposure_of, to_display

SIDE, SAMPLES = 300, 64
RADIUS, REPEAT = 0.5, (6, 3)
FINE = 128  # cells of the mesh to a side of the texture
CODECS: dict[str, dict[str, Any]] = {"pca": {}}
set_variant()  # which Mitsuba's classes wait for


class Truth(mi.BSDF):
    """The reflectance of the suite's renderer in the frame of the displaced mesh; for a colour and a gloss alike in
    all directions, as of cable-knit."""

    def __init__(self, maps: Maps):
        mi.BSDF.__init__(self, mi.Properties())
        flags = mi.BSDFFlags.GlossyReflection | mi.BSDFFlags.FrontSide
        self.m_flags, self.m_components = flags, [flags]
        self.rest = [float(np.mean(x)) for x in (maps.roughness, maps.metalness, maps.specular, maps.anisotropy)]
        self.base = mi.Texture2f(mi.TensorXf(maps.base_colour), wrap_mode=dr.WrapMode.Repeat)

    def eval(self, context: Any, si: Any, wo: Any, active: Any = True) -> Any:
        base = mi.Color3f(*self.base.eval(mi.Point2f(si.uv.x, 1 - si.uv.y)))
        value = reflect(shading(si.wi, base, *self.rest), wo)
        return dr.select(active & (si.wi.z > 0) & (wo.z > 0), value, 0)

    def pdf(self, context: Any, si: Any, wo: Any, active: Any = True) -> Any:
        return dr.select(wo.z > 0, wo.z / dr.pi, 0)

    def eval_pdf(self, context: Any, si: Any, wo: Any, active: Any = True) -> Any:
        return self.eval(context, si, wo, active), self.pdf(context, si, wo, active)

    def sample(self, context: Any, si: Any, sample1: Any, sample2: Any, active: Any = True) -> Any:
        found = mi.BSDFSample3f(mi.warp.square_to_cosine_hemisphere(sample2))
        found.pdf, found.eta = self.pdf(context, si, found.wo, active), 1.0
        found.sampled_type, found.sampled_component = mi.UInt32(+mi.BSDFFlags.GlossyReflection), 0
        return found, self.eval(context, si, found.wo, active) / found.pdf

    def to_string(self) -> str:
        return "Truth[]"


def on_a_plane(maps: Maps, pairs: int = 20) -> float:
    """How far the reflectance lies from the suite's renderer where both see the maps without height: the largest
    difference over the largest value, over all texels of some pairs."""
    rng = np.random.default_rng(0)
    wo, wi = (uniform(rng, pairs, 80.0) for _ in range(2))
    wanted = render(replace(maps, height=0.0), wo, wi, maps.shape, sub_points=1)
    rows, columns = (x.ravel() for x in np.mgrid[: maps.shape[0], : maps.shape[1]])
    bsdf, si = Truth(maps), dr.zeros(mi.SurfaceInteraction3f, len(rows))
    si.uv = mi.Point2f((columns + 0.5) / maps.shape[1], 1 - (rows + 0.5) / maps.shape[0])
    worst = 0.0
    for view, light, slice_ in zip(wo, wi, wanted, strict=True):
        si.wi = mi.Vector3f(*view.tolist())
        found = np.asarray(bsdf.eval(mi.BSDFContext(), si, mi.Vector3f(*light.tolist()))).T
        worst = max(worst, float(np.abs(found - slice_.reshape(-1, 3)).max()))
    return worst / float(wanted.max())


def between(picture: np.ndarray, row: np.ndarray, col: np.ndarray) -> np.ndarray:
    """A periodic picture (H, W) at fractional rows and columns, linear between the centres of its cells."""
    (H, W), top, left = picture.shape, np.floor(row).astype(int), np.floor(col).astype(int)
    down, right = row - top, col - left
    upper, lower = (
        picture[r % H, left % W] * (1 - right) + picture[r % H, (left + 1) % W] * right for r in (top, top + 1)
    )
    return upper * (1 - down) + lower * down


def ball(bsdf: mi.BSDF, height: np.ndarray) -> mi.Mesh:
    """A ball whose texture repeats upright, displaced by heights (H, W) in widths of the texture, row 0 at the top."""
    rows, columns = REPEAT[1] * FINE, REPEAT[0] * FINE
    u, v = np.meshgrid(np.arange(columns + 1) / FINE, np.linspace(0.02, REPEAT[1] - 0.02, rows + 1))
    rise = np.asarray(Image.fromarray(height.astype(np.float32)).resize((FINE, FINE), Image.Resampling.BOX))
    rise = between(rise, (1 - v) * FINE - 0.5, u * FINE - 0.5)
    phi, theta = (u / REPEAT[0] - 0.5) * 2 * np.pi, (v / REPEAT[1] - 0.5) * np.pi
    outward = np.stack([np.cos(phi) * np.cos(theta), np.sin(phi) * np.cos(theta), np.sin(theta)], -1)
    place = outward * (RADIUS + rise * 2 * np.pi * RADIUS / REPEAT[0])[..., None]
    east, north = np.gradient(place, axis=1), np.gradient(place, axis=0)
    normal = np.cross(east, north)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    corner = np.arange((rows + 1) * (columns + 1)).reshape(rows + 1, -1)
    a, b, c, d = corner[:-1, :-1], corner[:-1, 1:], corner[1:, 1:], corner[1:, :-1]
    faces = np.stack([a, b, c, a, c, d], -1).reshape(-1, 3)
    properties = mi.Properties()
    properties["bsdf"] = bsdf
    mesh = mi.Mesh("ball", corner.size, len(faces), properties, has_vertex_normals=True, has_vertex_texcoords=True)
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"], parameters["vertex_normals"] = (x.astype("f4").ravel() for x in (place, normal))
    parameters["vertex_texcoords"] = np.stack([u, v], -1).astype("f4").ravel()
    parameters["faces"] = faces.astype("u4").ravel()
    parameters.update()
    return mesh


def picture(bsdf: mi.BSDF, height: np.ndarray) -> np.ndarray:
    """The ball under a lamp (SIDE, SIDE, 3), linear."""
    camera = {
        "type": "perspective",
        "fov": 22.0,
        "to_world": mi.ScalarTransform4f().look_at([0, -3.1, 0.6], [0, 0, 0], [0, 0, 1]),
        "film": {"type": "hdrfilm", "width": SIDE, "height": SIDE, "rfilter": {"type": "box"}},
    }
    lamp = {"type": "point", "position": [-2.2, -1.8, 1.5], "intensity": {"type": "rgb", "value": 10.0}}
    scene = {"type": "scene", "integrator": {"type": "direct"}, "ball": ball(bsdf, height), "lamp": lamp}
    return np.asarray(mi.render(mi.load_dict(scene | {"camera": camera}), spp=SAMPLES))[..., :3]


def main() -> None:
    """See the module."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--material", default="cable-knit")
    parser.add_argument("--size", type=int, default=64)
    parser.add_argument("--out", type=Path, default=Path("runs/silhouette"))
    parser.add_argument("--picture", type=Path, default=Path("docs/images/silhouette.jpg"))
    options = parser.parse_args()
    register()
    maps = recipe(options.material).maps(0)
    print(f"reflectance on a plane: within {on_a_plane(maps):.1e} of the largest value of the suite's renderer")
    flat = np.zeros_like(maps.height)
    found = [picture(Truth(maps), maps.height - maps.height.mean())]
    for codec, settings in CODECS.items():
        file = options.out / f"{options.material}-{codec}.nbtf"
        if not file.exists():
            bench.encode(bench.open(options.material, size=options.size), codec, file, **settings)
        found.append(picture(mi.load_dict({"type": "neubtf", "filename": str(file)}), flat))
        lit = (found[0] > 0).any(-1) & (found[-1] > 0).any(-1)
        print(f"{codec}: mean of the picture {found[-1][lit].mean() / found[0][lit].mean():.3f} × the relief's")
    exposure = exposure_of(found[0][(found[0] > 0).any(-1)])
    shown = np.round(255 * to_display(np.concatenate(found, 1), exposure)).astype(np.uint8)
    Image.fromarray(shown).save(options.picture, quality=88)
    print(f"wrote {options.picture}: relief, {', '.join(CODECS)}")


if __name__ == "__main__":
    main()
