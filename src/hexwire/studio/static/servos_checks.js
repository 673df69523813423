// Parts of the page Servos that look and test: overview with torque, health, stress test, wave. Owns forms and plots.

import { question } from "./forms.js";
import hexwire, { all } from "./live.js";
import { Plot } from "./plot.js";
import { Work, button, choice, facts, field, form, frames, hint, live, number, numeric, progress, put, row, section, table, valueOf, workAt } from "./servos_kit.js";
import { fill, html, node, whyOf } from "./widgets.js";

/**
 * @typedef {import("./servos_kit.js").Part} Part
 * @typedef {import("./servos_kit.js").LatePart} LatePart
 */

const LIVE = [
  ["deg", "Position", "°"], ["counts", "Counts", ""], ["speed", "Speed", "°/s"], ["load", "Load", "%"],
  ["volts", "Supply", "V"], ["celsius", "Temperature", "°C"], ["amps", "Current", "A"], ["state", "Faults", ""],
];
const FRAMES = [
  ["position", "Position", "°"], ["velocity", "Speed", "°/s"], ["load", "Load", "%"], ["voltage", "Supply", "V"],
  ["temperature", "Temperature", "°C"], ["current", "Current", "A"], ["flags", "Faults", ""],
];
const WORST = 1000; // ms between two looks at the worst of ten minutes

/** @type {Work<Calls["stress.run"]["answer"]> | null} */
let tested = null; // the last stress test

// -- overview ----------------------------------------------------------------------------------------------------

/** @type {Part} */
export function overview(view, place, servo) {
  if (!view.servo?.facts.length) return place.append(hint("This servo is not known any more; search again."));
  const { facts: known, remarks } = view.servo;
  const items = remarks.length ? remarks.map(({ text, bad }) => [text, bad ? "error" : "warn"]) : [["Nothing is known against this servo.", "ok"]];
  const now = node("dl", { class: "sv-facts" });
  fill(now, html`${LIVE.map(([key, name, unit]) => html`<div><dt>${name}</dt><dd><span data-live="${key}" data-id="${servo}">–</span> ${unit}</dd></div>`)}`);
  live(now);
  const torque = async (/** @type {boolean} */ on) => {
    if ((await view.act("servos.torque", { servo, on })) !== undefined) hexwire.notify(`servo ${servo} ${on ? "holds where it is" : "has no torque"}`, "ok");
  };
  const off = async () => {
    if (await question("Torque off", `Servo ${servo} lets go: what it carries falls. Hold it.`, "Switch torque off")) torque(false);
  };
  const recover = async () => {
    const text = `Servo ${servo} has no torque until its fault is gone. What it carries falls: hold it.`;
    if (!(await question("End the overload protection", text, "Switch torque off and wait"))) return;
    if ((await view.act("servos.recover", { servo })) !== undefined) hexwire.notify(`servo ${servo} has no fault, and no torque`, "ok");
  };
  const move = node("div");
  place.append(
    facts(known),
    node("ul", { class: "sv-remarks" }, ...items.map(([text, level]) => node("li", { "data-level": level }, text))),
    ...section("Now"), now,
    ...section("Torque", "Switched on, a servo holds where it is; it never drives to an old goal."),
    row(button("Torque on", () => torque(true), { label: `Torque of servo ${servo} on` }),
      button("Torque off", off, { label: `Torque of servo ${servo} off`, offline: true }),
      button("Recover from overload", recover)),
    ...section("Move", "Within the servo's own limits, while it has torque and you hold its marker, an arrow key or a button; or by exact steps."), move);
  if (hexwire.operates) import("./servos_move.js").then(({ moveServo }) => (move.isConnected ? moveServo(view, move, servo) : undefined));
}

/**
 * A servo of an arm: what its protocol tells of it, its values, and its slider.
 * @type {Part}
 */
export function ofJoint(view, place) {
  if (!view.joint) return;
  const { i, name } = view.joint, told = node("div"), now = node("dl", { class: "sv-facts" });
  view.tell = () => {
    if (!view.kinds.length) return;
    const [, , series, present, supply, remarks] = view.kinds[i];
    told.replaceChildren(facts([["Series", series], ["Answers", present], ["Supply limits", supply], ["Model", remarks]].filter(([, value]) => value)));
  };
  view.tell();
  fill(now, html`${FRAMES.map(([key, words, unit]) => html`<div><dt>${words}</dt><dd><span data-frame="${key}" data-joint="${i}">–</span> ${unit}</dd></div>`)}`);
  frames(now);
  place.append(told, ...section("Now"), now);
  if (!hexwire.operates) return;
  const move = node("div");
  place.append(...section("Move", `As ${name} on the page Move: while you hold its marker, an arrow key or a button; or by exact steps.`), move);
  import("./servos_move.js").then(({ moveJoint }) => move.isConnected && moveJoint(view, move, hexwire.model.joints, i));
}

// -- health ------------------------------------------------------------------------------------------------------

/** @type {LatePart} */
export async function health(view, place, servo) {
  const worst = node("div"), box = node("div", { class: "sv-plot" });
  const found = node("ul", { class: "sv-remarks", "aria-live": "polite" });
  const forget = async () => (await view.act("health.forget", { servo })) !== undefined && view.redraw();
  const judge = async (/** @type {HTMLElement} */ made) => {
    made.hidden = true;
    const rows = await view.act("health.judge");
    made.hidden = false;
    if (rows) found.replaceChildren(...rows.map(([level, words]) => node("li", { "data-level": level }, words)));
  };
  place.append(...section("Health", "The last ten minutes: the worst of each second, and live values."), worst, box,
    row(button("Forget these values", forget, { offline: true }), button("Judge all servos now", judge)), found);
  const look = async () => {
    if (!place.isConnected) return;
    const rows = await hexwire.call("health.worst", { servo }, view.opened).catch(() => null);
    if (rows) worst.replaceChildren(facts(rows));
    setTimeout(look, WORST);
  };
  look();
  const past = await view.act("health.rows", { servo });
  if (!past || !box.isConnected) return;
  const { now, rows } = past;
  const plot = new Plot(box, {
    title: `Health of servo ${servo}`, window: 600, keep: 600, height: 420, fileName: `health-${servo}`,
    series: [
      { name: "supply", unit: "V", colour: 0 },
      { name: "temperature", unit: "°C", colour: 1 },
      { name: "current", unit: "A", colour: 4 },
      { name: "load", unit: "%", colour: 3 },
    ],
  });
  for (const [t, ...values] of rows) plot.append(t, values);
  let last = -Infinity;
  const add = (/** @type {number} */ t, /** @type {number[]} */ ...values) => {
    if (t - last < 0.9) return;
    last = t;
    plot.append(t, values.map((value) => (Number.isFinite(value) ? value : null)));
  };
  if (view.joint) {
    const { i } = view.joint, begun = performance.now();
    hexwire.onFrame((frame) => frame.known[i] && add((performance.now() - begun) / 1000, frame.voltage[i], frame.temperature[i], Math.abs(frame.current[i]), Math.abs(100 * frame.load[i])), box);
    return;
  }
  hexwire.onServos((message) => {
    const one = message.rows.find((each) => each.id === servo);
    if (one) add(message.t - now, one.volts ?? NaN, one.celsius ?? NaN, one.amps === null ? NaN : Math.abs(one.amps), one.load === null ? NaN : Math.abs(one.load));
  }, box);
}

// -- stress test -------------------------------------------------------------------------------------------------

/** @type {Part} */
export function stress(view, place, servo) {
  const who = choice([["all", "all servos"], ["one", `servo ${servo}`]]), count = numeric(1000, { min: 1, max: 100000, step: 1 });
  const start = button("Start", run, { level: "accent" });
  const cancel = button("Cancel", () => view.act("servos.cancel"), { offline: true });
  const bar = node("progress", { class: "sv-progress", max: 1, "aria-label": "Progress of the stress test", hidden: true });
  const result = node("div");
  cancel.hidden = true;
  place.append(
    ...section("Stress test", "Reads positions as fast as the line allows. Missing values name the servo whose cable or supply is weak."),
    form(field("Servos", who), field("Reads", count), start, cancel), bar, result);

  const before = workAt(view, tested);
  if (before) follow(before);

  function run() {
    const over = view.act("stress.run", { count: valueOf(count), servos: who.value === "all" ? null : [servo] });
    follow(tested = new Work(view, over, null));
  }

  /**
   * Show a test that goes on, and then what it has found.
   * @param {NonNullable<typeof tested>} work
   */
  async function follow(work) {
    start.hidden = work.running;
    cancel.hidden = !work.running;
    const test = await (work.running ? progress(bar, null, work.over) : work.over);
    start.hidden = false;
    cancel.hidden = true;
    if (!test?.bins.length) return;
    const most = Math.max(...test.bins.map(([, times]) => times));
    const bars = node("div", { class: "sv-histogram" });
    fill(bars, table("Histogram of the times", ["From", "Share", "#Reads"],
      test.bins.map(([from, times]) => [from, html`<span class="sv-bar" data-share="${times / most}"></span>`, times])));
    for (const each of all(bars, ".sv-bar")) each.style.width = `${100 * Number(each.dataset.share)}%`;
    result.replaceChildren(facts(test.facts), bars);
    if (test.missing.length) result.append(fill(node("div"), table("Missing values", ["Servo", "#Missing"], test.missing)));
  }
}

// -- wave --------------------------------------------------------------------------------------------------------

/** @type {LatePart} */
export async function wave(view, place, servo) {
  const shape = choice();
  const amplitude = numeric(10, { min: 0.1, max: 45, step: 1 }), period = numeric(2, { min: 0.2, max: 600, step: 0.1 });
  const last = numeric(0.25, { min: 0.2, max: 600, step: 0.05 }), seconds = numeric(6, { min: 0.5, max: 600, step: 1 });
  const lastField = field("Last period, s", last);
  const told = hint("", { role: "status" });
  const hold = node("button", { type: "button", class: "hw-button hw-accent sv-hold", "data-wave": "" }, `Hold to move servo ${servo}`);
  const box = node("div", { class: "sv-plot" }), result = node("div", { class: "sv-result", role: "status" });
  place.append(
    ...section("Wave", "The servo moves to both sides of where it stands while you hold the button, and returns at the end. If you release it earlier, the servo holds where it is."),
    form(field("Shape", shape), field("To either side, °", amplitude), field("Period, s", period), lastField, field("Duration, s", seconds)),
    told, row(hold), node("div", { class: "sv-wave" }, box, result));
  const wanted = () => ({
    servo, shape: shape.value, amplitude: valueOf(amplitude), period: valueOf(period), seconds: valueOf(seconds), last_period: valueOf(last),
  });
  let asked = 0;
  const check = async () => {
    lastField.hidden = shape.value !== "sweep";
    const mine = (asked += 1);
    try {
      const words = await hexwire.call("wave.check", { args: wanted() }, view.opened);
      if (mine !== asked) return;
      put(told, words);
      hold.disabled = false;
    } catch (error) {
      if (mine !== asked) return;
      put(told, whyOf(error));
      hold.disabled = true;
    }
  };
  const plot = new Plot(box, {
    title: "Goal and position", window: 10, keep: 620, height: 260, fileName: "wave",
    series: [
      { name: "goal", unit: "°", colour: 1, dash: [6, 4] },
      { name: "position", unit: "°", colour: 0 },
      { name: "load", unit: "%", colour: 3 },
    ],
  });
  hexwire.holdButton(hold, "wave", wanted);
  hexwire.onWave((message) => {
    if (message.begin !== undefined) {
      plot.clear();
      plot.resume();
      result.textContent = "";
    }
    for (const each of message.rows || []) plot.append(each[0], each.slice(1));
    if (message.end !== undefined) figures(result, message.end, message);
  }, box);
  const shapes = await view.act("wave.shapes");
  if (!shapes) return;
  shape.append(...shapes.map((name) => new Option(name)));
  shape.value = "sine";
  for (const input of [shape, amplitude, period, last, seconds]) input.addEventListener("input", check);
  check();
}

/**
 * @param {HTMLElement} result
 * @param {string} end why it ended
 * @param {Wave} message
 */
function figures(result, end, message) {
  const words = message.samples
    ? `${end}: ${message.samples} samples, ${message.missed} missing, largest error ${number(message.off ?? null, 2)} °`
    : end;
  result.replaceChildren(hint(words));
  if (!message.steps?.length) return;
  const head = ["#Step at s", "#°", "#Delay ms", "#Rise ms", "#Overshoot %", "#Settled ms", "#Steady error °"];
  const rows = message.steps.map((s) => [
    number(s.at, 2), number(s.size, 1), number(s.delay, 0), number(s.rise, 0), number(s.overshoot, 1), number(s.settled, 0), number(s.steady_error, 2),
  ]);
  result.append(fill(node("div"), table("Step response", head, rows)));
}
