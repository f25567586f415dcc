"use strict";
(() => {
  const data = JSON.parse(document.getElementById("report-data").textContent);
  const codes = data.codes;
  const NONE = 255;
  const PAPER_MM = [178, 150];
  const PAPER_DENSE = 3;
  const MM = 96 / 25.4;
  const MUTED = [128, 128, 128];
  const [STEP, REACH, BAR] = [1.6, 14, 52];
  /** Smallest side of a tile on the screen with which its obstacles are drawn: a forest of them hides the ground. */
  const OBSTACLES_FROM = 9;

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
      return shades[low].map((value, i) => value + (at - low) * (shades[low + 1][i] - value));
    });
  };

  /** A canvas with one pixel for each byte of a grid; colour gives [red, green, blue] of an index, or nothing. */
  const paint = (rows, cols, colour) => {
    const canvas = document.createElement("canvas");
    canvas.width = cols;
    canvas.height = rows;
    const context = canvas.getContext("2d");
    const image = context.createImageData(cols, rows);
    for (let at = 0; at < rows * cols; at += 1) {
      const found = colour(at);
      if (found) image.data.set([found[0], found[1], found[2], 255], 4 * at);
    }
    context.putImageData(image, 0, 0);
    return canvas;
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
      const [ground, barred, islands, objects, relief, photo, ...values] = await Promise.all([
        unpack(about.ground), about.barred && unpack(about.barred), about.islands && unpack(about.islands),
        about.objects && unpack(about.objects.codes), about.relief && picture(about.relief), about.photo && picture(about.photo),
        ...about.grids.map((grid) => unpack(grid.codes)),
      ]);
      return new ReportMap(figure, about, { ground, barred, islands, objects, relief, photo, values });
    }

    constructor(figure, about, content) {
      this.about = about;
      Object.assign(this, content);
      this.figure = figure;
      this.canvas = figure.querySelector("canvas");
      this.legends = figure.querySelector(".legends");
      this.readout = figure.querySelector(".readout");
      this.context = this.canvas.getContext("2d");
      this.paper = document.createElement("img");
      this.paper.className = "paper";
      this.paper.alt = this.figure.querySelector(".still").alt;
      this.canvas.after(this.paper);
      this.drawn = {};
      this.pointers = new Map();
      this.profiles = [...document.querySelectorAll(".profile")];
      figure.classList.add("live");
      figure.style.setProperty("--shape", about.height / about.width);
      this.canvas.hidden = false;
      if (window.matchMedia("(pointer: coarse)").matches) {
        this.readout.textContent = "Tap the map to read its values. Two fingers or a double tap zoom.";
      }
      this.listen();
      this.resize();
      this.showAll();
      this.show();
    }

    /** A canvas that is made once. */
    once(key, make) {
      return (this.drawn[key] ??= make());
    }

    tiles(colour) {
      return paint(this.about.rows, this.about.cols, colour);
    }

    /** Ground of which too little was seen has a class, and shows none: it must not look drivable. */
    isUnknown(at) {
      return this.ground[at] >= codes.unknownFrom || (this.barred && this.barred[at] === codes.littleSeen);
    }

    isClosed(at) {
      return this.barred && this.barred[at] !== 0 && this.shows("barred");
    }

    /** Ground under a grey photo: all but ground that can be driven and hangs together. */
    isMuted(at) {
      return this.barred && (this.isUnknown(at) || this.isClosed(at) || this.islands?.[at]);
    }

    /** The flat colours of the tiles. */
    flat(key) {
      return this.once(`${key} ${this.shows("barred")}`, () => {
        const colour = this.colouring(key);
        return this.tiles((at) => this.ground[at] !== NONE && colour(at));
      });
    }

    colouring(key) {
      if (key === "none") return () => [236, 236, 236];
      const values = this.valuesOf(key);
      const table = values && ramp(this.about.ramps?.[key] ?? codes.ramp);
      const own = (at) => (values ? table[values[at]] : codes.classColours[this.ground[at]]);
      const mixed = (colour) => colour.map((value, i) => codes.islandPart * value + (1 - codes.islandPart) * MUTED[i]);
      return (at) => {
        if (key === "barred") return codes.barredColours[this.barred[at]];
        if (this.isUnknown(at)) return codes.unknownColour;
        if (this.isClosed(at)) return codes.closedColour;
        const colour = own(at);
        if (!colour) return this.barred?.[at] ? codes.closedColour : codes.unknownColour;
        return this.islands?.[at] ? mixed(colour) : colour;
      };
    }

    /** The photo, grey where the ground is muted. */
    muted() {
      return this.once(`photo ${this.shows("barred")}`, () => {
        const { photo } = this;
        const canvas = Object.assign(document.createElement("canvas"), { width: photo.width, height: photo.height });
        const pen = canvas.getContext("2d");
        pen.drawImage(photo, 0, 0);
        pen.globalCompositeOperation = "saturation";
        pen.imageSmoothingEnabled = false;
        pen.drawImage(this.tiles((at) => this.isMuted(at) && MUTED), 0, 0, canvas.width, canvas.height);
        return canvas;
      });
    }

    valuesOf(key) {
      return this.values[this.about.grids.findIndex((grid) => grid.key === key)];
    }

    get chosen() {
      return this.figure.querySelector("input[type=radio]:checked").value;
    }

    shows(key) {
      return this.figure.querySelector(`input[type=checkbox][value=${key}]`)?.checked ?? false;
    }

    show() {
      for (const part of this.legends.querySelectorAll("[data-of], [data-with]")) {
        const { of, with: overlay } = part.dataset;
        part.hidden = (of && !of.split(" ").includes(this.chosen)) || (overlay && !this.shows(overlay));
      }
      if (this.atAll) this.fit();
      this.draw();
    }

    listen() {
      const { canvas, figure } = this;
      const layers = figure.querySelector(".layers");
      layers.addEventListener("input", () => this.show());
      layers.addEventListener("keydown", (event) => { if (event.key === "Escape") layers.open = false; });
      figure.querySelector(".zoom").addEventListener("click", (event) => {
        const action = event.target.value;
        if (action === "all") this.showAll();
        else if (action) this.zoom(action === "in" ? STEP : 1 / STEP);
      });
      canvas.addEventListener("keydown", (event) => this.key(event));
      canvas.addEventListener("blur", () => { this.crosshair = false; this.draw(); });
      canvas.addEventListener("wheel", (event) => {
        const idle = event.timeStamp - (this.wheeled ?? -1e6) > 400;
        if (this.atAll && event.deltaY > 0 && idle) return;  // the whole map is seen: the page scrolls
        event.preventDefault();
        this.wheeled = event.timeStamp;
        const step = event.deltaMode ? 0.05 : event.ctrlKey ? 0.01 : 0.0018;
        this.zoom(Math.exp(-event.deltaY * step), this.at(event));
      }, { passive: false });
      canvas.addEventListener("touchmove", (event) => { if (event.touches.length > 1) event.preventDefault(); }, { passive: false });
      canvas.addEventListener("pointerdown", (event) => {
        canvas.setPointerCapture(event.pointerId);
        this.pointers.set(event.pointerId, this.at(event));
        this.pressed = this.at(event);
        this.read(this.pressed);
      });
      canvas.addEventListener("pointermove", (event) => this.move(event));
      canvas.addEventListener("pointerup", (event) => this.tap(event));
      for (const end of ["pointerup", "pointercancel"]) {
        canvas.addEventListener(end, (event) => this.pointers.delete(event.pointerId));
      }
      new ResizeObserver(() => { if (!this.paperScale) { this.resize(); this.draw(); } }).observe(canvas.parentElement);
      this.profiles.forEach((profile, way) => {
        const [chart, slider] = [profile.querySelector("svg"), profile.querySelector("input")];
        slider.addEventListener("input", () => this.mark(way, Number(slider.value)));
        chart.addEventListener("pointermove", (event) => {
          const box = chart.getBoundingClientRect();
          const { along } = this.about.ways[way].profile;
          const far = ((event.clientX - box.left) / box.width) * along.at(-1);
          this.mark(way, along.reduce((best, each, at) => (Math.abs(each - far) < Math.abs(along[best] - far) ? at : best), 0));
        });
      });
      window.addEventListener("beforeprint", () => this.toPaper());
      window.addEventListener("afterprint", () => this.toScreen());
    }

    at(event) {
      const box = this.canvas.getBoundingClientRect();
      return [event.clientX - box.left, event.clientY - box.top];
    }

    /** The second of two taps at one place zooms. */
    tap(event) {
      const [now, time] = [this.at(event), event.timeStamp];
      const apart = (place) => Math.hypot(now[0] - place[0], now[1] - place[1]);
      if (apart(this.pressed) > REACH) return;
      const again = this.tapped && time - this.tapped.time < 350 && apart(this.tapped.now) < 2 * REACH;
      if (again) this.zoom(2, now);
      this.tapped = again ? undefined : { now, time };
    }

    move(event) {
      const now = this.at(event);
      this.crosshair = false;
      const before = this.pointers.get(event.pointerId);
      // One finger over the whole map scrolls the page.
      if (before && !(this.atAll && event.pointerType === "touch" && this.pointers.size === 1)) {
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
      else if (event.key === "+" || event.key === "=") this.zoom(STEP);
      else if (event.key === "-") this.zoom(1 / STEP);
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
      if (this.atAll) this.fit();
    }

    /**
     * Draw the whole map at a round scale as a picture for a sheet of A4, to which the print style gives the same room:
     * Chromium prints a canvas that is drawn now a little smaller than its box.
     */
    toPaper() {
      const { about } = this;
      const [wide, high] = PAPER_MM;
      const canvas = document.createElement("canvas");
      [canvas.width, canvas.height] = PAPER_MM.map((side) => Math.round(side * MM * PAPER_DENSE));
      const least = Math.max((about.width * 1000) / wide, (about.height * 1000) / high);
      const power = 10 ** Math.floor(Math.log10(least));
      this.paperScale = [1, 1.5, 2, 2.5, 3, 4, 5, 7.5, 10].map((digit) => digit * power).find((scale) => scale >= least);
      const screen = { ...this };
      Object.assign(this, { canvas, context: canvas.getContext("2d"), width: wide * MM, height: high * MM, dense: PAPER_DENSE });
      Object.assign(this, { scale: (MM * 1000) / this.paperScale, middle: [about.width / 2, about.height / 2] });
      this.draw();
      this.paper.src = canvas.toDataURL();
      Object.assign(this, screen);
    }

    toScreen() {
      this.paperScale = undefined;
      this.drawScale();
    }

    /** Show the whole map beside or above the legend, where that lies over the view, else below the buttons. */
    fit() {
      const [size, view] = [[this.about.width, this.about.height], [this.width, this.height]];
      const [own, card] = [this.canvas, this.legends].map((part) => part.getBoundingClientRect());
      const isOver = card.top < own.bottom - 1;
      const bar = isOver ? 0 : BAR;
      const fits = (hidden) => Math.min((view[0] - hidden[0]) / size[0], (view[1] - bar - hidden[1]) / size[1]);
      const ways = isOver ? [[own.right - card.left, 0], [0, own.bottom - card.top]] : [[0, 0]];
      const hidden = ways.reduce((one, other) => (fits(other) > fits(one) ? other : one));
      this.scale = this.least = 0.96 * Math.max(fits(hidden), 0.75 * Math.min(view[0] / size[0], view[1] / size[1]));
      this.middle = size.map((length, i) => {
        const room = (view[i] - length * this.scale) / 2 - 8;
        return length / 2 + Math.max(0, Math.min(hidden[i] - room, room)) / this.scale;
      });
      this.middle[1] -= bar / 2 / this.scale;
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
      const scale = Math.min(this.scale * factor, 200);
      if (scale <= this.least * 1.001) return this.showAll();
      this.scale = scale;
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
      const words = [];
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
        const bar = this.barred?.[at];
        if (this.barred && code < codes.unknownFrom) {
          if (bar === codes.littleSeen) words.push(`not known whether the vehicle can cross it: ${codes.barred[bar]}`);
          else words.push(bar ? `not passable: ${codes.barred[bar]}` : this.islands?.[at] ? "passable, but an island" : "passable");
        }
        const object = this.objects && this.objectAt(right, down);
        if (object === 1 || object === 2) words.push(codes.objects[object]);
      }
      words.push(`E ${grouped((about.west + right) / about.unit, 1)}, N ${grouped((about.north - down) / about.unit, 1)}`, ...this.degreesAt(right, down));
      this.follow(right, down);
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

    /** Mark a place along a way on the map and in its profile, and say what is there; nowhere without a place. */
    mark(way, at) {
      const profile = this.about.ways[way]?.profile;
      this.profiles.forEach((figure, other) => {
        const cursor = figure.querySelector(".cursor");
        cursor.toggleAttribute("hidden", other !== way);
        if (other !== way) return;
        cursor.setAttribute("transform", `translate(${(1000 * profile.along[at]) / (profile.along.at(-1) || 1)})`);
        const slider = figure.querySelector("input");
        [slider.value, slider.ariaValueText] = [at, profile.texts[at]];
        this.readout.textContent = profile.texts[at];
      });
      this.marked = profile && [profile.east[at], profile.north[at]];
      this.draw();
    }

    /** Mark what of a way is at the pointer. */
    follow(right, down) {
      if (!this.profiles.length) return;
      let [found, least] = [[-1, 0], REACH / this.scale];
      this.about.ways.forEach(({ profile }, way) => profile?.east.forEach((east, at) => {
        const far = Math.hypot(east - this.about.west - right, this.about.north - profile.north[at] - down);
        if (this.shows("ways") && far < least) [found, least] = [[way, at], far];
      }));
      if (found[0] >= 0 || this.marked) this.mark(...found);
    }

    draw() {
      if (!this.canvas.width || !this.canvas.height) return;  // not laid out yet
      const { context, about, dense, chosen } = this;
      this.canvas.classList.toggle("moved", !this.atAll);
      this.figure.querySelector("button[value=all]").hidden = this.atAll;
      context.setTransform(1, 0, 0, 1, 0, 0);
      context.fillStyle = "#fff";
      context.fillRect(0, 0, this.canvas.width, this.canvas.height);
      const [left, top] = [this.width, this.height].map((side, i) => (side / 2 - this.middle[i] * this.scale) * dense);
      this.corner = [left, top];
      const box = [left, top, about.cols * about.metres * this.scale * dense, about.rows * about.metres * this.scale * dense];
      const layer = (image, smooth, blend = "source-over", alpha = 1) => {
        [context.imageSmoothingEnabled, context.imageSmoothingQuality] = [smooth, "high"];
        [context.globalCompositeOperation, context.globalAlpha] = [blend, alpha];
        context.drawImage(image, ...box);
        [context.globalCompositeOperation, context.globalAlpha] = ["source-over", 1];
      };
      const isSmall = box[2] < about.cols;
      layer(this.flat(chosen), isSmall);
      const solids = this.objects && this.shows("objects") && about.metres * this.scale >= OBSTACLES_FROM;
      this.legends.querySelector(".objects")?.toggleAttribute("hidden", !solids);
      if (solids) layer(this.obstacles(), box[2] < about.objects.cols);
      if (this.photo && this.shows("photo")) {
        if (chosen === "none") layer(this.photo, true);
        else layer(this.muted(), true, "hard-light", codes.strength);
      }
      if (this.relief && this.shows("relief")) layer(this.relief, true, "hard-light", codes.strength);
      // Ground without points stays white, whatever lies below it.
      layer(this.once("blank", () => this.tiles((at) => this.ground[at] === NONE && [255, 255, 255])), isSmall);
      if (this.shows("grid")) this.drawGrid(left, top);
      if (this.shows("ways")) this.drawWays();
      if (this.shows("stretches")) this.drawStretches();
      if (this.shows("places")) this.drawPlaces();
      if (this.marked) this.disc(this.on(this.marked), 7, "#fff", "#111", 3);
      if (this.crosshair) this.disc([this.canvas.width / 2, this.canvas.height / 2], 9, "#ffffff80", "#111", 2);
      this.drawScale();
    }

    obstacles() {
      const { rows, cols } = this.about.objects;
      return this.once("objects", () => paint(rows, cols, (at) => codes.solids.includes(this.objects[at]) && codes.obstacleColour));
    }

    disc(place, radius, fill, stroke, line) {
      const { context, dense } = this;
      [context.fillStyle, context.strokeStyle, context.lineWidth] = [fill, stroke, line * dense];
      context.beginPath();
      context.arc(...place, radius * dense, 0, 2 * Math.PI);
      context.fill();
      context.stroke();
    }

    /** A path in white and, narrower, in a colour. */
    cased(path, wide, colour, narrow) {
      for (const [stroke, width] of [["#fff", wide], [colour, narrow]]) {
        [this.context.strokeStyle, this.context.lineWidth] = [stroke, width * this.dense];
        this.context.stroke(path);
      }
    }

    /** Pixels right and down on the canvas. */
    on([east, north]) {
      const { about, dense, corner } = this;
      return [east - about.west, about.north - north].map((metres, i) => corner[i] + metres * this.scale * dense);
    }

    /** Lines of round coordinates of the CRS, named where they leave the map above and on the left. */
    drawGrid(left, top) {
      const { context, about, dense } = this;
      const scale = (this.scale * about.unit) * dense;
      const step = nice((2.2 * 110 * dense) / scale);
      const [west, north] = [about.west / about.unit - left / scale, about.north / about.unit + top / scale];
      const { width, height } = this.canvas;
      const lines = new Path2D();
      const names = [];
      for (let east = Math.ceil(west / step) * step; (east - west) * scale < width; east += step) {
        const x = (east - west) * scale;
        lines.rect(x, -9, 0, height + 18);
        if (x > 60 * dense && x < width - 150 * dense) names.push([`E ${grouped(east)}`, x + 4 * dense, 15 * dense]);
      }
      for (let up = Math.floor(north / step) * step; (north - up) * scale < height; up -= step) {
        const y = (north - up) * scale;
        lines.rect(-9, y, width + 18, 0);
        if (y > 70 * dense && y < height - 60 * dense) names.push([`N ${grouped(up)}`, 4 * dense, y - 4 * dense]);
      }
      this.cased(lines, 2.4, "#1f293799", 0.8);
      names.forEach((name) => this.write(...name));
    }

    drawWays() {
      const { context, about, dense } = this;
      context.lineJoin = context.lineCap = "round";
      for (const way of about.ways) {
        const path = new Path2D();
        way.lines.forEach((line) => line.forEach((corner, at) => (at ? path.lineTo(...this.on(corner)) : path.moveTo(...this.on(corner)))));
        this.cased(path, 7, `rgb(${codes.wayColour})`, 3.5);
        const others = about.ways.filter((other) => other !== way).flatMap((other) => other.lines.flat());
        if (others.length) {
          // Its letter stands where it is farthest from the others.
          const apart = ([east, north]) => Math.min(...others.map((corner) => Math.hypot(corner[0] - east, corner[1] - north)));
          way.marked ??= way.lines.flat().reduce((one, other) => (apart(other) > apart(one) ? other : one));
          const [x, y] = this.on(way.marked);
          this.write(way.name, x + 6 * dense, y - 6 * dense);
        }
        this.label("start", this.on(way.lines[0][0]));
        this.label("goal", this.on(way.lines.at(-1).at(-1)));
      }
    }

    /** A disc for each stretch of a drive; what errors do not explain is larger and lies on top. */
    drawStretches() {
      const ordered = [...this.about.stretches].sort((one, other) => one.off - other.off);
      for (const { east, north, kind, off } of ordered) {
        this.disc(this.on([east, north]), off ? 7 : 4.5, `rgb(${codes.offColours[kind].slice(0, 3)})`, "#1c1e22", off ? 2.2 : 1.2);
      }
    }

    /** A frame around each place, so that it is seen however small it is; its number where no larger place has one. */
    drawPlaces() {
      const { about, dense } = this;
      const taken = [];
      for (const { name, east, north, size } of about.places) {
        const [width, height] = size.map((metres) => Math.max(14, metres * this.scale + 8) * dense);
        const [x, y] = this.on([east, north]).map((middle, i) => middle - (i ? height : width) / 2);
        const frame = new Path2D();
        frame.rect(x, y, width, height);
        this.cased(frame, 4, "#1f2937", 1.6);
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
      this.disc([x, y], 5, "#1f2937", "#fff", 3);
      this.write(text, x + 9 * this.dense, y + 5 * this.dense);
    }

    drawScale() {
      const length = nice(Math.min(this.width * 0.3, 180) / this.scale);
      this.figure.querySelector(".scale .bar").style.width = `${length * this.scale}px`;
      const text = length >= 1000 ? `${grouped(length / 1000)} km` : `${length >= 1 ? grouped(length) : grouped(length, 2)} m`;
      this.figure.querySelector(".scale .length").textContent =
        text + (this.paperScale ? `, 1 : ${grouped(this.paperScale)} on A4` : "");
    }
  }

  const start = async () => {
    const figures = [...document.querySelectorAll("figure.map")];
    const maps = await Promise.all(figures.map((figure, at) => ReportMap.of(figure, data.maps[at])));
    document.documentElement.dataset.ready = "yes";
    window.reportMaps = maps;
  };

  // An old browser keeps the still picture.
  if (typeof DecompressionStream === "function") start();
})();
