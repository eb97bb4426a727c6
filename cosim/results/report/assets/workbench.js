// The panels of a page: those that its figures state, and the workbench, where any column of any run goes into any panel.
"use strict";
(() => {
  const { pageData, flights, state, panels, element, setPrinting, finishLoading, SHOWN, drags, Panel } = window.hexjet;

  let current = null;
  const bench = (place) => {
    const search = element("input", { type: "search", id: "signal-search", placeholder: "name or meaning, such as rate p, throttle, refused", "aria-label": "search columns", autocomplete: "off" });
    const list = element("ul", { class: "signals", "aria-label": "columns found" });
    const where = element("div", { class: "bench-panels" });
    const open = () => {
      const panel = current = new Panel(where, { free: true, height: 190 });
      panel.onRemove = () => { if (current === panel) current = null; };
    };
    const names = new Map();
    for (const flight of flights) for (const about of flight.known.values()) if (!names.has(about.name)) names.set(about.name, about);
    const signalsOf = (name) => {
      const [shown, scale] = SHOWN[names.get(name).unit] || [names.get(name).unit, 1];
      return flights.filter((flight) => flight.known.has(name)).map((flight) => ({ run: flight.number, name, scale, shown }));
    };
    const put = (name) => {
      if (!current) open();
      for (const signal of signalsOf(name)) current.add(signal);
    };
    const show = () => {
      const words = search.value.toLowerCase().split(/\s+/).filter(Boolean);
      const found = [...names.values()].filter((about) => words.every((word) => `${about.name.replaceAll("_", " ")} ${about.name} ${about.meaning} ${about.unit}`.toLowerCase().includes(word)));
      list.replaceChildren(...found.map((about) => {
        const name = element("button", { type: "button", title: about.meaning, onclick: () => put(about.name) },
          element("code", {}, about.name), element("span", { class: "dim small" }, ` ${about.unit ? `[${about.unit}] ` : ""}${about.meaning}`));
        drags(name, () => signalsOf(about.name));
        return element("li", {}, name);
      }));
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
      const figure = pageData.figures[place.dataset.figure];
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
    addEventListener("beforeprint", () => setPrinting(true));
    addEventListener("afterprint", () => setPrinting(false));
    if (document.readyState === "complete") finishLoading(); else addEventListener("load", finishLoading);
    document.documentElement.dataset.strips = "ready";
  };

  window.hexjet.ready = begin();
})();
