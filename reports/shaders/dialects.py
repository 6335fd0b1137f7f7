"""The differences between the shading languages that the generator writes."""

from dataclasses import dataclass, field

Words = dict[str, str]


@dataclass(frozen=True)
class Dialect:
    """The spelling of one language; templates are filled by `str.format`."""

    name: str
    suffix: str
    types: Words  # of "float", "int", "bool", "vec4"
    declare: str  # {type} {name} {value}
    choose: str  # {condition} {yes} {no}
    matrix: str  # {columns} (a list of four columns), {vector}
    loops: str  # a product with weights in the texture; see `Writer` for what it is filled with
    prologue: str
    uniforms: str  # the buffer of {count} vectors of weights
    signature: str
    calls: Words = field(default_factory=dict)  # functions that are named otherwise than in GLSL


GLSL = Dialect(
    "glsl",
    ".glsl",
    {"float": "float", "int": "int", "bool": "bool", "vec4": "vec4"},
    "{type} {name} = {value};",
    "({condition} ? {yes} : {no})",
    "mat4({columns}) * {vector}",
    """{vec4} {name}in[{inputs}] = {vec4}[{inputs}]({given});
{vec4} {name}out[{outputs}] = {vec4}[{outputs}]({starts});
for (int j = 0; j < {outputs}; j++) {{
  for (int i = 0; i < {inputs}; i++) {{
    int row = {first} + (j * {inputs} + i) * 4;
    {name}out[j] += {product};
  }}
}}""",
    """uniform highp sampler2D exactTable;  // RGBA32F
uniform highp sampler2D halfTable;  // RGBA16F
vec4 exactRow(int i) {{ return texelFetch(exactTable, ivec2(i % {width}, i / {width}), 0); }}
vec4 halfRow(int i) {{ return texelFetch(halfTable, ivec2(i % {width}, i / {width}), 0); }}
float exactOne(int i) {{
  vec4 row = exactRow(i / 4);
  int k = i % 4;
  return k < 2 ? (k == 0 ? row.x : row.y) : (k == 2 ? row.z : row.w);
}}
""",
    "layout(std140) uniform Weights {{ vec4 weights[{count}]; }};\n",
    "vec3 material(vec2 uv, vec3 wo, vec3 wi, float footprint)",
)

HLSL = Dialect(
    "hlsl",
    ".hlsl",
    {"float": "float", "int": "int", "bool": "bool", "vec4": "float4"},
    "{type} {name} = {value};",
    "({condition} ? {yes} : {no})",
    "mul({vector}, float4x4({columns}))",  # the rows given are the columns of the product's matrix
    """{vec4} {name}in[{inputs}] = {{{given}}};
{vec4} {name}out[{outputs}] = {{{starts}}};
for (int j = 0; j < {outputs}; j++) {{
  for (int i = 0; i < {inputs}; i++) {{
    int row = {first} + (j * {inputs} + i) * 4;
    {name}out[j] += {product};
  }}
}}""",
    """Texture2D<float4> exactTable : register(t0);  // R32G32B32A32_FLOAT
Texture2D<float4> halfTable : register(t1);  // R16G16B16A16_FLOAT
float4 exactRow(int i) {{ return exactTable.Load(int3(i % {width}, i / {width}, 0)); }}
float4 halfRow(int i) {{ return halfTable.Load(int3(i % {width}, i / {width}, 0)); }}
float exactOne(int i) {{
  float4 row = exactRow(i / 4);
  int k = i % 4;
  return k < 2 ? (k == 0 ? row.x : row.y) : (k == 2 ? row.z : row.w);
}}
""",
    "cbuffer Weights : register(b0) {{ float4 weights[{count}]; }}\n",
    "float3 material(float2 uv, float3 wo, float3 wi, float footprint)",
    {"inversesqrt": "rsqrt", "fract": "frac"},
)

WGSL = Dialect(
    "wgsl",
    ".wgsl",
    {"float": "f32", "int": "i32", "bool": "bool", "vec4": "vec4<f32>"},
    "let {name}: {type} = {value};",
    "select({no}, {yes}, {condition})",
    "mat4x4<f32>({columns}) * {vector}",
    """var {name}in = array<{vec4}, {inputs}>({given});
var {name}out = array<{vec4}, {outputs}>({starts});
for (var j: i32 = 0; j < {outputs}; j++) {{
  for (var i: i32 = 0; i < {inputs}; i++) {{
    let row = {first} + (j * {inputs} + i) * 4;
    {name}out[j] += {product};
  }}
}}""",
    """@group(0) @binding(0) var exactTable: texture_2d<f32>;  // rgba32float
@group(0) @binding(1) var halfTable: texture_2d<f32>;  // rgba16float
fn exactRow(i: i32) -> vec4<f32> {{ return textureLoad(exactTable, vec2<i32>(i % {width}, i / {width}), 0); }}
fn halfRow(i: i32) -> vec4<f32> {{ return textureLoad(halfTable, vec2<i32>(i % {width}, i / {width}), 0); }}
fn exactOne(i: i32) -> f32 {{
  let row = exactRow(i / 4);
  let k = i % 4;
  return select(select(row.w, row.z, k == 2), select(row.y, row.x, k == 0), k < 2);
}}
""",
    "@group(0) @binding(2) var<uniform> weights: array<vec4<f32>, {count}>;\n",
    "fn material(uv: vec2<f32>, wo: vec3<f32>, wi: vec3<f32>, footprint: f32) -> vec3<f32>",
    {"inversesqrt": "inverseSqrt"},
)

DIALECTS = {dialect.name: dialect for dialect in (GLSL, HLSL, WGSL)}
