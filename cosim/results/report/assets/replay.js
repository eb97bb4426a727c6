// The vehicle of a flight in three dimensions, drawn from vehicle.toml, moved by the log; and the time line.
// Everything inside `world` is north-east-down; three.js has x east, y up, z south.
"use strict";
(() => {
  const { told, flights, state, setTime, setView, zoom, setMark, element, style, KINDS, number, inflate } = window.hexjet;
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
  const read = element("div", { class: "readout" });
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

  const scene = (flown) => {
    const renderer = new THREE.WebGLRenderer({ antialias: true, alpha: true });
    const canvas = renderer.domElement;
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", "the vehicle in three dimensions; drag to turn, wheel to come nearer");
    const camera = new THREE.PerspectiveCamera(40, 2, 0.02, 20000);
    const root = new THREE.Scene();
    const world = new THREE.Group();
    world.matrixAutoUpdate = false;
    world.matrix.set(0, 1, 0, 0, 0, 0, -1, 0, -1, 0, 0, 0, 0, 0, 0, 1);
    root.add(world);
    root.add(new THREE.HemisphereLight(0xffffff, 0x667788, 2.2));
    const sun = new THREE.DirectionalLight(0xffffff, 1.6);
    sun.position.set(3, 8, 5);
    root.add(sun);

    const vector = (list) => new THREE.Vector3(list[0], list[1], list[2]);
    const turned = (from, to, line) => line.quaternion.setFromUnitVectors(from, to);
    const UP = new THREE.Vector3(0, 1, 0);
    const rod = (from, to, radius, material) => {
      const along = to.clone().sub(from);
      const mesh = new THREE.Mesh(new THREE.CylinderGeometry(radius, radius, along.length() || 1e-6, 10), material);
      mesh.position.copy(from).addScaledVector(along, 0.5);
      turned(UP, along.normalize(), mesh);
      return mesh;
    };

    // ---- the vehicle: places from vehicle.toml, thicknesses in shares of its size
    const build = (about, colour, ghost) => {
      const places = [...about.jets.map((jet) => jet.position), ...about.contacts.map((contact) => contact.position)];
      const size = Math.max(0.05, ...places.flat().map(Math.abs));
      const paint = (hex, opacity) => ghost
        ? new THREE.MeshBasicMaterial({ color: colour, transparent: true, opacity: 0.16, depthWrite: false })
        : new THREE.MeshLambertMaterial({ color: hex, transparent: opacity < 1, opacity, side: THREE.DoubleSide, depthWrite: opacity === 1 });
      const body = new THREE.Group();
      // the hull lies between the points it touches with and the stations
      const hull = about.contacts.filter((contact) => contact.kind === "hull").map((contact) => vector(contact.position));
      const corners = [...hull, ...about.jets.map((jet) => vector(jet.position)), new THREE.Vector3(0, 0, 0)];
      const thick = 0.05 * size;
      const shell = corners.flatMap((corner) => [corner, corner.clone().add(new THREE.Vector3(0, 0, thick))]);
      if (corners.length > 3) {
        const geometry = new THREE.ConvexGeometry(shell);
        body.add(new THREE.Mesh(geometry, paint(colour, 0.4)));
        body.add(new THREE.LineSegments(new THREE.EdgesGeometry(geometry, 20), new THREE.LineBasicMaterial({ color: colour, transparent: true, opacity: ghost ? 0.8 : 0.9 })));
      }
      const nose = new THREE.Mesh(new THREE.CylinderGeometry(0, 0.09 * size, 0.22 * size, 12), paint(0xf08c00, 1)); // it points forward
      nose.position.set(Math.max(0, ...places.map((at) => at[0])) + 0.13 * size, 0, Math.min(0, ...places.map((at) => at[2])) * 0.5);
      turned(UP, new THREE.Vector3(1, 0, 0), nose);
      body.add(nose);
      for (const contact of about.contacts) {
        if (contact.kind !== "leg") continue;
        const foot = vector(contact.position);
        const above = Math.max(...corners.filter((at) => at.lengthSq() > 0).map((at) => at.z).filter((z) => z < foot.z), -Infinity);
        body.add(rod(new THREE.Vector3(foot.x, foot.y, Number.isFinite(above) ? above : Math.min(0, foot.z)), foot, 0.018 * size, paint(0x868e96, 1)));
        const ball = new THREE.Mesh(new THREE.SphereGeometry(0.04 * size, 10, 8), paint(0x495057, 1));
        ball.position.copy(foot);
        body.add(ball);
      }
      let apart = Infinity;
      about.jets.forEach((a, n) => about.jets.slice(n + 1).forEach((b) => { apart = Math.min(apart, vector(a.position).distanceTo(vector(b.position)) || Infinity); }));
      const radius = Math.min(0.22 * size, Number.isFinite(apart) ? 0.42 * apart : 0.2 * size);
      const jets = about.jets.map((jet) => {
        const group = new THREE.Group(), at = vector(jet.position), axis = vector(jet.axis);
        const material = paint(0x4a5b6c, 1);
        const duct = new THREE.Mesh(new THREE.CylinderGeometry(radius, 0.85 * radius, 1.5 * radius, 24, 1, true), material);
        const inlet = new THREE.Mesh(new THREE.CylinderGeometry(0.96 * radius, 0.96 * radius, 0.05 * radius, 24), paint(0x212529, 1));
        for (const part of [duct, inlet]) { turned(UP, axis, part); group.add(part); }
        inlet.position.copy(axis).multiplyScalar(0.3 * radius);
        group.position.copy(at);
        body.add(group);
        const arrow = ghost ? null : new THREE.ArrowHelper(axis, at, 0.1, 0xe03131, 0.1 * size, 0.08 * size);
        if (arrow) body.add(arrow);
        return { group, arrow, at, axis, material, turns: jet.turns.map((turn) => ({ ...turn, point: vector(turn.point), about: vector(turn.axis) })) };
      });
      return { body, jets, size };
    };

    const attitude = (roll, pitch, yaw) => {
      const [cr, sr, cp, sp, cy, sy] = [Math.cos(roll / 2), Math.sin(roll / 2), Math.cos(pitch / 2), Math.sin(pitch / 2), Math.cos(yaw / 2), Math.sin(yaw / 2)];
      return new THREE.Quaternion(sr * cp * cy - cr * sp * sy, cr * sp * cy + sr * cp * sy, cr * cp * sy - sr * sp * cy, cr * cp * cy + sr * sp * sy);
    };

    const TRACK = 20000; // points of a track, at most
    const vehicles = flown.map((flight, n) => {
      const colour = new THREE.Color(flight.colour || (n ? "#f08c00" : "#2f7de1"));
      const real = build(flight.vehicle, colour, false), ghost = build(flight.vehicle, colour, true);
      world.add(real.body, ghost.body);
      const every = Math.max(1, Math.ceil(flight.rows / TRACK));
      const count = Math.ceil(flight.rows / every);
      const points = new Float32Array(3 * count);
      const columns = ["north_m", "east_m", "down_m"].map((name) => flight.read.get(name).values);
      for (let i = 0; i < count; i++) for (let axis = 0; axis < 3; axis++) points[3 * i + axis] = columns[axis][i * every];
      const geometry = new THREE.BufferGeometry().setAttribute("position", new THREE.BufferAttribute(points, 3));
      const past = geometry.clone();
      const all = new THREE.Line(geometry, new THREE.LineBasicMaterial({ color: colour, transparent: true, opacity: 0.3 }));
      const done = new THREE.Line(past, new THREE.LineBasicMaterial({ color: colour }));
      for (const line of [all, done]) { line.frustumCulled = false; world.add(line); }
      const plumb = new THREE.Line(new THREE.BufferGeometry().setAttribute("position", new THREE.BufferAttribute(new Float32Array(6), 3)), new THREE.LineDashedMaterial({ color: colour, dashSize: 0.1, gapSize: 0.08 }));
      plumb.frustumCulled = false;
      world.add(plumb);
      const wind = new THREE.ArrowHelper(new THREE.Vector3(1, 0, 0), new THREE.Vector3(), 1, 0x1098ad);
      world.add(wind);
      const share = flight.vehicle.mass ? flight.vehicle.mass * 9.80665 / Math.max(1, flight.vehicle.jets.length) : 10;
      return { flight, real, ghost, past, every, plumb, wind, share };
    });
    const size = Math.max(...vehicles.map((each) => each.real.size));

    // ---- ground: lines a metre apart, or as the track wants
    let reach = 5;
    for (const { flight } of vehicles) for (const name of ["north_m", "east_m"]) { const [low, high] = flight.read.get(name).span(0, flight.rows); reach = Math.max(reach, Math.abs(low), Math.abs(high)); }
    const cell = 10 ** Math.max(0, Math.ceil(Math.log10(reach / 30)));
    const half = cell * Math.ceil(1.6 * reach / cell);
    const grid = [];
    for (let at = -half; at <= half + 1e-9; at += cell) grid.push(at, -half, 0, at, half, 0, -half, at, 0, half, at, 0);
    const ground = new THREE.LineSegments(new THREE.BufferGeometry().setAttribute("position", new THREE.BufferAttribute(new Float32Array(grid), 3)), new THREE.LineBasicMaterial());
    world.add(ground);
    const floor = new THREE.Mesh(new THREE.CircleGeometry(half * 1.5, 48), new THREE.MeshBasicMaterial({ transparent: true, opacity: 0.5, side: THREE.DoubleSide, depthWrite: false }));
    floor.position.z = 0.002;
    world.add(floor);
    world.add(new THREE.ArrowHelper(new THREE.Vector3(1, 0, 0), new THREE.Vector3(0, 0, -0.005), Math.min(half, 3 * size + 1), 0xc92a2a, 0.25, 0.15));
    const colours = () => {
      ground.material.color.set(style("--zero"));
      floor.material.color.set(style("--line"));
      renderer.setClearColor(new THREE.Color(style("--page")), 1);
    };
    colours();
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { colours(); show(); });

    // ---- camera
    const controls = new THREE.OrbitControls(camera, canvas);
    controls.enableDamping = false;
    controls.maxDistance = 40 * half;
    controls.minDistance = 2 * size;
    controls.enablePan = true;
    canvas.style.touchAction = "pan-y";
    const inWorld = (north, east, down) => new THREE.Vector3(east, -down, -north);
    let follow = true;
    const kinds = ["beside", "from above", "from behind", "whole track"];
    let kind = 0;
    const look = () => {
      const first = vehicles[0].real.body.position;
      const at = inWorld(first.x, first.y, first.z);
      follow = kind < 3;
      if (follow) {
        controls.target.copy(at);
        const far = 7.5 * size;
        camera.position.copy(at).add([new THREE.Vector3(0.75 * far, 0.42 * far, 0.75 * far), new THREE.Vector3(0, 1.2 * far, 0.02 * far), new THREE.Vector3(0, 0.25 * far, 1.1 * far)][kind]);
      } else {
        const box = [Infinity, Infinity, Infinity, -Infinity, -Infinity, -Infinity];
        for (const { flight } of vehicles) ["north_m", "east_m", "down_m"].forEach((name, axis) => { const [low, high] = flight.read.get(name).span(0, flight.rows); box[axis] = Math.min(box[axis], low); box[axis + 3] = Math.max(box[axis + 3], high); });
        const centre = inWorld(...[0, 1, 2].map((axis) => (box[axis] + box[axis + 3]) / 2));
        const wide = Math.max(6 * size, Math.hypot(box[3] - box[0], box[4] - box[1], box[5] - box[2]));
        controls.target.copy(centre);
        camera.position.copy(centre).add(new THREE.Vector3(0.7 * wide, 0.75 * wide, 1.0 * wide));
      }
      controls.update();
      choose.selectedIndex = kind;
      show();
    };
    const choose = element("select", { "aria-label": "camera (c)" }, ...kinds.map((name) => element("option", {}, name)));
    choose.addEventListener("change", () => { kind = choose.selectedIndex; look(); });
    views = () => { kind = (kind + 1) % kinds.length; look(); };

    // ---- a moment
    const last = new THREE.Vector3();
    const pose = (n) => {
      const each = vehicles[n], flight = each.flight;
      const row = Math.max(0, flight.row(Math.min(state.t, flight.end)));
      // between two samples the place goes on in a straight line and the attitude along the arc
      const next = Math.min(row + 1, flight.rows - 1);
      const from = flight.time(row), span = flight.time(next) - from;
      const share = span > 0 ? Math.max(0, Math.min(1, (state.t - from) / span)) : 0;
      const mixed = (name) => { const a = flight.at(name, row), b = flight.at(name, next); return a + share * (b - a); };
      const turn = (at, suffix = "_rad") => attitude(flight.at(`roll${suffix}`, at), flight.at(`pitch${suffix}`, at), flight.at(`yaw${suffix}`, at));
      return { row, place: [mixed("north_m"), mixed("east_m"), mixed("down_m")], quaternion: turn(row).slerp(turn(next), share) };
    };
    const spin = new THREE.Quaternion();
    const put = (each, n) => {
      const { flight, real, ghost } = each;
      const at = pose(n), row = at.row, value = (name) => flight.at(name, row);
      real.body.position.set(...at.place);
      real.body.quaternion.copy(at.quaternion);
      const or = (a, b) => Number.isFinite(a) ? a : b;
      const asked = ["roll", "pitch", "yaw"].map((axis) => value(`${axis}_setpoint_rad`));
      const where = [value("north_setpoint_m"), value("east_setpoint_m"), -value("altitude_setpoint_m")];
      ghost.body.visible = [...asked, ...where].some(Number.isFinite);
      // the height is above the ground, as the log's column has it
      const level = at.place[2] + value("altitude_m");
      ghost.body.position.set(or(where[0], at.place[0]), or(where[1], at.place[1]), Number.isFinite(where[2]) ? where[2] + level : at.place[2]);
      ghost.body.quaternion.copy(attitude(or(asked[0], value("roll_rad")), or(asked[1], value("pitch_rad")), or(asked[2], value("yaw_rad"))));
      real.jets.forEach((jet, index) => {
        const twin = ghost.jets[index];
        jet.group.position.copy(jet.at);
        jet.group.quaternion.identity();
        for (const turn of jet.turns) {
          spin.setFromAxisAngle(turn.about, (turn.effect ?? 1) * or(value(turn.column), 0));
          if (!turn.deflects) jet.group.position.sub(turn.point).applyQuaternion(spin).add(turn.point);
          jet.group.quaternion.premultiply(spin);
        }
        twin.group.position.copy(jet.group.position);
        twin.group.quaternion.copy(jet.group.quaternion);
        const thrust = value(`thrust_${index + 1}_N`);
        const length = real.size * Math.max(0, or(thrust, 0)) / each.share;
        jet.arrow.visible = length > 1e-3;
        jet.arrow.position.copy(jet.group.position);
        jet.arrow.setDirection(jet.axis.clone().applyQuaternion(jet.group.quaternion));
        jet.arrow.setLength(Math.max(length, 1e-3), Math.min(0.12 * real.size, 0.4 * length + 1e-4), 0.09 * real.size);
        jet.material.color.set(value(`fault_jet_${index + 1}`) > 0 ? 0xe03131 : value(`health_${index + 1}`) < 1 ? 0xf08c00 : 0x4a5b6c);
      });
      each.past.setDrawRange(0, Math.floor(row / each.every) + 1);
      const line = each.plumb.geometry.attributes.position;
      line.setXYZ(0, ...at.place);
      line.setXYZ(1, at.place[0], at.place[1], 0);
      line.needsUpdate = true;
      each.plumb.computeLineDistances();
      const air = new THREE.Vector3(...["north", "east", "down"].map((axis) => or(value(`wind_${axis}_m_s`), 0)));
      const force = air.length();
      each.wind.visible = force > 0.01;
      if (force > 0.01) {
        each.wind.setDirection(air.clone().normalize());
        const length = Math.min(6 * real.size, 0.5 * real.size * force);
        each.wind.position.copy(real.body.position).add(new THREE.Vector3(0, 0, -1.6 * real.size)).addScaledVector(air.normalize(), -0.5 * length);
        each.wind.setLength(length, 0.2 * real.size, 0.12 * real.size);
      }
    };

    const deg = (value) => Number.isFinite(value) ? `${(value * 180 / Math.PI).toFixed(1)}°` : "–";
    const words = () => vehicles.map(({ flight, real, share }, n) => {
      const row = pose(n).row, value = (name) => flight.at(name, row);
      const speed = Math.hypot(value("velocity_north_m_s"), value("velocity_east_m_s"), value("velocity_down_m_s"));
      const wind = Math.hypot(value("wind_north_m_s"), value("wind_east_m_s"), value("wind_down_m_s"));
      const thrust = flight.vehicle.jets.reduce((sum, _, jet) => sum + value(`thrust_${jet + 1}_N`), 0);
      const is = (x, digits, unit) => Number.isFinite(x) ? `${x.toFixed(digits)} ${unit}` : "–";
      return `${vehicles.length > 1 ? `${flight.label}: ` : ""}${is(value("altitude_m"), 2, "m high")}, ${is(speed, 2, "m/s")}, roll ${deg(value("roll_rad"))}, pitch ${deg(value("pitch_rad"))}, yaw ${deg(value("yaw_rad"))}, thrust ${is(thrust, 1, "N")}, wind ${is(wind, 1, "m/s")}`;
    });

    let asked = false;
    const show = () => {
      if (asked) return;
      asked = true;
      requestAnimationFrame(() => {
        asked = false;
        vehicles.forEach(put);
        const first = vehicles[0].real.body.position;
        const at = inWorld(first.x, first.y, first.z);
        if (follow) {
          const moved = at.clone().sub(last);
          controls.target.add(moved);
          camera.position.add(moved);
          camera.lookAt(controls.target);
        }
        last.copy(at);
        renderer.render(root, camera);
        read.replaceChildren(...words().map((text, n) => element("div", { style: vehicles.length > 1 ? `color:${vehicles[n].flight.colour}` : "" }, text)));
        canvas.dataset.time = state.t.toFixed(4);
      });
    };
    const fit = () => {
      const width = stage.clientWidth, height = Math.max(220, Math.min(460, 0.56 * width));
      renderer.setPixelRatio(Math.min(2, devicePixelRatio));
      renderer.setSize(width, height);
      camera.aspect = width / height;
      camera.updateProjectionMatrix();
      show();
    };
    stage.replaceChildren(canvas, read, choose);
    vehicles.forEach(put);
    last.copy(inWorld(...vehicles[0].real.body.position.toArray()));
    controls.addEventListener("change", show);
    new ResizeObserver(fit).observe(stage);
    state.listeners.push(show);
    fit();
    look();
    window.hexjet.pose = (n = 0) => { put(vehicles[n], n); const body = vehicles[n].real.body; return { place: body.position.toArray(), quaternion: [body.quaternion.w, body.quaternion.x, body.quaternion.y, body.quaternion.z] }; };
    document.documentElement.dataset.replay = "ready";
  };

  start().catch((error) => without(`The picture could not be drawn (${error.message}).`));
})();
