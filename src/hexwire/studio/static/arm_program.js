/* Programs on the page Move: steps one after the other, edited, checked as a whole, saved as a file, and run from any of them.

Owns the list and its run. A file is what `hexwire play` runs, too: degrees, millimetres, percent. Each motion is one that this
page holds, planned and checked by the server like every other; so it ends when the page is hidden, and STOP voids what is left.
Loaded when the part is first opened. */

import { capital, degrees, radians } from "./arm.js";
import hexwire from "./live.js";
import { node } from "./widgets.js";

const KINDS = {
  pose: "go to a pose", joints: "go to these joint angles", place: "go to this place", line: "straight to this place",
  grip: "gripper", wait: "wait", ask: "wait for me", play: "play a recording", repeat: "repeat",
};
const LOOK = 100; // ms between two looks, in a pause, at whether it is to end
const FINE = ["arrived", "released", "ended"];
const round = (value, digits) => Number(value.toFixed(digits));

export function mountProgram(page, root) {
  let steps = []; // as in the file
  let running = null; // the run: its end, and where it is
  let dragged = null;
  let saved = "";

  const list = node("ol", { class: "arm-steps", "aria-label": "Steps" });
  const note = node("p", { class: "arm-note", role: "status" });
  const name = node("input", { "aria-label": "Name of the program", placeholder: "name", maxlength: "80" });
  const files = node("select", { "aria-label": "Saved programs" });
  const kind = node("select", { "aria-label": "Kind of step" }, ...Object.entries(KINDS).map(([value, words]) => node("option", { value }, words)));
  const button = (words, act, more = {}) => node("button", { class: "hw-button arm-small", type: "button", onclick: act, ...more }, words);
  const goOn = button("Continue", () => running?.goOn?.(), { hidden: true });
  const end = button("End program", () => finish("ended"), { hidden: true });
  const start = button("Run", () => run(0), { class: "hw-button arm-primary arm-need arm-whole" });
  root.append(
    node("div", { class: "hw-row" }, name, button("Save", save), node("span", { class: "hw-row", hidden: true }, files, button("Open", open), button("Remove", remove))),
    list,
    node("div", { class: "hw-row" }, kind, button("Add step", add), button("Check", check), start, goOn, end),
    note);

  const say = (text, level = "") => {
    note.textContent = text;
    note.dataset.level = level;
  };
  const ask = async (call, values) => {
    const answer = await page.call(call, values);
    if (answer.error) say(capital(answer.error), "error");
    return answer.error ? null : answer;
  };

  // -- files ----------------------------------------------------------------------------------------

  const listed = (names) => {
    if (!names) return;
    files.parentElement.hidden = names.length === 0;
    files.replaceChildren(...names.map((one) => node("option", { value: one, selected: one === saved }, one)));
  };
  async function open() {
    const rows = files.value && (await ask("program", { name: files.value }));
    if (!rows) return;
    finish("another program was opened");
    steps = rows;
    saved = name.value = files.value;
    draw();
    say(`${saved}: ${steps.length} steps.`);
  }
  async function save() {
    const force = name.value === saved;
    const names = await ask("save_program", { name: name.value, steps, force });
    if (!names) return;
    saved = name.value;
    listed(names);
    say(`Saved: hexwire play "${saved}.toml" in the folder of recordings runs it, too.`);
  }
  async function remove() {
    const names = files.value && (await ask("remove_program", { name: files.value }));
    if (!names) return;
    say(`${files.value} is removed; its steps stay here until the page is left.`);
    saved = "";
    listed(names);
  }

  // -- the list -------------------------------------------------------------------------------------

  function add() {
    const made = makeStep(page, kind.value);
    if (made.error) {
      say(made.error, "error");
      return;
    }
    steps.push(made);
    changed();
  }
  function changed() {
    finish("the program was changed");
    draw();
  }
  function draw() {
    list.replaceChildren(...rows(steps, ""));
    lock();
  }
  function rows(of, before) {
    return of.map((step, i) => row(of, step, i, `${before}${i + 1}`));
  }
  function row(of, step, i, number) {
    const inner = step.steps && node("ol", { class: "arm-steps", "aria-label": `Steps of ${number}` }, ...rows(step.steps, `${number}.`));
    const made = node("li", { draggable: "true", "data-step": number },
      node("div", { class: "arm-step" },
        node("span", { class: "arm-step-number" }, number), fields(step, changed),
        button("↑", () => move(of, i, -1), { "aria-label": `Move step ${number} up` }),
        button("↓", () => move(of, i, 1), { "aria-label": `Move step ${number} down` }),
        of === steps ? button("▶", () => run(i), { class: "hw-button arm-small arm-need arm-whole", "aria-label": "Run from here", title: "Run from here" }) : "",
        button("×", () => (of.splice(i, 1), changed()), { "aria-label": `Remove step ${number}` })),
      inner ?? "");
    made.addEventListener("dragstart", (event) => {
      event.stopPropagation();
      dragged = { of, i, step };
      event.dataTransfer.effectAllowed = "move";
      event.dataTransfer.setData("text/plain", number);
    });
    made.addEventListener("dragover", (event) => dragged && event.preventDefault());
    made.addEventListener("drop", (event) => {
      if (!dragged) return;
      event.preventDefault();
      event.stopPropagation();
      const { of: from, i: at, step: taken } = dragged;
      dragged = null;
      if (taken === step || holds(taken, step)) return; // a repetition does not go into itself
      from.splice(at, 1);
      // On a repetition that has its steps elsewhere: to its end; else before what it was dropped on.
      if (step.steps && event.target.closest("ol") !== made.parentElement) step.steps.push(taken);
      else of.splice(of.indexOf(step) + (from === of && at < i ? 1 : 0), 0, taken);
      changed();
    });
    made.addEventListener("dragend", () => (dragged = null));
    return made;
  }
  /** Up and down in its list; past a repetition it goes into it, at its end out of it. */
  function move(of, i, by) {
    const [step] = of.splice(i, 1);
    const next = of[by < 0 ? i - 1 : i];
    const outer = of === steps ? null : parent(steps, of);
    if (next?.steps && next !== step) next.steps.splice(by < 0 ? next.steps.length : 0, 0, step);
    else if (next) of.splice(i + by, 0, step);
    else if (outer) outer.of.splice(outer.i + (by > 0 ? 1 : 0), 0, step);
    else of.splice(i, 0, step);
    changed();
  }

  // -- check and run --------------------------------------------------------------------------------

  const mark = (number, level) => {
    const found = number && list.querySelector(`[data-step="${CSS.escape(number)}"]`);
    if (found) found.dataset.level = level;
  };
  async function check() {
    for (const one of list.querySelectorAll("[data-level]")) delete one.dataset.level;
    const told = steps.length ? await ask("check_program", { steps }) : null;
    if (!told) return false;
    const refused = told.find(({ refusal }) => refusal);
    if (refused) {
      mark(refused.number, "error");
      say(`Step ${refused.number}: ${refused.refusal}`, "error");
      if (refused.fits !== null) offer(refused);
      return false;
    }
    say(`All ${told.length} motions are allowed from here.`);
    return true;
  }
  /** Offer the speed at which a recording is not too fast. */
  function offer({ number, fits }) {
    note.append(" ", button(`Play it at ${fits} of its speed`, () => {
      stepAt(steps, number).factor = fits;
      changed();
      check();
    }));
  }
  async function run(first) {
    finish("begun anew");
    if (!(await check()) || !page.mine) return;
    const mine = (running = { ends: page.attend(), over: "", goOn: null });
    lock();
    const todo = [...unrolled(steps.slice(first), "", first)];
    for (const [number, step] of todo) {
      if (gone(mine)) break;
      mark(number, "now");
      list.querySelector(`[data-step="${CSS.escape(number)}"]`)?.scrollIntoView({ block: "nearest" });
      say(`Step ${number}: ${words(step)}`);
      const why = await done(mine, step);
      mark(number, "");
      if (why !== "arrived") mine.over ||= why;
    }
    if (running !== mine) return;
    running = null;
    lock();
    const over = mine.over;
    say(over ? `Ended: ${over}` : "The program has ended.", over && !FINE.includes(over) ? "error" : "");
  }
  /** Do a step; resolves with "arrived", or why the program does not go on. */
  async function done(mine, step) {
    if ("wait" in step) {
      const until = performance.now() + 1000 * step.wait;
      while (performance.now() < until && !gone(mine)) await new Promise((next) => setTimeout(next, LOOK));
    } else if ("ask" in step) {
      say(step.ask, "warn");
      goOn.hidden = false;
      goOn.focus();
      let on = false;
      mine.goOn = () => (on = true);
      while (!on && !gone(mine)) await new Promise((next) => setTimeout(next, LOOK));
      mine.goOn = null;
      goOn.hidden = true;
    } else {
      return page.run(motionOf(step));
    }
    return gone(mine) ? mine.over : "arrived";
  }
  function gone(mine) {
    mine.over ||= mine.ends();
    return Boolean(mine.over);
  }
  function finish(why) {
    if (!running) return;
    running.over ||= why;
    hexwire.release(why === "ended" ? "ended" : "released");
  }
  function lock() {
    const busy = running !== null;
    end.hidden = !busy;
    for (const one of root.querySelectorAll("button, input, select")) if (one !== end && one !== goOn) one.disabled = busy || (one.classList.contains("arm-need") && (!page.mine || page.unready !== ""));
  }
  page.on("need", lock);
  ask("programs").then(listed);
  draw();
}

const holds = (step, other) => (step.steps ?? []).some((one) => one === other || holds(one, other));

/** The step with a number such as 3.1. */
function stepAt(steps, number) {
  const places = number.split(".").map((part) => Number(part) - 1);
  return places.reduce((step, place) => (step.steps ?? step)[place], steps);
}

function parent(of, inner) {
  for (const [i, step] of of.entries()) {
    if (step.steps === inner) return { of, i };
    const found = step.steps && parent(step.steps, inner);
    if (found) return found;
  }
  return null;
}

/** What is done, in its order, with the number of each step; the numbers begin behind `first`. */
function* unrolled(steps, before, first = 0) {
  for (const [i, step] of steps.entries()) {
    const number = `${before}${first + i + 1}`;
    if (!step.steps) yield [number, step];
    else for (let time = 0; time < step.repeat; time += 1) yield* unrolled(step.steps, `${number}.`);
  }
}

/** A step as the server takes a motion: radians and metres. */
function motionOf(step) {
  const speed = step.speed === undefined ? {} : { speed: step.speed };
  if ("pose" in step) return { what: "pose", name: step.pose, ...speed };
  if ("joints" in step) return { what: "joints", goals: Object.fromEntries(Object.entries(step.joints).map(([name, angle]) => [name, radians(angle)])), ...speed };
  if ("grip" in step) return { what: "grip", share: step.grip / 100, ...speed };
  if ("play" in step) {
    const part = { recording: step.play, begin: step.from ?? 0, factor: step.factor ?? 1 };
    return { what: "play", ...part, ...(step.to === undefined ? {} : { end: step.to }), ...speed };
  }
  const place = { what: "place", position: step.place.map((value) => value / 1000), relative: Boolean(step.relative), straight: Boolean(step.line), ...speed };
  if (step.branch) place.branch = step.branch;
  if (step.rpy) return { ...place, aim: "rpy", rpy: step.rpy.map(radians) };
  if (step.pitch !== undefined) return { ...place, aim: "pitch", pitch: radians(step.pitch), ...(step.roll === undefined ? {} : { roll: radians(step.roll) }) };
  return { ...place, aim: step.aim ?? "arm" };
}

/** A step of a kind, from where the arm is now. */
function makeStep(page, kind) {
  const speed = round(page.speed, 2);
  if (kind === "wait") return { wait: 1 };
  if (kind === "ask") return { ask: "Continue?" };
  if (kind === "repeat") return { repeat: 2, steps: [{ wait: 0 }] };
  if (kind === "pose") return { pose: "home", speed };
  if (kind === "play") return { play: "recording.mcap", speed };
  if (kind === "grip") return { grip: 100, speed };
  const positions = page.positions();
  if (!positions || ![...positions].every(Number.isFinite)) return { error: "Nobody knows where the joints are." };
  const { joints } = page.args;
  if (kind === "joints") return { joints: Object.fromEntries(joints.map(({ name }, i) => [name, round(degrees(positions[i]), 2)])), speed };
  const place = ["x", "y", "z"].map((axis) => Number(page.find(`[data-tip="${axis}"]`)?.textContent.replace("−", "-")));
  if (!place.every(Number.isFinite)) return { error: "The place of this arm's tip is not known." };
  return { place, ...(kind === "line" ? { line: true } : {}), speed };
}

function words(step) {
  if ("pose" in step) return `to ${step.pose}`;
  if ("joints" in step) return "to joint angles";
  if ("place" in step) return `${step.line ? "straight " : ""}${step.relative ? "by" : "to"} ${step.place.join(" ")} mm`;
  if ("grip" in step) return `gripper ${step.grip} % open`;
  if ("play" in step) return step.play;
  return "wait" in step ? `wait ${step.wait} s` : "ask" in step ? step.ask : `repeat ${step.repeat} times`;
}

/** What of a step can be changed. */
function fields(step, changed) {
  const parts = [];
  const text = (label, value, put, attributes = {}) => {
    const made = node("input", { "aria-label": label, value: String(value), ...attributes });
    made.addEventListener("change", () => {
      put(made.value);
      changed();
    });
    return made;
  };
  const number = (label, value, put, attributes = {}) => text(label, value, (typed) => Number.isFinite(parseFloat(typed)) && put(Number(typed)), { type: "number", step: "any", class: "arm-number-field", ...attributes });
  const flag = (label, now, put) => {
    const made = node("input", { type: "checkbox", checked: now });
    made.addEventListener("change", () => {
      put(made.checked);
      changed();
    });
    return node("label", {}, made, ` ${label}`);
  };
  if ("pose" in step) parts.push("pose ", text("Pose", step.pose, (value) => (step.pose = value)));
  else if ("joints" in step) parts.push("joints ", ...Object.entries(step.joints).map(([name, angle]) => number(`${name}, degrees`, angle, (value) => (step.joints[name] = value))), " °");
  else if ("place" in step) {
    parts.push(...step.place.map((value, i) => number(`${"xyz"[i]}, millimetres`, value, (typed) => (step.place[i] = typed))), " mm ",
      flag("straight", Boolean(step.line), (on) => (on ? (step.line = true) : delete step.line)),
      flag("relative", Boolean(step.relative), (on) => (on ? (step.relative = true) : delete step.relative)));
  } else if ("grip" in step) parts.push("gripper ", number("Opening, percent", step.grip, (value) => (step.grip = value), { min: 0, max: 100 }), " % open");
  else if ("play" in step) parts.push("play ", text("Recording", step.play, (value) => (step.play = value)));
  else if ("wait" in step) parts.push("wait ", number("Seconds", step.wait, (value) => (step.wait = value), { min: 0 }), " s");
  else if ("ask" in step) parts.push("wait for me: ", text("Text", step.ask, (value) => (step.ask = value)));
  else parts.push("repeat ", number("Times", step.repeat, (value) => (step.repeat = Math.max(1, Math.round(value))), { min: 1 }), " times");
  if (step.speed !== undefined) parts.push(" at ", number("Speed, percent of the limits", round(100 * step.speed, 0), (value) => (step.speed = Math.min(1, Math.max(0.01, value / 100))), { min: 1, max: 100 }), " %");
  return node("span", { class: "arm-step-fields" }, ...parts);
}
