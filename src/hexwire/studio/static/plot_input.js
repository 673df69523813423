// Mouse, fingers and keys on a plot.
//
// Mouse: wheel zooms, dragging zooms into a range, dragging with Shift or the middle button moves, a click sets a cursor,
// a cursor can be dragged, a double click follows again. Fingers: one moves, two zoom, a tap sets a cursor.
// Keys are those that the plot's label names. Escape is left to the page: it stops the arm.

const NEAR = 7;       // pixels from which a cursor is taken
const CLICK = 4;      // pixels within which a press is a click

import { CURSORS } from "./plot_look.js";

/**
 * A place on a panel; what is done from where a button or finger went down.
 * @typedef {import("./plot.js").Cursor} Cursor
 * @typedef {{ panel: import("./plot.js").Panel, x: number, width: number, t: number }} Place
 * @typedef {Place & { kind: "cursor" | "pan" | "select" | "pinch", held: Cursor | null, range: number[], moved: boolean, apart: number, about: number }} Press
 */

/** @param {import("./plot.js").Plot} plot */
export function followInput(plot) {
  const { stack } = plot;
  /** @type {Map<number, Place>} */
  const fingers = new Map();
  /** @type {Press | null} */
  let press = null;

  /**
   * The panel's plotting area under the pointer, and the time there.
   * @param {MouseEvent} event
   * @returns {Place | null}
   */
  function place(event) {
    const panel = plot._panels.find((one) => one.chart.over.contains(event.target)) ?? press?.panel;
    if (!panel) return null;
    const box = panel.chart.over.getBoundingClientRect();
    const x = Math.min(Math.max(event.clientX - box.left, 0), box.width);
    return { panel, x, width: box.width, t: panel.chart.posToVal(x, "x") };
  }

  /** @param {Place} at */
  function nearCursor(at) {
    for (const name of [plot.active, ...CURSORS]) {
      const t = plot.cursors[name];
      if (t !== null && Math.abs(at.panel.chart.valToPos(t, "x") - at.x) <= NEAR) return name;
    }
    return null;
  }

  /** @param {PointerEvent} event */
  function down(event) {
    const at = place(event);
    if (!at || event.button > 1) return;
    if (event.pointerType !== "touch") event.preventDefault();
    stack.focus({ preventScroll: true });
    fingers.set(event.pointerId, at);
    if (event.target instanceof Element) event.target.setPointerCapture(event.pointerId);
    const held = nearCursor(at);
    const kind = held ? "cursor" : event.pointerType === "touch" || event.shiftKey || event.button === 1 ? "pan" : "select";
    press = { ...at, kind, held, range: [...plot.range], moved: false, apart: 0, about: 0 };
    if (fingers.size === 2) startPinch(press);
  }

  /** @param {Press} before */
  function startPinch(before) {
    const [p, q] = [...fingers.values()];
    const x = (p.x + q.x) / 2;
    press = { ...before, kind: "pinch", moved: true, apart: Math.max(Math.abs(p.x - q.x), 20), range: [...plot.range],
      about: plot.range[0] + (x / p.width) * (plot.range[1] - plot.range[0]) };
  }

  /** @param {PointerEvent} event */
  function move(event) {
    const at = place(event);
    if (!press) { if (at) stack.classList.toggle("at-cursor", nearCursor(at) !== null); return; }
    if (!at || !fingers.has(event.pointerId)) return;
    fingers.set(event.pointerId, at);
    if (Math.abs(at.x - press.x) > CLICK) press.moved = true;
    if (press.kind === "pinch" && fingers.size === 2) {
      const [p, q] = [...fingers.values()];
      const factor = press.apart / Math.max(Math.abs(p.x - q.x), 20);
      const [from, to] = press.range;
      plot.zoom(press.about + (from - press.about) * factor, press.about + (to - press.about) * factor);
    } else if (press.held && press.kind === "cursor") plot.cursor(press.held, at.t);
    else if (!press.moved) return;
    else if (press.kind === "pan") {
      const by = ((press.x - at.x) / at.width) * (press.range[1] - press.range[0]);
      plot.zoom(press.range[0] + by, press.range[1] + by);
    } else if (press.kind === "select") select(press.x, at.x);
  }

  /**
   * @param {number} from
   * @param {number} to
   */
  function select(from, to) {
    for (const { chart } of plot._panels) {
      chart.setSelect({ left: Math.min(from, to), width: Math.abs(to - from), top: 0, height: chart.over.clientHeight }, false);
    }
  }

  /** @param {PointerEvent} event */
  function up(event) {
    const at = place(event);
    fingers.delete(event.pointerId);
    if (!press) return;
    const done = press;
    if (fingers.size) return;
    press = null;
    select(0, 0);
    if (event.type === "pointercancel" || !at) return;
    if (!done.moved && done.kind !== "cursor") { if (event.button === 0) plot.place(at.t); }
    else if (done.kind === "select") plot.zoom(Math.min(done.t, at.t), Math.max(done.t, at.t));
  }

  /** @param {WheelEvent} event */
  function wheel(event) {
    const at = place(event);
    if (!at || !event.deltaY) return;
    event.preventDefault();
    const lines = event.deltaMode === 1 ? 30 : 1;
    plot.scale(Math.exp(Math.min(Math.max(event.deltaY * lines, -120), 120) * 0.002), at.t);
  }

  /** @param {KeyboardEvent} event */
  function key(event) {
    if (event.target !== stack || event.ctrlKey || event.altKey || event.metaKey) return;
    const step = event.shiftKey ? 10 : 1;
    const [from, to] = plot.range;
    const selected = plot.cursors[plot.active];
    const sideways = (/** @type {number} */ sign) => {
      if (selected !== null && selected >= from && selected <= to) {
        plot.cursor(plot.active, selected + (sign * step * (to - from)) / 400);
      } else plot.pan(sign * 0.05 * step);
    };
    /** @type {Record<string, () => void>} */
    const acts = {
      " ": () => (plot.paused ? plot.resume() : plot.pause()),
      "+": () => plot.scale(0.7), "=": () => plot.scale(0.7), "-": () => plot.scale(1 / 0.7),
      ArrowLeft: () => sideways(-1), ArrowRight: () => sideways(1),
      a: () => choose("a"), b: () => choose("b"), A: () => choose("a"), B: () => choose("b"),
      Delete: () => { plot.cursor("a", null); plot.cursor("b", null); },
      0: () => plot.showAll(),
    };
    const act = acts[event.key];
    if (!act) return;
    event.preventDefault();
    act();
  }

  /** @param {Cursor} name */
  function choose(name) {
    const [from, to] = plot.range;
    const t = plot.cursors[name];
    plot.cursor(name, t !== null && t >= from && t <= to ? t : from + (name === "a" ? 0.35 : 0.65) * (to - from));
  }

  function again() {
    plot.cursor("a", null);
    plot.cursor("b", null);
    if (plot.options.live) plot.resume();
    else plot.showAll();
  }

  const over = new AbortController(), { signal } = over;
  stack.addEventListener("pointerdown", down, { signal });
  stack.addEventListener("pointermove", move, { signal });
  stack.addEventListener("pointerup", up, { signal });
  stack.addEventListener("pointercancel", up, { signal });
  stack.addEventListener("keydown", key, { signal });
  stack.addEventListener("dblclick", again, { signal });
  stack.addEventListener("wheel", wheel, { signal, passive: false });
  return () => over.abort();
}
