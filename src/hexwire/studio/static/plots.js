// The page Signals: any signal of any joint, live, with the last ten minutes from the server.
//
// Owns which signals are shown. plot.js draws; signals.js knows units.

import { chips } from "./forms.js";
import hexwire from "./live.js";
import { Plot } from "./plot.js";
import { fetchColumns, save } from "./columns.js";
import { ARM_SIGNALS, JOINT_SIGNALS, jointSeries, valuesOf } from "./signals.js";
import { loadSheet, node, whyOf } from "./widgets.js";

const STORE = "hexwire-plots";

/**
 * What is chosen; null: nothing was chosen yet.
 * @typedef {{ joints: string[] | null, signals: string[], arm: string[] }} Chosen
 *
 * A series, and what it shows: of one joint, or of the arm.
 * @typedef {import("./plot.js").SeriesOptions} SeriesOptions
 * @typedef {{ series: SeriesOptions, signal: import("./signals.js").JointSignal, joint: string, index: number }} JointRow
 * @typedef {{ series: SeriesOptions, signal: import("./signals.js").ArmSignal, joint?: undefined, index?: undefined }} ArmRow
 */

/** @param {HTMLElement} element */
export async function mount(element) {
  element.classList.add("pl-page");
  await loadSheet("/static/plots.css");
  if (!element.isConnected) return;
  /** @type {Chosen} */
  const chosen = { joints: null, signals: ["position", "goal"], arm: [], ...stored() };
  /**
   * `model`: names of the joints; `waiting`: frames that came while the past was asked for.
   * @type {{ plot: Plot | null, rows: (JointRow | ArmRow)[], model: string[], origin: number | null, waiting: Frame[] | null, last: number, round: number }}
   */
  const state = { plot: null, rows: [], model: [], origin: null, waiting: null, last: -Infinity, round: 0 };
  const pick = node("div", { class: "pl-pick" });
  const note = node("p", { class: "pl-note", role: "status" });
  const place = node("div", { class: "pl-plot" });
  const exports = node("div", { class: "pl-export", role: "group", "aria-label": "Export" });
  element.replaceChildren(pick, note, place, exports);

  const kinds = [
    ["CSV", "csv", "Save what is shown as CSV"],
    // A recording has whole states, so that it can be played.
    ["MCAP", "mcap", "Save the time shown, with all joints, as MCAP"],
  ];
  for (const [label, kind, title] of kinds) {
    const button = node("button", { type: "button", class: "hw-button", title, "aria-label": title }, label);
    button.addEventListener("click", () => exported(kind, button));
    exports.append(button);
  }
  const whole = node("input", { type: "checkbox", id: "pl-all" });
  exports.prepend(node("span", {}, "Save:"));
  exports.append(node("label", {}, whole, " all ten minutes"));

  const nothing = () => end("No arm is open. Open one on ", node("a", { href: "/" }, "Arms"), ".");
  hexwire.onHello((model) => model.joints.length ? begin(model) : nothing(), element);
  hexwire.onFrame((frame) => add(frame), element);
  hexwire.onLink((there) => there && state.model.length && refill(), element);
  if (!hexwire.model.joints.length && hexwire.facts?.mode === "bus") end("A bare servo bus is open: its values are on ", node("a", { href: "/servos" }, "Servos"), ".");
  else if (!hexwire.model.joints.length) nothing();
  let tall = window.innerHeight;
  const gone = setInterval(() => {
    if (element.isConnected) {
      if (tall !== window.innerHeight && state.plot) { plot(); refill(); }
      tall = window.innerHeight;
      return;
    }
    clearInterval(gone);
    state.plot?.destroy();
  }, 1000);

  /** @param {(string | Node)[]} words */
  function end(...words) {
    state.model = [];
    state.plot?.destroy();
    state.plot = null;
    pick.replaceChildren();
    exports.hidden = true;
    note.replaceChildren(...words);
  }

  /** @param {Hello} model */
  function begin(model) {
    const names = model.joints.map((joint) => joint.name);
    const same = state.model.join() === names.join();
    state.model = names;
    state.last = -Infinity;
    state.origin = null;
    exports.hidden = false;
    if (!same || !state.plot) {
      const kept = (chosen.joints ?? names).filter((name) => names.includes(name));
      chosen.joints = kept.length ? kept : names;
      choices();
      plot();
    }
    refill();
  }

  function choices() {
    /** @type {(key: keyof Chosen) => (values: string[]) => void} */
    const changed = (key) => (values) => { chosen[key] = values; store(); plot(); refill(); };
    pick.replaceChildren(
      chips("Joints", state.model.map((name, i) => ({ key: name, text: name, colour: `--joint-${(i % 8) + 1}` })),
        chosen.joints ?? [], changed("joints"), { all: true }),
      chips("Signals", JOINT_SIGNALS.map((one) => ({ key: one.key, text: one.words, unit: one.unit })),
        chosen.signals, changed("signals")),
      chips("Arm", ARM_SIGNALS.map((one) => ({ key: one.key, text: one.words, unit: one.unit })), chosen.arm, changed("arm")),
    );
  }

  /** What is drawn: pairs of series and how its values are found. */
  function rows() {
    /** @type {(JointRow | ArmRow)[]} */
    const found = [];
    for (const signal of JOINT_SIGNALS.filter((one) => chosen.signals.includes(one.key))) {
      state.model.forEach((joint, i) => {
        if (chosen.joints?.includes(joint)) found.push({ series: jointSeries(joint, i, signal), signal, joint, index: i });
      });
    }
    ARM_SIGNALS.filter((one) => chosen.arm.includes(one.key)).forEach((signal, i) => {
      found.push({ series: { name: signal.words, quantity: signal.words, unit: signal.unit, colour: i, digits: signal.digits }, signal });
    });
    return found;
  }

  function plot() {
    const before = state.plot;
    state.rows = rows();
    const panels = new Set(state.rows.map((row) => row.series.panel ?? row.series.unit)).size;
    // The page is filled, and the table of values is in sight: beside the panels, or below them where there is no room.
    const below = matchMedia("(max-width: 960px)").matches ? Math.min(240, 34 + 21 * state.rows.length) : 0;
    const top = place.getBoundingClientRect().top + window.scrollY;
    const height = Math.max(260, window.innerHeight - top - below - 112, 130 * panels);
    const options = { title: "", fileName: `${hexwire.model.robot || "hexwire"} plot`, series: state.rows.map((row) => row.series), height,
      keep: 600, capacity: 66048, window: before?.window ?? 30, origin: state.origin ?? 0 };
    before?.destroy();
    state.plot = new Plot(place, options);
    note.textContent = state.rows.length ? "" : "Choose a signal.";
  }

  async function refill() {
    const round = ++state.round;
    state.waiting = [];
    let found;
    try {
      found = await fetchColumns("/data/history");
    } catch (error) {
      if (round === state.round) { note.textContent = whyOf(error); state.waiting = null; }
      return;
    }
    if (round !== state.round || !state.plot) return;
    if (state.origin === null && found.times.length) state.origin = found.times[0];
    state.plot.options.origin = state.origin ?? 0;
    const columns = state.rows.map(({ signal, joint }) =>
      valuesOf(signal, (key) => found.columns.get(joint ? `${joint}.${key}` : key)) ?? new Float32Array(found.times.length).fill(NaN));
    state.plot.set([found.times, ...columns]);
    state.last = found.times.length ? found.times[found.times.length - 1] : -Infinity;
    const waiting = state.waiting;
    state.waiting = null;
    waiting?.forEach(add);
  }

  /** @param {Frame} frame */
  function add(frame) {
    if (!state.plot || !state.model.length || frame.position.length !== state.model.length) return;
    if (state.waiting) { state.waiting.push(frame); return; }
    if (frame.time <= state.last) return;
    state.last = frame.time;
    if (state.origin === null) state.plot.options.origin = state.origin = frame.time;
    const { facts } = hexwire;
    const ofArm = { rate: facts?.rate, round_trip: facts?.round_trip_ms, faults: facts?.faults?.length };
    state.plot.append(frame.time, state.rows.map(({ signal, index }) => {
      if (index === undefined) return ofArm[signal.key] ?? NaN;
      if (!frame.known[index]) return NaN; // what it was is no value of now
      if (signal.key === "error") return signal.factor * (frame.goal[index] - frame.position[index]);
      return signal.factor * frame[signal.key][index];
    }));
  }

  /**
   * @param {string} kind
   * @param {HTMLButtonElement} button
   */
  async function exported(kind, button) {
    if (!state.plot) return;
    const [from, to] = state.plot.range;
    // Of a difference, the two values that it is of.
    const kept = (/** @type {JointRow | ArmRow} */ { signal, joint }) => (signal.key === "error" ? ["goal", "position"] : [signal.key])
      .map((key) => (joint ? `${joint}.${key}` : key));
    const columns = [...new Set(state.rows.flatMap(kept))];
    button.disabled = true;
    note.textContent = "";
    try {
      await save(`/data/history.${kind}`, { ...(whole.checked ? {} : { from, to }), ...(kind === "csv" ? { columns: columns.join() } : {}) });
    } catch (error) {
      note.textContent = whyOf(error);
    }
    button.disabled = false;
  }

  function stored() {
    try { return JSON.parse(localStorage.getItem(STORE) ?? "{}"); } catch { return {}; }
  }

  function store() {
    try { localStorage.setItem(STORE, JSON.stringify(chosen)); } catch { /* a browser that stores nothing */ }
  }
}
