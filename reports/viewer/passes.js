// Shaders around `material`: depth first, then one pass a light, added up in half floats, then the display transform.
// A loop over lights around one call of `material` had not compiled after a minute; each further call takes 2 s.

const VERTEX = `#version 300 es
in vec3 position; in vec3 normal; in vec3 tangent; in vec2 uv;
uniform mat4 camera;
out vec3 vPosition; out vec3 vNormal; out vec3 vTangent; out vec2 vUV;
invariant gl_Position;
void main() {
  vPosition = position; vNormal = normal; vTangent = tangent; vUV = uv;
  gl_Position = camera * vec4(position, 1.0);
}`;

const HEAD = `#version 300 es
precision highp float;
precision highp int;
out vec4 colour;
`;

const DEPTH = `${HEAD}void main() { colour = vec4(0.0); }`;

const LIT = `
in vec3 vPosition; in vec3 vNormal; in vec3 vTangent; in vec2 vUV;
uniform vec3 eye;
uniform vec4 light;  // direction and strength, or position and strength where \`near\` is 1
uniform float near, tiling;
uniform vec2 periods;  // of the texture along u and v, in a length of its longer side
uniform int probing;
uniform vec3 probeWo;
uniform vec2 probeSize;
void main() {
  vec2 place = vUV * tiling;  // in longer sides of the texture, as the footprint is
  vec2 uv = probing == 1 ? gl_FragCoord.xy / probeSize : place * periods;
  float footprint = min(1.0, max(length(dFdx(place)), length(dFdy(place))));
  if (probing == 1) footprint = 1.0 / max(probeSize.x, probeSize.y);
  vec3 n = normalize(vNormal);
  vec3 t = normalize(vTangent - n * dot(n, vTangent));
  mat3 frame = mat3(t, cross(n, t), n);  // of the texture: x along +u, y along +v
  vec3 wo = probing == 1 ? probeWo : normalize(eye - vPosition) * frame;
  vec3 toLight = near > 0.5 ? light.xyz - vPosition : light.xyz;
  vec3 wi = probing == 1 ? light.xyz : normalize(toLight) * frame;
  float strength = near > 0.5 ? light.w * 5.0 / dot(toLight, toLight) : light.w;
  vec3 answer = vec3(0.0);
  if (wo.z > 0.0 && wi.z > 0.0) answer = strength * max(material(uv - floor(uv), wo, wi, footprint), 0.0);
  colour = vec4(min(answer, 6e4), 1.0);
}`;

const SCREEN = `#version 300 es
void main() { gl_Position = vec4(4.0 * vec2(gl_VertexID & 1, gl_VertexID >> 1) - 1.0, 0.0, 1.0); }`;

const DISPLAY = `${HEAD}uniform sampler2D radiance;
uniform float exposure;
void main() {  // a difference may be negative
  vec4 found = texelFetch(radiance, ivec2(gl_FragCoord.xy), 0);
  vec3 x = clamp(abs(found.rgb) / max(found.a, 1e-3) * exposure, 0.0, 1.0);
  vec3 shown = mix(12.92 * x, 1.055 * pow(max(x, vec3(1e-6)), vec3(1.0 / 2.4)) - 0.055, step(0.0031308, x));
  colour = vec4(shown * found.a, found.a);  // alpha is how much of the pixel the shape covers
}`;

function linked(gl, vertex, fragment) {
  const program = gl.createProgram();
  for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    gl.attachShader(program, shader);
  }
  ["position", "normal", "tangent", "uv"].forEach((name, i) => gl.bindAttribLocation(program, i, name));
  gl.linkProgram(program);
  return program;
}

// The uniforms of a linked program by name; an error with its log if it is not linked.
function uniformsOf(gl, program) {
  if (!gl.getProgramParameter(program, gl.LINK_STATUS)) {
    const logs = gl.getAttachedShaders(program).map((shader) => gl.getShaderInfoLog(shader)).join(" ");
    throw new Error(`${gl.getProgramInfoLog(program)} ${logs}`);
  }
  const found = {};
  for (let i = 0; i < gl.getProgramParameter(program, gl.ACTIVE_UNIFORMS); i++) {
    const { name } = gl.getActiveUniform(program, i);
    found[name] = gl.getUniformLocation(program, name);
  }
  return found;
}

// A picture of half floats with depth, to be drawn into with several samples a pixel and read as a texture.
function makeTarget(gl, width, height, samples) {
  const drawn = gl.createFramebuffer(), read = gl.createFramebuffer(), texture = gl.createTexture();
  const buffers = [gl.createRenderbuffer(), gl.createRenderbuffer()];
  const formats = [[gl.RGBA16F, gl.COLOR_ATTACHMENT0], [gl.DEPTH_COMPONENT24, gl.DEPTH_ATTACHMENT]];
  gl.bindFramebuffer(gl.FRAMEBUFFER, drawn);
  formats.forEach(([format, place], i) => {
    gl.bindRenderbuffer(gl.RENDERBUFFER, buffers[i]);
    gl.renderbufferStorageMultisample(gl.RENDERBUFFER, samples, format, width, height);
    gl.framebufferRenderbuffer(gl.FRAMEBUFFER, place, gl.RENDERBUFFER, buffers[i]);
  });
  gl.activeTexture(gl.TEXTURE2);
  gl.bindTexture(gl.TEXTURE_2D, texture);
  gl.texStorage2D(gl.TEXTURE_2D, 1, gl.RGBA16F, width, height);
  for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, name, gl.NEAREST);
  gl.bindFramebuffer(gl.FRAMEBUFFER, read);
  gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, texture, 0);
  const remove = () => {
    [drawn, read].forEach((each) => gl.deleteFramebuffer(each));
    buffers.forEach((each) => gl.deleteRenderbuffer(each));
    gl.deleteTexture(texture);
  };
  return { width, height, drawn, read, texture, remove };
}
