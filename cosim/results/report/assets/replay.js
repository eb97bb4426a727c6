// The replay of flights: the vehicle in three dimensions, moved by the log, and the time line.
"use strict";
(() => {
  const { pageData, flights, state, setTime, setView, zoom, setMark, element, style, KINDS, number, inflate } = window.hexjet;
  const place = document.getElementById("replay");
  if (!place) return;
  const SPEEDS = [0.05, 0.1, 0.25, 0.5, 1, 2, 5, 10, 30];
  let speed = SPEEDS.indexOf(1);

  // ---- the time line

  const play = element("button", { type: "button", class: "act", "aria-label": "play" }, "▶");
  const seek = element("input", { type: "range", min: 0, max: 1000000, step: 1, value: 0, "aria-label": "time" });
  const clock = element("output", { class: "clock" });
  const rate = element("select", { "aria-label": "speed" }, ...SPEEDS.map((value) => element("option", { value, selected: value === 1 }, `${value} ×`)));
  const said = element("p", { class: "said", role: "status" });
  const lane = element("canvas", { class: "lane", height: 26, role: "img", "aria-label": "events over time" });
  const marks = element("p", { class: "dim small marks" });
  const button = (text, title, act) => element("button", { type: "button", class: "act", title, "aria-label": title, onclick: act }, text);

  const events = flights.flatMap((flight) => flight.events.map((event) => ({ ...event, flight })))
    .concat(flights.flatMap((flight) => flight.saturated.filter(([from, to], n, all) => n === 0 || from - (all[n - 1][1] ?? flight.end) > 1)
      .map(([from, to]) => ({ t: from, end: to, kind: "saturation", text: "saturated", flight }))))
    .sort((a, b) => a.t - b.t);
  const tell = (event) => { said.textContent = event ? `${event.t.toFixed(3)} s: ${event.text}${flights.length > 1 ? ` (${event.flight.label})` : ""}` : ""; };
  const jump = (way) => {
    const event = way > 0 ? events.find((each) => each.t > state.t + 1e-6) : events.filter((each) => each.t < state.t - 1e-6).pop();
    if (event) { setTime(event.t); tell(event); }
  };
  const toggle = () => {
    state.playing = !state.playing;
    if (state.playing && state.t >= state.end - 1e-9) setTime(0);
    play.textContent = state.playing ? "❚❚" : "▶";
    play.setAttribute("aria-label", state.playing ? "pause" : "play");
    if (state.playing) { before = performance.now(); requestAnimationFrame(tick); }
  };
  const faster = (by) => { speed = Math.max(0, Math.min(SPEEDS.length - 1, speed + by)); rate.selectedIndex = speed; };
  play.addEventListener("click", toggle);
  rate.addEventListener("change", () => { speed = rate.selectedIndex; });
  seek.addEventListener("input", () => setTime(state.end * seek.value / 1e6));
  lane.addEventListener("click", (event) => {
    const t = state.end * event.offsetX / lane.clientWidth;
    const next = events.reduce((best, each) => Math.abs(each.t - t) < Math.abs((best ? best.t : Infinity) - t) ? each : best, null);
    const close = next && Math.abs(next.t - t) < 8 * state.end / lane.clientWidth;
    setTime(close ? next.t : t);
    tell(close ? next : null);
  });

  const paintLane = () => {
    const ratio = devicePixelRatio, width = lane.clientWidth || 300;
    lane.width = width * ratio;
    lane.height = 26 * ratio;
    const ctx = lane.getContext("2d");
    const x = (t) => t / state.end * lane.width;
    ctx.fillStyle = style("--line");
    ctx.fillRect(0, 12 * ratio, lane.width, 2 * ratio);
    for (const event of events) {
      const end = event.end ?? event.flight.end;
      if (event.kind === "saturation") continue;
      ctx.fillStyle = KINDS[event.kind];
      ctx.globalAlpha = event.lasts ? 0.35 : 0.95;
      if (event.lasts) ctx.fillRect(x(event.t), 5 * ratio, Math.max(2 * ratio, x(end) - x(event.t)), 16 * ratio);
      else ctx.fillRect(x(event.t), 3 * ratio, 2 * ratio, 20 * ratio);
    }
    ctx.globalAlpha = 0.9;
    ctx.fillStyle = "#e8590c";
    for (const flight of flights) for (const [from, to] of flight.saturated) ctx.fillRect(x(from), 22 * ratio, Math.max(ratio, x(to ?? flight.end) - x(from)), 4 * ratio);
    ctx.globalAlpha = 1;
    if (state.from > 0 || state.to < state.end) {
      ctx.strokeStyle = style("--dim");
      ctx.strokeRect(x(state.from), ratio, x(state.to) - x(state.from), 24 * ratio);
    }
  };

  const step = () => Math.min(...flights.map((flight) => flight.uniform ? flight.step : 0.01));
  const markText = () => {
    const [a, b] = state.marks;
    const one = (t) => t === null ? "not set" : `${t.toFixed(3)} s`;
    marks.textContent = `A ${one(a)}, B ${one(b)}${a !== null && b !== null ? `, B − A ${(b - a).toFixed(3)} s${b !== a ? ` (${number(1 / Math.abs(b - a))} Hz)` : ""}` : ""}`;
  };

  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || event.target.closest("input[type=search], input[type=text], textarea, select")) return;
    const keys = {
      " ": event.target.closest("button, summary, a") ? null : toggle, k: toggle,
      ArrowRight: () => setTime(state.t + (event.shiftKey ? 1 : step())), ArrowLeft: () => setTime(state.t - (event.shiftKey ? 1 : step())),
      Home: () => setTime(0), End: () => setTime(state.end), n: () => jump(1), p: () => jump(-1),
      "+": () => zoom(0.5), "=": () => zoom(0.5), "-": () => zoom(2), 0: () => setView(0, state.end),
      "]": () => faster(1), "[": () => faster(-1), a: () => setMark(0), b: () => setMark(1), c: () => views(),
    };
    const act = keys[event.key];
    if (!act) return;
    event.preventDefault();
    act();
  });

  const toolbar = element("div", { class: "timeline" },
    element("div", { class: "controls" }, play, rate, clock,
      button("⇤", "event before (p)", () => jump(-1)), button("⇥", "next event (n)", () => jump(1)),
      button("A", "mark A here (a)", () => setMark(0)), button("B", "mark B here (b)", () => setMark(1)),
      button("+", "zoom in (+)", () => zoom(0.5)), button("−", "zoom out (-)", () => zoom(2)), button("all", "whole flight (0)", () => setView(0, state.end))),
    seek, lane, said, marks);
  const stage = element("div", { class: "stage" });
  place.append(stage, toolbar);

  const update = () => {
    if (document.activeElement !== seek || state.playing) seek.value = Math.round(1e6 * state.t / state.end);
    seek.setAttribute("aria-valuetext", `${state.t.toFixed(3)} s`);
    clock.textContent = `${state.t.toFixed(3)} s of ${state.end.toFixed(2)}`;
    markText();
  };
  let before = 0;
  const tick = (now) => {
    if (!state.playing) return;
    setTime(state.t + SPEEDS[speed] * Math.min(0.25, (now - before) / 1000));
    before = now;
    if (state.t >= state.end - 1e-9) { toggle(); return; }
    requestAnimationFrame(tick);
  };
  state.listeners.push(update);
  state.views.push(paintLane);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", paintLane);
  new ResizeObserver(paintLane).observe(lane);

  let views = () => {};

  // ---- the scene

  const NEEDED = ["north_m", "east_m", "down_m", "roll_rad", "pitch_rad", "yaw_rad", "roll_setpoint_rad", "pitch_setpoint_rad", "yaw_setpoint_rad",
    "north_setpoint_m", "east_setpoint_m", "altitude_m", "altitude_setpoint_m", "wind_north_m_s", "wind_east_m_s", "wind_down_m_s",
    "velocity_north_m_s", "velocity_east_m_s", "velocity_down_m_s"];

  const without = (why) => {
    stage.replaceChildren(element("p", { class: "no-webgl" }, `${why} The strips below and the time line work without it.`));
    document.documentElement.dataset.replay = "none";
  };

  const start = async () => {
    await window.hexjet.ready;
    // the page is there first: WebGL alone takes a tenth of a second to begin, the library as long to unpack
    await new Promise((done) => { requestAnimationFrame(() => setTimeout(done)); setTimeout(done, 500); });
    update();
    paintLane();
    const flown = flights.filter((flight) => flight.rows && ["north_m", "east_m", "down_m", "roll_rad", "pitch_rad", "yaw_rad"].every((name) => flight.known.has(name)));
    if (!flown.length) return without("No place and attitude in this log: no picture of the vehicle.");
    const probe = document.createElement("canvas");
    if (!(probe.getContext("webgl2"))) return without("This browser shows no WebGL, so there is no picture of the vehicle.");
    if (typeof THREE === "undefined") {
      const library = document.getElementById("three-js");
      const script = document.createElement("script");
      const shared = library.dataset.src;
      const loaded = shared && new Promise((done) => { script.onload = script.onerror = done; });
      if (shared) script.src = shared;
      else script.textContent = new TextDecoder().decode(await inflate(library.textContent));
      document.head.append(script);
      await loaded;
      if (typeof THREE === "undefined") return without(`Not there: ${shared}, so there is no picture of the vehicle.`);
    }
    for (const flight of flown) {
      const jets = flight.vehicle.jets.map((_, n) => n + 1);
      const more = [...jets.flatMap((jet) => [`thrust_${jet}_N`, `health_${jet}`, `fault_jet_${jet}`]), ...new Set(flight.vehicle.jets.flatMap((jet) => jet.turns.map((turn) => turn.column)))];
      for (const name of [...NEEDED, ...more]) await flight.column(name);
    }
    try {
      scene(flown);
    } catch (error) {
      without(`WebGL does not work in this browser (${error.message}), so there is no picture of the vehicle.`);
    }
  };

  const TRACK = 6000; // points of a track, at most
  const AXES = ["north_m", "east_m", "down_m"];
  const scene = (flown) => {
    const tracks = flown.map((flight) => {
      const every = Math.max(1, Math.ceil(flight.rows / TRACK));
      const track = new Float32Array(3 * Math.ceil(flight.rows / every));
      AXES.forEach((name, axis) => { const { values } = flight.read.get(name); for (let i = 0; 3 * i < track.length; i++) track[3 * i + axis] = values[i * every]; });
      const spans = AXES.map((name) => flight.read.get(name).span(0, flight.rows));
      const bounds = [spans.map(([low]) => low), spans.map(([, high]) => high)];
      return { vehicle: flight.vehicle, colour: flight.colour, label: flight.label, track, every, whole: true, bounds: () => bounds };
    });
    const moment = (n) => {
      const flight = flown[n];
      const row = Math.max(0, flight.row(Math.min(state.t, flight.end)));
      // between two samples the place goes on in a straight line and the attitude along the arc
      const next = Math.min(row + 1, flight.rows - 1);
      const from = flight.time(row), span = flight.time(next) - from;
      const share = span > 0 ? Math.max(0, Math.min(1, (state.t - from) / span)) : 0;
      const turn = (at) => hexjetScene.attitude(flight.at("roll_rad", at), flight.at("pitch_rad", at), flight.at("yaw_rad", at));
      return {
        place: AXES.map((name) => { const a = flight.at(name, row), b = flight.at(name, next); return a + share * (b - a); }),
        quaternion: turn(row).slerp(turn(next), share),
        value: (name) => flight.at(name, row),
        seen: Math.floor(row / tracks[n].every) + 1,
      };
    };
    const made = hexjetScene.make({ stage, flown: tracks, moment, element, style, drawn: (canvas) => { canvas.dataset.time = state.t.toFixed(4); } });
    views = made.views;
    state.listeners.push(made.show);
    window.hexjet.pose = (n = 0) => made.put(n);
    document.documentElement.dataset.replay = "ready";
  };

  start().catch((error) => without(`The picture could not be drawn (${error.message}).`));
})();
