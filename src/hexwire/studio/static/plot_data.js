// Columns of samples for plots: appended at the end, dropped at the start, and reduced to what a screen can show.
//
// Owns memory and reduction. Must not know the page. Times rise. An unknown value is NaN.
//
// Beside the rows, minima and maxima of 8, 64 and 512 rows are kept, so that a view of ten minutes costs as much as
// one of ten seconds. Groups begin at multiples of their size counted from the first row ever, so that a curve that
// moves along does not shimmer.

const LEVELS = [8, 64, 512];
const STEP = LEVELS[LEVELS.length - 1];

/** @typedef {Float64Array | Float32Array | (number | null)[]} Column */

export class Columns {
  length = 0;
  _room = 0;
  _time = new Float64Array(0);
  /** @type {Float32Array[]} */
  _rows = [];
  /** @type {Float32Array[][]} */
  _low = [];
  /** @type {Float32Array[][]} */
  _high = [];

  /**
   * @param {number} width number of columns beside the time
   * @param {number} capacity most rows that are kept; the oldest eighth is dropped when they are full
   */
  constructor(width, capacity = 65536) {
    this.width = width;
    this.capacity = Math.max(2 * STEP, Math.ceil(capacity / STEP) * STEP);
    this.clear();
  }

  clear() {
    this.length = 0;
    this._room = 0;
    this._time = new Float64Array(0);
    this._rows = Array.from({ length: this.width }, () => new Float32Array(0));
    this._low = LEVELS.map(() => this._rows.map(() => new Float32Array(0)));
    this._high = LEVELS.map(() => this._rows.map(() => new Float32Array(0)));
  }

  get first() { return this.length ? this._time[0] : NaN; }
  get last() { return this.length ? this._time[this.length - 1] : NaN; }

  /** Bytes of memory that the columns take. */
  get bytes() {
    const share = LEVELS.reduce((sum, size) => sum + 2 / size, 1);
    return this._room * (8 + 4 * this.width * share);
  }

  /**
   * Add a row; one that is not later than the last is left out. Returns whether it was added.
   * @param {number} t
   * @param {ArrayLike<number | null | undefined>} values
   */
  append(t, values) {
    if (!Number.isFinite(t) || t <= this.last) return false;
    this._reserve(this.length + 1);
    const at = this.length;
    this._time[at] = t;
    for (let s = 0; s < this.width; s++) {
      const v = values[s];
      this._rows[s][at] = v === null || v === undefined ? NaN : v;
    }
    this.length = at + 1;
    this._fold(at);
    return true;
  }

  /**
   * Replace all rows: columns[0] are the times, rising; the others follow. Only the newest are kept if they are too many.
   * @param {Column[]} columns
   */
  set(columns) {
    this.clear();
    const [times, ...rest] = columns;
    const from = Math.max(0, times.length - this.capacity);
    const count = times.length - from;
    this._reserve(count);
    this._time.set(newest(times, from));
    for (let s = 0; s < this.width; s++) {
      const row = rest[s];
      if (row) this._rows[s].set(newest(row, from));
      else this._rows[s].fill(NaN, 0, count);
    }
    this.length = count;
    this._fold(0);
  }

  /**
   * Drop rows before a time, in whole groups.
   * @param {number} before
   */
  trim(before) {
    const rows = Math.floor(this.index(before) / STEP) * STEP;
    // Moving rows costs time, so it is done seldom.
    if (rows >= Math.max(STEP, this.capacity / 8)) this._drop(rows);
  }

  /**
   * Index of the first row at or after a time.
   * @param {number} t
   */
  index(t) {
    let low = 0, high = this.length;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (this._time[middle] < t) low = middle + 1;
      else high = middle;
    }
    return low;
  }

  /**
   * Index of the row nearest to a time; -1 if there is no row.
   * @param {number} t
   */
  nearest(t) {
    const at = this.index(t);
    if (at >= this.length) return this.length - 1;
    return at > 0 && t - this._time[at - 1] < this._time[at] - t ? at - 1 : at;
  }

  /** @param {number} row */
  time(row) { return this._time[row]; }
  /**
   * @param {number} series
   * @param {number} row
   */
  value(series, row) { return row < 0 || row >= this.length ? NaN : this._rows[series][row]; }

  /**
   * Newest known value of a series within the last second: an older one is no value of now.
   * @param {number} series
   */
  newest(series) {
    const since = this._time[this.length - 1] - 1;
    for (let row = this.length - 1; row >= 0 && this._time[row] > since; row--) {
      if (!Number.isNaN(this._rows[series][row])) return this._rows[series][row];
    }
    return NaN;
  }

  /**
   * What a screen shows between two times: at most `most` groups of rows, of each the least and the greatest value.
   * @param {number} from
   * @param {number} to
   * @param {number} most
   * @param {number[]} series
   * @returns {{ data: (number | null)[][], low: number, high: number }} uPlot's columns, and the least and greatest value of them
   */
  view(from, to, most, series) {
    const start = Math.max(0, this.index(from) - 1);
    const end = Math.min(this.length, this.index(to) + 1);
    let stride = 1;
    while ((end - start) / stride > most) stride *= 2;
    return stride === 1 ? this._raw(start, end, series) : this._grouped(start, end, stride, series);
  }

  /**
   * @param {number} start
   * @param {number} end
   * @param {number[]} series
   */
  _raw(start, end, series) {
    /** @type {(number | null)[][]} */
    const data = [Array.from(this._time.subarray(start, end))];
    let low = Infinity, high = -Infinity;
    for (const s of series) {
      const row = this._rows[s];
      const out = new Array(end - start);
      for (let i = start; i < end; i++) {
        const v = row[i];
        if (v !== v) out[i - start] = null;
        else {
          out[i - start] = v;
          if (v < low) low = v;
          if (v > high) high = v;
        }
      }
      data.push(out);
    }
    return { data, low, high };
  }

  /**
   * @param {number} start
   * @param {number} end
   * @param {number} stride
   * @param {number[]} series
   */
  _grouped(start, end, stride, series) {
    const level = stride >= 512 ? 2 : stride >= 64 ? 1 : stride >= 8 ? 0 : -1;
    const size = level < 0 ? 1 : LEVELS[level];
    const inner = stride / size;
    // Rows are dropped in groups of 512 only; a greater stride may shift then, at most once in minutes.
    const begin = Math.floor(start / stride) * stride;
    const groups = Math.ceil((end - begin) / stride);
    const x = new Array(2 * groups);
    for (let g = 0; g < groups; g++) {
      const row = begin + g * stride;
      x[2 * g] = this._time[row];
      x[2 * g + 1] = this._time[Math.min(row + stride / 2, end - 1)];
      if (x[2 * g + 1] <= x[2 * g]) x[2 * g + 1] = x[2 * g] + 1e-9;
    }
    /** @type {(number | null)[][]} */
    const data = [x];
    const entries = Math.ceil(end / size);
    let low = Infinity, high = -Infinity;
    for (const s of series) {
      const lows = level < 0 ? this._rows[s] : this._low[level][s];
      const highs = level < 0 ? this._rows[s] : this._high[level][s];
      const out = new Array(2 * groups);
      for (let g = 0; g < groups; g++) {
        const a = (begin + g * stride) / size;
        const b = Math.min(a + inner, entries);
        let least = Infinity, most = -Infinity;
        for (let i = a; i < b; i++) {
          if (lows[i] < least) least = lows[i];
          if (highs[i] > most) most = highs[i];
        }
        const known = least <= most;
        out[2 * g] = known ? least : null;
        out[2 * g + 1] = known ? most : null;
        if (known && least < low) low = least;
        if (known && most > high) high = most;
      }
      data.push(out);
    }
    return { data, low, high };
  }

  /**
   * Bring the minima and maxima up to date from a row on.
   * @param {number} from
   */
  _fold(from) {
    for (let s = 0; s < this.width; s++) {
      const row = this._rows[s];
      for (let k = 0; k < LEVELS.length; k++) {
        const size = LEVELS[k], low = this._low[k][s], high = this._high[k][s];
        for (let i = from; i < this.length; i++) {
          const g = Math.floor(i / size), v = row[i];
          if (i % size === 0) { low[g] = v; high[g] = v; continue; }
          // A comparison with NaN is false: the first known value replaces it.
          if (!(low[g] <= v) && v === v) low[g] = v;
          if (!(high[g] >= v) && v === v) high[g] = v;
        }
      }
    }
  }

  /** @param {number} rows */
  _reserve(rows) {
    if (rows <= this._room) return;
    if (this._room >= this.capacity) {
      this._drop(Math.max(STEP, Math.floor(this.capacity / 8 / STEP) * STEP));
      return;
    }
    this._room = Math.min(this.capacity, Math.max(STEP, 2 * this._room, Math.ceil(rows / STEP) * STEP));
    this._time = filled(new Float64Array(this._room), this._time);
    this._rows = this._rows.map((row) => filled(new Float32Array(this._room), row));
    for (const part of [this._low, this._high]) {
      LEVELS.forEach((size, k) => { part[k] = part[k].map((row) => filled(new Float32Array(this._room / size), row)); });
    }
  }

  /** @param {number} rows */
  _drop(rows) {
    this._time.copyWithin(0, rows, this.length);
    for (const row of this._rows) row.copyWithin(0, rows, this.length);
    LEVELS.forEach((size, k) => {
      for (const part of [this._low[k], this._high[k]]) for (const row of part) row.copyWithin(0, rows / size);
    });
    this.length -= rows;
  }
}

/**
 * @template {Float32Array | Float64Array} T
 * @param {T} made
 * @param {T} old
 */
function filled(made, old) {
  made.set(old);
  return made;
}

/**
 * The rows of a column from one on; what is unknown is NaN.
 * @param {Column} column
 * @param {number} from
 */
function newest(column, from) {
  return Array.isArray(column) ? column.slice(from).map((value) => value ?? NaN) : column.subarray(from);
}
