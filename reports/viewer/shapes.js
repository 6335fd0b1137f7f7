// The shapes that materials are shown on, and the camera.

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

function multiply(a, b) {
  const out = new Float32Array(16);
  for (let i = 0; i < 4; i++) {
    for (let j = 0; j < 4; j++) {
      for (let k = 0; k < 4; k++) out[4 * j + i] += a[4 * k + i] * b[4 * j + k];
    }
  }
  return out;
}

function cameraMatrix(eye, aspect, zoom) {
  const scale = 2.4 * zoom, near = 0.1, far = 20;
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
