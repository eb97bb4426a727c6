// Strips with every sample: columns of flights over time, drawn by uPlot from a pyramid of least and greatest values.
// What the page carries is described in signals_data.py; `pageData()` reads it.
"use strict";
(() => {
  const told = JSON.parse(document.getElementById("flight-data").textContent);
  // on paper: the colours of the page's print style, which scripts do not see in time, and the width of a page
  const PAPER = { "--ink": "#000", "--dim": "#444", "--grid": "#ddd", "--card": "#fff", width: 690 };
  let printing = false;
  const style = (name) => printing && PAPER[name] || getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const element = (kind, attributes = {}, ...children) => {
    const made = document.createElement(kind);
    for (const [key, value] of Object.entries(attributes)) {
      if (key.startsWith("on")) made.addEventListener(key.slice(2), value);
      else if (value !== undefined && value !== false) made.setAttribute(key, value === true ? "" : value);
    }
    made.append(...children);
    return made;
  };

  // ---- columns

  const bytesOf = (text) => {
    const binary = atob(text);
    const bytes = new Uint8Array(binary.length);
    for (let i = 0; i < binary.length; i++) bytes[i] = binary.charCodeAt(i);
    return bytes;
  };
  const inflate = async (text) => {
    const stream = new Blob([bytesOf(text)]).stream().pipeThrough(new DecompressionStream("deflate"));
    return new Uint8Array(await new Response(stream).arrayBuffer());
  };

  // the inverse of `packed` in signals_data.py
  const unpack = async (about, rows, text) => {
    const values = new Float64Array(rows);
    if (!text) return values.fill(about.base);
    const raw = await inflate(text);
    const numbers = new Int32Array(rows);
    for (let plane = 0; plane < about.planes; plane++) {
      const from = plane * rows, shift = 8 * plane;
      for (let i = 0; i < rows; i++) numbers[i] |= raw[from + i] << shift;
    }
    for (let i = 0; i < rows; i++) numbers[i] = (numbers[i] >>> 1) ^ -(numbers[i] & 1);
    for (let turn = 0; turn < about.order; turn++) {
      for (let i = 1; i < rows; i++) numbers[i] = (numbers[i] + numbers[i - 1]) | 0;
    }
    for (let i = 0; i < rows; i++) values[i] = about.base + about.step * numbers[i];
    if (about.gaps) {
      const from = about.planes * rows;
      for (let i = 0; i < rows; i++) if (raw[from + i]) values[i] = NaN;
    }
    return values;
  };

  const FAN = 16; // rows of one level in a row of the next

  // least and greatest of any stretch of rows, in a time that does not grow with the flight
  class Pyramid {
    constructor(values) {
      this.values = values;
      this.levels = [];
      let low = values, high = values;
      while (low.length > FAN) {
        const size = Math.ceil(low.length / FAN);
        const lows = new Float64Array(size).fill(Infinity), highs = new Float64Array(size).fill(-Infinity);
        for (let i = 0; i < low.length; i++) {
          const at = (i / FAN) | 0;
          if (low[i] < lows[at]) lows[at] = low[i];
          if (high[i] > highs[at]) highs[at] = high[i];
        }
        this.levels.push([lows, highs]);
        [low, high] = [lows, highs];
      }
    }

    // of rows first to end - 1; [Infinity, -Infinity] where there is no number
    span(first, end) {
      let low = Infinity, high = -Infinity;
      const take = (level, from, to) => {
        const [lows, highs] = level < 0 ? [this.values, this.values] : this.levels[level];
        for (let i = from; i < to; i++) {
          if (lows[i] < low) low = lows[i];
          if (highs[i] > high) high = highs[i];
        }
      };
      let a = first, b = end, level = -1;
      while (b - a > 2 * FAN && level + 1 < this.levels.length) {
        const up = Math.ceil(a / FAN), down = Math.floor(b / FAN);
        take(level, a, up * FAN);
        take(level, down * FAN, b);
        [a, b] = [up, down];
        level++;
      }
      take(level, a, b);
      return [low, high];
    }
  }

  class Flight {
    constructor(about, number) {
      Object.assign(this, about);
      this.number = number;
      this.known = new Map(about.columns.map((column) => [column.name, column]));
      this.read = new Map();
      this.times = null;
    }

    get end() { return this.uniform ? (this.rows - 1) * this.step : this.times[this.rows - 1]; }

    time(row) { return this.uniform ? row * this.step : this.times[row]; }

    // the last row at or before a time; -1 before the first
    row(time) {
      if (this.uniform) return Math.min(this.rows - 1, Math.floor(time / this.step + 1e-6));
      let low = -1, high = this.rows - 1;
      while (low < high) {
        const middle = (low + high + 1) >> 1;
        if (this.times[middle] <= time + 1e-9) low = middle; else high = middle - 1;
      }
      return low;
    }

    // a column's Pyramid; null where the flight has no such column, or no number in it
    column(name) {
      const about = this.known.get(name);
      if (!about) return Promise.resolve(null);
      if (!this.read.has(name)) {
        const place = document.getElementById(`data-${this.number}-${about.data}`);
        const work = unpack(about, this.rows, place ? place.textContent : "").then((values) => {
          const made = new Pyramid(values);
          made.about = about;
          this.read.set(name, made);
          return made;
        });
        this.read.set(name, work);
      }
      return Promise.resolve(this.read.get(name));
    }

    // a value that is there already; NaN if not
    at(name, row) {
      const column = this.read.get(name);
      return column instanceof Pyramid && row >= 0 ? column.values[row] : NaN;
    }
  }

  const flights = told.runs.map((about, number) => new Flight(about, number));

  // ---- time: one cursor, one window, for picture and all strips

  const state = { t: 0, from: 0, to: 1, marks: [null, null], listeners: [], views: [] };
  state.end = 1;
  const heard = (list, ...what) => list.forEach((each) => each(...what));
  const setTime = (t, source) => {
    state.t = Math.max(0, Math.min(state.end, t));
    heard(state.listeners, source);
  };
  const setView = (from, to) => {
    const least = 4 * Math.min(...flights.map((flight) => flight.step || 1e-3));
    if (to - from < least) [from, to] = [(from + to - least) / 2, (from + to + least) / 2];
    const span = Math.min(to - from, state.end);
    from = Math.max(0, Math.min(from, state.end - span));
    [state.from, state.to] = [from, from + span];
    heard(state.views);
  };
  const zoom = (factor, about = state.t) => {
    const at = about < state.from || about > state.to ? (state.from + state.to) / 2 : about;
    setView(at - (at - state.from) * factor, at + (state.to - at) * factor);
  };
  const setMark = (which) => {
    state.marks[which] = state.marks[which] === null || state.marks[which] !== state.t ? state.t : null;
    heard(state.listeners, "marks");
    heard(state.views);
  };

  // ---- what is drawn of a window: every sample where there is room, least and greatest of a pixel where not

  const ROOM = 3; // samples a pixel that are still drawn one by one

  const windowOf = (lines, from, to, pixels) => {
    const base = lines.map((line) => line.flight).sort((a, b) => (a.step || 1) - (b.step || 1))[0];
    if (!base || !base.rows) return [[0], ...lines.map(() => [null])];
    const last = Math.max(...lines.map((line) => line.flight.rows && line.flight.end));
    const own = lines.every((line) => line.flight.uniform && line.flight.step === base.step);
    const longest = own ? lines.map((line) => line.flight).sort((a, b) => b.rows - a.rows)[0] : base;
    const first = Math.max(0, longest.row(from)), end = Math.min(longest.rows, longest.row(to) + 2);
    if (end - first <= ROOM * pixels && (own || last <= base.end + 1e-9)) {
      const x = new Float64Array(Math.max(1, end - first));
      for (let i = 0; i < x.length; i++) x[i] = longest.time(first + i);
      return [x, ...lines.map((line) => {
        const y = new Array(x.length), values = line.column.values, scale = line.scale;
        for (let i = 0; i < x.length; i++) {
          const row = own ? first + i : line.flight.row(x[i]);
          const value = row >= 0 && row < values.length && x[i] <= line.flight.end + 1e-9 ? values[row] : NaN;
          y[i] = Number.isNaN(value) ? null : scale * value;
        }
        return y;
      })];
    }
    const buckets = Math.max(2, pixels), width = (to - from) / buckets;
    const x = new Float64Array(2 * buckets);
    const all = lines.map(() => new Array(2 * buckets));
    for (let i = 0; i < buckets; i++) {
      x[2 * i] = from + (i + 0.25) * width;
      x[2 * i + 1] = from + (i + 0.75) * width;
      for (let n = 0; n < lines.length; n++) {
        const { flight, column, scale } = lines[n];
        let a = flight.row(from + i * width) + 1, b = flight.row(from + (i + 1) * width) + 1;
        if (i === 0) a = Math.max(0, a - 1);
        if (b <= a) { a = b - 1; if (from + i * width > flight.end) a = b = -1; }
        const [low, high] = a < 0 ? [Infinity, -Infinity] : column.span(a, b);
        const none = low > high;
        const falling = !none && column.values[a] > column.values[b - 1];
        all[n][2 * i] = none ? null : scale * (falling !== scale < 0 ? high : low);
        all[n][2 * i + 1] = none ? null : scale * (falling !== scale < 0 ? low : high);
      }
    }
    return [x, ...all];
  };

  // ---- a panel

  // panels are drawn when they come near; the others when nothing else is to be done, for paper and pictures of the page
  const idle = window.requestIdleCallback || ((act) => setTimeout(act, 50));
  let loaded = false, resting = true;
  const drawRest = () => {
    if (!loaded || !resting) return;
    resting = false;
    delete document.documentElement.dataset.drawn;
    idle(async () => {
      const next = [...panels].find((panel) => !panel.drawnFor);
      if (next) await next.refresh(true);
      resting = true;
      if (next) drawRest(); else document.documentElement.dataset.drawn = "all";
    });
  };

  const COLOURS = ["#2f7de1", "#f08c00", "#2f9e44", "#c2339b", "#e03131", "#7048e8", "#1098ad", "#a0522d"];
  const DASHES = { solid: [], dash: [7, 4], dot: [2, 3], dashdot: [7, 3, 2, 3] };
  const KINDS = { fault: "#e03131", monitor: "#f08c00", pilot: "#2f7de1", contact: "#2f9e44", disturbance: "#868e96" };
  const SHOWN = { rad: ["deg", 180 / Math.PI], "rad/s": ["deg/s", 180 / Math.PI] };
  const panels = new Set();
  const number = (value) => value === null || !Number.isFinite(value) ? "–"
    : Math.abs(value) >= 1e5 || (value !== 0 && Math.abs(value) < 1e-4) ? value.toExponential(3)
    : value.toPrecision(5).replace(/(\.\d*?)0+$/, "$1").replace(/\.$/, "");

  const near = new IntersectionObserver((entries) => {
    for (const entry of entries) {
      const panel = entry.target.panel;
      panel.seen = entry.isIntersecting;
      if (panel.seen) panel.refresh();
    }
  }, { rootMargin: "300px" });

  class Panel {
    // signals: {run, column, label, colour, dash, width, held, scale}
    constructor(place, { title = "", unit = "", least = 0, signals = [], mode = "time", free = false, height = 150, equal = false, group = null }) {
      Object.assign(this, { title, unit, least, mode, free, height, equal, group });
      this.signals = [];
      this.seen = false;
      this.hidden = new Set();
      this.chips = element("span", { class: "chips" });
      this.head = element("div", { class: "strip-head" },
        element("span", { class: "strip-title" }), this.chips, this.menu());
      this.body = element("div", { class: "strip-body" });
      this.cursor = element("div", { class: "strip-cursor" });
      this.root = element("div", { class: "strip", tabindex: "-1" }, this.head, this.body);
      this.root.panel = this;
      place.append(this.root);
      panels.add(this);
      if (group) group.push(this);
      near.observe(this.root);
      this.signals = signals.slice();
      this.changed();
    }

    menu() {
      const item = (text, act) => element("button", { type: "button", onclick: () => { act(); box.open = false; } }, text);
      const box = element("details", { class: "strip-menu" }, element("summary", { "aria-label": "what to do with this panel", title: "save, spectrum, cross-plot" }, "⋯"),
        element("div", {},
          item("over time", () => this.turn("time")), item("spectrum of what is seen", () => this.turn("spectrum")),
          item("cross-plot of the first two", () => this.turn("cross")),
          item("save PNG", () => this.savePng()), item("save SVG", () => this.saveSvg()), item("save CSV", () => this.saveCsv()),
          ...(this.free ? [item("remove panel", () => this.remove())] : [])));
      return box;
    }

    turn(mode) { this.mode = mode; this.changed(); }

    remove() {
      panels.delete(this);
      near.unobserve(this.root);
      if (this.chart) this.chart.destroy();
      this.root.remove();
      if (current === this) current = null;
    }

    add(signal) { this.signals.push(signal); this.changed(); }

    // what is drawn is another
    changed() {
      if (this.chart) { this.chart.destroy(); this.chart = null; }
      this.drawnFor = null;
      this.refresh();
      drawRest();
    }

    // once more of what is there, at once
    again() {
      if (!this.chart) return;
      this.chart.destroy();
      this.build();
    }

    label(signal) { return signal.label || signal.column; }

    // draws what is seen; with `unseen` in any case
    async refresh(unseen = false) {
      if (!(this.seen || unseen) || this.building) return;
      if (this.chart) { if (this.drawnFor !== this.wanted()) this.redraw(); else this.values(); return; }
      this.building = true;
      const wanted = this.signals.slice();
      const lines = [];
      for (const signal of wanted) {
        const flight = flights[signal.run || 0];
        const column = await flight.column(signal.column);
        if (column) lines.push({ ...signal, flight, column, scale: signal.scale === undefined ? 1 : signal.scale });
      }
      this.building = false;
      if (wanted.length !== this.signals.length || wanted.some((each, n) => each !== this.signals[n])) return this.refresh(unseen);
      this.lines = lines;
      this.build();
    }

    wanted() { return `${state.from} ${state.to} ${this.width()} ${state.marks}`; }

    width() { return printing ? PAPER.width : Math.max(120, this.body.clientWidth); }

    heading() {
      const units = this.unit || [...new Set(this.lines.map((line) => line.shown))].filter(Boolean).join(", ");
      const extra = { time: "", spectrum: ", amplitude over Hz", cross: "" }[this.mode];
      this.head.firstChild.textContent = (this.title ? this.title + " " : "") + (units ? `[${units}]` : "") + extra;
      this.chips.replaceChildren(...this.lines.map((line, n) => {
        const value = element("b", {}, "");
        const chip = element("button", { type: "button", class: "chip-line", "aria-pressed": String(this.shows(line)), title: this.about(line),
          onclick: () => { if (this.shows(line)) this.hidden.add(this.label(line)); else this.hidden.delete(this.label(line));
            if (this.chart) this.chart.setSeries(n + 1, { show: this.shows(line) });
            chip.setAttribute("aria-pressed", String(this.shows(line))); } },
        element("i", { style: `border-top:3px ${line.dash && line.dash !== "solid" ? "dashed" : "solid"} ${line.colour}` }), this.label(line), " ", value);
        line.value = value;
        if (!this.free) return chip;
        return element("span", { class: "chip-pair" }, chip, element("button", { type: "button", class: "chip-off", "aria-label": `remove ${this.label(line)}`,
          onclick: () => { this.signals = this.signals.filter((each) => !(each.column === line.column && (each.run || 0) === line.flight.number)); this.changed(); } }, "×"));
      }));
    }

    shows(line) { return !this.hidden.has(this.label(line)); }

    about(line) {
      const { about } = line.column;
      return `${about.name}${about.unit ? ` [${about.unit}]` : ""}${about.frame ? `, ${about.frame}` : ""}: ${about.meaning}. ` +
        `Drawn in steps of ${number(about.step)}; exact in the log.`;
    }

    build() {
      this.heading();
      this.body.replaceChildren();
      this.drawnFor = this.wanted();
      if (!this.lines.length) { this.body.append(element("p", { class: "dim small" }, this.free ? "Nothing in this panel yet: find a column above and add it." : "Not in this log.")); return; }
      const width = this.width();
      if (this.mode === "time") this.buildTime(width);
      else if (this.mode === "spectrum") this.buildSpectrum(width);
      else this.buildCross(width);
    }

    common(width, more) {
      const ink = style("--dim"), grid = { stroke: style("--grid"), width: 1 }, ticks = { stroke: style("--grid"), width: 1 };
      const font = `11px ${getComputedStyle(document.body).fontFamily}`;
      return { width, height: this.height, legend: { show: false }, pxAlign: 0, padding: [6, 8, 0, 0],
        axes: [{ stroke: ink, grid, ticks, font, size: 26, values: more.xValues }, { stroke: ink, grid, ticks, font, size: 58, ...more.yAxis }], ...more.options };
    }

    buildTime(width) {
      const lines = this.lines;
      const series = lines.map((line) => ({ label: this.label(line), show: this.shows(line), stroke: line.colour, width: line.width || 1.4,
        dash: DASHES[line.dash] || [], spanGaps: false,
        points: { show: (u) => { const x = u.data[0]; return x.length > 1 && x.length < u.bbox.width / devicePixelRatio / 6; }, size: 4 },
        paths: line.held ? uPlot.paths.stepped({ align: 1 }) : uPlot.paths.linear() }));
      // uPlot's steps are at most twice the least space apart: three labels stand on a sixth of the height
      const options = this.common(width, { yAxis: { space: (u, axis, low, high, size) => Math.max(13, Math.min(30, size / 6)) }, options: {
        scales: { x: { time: false, range: () => [state.from, state.to] }, y: { range: (u, low, high) => this.yRange(low, high) } },
        series: [{}, ...series],
        cursor: { y: false, points: { show: false }, drag: { x: true, y: false, setScale: false } },
        select: { show: true },
        hooks: {
          drawClear: [(u) => this.bands(u)],
          setSelect: [(u) => { if (u.select.width > 3) { const a = u.posToVal(u.select.left, "x"), b = u.posToVal(u.select.left + u.select.width, "x");
            u.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false); setView(a, b); } }],
        } } });
      this.data = windowOf(lines, state.from, state.to, width - 66);
      this.chart = new uPlot(options, this.data, this.body);
      const over = this.chart.over;
      over.append(this.cursor);
      over.addEventListener("mousemove", (event) => { if (!state.playing && !event.buttons) setTime(this.chart.posToVal(event.offsetX, "x"), this); });
      over.addEventListener("click", (event) => setTime(this.chart.posToVal(event.offsetX, "x"), this));
      over.addEventListener("dblclick", () => setView(0, state.end));
      over.addEventListener("wheel", (event) => {
        if (!event.ctrlKey && !event.shiftKey) return; // the wheel alone scrolls the page
        event.preventDefault();
        if (event.ctrlKey) zoom(event.deltaY > 0 ? 1.25 : 0.8, this.chart.posToVal(event.offsetX, "x"));
        else { const by = 0.1 * (state.to - state.from) * Math.sign(event.deltaY || event.deltaX); setView(state.from + by, state.to + by); }
      }, { passive: false });
      this.values();
    }

    yRange(low, high) {
      const own = this.group ? this.group.filter((panel) => panel.data && panel.chart).map((panel) => panel.range()) : [];
      if (this.group) for (const [a, b] of [...own, this.range()]) { low = Math.min(low === null ? a : low, a); high = Math.max(high === null ? b : high, b); }
      if (low === null || !Number.isFinite(low)) [low, high] = [0, 0];
      const margin = Math.max(0.06 * (high - low), 0.5 * ((this.least || 0) - (high - low)), 1e-9 + 1e-6 * Math.abs(high));
      return [low - margin, high + margin];
    }

    range() {
      let low = Infinity, high = -Infinity;
      for (const y of this.data.slice(1)) for (const value of y) if (value !== null) { if (value < low) low = value; if (value > high) high = value; }
      return low > high ? [0, 0] : [low, high];
    }

    redraw() {
      if (!this.chart) return;
      const width = this.width();
      if (this.mode !== "time") { if (this.drawnFor !== this.wanted()) this.changed(); return; }
      if (this.chart.width !== width) this.chart.setSize({ width, height: this.height });
      this.data = windowOf(this.lines, state.from, state.to, width - 66);
      this.chart.setData(this.data);
      this.drawnFor = this.wanted();
      this.values();
    }

    // faults, disturbances, saturation behind the lines; words of monitor and autopilot as dotted lines
    bands(u) {
      const { ctx } = u, { left, top, width, height } = u.bbox;
      const x = (t) => Math.max(left, Math.min(left + width, u.valToPos(t, "x", true)));
      ctx.save();
      for (const number of new Set(this.lines.map((line) => line.flight.number))) {
        const flight = flights[number];
        for (const event of flight.events) {
          const end = event.end === null ? state.end : event.end;
          if (event.lasts && event.banded) {
            if (end < state.from || event.t > state.to) continue;
            ctx.globalAlpha = 0.14;
            ctx.fillStyle = KINDS[event.kind];
            ctx.fillRect(x(event.t), top, Math.max(1, x(end) - x(event.t)), height);
          } else if (!event.lasts && event.t >= state.from && event.t <= state.to) {
            ctx.globalAlpha = 0.9;
            ctx.strokeStyle = KINDS[event.kind];
            ctx.lineWidth = 1.2 * devicePixelRatio;
            ctx.setLineDash([2 * devicePixelRatio, 3 * devicePixelRatio]);
            ctx.beginPath(); ctx.moveTo(x(event.t), top); ctx.lineTo(x(event.t), top + height); ctx.stroke();
          }
        }
        ctx.globalAlpha = 0.14;
        ctx.fillStyle = KINDS.disturbance;
        for (const [from, to] of flight.upsets) if (to >= state.from && from <= state.to) ctx.fillRect(x(from), top, Math.max(1, x(to) - x(from)), height);
        ctx.globalAlpha = 0.5;
        ctx.fillStyle = "#e8590c";
        for (const [from, to] of flight.saturated) {
          const end = to === null ? flight.end : to;
          if (end >= state.from && from <= state.to) ctx.fillRect(x(from), top, Math.max(1, x(end) - x(from)), 3 * devicePixelRatio);
        }
      }
      ctx.globalAlpha = 1;
      ctx.setLineDash([]);
      state.marks.forEach((mark, n) => {
        if (mark === null || mark < state.from || mark > state.to) return;
        ctx.strokeStyle = ctx.fillStyle = style("--ink");
        ctx.lineWidth = devicePixelRatio;
        ctx.beginPath(); ctx.moveTo(x(mark), top); ctx.lineTo(x(mark), top + height); ctx.stroke();
        ctx.font = `${11 * devicePixelRatio}px sans-serif`;
        ctx.fillText("AB"[n], x(mark) + 3 * devicePixelRatio, top + 11 * devicePixelRatio);
      });
      ctx.restore();
    }

    // the cursor's place and what every line is there
    values() {
      if (!this.chart || !this.lines) return;
      if (this.mode === "time") {
        const at = this.chart.valToPos(state.t, "x");
        const inside = state.t >= state.from && state.t <= state.to;
        this.cursor.style.transform = `translateX(${at}px)`;
        this.cursor.style.visibility = inside ? "visible" : "hidden";
      }
      const now = performance.now();
      if (state.playing && now - (this.told || 0) < 80) return;
      this.told = now;
      const [a, b] = state.marks;
      for (const line of this.lines) {
        const value = (t) => t > line.flight.end + 1e-9 ? NaN : line.scale * line.column.values[line.flight.row(t)];
        const apart = a !== null && b !== null ? ` (B−A ${number(value(b) - value(a))})` : "";
        line.value.textContent = number(value(state.t)) + apart;
      }
    }

    // every sample of what is seen
    seenRows(line) {
      const first = Math.max(0, line.flight.row(state.from + 1e-9)), end = Math.min(line.flight.rows, line.flight.row(state.to) + 1);
      return [first, end];
    }

    buildSpectrum(width) {
      const made = this.lines.map((line) => {
        const [first, end] = this.seenRows(line);
        return amplitudes(line.column.values.subarray(first, end), line.flight.uniform ? line.flight.step : (line.flight.time(end - 1) - line.flight.time(first)) / Math.max(1, end - first - 1), line.scale);
      });
      const table = uPlot.join(made.map(([f, a]) => [f, a]));
      const options = this.common(width, { options: {
        scales: { x: { time: false, distr: 3 }, y: { distr: 3 } },
        series: [{}, ...this.lines.map((line) => ({ label: this.label(line), show: this.shows(line), stroke: line.colour, width: 1.2, spanGaps: true, points: { show: false } }))],
        cursor: { drag: { x: false, y: false } } } });
      this.data = table;
      this.chart = new uPlot(options, table, this.body);
      this.values();
    }

    buildCross(width) {
      const pairs = this.equal ? this.lines.filter((_, n) => n % 2 === 0).map((line, n) => [line, this.lines[2 * n + 1]]) : [[this.lines[0], this.lines[1] || this.lines[0]]];
      const height = this.equal ? Math.min(width, 420) : Math.max(this.height, 260);
      const tracks = pairs.filter(([, y]) => y).map(([x, y]) => {
        const [first, end] = this.seenRows(x);
        const every = Math.max(1, Math.floor((end - first) / 200000));
        const xs = [], ys = [];
        for (let row = first; row < end; row += every) { xs.push(x.scale * x.column.values[row]); ys.push(y.scale * y.column.values[y.flight === x.flight ? row : y.flight.row(x.flight.time(row))]); }
        return { xs, ys, colour: x.colour, x, y };
      });
      const fin = (list) => list.filter(Number.isFinite);
      const span = (lists) => { let low = Infinity, high = -Infinity; for (const list of lists) for (const value of fin(list)) { low = Math.min(low, value); high = Math.max(high, value); } return low > high ? [0, 1] : [low, high]; };
      let [x0, x1] = span(tracks.map((track) => track.xs)), [y0, y1] = span(tracks.map((track) => track.ys));
      const pad = (low, high) => { const margin = Math.max(0.06 * (high - low), this.equal ? 1 - (high - low) / 2 : 1e-9 + 1e-6 * Math.abs(high)); return [low - margin, high + margin]; };
      [x0, x1] = pad(x0, x1); [y0, y1] = pad(y0, y1);
      if (this.equal) { // one scale both ways
        const w = width - 66, h = height - 32, per = Math.max((x1 - x0) / w, (y1 - y0) / h);
        const cx = (x0 + x1) / 2, cy = (y0 + y1) / 2;
        [x0, x1, y0, y1] = [cx - per * w / 2, cx + per * w / 2, cy - per * h / 2, cy + per * h / 2];
      }
      const draw = (u) => {
        const { ctx } = u;
        ctx.save();
        ctx.beginPath(); ctx.rect(u.bbox.left, u.bbox.top, u.bbox.width, u.bbox.height); ctx.clip();
        for (const track of tracks) {
          ctx.strokeStyle = ctx.fillStyle = track.colour;
          ctx.lineWidth = 1.5 * devicePixelRatio;
          ctx.beginPath();
          let pen = false;
          const px = (i) => u.valToPos(track.xs[i], "x", true), py = (i) => u.valToPos(track.ys[i], "y", true);
          for (let i = 0; i < track.xs.length; i++) {
            if (!Number.isFinite(track.xs[i]) || !Number.isFinite(track.ys[i])) { pen = false; continue; }
            if (pen) ctx.lineTo(px(i), py(i)); else ctx.moveTo(px(i), py(i));
            pen = true;
          }
          ctx.stroke();
          if (track.xs.length) {
            const dot = (i, filled) => { ctx.beginPath(); ctx.arc(px(i), py(i), 4.5 * devicePixelRatio, 0, 7); if (filled) ctx.fill(); else { ctx.fillStyle = style("--card"); ctx.fill(); ctx.fillStyle = track.colour; ctx.stroke(); } };
            dot(0, false); dot(track.xs.length - 1, true);
          }
        }
        ctx.restore();
      };
      const options = this.common(width, { options: { height,
        scales: { x: { time: false, range: () => [x0, x1] }, y: { range: () => [y0, y1] } },
        series: [{}, { show: true, stroke: "transparent", points: { show: false }, paths: () => null }],
        cursor: { drag: { x: false, y: false } }, hooks: { draw: [draw] } } });
      const named = (line, fallback) => `${line ? line.column.about.name : fallback}${line && line.shown ? ` [${line.shown}]` : ""}`;
      options.axes[0].label = this.equal ? "east [m]" : named(tracks[0] && tracks[0].x, "x");
      options.axes[1].label = this.equal ? "north [m]" : named(tracks[0] && tracks[0].y, "y");
      for (const axis of options.axes) { axis.labelSize = 18; axis.labelFont = axis.font; axis.labelGap = 0; }
      this.tracks = tracks;
      this.data = [[x0, x1], [y0, y1]];
      this.chart = new uPlot(options, this.data, this.body);
      this.values();
    }

    // ---- out

    name() { return `${told.name}-${(this.title || this.lines.map((line) => line.column.about.name).join("-") || "panel").toLowerCase().replace(/[^a-z0-9]+/g, "-")}`.slice(0, 80); }

    save(blob, ending) {
      const link = element("a", { href: URL.createObjectURL(blob), download: `${this.name()}.${ending}` });
      link.click();
      setTimeout(() => URL.revokeObjectURL(link.href), 1000);
    }

    savePng() {
      const source = this.chart.ctx.canvas, ratio = devicePixelRatio;
      const canvas = element("canvas", { width: source.width, height: source.height + 22 * ratio });
      const ctx = canvas.getContext("2d");
      ctx.fillStyle = style("--card");
      ctx.fillRect(0, 0, canvas.width, canvas.height);
      ctx.drawImage(source, 0, 22 * ratio);
      ctx.font = `${12 * ratio}px sans-serif`;
      ctx.fillStyle = style("--ink");
      let x = 8 * ratio;
      ctx.fillText(this.head.firstChild.textContent, x, 15 * ratio);
      x += ctx.measureText(this.head.firstChild.textContent).width + 14 * ratio;
      for (const line of this.lines) { ctx.fillStyle = line.colour; ctx.fillText(this.label(line), x, 15 * ratio); x += ctx.measureText(this.label(line)).width + 12 * ratio; }
      canvas.toBlob((blob) => this.save(blob, "png"));
    }

    svg() {
      const u = this.chart, r = devicePixelRatio, { left, top, width, height } = u.bbox;
      const box = { x: left / r, y: top / r + 22, w: width / r, h: height / r };
      const text = (value) => String(value).replace(/&/g, "&amp;").replace(/</g, "&lt;").replace(/>/g, "&gt;");
      const parts = [`<svg xmlns="http://www.w3.org/2000/svg" width="${u.width}" height="${u.height + 40}" font-family="sans-serif" font-size="11">`,
        `<rect width="100%" height="100%" fill="${style("--card")}"/>`,
        `<clipPath id="c"><rect x="${box.x}" y="${box.y}" width="${box.w}" height="${box.h}"/></clipPath>`];
      let along = 8;
      const write = (value, colour) => { parts.push(`<text x="${along}" y="15" fill="${colour}">${text(value)}</text>`); along += 6.2 * String(value).length + 12; };
      write(this.head.firstChild.textContent, style("--ink"));
      for (const line of this.lines) write(this.label(line), line.colour);
      const X = (value) => (u.valToPos(value, "x", true) / r).toFixed(2), Y = (value) => (u.valToPos(value, "y", true) / r + 22).toFixed(2);
      for (const [n, axis] of u.axes.entries()) {
        const labels = axis._values || [];
        (axis._splits || []).forEach((at, i) => {
          if (labels[i] === null || labels[i] === undefined || labels[i] === "") return;
          parts.push(n === 0
            ? `<line x1="${X(at)}" x2="${X(at)}" y1="${box.y}" y2="${box.y + box.h}" stroke="${style("--grid")}"/><text x="${X(at)}" y="${box.y + box.h + 15}" text-anchor="middle" fill="${style("--dim")}">${text(labels[i])}</text>`
            : `<line y1="${Y(at)}" y2="${Y(at)}" x1="${box.x}" x2="${box.x + box.w}" stroke="${style("--grid")}"/><text x="${box.x - 6}" y="${Number(Y(at)) + 4}" text-anchor="end" fill="${style("--dim")}">${text(labels[i])}</text>`);
        });
      }
      const path = (xs, ys, colour, dash, held) => {
        let d = "", pen = false, before = 0;
        for (let i = 0; i < xs.length; i++) {
          if (ys[i] === null || ys[i] === undefined || !Number.isFinite(ys[i])) { pen = false; continue; }
          if (pen && held) d += `H${X(xs[i])}`;
          d += `${pen ? "L" : "M"}${X(xs[i])} ${Y(ys[i])}`;
          pen = true;
          before = i;
        }
        if (before >= 0 && d) parts.push(`<path clip-path="url(#c)" d="${d}" fill="none" stroke="${colour}" stroke-width="1.4"${dash && dash !== "solid" ? ` stroke-dasharray="${DASHES[dash].join(" ")}"` : ""}/>`);
      };
      if (this.mode === "cross") for (const track of this.tracks) path(track.xs, track.ys, track.colour);
      else this.lines.forEach((line, n) => u.series[n + 1].show && path(u.data[0], u.data[n + 1], line.colour, line.dash, line.held && this.mode === "time"));
      parts.push(`<text x="${box.x + box.w}" y="${u.height + 34}" text-anchor="end" fill="${style("--dim")}">${this.mode === "time" ? "time [s]" : ""}</text></svg>`);
      return parts.join("\n");
    }

    saveSvg() { this.save(new Blob([this.svg()], { type: "image/svg+xml" }), "svg"); }

    csv() {
      if (this.mode === "spectrum") {
        const rows = [["frequency_Hz", ...this.lines.map((line) => this.label(line))].join(",")];
        for (let i = 0; i < this.data[0].length; i++) rows.push(this.data.map((list) => list[i] === null || list[i] === undefined ? "" : list[i]).join(","));
        return rows.join("\n") + "\n";
      }
      const quoted = (value) => /[",\n]/.test(value) ? `"${value.replace(/"/g, '""')}"` : value;
      const one = flights.length === 1;
      const rows = [["time_s", ...this.lines.map((line) => quoted(`${line.column.about.name}${one ? "" : ` (${line.flight.label})`}`))].join(",")];
      const base = this.lines[0];
      const [first, end] = this.seenRows(base);
      for (let row = first; row < end; row++) {
        const t = base.flight.time(row);
        rows.push([Number(t.toPrecision(12)), ...this.lines.map((line) => {
          const value = line.column.values[line.flight === base.flight ? row : line.flight.row(t)];
          return value === undefined || Number.isNaN(value) || t > line.flight.end + 1e-9 ? "" : Number(value.toPrecision(9));
        })].join(","));
      }
      return rows.join("\n") + "\n";
    }

    saveCsv() { this.save(new Blob([this.csv()], { type: "text/csv" }), "csv"); }
  }

  // one-sided amplitude of each frequency: mean removed, Hann's window, its sum divided out; gaps hold the last value
  const amplitudes = (values, step, scale) => {
    let size = 1;
    const least = Math.max(4, values.length);
    while (2 * size <= Math.min(least, 1 << 18)) size *= 2;
    const re = new Float64Array(size), im = new Float64Array(size);
    let mean = 0, last = 0;
    for (let i = 0; i < size; i++) { const value = values[Math.min(i, values.length - 1)]; if (Number.isFinite(value)) last = value; re[i] = last; mean += last / size; }
    for (let i = 0; i < size; i++) re[i] = (re[i] - mean) * (0.5 - 0.5 * Math.cos(2 * Math.PI * i / size));
    fft(re, im);
    const frequencies = [], all = [];
    for (let i = 1; i < size / 2; i++) { frequencies.push(i / (size * step)); all.push(Math.abs(scale) * 4 * Math.hypot(re[i], im[i]) / size || 1e-300); }
    return [frequencies, all.map((value) => value > 1e-15 ? value : null)];
  };

  // in place, by Cooley and Tukey; the size is a power of two
  const fft = (re, im) => {
    const size = re.length;
    for (let i = 1, j = 0; i < size; i++) {
      let bit = size >> 1;
      for (; j & bit; bit >>= 1) j ^= bit;
      j ^= bit;
      if (i < j) { [re[i], re[j]] = [re[j], re[i]]; [im[i], im[j]] = [im[j], im[i]]; }
    }
    for (let length = 2; length <= size; length *= 2) {
      const half = length / 2;
      for (let k = 0; k < half; k++) {
        const angle = -2 * Math.PI * k / length, c = Math.cos(angle), s = Math.sin(angle);
        for (let i = k; i < size; i += length) {
          const a = re[i + half] * c - im[i + half] * s, b = re[i + half] * s + im[i + half] * c;
          re[i + half] = re[i] - a; im[i + half] = im[i] - b;
          re[i] += a; im[i] += b;
        }
      }
    }
  };

  // ---- the workbench: any column of any run in any panel

  let current = null;
  const bench = (place) => {
    const search = element("input", { type: "search", id: "signal-search", placeholder: "name or meaning, such as rate p, throttle, refused", "aria-label": "search columns", autocomplete: "off" });
    const list = element("ul", { class: "signals", "aria-label": "columns found" });
    const where = element("div", { class: "bench-panels" });
    const open = () => { current = new Panel(where, { free: true, height: 190 }); };
    const names = new Map();
    for (const flight of flights) for (const about of flight.known.values()) if (!names.has(about.name)) names.set(about.name, about);
    const put = (name) => {
      if (!current) open();
      const [unit, scale] = SHOWN[names.get(name).unit] || [names.get(name).unit, 1];
      for (const flight of flights) {
        if (!flight.known.has(name) || current.signals.some((each) => each.column === name && (each.run || 0) === flight.number)) continue;
        current.signals.push({ run: flight.number, column: name, label: flights.length > 1 ? `${name}, ${flight.label}` : name, scale, shown: unit,
          colour: COLOURS[current.signals.length % COLOURS.length] });
      }
      current.changed();
    };
    const show = () => {
      const words = search.value.toLowerCase().split(/\s+/).filter(Boolean);
      const found = [...names.values()].filter((about) => words.every((word) => `${about.name.replaceAll("_", " ")} ${about.name} ${about.meaning} ${about.unit}`.toLowerCase().includes(word)));
      list.replaceChildren(...found.map((about) => element("li", {}, element("button", { type: "button", title: about.meaning, onclick: () => put(about.name) },
        element("code", {}, about.name), element("span", { class: "dim small" }, ` ${about.unit ? `[${about.unit}] ` : ""}${about.meaning}`)))));
      if (!found.length) list.append(element("li", { class: "dim small" }, "No column has these words."));
    };
    search.addEventListener("input", show);
    search.addEventListener("keydown", (event) => { if (event.key === "Enter") { const first = list.querySelector("button"); if (first) first.click(); } });
    place.append(element("div", { class: "bench-find" }, search, element("button", { type: "button", class: "act", onclick: open }, "New panel")), list, where);
    const empty = [...new Set(flights.flatMap((flight) => flight.empty))];
    if (empty.length) place.append(element("p", { class: "dim small" }, `${empty.length} columns have no number in ${flights.length > 1 ? "one of these logs" : "this log"}: ${empty.slice(0, 6).join(", ")}${empty.length > 6 ? ", …" : ""}.`));
    show();
    open();
  };

  // ---- begin

  const begin = async () => {
    for (const flight of flights) if (!flight.uniform) flight.times = (await flight.column("time_s")).values;
    state.end = Math.max(1e-3, ...flights.map((flight) => flight.rows ? flight.end : 0));
    state.to = state.end;
    for (const place of document.querySelectorAll(".strips")) {
      const figure = told.figures[place.dataset.figure];
      if (!figure) continue;
      const group = figure.shared ? [] : null;
      for (const panel of figure.panels) new Panel(place, { ...panel, group, equal: figure.equal, mode: figure.equal ? "cross" : "time" });
    }
    const place = document.getElementById("bench");
    if (place) bench(place);
    state.views.push(() => panels.forEach((panel) => panel.refresh()));
    state.listeners.push(() => panels.forEach((panel) => panel.seen && panel.values()));
    let wait = 0;
    new ResizeObserver(() => { clearTimeout(wait); wait = setTimeout(() => panels.forEach((panel) => panel.refresh()), 60); }).observe(document.body);
    const repaint = () => panels.forEach((panel) => panel.changed());
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", repaint);
    const paper = (on) => () => { printing = on; panels.forEach((panel) => panel.again()); };
    addEventListener("beforeprint", paper(true));
    addEventListener("afterprint", paper(false));
    const finish = () => { loaded = true; drawRest(); };
    if (document.readyState === "complete") finish(); else addEventListener("load", finish);
    document.documentElement.dataset.strips = "ready";
  };

  window.hexjet = { told, flights, state, setTime, setView, zoom, setMark, panels, inflate, element, style, KINDS, number, Panel, amplitudes, ready: begin() };
})();
