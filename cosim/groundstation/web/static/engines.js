// One bar per engine: filled to the thrust delivered, with a mark at the thrust commanded.

import { draw, number, write } from "./show.js";

export class Engines {
  constructor(parent) {
    this.parent = parent;
    this.rows = [];
  }

  /** The engines of a flight: name and most thrust of each, throttle limits, whether a monitor watches them. */
  begin(flight) {
    this.watched = flight.watched;
    this.parent.replaceChildren();
    const most = Math.max(...flight.engines.map((engine) => engine.most_N));
    this.rows = flight.engines.map((engine, i) => this.row(i + 1, engine, most));
  }

  row(jet, engine, most) {
    const row = document.createElement("div");
    row.className = "jet";
    row.title = `engine ${jet}: ${engine.name}, up to ${number(engine.most_N)} N`;
    const name = document.createElement("b");
    name.textContent = jet;
    const figure = document.createElement("output");
    const more = document.createElement("div");
    more.className = "more";
    row.append(name);
    const svg = draw(row, "svg", { viewBox: "0 0 100 18", preserveAspectRatio: "none", role: "img" });
    draw(svg, "rect", { x: 0, y: 2, width: (100 * engine.most_N) / most, height: 14, class: "back", "vector-effect": "non-scaling-stroke" });
    const given = draw(svg, "rect", { x: 0, y: 4.5, width: 0, height: 9, class: "given" });
    const asked = draw(svg, "rect", { x: 0, y: 0, width: 0.9, height: 18, class: "asked" });
    row.append(figure, more);
    this.parent.append(row);
    return { row, svg, given, asked, figure, more, most, width: number(engine.most_N).length };
  }

  show(jets) {
    this.rows.forEach((row, i) => this.one(row, jets[i]));
  }

  one({ row, svg, given, asked, figure, more, most, width }, jet) {
    const at = (newton) => Math.min(100, Math.max(0, (100 * (newton ?? 0)) / most));
    given.setAttribute("width", at(jet?.thrust_N));
    asked.setAttribute("x", Math.max(0, at(jet?.asked_N) - 0.45));
    asked.setAttribute("visibility", jet ? "visible" : "hidden");
    if (!jet) return;
    const pad = (text, width) => text.padStart(width, "\u2007");
    const percent = pad(number(100 * jet.throttle, 0), 3);
    write(figure, `${pad(number(jet.asked_N), width)} → ${pad(number(jet.thrust_N), width)} N  ${percent} %`);
    svg.setAttribute("aria-label", `commanded ${number(jet.asked_N)} N, delivered ${number(jet.thrust_N)} N`);
    row.classList.toggle("fault", jet.fault || jet.health < 1);
    const told = [];
    if (jet.rpm !== null) told.push(`${pad(number(jet.rpm, 0), 6)} rpm`);
    if (jet.exhaust_C !== null) told.push(`exhaust ${pad(number(jet.exhaust_C, 0), 3)} °C`);
    if (jet.fuel_g_s !== null) told.push(`fuel ${pad(number(jet.fuel_g_s, 2), 5)} g/s`);
    if (this.watched) told.push(`health ${pad(number(100 * jet.health, 0), 3)} %`);
    if (jet.fault) told.push("FAULT");
    write(more, told.join("   "));
  }
}
