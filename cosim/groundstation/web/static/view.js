// The vehicle in three dimensions, by the module that draws the replay of finished flights.

import { css, element } from "./show.js";

const POINTS = 20000; // of the track; then every second one goes
const APART = 0.05; // m between two points, at first

export class View {
  constructor(stage, history) {
    Object.assign(this, { stage, history, state: null });
    this.track = new Float32Array(3 * POINTS);
    this.clear();
  }

  /** Why there is no picture; "" where there is one. */
  begin(flight) {
    this.flight = flight;
    if (this.scene || this.without) return this.without ?? "";
    if (typeof THREE === "undefined" || !document.createElement("canvas").getContext("webgl2")) {
      this.without = "This browser shows no WebGL, so there is no picture of the vehicle.";
      this.stage.replaceChildren(element("p", { class: "no-webgl" }, this.without));
    }
    return this.without ?? "";
  }

  clear() {
    this.count = 0;
    this.apart = APART;
    this.low = [0, 0, 0];
    this.high = [0, 0, 0];
    this.scene?.moved();
  }

  place() {
    return ["north_m", "east_m", "down_m"].map((name) => this.history.value(name));
  }

  /** A new row is in the history. */
  take() {
    const place = this.place();
    if (!place.every(Number.isFinite)) return;
    const at = 3 * (this.count - 1);
    if (this.count && Math.hypot(...place.map((value, axis) => value - this.track[at + axis])) < this.apart) return;
    if (this.count === POINTS) {
      for (let i = 0; 2 * i < POINTS; i++) this.track.copyWithin(3 * i, 6 * i, 6 * i + 3);
      this.count = POINTS / 2;
      this.apart *= 2;
    }
    this.track.set(place, 3 * this.count++);
    this.low = this.low.map((value, axis) => Math.min(value, place[axis]));
    this.high = this.high.map((value, axis) => Math.max(value, place[axis]));
    this.scene?.moved();
  }

  moment() {
    const value = (name) => this.history.value(name);
    return { place: this.place(), quaternion: hexjetScene.attitude(value("roll_rad"), value("pitch_rad"), value("yaw_rad")), value, seen: this.count };
  }

  draw() {
    if (this.without || !this.stage.clientWidth || !this.place().every(Number.isFinite)) return;
    if (this.scene) return this.scene.show();
    try {
      this.scene = hexjetScene.make({
        stage: this.stage, element, style: css, moment: () => this.moment(), high: () => this.stage.clientHeight,
        flown: [{ vehicle: this.flight.shape, colour: "#2f7de1", label: "", track: this.track, whole: false, bounds: () => [this.low, this.high] }],
        drawn: (canvas) => { canvas.dataset.time = this.history.end.toFixed(3); },
      });
    } catch (error) {
      this.without = `WebGL does not work in this browser (${error.message}), so there is no picture of the vehicle.`;
      this.stage.replaceChildren(element("p", { class: "no-webgl" }, this.without));
    }
  }
}
