"""Writes a material as a shader for a renderer: the function, its two textures, and a page of conventions.

The texture `exact` holds 32-bit floats, `half` 16-bit ones; both are pictures of RGBA whose texels the function reads
by number. In Slang the layers of a network are a third file, the content of a buffer.
"""

from importlib.metadata import version
from pathlib import Path
from typing import NamedTuple

import numpy as np

from bench.files.atomic import begins, make_folder, refuse_other_kind, replacing, write
from bench.files.exr import write_exr
from bench.inputs.errors import InputError
from bench.program import Program
from reports.shaders.dialects import DIALECTS, GLSL, SLANG
from reports.shaders.generator import Shader, shader

README = """# {name} as {language}

`{name}.{suffix}` holds one function, `material(uv, wo, wi, footprint)`, generated from the decoded codec file.
{whole}It needs two textures:

| file | binding | format | size |
| --- | --- | --- | --- |
| `exact.exr` | `exactTable` | RGBA, 32-bit floats | {exact} |
| `half.exr` | `halfTable` | RGBA, 16-bit floats | {half} |

{buffer}Row 0 of a picture is row 0 of its texture. Texels are read one by one: use no filter, no compression, no mip
levels and no colour conversion.

- **Answer**: f_r · cos θ_i, linear Rec. 709 RGB. Multiply it by the light's irradiance on a plane that faces the
  light; add no cosine.
- **Frame**: x along +u, y along +v, z is the normal toward the eye, right-handed. `wo` points to the camera, `wi` to
  the light; both have unit length.
- **uv**: the period of the material is 1 in u and in v; it holds {width} × {height} square texels, so a unit of u is
  {aspect:.6g} times as long on the surface as one of v{stretch}. Pass `uv - floor(uv)`. v grows upwards: v = 1 is the
  top edge of the picture.
- **footprint**: the side of the square that a pixel covers; 1 is the longer side of a period, 0 is a point. A renderer
  has it from derivatives: `max(length(dFdx(uv)), length(dFdy(uv)))` for square uv. Codecs without levels of detail
  ignore it.
- **Low lights**: below the lowest light of the fit, which is named at the end of this page, no data say anything. There
  the answer is that of the lowest light at the same azimuth, times the ratio of the cosines: 0 at the horizon.
- **Your part**: answer 0 where `wo.z <= 0` or `wi.z <= 0`, and clamp the answer at 0.

## Test vectors

What the decoded file answers, as `bench.load(FILE).query(uv, wo, wi, footprint)` does. Your copy is right if it differs
by at most {tolerance:g} times the brightest of these answers, about what {rounded} of halves round.

| u, v | wo | wi | footprint | R, G, B |
| --- | --- | --- | --- | --- |
{vectors}

Made from {source}, by neubtf-bench {suite}.
"""

BUFFER = """\
It also needs the buffer `weights` (`ByteAddressBuffer`) with the {size:,} bytes of `weights.bin`: the matrices
and biases of the network's layers, as the shader describes. Layers are computed by cooperative vectors of halves.
Compile for Vulkan with `slangc -target spirv -profile spirv_1_6 -capability spvCooperativeVectorNV`; the device needs
`VK_NV_cooperative_vector`. For C++, Slang writes loops instead.

"""

TOLERANCE = 1e-3  # of the brightest answer, between a shader and the decoded file
LAYERS_TOLERANCE = 5e-3  # the same where layers are computed in halves, which round by 5e-4 at each of them
# A whole fragment shader around the function: it compiles as it is, and shows how the function is called.
FRAGMENT = """#version 300 es
precision highp float;
precision highp int;

{function}
uniform vec3 wo;
uniform vec3 wi;
uniform float footprint;
in vec2 uv;
out vec4 colour;

void main() {{
  vec3 answer = wo.z > 0.0 && wi.z > 0.0 ? material(uv - floor(uv), wo, wi, footprint) : vec3(0.0);
  colour = vec4(max(answer, 0.0), 1.0);
}}
"""


class Vectors(NamedTuple):
    """Queries and the answers of the decoded file to them, by which a copy of the shader can be checked.

    uv (n, 2), wo and wi (n, 3), above the horizon; footprint (n,); rgb (n, 3).
    """

    uv: np.ndarray
    wo: np.ndarray
    wi: np.ndarray
    footprint: np.ndarray
    rgb: np.ndarray

    def rows(self) -> str:
        """The rows of a Markdown table; nine digits determine a 32-bit float."""
        lines = []
        for query in zip(self.uv, self.wo, self.wi, self.footprint[:, None], self.rgb, strict=True):
            cells = [", ".join(f"{number:.9g}" for number in numbers) for numbers in query]
            lines.append(f"| {' | '.join(cells)} |")
        return "\n".join(lines)


def export(
    program: Program, name: str, language: str, folder: Path, source: str, vectors: Vectors
) -> tuple[list[Path], int]:
    """Write shader, textures, a buffer of layers if there are some, README and, of GLSL, a whole fragment shader into a
    folder, which is made; returns their paths, and the bytes on a GPU.

    `name` is that of the material, and of its files; `language` a key of `DIALECTS`. `source` says in words of what the
    program was made: codec, versions, file. `vectors` are answers of the material, for the README. `InputError` for
    another language, a program that no shader can do, or a folder with files of these names that are not its own.
    """
    if language not in DIALECTS:
        raise InputError(f"format {language!r}: use one of {', '.join(DIALECTS)}")
    code = shader(program, DIALECTS[language])
    make_folder(folder)
    readme = folder / "README.md"
    function = folder / f"{name}.{language}"
    exact = folder / "exact.exr"
    half = folder / "half.exr"
    # The README of a project, or of another shader, whose textures would be replaced.
    refuse_other_kind(readme, "", begins(f"# {name} as {_title(language)}\n".encode()))
    if not readme.exists():
        for path in (exact, half, folder / "weights.bin"):
            refuse_other_kind(path, "", lambda _: False)
    files = [function, exact, half, readme]
    write(function, code.text.encode())
    for path, array in ((exact, code.exact), (half, code.half)):
        with replacing(path) as partial:
            write_exr(partial, array)
    write(readme, _readme(program, code, name, language, source, vectors).encode())
    if code.layers.size:
        weights = folder / "weights.bin"
        write(weights, code.layers.astype("<f2").tobytes())
        files.append(weights)
    if language == GLSL.name:  # the fragment shader is written in GLSL alone
        whole = folder / f"{name}.frag"
        write(whole, FRAGMENT.format(function=code.text).encode())
        files.append(whole)
    return files, code.gpu_bytes


def _title(language: str) -> str:
    """The name of a language as a README writes it."""
    return "Slang" if language == SLANG.name else language.upper()


def _readme(program: Program, code: Shader, name: str, language: str, source: str, vectors: Vectors) -> str:
    """The page of conventions that lies beside a shader, in Markdown."""
    # Width × height in words, of textures (height, width, 4).
    sizes = {"exact": "{1} × {0}".format(*code.exact.shape), "half": "{1} × {0}".format(*code.half.shape)}
    height, width = program.size
    across, up = program.periods  # how often the material repeats along u and v in a square of its longer side
    stretch = "" if height == width else f": for a surface with square uv, pass ({across:g} u, {up:g} v)"
    texture = {"width": width, "height": height, "aspect": width / height, "stretch": stretch}
    whole = ""
    if language == GLSL.name:
        whole = f"`{name}.frag` is a whole fragment shader around it, GLSL ES 3.00: uniforms `wo`, `wi`, `footprint`, "
        whole += "input `uv`, output `colour`.\n"
    words = {"name": name, "language": _title(language), "suffix": language, "whole": whole, "source": source}
    checks = {"vectors": vectors.rows(), "tolerance": TOLERANCE, "rounded": "textures", "buffer": ""}
    if code.layers.size:
        buffer = BUFFER.format(size=code.layers.nbytes)
        checks |= {"tolerance": LAYERS_TOLERANCE, "rounded": "layers", "buffer": buffer}
    return README.format(**words, **sizes, **texture, **checks, suite=version("neubtf-bench"))
