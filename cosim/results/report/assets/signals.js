// Every sample of the page's flights: columns unpacked when they are looked at, with least and greatest values of any
// stretch of rows, what a window of time shows of them, and their spectra.  `signals_data.py` says what the page carries.
"use strict";
(() => {
  const pageData = JSON.parse(document.getElementById("flight-data").textContent);

  // ---- columns

  const bytesOf = (text) => {
    const binary = atob(text);
    const bytes = new Uint8Array(binary.length);
    for (let i = 0; i < binary.length; i++) bytes[i] = binary.charCodeAt(i);
    return bytes;
  };
  const inflate = async (text) => {
    const stream = new Blob([bytesOf(text)]).stream().pipeThrough(new DecompressionStream("deflate"));
    return new Uint8Array(await new Response(stream).arrayBuffer());
  };

  // the inverse of `pack` in signals_data.py
  const unpack = async (about, rows, text) => {
    const values = new Float64Array(rows);
    if (!text) return values.fill(about.base);
    const raw = await inflate(text);
    const numbers = new Int32Array(rows);
    for (let plane = 0; plane < about.planes; plane++) {
      const from = plane * rows, shift = 8 * plane;
      for (let i = 0; i < rows; i++) numbers[i] |= raw[from + i] << shift;
    }
    for (let i = 0; i < rows; i++) numbers[i] = (numbers[i] >>> 1) ^ -(numbers[i] & 1);
    for (let turn = 0; turn < about.order; turn++) {
      for (let i = 1; i < rows; i++) numbers[i] = (numbers[i] + numbers[i - 1]) | 0;
    }
    for (let i = 0; i < rows; i++) values[i] = about.base + about.step * numbers[i];
    if (about.gaps) {
      const from = about.planes * rows;
      for (let i = 0; i < rows; i++) if (raw[from + i]) values[i] = NaN;
    }
    return values;
  };

  const FAN = 16; // rows of one level in a row of the next

  // least and greatest of any stretch of rows, in a time that does not grow with the flight
  class Pyramid {
    constructor(values) {
      this.values = values;
      this.levels = [];
      let low = values, high = values;
      while (low.length > FAN) {
        const size = Math.ceil(low.length / FAN);
        const lows = new Float64Array(size).fill(Infinity), highs = new Float64Array(size).fill(-Infinity);
        for (let i = 0; i < low.length; i++) {
          const at = (i / FAN) | 0;
          if (low[i] < lows[at]) lows[at] = low[i];
          if (high[i] > highs[at]) highs[at] = high[i];
        }
        this.levels.push([lows, highs]);
        [low, high] = [lows, highs];
      }
    }

    // of rows first to end - 1; [Infinity, -Infinity] where there is no number
    span(first, end) {
      let low = Infinity, high = -Infinity;
      const take = (level, from, to) => {
        const [lows, highs] = level < 0 ? [this.values, this.values] : this.levels[level];
        for (let i = from; i < to; i++) {
          if (lows[i] < low) low = lows[i];
          if (highs[i] > high) high = highs[i];
        }
      };
      let a = first, b = end, level = -1;
      while (b - a > 2 * FAN && level + 1 < this.levels.length) {
        const up = Math.ceil(a / FAN), down = Math.floor(b / FAN);
        take(level, a, up * FAN);
        take(level, down * FAN, b);
        [a, b] = [up, down];
        level++;
      }
      take(level, a, b);
      return [low, high];
    }
  }

  class Flight {
    constructor(about, number) {
      Object.assign(this, about);
      this.number = number;
      this.known = new Map(about.columns.map((column) => [column.name, column]));
      this.read = new Map();
      this.times = null;
    }

    get end() { return this.uniform ? (this.rows - 1) * this.step : this.times[this.rows - 1]; }

    time(row) { return this.uniform ? row * this.step : this.times[row]; }

    // the last row at or before a time; -1 before the first
    row(time) {
      if (this.uniform) return Math.min(this.rows - 1, Math.floor(time / this.step + 1e-6));
      let low = -1, high = this.rows - 1;
      while (low < high) {
        const middle = (low + high + 1) >> 1;
        if (this.times[middle] <= time + 1e-9) low = middle; else high = middle - 1;
      }
      return low;
    }

    // a column's Pyramid; null where the flight has no such column, or no number in it
    column(name) {
      const about = this.known.get(name);
      if (!about) return Promise.resolve(null);
      if (!this.read.has(name)) {
        const place = document.getElementById(`data-${this.number}-${about.data}`);
        const work = unpack(about, this.rows, place ? place.textContent : "").then((values) => {
          const made = new Pyramid(values);
          made.about = about;
          this.read.set(name, made);
          return made;
        });
        this.read.set(name, work);
      }
      return Promise.resolve(this.read.get(name));
    }

    // a value that is there already; NaN if not
    at(name, row) {
      const column = this.read.get(name);
      return column instanceof Pyramid && row >= 0 ? column.values[row] : NaN;
    }
  }

  const flights = pageData.runs.map((about, number) => new Flight(about, number));

  // ---- what is drawn of a window: every sample where there is room, least and greatest of a pixel where not

  const ROOM = 3; // samples a pixel that are still drawn one by one

  const windowOf = (lines, from, to, pixels) => {
    const base = lines.map((line) => line.flight).sort((a, b) => (a.step || 1) - (b.step || 1))[0];
    if (!base || !base.rows) return [[0], ...lines.map(() => [null])];
    const last = Math.max(...lines.map((line) => line.flight.rows && line.flight.end));
    const own = lines.every((line) => line.flight.uniform && line.flight.step === base.step);
    const longest = own ? lines.map((line) => line.flight).sort((a, b) => b.rows - a.rows)[0] : base;
    const first = Math.max(0, longest.row(from)), end = Math.min(longest.rows, longest.row(to) + 2);
    if (end - first <= ROOM * pixels && (own || last <= base.end + 1e-9)) {
      const x = new Float64Array(Math.max(1, end - first));
      for (let i = 0; i < x.length; i++) x[i] = longest.time(first + i);
      return [x, ...lines.map((line) => {
        const y = new Array(x.length), values = line.column.values, scale = line.scale;
        for (let i = 0; i < x.length; i++) {
          const row = own ? first + i : line.flight.row(x[i]);
          const value = row >= 0 && row < values.length && x[i] <= line.flight.end + 1e-9 ? values[row] : NaN;
          y[i] = Number.isNaN(value) ? null : scale * value;
        }
        return y;
      })];
    }
    const buckets = Math.max(2, pixels), width = (to - from) / buckets;
    const x = new Float64Array(2 * buckets);
    const all = lines.map(() => new Array(2 * buckets));
    for (let i = 0; i < buckets; i++) {
      x[2 * i] = from + (i + 0.25) * width;
      x[2 * i + 1] = from + (i + 0.75) * width;
      for (let n = 0; n < lines.length; n++) {
        const { flight, column, scale } = lines[n];
        let a = flight.row(from + i * width) + 1, b = flight.row(from + (i + 1) * width) + 1;
        if (i === 0) a = Math.max(0, a - 1);
        if (b <= a) { a = b - 1; if (from + i * width > flight.end) a = b = -1; }
        const [low, high] = a < 0 ? [Infinity, -Infinity] : column.span(a, b);
        const none = low > high;
        const falling = !none && column.values[a] > column.values[b - 1];
        all[n][2 * i] = none ? null : scale * (falling !== scale < 0 ? high : low);
        all[n][2 * i + 1] = none ? null : scale * (falling !== scale < 0 ? low : high);
      }
    }
    return [x, ...all];
  };

  // one-sided amplitude of each frequency: mean removed, Hann's window, its sum divided out; gaps hold the last value
  const amplitudes = (values, step, scale) => {
    let size = 1;
    const least = Math.max(4, values.length);
    while (2 * size <= Math.min(least, 1 << 18)) size *= 2;
    const re = new Float64Array(size), im = new Float64Array(size);
    let mean = 0, last = 0;
    for (let i = 0; i < size; i++) { const value = values[Math.min(i, values.length - 1)]; if (Number.isFinite(value)) last = value; re[i] = last; mean += last / size; }
    for (let i = 0; i < size; i++) re[i] = (re[i] - mean) * (0.5 - 0.5 * Math.cos(2 * Math.PI * i / size));
    fft(re, im);
    const frequencies = [], all = [];
    for (let i = 1; i < size / 2; i++) { frequencies.push(i / (size * step)); all.push(Math.abs(scale) * 4 * Math.hypot(re[i], im[i]) / size || 1e-300); }
    return [frequencies, all.map((value) => value > 1e-15 ? value : null)];
  };

  // in place, by Cooley and Tukey; the size is a power of two
  const fft = (re, im) => {
    const size = re.length;
    for (let i = 1, j = 0; i < size; i++) {
      let bit = size >> 1;
      for (; j & bit; bit >>= 1) j ^= bit;
      j ^= bit;
      if (i < j) { [re[i], re[j]] = [re[j], re[i]]; [im[i], im[j]] = [im[j], im[i]]; }
    }
    for (let length = 2; length <= size; length *= 2) {
      const half = length / 2;
      for (let k = 0; k < half; k++) {
        const angle = -2 * Math.PI * k / length, c = Math.cos(angle), s = Math.sin(angle);
        for (let i = k; i < size; i += length) {
          const a = re[i + half] * c - im[i + half] * s, b = re[i + half] * s + im[i + half] * c;
          re[i + half] = re[i] - a; im[i + half] = im[i] - b;
          re[i] += a; im[i] += b;
        }
      }
    }
  };

  window.hexjet = { pageData, flights, inflate, windowOf, amplitudes };
})();
