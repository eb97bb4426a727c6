// The pages of engines, events and parameters: tables, so that they can be read aloud cell by cell.

import { Panels } from "./panels.js";
import { element, get, hasWords, number, write } from "./show.js";

const KEPT = 1000; // events
const KINDS = [[/^mode /, "mode"], [/^(dis)?armed/, "arming"], [/^failsafe/i, "failsafe"], [/steps late/, "late"]]; // of messages
const PERIOD_MS = 250; // between two changes of the engines' table: figures that flicker cannot be read

export class EnginePage {
  constructor(history) {
    this.panels = new Panels(get("engine-strips"), history);
    this.body = get("engine-table").tBodies[0];
    this.before = 0;
  }

  begin(flight) {
    this.flight = flight;
    const jets = flight.engines.map((_, n) => n + 1);
    this.body.replaceChildren(...flight.engines.map(({ name }, n) => element("tr", {}, element("th", { scope: "row" }, String(n + 1)), element("td", {}, name),
      ...Array.from({ length: 9 }, () => element("td", {}, "–")))));
    const each = (title, pattern) => [title, jets.map((jet) => [pattern.replace("#", jet), String(jet)])];
    this.kinds = [each("Thrust", "thrust_#_N"), each("Throttle", "throttle_#"), each("Speed of rotation", "spool_speed_#_rad_s"),
      each("Exhaust temperature", "exhaust_temperature_#_K"), each("Fuel flow", "fuel_flow_#_kg_s")];
    this.asked = "";
  }

  draw(state, history) {
    // what no engine tells has no panel
    const told = this.kinds.filter(([, lines]) => lines.some(([name]) => history.has(name)));
    const asked = told.map(([title]) => title).join();
    if (asked !== this.asked) this.panels.begin(told);
    this.asked = asked;
    this.panels.draw();
    const now = performance.now();
    if (now - this.before < PERIOD_MS) return;
    this.before = now;
    state.jets.forEach((jet, n) => {
      const row = this.body.rows[n], { most_N: most } = this.flight.engines[n];
      const off = state.engines_do === "off";
      row.className = jet.fault ? "bad" : "";
      [jet.fault ? "fault" : off ? "off" : jet.health < 1 ? "doubted" : "runs", number(100 * jet.throttle, 0), number(jet.asked_N), number(jet.thrust_N), number(100 * jet.thrust_N / most, 0),
        number(jet.rpm, 0), number(jet.exhaust_C, 0), number(jet.fuel_g_s, 2), this.flight.watched ? number(100 * jet.health, 0) : "not watched",
      ].forEach((text, cell) => write(row.cells[cell + 2], text));
    });
    const thrust = state.jets.reduce((sum, jet) => sum + (jet.thrust_N ?? 0), 0);
    const fuel = history.value("fuel_kg");
    write(get("engines-sum"), `${number(thrust)} N together, weight ${number(9.80665 * history.value("mass_kg"))} N${Number.isFinite(fuel) ? `, fuel ${number(fuel, 3)} kg` : ""}`);
  }
}

export class EventPage {
  constructor() {
    this.rows = [];
    this.kinds = new Set();
    get("events-search").addEventListener("input", () => this.show());
    get("events-kind").addEventListener("change", () => this.show());
  }

  /** A new flight: its time begins again, so what came before goes. */
  begin() {
    this.rows = [];
    this.state = null;
    get("events").replaceChildren();
    this.show();
  }

  add(t, kind, text, grave = false) {
    if (!this.kinds.has(kind)) get("events-kind").append(new Option(kind, kind));
    this.kinds.add(kind);
    const line = element("tr", { class: grave ? "bad" : "" }, element("td", {}, t.toFixed(2)), element("td", {}, kind), element("td", {}, text));
    this.rows.push({ line, kind, text });
    get("events").prepend(line); // the newest first
    if (this.rows.length > KEPT) this.rows.shift().line.remove();
    this.show();
  }

  message({ t, severity, text }) {
    this.add(t, KINDS.find(([words]) => words.test(text))?.[1] ?? "message", text, ["ERROR", "CRITICAL", "ALERT", "EMERGENCY"].includes(severity));
  }

  /** What has changed since the last state and is in no message. */
  take(state) {
    const before = this.state;
    this.state = state;
    if (!before) return;
    const words = (value) => String(value).replaceAll("_", " ");
    if (before.landed !== state.landed) this.add(state.t, "ground", words(state.landed));
    if (before.engines_do !== state.engines_do) this.add(state.t, "engines", words(state.engines_do));
    state.jets.forEach((jet, n) => {
      const was = before.jets[n];
      if (was && was.fault !== jet.fault) this.add(state.t, "fault", `engine ${n + 1}: ${jet.fault ? "a fault acts" : "the fault is over"}`, jet.fault);
      if (was && was.health < 1 !== jet.health < 1) this.add(state.t, "engine monitor", `engine ${n + 1}: ${jet.health < 1 ? "is believed to give less than asked for" : "is believed to be well"}`, jet.health < 1);
    });
  }

  show() {
    const words = get("events-search").value, chosen = get("events-kind").value;
    let seen = 0;
    for (const { line, kind, text } of this.rows) {
      line.hidden = !((!chosen || kind === chosen) && hasWords(`${kind} ${text}`, words));
      seen += !line.hidden;
    }
    write(get("events-count"), `${seen} of ${this.rows.length}`);
  }
}

export class ParameterPage {
  /** `set(name, value)` asks the vehicle, and says whether it did. */
  constructor(set) {
    this.set = set;
    this.rows = new Map();
    get("parameters-search").addEventListener("input", () => this.show());
    get("parameters-changed").addEventListener("change", () => this.show());
  }

  begin(table) {
    this.rows = new Map(table.map((line) => [line.name, this.row(line)]));
    get("parameters").replaceChildren(...[...this.rows.values()].map(({ row }) => row));
    this.show();
  }

  row(line) {
    const { name, values, read_only: fixed, least, most, kind } = line;
    const label = `${name}: ${line.text}`;
    const field = fixed ? element("output", { "aria-label": label })
      : values.length ? element("select", { "aria-label": label, "data-needs": "link" }, ...values.map(([value, text]) => new Option(`${value}: ${text}`, value)))
      : element("input", { type: "number", "aria-label": label, "data-needs": "link", min: least, max: most, step: kind === "int" ? 1 : "any" });
    const made = { line, field, value: line.default };
    const send = async () => {
      const value = Number(field.value);
      if (field.value === "" || value === made.value) return this.put(made);
      const accepted = await this.set(name, value);
      if (!accepted) this.put(made);
    };
    if (values.length) field.addEventListener("change", send);
    else if (!fixed) {
      field.addEventListener("keydown", (event) => {
        if (event.key === "Enter") send();
        if (event.key === "Escape") this.put(made);
      });
      field.addEventListener("blur", () => this.put(made)); // what was not sent does not stay there as if it were
    }
    made.row = element("tr", {}, element("th", { scope: "row" }, element("code", {}, name)), element("td", {}, field), element("td", {}, line.unit),
      element("td", {}, fixed ? "read only" : values.length ? "" : `${plain(least)} to ${plain(most)}`), element("td", {}, plain(line.default)), element("td", {}, `${line.group}: ${line.text}`));
    return made;
  }

  put({ field, value }) {
    if (field.localName === "output") write(field, plain(value));
    else field.value = field.localName === "select" ? value : Number(value.toPrecision(7));
  }

  take(values) {
    for (const [name, value] of Object.entries(values)) {
      const made = this.rows.get(name);
      if (!made) continue;
      made.value = value;
      made.row.className = value === made.line.default ? "" : "changed";
      this.put(made);
    }
    this.show();
  }

  show() {
    const words = get("parameters-search").value, only = get("parameters-changed").checked;
    let seen = 0;
    for (const { line, row, value } of this.rows.values()) {
      row.hidden = !(hasWords(`${line.name} ${line.group} ${line.text} ${line.unit}`, words) && (!only || value !== line.default));
      seen += !row.hidden;
    }
    write(get("parameters-count"), `${seen} of ${this.rows.size}`);
  }
}

const plain = (value) => String(Number(value.toPrecision(6)));
