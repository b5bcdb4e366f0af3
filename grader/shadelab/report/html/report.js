// The viewers: what the static pictures show, and every pixel's values beside it. Without this script the page lacks nothing
// else. What encoding.py packed is unpacked when a viewer is opened.
"use strict";
(() => {
  if (!("DecompressionStream" in window)) return;
  const data = JSON.parse(document.getElementById("viewers").textContent);
  const TERMS = ["total", "ambient", "diffuse", "specular"];
  const GEOMETRY = ["id", "normal", "position", "distance"];
  const MOST_ZOOM = 64;

  // ------------------------------------------------------------------------------------------------------- numbers

  // What the bits of a float16 stand for.
  const HALF = Float32Array.from({ length: 65536 }, (_, bits) => {
    const sign = bits & 0x8000 ? -1 : 1, exponent = (bits >> 10) & 31, fraction = bits & 1023;
    if (exponent === 31) return fraction ? NaN : sign * Infinity;
    return sign * (exponent ? 2 ** (exponent - 15) * (1 + fraction / 1024) : 2 ** -14 * (fraction / 1024));
  });
  const INTEGER = Float32Array.from({ length: 65536 }, (_, k) => k);
  const SRGB = Float32Array.from({ length: 256 }, (_, k) => (k <= 10 ? k / 255 / 12.92 : ((k / 255 + 0.055) / 1.055) ** 2.4));
  // How many times the tolerance: 0 is below the least that is told, 1/4; 16 steps a doubling from there; the last is infinite.
  const EXCESS = Float32Array.from({ length: 65536 }, (_, k) => (k === 0 ? 0 : k === 65535 ? Infinity : 2 ** ((k - 33) / 16)));
  const fractions = (low, high) => INTEGER.map((k) => low + (k / 4095) * (high - low));

  // One or three planes of numbers, each an index into the table of what it stands for.
  class Layer {
    constructor(planes, tables) {
      Object.assign(this, { planes, tables });
    }
    at(k, i) {
      return this.tables[k][this.planes[k][i]];
    }
    read(i) {
      return this.planes.map((_, k) => this.at(k, i));
    }
  }

  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const minus = (a, b) => a.map((value, k) => value - b[k]);
  const unit = (a) => a.map((value) => value / Math.hypot(...a));

  function digits(x, count = 4) {
    if (!Number.isFinite(x)) return Number.isNaN(x) ? "NaN" : x > 0 ? "∞" : "−∞";
    const text = x === 0 ? "0" : Math.abs(x) < 1e-3 || Math.abs(x) >= 1e5 ? x.toExponential(count - 1) : x.toPrecision(count);
    return text.replace("-", "−");
  }

  // ------------------------------------------------------------------------------------------------------- unpacking

  async function unpack(name, channels, width, height, against = [], base = null) {
    const text = atob(document.getElementById(`data-${name}`).textContent);
    const packed = new Uint8Array(text.length);
    for (let i = 0; i < text.length; i++) packed[i] = text.charCodeAt(i);
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
    const bytes = new Uint8Array(await new Response(stream).arrayBuffer());
    const size = width * height;
    const layers = {}, order = [];
    for (const { name, planes, coding, low, high } of channels) {
      const first = order.length;
      for (let k = first; k < first + planes; k++) {
        const near = against.includes(k) ? base[k] : null;
        order.push(plane(bytes.subarray(2 * size * k, 2 * size * (k + 1)), width, height, near));
      }
      const tables = Array.from({ length: planes }, (_, k) =>
        ({ half: HALF, integer: INTEGER, excess: EXCESS })[coding] ?? fractions(low[k], high[k]));
      layers[name] = new Layer(order.slice(first), tables);
    }
    return { layers, order };
  }

  // From differences to numbers: against the same plane of the scene, or against left + above - above left.
  function plane(bytes, width, height, near) {
    const size = width * height, out = new Uint16Array(size);
    for (let y = 0, i = 0; y < height; y++) {
      for (let x = 0, left = 0; x < width; x++, i++) {
        const packed = (bytes[i] << 8) | bytes[size + i], change = (packed >> 1) ^ -(packed & 1);
        if (near) {
          out[i] = near[i] + change;
        } else {
          left = (left + change) & 0xffff;  // the row's differences from the row above, summed
          out[i] = left + (y ? out[i - width] : 0);
        }
      }
    }
    return out;
  }

  const scenes = new Map();  // unpacked once for both languages

  async function load(id, images) {
    const check = data.checks[id], { width, height } = check;
    if (!check.scene) return eightBits(check, images);
    const scene = data.scenes[check.scene];
    if (!scenes.has(check.scene)) scenes.set(check.scene, unpack(check.scene, scene.channels, width, height));
    const shared = await scenes.get(check.scene);
    const own = await unpack(id, check.channels, width, height, check.against, shared.order);
    return { ...check, ...scene, expected: shared.layers, yours: own.layers };
  }

  // There was no room for the values: those of the static pictures.
  async function eightBits(check, images) {
    const { width, height } = check, bare = { yours: {}, expected: {}, ...check };
    for (const [name, image] of Object.entries(images)) {
      await image.decode();
      const canvas = sheet(width, height);
      canvas.getContext("2d").drawImage(image, 0, 0, width, height);
      if (name === "difference") {
        bare.picture = canvas;
        continue;
      }
      const pixels = canvas.getContext("2d").getImageData(0, 0, width, height).data;
      const planes = [0, 1, 2].map((k) => Uint8Array.from({ length: width * height }, (_, i) => pixels[4 * i + k]));
      bare[name].total = new Layer(planes, [SRGB, SRGB, SRGB]);
    }
    return bare;
  }

  // ------------------------------------------------------------------------------------------------------- pictures

  function sheet(width, height) {
    const canvas = document.createElement("canvas");
    Object.assign(canvas, { width, height });
    return canvas;
  }

  function painted(width, height, colour) {
    const canvas = sheet(width, height), context = canvas.getContext("2d"), image = context.createImageData(width, height);
    colour(new Uint32Array(image.data.buffer));  // little-endian, as all machines with a browser are: 0xaabbggrr
    context.putImageData(image, 0, 0);
    return canvas;
  }

  const MAGENTA = 0xffff00ff, BLACK = 0xff000000;
  const rgb = (r, g, b) => (BLACK | (b << 16) | (g << 8) | r) >>> 0;
  const encoded = (x) => 255 * (x <= 0.0031308 ? 12.92 * x : 1.055 * x ** (1 / 2.4) - 0.055);

  function light(layer, exposure, width, height) {
    const gain = 2 ** exposure, table = layer.tables[0];
    const byte = Uint8Array.from(table, (x) => (x > 0 ? Math.round(encoded(Math.min(1, x * gain))) : 0));
    const bad = Uint8Array.from(table, (x) => (Number.isFinite(x) ? 0 : 1));
    const [r, g, b] = layer.planes;
    return painted(width, height, (out) => {
      for (let i = 0; i < out.length; i++)
        out[i] = bad[r[i]] | bad[g[i]] | bad[b[i]] ? MAGENTA : rgb(byte[r[i]], byte[g[i]], byte[b[i]]);
    });
  }

  const stops = data.ramp.map((colour) => [1, 3, 5].map((k) => parseInt(colour.slice(k, k + 2), 16)));

  function difference(source, name, exposure) {
    const most = stops.length - 1, mask = source.expected.mask.planes[0], far = source.yours[`${name} excess`].planes[0];
    const bad = Uint8Array.from(HALF, (x) => (Number.isFinite(x) ? 0 : 1)), [r, g, b] = source.yours[name].planes;
    // Of each possible excess: doublings beyond the tolerance, its colour, and the two greys of the hatching.
    const doublings = EXCESS.map((times) => Math.min(most, Math.max(0, Math.log2(times * 2 ** exposure))));
    const colours = Uint32Array.from(doublings, (d) => {
      const k = Math.min(most - 1, Math.floor(d));
      return d > 0 ? rgb(...stops[k].map((from, c) => Math.round(from + (d - k) * (stops[k + 1][c] - from)))) : BLACK;
    });
    const greys = [1, 0.6].map((shade) => Uint32Array.from(doublings, (d) => {
      const grey = Math.round(shade * (48 + (80 * d) / most));
      return rgb(grey, grey, grey);
    }));
    return painted(source.width, source.height, (out) => {
      for (let i = 0, y = 0; y < source.height; y++)
        for (let x = 0; x < source.width; x++, i++)
          out[i] = bad[r[i]] | bad[g[i]] | bad[b[i]] ? MAGENTA
            : mask[i] === 2 ? greys[(x + y) % 4 < 2 ? 0 : 1][far[i]] : colours[far[i]];
    });
  }

  function geometry(source, name) {
    const { width, height, eye } = source, { id, normal, position } = source.expected;
    const object = id.planes[0], [x, y, z] = position.planes;
    const away = (i) => Math.hypot(...minus(position.read(i), eye));
    let near = Infinity, far = 0;
    if (name === "distance")
      for (let i = 0; i < object.length; i++)
        if (object[i]) {
          near = Math.min(near, away(i));
          far = Math.max(far, away(i));
        }
    return painted(width, height, (out) => {
      for (let i = 0; i < out.length; i++) {
        if (!object[i]) {
          out[i] = BLACK;
        } else if (name === "id") {
          const turn = 2 * Math.PI * object[i] * 0.618;  // golden steps of hue: neighbours in number differ most
          out[i] = rgb(...[0, 2.1, 4.2].map((phase) => Math.round(150 + 90 * Math.cos(turn + phase))));
        } else if (name === "normal") {
          out[i] = rgb(...normal.read(i).map((n) => Math.round(127.5 + 127.5 * n)));
        } else if (name === "position") {
          out[i] = rgb(x[i] >> 4, y[i] >> 4, z[i] >> 4);
        } else {
          const grey = Math.round(255 - (215 * (away(i) - near)) / (far - near || 1));
          out[i] = rgb(grey, grey, grey);
        }
      }
    });
  }

  // ------------------------------------------------------------------------------------------------------- the page

  function element(tag, attributes = {}, ...children) {
    const out = document.createElement(tag);
    for (const [name, value] of Object.entries(attributes)) out.setAttribute(name, value);
    out.append(...children);
    return out;
  }

  const th = (text, attributes = {}) => element("th", { scope: "row", ...attributes }, text);
  const clamp = (x, low, high) => Math.min(high, Math.max(low, x));
  let viewers = 0;

  class Viewer {
    constructor(name, source, close) {
      this.source = source;
      this.close = close;
      this.root = document.getElementById("viewer").content.firstElementChild.cloneNode(true);
      this.find = (selector) => this.root.querySelector(selector);
      this.stage = this.find(".stage");
      this.canvases = Object.fromEntries(
        [...this.root.querySelectorAll("[data-pane]")].map((pane) => [pane.dataset.pane, pane.querySelector("canvas")]));
      this.root.setAttribute("aria-label", `Viewer of ${name}`);
      this.stage.setAttribute("aria-label", `Pictures of ${name}. Arrow keys move the pixel; more keys are listed below.`);
      viewers++;
      for (const radio of this.root.querySelectorAll("[type=radio]")) radio.name = `mode-${viewers}`;
      this.layers = [...TERMS.filter((t) => source.yours[t]), ...(source.expected.position ? GEOMETRY : [])];
      const select = this.find("select");
      for (const [label, names] of [["light", TERMS], ["geometry", GEOMETRY]]) {
        const present = names.filter((name) => this.layers.includes(name));
        const group = element("optgroup", { label }, ...present.map((name) => element("option", {}, name)));
        if (group.children.length) select.append(group);
      }
      for (const canvas of Object.values(this.canvases)) canvas.style.aspectRatio = `${source.width} / ${source.height}`;
      this.pictures = new Map();
      const [x, y] = source.pixel ?? this.farthest();
      this.state = {
        mode: innerWidth < 640 ? "slider" : "side", layer: "total", exposure: 0, zoom: 1, wipe: 0.5, flipped: false,
        x, y, centre: [source.width / 2, source.height / 2],
      };
      this.listen();
      new ResizeObserver(() => this.paint()).observe(this.stage);
      this.update();
    }

    // The pixel that is farthest off among those that are judged strictly.
    farthest() {
      const { width, height, expected, yours } = this.source;
      if (!expected.mask) return [width >> 1, height >> 1];
      const far = yours["total excess"].planes[0], mask = expected.mask.planes[0];
      let worst = (height >> 1) * width + (width >> 1);
      for (let i = 0, most = 0; i < far.length; i++)
        if (mask[i] !== 2 && far[i] > most) {
          most = far[i];
          worst = i;
        }
      return [worst % width, Math.floor(worst / width)];
    }

    listen() {
      this.root.addEventListener("keydown", (event) => this.key(event));
      this.root.addEventListener("click", (event) => {
        const action = event.target.closest("[data-do]")?.dataset.do;
        if (action) this.do(action);
      });
      this.find(".modes").addEventListener("change", (event) => this.set({ mode: event.target.value }));
      this.find("select").addEventListener("change", (event) => this.set({ layer: event.target.value }));
      this.find(".exposure input").addEventListener("input", (event) => this.set({ exposure: Number(event.target.value) }));
      this.find(".wipe input").addEventListener("input", (event) => this.set({ wipe: event.target.value / 100 }));
      for (const [name, canvas] of Object.entries(this.canvases)) {
        canvas.addEventListener("pointerdown", (event) => this.press(event, canvas, name));
        canvas.addEventListener("wheel", (event) => {
          if (!event.ctrlKey && !event.metaKey) return;  // a wheel alone scrolls the page
          event.preventDefault();
          this.zoom(this.state.zoom * 2 ** (-event.deltaY / 200), this.point(event, canvas));
        }, { passive: false });
      }
    }

    // --- What is done

    do(action) {
      const { zoom, x, y } = this.state;
      if (action === "larger") this.zoom(2 ** Math.floor(Math.log2(zoom) + 1), [x + 0.5, y + 0.5]);
      if (action === "smaller") this.zoom(2 ** Math.ceil(Math.log2(zoom) - 1));
      if (action === "fit") this.zoom(1);
      if (action === "worst") this.select(...(this.source.pixel ?? this.farthest()));
      if (action === "flip") this.set({ mode: "flip", flipped: this.state.mode === "flip" && !this.state.flipped });
      if (action === "close") this.close();
    }

    key(event) {
      if (event.ctrlKey || event.metaKey || event.altKey) return;
      const { key, target } = event, { layer, exposure, wipe, mode } = this.state;
      const step = event.shiftKey ? 10 : 1;
      const moves = { ArrowLeft: [-step, 0], ArrowRight: [step, 0], ArrowUp: [0, -step], ArrowDown: [0, step] };
      const modes = { 1: "side", 2: "slider", 3: "flip" };
      const actions = {
        "+": "larger", "=": "larger", "-": "smaller", "−": "smaller", 0: "fit", w: "worst", f: "flip", Escape: "close",
      };
      if (target.matches("select, summary, .scroll") && key !== "Escape") return;
      if (key in moves) {
        if (target !== this.stage) return;  // a slider's or a radio button's own
        this.select(this.state.x + moves[key][0], this.state.y + moves[key][1]);
      } else if (key in modes) {
        this.set({ mode: modes[key] });
      } else if (key.toLowerCase() in actions || key in actions) {
        this.do(actions[key] ?? actions[key.toLowerCase()]);
      } else if (key === "l" || key === "L") {
        const count = this.layers.length;
        this.set({ layer: this.layers[(this.layers.indexOf(layer) + (key === "L" ? count - 1 : 1)) % count] });
      } else if (key === "[" || key === "]") {
        this.set({ exposure: clamp(exposure + (key === "]" ? 0.5 : -0.5), -6, 6) });
      } else if ((key === "<" || key === ">") && mode === "slider") {
        this.set({ wipe: clamp(wipe + (key === ">" ? 0.05 : -0.05), 0, 1) });
      } else {
        return;
      }
      event.preventDefault();
    }

    // A click chooses a pixel; a drag moves the divider, or else the zoomed picture.
    press(event, canvas, name) {
      if (event.button) return;
      this.stage.focus({ preventScroll: true });
      const box = canvas.getBoundingClientRect(), { mode, zoom, wipe, centre } = this.state;
      const start = [event.clientX, event.clientY];
      const divides = name === "both" && mode === "slider" &&
        (zoom === 1 || Math.abs((event.clientX - box.left) / box.width - wipe) * box.width < 16);
      let dragged = false;
      const move = (to) => {
        dragged ||= Math.hypot(to.clientX - start[0], to.clientY - start[1]) > 4;
        if (!dragged) return;
        if (divides) {
          this.set({ wipe: clamp((to.clientX - box.left) / box.width, 0, 1) });
        } else if (zoom > 1) {
          const scale = this.source.width / zoom / box.width;
          this.state.centre = [centre[0] - (to.clientX - start[0]) * scale, centre[1] - (to.clientY - start[1]) * scale];
          this.paint();
        }
      };
      const end = (last) => {
        canvas.removeEventListener("pointermove", move);
        if (last.type === "pointerup" && !dragged) this.select(...this.point(last, canvas).map(Math.floor));
      };
      canvas.setPointerCapture(event.pointerId);
      canvas.addEventListener("pointermove", move);
      for (const type of ["pointerup", "pointercancel"]) canvas.addEventListener(type, end, { once: true });
    }

    // Where in the picture, in pixels, an event is.
    point(event, canvas) {
      const box = canvas.getBoundingClientRect(), [left, top, width, height] = this.window();
      return [left + ((event.clientX - box.left) / box.width) * width, top + ((event.clientY - box.top) / box.height) * height];
    }

    zoom(zoom, about) {
      zoom = clamp(zoom, 1, MOST_ZOOM);
      const before = this.window();
      if (about) {  // this point stays where it is, once it is in sight
        const share = [0, 1].map((k) => clamp((about[k] - before[k]) / before[k + 2], 0, 1));
        const size = [this.source.width / zoom, this.source.height / zoom];
        this.state.centre = [0, 1].map((k) => about[k] + (0.5 - share[k]) * size[k]);
      }
      this.set({ zoom });
    }

    select(x, y) {
      const { width, height } = this.source, { state } = this;
      [x, y] = [clamp(x, 0, width - 1), clamp(y, 0, height - 1)];
      const [left, top, wide, tall] = this.window();
      if (x < left || x + 1 > left + wide || y < top || y + 1 > top + tall) state.centre = [x + 0.5, y + 0.5];
      this.set({ x, y });
    }

    set(change) {
      Object.assign(this.state, change);
      this.update();
    }

    // --- What is shown

    // The part of the picture in sight: left, top, width, height; the same in every canvas.
    window() {
      const { zoom, centre } = this.state, size = [this.source.width, this.source.height];
      const part = size.map((length) => length / zoom);
      return [...[0, 1].map((k) => clamp(centre[k] - part[k] / 2, 0, size[k] - part[k])), ...part];
    }

    picture(which) {
      const { layer, exposure } = this.state, { source } = this, { width, height } = source;
      const name = which === "geometry" ? layer : `${which} ${layer} ${exposure}`;
      if (!this.pictures.has(name)) {
        if (this.pictures.size > 8) this.pictures.clear();
        this.pictures.set(name,
          which === "geometry" ? geometry(source, layer)
          : which !== "difference" ? light(source[which][layer], exposure, width, height)
          : source.picture ?? difference(source, layer, exposure));
      }
      return this.pictures.get(name);
    }

    update() {
      const { mode, layer, exposure, zoom, wipe, flipped } = this.state, { root } = this;
      const shape = GEOMETRY.includes(layer);
      const panes = shape ? ["geometry"] : mode === "side" ? ["yours", "expected", "difference"] : ["both", "difference"];
      for (const pane of root.querySelectorAll("[data-pane]")) pane.hidden = !panes.includes(pane.dataset.pane);
      root.dataset.mode = shape ? "geometry" : mode;
      for (const radio of root.querySelectorAll("[type=radio]")) {
        radio.checked = radio.value === mode;
        radio.disabled = shape;
      }
      this.find("select").value = layer;
      const light = this.find(".exposure input");
      light.value = exposure;
      light.disabled = shape;
      this.find(".exposure output").textContent = (exposure > 0 ? "+" : "") + String(exposure).replace("-", "−");
      this.find(".zoom output").textContent = `${Math.round(10 * zoom) / 10}×`;
      this.find(".wipe").hidden = shape || mode !== "slider";
      this.find(".wipe input").value = Math.round(100 * wipe);
      this.find(".flip").hidden = shape || mode !== "flip";
      this.find(".flip").textContent = flipped ? "Flip to yours" : "Flip to expected";
      this.find(".legend").hidden = shape;
      const scaled = exposure && !this.source.picture;
      const scale = scaled ? `, from ${Number((2 ** -exposure).toPrecision(2))}× the tolerance` : "";
      const shown = flipped ? "Expected" : "Yours", suffix = layer === "total" ? "" : `, ${layer}`;
      const captions = {
        yours: ["Yours", suffix], expected: ["Expected", suffix],
        both: mode === "flip" ? [shown, suffix] : ["Yours | Expected", suffix],
        difference: ["Difference", suffix + scale],
        geometry: [layer[0].toUpperCase() + layer.slice(1), ", of the scene: the same for both"],
      };
      for (const [name, [title, rest]] of Object.entries(captions)) {
        this.find(`[data-pane=${name}] figcaption`).replaceChildren(element("strong", {}, title), rest);
        this.canvases[name].setAttribute("aria-label", title + rest);
      }
      this.paint();
      this.inspect();
    }

    paint() {
      const { mode, flipped, wipe, x, y } = this.state, [left, top, width, height] = this.window();
      for (const [name, canvas] of Object.entries(this.canvases)) {
        if (!canvas.clientWidth) continue;
        const wide = Math.round(canvas.clientWidth * devicePixelRatio), tall = Math.round((wide * height) / width);
        if (canvas.width !== wide || canvas.height !== tall) Object.assign(canvas, { width: wide, height: tall });
        canvas.style.touchAction = this.state.zoom > 1 ? "none" : "pan-y";
        const context = canvas.getContext("2d"), scale = wide / width;
        context.imageSmoothingEnabled = scale < 1;
        const draw = (which, from = 0, to = wide) => {
          context.save();
          context.beginPath();
          context.rect(from, 0, to - from, tall);
          context.clip();
          context.drawImage(this.picture(which), left, top, width, height, 0, 0, wide, tall);
          context.restore();
        };
        if (name !== "both") {
          draw(name);
        } else if (mode === "flip") {
          draw(flipped ? "expected" : "yours");
        } else {
          const at = Math.round(wipe * wide);
          draw("yours", 0, at);
          draw("expected", at, wide);
          context.fillStyle = "#000";
          context.fillRect(at - 2, 0, 4, tall);
          context.fillStyle = "#fff";
          context.fillRect(at - 1, 0, 2, tall);
        }
        // Around the chosen pixel, never over it.
        const size = Math.max(scale, 8 * devicePixelRatio);
        const [cx, cy] = [(x + 0.5 - left) * scale, (y + 0.5 - top) * scale];
        for (const [colour, grow] of [["#000", 3], ["#fff", 1.5]]) {
          context.strokeStyle = colour;
          context.lineWidth = 1.5;
          context.strokeRect(cx - size / 2 - grow, cy - size / 2 - grow, size + 2 * grow, size + 2 * grow);
        }
      }
    }

    // Everything that is known of the chosen pixel.
    inspect() {
      const { source } = this, { x, y } = this.state, { expected, yours } = source, i = y * source.width + x;
      const exact = source.exact && source.pixel[0] === x && source.pixel[1] === y ? source.exact : null;
      const get = (side, name) => exact?.[side][name]?.map(Number) ?? source[side][name].read(i);
      const id = expected.id?.at(0, i) ?? null, mask = expected.mask?.at(0, i);
      const facts = element("tbody");
      const row = (name, ...cells) => {
        const blank = cells.length < 3 ? { colspan: 4 - cells.length } : {};
        const last = cells.pop();
        facts.append(element("tr", {}, th(name), ...cells.map((c) => element("td", {}, c)), element("td", blank, last)));
      };
      const vector = (name, v) => row(name, ...v.map((c) => digits(c)));
      row("pixel", `x ${x}, y ${y}`);
      if (id !== null) row("object", id ? String(id) : "none: background");
      if (mask !== undefined) row("judged", ["strictly: background", "strictly", "leniently: an edge"][mask]);
      if (id) {
        const position = get("expected", "position"), n = get("expected", "normal"), view = minus(source.eye, position);
        const v = unit(view);
        vector("x", position);
        row("distance", digits(Math.hypot(...view)));
        vector("n", n);
        vector("v", v);
        row("n·v", digits(dot(n, v)));
        source.lights.forEach(({ kind, directional, at }, k) => {
          const l = directional ? unit(at.map((c) => -c)) : unit(minus(at, position));
          const h = unit(l.map((c, k) => c + v[k]));
          const sub = source.lights.length > 1 ? String.fromCharCode(0x2081 + k) : "";
          facts.append(element("tr", { class: "light" }, th(`${kind}${sub && ` ${k + 1}`}`, { colspan: 4 })));
          vector(`l${sub}`, l);
          vector(`h${sub}`, h);
          row(`n·l${sub}`, digits(dot(n, l)));
          row(`n·h${sub}`, digits(dot(n, h)));
        });
      }
      const times = (name) => (source.picture ? NaN : get("yours", `${name} excess`)[0]);
      const told = (far) => (far < 0.25 ? "< 0.25×" : `${digits(far, exact ? 4 : 2)}×`);
      const parts = TERMS.filter((t) => yours[t]).map((name) => {
        const far = times(name), e = get("expected", name), a = get("yours", name);
        const mark = far > 1 ? [element("span", { class: "mark" }, element("span", { "aria-hidden": "true" }, "✗"),
          element("span", { class: "sr" }, "beyond the tolerance"))] : [];
        const rows = "rgb".split("").map((channel, k) =>
          element("tr", {}, th(`${name} ${channel}`), element("td", {}, digits(e[k])), element("td", {}, digits(a[k]))));
        if (!source.picture) rows[0].append(element("td", { rowspan: 3 }, told(far), ...mark));
        return element("tbody", far > 1 ? { class: "wrong" } : {}, ...rows);
      });
      const head = (...names) => element("thead", {}, element("tr", {}, ...names.map((n) => element("th", { scope: "col" }, n))));
      const table = (label, ...parts) => element("div", { class: "scroll", tabindex: 0, role: "region", "aria-label": label },
        element("table", { class: "values" }, ...parts));
      const rounded = source.picture ? "Read from pictures of 8 bits." : exact ? "Exactly as they were judged." :
        "Light is kept with 11 bits: the fourth digit is rounded. x and n with 12 bits of their range, and what is computed of them.";
      const names = ["value", "expected", "yours", ...(source.picture ? [] : ["off / limit"])];
      const old = [...this.root.querySelectorAll(".inspector .scroll")].map((part) => part.scrollLeft);
      this.find(".inspector").replaceChildren(
        table("The chosen pixel", facts),
        element("div", {}, table("Its values", head(...names), ...parts), element("p", { class: "soft" }, rounded)));
      this.root.querySelectorAll(".inspector .scroll").forEach((part, k) => (part.scrollLeft = old[k] ?? 0));
      clearTimeout(this.saying);
      const tell = ([r, g, b]) => `${digits(r, 3)}, ${digits(g, 3)}, ${digits(b, 3)}`;
      this.saying = setTimeout(() => {
        this.find("[aria-live]").textContent = `Pixel ${x}, ${y}: expected ${tell(get("expected", "total"))}; ` +
          `yours ${tell(get("yours", "total"))}` + (source.picture ? "" : `; difference ${told(times("total"))} the limit`);
      }, 300);
    }
  }

  // --- Opening and closing

  async function open(place, at = null, focus = true) {
    if (place.dataset.open) return;
    place.dataset.open = "yes";
    const { viewer: id, name } = place.dataset;
    const static_ = place.matches(".pictures") ? [place, place.nextElementSibling, place.previousElementSibling] : [];
    const images = Object.fromEntries(
      ["yours", "expected", "difference"].map((which) => [which, document.querySelector(`#${id}-${which} img`)]));
    let viewer;
    try {
      const source = await load(id, images);
      const close = () => {
        viewer.root.remove();
        for (const part of static_) part.hidden = false;
        delete place.dataset.open;
        (static_[2] ?? place.querySelector("button")).focus();
      };
      viewer = new Viewer(name, source, close);
    } catch (error) {
      place.before(element("p", { class: "note error" }, `The viewer could not be opened: ${error.message}`));
      return;
    }
    if (static_.length) {
      place.after(viewer.root);
    } else {  // one for all that pass
      const row = place.parentElement;
      row.parentElement.querySelectorAll(":scope > .viewer [data-do=close]").forEach((button) => button.click());
      row.after(viewer.root);
      viewer.root.prepend(element("p", { class: "title" }, name));
    }
    for (const part of static_) part.hidden = true;
    viewer.paint();
    if (at) viewer.select(...at);
    if (focus) viewer.stage.focus();
  }

  const places = [...document.querySelectorAll("[data-viewer]")];
  for (const place of places) {
    const button = element("button", { type: "button", class: "open" });
    button.addEventListener("click", () => open(place));
    if (place.matches(".pictures")) {
      button.append("Inspect the pixels");
      place.before(button);
      for (const frame of place.querySelectorAll(".frame"))
        frame.addEventListener("click", (event) => {
          event.preventDefault();
          const box = frame.getBoundingClientRect(), { width, height } = data.checks[place.dataset.viewer];
          const inside = event.detail > 0;  // not by the keyboard
          open(place, inside && [Math.floor((event.clientX - box.left) / box.width * width),
            Math.floor((event.clientY - box.top) / box.height * height)]);
        });
    } else {
      const image = place.querySelector("img");
      button.setAttribute("aria-label", `Inspect the pixels of ${place.dataset.name}`);
      image.before(button);
      button.append(image);
    }
  }
  // The one that the address names, or the first that failed, is open from the start.
  const named = location.hash && document.getElementById(location.hash.slice(1))?.querySelector(".pictures[data-viewer]");
  const first = named || places.find((place) => place.matches(".pictures"));
  if (first) open(first, null, false);
})();
