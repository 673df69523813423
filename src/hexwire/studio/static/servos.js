// The live parts of the page Servos: values in the list, waves, health, ranges. Forms and text are NiceGUI's; this
// module fills what changes often, and passes clicks in tables on as events. Must not know what a servo may do.

import hexwire, { faultsOf } from "/static/live.js";
import { Plot } from "/static/plot.js";

const DIGITS = { deg: 1, counts: 0, speed: 1, load: 0, volts: 1, celsius: 0, amps: 2 };
const FRAME = { position: [180 / Math.PI, 1], velocity: [180 / Math.PI, 1], load: [100, 0], voltage: [1, 1], temperature: [1, 0], current: [1, 2] };

export function mount(element, args) {
  if (!element) return;
  ({ list, live, table, wave, health, range, frames })[args.part](element, args);
}

function number(value, digits) {
  return value === null || !Number.isFinite(value) ? "–" : value.toFixed(digits).replace("-", "−");
}

function put(cell, text, level = "") {
  if (cell.textContent !== text) cell.textContent = text;
  if (cell.dataset.level !== level) cell.dataset.level = level;
}

// -- clicks and live values -------------------------------------------------------------------------------------

function clicks(element) {
  element.addEventListener("click", (event) => {
    const target = event.target.closest("[data-do]");
    if (target) element.dispatchEvent(new CustomEvent("act", { detail: { do: target.dataset.do, value: target.dataset.value } }));
  });
}

function fill(element, rows) {
  for (const row of rows) {
    for (const cell of element.querySelectorAll(`[data-live][data-id="${row.id}"]`)) {
      const name = cell.dataset.live;
      if (name === "state") put(cell, row.error ? "silent" : row.faults.join(", ") || "ok", row.error || row.faults.length ? "error" : "ok");
      else put(cell, number(row[name], DIGITS[name]));
    }
  }
}

function live(element) {
  element.classList.add("hw-live");
  hexwire.onServos((message) => fill(element, message.rows), element);
}

/** What needs a servo to answer cannot be pressed while nobody knows how the servos are. */
function silenced(page) {
  const mark = () => {
    const unknown = hexwire.facts?.mode === "bus" && !hexwire.known;
    for (const button of page.querySelectorAll(".sv-right .hw-button:not(.sv-offline)")) {
      if (button.inert !== unknown) button.inert = unknown;
    }
  };
  // Parts come and go.
  const watch = new MutationObserver(mark);
  watch.observe(page, { childList: true, subtree: true });
  hexwire.onFacts(mark, page);
}

function list(element, args) {
  clicks(element);
  live(element);
  silenced(element.closest(".sv-page"));
  const doing = document.getElementById(args.doing);
  if (doing) hexwire.onFacts((facts) => put(doing, facts.job || ""), element);
}

function table(element) {
  clicks(element);
}

// -- an arm's states, where a board answers for the servos -----------------------------------------------------

function frames(element) {
  element.classList.add("hw-live");
  let last = 0;
  hexwire.onFrame((frame) => {
    const now = performance.now();
    if (now - last < 200) return;
    last = now;
    for (const cell of element.querySelectorAll("[data-frame]")) {
      const name = cell.dataset.frame, i = Number(cell.dataset.joint);
      if (name === "flags") {
        const faults = faultsOf(frame.flags[i]);
        put(cell, faults.join(", ") || "ok", faults.length ? "error" : "ok");
      } else {
        const [factor, digits] = FRAME[name];
        put(cell, number(frame[name][i] * factor, digits));
        cell.classList.toggle("hw-dim", !frame.known[i]);
      }
    }
  }, element);
}

// -- wave -------------------------------------------------------------------------------------------------------

function wave(element, args) {
  const button = document.getElementById(args.button);
  const box = document.createElement("div");
  box.className = "sv-plot";
  const result = document.createElement("div");
  result.className = "sv-result";
  result.setAttribute("role", "status");
  element.append(box, result);
  const plot = new Plot(box, {
    title: "Goal and position", window: 10, keep: 620, height: 260, fileName: "wave",
    series: [
      { name: "goal", unit: "deg", colour: 1, dash: [6, 4] },
      { name: "position", unit: "deg", colour: 0 },
      { name: "load", unit: "%", colour: 3 },
    ],
  });
  hexwire.holdButton(button, "wave", () => JSON.parse(button.dataset.args || "{}"));
  hexwire.onWave((message) => {
    if (message.begin !== undefined) {
      plot.clear();
      plot.resume();
      result.textContent = "";
    }
    for (const row of message.rows || []) plot.append(row[0], row.slice(1));
    if (message.end !== undefined) figures(result, message);
  }, element);
}

function figures(result, message) {
  const words = message.samples
    ? `${message.end}: ${message.samples} samples, ${message.missed} missing, largest error ${number(message.off, 2)} deg`
    : message.end;
  result.replaceChildren(Object.assign(document.createElement("p"), { textContent: words, className: "sv-hint" }));
  if (!message.steps || !message.steps.length) return;
  const head = ["Step at s", "deg", "Delay ms", "Rise ms", "Overshoot %", "Settled ms", "Steady error deg"];
  const rows = message.steps.map((s) => [
    number(s.at, 2), number(s.size, 1), number(s.delay, 0), number(s.rise, 0), number(s.overshoot, 1), number(s.settled, 0), number(s.steady_error, 2),
  ]);
  result.append(makeTable("Step response", head, rows));
}

function makeTable(caption, head, rows) {
  const region = Object.assign(document.createElement("div"), { className: "sv-scroll", tabIndex: 0 });
  region.setAttribute("role", "region");
  region.setAttribute("aria-label", caption);
  const made = Object.assign(document.createElement("table"), { className: "sv-table" });
  made.append(Object.assign(document.createElement("caption"), { textContent: caption }));
  const line = (cells, kind) => {
    const row = document.createElement("tr");
    cells.forEach((text) => {
      const cell = Object.assign(document.createElement(kind), { textContent: text, className: "sv-num" });
      if (kind === "th") cell.scope = "col";
      row.append(cell);
    });
    return row;
  };
  const top = document.createElement("thead"), body = document.createElement("tbody");
  top.append(line(head, "th"));
  body.append(...rows.map((row) => line(row, "td")));
  made.append(top, body);
  region.append(made);
  return region;
}

// -- health -----------------------------------------------------------------------------------------------------

function health(element, args) {
  const plot = new Plot(element, {
    title: `Health of servo ${args.servo}`, window: 600, keep: 600, height: 420, fileName: `health-${args.servo}`,
    series: [
      { name: "supply", unit: "V", colour: 0 },
      { name: "temperature", unit: "°C", colour: 1 },
      { name: "current", unit: "A", colour: 4 },
      { name: "load", unit: "%", colour: 3 },
    ],
  });
  for (const [t, ...values] of args.rows) plot.append(t, values);
  let last = -Infinity;
  hexwire.onServos((message) => {
    const row = message.rows.find((one) => one.id === args.servo);
    const t = message.t - args.now;
    if (!row || t - last < 0.9) return;
    last = t;
    plot.append(t, [row.volts, row.celsius, row.amps === null ? null : Math.abs(row.amps), row.load === null ? null : Math.abs(row.load)]);
  }, element);
}

// -- ranges -----------------------------------------------------------------------------------------------------

function range(element) {
  const HEAD = ["Joint", "Min deg", "Now deg", "Max deg", "", "Missing"];
  let made = null, rows = new Map();
  hexwire.onRange((message) => {
    if (!made || !made.isConnected || rows.size !== message.rows.length) {
      const region = makeTable("Ranges", HEAD, message.rows.map(() => HEAD.map(() => "")));
      element.replaceChildren(region);
      made = region;
      rows = new Map(message.rows.map((row, i) => [row.name, [...region.querySelectorAll("tbody tr")[i].cells]]));
      for (const cells of rows.values()) {
        cells[0].className = cells[5].className = "";
        for (const i of [0, 5]) region.querySelectorAll("thead th")[i].className = "";
        cells[4].className = "sv-range";
        cells[4].append(document.createElement("span"), document.createElement("i"));
      }
    }
    for (const row of message.rows) {
      const cells = rows.get(row.name);
      if (!cells) continue;
      put(cells[0], row.name);
      put(cells[1], number(row.low, 1));
      put(cells[2], number(row.now, 1));
      put(cells[3], number(row.high, 1));
      put(cells[5], row.missing || "nothing", row.missing ? "warn" : "ok");
      const span = Math.max(row.usual || 0, row.high - row.low, 1) * 1.1, middle = (row.high + row.low) / 2;
      const place = (value) => Math.min(100, Math.max(0, 50 + (100 * (value - middle)) / span));
      const [bar, mark] = cells[4].children;
      bar.style.left = `${place(row.low)}%`;
      bar.style.width = `${place(row.high) - place(row.low)}%`;
      mark.style.left = `${place(row.now)}%`;
    }
  }, element);
}
