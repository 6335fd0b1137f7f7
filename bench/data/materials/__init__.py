"""The built-in materials: rendered by the suite, so that everything runs without a download.

A *recipe* is a class of parameters, such as `Satin(threads=10)`, that makes a material's maps: height, colour,
roughness and so on at each texel. The renderer turns maps and directions into radiance. Names and descriptions live
here; recipes, renderer and image libraries are imported only when a material is loaded.
"""

import importlib
from typing import TYPE_CHECKING, Any

from bench.inputs.errors import InputError, did_you_mean

if TYPE_CHECKING:
    from bench.btf import BTF
    from bench.codec import Progress
    from bench.data.materials.maps import Recipe

_REGISTRY: dict[str, tuple[str, str]] = {  # name → "module:Class" of this package, and a description
    "brick": ("photographs:Brick", "rough diffuse relief: brickwork from a photograph"),
    "gravel": ("photographs:Gravel", "rough diffuse relief with sharp shadows, from a photograph"),
    "grass": ("photographs:Grass", "fine, irregular relief from a photograph"),
    "satin": ("procedural:Satin", "woven anisotropic satin, warp and weft of two colours"),
    "brushed-metal": ("procedural:BrushedMetal", "brushed anisotropic metal with HDR highlights"),
    "leather": ("procedural:Leather", "glossy pebbled leather"),
    "cable-knit": ("procedural:CableKnit", "cable-knit wool: strong parallax, occlusion and shadows"),
    "hammered-copper": ("procedural:HammeredCopper", "hammered copper: glossy dents with patina (kept apart)"),
    "wicker": ("procedural:Wicker", "woven willow rods: parallax and gaps (kept apart)"),
}


def names() -> list[str]:
    """Every built-in material."""
    return list(_REGISTRY)


def describe() -> dict[str, str]:
    """Name → one line of description; imports nothing."""
    return {name: description for name, (_, description) in _REGISTRY.items()}


def refuse_unknown(name: str) -> None:
    """Raise an `InputError` if no built-in material has this name."""
    if name not in _REGISTRY:
        raise InputError(f"unknown material {name!r}{did_you_mean(name, _REGISTRY)} (a path has a / or an ending)")


def recipe(name: str) -> "Recipe":
    """The recipe of a built-in material with its default parameters. Raises `InputError` for an unknown name."""
    refuse_unknown(name)
    location, _ = _REGISTRY[name]
    module, _, class_name = location.partition(":")  # "procedural:Satin"
    recipe_class = getattr(importlib.import_module(f"{__name__}.{module}"), class_name)
    return recipe_class()


def load(
    name: str, size: int = 64, seed: int = 0, draw: int = 0, show: "Progress | None" = None, **pairs: Any
) -> "BTF":
    """A built-in material as a periodic BTF of size² texels, rendered once and then mapped from the cache.

    Pairs are those of a `Preparation` with the fields given by name: `load("satin", views=81, lights=81)`. They are the
    product of `views` × `lights` evenly thinned directions of a published set (pair = view · lights + light), then
    `heldout` random pairs, drawn uniformly in solid angle up to θ = 75°, which `BTF.heldout` marks: test pairs of one
    `draw`, or with `split="validation"` those by which settings are chosen. `seed` determines the material's random
    structure and the held-out pairs. `show(label, done, total)`, in pairs, is called while rendering. Raises
    `InputError` for an unknown name or direction set and for counts out of range.
    """
    from bench.data.materials.store import load_or_render
    from bench.data.spec import Preparation

    return load_or_render(name, recipe(name), Preparation(size, **pairs), seed=seed, draw=draw, show=show)
