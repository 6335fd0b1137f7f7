"""Assigns the files of a folder to maps, by the names of ambientCG, Poly Haven, glTF exporters and Substance.

A file's name is cut into words at separators and capitals. Words with which all names begin (the asset's name) are left
out. The last phrase that the vocabulary knows decides: `rusty_metal_02_nor_gl_1k` is a normal map.
"""

import os
import re
from dataclasses import dataclass
from itertools import takewhile
from pathlib import Path

from bench.inputs.errors import InputError

PICTURES = (".png", ".jpg", ".jpeg", ".exr", ".hdr", ".tif", ".tiff", ".tga", ".bmp", ".webp")
_PHRASES = {
    "albedo": "albedo, base color, base colour, basecolor, basecolour, color, colour, col, diffuse, diff",
    "normal_gl": "normal gl, normal open gl, normal opengl, normal ogl, nor gl, norm gl, nrm gl",
    "normal_dx": "normal dx, normal direct x, normal directx, nor dx, norm dx, nrm dx",
    "normal": "normal, normals, nor, norm, nrm",
    "roughness": "roughness, rough, rgh",
    "metalness": "metalness, metallic, metal, met",
    "packed": "arm, orm, occlusion roughness metallic, ao roughness metallic, metallic roughness",
    "displacement": "displacement, disp, height, heightmap",
    "depth": "depth",
    "occlusion": "ao, ambient occlusion, ambientocclusion, occlusion, occ",
    "anisotropy": "anisotropy, anisotropy level, anisotropylevel, anisotropy strength",
    "anisotropy_angle": "anisotropy angle, anisotropyangle, anisotropy rotation, anisotropic rotation",
}
_ROLES = {phrase: role for role, phrases in _PHRASES.items() for phrase in phrases.split(", ")}
_LONGEST = max(len(phrase.split()) for phrase in _ROLES)
# If several files give the same map, the first role is used.
_CHOICES = (("normal_gl", "normal_dx", "normal"), ("displacement", "depth"))


@dataclass(frozen=True)
class MapFiles:
    """The maps of a folder by role, and why its other pictures are not used, by file name.

    Roles: albedo, one of normal_gl, normal_dx and normal (convention unknown), roughness, metalness, packed (green:
    roughness, blue: metalness), displacement or depth (dark is high), anisotropy, anisotropy_angle.
    """

    folder: Path
    files: dict[str, str]
    unused: dict[str, str]


def looks_like_maps(folder: Path) -> bool:
    """True if a folder holds two maps by name, and no list of pairs or lights that makes it a BTF."""
    if not folder.is_dir():
        return False
    names = os.listdir(folder)
    if any(name == "pairs.csv" or name.lower().endswith(".lp") for name in names):
        return False
    return len(set(_roles(names).values()) - {""}) >= 2


def recognise(folder: Path) -> MapFiles:
    """The maps of a folder. Raises `InputError` if the albedo is missing or two files have the same role."""
    try:
        names = sorted(os.listdir(folder))
    except OSError as error:
        raise InputError(f"{folder}: cannot be read ({error.strerror}): give a folder of maps") from error
    by_role: dict[str, list[str]] = {}
    unused = {}
    for name, role in _roles(names).items():
        if role in ("", "occlusion"):
            unused[name] = "shadows are cast by the renderer" if role else "not recognised"
        else:
            by_role.setdefault(role, []).append(name)
    if "albedo" not in by_role:
        seen = ", ".join(names[:12]) or "nothing"
        raise InputError(f"{folder}: no albedo among its files ({seen}): name one like albedo.png or NAME_diff.jpg")
    for role, several in by_role.items():
        if len(several) > 1:
            raise InputError(f"{folder}: {' and '.join(several)} are all {role} by name: keep one in the folder")
    files = {role: several[0] for role, several in by_role.items()}
    for choice in _CHOICES:
        for role in [role for role in choice if role in files][1:]:
            unused[files.pop(role)] = "another file gives the same map"
    if {"roughness", "metalness"} <= set(files) and "packed" in files:
        unused[files.pop("packed")] = "the folder has separate roughness and metalness"
    return MapFiles(folder, files, unused)


def _roles(names: list[str]) -> dict[str, str]:
    """The role of each picture among files; empty if its name gives none."""
    pictures = [name for name in names if name.lower().endswith(PICTURES) and not name.startswith(".")]
    # `Bricks102_1K_NormalGL` → bricks, 102, 1, k, normal, gl.
    cut = {name: re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+", Path(name).stem) for name in pictures}
    words = {name: [word.lower() for word in found] for name, found in cut.items()}
    columns = takewhile(lambda column: len(set(column)) == 1, zip(*words.values(), strict=False))
    shared = len(list(columns)) if len(words) > 1 else 0
    return {name: _role(name_words[shared:]) for name, name_words in words.items()}


def _role(words: list[str]) -> str:
    """The role of the phrase that ends last; if several do, of the longest."""
    for end in range(len(words), 0, -1):
        for start in range(max(0, end - _LONGEST), end):
            if role := _ROLES.get(" ".join(words[start:end])):
                return role
    return ""
