// The strip chart: measured rate against the rate that the rate loop is fed with, over the last seconds.

import { css } from "./show.js";

const WINDOW_S = 15;
const GAP_S = 0.5; // a pause this long is drawn as a gap
const NAMES = ["roll", "pitch", "yaw"];

export class Strip {
  constructor(parent) {
    this.parent = parent;
    this.axis = 0;
    this.points = []; // t, p, q, r, then the predicted ones
    this.make();
    new ResizeObserver(() => this.chart.setSize(this.size())).observe(parent);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.chart.redraw());
  }

  size() {
    return { width: Math.max(120, this.parent.clientWidth), height: Math.max(100, this.parent.clientHeight) };
  }

  make() {
    const axis = (more) => ({ stroke: () => css("--dim"), font: "11px system-ui, sans-serif", grid: { stroke: () => css("--grid"), width: 1 }, ticks: { show: false }, ...more });
    const series = (colour) => ({ stroke: () => css(colour), width: 1.6, points: { show: false } });
    this.chart = new uPlot({
      ...this.size(),
      legend: { show: false },
      cursor: { show: false },
      scales: { x: { time: false, range: () => [this.end - WINDOW_S, this.end] }, y: { range: (_, low, high) => room(low, high) } },
      axes: [
        axis({ space: 60, label: "time of the flight, s", labelSize: 14, labelGap: 0, labelFont: "11px system-ui, sans-serif", size: 22 }),
        axis({ size: 48, values: (_, ticks) => ticks.map((tick) => String(tick).replace("-", "−")), label: "rate, °/s", labelSize: 14, labelGap: 0, labelFont: "11px system-ui, sans-serif" }),
      ],
      series: [{}, series("--measured"), { ...series("--predicted"), dash: [6, 3] }],
    }, [[], [], []], this.parent);
  }

  get end() {
    return Math.max(WINDOW_S, this.points.at(-1)?.[0] ?? 0);
  }

  get last() {
    const point = this.points.at(-1);
    return point ? [point[1 + this.axis], point[4 + this.axis]] : [null, null];
  }

  choose(axis) {
    this.axis = axis;
    this.parent.setAttribute("aria-label", `${NAMES[axis]} rate, measured and predicted`);
  }

  clear() {
    this.points = [];
  }

  take(points) {
    for (const point of points) {
      const last = this.points.at(-1);
      if (last && point[0] <= last[0]) continue;
      if (last && point[0] - last[0] > GAP_S) this.points.push([last[0] + 1e-3, ...Array(6).fill(null)]);
      this.points.push(point);
    }
    const first = this.points.findIndex((point) => point[0] >= this.end - WINDOW_S - 1);
    if (first > 0) this.points.splice(0, first);
  }

  draw() {
    const column = (i) => this.points.map((point) => point[i]);
    this.chart.setData([column(0), column(1 + this.axis), column(4 + this.axis)]);
  }
}

/** A range that changes seldom: the next of 1, 1.5, 2, 3, 5, 7.5 times a power of ten, the same up and down. */
function room(low, high) {
  const most = Math.max(5, Math.abs(low ?? 0), Math.abs(high ?? 0));
  const power = 10 ** Math.floor(Math.log10(most));
  const edge = [1, 1.5, 2, 3, 5, 7.5, 10].map((n) => n * power).find((n) => n >= most);
  return [-edge, edge];
}
