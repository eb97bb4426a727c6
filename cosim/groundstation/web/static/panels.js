// Strips of the last minutes: columns of the log over time, each line with its value in words beside it.

import { css, element, get, hasWords, number, write } from "./show.js";

const COLOURS = ["--c1", "--c2", "--c3", "--c4", "--c5", "--c6", "--c7", "--c8"];
const SHOWN = { rad: ["°", 180 / Math.PI], "rad/s": ["°/s", 180 / Math.PI], 1: ["", 1] };
const PERIOD_MS = 100; // between two drawings; the eye asks for no more of lines that move a pixel
const FONT = "11px system-ui, sans-serif";

/** One panel; `lines`: [column, label, dashed]. */
class Panel {
  constructor(history, title, lines, remove) {
    Object.assign(this, { history, title });
    this.legend = element("ul", { class: "chips" });
    this.body = element("div", { class: "panel-body", role: "img" });
    this.root = element("section", { class: "card panel", "aria-label": title },
      element("div", { class: "head" }, element("h3", {}, title), this.legend, element("span", { class: "spring" }),
        ...(remove ? [element("button", { type: "button", class: "small", "aria-label": `remove ${title}`, onclick: () => remove(this) }, "×")] : [])), this.body);
    this.asked = lines;
    this.lines = [];
  }

  /** Draw those of its columns that have numbers; before the first row nobody knows which. */
  make() {
    const { history } = this;
    this.lines = this.asked.filter(([name]) => history.index.has(name)).map(([name, label, dash], n) => {
      const [unit, scale] = SHOWN[history.columns[history.index.get(name)].unit] ?? [history.columns[history.index.get(name)].unit, 1];
      return { name, label, dash, unit, scale, colour: COLOURS[n % COLOURS.length] };
    });
    const units = [...new Set(this.lines.map((line) => line.unit))].filter(Boolean).join(", ");
    write(this.root.querySelector("h3"), units && !this.title.includes("[") ? `${this.title} [${units}]` : this.title);
    this.legend.replaceChildren(...this.lines.map((line) => {
      line.value = element("span", { class: "value" });
      const key = element("i", { class: line.dash ? "line dashed" : "line" });
      key.style.borderTopColor = `var(${line.colour})`;
      return element("li", { title: history.columns[history.index.get(line.name)].meaning }, key, `${line.label} `, line.value);
    }));
    const axis = (more) => ({ stroke: () => css("--dim"), font: FONT, grid: { stroke: () => css("--grid"), width: 1 }, ticks: { show: false }, ...more });
    this.chart = new uPlot({
      ...this.size(), legend: { show: false }, cursor: { show: false }, padding: [6, 8, 0, 0],
      scales: { x: { time: false, range: () => [this.from, this.to] }, y: { range: (_, low, high) => margin(low, high) } },
      axes: [axis({ space: 60, size: 22, values: (_, ticks) => ticks.map((tick) => `${tick} s`) }), axis({ size: 52, space: 24, values: (_, ticks) => ticks.map((tick) => String(tick).replace("-", "−")) })],
      series: [{}, ...this.lines.map((line) => ({ stroke: () => css(line.colour), width: 1.5, dash: line.dash ? [6, 4] : [], points: { show: false } }))],
    }, [[], ...this.lines.map(() => [])], this.body);
  }

  size() {
    return { width: Math.max(160, this.body.clientWidth), height: 150 };
  }

  draw(from, to, length) {
    if (!this.chart) this.make();
    [this.from, this.to] = [from, to];
    const size = this.size();
    if (size.width !== this.chart.width) this.chart.setSize(size);
    this.chart.setData(this.history.since(from, this.lines.map((line) => line.name), this.lines.map((line) => line.scale)));
    for (const line of this.lines) write(line.value, number(this.history.has(line.name) ? line.scale * this.history.value(line.name) : null, 2));
    const words = `${this.title}, the last ${length} s; values are beside the names`;
    if (this.body.getAttribute("aria-label") !== words) this.body.setAttribute("aria-label", words);
  }
}

/** Panels of one page, drawn while it is seen. */
export class Panels {
  constructor(place, history) {
    Object.assign(this, { place, history, panels: [], before: 0, length: 60, held: null });
  }

  begin(panels) {
    this.panels = [];
    this.place.replaceChildren();
    this.held = null;
    for (const [title, lines] of panels) this.add(title, lines);
  }

  add(title, lines, own = false) {
    const panel = new Panel(this.history, title, lines, own && ((it) => this.remove(it)));
    this.panels.push(panel);
    this.place.append(panel.root);
    return panel;
  }

  remove(panel) {
    panel.chart?.destroy();
    panel.root.remove();
    this.panels = this.panels.filter((each) => each !== panel);
  }

  hold(on) {
    this.held = on ? this.history.end : null;
  }

  draw() {
    const now = performance.now();
    if (now - this.before < PERIOD_MS || !this.history.count) return;
    this.before = now;
    const end = Math.max(this.length, this.held ?? this.history.end);
    for (const panel of this.panels) panel.draw(end - this.length, end, this.length);
  }
}

/** The page of strips: those that are asked for first, and any column by search. */
export class Strips {
  constructor(history) {
    this.history = history;
    this.panels = new Panels(get("strips"), history);
    get("strips-window").addEventListener("change", (event) => { this.panels.length = Number(event.target.value); });
    get("strips-hold").addEventListener("click", (event) => {
      const on = event.target.getAttribute("aria-pressed") !== "true";
      event.target.setAttribute("aria-pressed", String(on));
      this.panels.hold(on);
    });
    get("strips-search").addEventListener("input", () => this.find());
    get("strips-search").addEventListener("keydown", (event) => {
      if (event.key === "Enter") get("strips-found").querySelector("button")?.click();
      if (event.key === "Escape") { event.target.value = ""; this.find(); }
    });
  }

  begin(flight) {
    const jets = flight.engines.map((_, n) => n + 1);
    get("strips-hold").setAttribute("aria-pressed", "false");
    this.panels.begin([
      ["Roll", [["roll_rad", "true"], ["roll_setpoint_rad", "asked", true]]],
      ["Pitch", [["pitch_rad", "true"], ["pitch_setpoint_rad", "asked", true]]],
      ["Height", [["altitude_m", "true"], ["altitude_setpoint_m", "asked", true]]],
      ["Speed", [["velocity_north_m_s", "north"], ["velocity_east_m_s", "east"], ["velocity_down_m_s", "down"]]],
      ["Rates", ["p", "q", "r"].map((rate) => [`rate_${rate}_measured_rad_s`, rate])],
      ["Thrust", jets.map((jet) => [`thrust_${jet}_N`, String(jet)])],
      ["Wind", ["north", "east", "down"].map((axis) => [`wind_${axis}_m_s`, axis])],
      ["Left unallocated: roll, throttle; pitch, yaw, rad", ["roll", "pitch", "yaw"].map((axis) => [`refused_${axis}`, axis])],
    ]);
    this.find();
  }

  find() {
    const words = get("strips-search").value.trim(), list = get("strips-found");
    list.hidden = !words;
    const found = words ? this.history.columns.filter(({ name, meaning, unit }) => hasWords(`${name} ${name.replaceAll("_", " ")} ${meaning} ${unit}`, words)) : [];
    write(get("strips-found-count"), words ? `${found.length} found; Enter adds the first` : "");
    list.replaceChildren(...found.slice(0, 40).map(({ name, unit, meaning }) => element("li", {}, element("button", { type: "button", onclick: () => {
      this.panels.add(name, [[name, name]], true).root.scrollIntoView({ block: "nearest" });
      write(get("strips-found-count"), `${name} added`);
    } }, element("code", {}, name), ` ${unit ? `[${unit}] ` : ""}${meaning}`))));
  }
}

function margin(low, high) {
  if (low === null || !Number.isFinite(low)) return [-1, 1];
  const room = Math.max(0.08 * (high - low), 0.01, 1e-3 * Math.abs(high));
  return [low - room, high + room];
}
