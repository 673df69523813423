// A picture of a plot with what a reader needs who has only the picture: title, names, units, cursors.

import { FONT, timeText, uPlot, valueText } from "./plot_look.js";

/** @typedef {import("./plot.js").Plot} Plot */

/**
 * @param {Plot} plot
 * @returns {Promise<Blob>} PNG in the colours of the page
 */
export function picture(plot) {
  const ratio = uPlot.pxRatio;
  const charts = plot._panels.map((panel) => panel.chart.ctx.canvas);
  const width = Math.max(...charts.map((one) => one.width));
  const shown = plot.series.map((_, i) => i).filter((i) => plot.series[i].shown);
  const font = (/** @type {number} */ size, weight = "") => `${weight} ${FONT.replace("12px", `${size * ratio}px`)}`.trim();
  const canvas = document.createElement("canvas");
  const ctx = canvas.getContext("2d");
  if (!ctx) throw new Error("no picture");
  const pad = 12 * ratio, line = 18 * ratio;

  ctx.font = font(12);
  const entries = shown.map((i) => ({ i, text: legendText(plot, i) }));
  const cell = Math.max(80 * ratio, ...entries.map((one) => ctx.measureText(one.text).width)) + 40 * ratio;
  const columns = Math.max(1, Math.floor((width - 2 * pad) / cell));
  const rows = Math.ceil(entries.length / columns);
  // Where the page has the title, the picture has none: the name of its file tells what it shows.
  const title = plot.options.title || plot.options.fileName || "";
  const top = title ? 30 * ratio : pad;
  const cursors = cursorText(plot);
  const tall = charts.reduce((sum, one) => sum + one.height, 0);
  canvas.width = width;
  canvas.height = top + tall + (rows + (cursors ? 1 : 0)) * line + pad;

  ctx.fillStyle = plot.theme.background;
  ctx.fillRect(0, 0, canvas.width, canvas.height);
  ctx.fillStyle = plot.theme.text;
  ctx.textBaseline = "middle";
  ctx.font = font(15, "600");
  ctx.fillText(title, pad, top / 2, width - 2 * pad);
  let y = top;
  for (const one of charts) { ctx.drawImage(one, 0, y); y += one.height; }
  ctx.font = font(12);
  entries.forEach(({ i, text }, n) => {
    const x = pad + (n % columns) * cell, at = y + (Math.floor(n / columns) + 0.5) * line;
    ctx.strokeStyle = plot.colour(i);
    ctx.lineWidth = 2 * ratio;
    ctx.setLineDash((plot.series[i].dash ?? []).map((d) => d * ratio));
    ctx.beginPath();
    ctx.moveTo(x, at);
    ctx.lineTo(x + 22 * ratio, at);
    ctx.stroke();
    ctx.fillText(text, x + 28 * ratio, at);
  });
  if (cursors) ctx.fillText(cursors, pad, y + (rows + 0.5) * line);
  return new Promise((done, failed) => canvas.toBlob((blob) => (blob ? done(blob) : failed(new Error("no picture"))), "image/png"));
}

/**
 * @param {Plot} plot
 * @param {number} i
 */
function legendText(plot, i) {
  const one = plot.series[i], v = plot.values(i), digits = plot.digits(i);
  const found = [];
  if (plot.cursors.a !== null) found.push(`A ${valueText(v.a, digits)}`);
  if (plot.cursors.b !== null) found.push(`B ${valueText(v.b, digits)}`);
  if (found.length === 2) found.push(`B−A ${valueText(v.b - v.a, digits)}`);
  return `${one.name}${one.unit ? `, ${one.unit}` : ""}${found.length ? `: ${found.join("  ")}` : ""}`;
}

/** @param {Plot} plot */
function cursorText(plot) {
  const { a, b } = plot.cursors, origin = plot.options.origin;
  const said = [];
  if (a !== null) said.push(`A at ${timeText(a - origin)} s`);
  if (b !== null) said.push(`B at ${timeText(b - origin)} s`);
  if (a !== null && b !== null) said.push(`B − A: ${timeText(b - a)} s`);
  return said.join("    ");
}
