"use strict";
// The slice viewer: a view and a light chosen on two hemispheres, truth and codecs side by side with a wipe.
(() => {
  const { element, drawn, number } = report;
  const SIZE = 120, GAINS = [1, 4, 16];

  function picture(url) {
    return new Promise((resolve, reject) => {
      const image = new Image();
      image.onload = () => resolve(image);
      image.onerror = () => reject(new Error("a stored picture cannot be shown"));
      image.src = url;
    });
  }

  const place = ([theta, phi]) => {
    const radius = (theta / 90) * (SIZE / 2 - 8), angle = (phi * Math.PI) / 180;
    return [SIZE / 2 + radius * Math.cos(angle), SIZE / 2 - radius * Math.sin(angle)];
  };

  const images = new Map();
  function loaded(url) {
    if (!images.has(url)) images.set(url, picture(url));
    return images.get(url);
  }

  // The texels of one pair of a stored grid.
  async function cutOut({ width, height, columns }, url, pair) {
    const image = await loaded(url), cut = new OffscreenCanvas(width, height).getContext("2d", { willReadFrequently: true });
    cut.drawImage(image, -(pair % columns) * width, -Math.floor(pair / columns) * height);
    return cut.getImageData(0, 0, width, height);
  }

  // The colours of grey levels.
  function magma(pixels) {
    for (let i = 0; i < pixels.data.length; i += 4) pixels.data.set(report.data.magma[pixels.data[i]], i);
    return pixels;
  }

  function put(canvas, pixels) {
    [canvas.width, canvas.height] = [pixels.width, pixels.height];
    canvas.getContext("2d").putImageData(pixels, 0, 0);
  }

  class Slices {
    constructor(root, data) {
      this.data = data;
      this.factor = Math.max(1, Math.round(384 / Math.max(data.width, data.height)));
      this.state = { pair: 0, left: -1, right: best(data.codecs), show: "decoded", gain: 4, wipe: 0.5 };
      this.canvas = element("canvas", { width: data.width * this.factor, height: data.height * this.factor, tabindex: 0,
        role: "slider", "aria-label": "wipe between the left and the right picture", "aria-valuemin": 0, "aria-valuemax": 100 });
      this.says = element("p", { role: "status" });
      const names = ["truth", ...data.codecs.map((codec) => codec.label)];
      const shows = [["decoded", "picture"], ["difference", "difference from truth"], ["flip", "FLIP map"]];
      const chosen = (name, options, value) => {
        const list = element("select", { name, change: () => { this.state[name] = list.value; this.changed(); } });
        for (const [key, text] of options) list.append(new Option(text, key));
        list.value = value;
        return element("label", {}, `${name} `, list);
      };
      const sides = names.map((name, i) => [i - 1, name]), right = chosen("right", sides, this.state.right);
      this.right = right.querySelector("select");
      this.pairs = element("select", { name: "pair", change: () => { this.state.pair = Number(this.pairs.value); this.changed(); } });
      data.wo.forEach((wo, i) => this.pairs.append(new Option(`view ${angles(wo)} · light ${angles(data.wi[i])}`, i)));
      root.append(
        element("div", { class: "controls" }, chosen("left", sides, -1), right,
          chosen("show", shows, "decoded"), chosen("gain", GAINS.map((gain) => [gain, `× ${gain}`]), 4)),
        element("div", { class: "stage" }, this.canvas, element("div", { class: "hemispheres" },
          this.hemisphere("view", data.wo), this.hemisphere("light", data.wi), element("label", {}, "pair ", this.pairs))),
        this.says, this.sheet(names));
      this.listen();
      this.say();
    }

    hemisphere(name, directions) {
      const svg = drawn("svg", { width: SIZE, height: SIZE, viewBox: `0 0 ${SIZE} ${SIZE}`, tabindex: 0, role: "slider",
        "aria-label": `${name}: arrow keys choose a pair`, "aria-valuemin": 1, "aria-valuemax": directions.length });
      for (const theta of [30, 60, 90]) {
        svg.append(drawn("circle", { cx: SIZE / 2, cy: SIZE / 2, r: (theta / 90) * (SIZE / 2 - 8), class: "ring" }));
      }
      const dots = directions.map((direction) => {
        const [cx, cy] = place(direction);
        return drawn("circle", { cx, cy, r: 4, class: "dot" });
      });
      svg.append(...dots);
      const choose = (event) => {
        const box = svg.getBoundingClientRect(), x = event.clientX - box.left, y = event.clientY - box.top;
        const away = directions.map((d) => Math.hypot(place(d)[0] - x, place(d)[1] - y));
        this.state.pair = away.indexOf(Math.min(...away));
        this.changed();
      };
      svg.addEventListener("pointerdown", (event) => { svg.setPointerCapture(event.pointerId); choose(event); });
      svg.addEventListener("pointermove", (event) => { if (event.buttons) choose(event); });
      svg.addEventListener("keydown", (event) => {
        const step = { ArrowRight: 1, ArrowUp: 1, ArrowLeft: -1, ArrowDown: -1 }[event.key];
        if (!step) return;
        event.preventDefault();
        this.state.pair = (this.state.pair + step + directions.length) % directions.length;
        this.changed();
      });
      (this.dots = this.dots || []).push({ svg, dots });
      return element("figure", {}, svg, element("figcaption", {}, name));
    }

    // Every codec at the chosen pair, to look at together and to choose from.
    sheet(names) {
      this.small = names.map(() => element("canvas", { width: this.data.width, height: this.data.height }));
      return element("div", { class: "strip sheet" }, ...names.map((name, i) => element("button", { type: "button",
        click: () => { this.right.value = this.state.right = i - 1; this.changed(); } }, this.small[i], name)));
    }

    listen() {
      const wiped = (to) => { this.state.wipe = Math.min(1, Math.max(0, to)); this.paint(); };
      const at = (event) => (event.clientX - this.canvas.getBoundingClientRect().left) / this.canvas.clientWidth;
      this.canvas.addEventListener("pointerdown", (event) => { this.canvas.setPointerCapture(event.pointerId); wiped(at(event)); });
      this.canvas.addEventListener("pointermove", (event) => { if (event.buttons) wiped(at(event)); });
      this.canvas.addEventListener("keydown", (event) => {
        const to = { ArrowLeft: this.state.wipe - 0.05, ArrowRight: this.state.wipe + 0.05, Home: 0, End: 1 }[event.key];
        if (to === undefined) return;
        event.preventDefault();
        wiped(to);
      });
    }

    slice(url) { return cutOut(this.data, url, this.state.pair); }

    async side(number, show) {
      const codec = this.data.codecs[number], { truth } = this.data;
      if (!codec) return this.slice(truth);
      if (show === "flip") return codec.flip ? magma(await this.slice(codec.flip)) : null;
      const found = await this.slice(codec.decoded);
      if (show === "difference") {
        const other = await this.slice(truth), gain = Number(this.state.gain);
        for (let i = 0; i < found.data.length; i++) if (i % 4 < 3) found.data[i] = gain * Math.abs(found.data[i] - other.data[i]);
      }
      return found;
    }

    async changed() {
      const { pair, left, right, show } = this.state, order = (this.order = (this.order || 0) + 1);
      this.pairs.value = pair;
      for (const { svg, dots } of this.dots) {
        svg.setAttribute("aria-valuenow", pair + 1);
        svg.setAttribute("aria-valuetext", this.pairs.selectedOptions[0].textContent);
        dots.forEach((dot, i) => dot.classList.toggle("chosen", i === pair));
        svg.append(dots[pair]);
      }
      const sides = await Promise.all([this.side(Number(left), "decoded"), this.side(Number(right), show)]);
      if (order !== this.order) return;
      this.sides = sides;
      this.paint();
      for (const [i, canvas] of this.small.entries()) {
        const pixels = await this.side(i - 1, show);
        if (order !== this.order) return;
        if (pixels) put(canvas, pixels);
        else canvas.getContext("2d").clearRect(0, 0, canvas.width, canvas.height);
      }
    }

    paint() {
      if (!this.sides) return;
      const { width, height } = this.data, { factor } = this;
      const context = this.canvas.getContext("2d"), middle = Math.round(this.state.wipe * width * factor);
      this.canvas.width = width * factor;
      this.canvas.height = height * factor;
      context.imageSmoothingEnabled = false;
      this.sides.forEach((pixels, i) => {
        if (!pixels) return;
        const cut = new OffscreenCanvas(width, height);
        cut.getContext("2d").putImageData(pixels, 0, 0);
        context.save();
        context.beginPath();
        if (i) context.rect(middle, 0, width * factor - middle, height * factor);
        else context.rect(0, 0, middle, height * factor);
        context.clip();
        context.drawImage(cut, 0, 0, width * factor, height * factor);
        context.restore();
      });
      context.fillStyle = "#fff8";
      context.fillRect(middle - 1, 0, 2, height * factor);
      this.canvas.setAttribute("aria-valuenow", Math.round(100 * this.state.wipe));
      this.say();
    }

    say() {
      const { left, right, show } = this.state, codec = this.data.codecs[right];
      const missing = show === "flip" && codec && !codec.flip ? ", no FLIP map" : "";
      this.says.textContent = `${this.told(Number(left))} | ${this.told(Number(right))}${missing}`;
    }

    told(which) {
      const codec = this.data.codecs[which], { pair } = this.state;
      if (!codec) return "truth";
      const psnr = codec.psnr ? `, ${number(codec.psnr[pair], codec.psnr[pair] === null ? "" : "dB")}` : "";
      return codec.label + psnr + (codec.flips ? `, FLIP ${codec.flips[pair].toFixed(3)}` : "");
    }
  }

  // The codec whose shown slices have the least FLIP, or the first.
  function best(codecs) {
    const sums = codecs.map((codec) => (codec.flips ? codec.flips.reduce((a, b) => a + b, 0) : Infinity));
    return Math.max(0, sums.indexOf(Math.min(...sums)));
  }

  const angles = ([theta, phi]) => `θ ${Math.round(theta)}° φ ${Math.round(phi)}°`;

  const stored = (id) => JSON.parse(document.getElementById(id).textContent);

  // The first pictures of the page: seen from above in light from the side, as far as that pair is stored.
  async function strip(root) {
    const given = stored(root.dataset.strip), away = given.wo.map(([theta], i) => theta + Math.abs(given.wi[i][0] - 45));
    const pair = away.indexOf(Math.min(...away));
    for (const canvas of root.querySelectorAll("canvas")) {
      const codec = given.codecs.find((each) => each.label === canvas.dataset.codec);
      put(canvas, await cutOut(given, codec ? codec.decoded : given.truth, pair));
      canvas.title = `view ${angles(given.wo[pair])} · light ${angles(given.wi[pair])}`;
    }
  }
  document.querySelectorAll("[data-strip]").forEach(strip);

  for (const root of document.querySelectorAll("[data-slices]")) {
    root.slices = new Slices(root, stored(root.dataset.slices));
    report.whenNear(root, () => root.slices.changed());
  }
})();
