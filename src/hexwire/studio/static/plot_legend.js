// The table below a plot: every series with a switch, its value now (or under the pointer), at both cursors, and the difference.
//
// Owns the table; written at most ten times a second.

import { timeText, valueText } from "./plot_look.js";
import { node, put } from "./widgets.js";

const PERIOD = 100; // ms

export class Legend {
  _timer = 0;
  /** @type {HTMLElement[]} */
  _heads = [];
  /** @type {{ line: HTMLElement, box: HTMLInputElement, cells: HTMLElement[], row: HTMLElement }[]} */
  _rows = [];
  _table = node("table");

  /** @param {import("./plot.js").Plot} plot */
  constructor(plot) {
    this.plot = plot;
    this.element = node("div", { class: "hx-plot-legend" });
  }

  build() {
    const { plot } = this;
    this._heads = ["signal", "unit", "now", "A", "B", "B − A"].map((text) => node("th", { scope: "col" }, text));
    this._rows = plot.series.map((one, i) => {
      const box = node("input", { type: "checkbox", checked: one.shown });
      box.addEventListener("change", () => plot.show(i, box.checked));
      const line = node("span", { class: `hx-plot-line${one.dash ? " dashed" : ""}` });
      const name = node("th", { scope: "row" }, node("label", {}, box, line, ` ${one.name}`));
      const cells = ["now", "a", "b", "d"].map(() => node("td"));
      // A page greys it where nobody knows how it is now.
      if (plot.options.live) cells[0].className = "hw-live";
      return { line, box, cells, row: node("tr", {}, name, node("td", { class: "unit" }, one.unit), ...cells) };
    });
    this._table = node("table", {}, node("thead", {}, node("tr", {}, ...this._heads)), node("tbody", {}, ...this._rows.map(({ row }) => row)));
    this.element.replaceChildren(this._table);
    this.colours();
    this._write();
  }

  colours() {
    this._rows.forEach((row, i) => { row.line.style.borderColor = this.plot.colour(i); });
  }

  later() {
    if (this._timer) return;
    this._timer = setTimeout(() => { this._timer = 0; this._write(); }, PERIOD);
  }

  destroy() { clearTimeout(this._timer); }

  _write() {
    const { plot } = this;
    const { a, b } = plot.cursors;
    const origin = plot.options.origin;
    const at = (/** @type {number | null} */ t) => (t === null ? "" : ` ${timeText(t - origin)} s`);
    put(this._heads[2], plot.hover === null ? (plot.options.live ? "now" : "end") : `at${at(plot.hover)}`);
    put(this._heads[3], `A${at(a)}`);
    put(this._heads[4], `B${at(b)}`);
    put(this._heads[5], a !== null && b !== null ? `B − A ${timeText(b - a)} s` : "B − A");
    for (const [name, shown] of Object.entries({ 4: a !== null, 5: b !== null, 6: a !== null && b !== null })) {
      this._table.classList.toggle(`without-${name}`, !shown);
    }
    this._rows.forEach((row, i) => {
      const digits = plot.digits(i);
      const v = plot.values(i);
      const texts = [v.now, v.a, v.b, v.b - v.a].map((value) => valueText(value, digits));
      row.cells.forEach((cell, k) => put(cell, texts[k]));
    });
  }
}
