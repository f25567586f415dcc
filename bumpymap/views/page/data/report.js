"use strict";
(() => {
  const data = JSON.parse(document.getElementById("report-data").textContent);
  const codes = data.codes;
  const NONE = 255;
  const LINES = 8;
  const PAPER_MM = [178, 125];
  const PAPER_DENSE = 3;
  const MM = 96 / 25.4;
  const AXES = ["N-S", "NNE-SSW", "NE-SW", "ENE-WSW", "E-W", "ESE-WNW", "SE-NW", "SSE-NNW"];
  const BLACK = [0, 0, 0, 255];

  const unpack = async (text) => {
    const packed = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
    const plain = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
    return new Uint8Array(await new Response(plain).arrayBuffer());
  };

  const picture = (uri) => new Promise((resolve, reject) => {
    const image = new Image();
    image.onload = () => resolve(image);
    image.onerror = reject;
    image.src = uri;
  });

  /** The colours of 255 steps, mixed between those of a ramp. */
  const ramp = (texts) => {
    const shades = texts.map((text) => [1, 3, 5].map((at) => parseInt(text.slice(at, at + 2), 16)));
    return Array.from({ length: 255 }, (_, code) => {
      const at = (code / 254) * (shades.length - 1);
      const low = Math.min(Math.floor(at), shades.length - 2);
      return [...shades[low].map((value, i) => value + (at - low) * (shades[low + 1][i] - value)), 255];
    });
  };

  /** A canvas with one pixel for each byte of a grid; colour gives [red, green, blue, alpha] of an index, or null. */
  const paint = (rows, cols, colour) => {
    const canvas = document.createElement("canvas");
    canvas.width = cols;
    canvas.height = rows;
    const context = canvas.getContext("2d");
    const image = context.createImageData(cols, rows);
    for (let at = 0; at < rows * cols; at += 1) {
      const found = colour(at);
      if (found) image.data.set(found, 4 * at);
    }
    context.putImageData(image, 0, 0);
    return canvas;
  };

  const hatching = (context, colour, rising) => {
    const side = LINES;
    const canvas = document.createElement("canvas");
    canvas.width = canvas.height = side;
    const pen = canvas.getContext("2d");
    pen.strokeStyle = colour;
    pen.lineWidth = 1.3;
    for (const shift of [-side, 0, side]) {
      pen.beginPath();
      pen.moveTo(shift, rising ? side : 0);
      pen.lineTo(shift + side, rising ? 0 : side);
      pen.stroke();
    }
    return context.createPattern(canvas, "repeat");
  };

  const nice = (metres) => {
    const power = 10 ** Math.floor(Math.log10(metres));
    return [5, 2, 1].map((digit) => digit * power).find((length) => length <= metres) ?? power;
  };

  const grouped = (value, decimals = 0) =>
    value.toLocaleString("en", { minimumFractionDigits: decimals, maximumFractionDigits: decimals });

  class ReportMap {
    static async of(figure, about) {
      // A page of what has changed has neither bars nor objects.
      const [ground, barred, objects, relief, photo, headings, ...values] = await Promise.all([
        unpack(about.ground), about.barred && unpack(about.barred), about.objects && unpack(about.objects.codes),
        about.relief && picture(about.relief), about.photo && picture(about.photo), about.headings && unpack(about.headings.codes),
        ...about.grids.map((grid) => unpack(grid.codes)),
      ]);
      return new ReportMap(figure, about, { ground, barred, objects, relief, photo, headings, values });
    }

    constructor(figure, about, content) {
      this.about = about;
      Object.assign(this, content);
      this.figure = figure;
      this.canvas = figure.querySelector("canvas");
      this.readout = figure.querySelector(".readout");
      this.context = this.canvas.getContext("2d");
      this.paper = document.createElement("img");
      this.paper.className = "paper";
      this.paper.alt = this.figure.querySelector(".still").alt;
      this.canvas.after(this.paper);
      this.layers = {};
      this.pointers = new Map();
      this.masks = {
        objects: this.objects && paint(about.objects.rows, about.objects.cols, (at) => {
          const code = this.objects[at];
          return (code === 1 || code === 2) && codes.objectColours[code];
        }),
      };
      figure.classList.add("live");
      this.canvas.hidden = false;
      figure.querySelector(".scale").classList.add("on");
      this.listen();
      this.resize();
      this.showAll();
    }

    tiles(colour) {
      return paint(this.about.rows, this.about.cols, colour);
    }

    /** Ground of which too little was seen has a class, and shows none: it must not look drivable. */
    isUnknown(at, key) {
      return this.ground[at] !== NONE && (this.ground[at] >= codes.unknownFrom
        || (this.barred !== undefined && key !== "barred" && this.barred[at] === codes.littleSeen));
    }

    layer(key) {
      if (!(key in this.layers)) this.layers[key] = this.tiles(this.colouring(key));
      return this.layers[key];
    }

    colouring(key) {
      const known = (colour) => (at) => this.ground[at] !== NONE && !this.isUnknown(at, key) && colour(at);
      if (key === "changes alone") return known((at) => this.ground[at] && codes.classColours[this.ground[at]]);
      if (key === "class" || key === "changed") return known((at) => codes.classColours[this.ground[at]]);
      if (key === "barred") return known((at) => codes.barredColours[this.barred[at]]);
      if (key === "none") return known(() => [236, 236, 236, 255]);
      const values = this.valuesOf(key);
      const table = ramp(this.about.ramps?.[key] ?? codes.ramp);
      // Ground whose value is not known is not given one: white, not the colour of the least.
      return known((at) => (values[at] === NONE ? [225, 225, 225, 255] : table[values[at]]));
    }

    valuesOf(key) {
      return this.values[this.about.grids.findIndex((grid) => grid.key === key)];
    }

    /** What is hatched: ground that is not known and, among differences, what has none, since white means no difference. */
    unknownIn(key) {
      const values = this.about.differences && this.valuesOf(key);
      return (at) => this.isUnknown(at, key) || (values && this.ground[at] !== NONE && values[at] === NONE);
    }

    get chosen() {
      return this.figure.querySelector("input[type=radio]:checked").value;
    }

    get strength() {
      return (this.figure.querySelector("input[type=range]")?.value ?? 100) / 100;
    }

    shows(key) {
      return this.figure.querySelector(`input[type=checkbox][value=${key}]`)?.checked ?? false;
    }

    show() {
      for (const legend of this.figure.querySelectorAll(".legend[data-of]")) legend.hidden = legend.dataset.of !== this.chosen;
      this.draw();
    }

    listen() {
      const { canvas, figure } = this;
      figure.querySelector(".controls").addEventListener("input", ({ target }) => {
        const strength = figure.querySelector("input[type=range]");
        if (target.value === "photo" && strength) strength.value = target.checked ? strength.dataset.photo : 100;
        this.show();
      });
      figure.querySelector(".zoom").addEventListener("click", (event) => {
        const action = event.target.value;
        if (action === "all") this.showAll();
        else if (action) this.zoom(action === "in" ? 1.6 : 1 / 1.6);
      });
      canvas.addEventListener("keydown", (event) => this.key(event));
      canvas.addEventListener("blur", () => { this.crosshair = false; this.draw(); });
      canvas.addEventListener("wheel", (event) => {
        if (document.activeElement !== canvas && !event.ctrlKey) return;  // else the page scrolls
        event.preventDefault();
        this.zoom(Math.exp(-event.deltaY * (event.deltaMode ? 0.05 : 0.0018)), this.at(event));
      }, { passive: false });
      canvas.addEventListener("pointerdown", (event) => {
        canvas.setPointerCapture(event.pointerId);
        this.pointers.set(event.pointerId, this.at(event));
        this.read(this.at(event));
      });
      canvas.addEventListener("pointermove", (event) => this.move(event));
      for (const end of ["pointerup", "pointercancel"]) {
        canvas.addEventListener(end, (event) => this.pointers.delete(event.pointerId));
      }
      new ResizeObserver(() => { if (!this.paperScale) { this.resize(); this.draw(); } }).observe(canvas.parentElement);
      window.addEventListener("beforeprint", () => this.toPaper());
      window.addEventListener("afterprint", () => this.toScreen());
    }

    at(event) {
      const box = this.canvas.getBoundingClientRect();
      return [event.clientX - box.left, event.clientY - box.top];
    }

    move(event) {
      const now = this.at(event);
      this.crosshair = false;
      const before = this.pointers.get(event.pointerId);
      if (before) {
        const others = [...this.pointers].filter(([id]) => id !== event.pointerId).map(([, place]) => place);
        this.pan(now[0] - before[0], now[1] - before[1], others.length ? 0.5 : 1);
        if (others.length) {
          const length = (place) => Math.hypot(place[0] - others[0][0], place[1] - others[0][1]);
          this.zoom(length(now) / Math.max(length(before), 1), now.map((value, i) => (value + others[0][i]) / 2));
        }
        this.pointers.set(event.pointerId, now);
      }
      this.read(now);
    }

    key(event) {
      const steps = { ArrowLeft: [1, 0], ArrowRight: [-1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
      if (event.ctrlKey || event.metaKey || event.altKey) return;
      if (event.key in steps) this.pan(...steps[event.key].map((step) => step * 60), 1);
      else if (event.key === "+" || event.key === "=") this.zoom(1.6);
      else if (event.key === "-") this.zoom(1 / 1.6);
      else if (event.key === "0" || event.key === "Home") this.showAll();
      else return;
      event.preventDefault();
      this.crosshair = true;
      this.read([this.width / 2, this.height / 2]);
      this.draw();
    }

    resize() {
      const box = this.canvas.parentElement;
      const dense = window.devicePixelRatio || 1;
      this.width = box.clientWidth;
      this.height = box.clientHeight;
      this.dense = dense;
      this.canvas.width = Math.round(this.width * dense);
      this.canvas.height = Math.round(this.height * dense);
      this.unknownPattern = hatching(this.context, "#5b5b5b", true);
      this.barredPattern = hatching(this.context, "#111", false);
      if (this.atAll) this.fit();
    }

    /**
     * Draw the whole map at a round scale as a picture for a sheet of A4, to which the print style gives the same room:
     * Chromium prints a canvas that is drawn now a little smaller than its box.
     */
    toPaper() {
      const { about, canvas } = this;
      const sheet = document.createElement("canvas");
      [sheet.width, sheet.height] = PAPER_MM.map((side) => Math.round(side * MM * PAPER_DENSE));
      const screen = [canvas, this.width, this.height, this.dense, this.scale, this.middle];
      const [wide, high] = PAPER_MM;
      const least = Math.max((about.width * 1000) / wide, (about.height * 1000) / high);
      const power = 10 ** Math.floor(Math.log10(least));
      this.paperScale = [1, 1.5, 2, 2.5, 3, 4, 5, 7.5, 10].map((digit) => digit * power).find((scale) => scale >= least);
      this.use(sheet, wide * MM, high * MM, PAPER_DENSE, (MM * 1000) / this.paperScale, [about.width / 2, about.height / 2]);
      this.paper.src = sheet.toDataURL();
      [this.canvas, this.width, this.height, this.dense, this.scale, this.middle] = screen;
      this.context = canvas.getContext("2d");
    }

    toScreen() {
      this.paperScale = undefined;
      this.drawScale();
    }

    use(canvas, width, height, dense, scale, middle) {
      Object.assign(this, { canvas, width, height, dense, scale, middle, context: canvas.getContext("2d") });
      this.draw();
    }

    fit() {
      const margin = 0.96;
      this.scale = margin * Math.min(this.width / this.about.width, this.height / this.about.height);
      this.middle = [this.about.width / 2, this.about.height / 2];
    }

    showAll() {
      this.atAll = true;
      this.fit();
      this.draw();
    }

    pan(right, down, part) {
      this.atAll = false;
      this.middle = [this.middle[0] - (part * right) / this.scale, this.middle[1] - (part * down) / this.scale];
      this.hold();
      this.draw();
    }

    zoom(factor, around = [this.width / 2, this.height / 2]) {
      const fixed = this.place(around);
      const whole = Math.min(this.width / this.about.width, this.height / this.about.height);
      this.scale = Math.min(Math.max(this.scale * factor, whole / 4), 200);
      const moved = this.place(around);
      this.atAll = false;
      this.middle = this.middle.map((value, i) => value + fixed[i] - moved[i]);
      this.hold();
      this.draw();
    }

    /** Keep the middle of the view on the map. */
    hold() {
      const { width, height } = this.about;
      this.middle = [Math.min(Math.max(this.middle[0], 0), width), Math.min(Math.max(this.middle[1], 0), height)];
    }

    /** Metres right of the west edge and below the north edge. */
    place([right, down]) {
      return [
        this.middle[0] + (right - this.width / 2) / this.scale,
        this.middle[1] + (down - this.height / 2) / this.scale,
      ];
    }

    read(where) {
      const [right, down] = this.place(where);
      const { about } = this;
      const east = (about.west + right) / about.unit;
      const north = (about.north - down) / about.unit;
      const words = [`E ${grouped(east, 1)}, N ${grouped(north, 1)}`, ...this.degreesAt(right, down)];
      const col = Math.floor(right / about.metres);
      const row = Math.floor(down / about.metres);
      const inside = col >= 0 && row >= 0 && col < about.cols && row < about.rows;
      const at = row * about.cols + col;
      const code = inside ? this.ground[at] : NONE;
      if (code === NONE) {
        words.push(codes.outside ?? "no points: not known");
      } else {
        const name = this.about.differences ? codes.classes[code] : `class ${code} ${codes.classes[code]}`;
        words.push(code < codes.unknownFrom ? name : this.about.differences ? codes.reasons[0]
          : `not known: ${codes.reasons[code - codes.unknownFrom]}`);
        about.grids.forEach((grid, number) => {
          const found = this.values[number][at];
          if (found === NONE) return;
          const plain = grid.low + grid.step * found;
          const value = grid.scale === "log" ? Math.exp(plain) : grid.scale === "root" ? plain * Math.abs(plain) : plain;
          const sign = grid.scale === "root" && value > 0 ? "+" : "";
          words.push(`${grid.label} ${sign}${grouped(value, grid.decimals).replace(/^-(?=[0.]*$)/, "")}${grid.unit === "°" ? "°" : grid.unit && ` ${grid.unit}`}`);
        });
        const rides = this.ridesAt(at);
        if (rides) words.push(this.headingWords(rides));
        const bar = this.barred?.[at];
        if (this.barred && code < codes.unknownFrom) {
          if (bar === codes.littleSeen) words.push(`not known whether the vehicle can cross it: ${codes.barred[bar]}`);
          else words.push(bar ? `not passable: ${codes.barred[bar]}` : "passable");
        }
        const object = this.objects && this.objectAt(right, down);
        if (object === 1 || object === 2) words.push(codes.objects[object]);
      }
      if (this.headings) this.drawRose(code === NONE ? null : this.ridesAt(at));
      const stretch = this.shows("stretches") && this.stretchAt(right, down);
      if (stretch) words.push(stretch.text);
      this.readout.textContent = words.join(" · ");
    }

    /** Latitude and longitude, between those of the corners of the map; nothing if they are not known. */
    degreesAt(right, down) {
      const corners = this.about.degrees;
      if (!corners) return [];
      const [x, y] = [right / this.about.width, down / this.about.height];
      const [lon, lat] = [0, 1].map((axis) => {
        const [nw, ne, sw, se] = corners.map((corner) => corner[axis]);
        return (nw + x * (ne - nw)) * (1 - y) + (sw + x * (se - sw)) * y;
      });
      return [`${Math.abs(lat).toFixed(6)}° ${lat < 0 ? "S" : "N"}, ${Math.abs(lon).toFixed(6)}° ${lon < 0 ? "W" : "E"}`];
    }

    /** C_r along eight axes and that of the tile, rad/m; null where they are not known. */
    ridesAt(at) {
      const { headings: about, rows, cols, grids } = this.about;
      const mean = this.valuesOf("c_r")?.[at];
      if (!this.headings || mean === NONE || this.headings[at] === NONE) return null;
      const { low, step } = grids.find((grid) => grid.key === "c_r");
      const own = Math.exp(low + step * mean);
      const axes = AXES.map((_, axis) => own * Math.exp(about.step * (this.headings[axis * rows * cols + at] - about.even)));
      return { own, axes, least: Math.min(...axes), most: Math.max(...axes) };
    }

    headingWords({ axes, least, most }) {
      const name = (value) => `${AXES[axes.indexOf(value)]} (${grouped(value, 3)})`;
      return `calmest along ${name(least)}, roughest along ${name(most)}`;
    }

    drawRose(rides) {
      const rose = this.figure.querySelector(".rose");
      rose.toggleAttribute("hidden", !rides);
      if (!rides) return;
      const points = [...rides.axes, ...rides.axes].map((value, at) => {
        const [turn, far] = [(at * Math.PI) / AXES.length, (48 * value) / rides.most];
        return `${(52 + far * Math.sin(turn)).toFixed(1)},${(52 - far * Math.cos(turn)).toFixed(1)}`;
      });
      rose.querySelector("polygon").setAttribute("points", points.join(" "));
      rose.querySelector(".mean").setAttribute("r", ((48 * rides.own) / rides.most).toFixed(1));
    }

    /** The stretch of a drive whose mark lies there, the nearest one. */
    stretchAt(right, down) {
      const { about } = this;
      const far = ({ east, north }) => Math.hypot(east - about.west - right, about.north - north - down) * this.scale;
      const near = about.stretches.filter((stretch) => far(stretch) < 12);
      return near.length ? near.reduce((one, other) => (far(other) < far(one) ? other : one)) : undefined;
    }

    objectAt(right, down) {
      const { rows, cols } = this.about.objects;
      const { metres } = this.about;
      const col = Math.floor((right / (this.about.cols * metres)) * cols);
      const row = Math.floor((down / (this.about.rows * metres)) * rows);
      return this.objects[row * cols + col];
    }

    draw() {
      if (!this.canvas.width || !this.canvas.height) return;  // not laid out yet
      const { context, about, dense } = this;
      this.canvas.classList.toggle("moved", !this.atAll);
      context.setTransform(1, 0, 0, 1, 0, 0);
      context.fillStyle = "#fff";
      context.fillRect(0, 0, this.canvas.width, this.canvas.height);
      const left = (this.width / 2 - this.middle[0] * this.scale) * dense;
      const top = (this.height / 2 - this.middle[1] * this.scale) * dense;
      const box = [left, top, about.cols * about.metres * this.scale * dense, about.rows * about.metres * this.scale * dense];
      const layer = (canvas) => context.drawImage(canvas, ...box);
      const sharp = box[2] > about.cols;
      context.imageSmoothingEnabled = !sharp;
      const onPhoto = this.photo && this.shows("photo");
      if (onPhoto) {
        context.imageSmoothingEnabled = true;
        layer(this.photo);
        context.imageSmoothingEnabled = !sharp;
      }
      context.globalAlpha = this.strength;
      if (!onPhoto || this.chosen !== "none") {
        layer(this.layer(onPhoto && this.chosen === "changed" ? "changes alone" : this.chosen));
        context.imageSmoothingEnabled = false;
        context.drawImage(...this.worst("unknown", box));
      }
      context.globalAlpha = 1;
      if (this.shows("relief")) {
        context.globalCompositeOperation = "multiply";
        context.imageSmoothingEnabled = true;
        layer(this.relief);
        context.imageSmoothingEnabled = !sharp;
        context.globalCompositeOperation = "source-over";
      }
      if (this.shows("objects")) layer(this.masks.objects);
      this.hatch(...this.worst("unknown", box), this.unknownPattern);
      if (this.shows("barred")) this.drawBarred(box);
      this.white(box);
      if (this.shows("grid")) this.drawGrid(left, top);
      if (this.shows("ways")) this.drawWays(left, top);
      if (this.shows("stretches")) this.drawStretches(left, top);
      if (this.shows("places")) this.drawPlaces(left, top);
      if (this.crosshair) this.drawCrosshair();
      this.drawScale();
    }

    /** Ground without points stays white, whatever the relief says. */
    white(box) {
      this.blank ??= this.tiles((at) => this.ground[at] === NONE && [255, 255, 255, 255]);
      this.context.drawImage(this.blank, ...box);
    }

    /** Lines over what is not passable; where tiles are so small that lines would miss some, all of it is dark. */
    drawBarred(box) {
      const { context } = this;
      if (this.about.metres * this.scale >= LINES) {
        this.hatch(...this.worst("barred", box), this.barredPattern);
        return;
      }
      context.globalAlpha = this.photo && this.shows("photo") ? 0.35 : 0.6;
      context.imageSmoothingEnabled = false;
      context.drawImage(...this.worst("barred", box));
      context.globalAlpha = 1;
    }

    /**
     * A mask and its box. Where a pixel of the screen spans several tiles, those of the mask are as large: each is set
     * if one of its tiles is, so that no tile is skipped.
     */
    worst(key, box) {
      const { rows, cols } = this.about;
      const step = Math.max(1, Math.ceil(cols / box[2]));
      const [high, wide] = [Math.ceil(rows / step), Math.ceil(cols / step)];
      const name = `${key} ${this.about.differences || this.chosen === "barred" ? this.chosen : ""} ${step}`;
      if (!(name in this.masks)) {
        const isOn = key === "unknown" ? this.unknownIn(this.chosen) : (at) => barredCode(this.barred[at]);
        const found = new Uint8Array(high * wide);
        for (let at = 0; at < rows * cols; at += 1) {
          if (isOn(at)) found[Math.floor(at / cols / step) * wide + Math.floor((at % cols) / step)] = 1;
        }
        const colour = key === "unknown" ? codes.unknownColour : BLACK;
        this.masks[name] = paint(high, wide, (at) => found[at] && colour);
      }
      return [this.masks[name], box[0], box[1], (box[2] * wide * step) / cols, (box[3] * high * step) / rows];
    }

    hatch(mask, left, top, width, height, pattern) {
      const over = (this.over ??= document.createElement("canvas"));
      over.width = this.canvas.width;
      over.height = this.canvas.height;
      const pen = over.getContext("2d");
      pen.imageSmoothingEnabled = false;
      pen.drawImage(mask, left, top, width, height);
      pen.globalCompositeOperation = "source-in";
      pen.fillStyle = pattern;
      pen.fillRect(0, 0, over.width, over.height);
      this.context.drawImage(over, 0, 0);
    }

    /** Lines of round coordinates of the CRS, named where they leave the map above and on the left. */
    drawGrid(left, top) {
      const { context, about, dense } = this;
      const scale = (this.scale * about.unit) * dense;
      const step = nice((2.2 * 110 * dense) / scale);
      const [west, north] = [about.west / about.unit - left / scale, about.north / about.unit + top / scale];
      const { width, height } = this.canvas;
      const line = (from, to) => {
        context.lineWidth = dense;
        for (const [colour, shift] of [["#ffffff99", 0], ["#1f293799", dense]]) {
          context.strokeStyle = colour;
          context.beginPath();
          context.moveTo(from[0] + shift, from[1] + shift);
          context.lineTo(to[0] + shift, to[1] + shift);
          context.stroke();
        }
      };
      for (let east = Math.ceil(west / step) * step; (east - west) * scale < width; east += step) {
        const x = (east - west) * scale;
        line([x, 0], [x, height]);
        if (x > 60 * dense && x < width - 150 * dense) this.write(`E ${grouped(east)}`, x + 4 * dense, 15 * dense);
      }
      for (let up = Math.floor(north / step) * step; (north - up) * scale < height; up -= step) {
        const y = (north - up) * scale;
        line([0, y], [width, y]);
        if (y > 70 * dense && y < height - 60 * dense) this.write(`N ${grouped(up)}`, 4 * dense, y - 4 * dense);
      }
    }

    drawWays(left, top) {
      const { context, about, dense } = this;
      const on = ([east, north]) => [
        left + (east - about.west) * this.scale * dense,
        top + (about.north - north) * this.scale * dense,
      ];
      context.lineJoin = context.lineCap = "round";
      for (const way of about.ways) {
        for (const line of way.lines) {
          for (const [colour, width] of [["#fff", 7], ["#d60093", 3.5]]) {
            context.strokeStyle = colour;
            context.lineWidth = width * dense;
            context.beginPath();
            line.forEach((corner) => context.lineTo(...on(corner)));
            context.stroke();
          }
        }
        const others = about.ways.filter((other) => other !== way).flatMap((other) => other.lines.flat());
        if (others.length) {
          // Its letter stands where it is farthest from the others.
          const apart = ([east, north]) => Math.min(...others.map((corner) => Math.hypot(corner[0] - east, corner[1] - north)));
          way.marked ??= way.lines.flat().reduce((one, other) => (apart(other) > apart(one) ? other : one));
          const [x, y] = on(way.marked);
          this.write(way.name, x + 6 * dense, y - 6 * dense);
        }
        this.label("start", on(way.lines[0][0]));
        this.label("goal", on(way.lines.at(-1).at(-1)));
      }
    }

    /** A disc for each stretch of a drive; what errors do not explain is larger and lies on top. */
    drawStretches(left, top) {
      const { context, about, dense } = this;
      const ordered = [...about.stretches].sort((one, other) => one.off - other.off);
      for (const { east, north, kind, off } of ordered) {
        const [red, green, blue] = codes.offColours[kind];
        context.fillStyle = `rgb(${red} ${green} ${blue})`;
        context.strokeStyle = "#1c1e22";
        context.lineWidth = (off ? 2.2 : 1.2) * dense;
        context.beginPath();
        const x = left + (east - about.west) * this.scale * dense;
        const y = top + (about.north - north) * this.scale * dense;
        context.arc(x, y, (off ? 7 : 4.5) * dense, 0, 2 * Math.PI);
        context.fill();
        context.stroke();
      }
    }

    /** A frame around each place, so that it is seen however small it is; its number where no larger place has one. */
    drawPlaces(left, top) {
      const { context, about, dense } = this;
      const taken = [];
      for (const { name, east, north, size } of about.places) {
        const [width, height] = size.map((metres) => Math.max(14, metres * this.scale + 8) * dense);
        const x = left + (east - about.west) * this.scale * dense - width / 2;
        const y = top + (about.north - north) * this.scale * dense - height / 2;
        for (const [colour, line] of [["#fff", 4], ["#1f2937", 1.6]]) {
          context.strokeStyle = colour;
          context.lineWidth = line * dense;
          context.strokeRect(x, y, width, height);
        }
        const [right, foot] = [x + width + 4 * dense, y + 6 * dense];
        const near = ([other, line]) => Math.abs(other - right) < 30 * dense && Math.abs(line - foot) < 14 * dense;
        if (taken.some(near)) continue;
        taken.push([right, foot]);
        this.write(name, right, foot);
      }
    }

    write(text, x, y) {
      const { context, dense } = this;
      context.font = `600 ${13 * dense}px system-ui, sans-serif`;
      context.lineWidth = 4 * dense;
      context.strokeStyle = "#fff";
      context.fillStyle = "#1f2937";
      context.strokeText(text, x, y);
      context.fillText(text, x, y);
    }

    label(text, [x, y]) {
      const { context, dense } = this;
      context.lineWidth = 4 * dense;
      context.strokeStyle = "#fff";
      context.fillStyle = "#1f2937";
      context.beginPath();
      context.arc(x, y, 5 * dense, 0, 2 * Math.PI);
      context.stroke();
      context.fill();
      this.write(text, x + 9 * dense, y + 5 * dense);
    }

    drawCrosshair() {
      const { context, dense } = this;
      const [x, y] = [(this.width / 2) * dense, (this.height / 2) * dense];
      for (const [colour, width] of [["#fff", 5], ["#111", 2]]) {
        context.strokeStyle = colour;
        context.lineWidth = width * dense;
        context.beginPath();
        for (const [right, down] of [[1, 0], [-1, 0], [0, 1], [0, -1]]) {
          context.moveTo(x + 4 * right * dense, y + 4 * down * dense);
          context.lineTo(x + 14 * right * dense, y + 14 * down * dense);
        }
        context.stroke();
      }
    }

    drawScale() {
      const length = nice(Math.min(this.width * 0.3, 180) / this.scale);
      this.figure.querySelector(".scale .bar").style.width = `${length * this.scale}px`;
      const text = length >= 1000 ? `${grouped(length / 1000)} km` : `${length >= 1 ? grouped(length) : grouped(length, 2)} m`;
      this.figure.querySelector(".scale .length").textContent =
        text + (this.paperScale ? `, 1 : ${grouped(this.paperScale)} on A4` : "");
    }
  }

  const barredCode = (code) => ![0, codes.unknown, codes.littleSeen, NONE].includes(code);

  const start = async () => {
    const figures = [...document.querySelectorAll("figure.map")];
    const maps = await Promise.all(figures.map((figure, at) => ReportMap.of(figure, data.maps[at])));
    document.documentElement.dataset.ready = "yes";
    window.reportMaps = maps;
  };

  // An old browser keeps the still picture.
  if (typeof DecompressionStream === "function") start();
})();
