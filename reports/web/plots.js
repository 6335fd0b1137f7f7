"use strict";
// Plots as SVG: points, lines and steps; the nearest point is told by pointer or arrow keys.
(() => {
  const { data, hidden, drawn, element, marker, colourOf, lookOf, number } = report;
  const LEFT = 46, RIGHT = 12, TOP = 10, BOTTOM = 44, HEIGHT = 300, BINS = 24;

  function linear(low, high) {
    const step = [1, 2, 2.5, 5, 10].map((m) => m * 10 ** Math.floor(Math.log10((high - low) / 5)))
      .find((s) => (high - low) / s <= 7);
    const found = [];
    for (let i = Math.ceil(low / step); i * step <= high + 1e-9; i++) found.push(Number((i * step).toPrecision(6)));
    return found;
  }

  function logarithmic(low, high) {
    const wanted = high / low > 1e4 ? [1] : high / low > 50 ? [1, 3] : high / low > 10 ? [1, 2, 5] : [1, 1.5, 2, 3, 4, 5, 6, 8];
    const found = [];
    for (let e = Math.floor(Math.log10(low)); e <= Math.log10(high); e++) {
      for (const m of wanted) if (m * 10 ** e >= low && m * 10 ** e <= high) found.push(m * 10 ** e);
    }
    return found;
  }

  // A histogram's series as steps, over bins that all series share.
  function binned(plot) {
    const all = plot.series.flatMap((each) => each.samples);
    const low = Math.floor(Math.min(...all)), width = Math.max(0.5, Math.ceil((Math.max(...all) - low + 0.1) / BINS));
    return plot.series.map(({ label, samples }) => {
      const counts = new Map();
      for (const sample of samples) {
        const bin = Math.floor((sample - low) / width);
        counts.set(bin, (counts.get(bin) || 0) + 1);
      }
      const bins = [...counts.keys()], points = [];
      for (let bin = Math.min(...bins) - 1; bin <= Math.max(...bins) + 1; bin++) {
        points.push([low + (bin + 0.5) * width, counts.get(bin) || 0]);
      }
      return { label, points, step: width };
    });
  }

  function range(values, log) {
    let low = Math.min(...values), high = Math.max(...values);
    if (log) { const by = Math.max(high > low ? 1.08 : 2, (high / low) ** 0.06); return [low / by, high * by]; }
    const by = Math.max(0.5, 0.07 * (high - low));
    return [low - by, high + by];
  }

  function scale([low, high], from, to, log) {
    const f = log ? Math.log : (x) => x;
    return (x) => from + ((f(x) - f(low)) / (f(high) - f(low))) * (to - from);
  }

  class Plot {
    constructor(root, plot) {
      this.root = root;
      this.plot = plot;
      this.points = [];
      this.series = plot.kind === "slices" ? binned(plot) : plot.series;
      this.svg = drawn("svg", { height: HEIGHT, tabindex: 0, role: "img",
        "aria-label": `${plot.title} ${plot.material}. Arrow keys move from point to point.` });
      this.tip = element("p", { class: "tip", role: "status", hidden: "" });
      root.append(element("h4", {}, plot.title), this.svg, this.tip);
      if (plot.missing.length) {
        const names = plot.missing.length > 6 ? `${plot.missing.slice(0, 6).join(", ")} and ${plot.missing.length - 6} more`
          : plot.missing.join(", ");
        root.append(element("p", { class: "notes" }, `Not drawn, without such a number or without any error: ${names}.`));
      }
      this.svg.addEventListener("pointermove", (event) => this.near(event));
      this.svg.addEventListener("pointerleave", () => this.show(null));
      this.svg.addEventListener("blur", () => this.show(null));
      this.svg.addEventListener("keydown", (event) => this.key(event));
    }

    begin() {
      report.listen(() => this.draw());
      new ResizeObserver(() => this.draw()).observe(this.root);
      this.draw();
    }

    draw() {
      const width = this.root.clientWidth;
      if (!width) return;
      const shown = this.series.filter((each) => !hidden.has(each.label)), { x, y } = this.plot;
      this.svg.replaceChildren();
      this.svg.setAttribute("viewBox", `0 0 ${width} ${HEIGHT}`);
      this.points = [];
      this.active = null;
      this.show(null);
      if (!shown.length) return;
      const all = shown.flatMap((each) => each.points);
      const xs = range(all.flatMap((p) => (p.length > 2 ? [p[0], p[2], p[3]] : [p[0]])), x.log);
      const ys = range(all.map((p) => p[1]), false);
      if (this.plot.kind === "slices") ys[0] = 0;
      const h = scale(xs, LEFT, width - RIGHT, x.log), v = scale(ys, HEIGHT - BOTTOM, TOP, false);
      this.axes(width, xs, ys, h, v);
      this.ladders(shown, h, v);
      for (const each of shown) this.one(each, h, v);
      this.ring = drawn("circle", { r: 9, fill: "none", stroke: "var(--ink)", "stroke-width": 1.5, visibility: "hidden" });
      this.svg.append(this.ring);
    }

    axes(width, xs, ys, h, v) {
      const text = (at, words, more) => this.svg.append(drawn("text", { ...at, ...more }, words));
      let marks = this.plot.x.ticks || (this.plot.x.log ? logarithmic(...xs) : linear(...xs));
      while (marks.length > width / 60) marks = marks.filter((_, i) => i % 2 === 0);
      for (const mark of marks) {
        this.svg.append(drawn("line", { x1: h(mark), x2: h(mark), y1: TOP, y2: HEIGHT - BOTTOM, class: "grid" }));
        text({ x: h(mark), y: HEIGHT - BOTTOM + 15 }, number(mark, this.plot.x.unit === "B" ? "B" : ""), { "text-anchor": "middle" });
      }
      for (const mark of linear(...ys)) {
        this.svg.append(drawn("line", { x1: LEFT, x2: width - RIGHT, y1: v(mark), y2: v(mark), class: "grid" }));
        text({ x: LEFT - 6, y: v(mark) + 4 }, number(mark, ""), { "text-anchor": "end" });
      }
      text({ x: (LEFT + width - RIGHT) / 2, y: HEIGHT - 8 }, this.plot.x.label, { "text-anchor": "middle" });
      const middle = (TOP + HEIGHT - BOTTOM) / 2;
      text({ x: 11, y: middle }, this.plot.y.label, { "text-anchor": "middle", transform: `rotate(-90 11 ${middle})` });
    }

    // Lines that join the points of a ladder of rates.
    ladders(shown, h, v) {
      const groups = new Map();
      for (const each of shown) if (each.curve) groups.set(each.curve, [...(groups.get(each.curve) || []), each]);
      for (const group of groups.values()) {
        const points = group.map((each) => each.points[0]).sort((a, b) => a[0] - b[0]);
        this.line(group[0].label, points.map(([a, b]) => `${h(a)},${v(b)}`));
      }
    }

    line(label, points) {
      this.svg.append(drawn("polyline", { points: points.join(" "), fill: "none", stroke: colourOf(label),
        "stroke-width": 1.4, "stroke-dasharray": lookOf(label).dash }));
    }

    one(each, h, v) {
      const { label, points } = each;
      if (each.step) {
        const half = each.step / 2;
        this.line(label, points.flatMap(([a, b]) => [`${h(a - half)},${v(b)}`, `${h(a + half)},${v(b)}`]));
      } else if (each.line) this.line(label, points.map(([a, b]) => `${h(a)},${v(b)}`));
      for (const point of points) {
        const [a, b, low, high] = point, at = { label, x: h(a), y: v(b), point };
        if (high > low) {
          this.svg.append(drawn("line", { x1: h(low), x2: h(high), y1: at.y, y2: at.y, stroke: colourOf(label) }));
        }
        const highest = each.step && b === Math.max(...points.map((p) => p[1]));
        if (!each.step || highest) this.svg.append(marker(label, at.x, at.y, this.plot.kind === "fits" ? 2.6 : 5.5));
        this.points.push(at);
      }
    }

    near(event) {
      const box = this.svg.getBoundingClientRect(), x = event.clientX - box.left, y = event.clientY - box.top;
      const away = (at) => Math.hypot(at.x - x, at.y - y);
      const best = this.points.reduce((one, other) => (!one || away(other) < away(one) ? other : one), null);
      this.show(best && away(best) < 40 ? best : null);
    }

    key(event) {
      const step = { ArrowRight: 1, ArrowLeft: -1, ArrowDown: 1, ArrowUp: -1 }[event.key];
      if (!step || !this.points.length) return;
      event.preventDefault();
      let at = this.points.indexOf(this.active), from = this.active && this.active.label;
      do {
        at = (at + step + this.points.length) % this.points.length;
      } while (/Up|Down/.test(event.key) && this.points[at].label === from && this.points.some((p) => p.label !== from));
      this.show(this.points[at]);
    }

    show(at) {
      this.active = at;
      this.tip.hidden = !at;
      if (this.ring) this.ring.setAttribute("visibility", at ? "visible" : "hidden");
      if (!at) return;
      const { x } = this.plot, [a, b, low, high] = at.point, slices = this.plot.kind === "slices";
      const span = high > low ? ` (${number(low, "")} to ${number(high, x.unit)})` : "";
      this.tip.replaceChildren(element("b", {}, at.label), document.createElement("br"),
        slices ? `${b} slices at ${number(a, "dB")}` : `${number(b, "dB")} at ${number(a, x.unit)}${span}`);
      this.ring.setAttribute("cx", at.x);
      this.ring.setAttribute("cy", at.y);
      const right = at.x > this.root.clientWidth / 2;
      this.tip.style.left = right ? "" : `${at.x + 14}px`;
      this.tip.style.right = right ? `${this.root.clientWidth - at.x + 14}px` : "";
      this.tip.style.top = `${this.svg.offsetTop + Math.max(0, at.y - 20)}px`;
    }
  }

  for (const root of document.querySelectorAll("[data-plots]")) {
    const chosen = data.plots.filter((plot) => plot.material === root.dataset.plots);
    for (const plot of chosen) {
      const place = element("figure", { class: "plot", "data-kind": plot.kind });
      root.append(place);
      const made = new Plot(place, plot);
      report.whenNear(place, () => made.begin());
    }
  }
})();
