// Two virtual sticks, by pointer and by keyboard.  They send only while they are switched on and the page is seen.

import { draw, get, write } from "./show.js";

const PERIOD_MS = 50;
const KEY = 0.5; // of full stick; with shift the whole
const KEYS = {
  KeyW: ["throttle", 1], KeyS: ["throttle", -1], KeyA: ["yaw", -1], KeyD: ["yaw", 1],
  ArrowUp: ["pitch", 1], ArrowDown: ["pitch", -1], ArrowLeft: ["roll", -1], ArrowRight: ["roll", 1],
};

class Stick {
  /** `springs` says of each direction, x and y, whether it returns to its centre. */
  constructor(parent, springs) {
    this.parent = parent;
    this.springs = springs;
    this.x = this.y = 0;
    const svg = draw(parent, "svg", { viewBox: "-1.2 -1.2 2.4 2.4" });
    draw(svg, "line", { x1: -1.2, x2: 1.2, y1: 0, y2: 0, "stroke-width": 0.02 });
    draw(svg, "line", { y1: -1.2, y2: 1.2, x1: 0, x2: 0, "stroke-width": 0.02 });
    this.knob = draw(svg, "circle", { r: 0.2 });
    parent.addEventListener("pointerdown", (event) => {
      if (!parent.classList.contains("on")) return;
      parent.setPointerCapture(event.pointerId);
      this.held = event.pointerId;
      this.follow(event);
    });
    parent.addEventListener("pointermove", (event) => event.pointerId === this.held && this.follow(event));
    for (const kind of ["pointerup", "pointercancel", "lostpointercapture"]) {
      parent.addEventListener(kind, (event) => event.pointerId === this.held && this.release());
    }
  }

  follow(event) {
    const box = this.parent.getBoundingClientRect();
    const at = (offset, size) => Math.min(1, Math.max(-1, (2.4 * offset) / size - 1.2));
    this.set(at(event.clientX - box.left, box.width), -at(event.clientY - box.top, box.height));
  }

  release() {
    this.held = undefined;
    const [x, y] = this.springs();
    this.set(x ? 0 : this.x, y ? 0 : this.y);
  }

  set(x, y) {
    [this.x, this.y] = [x, y];
    this.knob.setAttribute("cx", x);
    this.knob.setAttribute("cy", -y);
  }
}

export class Sticks {
  /** `send({roll, pitch, yaw, throttle})` is called while the sticks are on. */
  constructor(send) {
    this.send = send;
    this.direct = false; // the throttle is the thrust: it stays where it is put
    this.keys = new Set();
    this.left = new Stick(get("stick-left"), () => [true, !this.direct]);
    this.right = new Stick(get("stick-right"), () => [true, true]);
    this.box = get("sticks-on");
    this.box.addEventListener("change", () => this.turn(this.box.checked));
    // a page that is not seen has slow clocks, and a key that is let go elsewhere is not seen either
    document.addEventListener("visibilitychange", () => document.hidden && this.off("Off: the page was hidden."));
    addEventListener("blur", () => this.letGo());
    addEventListener("keydown", (event) => this.key(event, true));
    addEventListener("keyup", (event) => this.key(event, false));
  }

  turn(on) {
    this.letGo();
    this.box.checked = on;
    for (const stick of [this.left, this.right]) stick.parent.classList.toggle("on", on);
    clearInterval(this.clock);
    if (on) this.clock = setInterval(() => this.send(this.read()), PERIOD_MS);
    if (on) this.send(this.read());
    write(get("sticks-note"), on ? "On, 20 times a second. If they stop, the vehicle holds." : "Off. They act in MANUAL, STABILIZED, ALTCTL and POSCTL.");
  }

  off(why) {
    if (!this.box.checked) return;
    this.turn(false);
    write(get("sticks-note"), why);
  }

  /** The mode has changed; `grounded`: on the ground, where a throttle that is thrust begins at none. */
  mode(direct, grounded) {
    if (direct === this.direct) return;
    this.direct = direct;
    this.left.set(this.left.x, direct && grounded ? -1 : 0);
  }

  letGo() {
    this.keys.clear();
    this.left.release();
    this.right.release();
  }

  key(event, down) {
    const typing = event.target.closest?.("input:not([type=checkbox]), select, dialog");
    if (!KEYS[event.code] || !this.box.checked || (down && (typing || event.ctrlKey || event.metaKey || event.altKey))) return;
    event.preventDefault();
    if (down) this.keys.add(event.code);
    else this.keys.delete(event.code);
    this.size = event.shiftKey ? 1 : KEY;
    this.fromKeys(KEYS[event.code][0]);
  }

  fromKeys(changed) {
    const sum = (name) => [...this.keys].reduce((total, code) => total + (KEYS[code][0] === name ? KEYS[code][1] : 0), 0) * this.size;
    if (changed === "throttle" || changed === "yaw") {
      // a throttle that stays is moved by keys, not put
      const throttle = this.direct ? Math.min(1, Math.max(-1, this.left.y + 0.2 * sum("throttle"))) : sum("throttle");
      this.left.set(sum("yaw"), throttle);
    } else {
      this.right.set(sum("roll"), sum("pitch"));
    }
  }

  read() {
    const round = (value) => Math.round(1000 * value) / 1000;
    return { roll: round(this.right.x), pitch: round(this.right.y), yaw: round(this.left.x), throttle: round((this.left.y + 1) / 2) };
  }
}
