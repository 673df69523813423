// Mouse, fingers and keys on a plot.
//
// Mouse: wheel zooms, dragging zooms into a range, dragging with Shift or the middle button moves, a click sets a cursor,
// a cursor can be dragged, a double click follows again. Fingers: one moves, two zoom, a tap sets a cursor.
// Keys are those that the plot's label names. Escape is left to the page: it stops the arm.

const NEAR = 7;       // pixels from which a cursor is taken
const CLICK = 4;      // pixels within which a press is a click

export function followInput(plot) {
  const { stack } = plot;
  const fingers = new Map();
  let press = null;

  /** The panel's plotting area under the pointer, and the time there. */
  function place(event) {
    const panel = plot._panels.find((one) => one.chart.over.contains(event.target)) ?? press?.panel;
    if (!panel) return null;
    const box = panel.chart.over.getBoundingClientRect();
    const x = Math.min(Math.max(event.clientX - box.left, 0), box.width);
    return { panel, x, width: box.width, t: panel.chart.posToVal(x, "x") };
  }

  function nearCursor(at) {
    for (const name of [plot.active, "a", "b"]) {
      const t = plot.cursors[name];
      if (t !== null && Math.abs(at.panel.chart.valToPos(t, "x") - at.x) <= NEAR) return name;
    }
    return null;
  }

  function down(event) {
    const at = place(event);
    if (!at || event.button > 1) return;
    if (event.pointerType !== "touch") event.preventDefault();
    stack.focus({ preventScroll: true });
    fingers.set(event.pointerId, at);
    event.target.setPointerCapture?.(event.pointerId);
    const held = nearCursor(at);
    const kind = held ? "cursor" : event.pointerType === "touch" || event.shiftKey || event.button === 1 ? "pan" : "select";
    press = { ...at, kind, held, range: [...plot.range], moved: false, pinch: null };
    if (fingers.size === 2) startPinch();
  }

  function startPinch() {
    const [p, q] = [...fingers.values()];
    const x = (p.x + q.x) / 2;
    press = { ...press, kind: "pinch", moved: true, apart: Math.max(Math.abs(p.x - q.x), 20), range: [...plot.range],
      about: plot.range[0] + (x / p.width) * (plot.range[1] - plot.range[0]) };
  }

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
    } else if (press.kind === "cursor") plot.cursor(press.held, at.t);
    else if (!press.moved) return;
    else if (press.kind === "pan") {
      const by = ((press.x - at.x) / at.width) * (press.range[1] - press.range[0]);
      plot.zoom(press.range[0] + by, press.range[1] + by);
    } else if (press.kind === "select") select(press.x, at.x);
  }

  function select(from, to) {
    for (const { chart } of plot._panels) {
      chart.setSelect({ left: Math.min(from, to), width: Math.abs(to - from), top: 0, height: chart.over.clientHeight }, false);
    }
  }

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

  function wheel(event) {
    const at = place(event);
    if (!at || !event.deltaY) return;
    event.preventDefault();
    const lines = event.deltaMode === 1 ? 30 : 1;
    plot.scale(Math.exp(Math.min(Math.max(event.deltaY * lines, -120), 120) * 0.002), at.t);
  }

  function key(event) {
    if (event.target !== stack || event.ctrlKey || event.altKey || event.metaKey) return;
    const step = event.shiftKey ? 10 : 1;
    const [from, to] = plot.range;
    const selected = plot.cursors[plot.active] !== null ? plot.active : null;
    const sideways = (sign) => {
      if (selected && plot.cursors[selected] >= from && plot.cursors[selected] <= to) {
        plot.cursor(selected, plot.cursors[selected] + (sign * step * (to - from)) / 400);
      } else plot.pan(sign * 0.05 * step);
    };
    const act = {
      " ": () => (plot.paused ? plot.resume() : plot.pause()),
      "+": () => plot.scale(0.7), "=": () => plot.scale(0.7), "-": () => plot.scale(1 / 0.7),
      ArrowLeft: () => sideways(-1), ArrowRight: () => sideways(1),
      a: () => choose("a"), b: () => choose("b"), A: () => choose("a"), B: () => choose("b"),
      Delete: () => { plot.cursor("a", null); plot.cursor("b", null); },
      0: () => plot.showAll(),
    }[event.key];
    if (!act) return;
    event.preventDefault();
    act();
  }

  function choose(name) {
    const [from, to] = plot.range;
    const t = plot.cursors[name];
    plot.cursor(name, t !== null && t >= from && t <= to ? t : from + (name === "a" ? 0.35 : 0.65) * (to - from));
  }

  const taken = [["pointerdown", down], ["pointermove", move], ["pointerup", up], ["pointercancel", up],
    ["keydown", key], ["dblclick", () => { plot.cursor("a", null); plot.cursor("b", null); plot.options.live ? plot.resume() : plot.showAll(); }]];
  for (const [name, fn] of taken) stack.addEventListener(name, fn);
  stack.addEventListener("wheel", wheel, { passive: false });
  return () => {
    for (const [name, fn] of taken) stack.removeEventListener(name, fn);
    stack.removeEventListener("wheel", wheel);
  };
}
