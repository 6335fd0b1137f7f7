"use strict";
// Plots as SVG: points that carry their names, their front, lines and spans; the nearest point is told by pointer or
// arrow keys. The titles of axes are text around the drawing, so that they fold where it is narrow.
(() => {
  const { data, hidden, drawn, element, marker, colourOf, lookOf, number } = report;
  const LEFT = 34, RIGHT = 12, TOP = 10, BOTTOM = 22, HEIGHT = 300, ROW = 27;
  const pen = document.createElement("canvas").getContext("2d");

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

  // The name of a codec, with its settings where the run has it at several.
  const codecOf = (label) => label.split(/[ ,]/)[0];
  const nameOf = (label) => (data.codecs.filter((each) => codecOf(each.label) === codecOf(label)).length > 1 ? label : codecOf(label));

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
      this.series = plot.series;
      this.spans = plot.kind === "slices";
      this.height = this.spans ? plot.series.length * ROW + TOP + BOTTOM : HEIGHT;
      this.svg = drawn("svg", { height: this.height, tabindex: 0, role: "img",
        "aria-label": `${plot.title} ${plot.material}. Arrow keys move from point to point.` });
      this.tip = element("p", { class: "tip", role: "status", hidden: "" });
      const { x, y } = plot, front = this.fronted() ? " Grey line: nothing else is as good for less." : "";
      root.append(element("h4", {}, plot.title), element("p", { class: "notes" }, y.label ? `↑ better: ${y.label}` : ""), this.svg,
        this.tip, element("p", { class: "notes x" }, `${x.less ? "← better: " : ""}${x.label}${this.spans ? " → better" : ""}.${front}`));
      if (plot.missing.length) {
        const names = plot.missing.length > 6 ? `${plot.missing.slice(0, 6).join(", ")} and ${plot.missing.length - 6} more`
          : plot.missing.join(", ");
        root.append(element("p", { class: "notes" }, `Not drawn, without such a number or without any error: ${names}.`));
      }
      if (plot.note) root.append(element("p", { class: "notes" }, plot.note));
      this.svg.addEventListener("pointermove", (event) => this.near(event));
      this.svg.addEventListener("pointerleave", () => this.show(null));
      this.svg.addEventListener("blur", () => this.show(null));
      this.svg.addEventListener("keydown", (event) => this.key(event));
    }

    fronted() { return ["rate", "speed", "cost"].includes(this.plot.kind); }

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
      this.svg.setAttribute("viewBox", `0 0 ${width} ${this.height}`);
      this.points = [];
      this.active = null;
      this.show(null);
      if (!shown.length) return;
      const all = shown.flatMap((each) => each.points);
      const xs = range(all.flatMap((p) => (this.spans ? p : p.length > 2 ? [p[0], p[2], p[3]] : [p[0]])), x.log);
      const ys = this.spans ? null : range(all.map((p) => p[1]), false);
      const h = scale(xs, ys ? LEFT : RIGHT, width - RIGHT, x.log), v = ys && scale(ys, HEIGHT - BOTTOM, TOP, false);
      this.axes(width, xs, ys, h, v);
      if (this.spans) shown.forEach((each, row) => this.span(each, TOP + row * ROW, h));
      else {
        if (this.fronted()) this.front(width, all, h, v);
        this.ladders(shown, h, v);
        for (const each of shown) if (each.line) this.line(each.label, each.points.map(([a, b]) => `${h(a)},${v(b)}`));
        for (const each of shown) this.one(each, h, v);
        this.names(width);
      }
      this.ring = drawn("circle", { r: 9, fill: "none", stroke: "var(--ink)", "stroke-width": 1.5, visibility: "hidden" });
      this.svg.append(this.ring);
    }

    axes(width, xs, ys, h, v) {
      const text = (at, words, more) => this.svg.append(drawn("text", { ...at, ...more }, words));
      const { ticks } = this.plot.x;
      let marks = ticks ? ticks.filter((tick) => xs[0] <= tick && tick <= xs[1]) : (this.plot.x.log ? logarithmic(...xs) : linear(...xs));
      while (marks.length > Math.max(1, width / 60)) marks = marks.filter((_, i) => i % 2 === 0);
      for (const mark of marks) {
        this.svg.append(drawn("line", { x1: h(mark), x2: h(mark), y1: TOP, y2: this.height - BOTTOM, class: "grid" }));
        text({ x: h(mark), y: this.height - BOTTOM + 15 }, number(mark, this.plot.x.unit === "B" ? "B" : ""), { "text-anchor": "middle" });
      }
      for (const mark of ys ? linear(...ys) : []) {
        this.svg.append(drawn("line", { x1: LEFT, x2: width - RIGHT, y1: v(mark), y2: v(mark), class: "grid" }));
        text({ x: LEFT - 6, y: v(mark) + 4 }, number(mark, ""), { "text-anchor": "end" });
      }
    }

    // What nothing else beats at less cost, as a stair.
    front(width, all, h, v) {
      let best = -Infinity;
      const stair = [];
      for (const [a, b] of [...all].sort((p, q) => p[0] - q[0] || q[1] - p[1])) {
        if (b <= best) continue;
        if (stair.length) stair.push(`${h(a)},${v(best)}`);
        stair.push(`${h(a)},${v(b)}`);
        best = b;
      }
      stair.push(`${width - RIGHT},${v(best)}`);
      this.svg.append(drawn("polyline", { points: stair.join(" "), class: "front" }));
    }

    // The spread of a codec's slices: a thin line, its middle half thick, a marker at the median, the name above.
    span({ label, points: [point] }, top, h) {
      const y = top + ROW - 7, [low, from, middle, to, high] = point.map(h);
      const bar = (x1, x2, width) => drawn("line", { x1, x2, y1: y, y2: y, stroke: colourOf(label), "stroke-width": width,
        "stroke-opacity": width > 2 ? 0.5 : 1 });
      this.svg.append(drawn("text", { x: RIGHT, y: top + 11, class: "name" }, label), bar(low, high, 1.4), bar(from, to, 6),
        marker(label, middle, y, 5.5));
      this.points.push({ label, x: middle, y, point });
    }

    // The name of each point, or of a line at its end: beside it or, without room there, at the end of a thin line from
    // it. What has no room at all is still told by pointer and keys.
    names(width) {
      const boxes = this.points.map(({ x, y }) => [x - 6, y - 6, x + 6, y + 6]);
      const free = (box) => box[0] > LEFT && box[2] < width && box[1] > 0 && box[3] < HEIGHT - BOTTOM &&
        boxes.every((other) => box[0] >= other[2] || box[2] <= other[0] || box[1] >= other[3] || box[3] <= other[1]);
      pen.font = `11.5px ${getComputedStyle(this.root).fontFamily}`;
      for (const { label, x, y } of this.points.filter((at, i, all) => at.label !== all[i + 1]?.label)) {
        const name = nameOf(label), wide = pen.measureText(name).width;
        const boxAt = ([dx, dy]) => [x + dx, y + dy, x + dx + wide, y + dy + 12];
        const beside = [[8, -6], [-8 - wide, -6], [-wide / 2, -19], [-wide / 2, 8], [5, -18], [5, 7], [-5 - wide, -18], [-5 - wide, 7]];
        const away = [24, 34, 46, 58, 72, 86, 102, 120, 140, 164].flatMap((r) => Array.from({ length: 16 }, (_, i) => {
          const angle = (i * Math.PI) / 8, dx = r * Math.cos(angle);
          return [dx < 0 ? dx - wide : dx, r * Math.sin(angle) - 6];
        }));
        const near = beside.map(boxAt).find(free), box = near || away.map(boxAt).find(free);
        if (!box) continue;
        boxes.push(box);
        if (!near) {
          const end = Math.min(Math.max(x, box[0]), box[2]);
          this.svg.append(drawn("line", { x1: x, y1: y, x2: end, y2: (box[1] + box[3]) / 2, stroke: colourOf(label), class: "leader" }));
        }
        this.svg.append(drawn("text", { x: box[0], y: box[1] + 10, class: "name" }, name));
      }
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
      // A curve has points between its ticks, too; only its end is told of these.
      const { label } = each, { ticks } = this.plot.x, told = (p, i, all) => !ticks || ticks.includes(p[0]) || i === all.length - 1;
      for (const point of each.points.filter(told)) {
        const [a, b, low, high] = point, at = { label, x: h(a), y: v(b), point };
        if (high > low) {
          this.svg.append(drawn("line", { x1: h(low), x2: h(high), y1: at.y, y2: at.y, stroke: colourOf(label) }));
        }
        if (!ticks || ticks.includes(a)) this.svg.append(marker(label, at.x, at.y, this.plot.kind === "fits" ? 2.6 : 5));
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
      const { x } = this.plot, [a, b, low, high, best] = at.point;
      const span = high > low ? ` (${number(low, "")} to ${number(high, x.unit)})` : "";
      this.tip.replaceChildren(element("b", {}, at.label), document.createElement("br"),
        this.spans ? `median ${number(low, "dB")}, half between ${number(b, "")} and ${number(high, "dB")}, 9 of 10 between ${
          number(a, "")} and ${number(best, "dB")}` : `${number(b, "dB")} at ${number(a, x.unit)}${span}`);
      this.ring.setAttribute("cx", at.x);
      this.ring.setAttribute("cy", at.y);
      const right = at.x > this.root.clientWidth / 2;
      this.tip.style.left = right ? "" : `${at.x + 14}px`;
      this.tip.style.right = right ? `${this.root.clientWidth - at.x + 14}px` : "";
      this.tip.style.top = `${this.svg.offsetTop + Math.max(0, at.y - 20)}px`;
    }
  }

  for (const root of document.querySelectorAll("[data-plots]")) {
    const chosen = data.plots.filter((plot) => plot.material === root.dataset.plots && root.dataset.kinds.split(" ").includes(plot.kind));
    for (const plot of chosen) {
      const place = element("figure", { class: "plot", "data-kind": plot.kind });
      root.append(place);
      const made = new Plot(place, plot);
      report.whenNear(place, () => made.begin());
    }
  }
})();
