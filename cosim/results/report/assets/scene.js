// Vehicles in three dimensions, for the replay of finished flights and for the live page: drawn from what `shape` in
// signals_data.py tells of vehicle.toml, put where the caller says.
// Everything inside `world` is north-east-down; three.js has x east, y up, z south.
"use strict";
(() => {
  const attitude = (roll, pitch, yaw) => {
    const [cr, sr, cp, sp, cy, sy] = [Math.cos(roll / 2), Math.sin(roll / 2), Math.cos(pitch / 2), Math.sin(pitch / 2), Math.cos(yaw / 2), Math.sin(yaw / 2)];
    return new THREE.Quaternion(sr * cp * cy - cr * sp * sy, cr * sp * cy + sr * cp * sy, cr * cp * sy - sr * sp * cy, cr * cp * cy + sr * sp * sy);
  };

  // flown: of each vehicle {vehicle, colour, label, track, whole, bounds}: track has north, east, down of one point after the
  // other, is drawn as far as it is flown and, if `whole`, palely to its end; bounds() gives least and greatest of each axis.
  // moment(n): where it is, {place, quaternion, value, seen}: value(name) is that of a column of the log, or NaN; so many points
  // of its track are flown.  drawn() is called after each picture; high(width) is the picture's height in pixels.
  // Gives {show, views, put, moved}: draw, next camera, put a vehicle to its moment, tell that a track has grown.
  const make = ({ stage, flown, moment, element, style, drawn = () => {}, high = (width) => Math.max(220, Math.min(460, 0.65 * width)) }) => {
    const read = element("div", { class: "readout" });
    // where the processor draws, a picture that moves is coarser, without smooth edges: that is more than half of its cost
    const probe = document.createElement("canvas").getContext("webgl2");
    const naming = probe && probe.getExtension("WEBGL_debug_renderer_info");
    const slow = /swiftshader|llvmpipe|softpipe|software|basic render/i.test(naming ? probe.getParameter(naming.UNMASKED_RENDERER_WEBGL) : "");
    const losing = probe && probe.getExtension("WEBGL_lose_context");
    if (losing) losing.loseContext();
    const renderer = new THREE.WebGLRenderer({ antialias: !slow, alpha: true });
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
      const places = [...about.jets.map((jet) => jet.position), ...about.contacts.map((contact) => contact.position), ...about.panels.flatMap((panel) => panel.corners)];
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
        body.add(new THREE.Mesh(geometry, paint(colour, 0.16))); // what the points enclose; of the hull's own shape nothing is known
        body.add(new THREE.LineSegments(new THREE.EdgesGeometry(geometry, 20), new THREE.LineBasicMaterial({ color: colour, transparent: true, opacity: ghost ? 0.8 : 0.9 })));
      }
      const nose = new THREE.Mesh(new THREE.CylinderGeometry(0, 0.09 * size, 0.22 * size, 12), paint(0xf08c00, 1)); // it points forward
      nose.position.set(Math.max(0, ...places.map((at) => at[0])) + 0.13 * size, 0, Math.min(0, ...places.map((at) => at[2])) * 0.5);
      turned(UP, new THREE.Vector3(1, 0, 0), nose);
      body.add(nose);
      for (const contact of about.contacts) {
        if (contact.kind !== "leg") continue;
        const foot = vector(contact.position);
        // from the nearest place above it that is known to be one of the vehicle's: no leg hangs in the air
        const root = corners.filter((at) => at.z < foot.z).reduce((best, at) => at.distanceTo(foot) < best.distanceTo(foot) ? at : best, new THREE.Vector3(0, 0, Math.min(0, foot.z)));
        body.add(rod(root, foot, 0.018 * size, paint(0x868e96, 1)));
        const ball = new THREE.Mesh(new THREE.SphereGeometry(0.04 * size, 10, 8), paint(0x495057, 1));
        ball.position.copy(foot);
        body.add(ball);
      }
      let apart = Infinity;
      about.jets.forEach((a, n) => about.jets.slice(n + 1).forEach((b) => { apart = Math.min(apart, vector(a.position).distanceTo(vector(b.position)) || Infinity); }));
      const radius = Math.min(0.22 * size, Number.isFinite(apart) ? 0.42 * apart : 0.2 * size);
      for (const jet of about.jets) if (vector(jet.position).length() > 1e-6) body.add(rod(new THREE.Vector3(0, 0, 0), vector(jet.position), 0.02 * size, paint(colour, 1)));
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
      // wings and tails, flat; one with a column turns about its first edge
      const panels = about.panels.map((panel) => {
        const group = new THREE.Group(), corners = panel.corners.map(vector), at = corners[0];
        const local = corners.map((corner) => corner.clone().sub(at));
        const geometry = new THREE.BufferGeometry().setFromPoints(local.slice(2).flatMap((corner, n) => [local[0], local[n + 1], corner]));
        geometry.computeVertexNormals();
        group.add(new THREE.Mesh(geometry, paint(panel.column ? 0xf08c00 : colour, 0.7)));
        group.add(new THREE.Line(new THREE.BufferGeometry().setFromPoints([...local, local[0]]), new THREE.LineBasicMaterial({ color: colour, transparent: true, opacity: ghost ? 0.8 : 0.9 })));
        group.position.copy(at);
        body.add(group);
        return { group, column: panel.column, turn: panel.turn, about: corners[1].clone().sub(at).normalize() };
      });
      return { body, jets, panels, size };
    };

    const vehicles = flown.map((flight, n) => {
      const colour = new THREE.Color(flight.colour || (n ? "#f08c00" : "#2f7de1"));
      const real = build(flight.vehicle, colour, false), ghost = build(flight.vehicle, colour, true);
      world.add(real.body, ghost.body);
      const geometry = new THREE.BufferGeometry().setAttribute("position", new THREE.BufferAttribute(flight.track, 3));
      const past = flight.whole ? geometry.clone() : geometry;
      const all = new THREE.Line(geometry, new THREE.LineBasicMaterial({ color: colour, transparent: true, opacity: 0.3 }));
      const done = new THREE.Line(past, new THREE.LineBasicMaterial({ color: colour }));
      for (const line of flight.whole ? [all, done] : [done]) { line.frustumCulled = false; world.add(line); }
      const plumb = new THREE.Line(new THREE.BufferGeometry().setAttribute("position", new THREE.BufferAttribute(new Float32Array(6), 3)), new THREE.LineDashedMaterial({ color: colour, dashSize: 0.1, gapSize: 0.08 }));
      plumb.frustumCulled = false;
      world.add(plumb);
      const wind = new THREE.ArrowHelper(new THREE.Vector3(1, 0, 0), new THREE.Vector3(), 1, 0x1098ad);
      world.add(wind);
      const share = flight.vehicle.mass ? flight.vehicle.mass * 9.80665 / Math.max(1, flight.vehicle.jets.length) : 10;
      return { flight, real, ghost, past, plumb, wind, share };
    });
    const size = Math.max(...vehicles.map((each) => each.real.size));

    // ---- ground: lines a metre apart, or as the track wants
    let half = 0;
    const ground = new THREE.LineSegments(new THREE.BufferGeometry(), new THREE.LineBasicMaterial());
    const floor = new THREE.Mesh(new THREE.CircleGeometry(1.5, 48), new THREE.MeshBasicMaterial({ transparent: true, opacity: 0.5, side: THREE.DoubleSide, depthWrite: false }));
    floor.position.z = 0.002;
    const north = new THREE.ArrowHelper(new THREE.Vector3(1, 0, 0), new THREE.Vector3(0, 0, -0.005), 1, 0xc92a2a, 0.25, 0.15);
    world.add(ground, floor, north);
    const lay = () => {
      const reach = Math.max(5, ...flown.flatMap((flight) => { const [low, high] = flight.bounds(); return [low[0], low[1], high[0], high[1]].map(Math.abs); }));
      if (reach <= half / 1.2) return; // a track that grows is given room
      const cell = 10 ** Math.max(0, Math.ceil(Math.log10(reach / 30)));
      half = cell * Math.ceil(1.6 * reach / cell);
      const grid = [];
      for (let at = -half; at <= half + 1e-9; at += cell) grid.push(at, -half, 0, at, half, 0, -half, at, 0, half, at, 0);
      ground.geometry.dispose();
      ground.geometry = new THREE.BufferGeometry().setAttribute("position", new THREE.BufferAttribute(new Float32Array(grid), 3));
      ground.frustumCulled = false;
      floor.scale.set(half, half, 1);
      north.setLength(Math.min(half, 3 * size + 1), 0.25, 0.15);
      if (controls) controls.maxDistance = 40 * half;
    };
    let controls = null;
    lay();
    const colours = () => {
      ground.material.color.set(style("--zero"));
      floor.material.color.set(style("--line"));
      renderer.setClearColor(new THREE.Color(style("--page")), 1);
    };
    colours();
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { colours(); show(); });

    // ---- camera
    controls = new THREE.OrbitControls(camera, canvas);
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
        for (const flight of flown) { const [low, high] = flight.bounds(); for (let axis = 0; axis < 3; axis++) { box[axis] = Math.min(box[axis], low[axis]); box[axis + 3] = Math.max(box[axis + 3], high[axis]); } }
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
    const views = () => { kind = (kind + 1) % kinds.length; look(); };

    // ---- a moment
    const last = new THREE.Vector3();
    const spin = new THREE.Quaternion();
    const put = (each, n) => {
      const { real, ghost } = each;
      const at = moment(n), value = at.value;
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
      real.panels.forEach((panel, index) => {
        if (!panel.column) return;
        panel.group.quaternion.setFromAxisAngle(panel.about, panel.turn * or(value(panel.column), 0));
        ghost.panels[index].group.quaternion.copy(panel.group.quaternion);
      });
      each.past.setDrawRange(0, at.seen);
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

    // no minus before what rounds to 0
    const fixed = (value, digits) => value.toFixed(digits).replace(/^-(?=[0.]*$)/, "");
    const deg = (value) => Number.isFinite(value) ? `${fixed(value * 180 / Math.PI, 1)}°` : "–";
    const words = () => vehicles.map(({ flight, real, share }, n) => {
      const { value } = moment(n);
      const speed = Math.hypot(value("velocity_north_m_s"), value("velocity_east_m_s"), value("velocity_down_m_s"));
      const wind = Math.hypot(value("wind_north_m_s"), value("wind_east_m_s"), value("wind_down_m_s"));
      const thrust = flight.vehicle.jets.reduce((sum, _, jet) => sum + value(`thrust_${jet + 1}_N`), 0);
      const is = (x, digits, unit) => Number.isFinite(x) ? `${fixed(x, digits)} ${unit}` : "–";
      return `${vehicles.length > 1 ? `${flight.label}: ` : ""}${is(value("altitude_m"), 2, "m high")}, ${is(speed, 2, "m/s")}, roll ${deg(value("roll_rad"))}, pitch ${deg(value("pitch_rad"))}, yaw ${deg(value("yaw_rad"))}, thrust ${is(thrust, 1, "N")}, wind ${is(wind, 1, "m/s")}`;
    });

    const moving = Math.min(slow ? 2 / 3 : 2, devicePixelRatio), fine = slow ? 1.5 : moving;
    const draw = (ratio) => {
      if (renderer.getPixelRatio() !== ratio) renderer.setPixelRatio(ratio);
      renderer.render(root, camera);
    };
    let asked = false, stands = 0, seen = true, compiled = false, stale = true;
    const paint = () => {
      if (asked || !compiled) return;
      asked = true;
      requestAnimationFrame(() => {
        asked = stale = false;
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
        draw(moving);
        clearTimeout(stands);
        if (slow) stands = setTimeout(() => requestAnimationFrame(() => draw(fine)), 250);
        read.replaceChildren(...words().map((text, n) => {
          const line = element("div", {}, text);
          if (vehicles.length > 1) line.style.color = vehicles[n].flight.colour; // as an attribute the live page's policy forbids it
          return line;
        }));
        drawn(canvas);
      });
    };
    const show = () => { stale = true; if (seen) paint(); };
    const fit = () => {
      const width = stage.clientWidth, height = high(width);
      if (!width || !height) return; // it is not seen
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
    // out of sight it is drawn once, so that it is there when it is scrolled to; it comes back, also on paper, as it is then
    addEventListener("beforeprint", () => { if (compiled) { vehicles.forEach(put); draw(fine); } });
    new IntersectionObserver((entries) => { seen = entries[entries.length - 1].isIntersecting; if (seen && stale) paint(); }, { rootMargin: "100px" }).observe(stage);
    fit();
    look();
    const begin = () => { compiled = true; paint(); };
    renderer.compileAsync(root, camera).then(begin, begin); // beside what the page does
    return {
      show,
      views,
      put: (n) => { put(vehicles[n], n); const { position, quaternion } = vehicles[n].real.body; return { place: position.toArray(), quaternion: [quaternion.w, quaternion.x, quaternion.y, quaternion.z] }; },
      moved: () => { lay(); for (const { past } of vehicles) past.attributes.position.needsUpdate = true; },
    };
  };

  window.hexjetScene = { make, attitude };
})();
