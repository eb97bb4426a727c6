// The last minutes of the log's columns, as the frames bring them.

const ROWS = 6000; // five minutes of 20 frames a second
const ROOM = 2 * ROWS; // rows are moved to the front once in ROWS frames

export class History {
  begin(columns) {
    this.columns = columns.map(([name, unit, frame, meaning]) => ({ name, unit, frame, meaning }));
    this.index = new Map(this.columns.map(({ name }, n) => [name, n]));
    this.table = this.columns.map(() => new Float32Array(ROOM));
    this.times = new Float64Array(ROOM);
    this.clear();
  }

  clear() {
    this.first = this.count = 0; // rows from first to count are there
    this.row = [];
  }

  take(t, row) {
    if (!row.length || (this.count && t <= this.times[this.count - 1])) return;
    if (this.count === ROOM) {
      for (const list of [this.times, ...this.table]) list.copyWithin(0, ROOM - ROWS, ROOM);
      this.count = ROWS;
      this.first = 0;
    }
    this.row = row;
    this.times[this.count] = t;
    row.forEach((value, n) => { this.table[n][this.count] = value ?? NaN; });
    this.count += 1;
    this.first = Math.max(this.first, this.count - ROWS);
  }

  get end() {
    return this.count ? this.times[this.count - 1] : 0;
  }

  /** A column now; NaN for what is not known. */
  value(name) {
    return this.row[this.index.get(name)] ?? NaN;
  }

  /** Has it a number in the newest row? */
  has(name) {
    return Number.isFinite(this.value(name));
  }

  /** From a time on: the times, and of each name its values, scaled, null where there is none. */
  since(from, names, scales) {
    let low = this.first, high = this.count;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (this.times[middle] < from) low = middle + 1;
      else high = middle;
    }
    const rows = this.count - low;
    return [this.times.slice(low, this.count), ...names.map((name, n) => {
      const column = this.table[this.index.get(name)], made = new Array(rows);
      for (let i = 0; i < rows; i++) made[i] = Number.isNaN(column[low + i]) ? null : scales[n] * column[low + i];
      return made;
    })];
  }
}
