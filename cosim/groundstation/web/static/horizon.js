// The artificial horizon: sky and ground turn and move behind a vehicle that stands still.

import { draw } from "./show.js";

const SCALE = 1.9; // units of the drawing per degree of pitch

export class Horizon {
  constructor(parent) {
    const svg = draw(parent, "svg", { viewBox: "-100 -92 200 184", role: "img", "aria-label": "Artificial horizon" });
    const clip = draw(draw(svg, "defs"), "clipPath", { id: "round" });
    draw(clip, "rect", { x: -98, y: -90, width: 196, height: 180, rx: 12 });
    const view = draw(svg, "g", { "clip-path": "url(#round)" });
    this.turn = draw(view, "g");
    this.move = draw(this.turn, "g");
    draw(this.move, "rect", { x: -300, y: -600, width: 600, height: 600, class: "sky" });
    draw(this.move, "rect", { x: -300, y: 0, width: 600, height: 600, class: "ground" });
    const rungs = draw(draw(svg, "defs"), "clipPath", { id: "rungs" });
    draw(rungs, "rect", { x: -300, y: -64, width: 600, height: 132 });
    this.rungs = draw(draw(this.turn, "g", { "clip-path": "url(#rungs)" }), "g");
    this.ladder();
    this.asked = draw(this.turn, "g", { class: "asked-bar" });
    draw(this.asked, "path", { d: "M-46 0H-22M22 0H46" });
    // the scale of roll turns with the sky, its pointer stays
    const arc = draw(this.turn, "g", { class: "arc" });
    for (const angle of [-60, -45, -30, -20, -10, 0, 10, 20, 30, 45, 60]) {
      const long = angle % 30 === 0 ? 8 : 5;
      draw(arc, "path", { d: `M0 -82V${-82 + long}`, transform: `rotate(${angle})` });
    }
    draw(svg, "path", { d: "M0 -72l-4.5 8h9z", class: "pointer" });
    draw(svg, "path", { d: "M-44 0H-18l6 7M44 0H18l-6 7M0 0h.01", class: "bug" });
    draw(svg, "rect", { x: -98, y: -90, width: 196, height: 180, rx: 12, class: "frame" });
    this.show(null, null);
  }

  ladder() {
    const ladder = draw(this.rungs, "g", { class: "ladder" });
    draw(ladder, "path", { d: "M-300 0H300" });
    for (let pitch = -60; pitch <= 60; pitch += 10) {
      if (pitch === 0) continue;
      const y = -pitch * SCALE;
      draw(ladder, "path", { d: `M-24 ${y}H24M-10 ${y + 5 * SCALE}H10` });
      for (const x of [-36, 28]) draw(ladder, "text", { x, y: y + 2 }, String(Math.abs(pitch)));
    }
  }

  /** Roll, pitch and yaw, measured and asked for, in degrees. */
  show(attitude, asked) {
    const [roll, pitch] = attitude ?? [0, 0];
    this.turn.setAttribute("transform", `rotate(${-roll})`);
    for (const each of [this.move, this.rungs]) each.setAttribute("transform", `translate(0 ${pitch * SCALE})`);
    this.asked.setAttribute("visibility", asked ? "visible" : "hidden");
    if (asked) this.asked.setAttribute("transform", `translate(0 ${(pitch - asked[1]) * SCALE}) rotate(${asked[0]})`);
  }
}
