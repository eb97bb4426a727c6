// What a figure is computed with before anything is drawn: values and their texts, colours of a scale, and axes.
"use strict";
(() => {
  const escaped = (text) => String(text).replace(/&/g, "&amp;").replace(/</g, "&lt;").replace(/>/g, "&gt;").replace(/"/g, "&quot;");
  const bare = (text) => String(text).replace(/<\/?b>/g, "");
  const lines = (text) => bare(text).split("<br>");
  const finite = (value) => typeof value === "number" && Number.isFinite(value);

  // ---- values

  const KINDS = { f4: Float32Array, f8: Float64Array };
  const list = (values) => {
    if (values === undefined || Array.isArray(values)) return values || [];
    const bytes = Uint8Array.from(atob(values.bdata), (each) => each.charCodeAt(0));
    return Array.from(new KINDS[values.dtype](bytes.buffer), (value) => Number.isNaN(value) ? null : value);
  };

  // d3's formats as far as templates use them: sign, digits, ~ without zeros at the end, and g, f or d
  const format = (value, how) => {
    if (!finite(value) || !how) return String(finite(value) ? Number(value.toPrecision(6)) : value);
    const [, sign, digits, trimmed, kind] = /^(\+?)(?:\.(\d+))?(~?)([gfd]?)$/.exec(how) || [null, "", "6", "~", "g"];
    let text = kind === "d" ? value.toFixed(0) : kind === "f" ? value.toFixed(Number(digits)) : value.toPrecision(Math.max(1, Number(digits || 6)));
    if (kind !== "f" && kind !== "d" && Math.abs(value) >= 1e-4 && Math.abs(value) < 1e9 && text.includes("e")) text = String(Number(text));
    if (trimmed) text = text.replace(/(\.\d*?)0+(?=e|$)/, "$1").replace(/\.(?=e|$)/, "");
    return (sign && value > 0 ? "+" : "") + text;
  };
  const filled = (template, point) => template.replace("<extra></extra>", "")
    .replace(/%\{(\w+)(?::([^}]*))?\}/g, (_, name, how) => format(point[name], how));

  const channels = (colour) => [1, 3, 5].map((at) => parseInt(colour.slice(at, at + 2), 16));
  const shade = (scale, position) => {
    const at = Math.min(1, Math.max(0, position));
    const next = Math.max(1, scale.findIndex(([end]) => end >= at));
    const [[from, first], [to, second]] = [scale[next - 1], scale[next]];
    if (first === second) return first;
    const part = (at - from) / (to - from), [a, b] = [channels(first), channels(second)];
    return `rgb(${a.map((value, n) => Math.round(value + part * (b[n] - value))).join(",")})`;
  };

  // ---- axes

  const nice = (span, most) => {
    const raw = span / Math.max(1, most), power = 10 ** Math.floor(Math.log10(raw));
    return power * ([1, 2, 5].find((each) => each * power >= raw * 0.999) || 10);
  };
  const tickText = (value, step) => {
    if (value === 0) return "0";
    if (Math.abs(value) >= 1e6 || Math.abs(value) < 1e-4) return Number(value.toPrecision(4)).toExponential().replace("e+", "e").replaceAll("-", "−");
    const text = step ? value.toFixed(Math.max(0, Math.min(10, -Math.floor(Math.log10(step) + 1e-9)))) : String(Number(value.toPrecision(6)));
    return text.replace("-", "−");
  };

  class Axis {
    constructor(name, about, traces) {
      Object.assign(this, { name, about, letter: name[0], id: name[0] + name.slice(5) });
      const own = traces.filter((trace) => (trace[this.letter + "axis"] || this.letter) === this.id);
      this.own = own;
      const texts = about.categoryarray || [...new Set(own.flatMap((trace) => trace.values[this.letter]).filter((value) => typeof value === "string"))];
      this.categories = about.type === "category" || (!about.type && texts.length) ? [...new Set(own.length && !about.categoryarray ? own.flatMap((trace) => trace.values[this.letter]).map(String) : texts)] : null;
      this.log = about.type === "log";
    }

    // a value in the axis' own measure, in which it is even: its logarithm, or the number of a category
    even(value) {
      if (value === null || value === undefined) return NaN;
      if (this.categories) return typeof value === "number" ? value : this.categories.indexOf(String(value));
      return this.log ? Math.log10(value) : value;
    }

    value(even) { return this.log ? 10 ** even : even; }

    px(value) { return this.at(this.even(value)); }

    at(even) { return this.from + (even - this.range[0]) / (this.range[1] - this.range[0]) * (this.to - this.from); }

    back(px) { return this.range[0] + (px - this.from) / (this.to - this.from) * (this.range[1] - this.range[0]); }

    // around everything that is drawn
    ends(shown, stacked) {
      const { letter, about } = this;
      if (about.range) return [...about.range];
      let [low, high] = [Infinity, -Infinity], padded = letter === "y";
      const take = (value) => { const even = this.even(value); if (finite(even)) { low = Math.min(low, even); high = Math.max(high, even); } };
      for (const trace of shown.filter((each) => this.own.includes(each))) {
        const along = trace.type === "bar" && (trace.orientation === "h") === (letter === "x");
        if (trace.type === "heatmap" || trace.type === "contour") { trace.edges(this).forEach((even) => { low = Math.min(low, even); high = Math.max(high, even); }); padded = false; continue; }
        trace.values[letter].forEach((value, n) => {
          take(along && stacked ? (trace.base ? trace.base[n] : 0) + value : value);
          const error = trace["error_" + letter];
          if (error && finite(value)) { take(value + (error.array[n] || 0)); take(value - ((error.arrayminus || error.array)[n] || 0)); }
        });
        if (along) { take(0); padded = true; }
        if ((trace.mode || "").includes("markers")) padded = true;
      }
      if (this.categories) [low, high] = [-0.5, this.categories.length - 0.5];
      else {
        if (about.rangemode === "tozero") { low = Math.min(low, 0); high = Math.max(high, 0); }
        if (low > high) [low, high] = this.log ? [-1, 1] : [0, 1];
        const margin = low === high ? (this.log ? 0.5 : Math.abs(low) / 2 || 1) : padded ? 0.055 * (high - low) : 0;
        if (!(about.rangemode === "tozero" && low === 0)) low -= margin;
        high += margin;
      }
      return about.autorange === "reversed" ? [high, low] : [low, high];
    }

    ticks() {
      const [low, high] = [Math.min(...this.range), Math.max(...this.range)], { about } = this, length = Math.abs(this.to - this.from);
      const inside = (tick) => tick.even >= low - 1e-9 * Math.abs(high - low) && tick.even <= high + 1e-9 * Math.abs(high - low);
      const made = (value, text) => ({ even: this.even(value), text });
      if (about.tickvals) return about.tickvals.map((value, n) => made(value, about.ticktext ? about.ticktext[n] : tickText(value))).filter(inside);
      if (this.categories) return this.categories.map((name, n) => ({ even: n, text: name })).filter(inside);
      const most = Math.min(about.nticks || 99, Math.max(2, length / (this.letter === "x" ? 70 : 30)));
      if (this.log && high - low > 0.7) {
        const found = [], every = Math.max(1, Math.ceil((high - low) / most));
        const steps = about.dtick || (high - low) * 3 > most * 1.4 ? [1] : [1, 2, 5];
        for (let power = Math.floor(low); power <= Math.ceil(high); power++) for (const step of steps) if (power % every === 0) found.push(made(step * 10 ** power, tickText(step * 10 ** power)));
        return found.filter(inside);
      }
      const [from, to] = [this.value(low), this.value(high)], step = nice(to - from, most), found = [];
      for (let n = Math.ceil(from / step - 1e-9); n * step <= to + 1e-9 * step; n++) found.push(made(n * step, tickText(n * step, step)));
      return found;
    }
  }

  // ---- a figure

  const prepared = (trace) => {
    const made = { ...trace, type: trace.type || "scatter", values: { x: list(trace.x), y: list(trace.y) } };
    // edges of cells in an axis' own measure: given, or halfway between their middles
    made.edges = (axis) => {
      const even = made.values[axis.letter].map((value) => axis.even(value));
      const count = axis.letter === "x" ? made.z[0].length : made.z.length;
      if (even.length > count) return even;
      const middle = even.slice(1).map((value, n) => (value + even[n]) / 2);
      if (!middle.length) return [even[0] - 0.5, even[0] + 0.5];
      return [2 * even[0] - middle[0], ...middle, 2 * even[even.length - 1] - middle[middle.length - 1]];
    };
    return made;
  };
  window.hexjetFigures = { escaped, bare, lines, finite, format, filled, shade, Axis, prepared };
})();
