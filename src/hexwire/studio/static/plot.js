// A plot of values over time, as every page of the studio shows it.
//
//   const plot = new Plot(element, { title: "Positions", series: [{ name: "J1", unit: "°", colour: 0 }] });
//   plot.append(t, [12.5]);          // a live row: seconds, and a value for each series (NaN or null: unknown)
//   plot.set([times, values, ...]);  // all rows at once
//
// Series of the same unit share a panel; the panels have a common time axis below each other. Owns the view: which times
// are shown, which series, where the cursors are. plot_data.js keeps the samples, plot_input.js reads mouse, fingers
// and keys, plot_legend.js writes the table below, plot_export.js makes the picture. Must not know the server.

import { Columns } from "./plot_data.js";
import { CURSORS, uPlot, FONT, themeOf, colourOf, onTheme, rangeOf, timeText, digitsOf } from "./plot_look.js";
import { followInput } from "./plot_input.js";
import { Legend } from "./plot_legend.js";
import { makeToolbar } from "./plot_toolbar.js";
import { picture } from "./plot_export.js";

const GUTTER = 62;      // width of the value axes, so that panels are aligned
const BOTTOM = 40;      // height of the time axis with its label
const STEPS = [1e-3, 2e-3, 5e-3, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 1200, 3600]; // s
const SHARE = 0.35;     // most of a core that drawing may take

/**
 * @typedef {"a" | "b"} Cursor
 *
 * `colour`: number of a joint, "--variable" or CSS.
 * @typedef {{ name: string, unit?: string, colour?: number | string, quantity?: string, shown?: boolean, dash?: number[], digits?: number, panel?: string }} SeriesOptions
 * @typedef {SeriesOptions & Required<Pick<SeriesOptions, "unit" | "colour" | "quantity" | "shown">>} Series
 *
 * `window`: seconds that are followed (30); `keep`: seconds that are kept (600); `capacity`: rows that are kept; `height`: CSS
 * pixels of all panels (320); `origin`: seconds that are called 0; `live`: false where nothing is appended; `toolbar`,
 * `legend`: false to leave out; `fileName`: of pictures, without ending; `onTime(t)`: the time under the pointer, else that of
 * the active cursor, else null.
 * @typedef {{
 *   title?: string, series?: SeriesOptions[], window?: number, keep?: number, capacity?: number, height?: number, origin?: number,
 *   live?: boolean, toolbar?: boolean, legend?: boolean, fileName?: string, onPause?: (paused: boolean) => void,
 *   onTime?: (t: number | null) => void
 * }} PlotOptions
 *
 * Series of one unit, by their numbers.
 * @typedef {{ shown: number[], unit: string, colours: string[], y: number[], last: boolean, chart: Untyped }} Panel
 */

export class Plot {
  /** @type {Record<Cursor, number | null>} */
  cursors = { a: null, b: null };
  /** @type {Cursor} */
  active = "a";
  /** @type {number | null} */
  hover = null;
  /** @type {{ t: number, text: string }[]} */
  marks = [];
  /** @type {Series[]} */
  series = [];
  columns = new Columns(0);
  stack = document.createElement("div");
  status = document.createElement("div");
  /** @type {Panel[]} */
  _panels = [];
  /** @type {string | null} */
  _key = null;
  _drawn = -Infinity;
  _cost = 0;
  _interval = 0;
  _frame = 0;
  _timer = 0;
  _saying = 0;
  /** @type {ReturnType<typeof themeOf> | null} */
  _theme = null;

  /**
   * @param {HTMLElement} element is filled; its width is followed
   * @param {PlotOptions} options
   */
  constructor(element, options = {}) {
    this.element = element;
    this.options = { title: "", window: 30, keep: 600, origin: 0, toolbar: true, legend: true, live: true, ...options };
    this.following = this.options.live !== false;
    this.window = this.options.window;
    this.range = [0, this.window];
    this.toolbar = this.options.toolbar ? makeToolbar(this) : null;
    this.legend = this.options.legend ? new Legend(this) : null;
    this._build();
    this._stopInput = followInput(this);
    this.setSeries(this.options.series ?? []);
    this._stopTheme = onTheme(() => this.refresh());
    this._resized = new ResizeObserver(() => this._layout());
    this._resized.observe(this.stack);
  }

  // -- data ----------------------------------------------------------------------------------------

  /**
   * Replace the series; all samples are dropped.
   * @param {SeriesOptions[]} series
   */
  setSeries(series) {
    this.series = series.map((one) => ({ quantity: "", unit: "", colour: 0, shown: true, ...one }));
    this.columns = new Columns(this.series.length, this.options.capacity ?? 65536);
    this._interval = 0;
    this.legend?.build();
    this._makePanels();
  }

  /**
   * Add a row: seconds, and a value for each series.
   * @param {number} t
   * @param {(number | null)[]} values
   */
  append(t, values) {
    const dt = t - this.columns.last;
    // Nothing is known between two samples that are far apart, so no line joins them.
    if (dt > Math.max(1, 8 * this._interval) && this._interval) {
      this.columns.append(t - 1e-6, this.series.map(() => NaN));
    } else if (dt > 0) this._interval = this._interval ? 0.9 * this._interval + 0.1 * dt : dt;
    if (!this.columns.append(t, values)) return;
    this.columns.trim(t - 1.2 * this.options.keep);
    if (this.following) this._dirty();
    else this.legend?.later();
  }

  /**
   * Replace all rows: [times, values of the first series, ...]; typed arrays are fastest.
   * @param {import("./plot_data.js").Column[]} columns
   */
  set(columns) {
    this.columns.set(columns);
    this._interval = this.columns.length > 1 ? (this.columns.last - this.columns.first) / (this.columns.length - 1) : 0;
    if (!this.following) this.showAll();
    this._dirty();
  }

  clear() {
    this.columns.clear();
    this._dirty();
  }

  /**
   * Vertical marks with a word.
   * @param {{ t: number, text: string }[]} marks
   */
  setMarks(marks) { this.marks = marks; this._dirty(); }

  // -- view ----------------------------------------------------------------------------------------

  get paused() { return !this.following; }

  pause() { this._follow(false); }
  resume() { this._follow(true); }

  /** @param {boolean} on */
  _follow(on) {
    if (this.following === on || (on && this.options.live === false)) return;
    this.following = on;
    this.toolbar?.update();
    this.options.onPause?.(!on);
    this._dirty();
  }

  /**
   * Follow the newest samples over so many seconds.
   * @param {number} seconds
   */
  setWindow(seconds) {
    this.window = Math.min(Math.max(seconds, 0.05), Math.max(this.options.keep, 0.05));
    this._follow(true);
    this._dirty();
  }

  /**
   * Show a range of times; the plot is paused.
   * @param {number} from
   * @param {number} to
   */
  zoom(from, to) {
    if (!(to > from)) return;
    const middle = (from + to) / 2, half = Math.max((to - from) / 2, 0.002);
    this.range = [middle - half, middle + half];
    this._follow(false);
    this._dirty();
  }

  /**
   * Zoom by a factor about a time; while the plot follows, its window changes instead.
   * @param {number} factor
   */
  scale(factor, about = (this.range[0] + this.range[1]) / 2) {
    if (this.following) {
      this.setWindow(this.window * factor);
      this.toolbar?.update();
      return;
    }
    const [from, to] = this.range;
    const most = Math.max(1.5 * (this.columns.last - this.columns.first || 1), 1);
    const bounded = Math.min(factor, most / (to - from));
    this.zoom(about + (from - about) * bounded, about + (to - about) * bounded);
  }

  /**
   * Move the view by a part of its width.
   * @param {number} part
   */
  pan(part) {
    const [from, to] = this.range, by = part * (to - from);
    this.zoom(from + by, to + by);
  }

  /** Show all samples. */
  showAll() {
    const { first, last } = this.columns;
    if (Number.isFinite(first) && last > first) this.zoom(first, last);
  }

  /**
   * Put a cursor at a time, or remove it with null.
   * @param {Cursor} name
   * @param {number | null} t
   */
  cursor(name, t) {
    this.cursors[name] = t;
    if (t !== null) this.active = name;
    else if (this.cursors[name === "a" ? "b" : "a"] !== null) this.active = name === "a" ? "b" : "a";
    this.toolbar?.update();
    this.options.onTime?.(this.hover ?? this.cursors[this.active]);
    this._redrawCursors();
  }

  /**
   * Put the next cursor at a time: the first, then the second, then whichever is nearer moves.
   * @param {number} t
   */
  place(t) {
    const { a, b } = this.cursors;
    if (a === null) this.cursor("a", t);
    else if (b === null) this.cursor("b", t);
    else this.cursor(Math.abs(t - a) <= Math.abs(t - b) ? "a" : "b", t);
  }

  /**
   * @param {number} index
   * @param {boolean} shown
   */
  show(index, shown) {
    this.series[index].shown = shown;
    this._makePanels();
  }

  /** Follow a changed theme. */
  refresh() {
    this._theme = themeOf(this.element);
    this.legend?.colours();
    for (const panel of this._panels) panel.colours = panel.shown.map((s) => this.colour(s));
    this._dirty();
  }

  /** @param {number} index */
  colour(index) { return colourOf(this.element, this.series[index].colour); }
  get theme() { return (this._theme ??= themeOf(this.element)); }

  /** A picture with title, units and legend. @returns {Promise<Blob>} */
  async png() {
    this._draw();
    await new Promise((done) => requestAnimationFrame(done));
    return picture(this);
  }

  destroy() {
    this._stopTheme();
    this._resized.disconnect();
    this._stopInput();
    for (const panel of this._panels) panel.chart.destroy();
    this._panels = [];
    cancelAnimationFrame(this._frame);
    clearTimeout(this._timer);
    this.legend?.destroy();
    this.element.replaceChildren();
  }

  // -- building ------------------------------------------------------------------------------------

  _build() {
    this.element.classList.add("hx-plot");
    this.stack.className = "hx-plot-stack";
    this.stack.tabIndex = 0;
    this.stack.setAttribute("role", "group");
    this.stack.setAttribute("aria-label", `${this.options.title || "Plot"}. Keys: plus and minus zoom, arrows move, `
      + "space pauses, A and B set the cursors, Delete removes them, 0 shows everything.");
    this.status.className = "hx-plot-status";
    this.status.setAttribute("role", "status");
    this.element.replaceChildren(...[this.toolbar?.element, this.stack, this.legend?.element, this.status].flatMap((part) => part ?? []));
  }

  _makePanels() {
    for (const panel of this._panels) panel.chart.destroy();
    this.stack.replaceChildren();
    /** @type {Map<string, number[]>} */
    const units = new Map();
    this.series.forEach((one, i) => {
      const key = one.panel ?? one.unit;
      if (one.shown) units.set(key, [...(units.get(key) ?? []), i]);
    });
    const groups = units.size ? [...units.values()] : [[]];
    this._panels = groups.map((shown, i) => ({
      shown, unit: shown.length ? this.series[shown[0]].unit : "", colours: shown.map((s) => this.colour(s)), y: [0, 1],
      last: i === groups.length - 1, chart: null,
    }));
    this._panels.forEach((panel) => {
      panel.chart = new uPlot(this._chartOptions(panel), [[], ...panel.shown.map(() => [])], this.stack);
    });
    this._layout();
  }

  /** @param {Panel} panel */
  _chartOptions(panel) {
    const theme = (/** @type {keyof ReturnType<typeof themeOf>} */ name) => () => this.theme[name];
    const axis = { stroke: theme("muted"), font: FONT, labelFont: FONT, grid: { stroke: theme("grid"), width: 1 },
      ticks: { stroke: theme("line"), width: 1, size: 4 }, gap: 4 };
    return {
      width: 300, height: 150, pxAlign: 0,
      padding: [8, 12, panel.last ? 0 : 4, 0],
      legend: { show: false },
      cursor: { y: false, points: { show: false }, drag: { x: false, y: false, setScale: false },
        bind: { mousedown: () => null, mouseup: () => null, dblclick: () => null },
        sync: { key: this._key ??= `hx-plot-${Plot.count++}`, setSeries: false } },
      scales: { x: { time: false, range: () => this.range }, y: { range: () => panel.y } },
      axes: [
        { ...axis, size: panel.last ? BOTTOM - 18 : 0, labelSize: 18, label: panel.last ? "time, s" : undefined,
          space: 70, incrs: STEPS, splits: (/** @type {Untyped} */ u, /** @type {number} */ i, /** @type {number} */ from, /** @type {number} */ to, /** @type {number} */ step) => this._splits(from, to, step),
          values: (/** @type {Untyped} */ u, /** @type {number[]} */ splits) => (panel.last ? this._times(u, splits) : splits.map(() => "")) },
        { ...axis, size: GUTTER - 18, labelSize: 18, label: " ", space: (/** @type {Untyped} */ u) => (u.height < 200 ? 22 : 40),
          values: (/** @type {Untyped} */ u, /** @type {number[]} */ splits) => splits.map((v) => String(Number(v.toPrecision(12))).replace("-", "−")) },
      ],
      series: [{}, ...panel.shown.map((s, i) => ({
        scale: "y", stroke: () => panel.colours[i], width: panel.shown.length > 3 ? 1 : 1.5, dash: this.series[s].dash,
        points: { show: false }, spanGaps: false,
      }))],
      hooks: { draw: [(/** @type {Untyped} */ u) => this._drawMarks(u, panel)], setCursor: [(/** @type {Untyped} */ u) => this._hovered(u)] },
    };
  }

  /**
   * What a panel shows, with its unit, as long as there is room for it.
   * @param {Panel} panel
   * @param {number} height
   */
  _panelLabel(panel, height) {
    const names = [...new Set(panel.shown.map((s) => this.series[s].quantity).filter(Boolean))];
    const words = [names.join(" and "), names.length > 1 ? "" : names[0], ""].map((one) => [one, panel.unit].filter(Boolean).join(", "));
    return words.find((one) => one.length * 6.4 < height) || " ";
  }

  /**
   * Round times as they are written, counted from the origin.
   * @param {number} from
   * @param {number} to
   * @param {number} step
   */
  _splits(from, to, step) {
    const { origin } = this.options;
    const found = [];
    for (let k = Math.ceil((from - origin) / step - 1e-9); k * step + origin <= to; k++) found.push(k * step + origin);
    return found;
  }

  /**
   * @param {Untyped} u
   * @param {number[]} splits
   */
  _times(u, splits) {
    const step = splits.length > 1 ? splits[1] - splits[0] : 1;
    const shown = splits.map((t) => t - this.options.origin);
    const long = Math.max(...shown.map(Math.abs)) >= 100 && step >= 0.1;
    u.axes[0].label = long ? "time, min:s" : "time, s";
    return shown.map((t) => timeText(t, step, long));
  }

  _layout() {
    const width = Math.floor(this.stack.clientWidth);
    if (width < 40) return;
    const fixed = this.options.height ?? 320;
    const least = 112 * this._panels.length + BOTTOM;
    const total = Math.max(fixed, least);
    const each = Math.floor((total - BOTTOM) / this._panels.length);
    for (const panel of this._panels) {
      panel.chart.axes[1].label = this._panelLabel(panel, each - 12);
      panel.chart.setSize({ width, height: each + (panel.last ? BOTTOM : 0) });
    }
    this._dirty();
  }

  // -- drawing -------------------------------------------------------------------------------------

  _dirty() {
    if (this._frame || this._timer) return;
    // A slow machine draws less often, and keeps time for everything else.
    const wait = this._drawn + Math.max(30, this._cost / SHARE) - performance.now();
    const soon = () => { this._timer = 0; this._frame = requestAnimationFrame(() => { this._frame = 0; this._draw(); }); };
    if (wait > 4) this._timer = setTimeout(soon, wait);
    else soon();
  }

  _draw() {
    const began = performance.now();
    const { columns } = this;
    if (this.following) {
      // At first the plot fills from the left.
      const end = Math.max(columns.length ? columns.last : -Infinity,
        (columns.length ? columns.first : this.options.origin) + this.window);
      this.range = [end - this.window, end];
    }
    for (const panel of this._panels) {
      // A group gives two points, its least and its greatest value.
      const groups = Math.max(50, (panel.chart.width - GUTTER) / 2);
      const { data, low, high } = columns.view(this.range[0], this.range[1], groups, panel.shown);
      panel.y = rangeOf(low, high, panel.unit);
      panel.chart.setData(data, true);
    }
    this.legend?.later();
    this._drawn = performance.now();
    // uPlot draws after this call, and the browser paints even later.
    requestAnimationFrame(() => requestAnimationFrame(() => {
      this._cost = 0.6 * this._cost + 0.4 * Math.max(0, performance.now() - began - 32);
    }));
  }

  _redrawCursors() {
    for (const panel of this._panels) panel.chart.redraw(false, false);
    this.legend?.later();
    this._say();
  }

  /**
   * @param {Untyped} u
   * @param {Panel} panel
   */
  _drawMarks(u, panel) {
    const { bbox } = u;
    /** @type {CanvasRenderingContext2D} */
    const ctx = u.ctx;
    const ratio = uPlot.pxRatio;
    const first = panel === this._panels[0];
    ctx.save();
    ctx.font = FONT.replace("12px", `${12 * ratio}px`);
    ctx.textBaseline = "top";
    ctx.textAlign = "left";
    /** @type {(t: number, text: string, colour: string, dash: number[], width: number) => void} */
    const line = (t, text, colour, dash, width) => {
      const x = u.valToPos(t, "x", true);
      if (!(x >= bbox.left - 1 && x <= bbox.left + bbox.width + 1)) return;
      ctx.strokeStyle = ctx.fillStyle = colour;
      ctx.lineWidth = width * ratio;
      ctx.setLineDash(dash.map((d) => d * ratio));
      ctx.beginPath();
      ctx.moveTo(x, bbox.top);
      ctx.lineTo(x, bbox.top + bbox.height);
      ctx.stroke();
      if (!first || !text) return;
      const wide = ctx.measureText(text).width + 6 * ratio;
      const left = x + wide > bbox.left + bbox.width ? x - wide : x;
      ctx.fillRect(left, bbox.top, wide, 15 * ratio);
      ctx.fillStyle = this.theme.background;
      ctx.fillText(text, left + 3 * ratio, bbox.top + 1.5 * ratio);
    };
    for (const mark of this.marks) line(mark.t, mark.text, this.theme.muted, [2, 3], 1);
    for (const name of CURSORS) {
      const t = this.cursors[name];
      if (t !== null) line(t, name.toUpperCase(), this.theme.text, [], 1.25);
    }
    ctx.restore();
  }

  /** @param {Untyped} u */
  _hovered(u) {
    const left = u.cursor.left;
    const now = left >= 0 ? u.posToVal(left, "x") : null;
    if (now === this.hover) return;
    this.hover = now;
    this.options.onTime?.(now ?? this.cursors[this.active]);
    this.legend?.later();
  }

  _say() {
    const said = CURSORS.flatMap((name) => {
      const t = this.cursors[name];
      return t === null ? [] : [`cursor ${name.toUpperCase()} at ${timeText(t - this.options.origin)} s`];
    });
    clearTimeout(this._saying);
    // Only where a cursor comes to rest.
    this._saying = setTimeout(() => { this.status.textContent = said.join(", "); }, 600);
  }

  /**
   * Values of a series; NaN where unknown.
   * @param {number} index
   */
  values(index) {
    const { columns } = this;
    const at = (/** @type {number | null} */ t) => {
      const row = t === null ? -1 : columns.nearest(t);
      // Beside the data nothing is known.
      return t === null || row < 0 || Math.abs(columns.time(row) - t) > Math.max(0.2, 5 * this._interval) ? NaN : columns.value(index, row);
    };
    return { now: this.hover === null ? columns.newest(index) : at(this.hover), a: at(this.cursors.a), b: at(this.cursors.b) };
  }

  /** @param {number} index */
  digits(index) { return digitsOf(this.series[index]); }
}

Plot.count = 0;
