// Draws materials on a plane, a sphere or a drape. `mountViewer(root, data)` builds the controls and returns what tests
// use. data.models: {label, note, exposure, periods, shader, exact, half, uniforms, fallback}; tables are buffers, or
// base64, of RGBA32F and RGBA16F rows, uniforms of vec4; fallback holds the changed parts of the shader for compilers
// that cannot handle the first.

const DISTANCE = 4.2, LAMP = 3.0;  // of the camera and of the point light; shapes are about 2 wide
const PATIENCE = 20000;  // milliseconds for a compiler, where another shader is at hand

// Each light: direction or position, and strength: the irradiance of a surface that faces it; for a point light, near
// the shapes.
function lightsOf(state) {
  const sun = direction(...state.sun);
  if (state.light === "point") return [[...sun.map((x) => LAMP * x), 1]];
  if (state.light === "sun") return [[...sun, 1]];
  const around = [];
  for (let i = 0; i < 6; i++) around.push([...direction(1.0, state.sun[1] + (i * Math.PI) / 3), i % 2 ? 0.12 : 0.25]);
  return [[...sun, 0.5], ...around];
}

function bytes(base64) {
  if (base64 instanceof ArrayBuffer) return base64;
  const text = atob(base64), out = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) out[i] = text.charCodeAt(i);
  return out.buffer;
}

// The WebGL objects of the models and shapes of one canvas.
class Stage {
  constructor(gl, data) {
    Object.assign(this, { gl, data, models: new Map(), meshes: {}, target: null });
    this.parallel = gl.getExtension("KHR_parallel_shader_compile");
    this.samples = Math.min(4, gl.getParameter(gl.MAX_SAMPLES));
    [this.depth, this.display] = [linked(gl, VERTEX, DEPTH), linked(gl, SCREEN, DISPLAY)];
    this.depthAt = uniformsOf(gl, this.depth);
    this.displayAt = uniformsOf(gl, this.display);
  }

  table(base64, half, unit) {
    const { gl, data } = this, floats = base64 instanceof Float32Array;
    const values = floats ? base64 : half ? new Uint16Array(bytes(base64)) : new Float32Array(bytes(base64));
    const made = gl.createTexture(), format = half ? [gl.RGBA16F, floats ? gl.FLOAT : gl.HALF_FLOAT] : [gl.RGBA32F, gl.FLOAT];
    gl.activeTexture(gl.TEXTURE0 + unit);
    gl.bindTexture(gl.TEXTURE_2D, made);
    for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, name, gl.NEAREST);
    const rows = values.length / 4 / data.width, most = gl.getParameter(gl.MAX_TEXTURE_SIZE);
    if (rows > most) throw new Error(`its tables have ${rows} rows, and this machine's textures at most ${most}`);
    gl.texImage2D(gl.TEXTURE_2D, 0, format[0], data.width, rows, 0, gl.RGBA, format[1], values);
    return made;
  }

  // A model, compiled when it is first shown: `program` is null until then, `error` says why there is none.
  model(number, wait) {
    if (!this.models.has(number)) this.models.set(number, this.compiling(this.data.models[number]));
    const model = this.models.get(number);
    if (model.program || model.error) return model;
    const { label, fallback } = model.given, late = fallback && performance.now() - model.since > PATIENCE;
    if (!wait && !late && !this.finished(model)) return model;
    try {
      if (late && !this.finished(model)) throw new Error("its shader takes too long to compile");
      this.complete(model);
    } catch (error) {
      if (fallback) this.models.set(number, this.compiling({ ...model.given, ...fallback, fallback: null }));
      else model.error = `${label}: ${error.message}`;
      return this.model(number, wait);
    }
    return model;
  }

  compiling(given) {
    return { given, linking: linked(this.gl, VERTEX, HEAD + given.shader + LIT), since: performance.now() };
  }

  finished(model) {
    const { gl, parallel } = this;
    return !parallel || gl.getProgramParameter(model.linking, parallel.COMPLETION_STATUS_KHR);
  }

  complete(model) {
    const { gl } = this, { exact, half, uniforms } = model.given;
    model.uniforms = uniformsOf(gl, model.linking);
    [model.exact, model.half] = [this.table(exact, false, 0), this.table(half, true, 1)];
    if (bytes(uniforms).byteLength) {
      model.buffer = gl.createBuffer();
      gl.bindBuffer(gl.UNIFORM_BUFFER, model.buffer);
      gl.bufferData(gl.UNIFORM_BUFFER, bytes(uniforms), gl.STATIC_DRAW);
      gl.uniformBlockBinding(model.linking, gl.getUniformBlockIndex(model.linking, "Weights"), 0);
    }
    model.program = model.linking;
  }

  bind(shape) {
    const { gl } = this;
    if (!this.meshes[shape]) {
      const { values, index } = mesh(shape, shape === "plane" ? 1 : 64);
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
      this.meshes[shape] = { array, count: index.length };
    }
    gl.bindVertexArray(this.meshes[shape].array);
    return this.meshes[shape].count;
  }

  start(width, height) {
    const { gl } = this;
    if (!this.target || this.target.width !== width || this.target.height !== height) {
      if (this.target) this.target.remove();
      this.target = makeTarget(gl, width, height, this.samples);
    }
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.target.drawn);
    gl.viewport(0, 0, width, height);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
  }

  // The light of one model on a shape, between two columns of the picture; added to what is there, or subtracted.
  light(model, shape, lights, values, from, to, subtracted = false) {
    const { gl } = this, count = this.bind(shape);
    gl.enable(gl.SCISSOR_TEST);
    gl.scissor(from, 0, to - from, this.target.height);
    gl.enable(gl.DEPTH_TEST);
    gl.depthFunc(gl.LESS);
    gl.useProgram(this.depth);
    gl.uniformMatrix4fv(this.depthAt.camera, false, values.camera);
    gl.colorMask(false, false, false, false);
    gl.drawElements(gl.TRIANGLES, count, gl.UNSIGNED_INT, 0);
    gl.colorMask(true, true, true, true);
    gl.depthFunc(gl.EQUAL);
    gl.enable(gl.BLEND);
    gl.blendEquationSeparate(subtracted ? gl.FUNC_REVERSE_SUBTRACT : gl.FUNC_ADD, gl.FUNC_ADD);
    gl.blendFuncSeparate(gl.ONE, gl.ONE, gl.ONE, gl.ZERO);
    gl.useProgram(model.program);
    [model.exact, model.half].forEach((texture, unit) => {
      gl.activeTexture(gl.TEXTURE0 + unit);
      gl.bindTexture(gl.TEXTURE_2D, texture);
    });
    if (model.buffer) gl.bindBufferBase(gl.UNIFORM_BUFFER, 0, model.buffer);
    this.set(model.uniforms, { ...values, periods: model.given.periods });
    for (const light of lights) {
      gl.uniform4fv(model.uniforms.light, light);
      gl.drawElements(gl.TRIANGLES, count, gl.UNSIGNED_INT, 0);
    }
    [gl.BLEND, gl.DEPTH_TEST, gl.SCISSOR_TEST].forEach((each) => gl.disable(each));
  }

  set(at, { camera, periods, eye = [0, 0, 1], near = 0, tiling = 1, probing = 0, probeWo = [0, 0, 1], probeSize = [1, 1] }) {
    const { gl } = this;
    gl.uniform1i(at.exactTable, 0);
    gl.uniform1i(at.halfTable, 1);
    gl.uniform1i(at.probing, probing);
    gl.uniformMatrix4fv(at.camera, false, camera);
    gl.uniform3fv(at.eye, eye);
    gl.uniform1f(at.near, near);
    gl.uniform1f(at.tiling, tiling);
    gl.uniform2fv(at.periods, periods);
    gl.uniform3fv(at.probeWo, probeWo);
    gl.uniform2fv(at.probeSize, probeSize);
  }

  // The light as the display shows it, each part {from, to, exposure} of the picture at its exposure.
  show(parts) {
    const { gl, target } = this, { width, height } = target;
    gl.bindFramebuffer(gl.READ_FRAMEBUFFER, target.drawn);
    gl.bindFramebuffer(gl.DRAW_FRAMEBUFFER, target.read);
    gl.blitFramebuffer(0, 0, width, height, 0, 0, width, height, gl.COLOR_BUFFER_BIT, gl.NEAREST);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.viewport(0, 0, width, height);
    gl.useProgram(this.display);
    gl.activeTexture(gl.TEXTURE2);
    gl.bindTexture(gl.TEXTURE_2D, target.texture);
    gl.uniform1i(this.displayAt.radiance, 2);
    gl.enable(gl.SCISSOR_TEST);
    for (const { from, to, exposure } of parts) {
      gl.scissor(from, 0, to - from, height);
      gl.uniform1f(this.displayAt.exposure, exposure);
      gl.drawArrays(gl.TRIANGLES, 0, 3);
    }
    gl.disable(gl.SCISSOR_TEST);
  }

  pixels(width, height) {
    const found = new Uint8Array(4 * width * height);
    this.gl.readPixels(0, 0, width, height, this.gl.RGBA, this.gl.UNSIGNED_BYTE, found);
    return found;
  }
}

// The context of a canvas, or the reason why there is none.
function context(canvas) {
  const gl = canvas.getContext("webgl2", { antialias: false, preserveDrawingBuffer: true });
  if (!gl) return "This browser has no WebGL 2: the material cannot be drawn.";
  if (!gl.getExtension("EXT_color_buffer_float") && !gl.getExtension("EXT_color_buffer_half_float")) {
    return "This browser cannot draw into half floats: the material cannot be drawn.";
  }
  return gl;
}

function mountViewer(root, data) {
  const canvas = root.querySelector("canvas"), said = root.querySelector("[data-says]");
  const gl = context(canvas);
  if (typeof gl === "string") {
    said.textContent = gl;
    return null;
  }
  const stage = new Stage(gl, data);
  const state = {
    left: 0, right: Math.min(1, data.models.length - 1), wipe: data.models.length > 1 ? 0.5 : 1,
    shape: "sphere", light: "point", show: "sides", exposure: 0, tiling: 1, scale: 0.25, zoom: 1.3, drag: "view",
    view: [0.45, 0.9], sun: [0.55, 1.9],
  };

  function sides(width) {
    if (state.show === "difference") return [[state.left, 0, width], [state.right, 0, width]];
    const middle = Math.round(width * state.wipe);
    return [[state.left, 0, middle], [state.right, middle, width]].filter(([, from, to]) => to > from);
  }

  // Draws, waits for the picture and returns the milliseconds that this took; null while a shader compiles.
  function draw(wait = true) {
    const width = Math.max(1, Math.round(canvas.clientWidth * state.scale));
    const height = Math.max(1, Math.round(canvas.clientHeight * state.scale));
    const parts = sides(width).map(([number, from, to]) => ({ number, from, to, model: stage.model(number, wait) }));
    const error = parts.map(({ model }) => model.error).find(Boolean);
    if (parts.some(({ model }) => !model.program && !model.error)) {
      said.textContent = "The shader is being compiled …";
      return null;
    }
    if (canvas.width !== width || canvas.height !== height) { canvas.width = width; canvas.height = height; }
    const started = performance.now(), lights = lightsOf(state), eye = direction(...state.view).map((x) => DISTANCE * x);
    const camera = cameraMatrix(eye, width / height, state.zoom);
    const values = { camera, eye, near: state.light === "point" ? 1 : 0, tiling: state.tiling };
    stage.start(width, height);
    const differs = state.show === "difference";
    parts.forEach(({ model, from, to }, i) => {
      if (model.program) stage.light(model, state.shape, lights, values, from, to, differs && i > 0);
    });
    stage.show((differs ? parts.slice(0, 1) : parts).map((part) => ({ ...part, exposure: data.models[part.number].exposure * 2 ** state.exposure })));
    stage.pixels(1, 1);  // waits
    const spent = performance.now() - started;
    said.textContent = error || speed(spent, width, height, lights.length);
    return spent;
  }

  function speed(spent, width, height, lights) {
    const pixels = stage.pixels(width, height);
    let covered = 0;
    for (let i = 3; i < pixels.length; i += 4) covered += pixels[i] > 0;
    const each = covered ? `${((1e6 * spent) / covered).toFixed(0)} ns a pixel of ${lights} light${lights > 1 ? "s" : ""}` : "";
    const rate = `${(1000 / Math.max(spent, 0.1)).toFixed(spent > 100 ? 1 : 0)} frames/s`;
    return [rate, `${width} × ${height}`, each].filter(Boolean).join(", ");
  }

  // While something moves, the resolution holds the frame rate; at rest it is as high as a second allows.
  let waiting = 0, resting = 0, lost = false;
  const fitting = (spent, budget) => Math.min(1, Math.max(0.15, state.scale * Math.sqrt(budget / Math.max(spent, 1))));
  function moved() {
    if (waiting || lost) return;
    waiting = requestAnimationFrame(() => {
      waiting = 0;
      const spent = draw(false);
      clearTimeout(resting);
      if (spent === null) {
        resting = setTimeout(moved, 50);
        return;
      }
      const still = fitting(spent, 1000);
      if (still > 1.1 * state.scale) resting = setTimeout(() => { state.scale = still; draw(); }, 400);
      state.scale = fitting(spent, 40);
    });
  }

  // The plane as one texel a pixel, under one light, at the model's exposure; rows from the bottom.
  function probe(number, wo, wi, width, height) {
    const model = stage.model(number, true);
    if (!model.program) return null;
    const camera = new Float32Array([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]);
    [canvas.width, canvas.height] = [width, height];
    stage.start(width, height);
    const values = { camera, probing: 1, probeWo: wo, probeSize: [width, height] };
    stage.light(model, "plane", [[...wi, 1]], values, 0, width);
    stage.show([{ from: 0, to: width, exposure: data.models[number].exposure }]);
    return Array.from(stage.pixels(width, height));
  }

  canvas.addEventListener("webglcontextlost", () => {
    lost = true;
    clearTimeout(resting);
    said.textContent = "The graphics system gave up: on too many materials at once, or a long shader. Reload the page.";
  });
  controls(root, data, state, moved);
  drags(canvas, state, moved);
  new ResizeObserver(moved).observe(canvas);
  moved();
  return { state, draw, probe, moved };
}
