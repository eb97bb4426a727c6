// Strips: panels of columns over time, as spectra or as cross-plots, drawn by uPlot, with one cursor and one window of
// time for all of them and for the picture.
"use strict";
(() => {
  const { flights, windowOf, amplitudes } = window.hexjet;
  // on paper: the colours of the page's print style, which scripts do not see in time, and the width of a page
  const PAPER = { "--ink": "#000", "--dim": "#444", "--grid": "#ddd", "--card": "#fff", width: 690 };
  let printing = false;
  const setPrinting = (on) => { printing = on; panels.forEach((panel) => panel.again()); };
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

  // ---- time: one cursor, one window, for picture and all strips

  const state = { t: 0, from: 0, to: 1, marks: [null, null], listeners: [], views: [] };
  state.end = 1;
  const notify = (list, ...what) => list.forEach((each) => each(...what));
  const setTime = (t, source) => {
    state.t = Math.max(0, Math.min(state.end, t));
    notify(state.listeners, source);
  };
  const setView = (from, to) => {
    const least = 4 * Math.min(...flights.map((flight) => flight.step || 1e-3));
    if (to - from < least) [from, to] = [(from + to - least) / 2, (from + to + least) / 2];
    const span = Math.min(to - from, state.end);
    from = Math.max(0, Math.min(from, state.end - span));
    [state.from, state.to] = [from, from + span];
    notify(state.views);
  };
  const zoom = (factor, about = state.t) => {
    const at = about < state.from || about > state.to ? (state.from + state.to) / 2 : about;
    setView(at - (at - state.from) * factor, at + (state.to - at) * factor);
  };
  const setMark = (which) => {
    state.marks[which] = state.marks[which] === null || state.marks[which] !== state.t ? state.t : null;
    notify(state.listeners, "marks");
    notify(state.views);
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

  const finishLoading = () => { loaded = true; drawRest(); };

  const SIDES = 74; // pixels of the width that are not the field of a panel
  const COLOURS = ["#2f7de1", "#f08c00", "#2f9e44", "#c2339b", "#e03131", "#7048e8", "#1098ad", "#a0522d"];
  const DASHES = { solid: [], dash: [7, 4], dot: [2, 3], dashdot: [7, 3, 2, 3] };
  const KINDS = { fault: "#e03131", monitor: "#f08c00", pilot: "#2f7de1", contact: "#2f9e44", disturbance: "#868e96", requirement: "#7048e8" };
  const TINTS = ["#868e96", "#2f7de1", "#2f9e44", "#f08c00", "#7048e8", "#1098ad", "#c2339b", "#a0522d"];
  const SHOWN = { rad: ["deg", 180 / Math.PI], "rad/s": ["deg/s", 180 / Math.PI] };
  const panels = new Set();
  const number = (value) => value === null || !Number.isFinite(value) ? "–"
    : Math.abs(value) >= 1e5 || (value !== 0 && Math.abs(value) < 1e-4) ? value.toExponential(3)
    : value.toPrecision(5).replace(/(\.\d*?)0+$/, "$1").replace(/\.$/, "");

  // a name that is pulled to another panel is drawn there too; a finger scrolls, and a press alone stays one
  const drags = (name, signals) => name.addEventListener("pointerdown", (down) => {
    if (down.button !== 0 || down.pointerType === "touch") return;
    const target = (event) => {
      const root = document.elementFromPoint(event.clientX, event.clientY)?.closest(".strip");
      return root && !root.contains(name) && !root.panel.equal ? root : null;
    };
    let over = null, pulled = false;
    const mark = (root) => { if (over) over.classList.remove("strip-target"); over = root; if (over) over.classList.add("strip-target"); };
    const move = (event) => {
      pulled ||= Math.hypot(event.clientX - down.clientX, event.clientY - down.clientY) > 6;
      if (!pulled) return;
      event.preventDefault();
      document.documentElement.classList.add("pulling");
      mark(target(event));
    };
    const stop = () => {
      document.documentElement.classList.remove("pulling");
      mark(null);
      for (const [kind, act] of acts) removeEventListener(kind, act, true);
    };
    const drop = (event) => {
      const root = pulled ? target(event) : null;
      stop();
      if (!pulled) return;
      const still = (click) => { click.stopPropagation(); click.preventDefault(); };
      addEventListener("click", still, true);
      setTimeout(() => removeEventListener("click", still, true)); // the press's own click comes before it, or not at all
      if (root) for (const signal of signals()) root.panel.add(signal);
    };
    const acts = [["pointermove", move], ["pointerup", drop], ["pointercancel", stop]];
    for (const [kind, act] of acts) addEventListener(kind, act, true);
  });

  const near = new IntersectionObserver((entries) => {
    for (const entry of entries) {
      const panel = entry.target.panel;
      panel.seen = entry.isIntersecting;
      if (panel.seen) panel.refresh();
    }
  }, { rootMargin: "300px" });

  class Panel {
    // signals: {run, column, label, colour, dash, width, held, scale}; window: what is seen while all else shows the whole
    // flight, {from, to}; spans: named intervals behind the lines, [from, to, name]
    constructor(place, { title = "", unit = "", least = 0, signals = [], mode = "time", free = false, height = 150, equal = false, group = null, window = null, spans = null }) {
      Object.assign(this, { title, unit, least, mode, free, height, equal, group, window, spans });
      this.signals = [];
      this.seen = false;
      this.hidden = new Set();
      this.chips = element("span", { class: "chips" });
      this.head = element("div", { class: "strip-head" },
        element("span", { class: "strip-title" }), this.chips, this.tools());
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

    tools() {
      const item = (text, act) => element("button", { type: "button", onclick: () => { act(); box.open = false; } }, text);
      const box = element("details", { class: "strip-menu" }, element("summary", { "aria-label": "what to do with this panel", title: "save, cross-plot" }, "⋯"),
        element("div", {},
          item("over time", () => this.turn("time")),
          item("cross-plot of the first two", () => this.turn("cross")),
          item("save PNG", () => hexjet.files.savePng(this)), item("save SVG", () => hexjet.files.saveSvg(this)), item("save CSV", () => hexjet.files.saveCsv(this)),
          ...(this.free ? [item("remove panel", () => this.remove())] : [])));
      // a spectrum is of every step alone
      this.toSpectrum = this.equal || flights.some((flight) => flight.group > 1) ? null : element("button", { type: "button", class: "strip-spectrum",
        title: "spectrum of what is seen, and back", onclick: () => this.turn(this.mode === "spectrum" ? "time" : "spectrum") }, "spectrum");
      return element("span", { class: "strip-tools" }, ...(this.toSpectrum ? [this.toSpectrum] : []), box);
    }

    turn(mode) { this.mode = mode; this.changed(); }

    remove() {
      panels.delete(this);
      near.unobserve(this.root);
      if (this.chart) this.chart.destroy();
      this.root.remove();
      if (this.onRemove) this.onRemove();
    }

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

    // another signal, from another panel or the list of columns
    add({ run = 0, name, scale, shown, held }) {
      if (this.signals.some((each) => each.column === name && (each.run || 0) === run)) return;
      const used = new Set(this.signals.map((each) => each.colour));
      this.signals.push({ run, column: name, label: flights.length > 1 ? `${name}, ${flights[run].label}` : name, scale, shown, held, added: true,
        colour: COLOURS.find((each) => !used.has(each)) || COLOURS[this.signals.length % COLOURS.length] });
      this.changed();
    }

    label(signal) { return signal.label || signal.column; }

    // draws what is seen; with `unseen` in any case
    async refresh(unseen = false) {
      if (!(this.seen || unseen) || this.building) return;
      if (this.chart) { if (this.drawnFor !== this.viewKey()) this.redraw(); else this.values(); return; }
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

    get view() { return this.window && state.from === 0 && state.to === state.end ? this.window : state; }

    viewKey() { return `${state.from} ${state.to} ${this.width()} ${state.marks}`; }

    width() { return printing ? PAPER.width : Math.max(120, this.body.clientWidth); }

    heading() {
      if (this.toSpectrum) this.toSpectrum.setAttribute("aria-pressed", String(this.mode === "spectrum"));
      const units = this.units = [...new Set([this.unit, ...this.lines.map((line) => line.shown)])].filter(Boolean).join(", ");
      const extra = { time: "", spectrum: ", amplitude", cross: "" }[this.mode];
      this.head.firstChild.textContent = (this.title ? this.title + " " : "") + (units ? `[${units}]` : "") + extra;
      this.chips.replaceChildren(...this.lines.map((line, n) => {
        const value = element("b", {}, "");
        const chip = element("button", { type: "button", class: "chip-line", "aria-pressed": String(this.shows(line)), title: this.about(line),
          onclick: () => { if (this.shows(line)) this.hidden.add(this.label(line)); else this.hidden.delete(this.label(line));
            if (this.chart) this.chart.setSeries(n + 1, { show: this.shows(line) });
            chip.setAttribute("aria-pressed", String(this.shows(line))); } },
        element("i", { style: `border-top:3px ${line.dash && line.dash !== "solid" ? "dashed" : "solid"} ${line.colour}` }), this.label(line), " ", value);
        line.value = value;
        drags(chip, () => [{ run: line.flight.number, name: line.column.about.name, scale: line.scale, shown: line.shown, held: line.held }]);
        if (!this.free && !line.added) return chip;
        return element("span", { class: "chip-pair" }, chip, element("button", { type: "button", class: "chip-off", "aria-label": `remove ${this.label(line)}`,
          onclick: () => { this.signals = this.signals.filter((each) => !(each.column === line.column.about.name && (each.run || 0) === line.flight.number)); this.changed(); } }, "×"));
      }));
    }

    shows(line) { return !this.hidden.has(this.label(line)); }

    about(line) {
      const { about } = line.column;
      return `${about.name}${about.unit ? ` [${about.unit}]` : ""}${about.frame ? `, ${about.frame}` : ""}: ${about.meaning}. ` +
        `Drawn in steps of ${number(about.step)}${line.flight.group > 1 ? `, the least and the greatest of each ${line.flight.group} rows` : ""}; exact in the log.`;
    }

    build() {
      this.heading();
      this.body.replaceChildren();
      this.drawnFor = this.viewKey();
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
        axes: [{ stroke: ink, grid, ticks, font, size: 26, space: 60, values: (u, splits) => splits.map((at) => at === null ? "" : `${parseFloat(more.per ? at.toPrecision(3) : at.toFixed(6))} ${more.per || "s"}`) },
          { stroke: ink, grid, ticks, font, size: 54, label: this.units || " ", labelFont: font, labelSize: 12, labelGap: 0, ...more.yAxis }], ...more.options };
    }

    buildTime(width) {
      const lines = this.lines;
      const series = lines.map((line) => ({ label: this.label(line), show: this.shows(line), stroke: line.colour, width: line.width || 1.4,
        dash: DASHES[line.dash] || [], spanGaps: false,
        points: { show: (u) => { const x = u.data[0]; return x.length > 1 && x.length < u.bbox.width / devicePixelRatio / 6; }, size: 4 },
        paths: line.held ? uPlot.paths.stepped({ align: 1 }) : uPlot.paths.linear() }));
      // uPlot's steps are at most twice the least space apart: three labels stand on a sixth of the height
      const options = this.common(width, { yAxis: { space: (u, axis, low, high, size) => Math.max(13, Math.min(30, size / 6)) }, options: {
        scales: { x: { time: false, range: () => [this.view.from, this.view.to] }, y: { range: (u, low, high) => this.yRange(low, high) } },
        series: [{}, ...series],
        cursor: { y: false, points: { show: false }, drag: { x: true, y: false, setScale: false } },
        select: { show: true },
        hooks: {
          drawClear: [(u) => this.bands(u)],
          setSelect: [(u) => { if (u.select.width > 3) { const a = u.posToVal(u.select.left, "x"), b = u.posToVal(u.select.left + u.select.width, "x");
            u.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false); setView(a, b); } }],
        } } });
      this.data = windowOf(lines, this.view.from, this.view.to, width - SIDES);
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
        else { const { from, to } = this.view, by = 0.1 * (to - from) * Math.sign(event.deltaY || event.deltaX); setView(from + by, to + by); }
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
      if (this.mode !== "time") { if (this.drawnFor !== this.viewKey()) this.changed(); return; }
      if (this.chart.width !== width) this.chart.setSize({ width, height: this.height });
      this.data = windowOf(this.lines, this.view.from, this.view.to, width - SIDES);
      this.chart.setData(this.data);
      this.drawnFor = this.viewKey();
      this.values();
    }

    // a tint for each phase, and its name in the first of panels above each other
    tint(u, x, phases, alpha) {
      const { ctx } = u, { from: begin, to: end } = this.view, { top, height } = u.bbox, ratio = devicePixelRatio;
      const names = [...new Set(phases.map(([, , name]) => name))];
      ctx.font = `${10 * ratio}px ${getComputedStyle(document.body).fontFamily}`;
      for (const [from, to, name] of phases) {
        if (to < begin || from > end) continue;
        ctx.globalAlpha = alpha;
        ctx.fillStyle = TINTS[names.indexOf(name) % TINTS.length];
        ctx.fillRect(x(from), top, x(to) - x(from), height);
        ctx.globalAlpha = 1;
        ctx.fillStyle = style("--dim");
        if (!this.root.previousElementSibling && ctx.measureText(name).width + 6 * ratio < x(to) - x(from)) ctx.fillText(name, x(from) + 3 * ratio, top + height - 4 * ratio);
      }
    }

    // phases, faults, disturbances, saturation behind the lines; words of monitor and autopilot as dotted lines
    bands(u) {
      const { ctx } = u, { left, top, width, height } = u.bbox, { from: begin, to: end } = this.view;
      const x = (t) => Math.max(left, Math.min(left + width, u.valToPos(t, "x", true)));
      ctx.save();
      const shown = new Set(this.lines.map((line) => line.flight.number));
      if (this.spans) this.tint(u, x, this.spans, 0.2);
      else if (shown.size === 1) this.tint(u, x, this.lines[0].flight.phases, 0.09);
      for (const number of shown) {
        const flight = flights[number];
        for (const event of flight.events) {
          const last = event.end === null ? state.end : event.end;
          if (event.lasts && event.banded) {
            if (last < begin || event.t > end) continue;
            ctx.globalAlpha = 0.14;
            ctx.fillStyle = KINDS[event.kind];
            ctx.fillRect(x(event.t), top, Math.max(1, x(last) - x(event.t)), height);
          } else if (!event.lasts && event.t >= begin && event.t <= end) {
            ctx.globalAlpha = 0.9;
            ctx.strokeStyle = KINDS[event.kind];
            ctx.lineWidth = 1.2 * devicePixelRatio;
            ctx.setLineDash([2 * devicePixelRatio, 3 * devicePixelRatio]);
            ctx.beginPath(); ctx.moveTo(x(event.t), top); ctx.lineTo(x(event.t), top + height); ctx.stroke();
          }
        }
        ctx.globalAlpha = 0.14;
        ctx.fillStyle = KINDS.disturbance;
        for (const [from, to] of flight.upsets) if (to >= begin && from <= end) ctx.fillRect(x(from), top, Math.max(1, x(to) - x(from)), height);
        ctx.globalAlpha = 0.5;
        ctx.fillStyle = "#e8590c";
        for (const [from, to] of flight.saturated) {
          const last = to === null ? flight.end : to;
          if (last >= begin && from <= end) ctx.fillRect(x(from), top, Math.max(1, x(last) - x(from)), 3 * devicePixelRatio);
        }
      }
      ctx.globalAlpha = 1;
      ctx.setLineDash([]);
      state.marks.forEach((mark, n) => {
        if (mark === null || mark < begin || mark > end) return;
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
        const inside = state.t >= this.view.from && state.t <= this.view.to;
        this.cursor.style.transform = `translateX(${at}px)`;
        this.cursor.style.visibility = inside ? "visible" : "hidden";
      }
      const now = performance.now();
      if (state.playing && now - (this.valuesAt || 0) < 80) return;
      this.valuesAt = now;
      const [a, b] = state.marks;
      for (const line of this.lines) {
        const value = (t) => t > line.flight.end + 1e-9 ? NaN : line.scale * line.column.values[line.flight.row(t)];
        const apart = a !== null && b !== null ? ` (B−A ${number(value(b) - value(a))})` : "";
        line.value.textContent = number(value(state.t)) + apart;
      }
    }

    // every sample of what is seen
    seenRows(line) {
      const first = Math.max(0, line.flight.row(this.view.from + 1e-9)), end = Math.min(line.flight.rows, line.flight.row(this.view.to) + 1);
      return [first, end];
    }

    buildSpectrum(width) {
      const made = this.lines.map((line) => {
        const [first, end] = this.seenRows(line);
        return amplitudes(line.column.values.subarray(first, end), line.flight.uniform ? line.flight.step : (line.flight.time(end - 1) - line.flight.time(first)) / Math.max(1, end - first - 1), line.scale);
      });
      const table = uPlot.join(made.map(([f, a]) => [f, a]));
      // five decades below the greatest: what is less is rounding
      const decades = (low, high) => high > 0 ? [10 ** Math.floor(Math.log10(Math.max(low, 1e-5 * high))), 10 ** Math.ceil(Math.log10(high))] : [0.1, 1];
      const small = (u, splits) => splits.map((at) => at === null ? "" : at < 1e-3 ? at.toExponential(0) : String(parseFloat(at.toPrecision(3))));
      const options = this.common(width, { per: "Hz", yAxis: { values: small }, options: {
        scales: { x: { time: false, distr: 3, range: (u, low, high) => [low, high] }, y: { distr: 3, range: (u, low, high) => decades(low, high) } },
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
        const w = width - SIDES, h = height - 32, per = Math.max((x1 - x0) / w, (y1 - y0) / h);
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
      delete options.axes[0].values;
      for (const axis of options.axes) { axis.labelSize = 18; axis.labelFont = axis.font; axis.labelGap = 0; }
      this.tracks = tracks;
      this.data = [[x0, x1], [y0, y1]];
      this.chart = new uPlot(options, this.data, this.body);
      this.values();
    }
  }

  Object.assign(window.hexjet, { state, setTime, setView, zoom, setMark, panels, element, style, setPrinting, finishLoading, COLOURS, DASHES, KINDS, SHOWN, number, drags, Panel });
})();
