"""Assigns the files of a folder to maps, by the names of ambientCG, Poly Haven, glTF, Substance, Unity and Unreal.

What a file is for is called its role: `albedo`, `roughness`, `packed` (see `MapFiles`). A file's name is cut into words
at separators and capitals. Words with which all names begin (the asset's name) are left out. The last phrase that the
vocabulary knows decides: `rusty_metal_02_nor_gl_1k` is a normal map. Where no phrase is known a last letter decides, as
in `T_Rock_N`.
"""

import filecmp
import os
import re
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from bench.data.readers.files import FolderFiles
from bench.data.readers.folder import LIST
from bench.data.readers.pictures import SUPPORTED, picture_format
from bench.inputs.errors import InputError

PICTURES = (".png", ".jpg", ".jpeg", ".exr", ".hdr", ".tif", ".tiff", ".tga", ".bmp", ".webp")
_PHRASES = {
    "albedo": "albedo, base color, base colour, basecolor, basecolour, bc, color, colour, col, diffuse, diff",
    "normal_gl": "normal gl, normal open gl, normal opengl, normal ogl, nor gl, norm gl, nrm gl",
    "normal_dx": "normal dx, normal direct x, normal directx, nor dx, norm dx, nrm dx",
    "normal": "normal, normals, nor, norm, nrm",
    "roughness": "roughness, rough, rgh",
    "metalness": "metalness, metallic, metal, met",
    "packed": "arm, orm",
    "smoothness": "smoothness, glossiness, gloss",
    "metallic_smoothness": "metallic smoothness, metalness smoothness, metallic glossiness",
    "specular": "specular, specular smoothness, specular glossiness, specular gloss",
    "displacement": "displacement, disp, height, heightmap",
    "depth": "depth",
    "occlusion": "ao, ambient occlusion, ambientocclusion, occlusion, occ",
    "anisotropy": "anisotropy, anisotropy level, anisotropylevel, anisotropy strength",
    "anisotropy_angle": "anisotropy angle, anisotropyangle, anisotropy rotation, anisotropic rotation",
}
_ROLES: dict[str, str] = {}
for _role_of_phrases, _phrases in _PHRASES.items():
    _ROLES |= dict.fromkeys(_phrases.split(", "), _role_of_phrases)
# glTF's packed map is named by its channels in either order, at times with the occlusion in red.
for _metal in ("metallic", "metalness", "metal"):
    for _pair in (f"roughness {_metal}", f"{_metal} roughness"):
        _ROLES |= {_pair: "packed", f"occlusion {_pair}": "packed", f"ao {_pair}": "packed"}
# Packages for both workflows hold a base colour and a diffuse colour, which is black where there is metal.
_BASE_COLOUR = re.compile(r"\b(base ?colou?r|bc)\b")
_LETTERS = {"d": "albedo", "n": "normal", "r": "roughness", "m": "metalness", "h": "displacement", "o": "occlusion"}
_LETTERS |= {"s": "specular", "e": ""}  # Unreal; e is the emission
_LONGEST = max(len(phrase.split()) for phrase in _ROLES)
# Roles that give the same map. If a folder has files of several of them, that of the first role is used.
_CHOICES = (("normal_gl", "normal_dx", "normal"), ("displacement", "depth"), ("roughness", "smoothness"))
_SAME_MAP = "another file gives the same map"
_UNREAD = f"only {SUPPORTED}"
# Why a picture is not used although its name is known.
_NOT_USED = {"": "not recognised", "occlusion": "shadows are cast by the renderer"}
_NOT_USED |= {"specular": "the specular workflow is not read, give a metalness map"}
# Roles of unused pictures that may be a map that the bake needs; an occlusion is none.
_DOUBTFUL = ("", "specular")


@dataclass(frozen=True)
class MapFiles:
    """The maps of a folder, and what becomes of its other pictures.

    Roles: albedo, one of normal_gl, normal_dx and normal (convention unknown), roughness or smoothness, metalness,
    packed (green: roughness, blue: metalness), metallic_smoothness (red: metalness, alpha: smoothness), displacement or
    depth (dark is high), anisotropy, anisotropy_angle.
    """

    folder: Path
    files: dict[str, str]  # role → file: its name in the folder, or an absolute path
    unused: dict[str, str]  # name of a picture that is not used → why, in words
    doubtful: tuple[str, ...] = ()  # names of unused pictures that may be maps nevertheless, for a warning


def looks_like_maps(folder: Path) -> bool:
    """True if a folder holds an albedo or two other maps by name, and no list of pairs or lights (a BTF)."""
    if not folder.is_dir():
        return False
    names = os.listdir(folder)
    if any(map(_is_list, names)):
        return False
    roles = set(_roles(names).values()) - {""}  # pictures without a role are no maps
    return "albedo" in roles or len(roles) >= 2


def _is_list(name: str) -> bool:
    """Whether a file is a list of pairs or lights by its name, which makes a folder of pictures a BTF."""
    return name.lower() == LIST or (name.lower().endswith(".lp") and not name.startswith("."))


def inner_maps(folder: Path) -> list[Path]:
    """The folders in a folder that look like maps; packages often keep them in one, like `textures`."""
    folders = []
    for inner in sorted(folder.iterdir()):
        with suppress(OSError):  # one that may not be listed
            if looks_like_maps(inner):
                folders.append(inner)
    return folders


def no_albedo_fault(folder: Path) -> str:
    """Why the files of a folder are not maps, and the remedy; a folder of pictures may also be meant as a BTF.

    The message lists the first dozen of its files, or up to three folders in it that hold maps.
    """
    inner = inner_maps(folder)
    if inner:
        which = "that folder" if len(inner) == 1 else "one of these folders"
        return f"the maps lie in {' and '.join(map(str, inner[:3]))}: give {which}"
    names = os.listdir(folder)
    listed = ", ".join(sorted(names)[:12]) or "nothing"
    remedy = "name one like albedo.png or NAME_diff.jpg, or give bake --map albedo=FILE"
    return f"no albedo among its files ({listed}): {remedy}; a BTF in pictures needs pairs.csv"


def has_pictures(names: list[str]) -> bool:
    """Whether some of these files are pictures that could be maps, under whatever names; hidden files do not count."""
    return any(name.lower().endswith(PICTURES) and not name.startswith(".") for name in names)


def recognise(folder: Path, user_files: dict[str, str] | None = None) -> MapFiles:
    """The maps of a folder; `user_files` (role → file) are those that the user names, in the folder or by their path.

    Raises `InputError` if the folder cannot be read or is a BTF, if a file that the user names is not there, if the
    albedo is missing, or if two files of one role differ, neither of which goes before the other.
    """
    try:
        names = sorted(os.listdir(folder))
    except OSError as error:
        raise InputError(f"{folder}: cannot be read ({error.strerror}): give a folder of maps") from error
    lists = list(filter(_is_list, names))
    if lists:
        raise InputError(f"{folder}: it holds {lists[0]}, so it is a BTF and needs no bake: give it to run --material")
    # The files that the user names go before those that are recognised.
    by_user = {role: _user_file(folder, role, file) for role, file in (user_files or {}).items()}
    # Each other picture has a role by its name, or a reason why it is not used.
    role_of = {name: role for name, role in _roles(names).items() if name not in by_user.values()}
    by_name: dict[str, list[str]] = {}  # role → files in the folder with such a name
    unused = {}
    for name, role in role_of.items():
        if role in _NOT_USED:
            unused[name] = _NOT_USED[role]
        elif role in by_user:
            unused[name] = _SAME_MAP
        else:
            by_name.setdefault(role, []).append(name)
    doubtful = tuple(name for name, role in role_of.items() if role in _DOUBTFUL)
    if "albedo" not in by_name | by_user:
        raise InputError(f"{folder}: {no_albedo_fault(folder)}")
    has_metalness = bool({"metalness", "packed", "metallic_smoothness"} & {*by_name, *by_user})
    files = {}
    for role, several in by_name.items():
        files[role], others = _one_file(folder, role, several, has_metalness)
        unused |= others
    files |= by_user
    for role, why in _second_choices(files, by_user).items():
        unused[files.pop(role)] = why
    return MapFiles(folder, files, unused, doubtful)


def _one_file(folder: Path, role: str, several: list[str], has_metalness: bool) -> tuple[str, dict[str, str]]:
    """The file of a role, of several in a folder, and why each other one is not used (file → words).

    A base colour goes before other albedos where there is metalness, and a file that can be read before others.
    `InputError` if those that are left differ.
    """
    unused: dict[str, str] = {}
    if role == "albedo" and has_metalness:
        several, others = _preferred(several, _is_base_colour)
        unused |= dict.fromkeys(others, "the base colour is taken, because there is metalness")
    files = FolderFiles(folder)
    several, others = _preferred(several, lambda name: bool(picture_format(files.head(name, 8))))
    unused |= dict.fromkeys(others, _UNREAD)
    return several[0], unused | _equal_files(folder, role, several)


def _equal_files(folder: Path, role: str, several: list[str]) -> dict[str, str]:
    """All files of a role but the first (file → why it is not used); `InputError` unless they equal the first."""
    first, *others = several
    if not all(filecmp.cmp(folder / first, folder / other, shallow=False) for other in others):
        remedy = f"keep one in the folder, or give bake --map {role}=FILE"
        raise InputError(f"{folder}: {' and '.join(several)} are all {role} by name: {remedy}")
    return dict.fromkeys(others, f"the same file as {first}")


def _preferred(several: list[str], is_better: Callable[[str], bool]) -> tuple[list[str], list[str]]:
    """Those of several files of a role that are better, and the others; all, and no others, if none is better."""
    better = [name for name in several if is_better(name)] if len(several) > 1 else []
    if not better:
        return several, []
    return better, [name for name in several if name not in better]


def _is_base_colour(name: str) -> bool:
    """Whether a file is called a base colour."""
    return bool(_BASE_COLOUR.search(" ".join(_words(name))))


def _second_choices(files: dict[str, str], by_user: dict[str, str]) -> dict[str, str]:
    """The roles in `files` (role → file) whose map a better file gives, each with the reason in words.

    `by_user` (role → file) are the files that the user names.
    """
    reasons: dict[str, str] = {}
    for choice in _CHOICES:
        roles = [role for role in choice if role in files]
        # The user's file comes first, and then the order of the choice, which sorting keeps among equals.
        roles.sort(key=lambda role: role not in by_user)
        reasons |= dict.fromkeys(roles[1:], _SAME_MAP)
    packed = [role for role in ("packed", "metallic_smoothness") if role in files]  # each holds both maps
    packed.sort(key=lambda role: role not in by_user)
    separate = [role for role in ("metalness", "roughness", "smoothness") if role in files]
    if packed and packed[0] in by_user:
        recognised = [role for role in (*separate, *packed[1:]) if role not in by_user]
        return reasons | dict.fromkeys(recognised, _SAME_MAP)
    if "metalness" in separate and len(separate) > 1:
        return reasons | dict.fromkeys(packed, "the folder has separate roughness and metalness")
    return reasons | dict.fromkeys(packed[1:], _SAME_MAP)


def _user_file(folder: Path, role: str, file: str) -> str:
    """A file that the user names for a role by `--map ROLE=FILE`: its name in the folder, or its absolute path
    elsewhere. `InputError` if there is no such role or file.

    `file` may be a name in the folder, or any path, also that of a file in the folder.
    """
    roles = sorted(set(_ROLES.values()) - set(_NOT_USED))
    if role not in roles:
        raise InputError(f"--map {role}={file}: there is no map {role!r}: give one of {', '.join(roles)}")
    is_name = (folder / file).is_file()
    path = folder / file if is_name else Path(file).absolute()
    if not path.is_file():
        raise InputError(f"--map {role}={file}: there is no such file, nor in {folder}: check the path")
    if path.parent.resolve() == folder.resolve():
        return path.name  # under which `recognise` finds it, too
    return file if is_name else str(path)


def _roles(names: list[str]) -> dict[str, str]:
    """The role of each picture among the files of a folder (name → role); "" if the name gives none.

    Files that are no pictures are left out.
    """
    words_of = {name: _words(name) for name in names if has_pictures([name])}
    # The asset's name is what the maps share; a preview or another stray picture does not hide it.
    maps = [words for words in words_of.values() if _role_of_phrase(words) or _last_letter(words)]
    if len(maps) > 1:  # of a single name, all words would be shared
        asset = _shared_start(maps)
        words_of = {name: _without_start(words, asset) for name, words in words_of.items()}
    # Last letters mean roles only if each of them is known: pictures a, b, c are numbered, not named.
    last_letters = {_last_letter(words) for words in words_of.values() if not _role_of_phrase(words)}
    letters_are_roles = last_letters <= {"", *_LETTERS}
    roles = {}
    for name, words in words_of.items():
        role = _role_of_phrase(words)
        if not role and letters_are_roles:
            role = _LETTERS.get(_last_letter(words), "")
        roles[name] = role
    return roles


def _words(name: str) -> list[str]:
    """The words of a file's name: `Bricks102_1K_NormalGL` → bricks, 102, 1, k, normal, gl."""
    # Capitals up to the one that begins a word (in GLNormal: GL), a word with or without a capital, or digits.
    words = re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+", Path(name).stem)
    return [word.lower() for word in words]


def _shared_start(names: list[list[str]]) -> list[str]:
    """The words with which all names, each a list of words, begin."""
    shared = []
    # The first words of all names, then the second ones, up to the end of the shortest name.
    for words in zip(*names, strict=False):
        if len(set(words)) > 1:
            break
        shared.append(words[0])
    return shared


def _without_start(words: list[str], start: list[str]) -> list[str]:
    """The words of a name without `start`, if it begins with these words."""
    return words[len(start) :] if words[: len(start)] == start else words


def _last_letter(words: list[str]) -> str:
    """The last word of a name, before a size, if it is a single letter, as the n of `rock_n_2k`; else ""."""
    end = len(words)
    while end and (words[end - 1].isdigit() or words[end - 1] == "k"):
        end -= 1
    if end and len(words[end - 1]) == 1:
        return words[end - 1]
    return ""


def _role_of_phrase(words: list[str]) -> str:
    """The role of the phrase in a name that ends last; if several end there, of the longest. "" without a phrase."""
    for end in range(len(words), 0, -1):
        # From the earliest start on, so that the longest phrase is found first.
        for start in range(max(0, end - _LONGEST), end):
            phrase = " ".join(words[start:end])
            if phrase in _ROLES:
                return _ROLES[phrase]
    return ""
