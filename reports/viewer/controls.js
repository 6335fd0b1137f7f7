// The settings that a person changes: by lists and sliders, by dragging, by keys.

const SLIDERS = ["wipe", "exposure", "tiling", "zoom"], LISTS = ["shape", "light", "drag", "show"];
// What stands beside a slider.
const UNITS = {
  wipe: (x) => `${Math.round(100 * x)} %`, exposure: (x) => `${x < 0 ? "−" : "+"}${Math.abs(x).toFixed(1)} stops`,
  tiling: (x) => `× ${x}`, zoom: (x) => `× ${x.toFixed(1)}`,
};

function controls(root, data, state, moved) {
  const find = (name) => root.querySelector(`[name=${name}]`);
  function named() {
    const shown = [state.left, state.right].map((i) => data.models[i]);
    root.querySelector("[data-note]").textContent = [...new Set(shown.map(({ note }) => note).filter(Boolean))].join(" · ");
    ["left", "right"].forEach((side, i) => { root.querySelector(`[data-${side}]`).textContent = shown[i].label; });
    for (const name of SLIDERS) root.querySelector(`[data-of=${name}]`).textContent = UNITS[name](state[name]);
    root.style.setProperty("--wipe", state.wipe);
    root.classList.toggle("alone", data.models.length < 2);
    root.classList.toggle("difference", state.show === "difference");
  }
  for (const side of ["left", "right"]) {
    const list = find(side);
    data.models.forEach((model, i) => list.append(new Option(model.label, i)));
    list.value = state[side];
    list.addEventListener("change", () => { state[side] = Number(list.value); named(); moved(); });
  }
  for (const name of LISTS) {
    find(name).value = state[name];
    find(name).addEventListener("change", () => { state[name] = find(name).value; named(); moved(); });
  }
  for (const name of SLIDERS) {
    find(name).value = state[name];
    find(name).addEventListener("input", () => { state[name] = Number(find(name).value); named(); moved(); });
  }
  named();
  const line = root.querySelector("[data-line]"), canvas = root.querySelector("canvas");
  line.addEventListener("pointerdown", (event) => line.setPointerCapture(event.pointerId));
  line.addEventListener("pointermove", (event) => {
    if (!event.buttons) return;
    const { left, width } = canvas.getBoundingClientRect();
    find("wipe").value = state.wipe = Math.min(1, Math.max(0, (event.clientX - left) / width));
    named();
    moved();
  });
}

// One finger or the left button turns the choice of the list; two fingers, Shift or the right button turn the light.
function drags(canvas, state, moved) {
  const at = new Map();
  const turn = (which, dx, dy) => {
    const [theta, phi] = state[which];
    state[which] = [Math.min(1.5, Math.max(0.001, theta + dy)), phi + dx];
    moved();
  };
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    at.set(event.pointerId, [event.clientX, event.clientY]);
  });
  for (const name of ["pointerup", "pointercancel"]) {
    canvas.addEventListener(name, (event) => at.delete(event.pointerId));
  }
  canvas.addEventListener("pointermove", (event) => {
    if (!at.has(event.pointerId)) return;
    const [x, y] = at.get(event.pointerId), light = event.shiftKey || event.buttons === 2 || at.size > 1;
    const which = light ? "sun" : state.drag, step = which === "sun" ? 150 : -150;
    at.set(event.pointerId, [event.clientX, event.clientY]);
    turn(which, (event.clientX - x) / step / at.size, (event.clientY - y) / step / at.size);
  });
  canvas.addEventListener("keydown", (event) => {
    const steps = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, -0.1], ArrowDown: [0, 0.1] };
    if (!(event.key in steps)) return;
    event.preventDefault();
    turn(event.shiftKey ? "sun" : state.drag, ...steps[event.key]);
  });
}
