"""The differences between the shading languages that the generator writes: GLSL, HLSL, WGSL and Slang.

A dialect holds templates for `str.format`: {name} is filled in, and {{ stands for a brace of the shader. Every dialect
reads the two textures of constants by the same three functions: `exactRow(i)` and `halfRow(i)` return the four floats
of texel i, `exactOne(i)` returns float i. The textures have {width} texels a row.
"""

import re
from dataclasses import dataclass, field, replace

Words = dict[str, str]


@dataclass(frozen=True)
class Dialect:
    """The spelling of one language. The defaults are those of C."""

    name: str  # also the suffix of a file
    vec4: str  # the type of a vector of four floats
    matrix: str  # the product of a 4 × 4 matrix, by {columns} (its four columns, with commas), and {vector}
    array: str  # declares an array {name} of {count} vectors of four, with {values}
    prologue: str  # declares both textures, and the functions that read them; {width}
    uniforms: str  # declares `weights`, a buffer of {count} vectors of four
    signature: str  # of the function `material`
    types: Words = field(default_factory=lambda: {"float": "float", "int": "int", "bool": "bool"})
    declare: str = "{type} {name} = {value};"  # a constant
    choose: str = "({condition} ? {yes} : {no})"
    counter: str = "int {0}"  # declares the counter of a loop
    row: str = "int row"  # declares the number of a row of a texture
    calls: Words = field(default_factory=dict)  # by their names in GLSL: functions that have another name here

    def type(self, kind: str) -> str:
        """The name of a "float", "int", "bool" or "vec4"."""
        return self.vec4 if kind == "vec4" else self.types[kind]

    def loops(self, name: str, first: int, product: str, inputs: list[str], outputs: list[str]) -> list[str]:
        """Lines of code of a matrix times a vector, with the weights in the texture from row `first` on.

        `inputs` are the vectors of four that the array `NAMEin` begins with, and `outputs` those of `NAMEout`, to which
        products are added. `product` is the text of one: a block of 4 × 4 weights at `row`, times `NAMEin[i]`.
        """
        return [
            self.array.format(name=f"{name}in", count=len(inputs), values=", ".join(inputs)),
            self.array.format(name=f"{name}out", count=len(outputs), values=", ".join(outputs)),
            f"for ({self.counter.format('j')} = 0; j < {len(outputs)}; j++) {{",
            f"  for ({self.counter.format('i')} = 0; i < {len(inputs)}; i++) {{",
            f"    {self.row} = {first} + (j * {len(inputs)} + i) * 4;",
            f"    {name}out[j] += {product};",
            "  }",
            "}",
        ]


# Of GLSL and HLSL: %s is their vector of four floats, %% the remainder. Channels are chosen by ?:, not by a number.
_EXACT_ONE = """float exactOne(int i) {{
  %s row = exactRow(i / 4);
  int k = i %% 4;
  return k < 2 ? (k == 0 ? row.x : row.y) : (k == 2 ? row.z : row.w);
}}
"""

GLSL = Dialect(
    name="glsl",
    vec4="vec4",
    matrix="mat4({columns}) * {vector}",
    array="vec4 {name}[{count}] = vec4[{count}]({values});",
    prologue="""uniform highp sampler2D exactTable;  // RGBA32F
uniform highp sampler2D halfTable;  // RGBA16F
vec4 exactRow(int i) {{ return texelFetch(exactTable, ivec2(i % {width}, i / {width}), 0); }}
vec4 halfRow(int i) {{ return texelFetch(halfTable, ivec2(i % {width}, i / {width}), 0); }}
"""
    + _EXACT_ONE % "vec4",
    uniforms="layout(std140) uniform Weights {{ vec4 weights[{count}]; }};\n",
    signature="vec3 material(vec2 uv, vec3 wo, vec3 wi, float footprint)",
)

HLSL = Dialect(
    name="hlsl",
    vec4="float4",
    matrix="mul({vector}, float4x4({columns}))",  # the given rows are the columns of the matrix
    array="float4 {name}[{count}] = {{{values}}};",
    prologue="""Texture2D<float4> exactTable : register(t0);  // R32G32B32A32_FLOAT
Texture2D<float4> halfTable : register(t1);  // R16G16B16A16_FLOAT
float4 exactRow(int i) {{ return exactTable.Load(int3(i % {width}, i / {width}, 0)); }}
float4 halfRow(int i) {{ return halfTable.Load(int3(i % {width}, i / {width}, 0)); }}
"""
    + _EXACT_ONE % "float4",
    uniforms="cbuffer Weights : register(b0) {{ float4 weights[{count}]; }}\n",
    signature="float3 material(float2 uv, float3 wo, float3 wi, float footprint)",
    calls={"inversesqrt": "rsqrt"},
)

WGSL = Dialect(
    name="wgsl",
    vec4="vec4<f32>",
    matrix="mat4x4<f32>({columns}) * {vector}",
    array="var {name} = array<vec4<f32>, {count}>({values});",
    prologue="""@group(0) @binding(0) var exactTable: texture_2d<f32>;  // rgba32float
@group(0) @binding(1) var halfTable: texture_2d<f32>;  // rgba16float
fn exactRow(i: i32) -> vec4<f32> {{ return textureLoad(exactTable, vec2<i32>(i % {width}, i / {width}), 0); }}
fn halfRow(i: i32) -> vec4<f32> {{ return textureLoad(halfTable, vec2<i32>(i % {width}, i / {width}), 0); }}
fn exactOne(i: i32) -> f32 {{
  let row = exactRow(i / 4);
  let k = i % 4;
  return select(select(row.w, row.z, k == 2), select(row.y, row.x, k == 0), k < 2);
}}
""",
    uniforms="@group(0) @binding(2) var<uniform> weights: array<vec4<f32>, {count}>;\n",
    signature="fn material(uv: vec2<f32>, wo: vec3<f32>, wi: vec3<f32>, footprint: f32) -> vec3<f32>",
    types={"float": "f32", "int": "i32", "bool": "bool"},
    declare="let {name}: {type} = {value};",
    choose="select({no}, {yes}, {condition})",
    counter="var {0}: i32",
    row="let row",
    calls={"inversesqrt": "inverseSqrt"},
)

# Slang reads HLSL. `register` binds for Direct3D; for Vulkan, Slang asks for `vk::binding`.
BOUND = re.sub(r"(Texture2D.* register\(t(\d)\))", r"[[vk::binding(\2)]] \1", HLSL.prologue)
SLANG = replace(HLSL, name="slang", prologue=BOUND)

DIALECTS = {dialect.name: dialect for dialect in (GLSL, HLSL, WGSL, SLANG)}
