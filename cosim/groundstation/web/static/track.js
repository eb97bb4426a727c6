// The track seen from above: a plane of metres, north up, with the origin where the flight has begun.

import { css, number } from "./show.js";

const KEPT = 6000; // points of the track
const APART = 0.1; // m between two points that are kept
const LEAST = 8; // m, half of the smallest view

export class Track {
  /** `chosen(north, east)` is called for a click. */
  constructor(canvas, chosen) {
    this.canvas = canvas;
    this.points = [];
    this.centre = [0, 0];
    this.half = 20; // m from the middle to the nearer edge
    this.fitting = true;
    this.marked = null;
    this.now = null;
    canvas.addEventListener("click", (event) => {
      this.marked = this.toPlane(event.offsetX, event.offsetY);
      chosen(...this.marked);
    });
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.zoom(event.deltaY > 0 ? 1.15 : 1 / 1.15);
    }, { passive: false });
    canvas.addEventListener("keydown", (event) => {
      if (event.key === "+") this.zoom(1 / 1.5);
      if (event.key === "-") this.zoom(1.5);
    });
  }

  zoom(factor) {
    this.fitting = false;
    this.half = Math.min(5000, Math.max(2, this.half * factor));
  }

  fit() {
    this.fitting = true;
  }

  clear() {
    this.points = [];
  }

  mark(north, east) {
    this.marked = north === null ? null : [north, east];
  }

  /** Take a state in. */
  take(state) {
    this.now = state;
    const [north, east] = state.position;
    const last = this.points.at(-1);
    if (!last || Math.hypot(last[0] - north, last[1] - east) > APART) this.points.push([north, east]);
    if (this.points.length > KEPT) this.points.splice(0, KEPT / 4);
  }

  look() {
    if (!this.fitting || !this.now) return;
    const seen = [...this.points, this.now.position, this.now.home, this.now.target, this.marked].filter(Boolean);
    const lows = [0, 1].map((i) => seen.reduce((least, each) => Math.min(least, each[i]), Infinity));
    const highs = [0, 1].map((i) => seen.reduce((most, each) => Math.max(most, each[i]), -Infinity));
    const { clientWidth: width, clientHeight: height } = this.canvas;
    const edge = Math.min(width, height) || 1;
    this.centre = [0, 1].map((i) => (lows[i] + highs[i]) / 2);
    const need = Math.max(((highs[0] - lows[0]) * edge) / (height || 1), ((highs[1] - lows[1]) * edge) / (width || 1));
    const wanted = Math.max(LEAST, 0.62 * need);
    // grow at once, shrink only when much is empty: the view should stand still
    if (wanted > this.half || wanted < 0.5 * this.half) this.half = 1.25 * wanted;
  }

  get scale() {
    return Math.min(this.canvas.clientWidth, this.canvas.clientHeight) / (2 * this.half);
  }

  toPlane(x, y) {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    return [this.centre[0] - (y - height / 2) / this.scale, this.centre[1] + (x - width / 2) / this.scale];
  }

  toScreen([north, east]) {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    return [width / 2 + (east - this.centre[1]) * this.scale, height / 2 - (north - this.centre[0]) * this.scale];
  }

  draw() {
    this.look();
    const { canvas } = this, dots = window.devicePixelRatio || 1;
    const width = canvas.clientWidth, height = canvas.clientHeight;
    if (!width || !height) return;
    if (canvas.width !== Math.round(width * dots) || canvas.height !== Math.round(height * dots)) {
      canvas.width = Math.round(width * dots);
      canvas.height = Math.round(height * dots);
    }
    const g = canvas.getContext("2d");
    g.setTransform(dots, 0, 0, dots, 0, 0);
    g.fillStyle = css("--field");
    g.fillRect(0, 0, width, height);
    this.grid(g, width, height);
    if (!this.now) return;
    this.path(g);
    if (this.now.home) this.home(g, this.toScreen(this.now.home));
    if (this.now.target) this.ring(g, this.toScreen(this.now.target), css("--asked"), 7);
    if (this.marked) this.cross(g, this.toScreen(this.marked));
    this.vehicle(g, this.toScreen(this.now.position), this.now.attitude_deg[2]);
  }

  grid(g, width, height) {
    const raw = (2 * this.half) / 5, power = 10 ** Math.floor(Math.log10(raw));
    const mesh = [1, 2, 5, 10].map((n) => n * power).find((n) => n >= raw);
    const [top, left] = this.toPlane(0, 0), [bottom, right] = this.toPlane(width, height);
    g.strokeStyle = css("--line");
    g.lineWidth = 1;
    g.fillStyle = css("--dim");
    g.font = "11px system-ui, sans-serif";
    const digits = mesh < 1 ? 1 : 0;
    for (let east = Math.ceil(left / mesh) * mesh; east <= right; east += mesh) {
      const [x] = this.toScreen([0, east]);
      line(g, [[x, 0], [x, height]]);
      if (x > 34 && x < width - 60) g.fillText(number(east, digits), x + 3, height - 5);
    }
    for (let north = Math.ceil(bottom / mesh) * mesh; north <= top; north += mesh) {
      const [, y] = this.toScreen([north, 0]);
      line(g, [[0, y], [width, y]]);
      if (y > 24 && y < height - 20) g.fillText(number(north, digits), 4, y - 3);
    }
    g.fillText("N (m)", 4, 12);
    g.fillText("E (m)", width - 34, height - 5);
  }

  path(g) {
    g.strokeStyle = css("--measured");
    g.lineWidth = 2;
    line(g, this.points.map((point) => this.toScreen(point)));
  }

  home(g, [x, y]) {
    g.fillStyle = css("--good");
    g.beginPath();
    g.arc(x, y, 9, 0, 7);
    g.fill();
    g.fillStyle = css("--card");
    g.font = "bold 11px system-ui, sans-serif";
    g.fillText("H", x - 4, y + 4);
  }

  ring(g, [x, y], colour, size) {
    g.strokeStyle = colour;
    g.lineWidth = 2;
    g.beginPath();
    g.arc(x, y, size, 0, 7);
    g.stroke();
  }

  cross(g, [x, y]) {
    g.strokeStyle = css("--bad");
    g.lineWidth = 2;
    line(g, [[x - 8, y], [x + 8, y]]);
    line(g, [[x, y - 8], [x, y + 8]]);
  }

  vehicle(g, [x, y], heading) {
    g.save();
    g.translate(x, y);
    g.rotate((heading * Math.PI) / 180);
    g.fillStyle = css("--ink");
    g.strokeStyle = css("--card");
    g.lineWidth = 1.5;
    g.beginPath();
    g.moveTo(0, -13);
    g.lineTo(9, 10);
    g.lineTo(0, 5);
    g.lineTo(-9, 10);
    g.closePath();
    g.fill();
    g.stroke();
    g.restore();
  }
}

function line(g, points) {
  g.beginPath();
  for (const [x, y] of points) g.lineTo(x, y);
  g.stroke();
}
