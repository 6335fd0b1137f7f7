"use strict";
// Common parts of a report's scripts: its data, the ticked codecs, elements, packed texts, and the theme.
const report = (() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const hidden = new Set(), heard = [];

  function element(name, attributes = {}, ...inside) {
    const made = document.createElement(name);
    for (const [key, value] of Object.entries(attributes)) {
      if (typeof value === "function") made.addEventListener(key, value);
      else made.setAttribute(key, value);
    }
    made.append(...inside);
    return made;
  }

  function drawn(name, attributes = {}, ...inside) {
    const made = document.createElementNS("http://www.w3.org/2000/svg", name);
    for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
    made.append(...inside);
    return made;
  }

  // Outlines of Matplotlib's markers, on a square of 2 × 2 about 0.
  const round = (count, start, inner = 1) => Array.from({ length: count * (inner < 1 ? 2 : 1) }, (_, i) => {
    const radius = inner < 1 && i % 2 ? inner : 1, angle = start + (i * 2 * Math.PI) / (count * (inner < 1 ? 2 : 1));
    return [radius * Math.sin(angle), -radius * Math.cos(angle)];
  });
  const plus = [[-0.35, -1], [0.35, -1], [0.35, -0.35], [1, -0.35], [1, 0.35], [0.35, 0.35], [0.35, 1], [-0.35, 1],
    [-0.35, 0.35], [-1, 0.35], [-1, -0.35], [-0.35, -0.35]];
  const OUTLINES = {
    o: round(24, 0), s: [[-0.85, -0.85], [0.85, -0.85], [0.85, 0.85], [-0.85, 0.85]], "^": round(3, 0),
    v: round(3, Math.PI), "<": round(3, -Math.PI / 2), ">": round(3, Math.PI / 2), D: round(4, 0),
    d: round(4, 0).map(([x, y]) => [0.6 * x, y]), P: plus,
    X: plus.map(([x, y]) => [0.75 * (x - y), 0.75 * (x + y)]), p: round(5, 0), h: round(6, 0),
    "*": round(5, 0, 0.4), 8: round(8, Math.PI / 8),
  };
  const looks = new Map(data.codecs.map((codec) => [codec.label, codec]));
  const lookOf = (label) => looks.get(label) || { colour: "#888888", marker: "o", hollow: false, dash: "" };
  const colourOf = (label) => lookOf(label).colour;

  function marker(label, x, y, size) {
    const look = lookOf(label), outline = OUTLINES[look.marker] || OUTLINES.o;
    const points = outline.map(([a, b]) => `${(x + size * a).toFixed(2)},${(y + size * b).toFixed(2)}`).join(" ");
    return drawn("polygon", { points, stroke: colourOf(label), "stroke-width": 1.4,
      fill: look.hollow ? "none" : colourOf(label) });  // so that a hollow marker hides no other
  }

  function number(value, unit) {
    if (value === null || value === undefined) return "no error";
    if (unit === "B") {
      const step = value >= 1e6 ? [1e6, "MB"] : value >= 1e3 ? [1e3, "kB"] : [1, "B"];
      return `${Number((value / step[0]).toPrecision(3))} ${step[1]}`;
    }
    const text = Math.abs(value) >= 1e5 || value === 0 ? value.toLocaleString("en") :
      Number(value.toPrecision(4)).toLocaleString("en", { maximumFractionDigits: 6 });
    return unit ? `${text} ${unit}` : text;
  }

  function tick(label, shown) {
    if (shown) hidden.delete(label);
    else hidden.add(label);
  }

  function ticks(bar) {
    const boxes = data.codecs.map(({ label }) => {
      const box = element("input", { type: "checkbox", value: label, change: () => { tick(label, box.checked); tell(); } });
      box.checked = true;
      const swatch = drawn("svg", { width: 22, height: 14, "aria-hidden": "true" });
      swatch.append(drawn("line", { x1: 0, x2: 22, y1: 7, y2: 7, stroke: colourOf(label), "stroke-width": 1.4,
        "stroke-dasharray": lookOf(label).dash }), marker(label, 11, 7, 5));
      bar.querySelector(".boxes").append(element("label", {}, box, swatch, label));
      return box;
    });
    for (const button of bar.querySelectorAll("button")) {
      button.addEventListener("click", () => {
        for (const box of boxes) { box.checked = button.value === "all"; tick(box.value, box.checked); }
        tell();
      });
    }
  }

  const tell = () => heard.forEach((listener) => listener());

  function themed(button) {
    const dark = window.matchMedia("(prefers-color-scheme: dark)");
    const now = () => document.documentElement.dataset.theme || (dark.matches ? "dark" : "light");
    const say = () => { button.textContent = now() === "dark" ? "Light" : "Dark"; };
    button.addEventListener("click", () => {
      document.documentElement.dataset.theme = now() === "dark" ? "light" : "dark";
      say();
    });
    dark.addEventListener("change", say);
    say();
  }

  // Calls a function when an element first comes near the window. Its drawing must not change sizes, because a page
  // that moves while scrolling takes a button from under the pointer.
  function whenNear(root, begin) {
    const watch = new IntersectionObserver((entries) => {
      if (entries.some((entry) => entry.isIntersecting)) { watch.disconnect(); begin(); }
    }, { rootMargin: "600px" });
    watch.observe(root);
  }

  // A record opens when a link leads to it, and its text is unpacked when it opens.
  let records = null;
  async function opened(details) {
    const place = details.querySelector("pre");
    if (!details.open || place.textContent) return;
    records = records || unpacked("records-data");
    place.textContent = JSON.stringify((await records)[Number(details.dataset.record)], null, 1);
  }
  function followed() {
    const target = document.getElementById(decodeURIComponent(location.hash.slice(1)));
    for (let at = target; at; at = at.parentElement) if (at.tagName === "DETAILS") at.open = true;
    if (target) target.scrollIntoView();
  }

  ticks(document.getElementById("codecs"));
  themed(document.getElementById("theme"));
  for (const details of document.querySelectorAll("[data-record]")) details.addEventListener("toggle", () => opened(details));
  window.addEventListener("hashchange", followed);
  if (location.hash) window.addEventListener("load", followed);
  return { data, hidden, listen: (listener) => heard.push(listener), element, drawn, marker, colourOf, lookOf, number,
    unpacked, whenNear };
})();
