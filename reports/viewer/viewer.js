"use strict";
// Draws materials on a plane, a sphere or a drape. `mountViewer(root, data)` builds the controls and returns what tests
// use. data.models: {label, note, shader, exact, half, exposure}; textures are base64 of RGBA32F and RGBA16F rows.

const VERTEX = `#version 300 es
in vec3 position; in vec3 normal; in vec3 tangent; in vec2 uv;
uniform mat4 camera;
out vec3 vPosition; out vec3 vNormal; out vec3 vTangent; out vec2 vUV;
void main() {
  vPosition = position; vNormal = normal; vTangent = tangent; vUV = uv;
  gl_Position = camera * vec4(position, 1.0);
}`;

const HEAD = `#version 300 es
precision highp float;
precision highp int;
`;

const TAIL = `
in vec3 vPosition; in vec3 vNormal; in vec3 vTangent; in vec2 vUV;
uniform vec3 eye;
uniform vec4 lights[8];  // direction and strength, or position and strength where \`near\` is 1
uniform int lightCount;
uniform float near, exposure, tiling;
uniform int probing;
uniform vec3 probeWo, probeWi;
uniform vec2 probeSize;
out vec4 colour;
vec3 answer(vec2 uv, vec3 wo, vec3 wi, float footprint) {
  if (wo.z <= 0.0 || wi.z <= 0.0) return vec3(0.0);
  return max(material(uv - floor(uv), wo, wi, footprint), 0.0);
}
vec3 display(vec3 radiance) {
  vec3 x = clamp(radiance * exposure, 0.0, 1.0);
  return mix(12.92 * x, 1.055 * pow(max(x, vec3(1e-6)), vec3(1.0 / 2.4)) - 0.055, step(0.0031308, x));
}
void main() {
  if (probing == 1) {
    vec2 uv = gl_FragCoord.xy / probeSize;
    colour = vec4(display(answer(uv, probeWo, probeWi, 1.0 / max(probeSize.x, probeSize.y))), 1.0);
    return;
  }
  vec2 uv = vUV * tiling;
  float footprint = min(1.0, max(length(dFdx(uv)), length(dFdy(uv))));
  vec3 n = normalize(vNormal);
  vec3 t = normalize(vTangent - n * dot(n, vTangent));
  vec3 b = cross(n, t);
  vec3 v = normalize(eye - vPosition);
  vec3 wo = vec3(dot(v, t), dot(v, b), dot(v, n));
  vec3 sum = vec3(0.0);
  for (int i = 0; i < lightCount; i++) {
    vec3 toLight = near > 0.5 ? lights[i].xyz - vPosition : lights[i].xyz;
    float strength = near > 0.5 ? lights[i].w * 4.0 / dot(toLight, toLight) : lights[i].w;
    vec3 l = normalize(toLight);
    sum += strength * answer(uv, wo, vec3(dot(l, t), dot(l, b), dot(l, n)), footprint);
  }
  colour = vec4(display(sum), 1.0);
}`;

const SHAPES = {
  plane: (s, t) => [2 * s - 1, 2 * t - 1, 0],
  sphere: (s, t) => {
    const phi = 2 * Math.PI * (s - 0.5), theta = Math.PI * (t - 0.5);
    return [Math.cos(theta) * Math.sin(phi), Math.sin(theta), Math.cos(theta) * Math.cos(phi)];
  },
  drape: (s, t) => {
    const x = 2.2 * s - 1.1, y = 2.2 * t - 1.1;
    const radius = Math.hypot(x, y), angle = Math.atan2(y, x);
    const dome = 0.75 * Math.exp(-2.2 * radius * radius);
    const folds = 0.11 * Math.sin(7 * angle) * Math.min(1, radius * radius) * Math.exp(-0.4 * radius);
    return [x, y, dome + folds - 0.25];
  },
};
const REPEATS = { plane: [2, 2], sphere: [4, 2], drape: [2, 2] };

// A grid over s, t in [0, 1]²: position, normal, tangent and uv a vertex; derivatives by differences.
function mesh(shape, count) {
  const at = SHAPES[shape], values = [], index = [], h = 1e-4;
  const minus = (a, b) => a.map((x, i) => x - b[i]);
  for (let j = 0; j <= count; j++) {
    for (let i = 0; i <= count; i++) {
      const s = i / count, t = Math.min(0.9999, Math.max(0.0001, j / count));
      const du = minus(at(s + h, t), at(s - h, t)), dv = minus(at(s, t + h), at(s, t - h));
      const n = [du[1] * dv[2] - du[2] * dv[1], du[2] * dv[0] - du[0] * dv[2], du[0] * dv[1] - du[1] * dv[0]];
      const [nu, nv] = REPEATS[shape];
      const unit = (a) => a.map((x) => x / Math.hypot(...a));
      values.push(...at(s, t), ...unit(n), ...unit(du), s * nu, (j / count) * nv);
    }
  }
  for (let j = 0; j < count; j++) {
    for (let i = 0; i < count; i++) {
      const a = j * (count + 1) + i, b = a + count + 1;
      index.push(a, a + 1, b, a + 1, b + 1, b);
    }
  }
  return { values: new Float32Array(values), index: new Uint32Array(index) };
}

function bytes(base64) {
  const text = atob(base64), out = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) out[i] = text.charCodeAt(i);
  return out.buffer;
}

function multiply(a, b) {
  const out = new Float32Array(16);
  for (let i = 0; i < 4; i++) {
    for (let j = 0; j < 4; j++) {
      for (let k = 0; k < 4; k++) out[4 * j + i] += a[4 * k + i] * b[4 * j + k];
    }
  }
  return out;
}

function cameraMatrix(eye, aspect) {
  const scale = 2.4, near = 0.1, far = 20;
  const length = Math.hypot(...eye), z = eye.map((x) => x / length);
  let x = [z[2], 0, -z[0]];
  const wide = Math.hypot(...x) || 1;
  x = x.map((c) => c / wide);
  const y = [z[1] * x[2] - z[2] * x[1], z[2] * x[0] - z[0] * x[2], z[0] * x[1] - z[1] * x[0]];
  const view = new Float32Array([x[0], y[0], z[0], 0, x[1], y[1], z[1], 0, x[2], y[2], z[2], 0, 0, 0, -length, 1]);
  const f = aspect < 1 ? scale * aspect : scale;
  const projection = new Float32Array(16);
  projection[0] = f / aspect; projection[5] = f; projection[10] = -(far + near) / (far - near);
  projection[11] = -1; projection[14] = (-2 * far * near) / (far - near);
  return multiply(projection, view);
}

const direction = (theta, phi) => [
  Math.sin(theta) * Math.cos(phi), Math.sin(theta) * Math.sin(phi), Math.cos(theta),
];

function mountViewer(root, data) {
  const canvas = root.querySelector("canvas");
  const gl = canvas.getContext("webgl2", { antialias: true, preserveDrawingBuffer: true });
  const said = root.querySelector("[data-says]");
  if (!gl) {
    said.textContent = "This browser has no WebGL 2: the material cannot be drawn.";
    return null;
  }
  const state = {
    left: 0, right: Math.min(1, data.models.length - 1), wipe: data.models.length > 1 ? 0.5 : 1,
    shape: "sphere", light: "point", exposure: 0, tiling: 1, scale: 0.25,
    view: [0.35, -1.2], sun: [0.7, 0.9],
  };

  function texture(base64, half, unit) {
    const values = half ? new Uint16Array(bytes(base64)) : new Float32Array(bytes(base64));
    const made = gl.createTexture();
    gl.activeTexture(gl.TEXTURE0 + unit);
    gl.bindTexture(gl.TEXTURE_2D, made);
    for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, name, gl.NEAREST);
    const format = half ? [gl.RGBA16F, gl.HALF_FLOAT] : [gl.RGBA32F, gl.FLOAT];
    gl.texImage2D(gl.TEXTURE_2D, 0, format[0], data.width, values.length / 4 / data.width, 0, gl.RGBA, format[1], values);
    return made;
  }

  function compiled(model) {
    const program = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, HEAD + model.shader + TAIL]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    ["position", "normal", "tangent", "uv"].forEach((name, i) => gl.bindAttribLocation(program, i, name));
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) {
      const logs = gl.getAttachedShaders(program).map((shader) => gl.getShaderInfoLog(shader)).join(" ");
      throw new Error(`${model.label}: ${gl.getProgramInfoLog(program)} ${logs}`);
    }
    const uniforms = {};
    for (const name of ["camera", "eye", "lights", "lightCount", "near", "exposure", "tiling", "probing", "probeWo",
                        "probeWi", "probeSize", "exactTable", "halfTable"]) {
      uniforms[name] = gl.getUniformLocation(program, name);
    }
    return { program, uniforms, exact: texture(model.exact, false, 0), half: texture(model.half, true, 1) };
  }

  const drawn = new Map();  // a model is compiled when it is first looked at
  function ready(number) {
    if (!drawn.has(number)) {
      try {
        drawn.set(number, compiled(data.models[number]));
      } catch (error) {
        drawn.set(number, null);
        said.textContent = String(error.message);
      }
    }
    return drawn.get(number);
  }

  const meshes = {};
  function bound(shape) {
    if (!meshes[shape]) {
      const { values, index } = mesh(shape, shape === "plane" ? 1 : 128);
      const array = gl.createVertexArray();
      gl.bindVertexArray(array);
      gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
      gl.bufferData(gl.ARRAY_BUFFER, values, gl.STATIC_DRAW);
      [3, 3, 3, 2].forEach((size, i) => {
        gl.enableVertexAttribArray(i);
        gl.vertexAttribPointer(i, size, gl.FLOAT, false, 44, [0, 12, 24, 36][i]);
      });
      gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
      gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, index, gl.STATIC_DRAW);
      meshes[shape] = { array, count: index.length };
    }
    gl.bindVertexArray(meshes[shape].array);
    return meshes[shape].count;
  }

  function use(model, number) {
    gl.useProgram(model.program);
    gl.activeTexture(gl.TEXTURE0); gl.bindTexture(gl.TEXTURE_2D, model.exact);
    gl.activeTexture(gl.TEXTURE1); gl.bindTexture(gl.TEXTURE_2D, model.half);
    gl.uniform1i(model.uniforms.exactTable, 0);
    gl.uniform1i(model.uniforms.halfTable, 1);
    gl.uniform1f(model.uniforms.exposure, data.models[number].exposure * 2 ** state.exposure);
  }

  function lightList() {
    const sun = direction(...state.sun);
    if (state.light === "point") return [[...sun.map((x) => 3 * x), 1.2]];
    if (state.light === "sun") return [[...sun, 1]];
    const around = [];
    for (let i = 0; i < 6; i++) around.push([...direction(1.0, state.sun[1] + (i * Math.PI) / 3), i % 2 ? 0.12 : 0.25]);
    return [[...sun, 0.5], ...around];
  }

  function paint(number, from, to) {
    const model = ready(number);
    if (!model || to <= from) return;
    use(model, number);
    const u = model.uniforms, eye = direction(...state.view).map((x) => 4.2 * x), lights = lightList();
    gl.enable(gl.SCISSOR_TEST);
    gl.scissor(from, 0, to - from, canvas.height);
    gl.uniform1i(u.probing, 0);
    gl.uniformMatrix4fv(u.camera, false, cameraMatrix(eye, canvas.width / canvas.height));
    gl.uniform3fv(u.eye, eye);
    gl.uniform4fv(u.lights, new Float32Array(lights.flat()));
    gl.uniform1i(u.lightCount, lights.length);
    gl.uniform1f(u.near, state.light === "point" ? 1 : 0);
    gl.uniform1f(u.tiling, state.tiling);
    gl.drawElements(gl.TRIANGLES, bound(state.shape), gl.UNSIGNED_INT, 0);
    gl.disable(gl.SCISSOR_TEST);
  }

  function draw() {
    const started = performance.now();
    const width = Math.max(1, Math.round(canvas.clientWidth * state.scale));
    const height = Math.max(1, Math.round(canvas.clientHeight * state.scale));
    if (canvas.width !== width || canvas.height !== height) { canvas.width = width; canvas.height = height; }
    gl.viewport(0, 0, width, height);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    const middle = Math.round(width * state.wipe);
    paint(state.left, 0, middle);
    paint(state.right, middle, width);
    const pixels = new Uint8Array(4 * width * height);
    gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, pixels);  // waits for the picture
    const spent = performance.now() - started;
    let covered = 0;
    for (let i = 3; i < pixels.length; i += 4) covered += pixels[i] > 0;
    const rate = `${(1000 / Math.max(spent, 0.1)).toFixed(0)} frames a second, ${width} × ${height}`;
    if (covered && ![state.left, state.right].some((i) => drawn.get(i) === null)) {
      said.textContent = `${rate}, ${((1e6 * spent) / covered).toFixed(0)} ns a pixel (reading back included)`;
    }
    return spent;
  }

  // While something moves, the resolution holds the frame rate; at rest it is as high as a second allows.
  let waiting = 0, resting = 0;
  const fitting = (spent, budget) => Math.min(1, Math.max(0.15, state.scale * Math.sqrt(budget / Math.max(spent, 1))));
  function moved() {
    if (waiting) return;
    waiting = requestAnimationFrame(() => {
      waiting = 0;
      const spent = draw();
      clearTimeout(resting);
      const still = fitting(spent, 1000);
      if (still > 1.1 * state.scale) resting = setTimeout(() => { state.scale = still; draw(); }, 400);
      state.scale = fitting(spent, 40);
    });
  }

  function probe(number, wo, wi, width, height) {
    const model = ready(number);
    if (!model) return null;
    const target = gl.createFramebuffer(), picture = gl.createTexture();
    gl.activeTexture(gl.TEXTURE2);
    gl.bindTexture(gl.TEXTURE_2D, picture);
    gl.texStorage2D(gl.TEXTURE_2D, 1, gl.RGBA8, width, height);
    gl.bindFramebuffer(gl.FRAMEBUFFER, target);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, picture, 0);
    use(model, number);
    const u = model.uniforms;
    gl.uniform1f(u.exposure, data.models[number].exposure);
    gl.uniform1i(u.probing, 1);
    gl.uniform3fv(u.probeWo, wo);
    gl.uniform3fv(u.probeWi, wi);
    gl.uniform2f(u.probeSize, width, height);
    gl.uniformMatrix4fv(u.camera, false, new Float32Array([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]));
    gl.viewport(0, 0, width, height);
    gl.disable(gl.DEPTH_TEST);
    gl.drawElements(gl.TRIANGLES, bound("plane"), gl.UNSIGNED_INT, 0);
    const pixels = new Uint8Array(4 * width * height);
    gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.deleteFramebuffer(target);
    gl.deleteTexture(picture);
    return Array.from(pixels);
  }

  controls(root, data, state, moved);
  drags(canvas, state, moved);
  new ResizeObserver(moved).observe(canvas);
  moved();
  return { state, draw, probe, moved };
}

function controls(root, data, state, moved) {
  for (const side of ["left", "right"]) {
    const list = root.querySelector(`[name=${side}]`);
    data.models.forEach((model, i) => list.append(new Option(model.label, i)));
    list.value = state[side];
    list.addEventListener("change", () => { state[side] = Number(list.value); noted(); moved(); });
  }
  const note = root.querySelector("[data-note]");
  function noted() {
    const texts = [state.left, state.right].map((i) => data.models[i].note).filter(Boolean);
    note.textContent = [...new Set(texts)].join(" · ");
  }
  noted();
  for (const name of ["shape", "light"]) {
    const list = root.querySelector(`[name=${name}]`);
    list.value = state[name];
    list.addEventListener("change", () => { state[name] = list.value; moved(); });
  }
  for (const name of ["wipe", "exposure", "tiling"]) {
    const slider = root.querySelector(`[name=${name}]`);
    slider.value = state[name];
    slider.addEventListener("input", () => { state[name] = Number(slider.value); moved(); });
  }
}

function drags(canvas, state, moved) {
  const turn = (which, dx, dy) => {
    const [theta, phi] = state[which];
    state[which] = [Math.min(1.5, Math.max(0.001, theta + dy)), phi + dx];
    moved();
  };
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("pointerdown", (event) => canvas.setPointerCapture(event.pointerId));
  canvas.addEventListener("pointermove", (event) => {
    if (!event.buttons) return;
    const which = event.shiftKey || event.buttons === 2 ? "sun" : "view";
    turn(which, event.movementX / (which === "sun" ? 150 : -150), event.movementY / (which === "sun" ? 150 : -150));
  });
  canvas.addEventListener("keydown", (event) => {
    const steps = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, -0.1], ArrowDown: [0, 0.1] };
    if (!(event.key in steps)) return;
    event.preventDefault();
    turn(event.shiftKey ? "sun" : "view", ...steps[event.key]);
  });
}
