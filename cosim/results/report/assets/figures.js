// Figures that are no flight over time: lines, points, bars, heat maps and one contour in panels, drawn as SVG from the
// part of Plotly's schema that report/plot.py and its users write. Colours of text and grid are the page's.
"use strict";
(() => {
  const { escaped, bare, lines, finite, format, filled, Axis, prepared, DASHES, drawTrace, barRectangles } = window.hexjetFigures;
  const PAPER = { width: 690, share: 0.78 };  // on paper: the width of a page, and two figures a page
  const LINE = 15;  // px from one line of text to the next
  const CHARACTER = 6.4;  // px of a character, on average
  const GAP = 16;  // px from the left edge to names, and from names to their axis
  const pen = document.createElement("canvas").getContext("2d");
  const fitted = (name, room) => {  // a name without its first letters, where there is no room for them
    let cut = name;
    while (cut.length > 2 && pen.measureText(cut).width > room) cut = `…${cut.slice(cut === name ? 1 : 2)}`;
    return cut;
  };
  const element = (kind, attributes, ...children) => {
    const made = document.createElement(kind);
    for (const [key, value] of Object.entries(attributes)) key.startsWith("on") ? made.addEventListener(key.slice(2), value) : made.setAttribute(key, value);
    made.append(...children);
    return made;
  };

  // ---- a figure

  const group = (trace) => trace.legendgroup || trace.name;

  class Figure {
    constructor(place) {
      this.place = place;
      this.hidden = new Set();
      this.zoom = {};
      this.legend = element("div", { class: "figure-legend" });
      this.body = element("div", { class: "figure-body" });
      this.said = element("div", { class: "figure-said", hidden: "" });
      const item = (text, act) => element("button", { type: "button", onclick: () => { act(); menu.open = false; } }, text);
      const menu = element("details", { class: "figure-menu" }, element("summary", { "aria-label": "what to do with this figure", title: "save, whole range" }, "⋯"),
        element("div", {}, item("whole range", () => this.view({})), item("save PNG", () => this.savePng()), item("save SVG", () => this.saveSvg()), item("save CSV", () => this.saveCsv())));
      place.classList.add("figure");
      place.replaceChildren(element("div", { class: "figure-head" }, this.legend, menu), this.body, this.said);
      this.listen();
    }

    set(data, layout) {
      Object.assign(this.place, { data, layout });
      this.layout = layout;
      this.traces = data.map(prepared);
      this.zoom = {};
      this.heading();
      this.draw();
    }

    // names of traces that hide and show them, and the scale of colours
    heading() {
      const seen = new Set(), { layout } = this, made = [];
      if (layout.showlegend !== false) for (const trace of this.traces) {
        if (!trace.name || trace.showlegend === false || seen.has(group(trace))) continue;
        seen.add(group(trace));
        const [first, other] = trace.type === "bar" || trace.mode === "markers" ? [trace.marker, trace.line] : [trace.line, trace.marker];
        const colour = (first || {}).color || (other || {}).color || "currentColor";
        const line = (trace.mode || "lines").includes("lines") && trace.type === "scatter";
        const mark = element("i", { style: line ? `border-top: 3px ${DASHES[(trace.line || {}).dash] ? "dashed" : "solid"} ${colour}` : `background: ${colour}; height: 9px; border-radius: 2px; vertical-align: 0` });
        const chip = element("button", { type: "button", "aria-pressed": "true", title: "hide or show",
          onclick: () => { this.hidden.has(group(trace)) ? this.hidden.delete(group(trace)) : this.hidden.add(group(trace)); chip.setAttribute("aria-pressed", String(!this.hidden.has(group(trace)))); this.draw(); } }, mark, bare(trace.name));
        made.push(chip);
      }
      if ((layout.legend || {}).traceorder === "reversed") made.reverse();
      const scaled = this.traces.find((trace) => trace.showscale && trace.colorbar);
      if (scaled) {
        const stops = scaled.colorscale.map(([at, colour]) => `${colour} ${100 * at}%`).join(", ");
        made.push(element("span", {}, `${scaled.colorbar.title.text} ${scaled.zmin} `, element("i", { style: `background: linear-gradient(90deg, ${stops}); width: 90px; height: 9px; vertical-align: 0` }), `${scaled.zmax}`));
      }
      this.legend.replaceChildren(...made);
    }

    view(zoom) {
      this.zoom = zoom;
      this.draw();
    }

    // one horizontal axis for figures over the same quantity: what is zoomed in one is zoomed in all
    zoomed(zoom) {
      this.view(zoom);
      const title = (figure) => ((figure.layout.xaxis || {}).title || {}).text;
      if (this.place.dataset.alone !== undefined) return;
      for (const figure of figures.values()) if (figure !== this && figure.place.dataset.alone === undefined && title(figure) === title(this)) figure.view(zoom.x ? { x: zoom.x } : {});
    }

    // where everything is: axes with their ranges and places
    arrange() {
      const { layout } = this, printing = this.printing;
      this.width = printing ? PAPER.width : Math.max(160, this.body.clientWidth || 800);
      this.height = Math.round((layout.height || 360) * (printing ? PAPER.share : 1)) - ((layout.margin || {}).t || 0) + ((layout.annotations || []).length ? 26 : 12);
      const names = new Set(["xaxis", "yaxis", ...Object.keys(layout).filter((key) => /^[xy]axis\d*$/.test(key))]);
      this.axes = {};
      for (const name of names) { const axis = new Axis(name, layout[name] || {}, this.traces); this.axes[axis.id] = axis; }
      this.shown = this.traces.filter((trace) => !this.hidden.has(group(trace)));
      this.pairs = [...new Set(this.traces.map((trace) => `${trace.xaxis || "x"} ${trace.yaxis || "y"}`))].map((pair) => pair.split(" ").map((id) => this.axes[id]));
      const stacked = layout.barmode === "stack";
      const sums = new Map();
      for (const trace of this.shown.filter((each) => each.type === "bar" && stacked)) {
        const [name, along] = trace.orientation === "h" ? ["y", "x"] : ["x", "y"];
        trace.base = trace.values[name].map((key, n) => { const before = sums.get(key) || 0; sums.set(key, before + (trace.values[along][n] || 0)); return before; });
      }
      const together = (axis) => axis.about.matches ? axis.about.matches : axis.id;
      const ends = {};
      for (const axis of Object.values(this.axes)) {
        const [low, high] = axis.ends(this.shown.length ? this.shown : this.traces, stacked), root = together(axis), before = ends[root];
        ends[root] = !before || axis.about.range ? [low, high] : [Math.min(before[0], low), Math.max(before[1], high)];
      }
      const margin = { l: 64, r: 12, b: 44, ...(layout.margin || {}), t: 12 };
      if ((layout.annotations || []).length) margin.t = 26;
      for (const axis of Object.values(this.axes)) axis.range = this.zoom[together(axis)] || [...ends[together(axis)]];
      for (const axis of Object.values(this.axes)) {
        if (axis.letter !== "y" || !axis.categories && !axis.about.automargin) continue;
        pen.font = `12px ${getComputedStyle(this.body).fontFamily}`;  // as figures.css has it
        const widest = axis.categories ? Math.max(0, ...axis.categories.flatMap(lines).map((text) => pen.measureText(text).width)) : 6 * CHARACTER;
        margin.l = Math.max(axis.about.title ? 64 : 20, Math.min(0.6 * this.width, GAP + widest));
      }
      this.margin = margin;
      const put = (letter) => {
        const [start, inner] = letter === "x" ? [margin.l, this.width - margin.l - margin.r] : [margin.t, this.height - margin.t - margin.b];
        for (const axis of Object.values(this.axes)) if (axis.letter === letter) {
          const [from, to] = (axis.about.domain || [0, 1]).map((end) => start + (letter === "x" ? end : 1 - end) * inner);
          Object.assign(axis, { from, to });
        }
      };
      put("y");
      for (const axis of Object.values(this.axes)) {  // long numbers make room for themselves
        if (axis.letter !== "y" || axis.categories) continue;
        axis.beside = Math.max(50, 16 + 7.6 * Math.max(0, ...axis.ticks().map((tick) => tick.text.length)));
        if (!((this.axes[axis.about.anchor || "x"] || axis).about.domain || [0])[0]) margin.l = Math.max(margin.l, axis.beside + 12);
      }
      put("x");
      for (const axis of Object.values(this.axes)) {  // one scale both ways
        const other = this.axes[axis.about.scaleanchor];
        if (!other) continue;
        const scale = Math.min(...[axis, other].map((each) => Math.abs(each.to - each.from) / Math.abs(each.range[1] - each.range[0])));
        for (const each of [axis, other]) { const middle = (each.range[0] + each.range[1]) / 2, half = Math.abs(each.to - each.from) / scale / 2; each.range = [middle - half, middle + half]; }
      }
    }

    draw() {
      this.arrange();
      const parts = [], { axes, layout } = this;
      const text = (x, y, words, anchor = "middle", more = "") => {
        const rows = lines(words);
        parts.push(`<text x="${x.toFixed(1)}" y="${y.toFixed(1)}" text-anchor="${anchor}" ${more}>${rows.map((row, n) => n ? `<tspan x="${x.toFixed(1)}" dy="${LINE}">${escaped(row)}</tspan>` : escaped(row)).join("")}</text>`);
      };
      const line = (kind, x0, y0, x1, y1) => parts.push(`<path class="${kind}" d="M${x0.toFixed(1)} ${y0.toFixed(1)}L${x1.toFixed(1)} ${y1.toFixed(1)}"/>`);
      const id = `clip-${this.place.dataset.figure || this.place.id}`;
      this.pairs.forEach(([x, y], n) => parts.push(`<clipPath id="${id}-${n}"><rect x="${x.from}" y="${y.to}" width="${Math.max(0, x.to - x.from)}" height="${Math.max(0, y.from - y.to)}"/></clipPath>`));
      const under = (layout.shapes || []).filter((shape) => shape.layer === "below"), over = (layout.shapes || []).filter((shape) => shape.layer !== "below");
      under.forEach((shape) => parts.push(this.shape(shape)));
      this.pairs.forEach(([x, y]) => {
        for (const tick of x.ticks()) if (x.about.showgrid !== false && !(x.categories && !x.about.tickvals)) line(tick.even === 0 && !x.log && x.about.zeroline !== false && !x.categories ? "zero" : "grid", x.at(tick.even), y.from, x.at(tick.even), y.to);
        for (const tick of y.ticks()) if (y.about.showgrid !== false) line(tick.even === 0 && !y.log && y.about.zeroline !== false && !y.categories ? "zero" : "grid", x.from, y.at(tick.even), x.to, y.at(tick.even));
      });
      for (const axis of Object.values(axes)) {
        const used = this.pairs.filter((pair) => pair.includes(axis));
        if (!used.length) continue;
        const other = axes[axis.about.anchor] || used[0][axis.letter === "x" ? 1 : 0], ticks = axis.ticks(), named = (axis.about.title || {}).text;
        const labelled = axis.about.showticklabels !== false;
        if (axis.letter === "x") {
          let end = -Infinity, deep = 1;
          if (labelled) for (const tick of ticks) {
            const rows = lines(tick.text), half = CHARACTER * Math.max(...rows.map((row) => row.length)) / 2, at = axis.at(tick.even);
            if (at - half < end) continue;
            end = at + half + 4;
            deep = Math.max(deep, rows.length);
            text(at, other.from + 15, tick.text);
          }
          if (named) text((axis.from + axis.to) / 2, other.from + 21 + LINE * (labelled ? deep : 0), named, "middle", 'class="title"');
        } else {
          if (labelled) for (const tick of ticks) text(other.from - 6, axis.at(tick.even) + 4 - LINE * (lines(tick.text).length - 1) / 2, axis.categories ? lines(tick.text).map((row) => fitted(row, other.from - 8)).join("<br>") : tick.text, "end");
          if (named) { const at = [other.from - (axis.beside || 50), (axis.from + axis.to) / 2]; text(...at, named, "middle", `class="title" transform="rotate(-90 ${at[0].toFixed(1)} ${at[1].toFixed(1)})"`); }
        }
      }
      this.pairs.forEach((pair, n) => {
        const own = this.shown.filter((trace) => axes[trace.xaxis || "x"] === pair[0] && axes[trace.yaxis || "y"] === pair[1]);
        parts.push(`<g clip-path="url(#${id}-${n})">${own.map((trace) => drawTrace(this, trace, ...pair)).join("")}</g>`);
      });
      over.forEach((shape) => parts.push(this.shape(shape)));
      for (const note of layout.annotations || []) {
        const [x, y] = [this.pixelOf(note.xref, note.x, "x"), this.pixelOf(note.yref, note.y, "y")];
        const anchor = { left: "start", right: "end" }[note.xanchor] || "middle";
        text(x, y - (note.yshift || 0) - (note.yanchor === "bottom" ? 6 : -4), note.text, anchor, /<b>/.test(note.text) ? 'class="heading"' : "");
      }
      this.body.innerHTML = `<svg xmlns="http://www.w3.org/2000/svg" width="${this.width}" height="${this.height}" fill="none" role="img" aria-label="${escaped(this.place.dataset.figure || this.place.id || "figure")}">${parts.join("")}<path class="pointer"/><rect class="chosen" width="0" height="0"/></svg>`;
      this.svg = this.body.firstChild;
      this.said.hidden = true;
    }

    // px of a place that is said in data, in parts of a panel ("x2 domain") or of the figure ("paper")
    pixelOf(of, value, letter) {
      const { margin } = this, [id, domain] = (of || letter).split(" ");
      if (id === "paper") return letter === "x" ? margin.l + value * (this.width - margin.l - margin.r) : margin.t + (1 - value) * (this.height - margin.t - margin.b);
      const axis = this.axes[id];
      if (domain) return axis.from + value * (axis.to - axis.from);
      return axis.categories && typeof value === "string" ? axis.px(value) : axis.at(axis.log ? value : axis.even(value));
    }

    shape(shape) {
      const at = (end, letter) => { const of = shape[letter + "ref"] || letter, axis = this.axes[of]; return axis && !axis.categories ? axis.px(shape[letter + end]) : this.pixelOf(of, shape[letter + end], letter); };
      const [x0, x1, y0, y1] = [at(0, "x"), at(1, "x"), at(0, "y"), at(1, "y")];
      if (![x0, x1, y0, y1].every(Number.isFinite)) return "";
      const { line = {} } = shape;
      if (shape.type === "rect") return `<rect x="${Math.min(x0, x1)}" y="${Math.min(y0, y1)}" width="${Math.abs(x1 - x0)}" height="${Math.abs(y1 - y0)}" fill="${shape.fillcolor}" opacity="${shape.opacity ?? 1}"/>`;
      return `<path d="M${x0} ${y0}L${x1} ${y1}" stroke="${line.color}" stroke-width="${line.width || 1}" stroke-dasharray="${DASHES[line.dash] || ""}"/>`;
    }

    // ---- pointer: values, zoom

    panel(px, py) { return this.pairs.find(([x, y]) => px >= x.from && px <= x.to && py <= y.from && py >= y.to); }

    // the nearest point of a trace, for the pointer's place; its distance both ways
    nearest(trace, x, y, px, py) {
      let best = null;
      const say = (point, far) => { if (!best || far < best.far) best = { trace, far, ...point }; };
      if (trace.hoverinfo === "skip" || trace.type === "contour") return null;
      if (trace.type === "heatmap") {
        const within = (edges, at) => edges.findIndex((edge, n) => n + 1 < edges.length && (at - edge) * (at - edges[n + 1]) <= 0);
        const i = within(trace.edges(x).map((even) => x.at(even)), px), j = within(trace.edges(y).map((even) => y.at(even)), py);
        if (i >= 0 && j >= 0 && finite(trace.z[j][i])) say({ px, py, x: trace.values.x[i], y: trace.values.y[j], z: trace.z[j][i], text: trace.text && trace.text[j][i] }, 1);
        return best;
      }
      const point = (n) => ({ x: trace.values.x[n], y: trace.values.y[n], text: Array.isArray(trace.text) ? trace.text[n] : trace.text, customdata: trace.customdata && trace.customdata[n] });
      if (trace.type === "bar") {
        barRectangles(this, trace, x, y).forEach(({ across, along }, n) => {
          const [a, b] = trace.orientation === "h" ? [py, px] : [px, py], inside = (at, [from, to]) => (at - from) * (at - to) <= 0;
          if (inside(a, across) && inside(b, along)) say({ px, py, ...point(n) }, 0);
        });
        return best;
      }
      trace.values.x.forEach((value, n) => {
        const [a, b] = [x.px(value), y.px(trace.values.y[n])];
        if (Number.isFinite(a) && Number.isFinite(b)) say({ px: a, py: b, ...point(n) }, this.unified ? Math.abs(a - px) : Math.hypot(a - px, b - py));
      });
      return best;
    }

    get unified() { return this.layout.hovermode === "x unified"; }

    point(event) {
      const box = this.svg.getBoundingClientRect(), px = event.clientX - box.left, py = event.clientY - box.top, panel = this.panel(px, py), pointer = this.svg.querySelector(".pointer");
      pointer.setAttribute("d", "");
      this.said.hidden = true;
      if (!panel) return;
      const [x, y] = panel;
      const axesOf = (trace) => [this.axes[trace.xaxis || "x"], this.axes[trace.yaxis || "y"]];
      const across = this.shown.filter((trace) => { const [tx, ty] = axesOf(trace); return this.unified ? tx.from === x.from : tx === x && ty === y; });
      const found = across.map((trace) => this.nearest(trace, ...axesOf(trace), px, py)).filter(Boolean).sort((a, b) => this.unified ? 0 : a.far - b.far);
      const near = this.unified ? found.filter((each) => each.far < 40) : found.filter((each) => each.far < 24).slice(0, 1);
      if (!near.length) return;
      const words = near.map((each) => filled(each.trace.hovertemplate || `${each.trace.name ? `${escaped(each.trace.name)}: ` : ""}${this.unified ? "" : "%{x:.4~g}, "}%{y:.4~g}`, each));
      const title = (x.about.title || {}).text || "";
      const head = this.unified ? [`${escaped(title)} ${format(near.reduce((best, each) => each.far < best.far ? each : best).x, x.about.hoverformat || ".5~g")}`] : [];
      this.said.replaceChildren(...[...head, ...words].flatMap((text) => text.split("<br>")).map((text, n) => { const row = element("div", {}); row.textContent = bare(text).replace(/&lt;/g, "<").replace(/&gt;/g, ">").replace(/&amp;/g, "&"); return row; }));
      this.said.hidden = false;
      if (this.unified) pointer.setAttribute("d", `M${px} ${this.margin.t}V${this.height - this.margin.b}`);
      const room = this.place.clientWidth, left = px > room / 2 ? px - this.said.offsetWidth - 14 : px + 14;
      this.said.style.left = `${Math.max(0, Math.min(room - this.said.offsetWidth, left))}px`;
      this.said.style.top = `${this.body.offsetTop + Math.max(0, py - this.said.offsetHeight / 2)}px`;
    }

    listen() {
      let start = null;
      const at = (event) => { const box = this.svg.getBoundingClientRect(); return [event.clientX - box.left, event.clientY - box.top]; };
      const chosen = (event) => {
        const { px, py, x, y } = start, [qx, qy] = at(event), wide = Math.abs(qx - px), high = Math.abs(qy - py);
        const both = wide > 8 && high > 8 && Math.min(wide, high) > 0.25 * Math.max(wide, high);
        return { wide, high, qx, qy, x: both || wide >= high, y: both || high > wide, axes: [x, y] };
      };
      this.body.addEventListener("pointerdown", (event) => {
        const [px, py] = at(event), panel = this.panel(px, py);
        if (!panel || event.button || event.pointerType === "touch") return;
        start = { px, py, x: panel[0], y: panel[1], ranges: panel.map((axis) => [...axis.range]) };
        this.body.setPointerCapture(event.pointerId);
        event.preventDefault();
      });
      this.body.addEventListener("pointermove", (event) => {
        if (!start) return this.point(event);
        const { px, py, x, y } = start, what = chosen(event);
        if (event.shiftKey) return this.move(start, what);
        const box = this.svg.querySelector(".chosen"), [left, right] = what.x ? [px, what.qx] : [x.from, x.to], [top, bottom] = what.y ? [py, what.qy] : [y.from, y.to];
        for (const [key, value] of Object.entries({ x: Math.min(left, right), y: Math.min(top, bottom), width: Math.abs(right - left), height: Math.abs(bottom - top) })) box.setAttribute(key, value);
      });
      this.body.addEventListener("pointerup", (event) => {
        if (!start) return;
        const { px, py, x, y } = start, what = chosen(event);
        start = null;
        this.svg.querySelector(".chosen").setAttribute("width", 0);
        if (event.shiftKey || Math.max(what.wide, what.high) < 8) return;
        const zoom = { ...this.zoom }, inside = (axis, from, to) => {
          const ends = [from, to].map((each) => axis.back(Math.max(Math.min(axis.from, axis.to), Math.min(Math.max(axis.from, axis.to), each))));
          return (ends[0] < ends[1]) === (axis.range[0] < axis.range[1]) ? ends : ends.reverse();
        };
        if (what.x) zoom[x.about.matches || x.id] = inside(x, px, what.qx);
        if (what.y) zoom[y.about.matches || y.id] = inside(y, py, what.qy);
        this.zoomed(zoom);
      });
      this.body.addEventListener("pointerleave", () => { this.said.hidden = true; if (this.svg) this.svg.querySelector(".pointer").setAttribute("d", ""); });
      this.body.addEventListener("dblclick", () => this.zoomed({}));
    }

    move(start, what) {
      const zoom = { ...this.zoom };
      [[start.x, what.qx - start.px, 0], [start.y, what.qy - start.py, 1]].forEach(([axis, by, n]) => {
        const each = by / (axis.to - axis.from) * (start.ranges[n][1] - start.ranges[n][0]);
        zoom[axis.about.matches || axis.id] = start.ranges[n].map((end) => end - each);
      });
      this.view(zoom);
    }

    // ---- out

    source() {
      const copy = this.svg.cloneNode(true), style = getComputedStyle(document.documentElement), colour = (name) => style.getPropertyValue(name).trim();
      copy.querySelectorAll(".pointer, .chosen").forEach((each) => each.remove());
      const names = [...this.legend.querySelectorAll("button")].map((each) => `<tspan fill="${each.firstChild.style.borderTopColor || each.firstChild.style.backgroundColor}">■ </tspan>${escaped(each.textContent)}`).join("  ");
      const head = `<style>text{font:12px sans-serif;fill:${colour("--ink")}}.heading{font-weight:700}.grid{stroke:${colour("--grid")}}.zero{stroke:${colour("--zero")}}</style><rect width="100%" height="100%" fill="${colour("--card")}"/><text x="8" y="15">${names}</text>`;
      return `<svg xmlns="http://www.w3.org/2000/svg" width="${this.width}" height="${this.height + 24}" fill="none">${head}<g transform="translate(0 24)">${copy.innerHTML}</g></svg>`;
    }

    save(blob, ending) {
      const link = element("a", { href: URL.createObjectURL(blob), download: `${this.place.dataset.figure || this.place.id}.${ending}` });
      link.click();
      setTimeout(() => URL.revokeObjectURL(link.href), 1000);
    }

    saveSvg() { this.save(new Blob([this.source()], { type: "image/svg+xml" }), "svg"); }

    savePng() {
      const image = new Image(), ratio = 2;
      image.onload = () => {
        const canvas = element("canvas", { width: ratio * this.width, height: ratio * (this.height + 24) }), context = canvas.getContext("2d");
        context.scale(ratio, ratio);
        context.drawImage(image, 0, 0);
        canvas.toBlob((blob) => this.save(blob, "png"));
      };
      image.src = `data:image/svg+xml;charset=utf-8,${encodeURIComponent(this.source())}`;
    }

    csv() {
      const quoted = (value) => value === null || value === undefined ? "" : /[",\n]/.test(value) ? `"${String(value).replace(/"/g, '""')}"` : String(value);
      const rows = ["name,x,y,value"];
      for (const trace of this.traces) {
        const name = bare(trace.name || ""), { x, y } = trace.values;
        if (trace.z) trace.z.forEach((row, j) => row.forEach((value, i) => { if (finite(value)) rows.push([name, x[i], y[j], value].map(quoted).join(",")); }));
        else x.forEach((value, n) => rows.push([name, value, y[n], ""].map(quoted).join(",")));
      }
      return rows.join("\n") + "\n";
    }

    saveCsv() { this.save(new Blob([this.csv()], { type: "text/csv" }), "csv"); }
  }

  // ---- begin

  const figures = new Map();
  // also for the page's own scripts: figures that follow what is chosen
  window.draw = (place, data, layout) => {
    if (waiting.delete(place)) { near.unobserve(place); place.style.minHeight = ""; }
    if (!figures.has(place)) { figures.set(place, new Figure(place)); sized.observe(place); }
    figures.get(place).set(data, layout);
  };
  const sized = new ResizeObserver((entries) => {
    for (const { target } of entries) { const figure = figures.get(target); if (figure && !figure.printing && figure.body.clientWidth && figure.body.clientWidth !== figure.width) figure.draw(); }
  });
  // a figure is read and drawn when it comes near to what is seen, or goes on paper
  const waiting = new Map();
  const begin = (place) => {
    const figure = JSON.parse(waiting.get(place).textContent);
    window.draw(place, figure.data, figure.layout);
  };
  const near = new IntersectionObserver((entries) => {
    for (const { target, isIntersecting } of entries) if (isIntersecting && waiting.has(target)) begin(target);
  }, { rootMargin: "50% 0px" });
  for (const place of document.querySelectorAll(".plot")) {
    const text = document.getElementById("figure-" + place.dataset.figure);
    if (!text) continue;
    waiting.set(place, text);
    place.style.minHeight = "320px"; // so that what is below does not come into view meanwhile
    near.observe(place);
  }
  const paper = (on) => () => {
    if (on) [...waiting.keys()].forEach(begin);
    figures.forEach((figure) => { figure.printing = on; figure.draw(); });
  };
  addEventListener("beforeprint", paper(true));
  addEventListener("afterprint", paper(false));
})();
