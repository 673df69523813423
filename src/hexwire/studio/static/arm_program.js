/* Programs on the page Move: steps one after the other, edited, checked as a whole, saved as a file, and run from any of them.

Owns the list and its run. A file is what `hexwire play` runs, too: degrees, millimetres, percent. Each motion is one that this
page holds, planned and checked by the server like every other; so it ends when the page is hidden, and STOP voids what is left.
Loaded when the part is first chosen. */

import { degrees, isRefused, radians } from "./arm.js";
import { question } from "./forms.js";
import hexwire, { all, capital } from "./live.js";
import { node, within } from "./widgets.js";

const KINDS = {
  pose: "go to a pose", joints: "go to these joint angles", place: "go to this place", line: "straight to this place",
  grip: "gripper", wait: "wait", ask: "wait for me", play: "play a recording", repeat: "repeat",
};
const LOOK = 100; // ms between two looks, in a pause, at whether it is to end
const FINE = ["arrived", "released", "ended"];
const AIMS = [["arm", "keeps its angle to the arm"], ["space", "keeps its direction"], ["down", "points straight down"]];
const BACK = 50; // changes that can be undone
/** @type {(value: number, digits: number) => number} */
const round = (value, digits) => Number(value.toFixed(digits));

/**
 * The steps, as in the file, and what can be undone: they stay when the page is left.
 * @type {{ steps: Step[], name: string, saved: string, past: string[] }}
 */
const draft = { steps: [], name: "", saved: "", past: [] };

/**
 * A run: why it is to end, why it did, and what goes on from a pause.
 * @typedef {{ ends: () => string, over: string, goOn: (() => unknown) | null }} ProgramRun
 */

/**
 * @param {ArmPage} page
 * @param {HTMLElement} root
 */
export function mountProgram(page, root) {
  let { steps } = draft;
  let before = JSON.stringify(steps);
  /** @type {ProgramRun | null} */
  let running = null;
  /** @type {{ of: Step[], i: number, step: Step } | null} */
  let dragged = null;
  /** @type {string[]} */
  let recordings = [];
  /** @type {string[]} */
  let poses = [];
  /** @type {Map<Step, HTMLElement>} */
  const shown = new Map(); // the row of each step
  let opening = 0; // files that were asked for
  let checks = 0; // what was found out about steps that are others now is not shown

  const list = node("ol", { class: "arm-steps", "aria-label": "Steps" });
  const note = node("p", { class: "arm-note", role: "status" });
  const name = node("input", { "aria-label": "Name of the program", placeholder: "name", maxlength: "80" });
  const files = node("select", { "aria-label": "Saved programs" });
  const kind = node("select", { "aria-label": "Kind of step" }, ...Object.entries(KINDS).map(([value, words]) => node("option", { value }, words)));
  /** @type {(words: string, act: () => unknown, more?: Record<string, string | boolean>) => HTMLButtonElement} */
  const button = (words, act, more = {}) => node("button", { class: "hw-button arm-small", type: "button", onclick: act, ...more }, words);
  const goOn = button("Continue", () => running?.goOn?.(), { hidden: true });
  const end = button("End program", () => finish("ended"), { hidden: true });
  const start = button("Run", () => run(0), { class: "hw-button arm-primary arm-need arm-whole" });
  const undone = button("Undo", undo);
  const saved = node("span", { class: "hw-row", hidden: true }, files, button("Open", open), button("Remove", remove));
  root.append(
    node("div", { class: "hw-row arm-program-file" }, name, button("Save", save), saved),
    list,
    node("div", { class: "hw-row" }, kind, button("Add step", add), undone, node("span", { class: "hw-row arm-end-row" }, button("Check", () => check(0)), start, goOn, end)),
    note);

  const say = (/** @type {string} */ text, level = "") => {
    note.textContent = text;
    note.dataset.level = level;
  };
  /**
   * @template {keyof Calls} N
   * @param {N} name
   * @param {Calls[N]["args"]} [values]
   */
  const ask = async (name, values) => {
    const answer = await page.call(name, values);
    if (!isRefused(answer)) return answer;
    say(capital(answer.error), "error");
    return null;
  };

  // -- files ----------------------------------------------------------------------------------------

  const listed = (/** @type {string[] | null} */ names) => {
    if (!names) return;
    saved.hidden = names.length === 0;
    files.replaceChildren(...names.map((one) => node("option", { value: one, selected: one === draft.saved }, one)));
  };
  async function open() {
    const wanted = files.value, mine = (opening += 1);
    const rows = wanted ? await ask("arm.program", { name: wanted }) : null;
    if (!rows || mine !== opening) return;
    steps = draft.steps = rows;
    // Not what is chosen by now: it would be saved as that.
    draft.saved = draft.name = name.value = wanted;
    changed();
    say(`${wanted}: ${steps.length} steps.`);
  }
  async function save() {
    const called = name.value, force = called === draft.saved;
    const names = whole() ? await ask("arm.save_program", { name: called, steps, force }) : null;
    if (!names) return;
    // Not what is typed by now: a file of that name would be replaced without a question.
    draft.saved = called;
    listed(names);
    say(`Saved: hexwire play "${called}.toml" in the folder of recordings runs it, too.`);
  }
  async function remove() {
    const gone = files.value;
    if (!gone || !(await question(`Remove ${gone}?`, "Its file is deleted; the steps below stay.", "Remove it"))) return;
    const names = await ask("arm.remove_program", { name: gone });
    if (!names) return;
    say(`${gone} is removed.`);
    draft.saved = "";
    listed(names);
  }

  // -- the list -------------------------------------------------------------------------------------

  function add() {
    const made = makeStep(page, kind.value, recordings);
    if (isRefused(made)) {
      say(made.error, "error");
      return;
    }
    steps.push(made);
    changed();
  }
  /** A value of a step is another one; its row stays, and with it where somebody types. */
  function edited() {
    finish("the program was changed");
    checks += 1;
    draft.past = [...draft.past.slice(-BACK), before];
    before = JSON.stringify(steps);
    undone.disabled = false;
  }
  /**
   * Steps came, went or moved; `step` is the one where somebody is, at a button of its row.
   * @param {Step | null} step
   */
  function changed(step = null, act = "") {
    edited();
    draw();
    const row = step && shown.get(step);
    if (row) all(row, `[data-act="${act}"]`)[0]?.focus();
  }
  function undo() {
    const last = draft.past.pop();
    if (last === undefined) return;
    finish("the program was changed");
    checks += 1;
    steps = draft.steps = JSON.parse((before = last));
    draw();
    if (undone.disabled) kind.focus();
  }
  function draw() {
    shown.clear();
    const empty = node("li", { class: "arm-note" }, "No steps yet. Choose what the first one does, and add it: it begins with where the arm is now.");
    list.replaceChildren(...(steps.length ? rows(steps, "") : [empty]));
    lock();
  }
  /**
   * @param {Step[]} of
   * @param {string} before
   * @returns {HTMLElement[]}
   */
  function rows(of, before) {
    return of.map((step, i) => row(of, step, i, `${before}${i + 1}`));
  }
  /**
   * @param {Step[]} of
   * @param {Step} step
   * @param {number} i
   * @param {string} number
   */
  function row(of, step, i, number) {
    const nothing = node("li", { class: "arm-note" }, "Nothing yet: drag a step here, or move the one above down.");
    const inner = step.steps && node("ol", { class: "arm-steps", "aria-label": `Steps of ${number}` },
      ...(step.steps.length ? rows(step.steps, `${number}.`) : [nothing]));
    const grip = node("span", { class: "arm-step-number", draggable: "true", title: "Drag to another place" }, number);
    const made = node("li", { "data-step": number },
      node("div", { class: "arm-step" },
        grip, fields(step, edited, { recordings, poses }),
        node("span", { class: "arm-step-acts" },
          button("↑", () => move(of, i, -1), { "aria-label": `Move step ${number} up`, title: "Up", "data-act": "up" }),
          button("↓", () => move(of, i, 1), { "aria-label": `Move step ${number} down`, title: "Down", "data-act": "down" }),
          of === steps ? button("▶", () => run(i), { class: "hw-button arm-small arm-need arm-whole", "aria-label": "Run from here", title: "Run from here" }) : "",
          button("×", () => take(of, i), { "aria-label": `Remove step ${number}`, title: "Remove", "data-act": "remove" }))),
      inner ?? "");
    shown.set(step, made);
    grip.addEventListener("dragstart", (event) => {
      dragged = { of, i, step };
      if (!event.dataTransfer) return;
      event.dataTransfer.setDragImage(made, 0, 0);
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
      if (step.steps && within(event, "ol") !== made.parentElement) step.steps.push(taken);
      else of.splice(of.indexOf(step) + (from === of && at < i ? 1 : 0), 0, taken);
      changed();
    });
    grip.addEventListener("dragend", () => (dragged = null));
    return made;
  }
  /**
   * @param {Step[]} of
   * @param {number} i
   */
  function take(of, i) {
    of.splice(i, 1);
    changed(of[i] ?? of[i - 1] ?? null, "remove");
    if (!steps.length) kind.focus();
  }
  /**
   * Up and down in its list; past a repetition it goes into it, at its end out of it.
   * @param {Step[]} of
   * @param {number} i
   * @param {number} by
   */
  function move(of, i, by) {
    const [step] = of.splice(i, 1);
    const next = of[by < 0 ? i - 1 : i];
    const outer = of === steps ? null : parent(steps, of);
    if (next?.steps && next !== step) next.steps.splice(by < 0 ? next.steps.length : 0, 0, step);
    else if (next) of.splice(i + by, 0, step);
    else if (outer) outer.of.splice(outer.i + (by > 0 ? 1 : 0), 0, step);
    else of.splice(i, 0, step);
    changed(step, by < 0 ? "up" : "down");
  }

  // -- check and run --------------------------------------------------------------------------------

  const rowAt = (/** @type {string} */ number) => all(list, `[data-step="${number}"]`).at(0);
  /** @type {(number: string, level: string) => void} */
  const mark = (number, level) => {
    const found = rowAt(number);
    if (found) found.dataset.level = level;
  };
  /** Whether there is something in it, and in each of its repetitions. */
  function whole() {
    for (const one of all(list, "[data-level]")) delete one.dataset.level;
    const [, empty] = [...shown].find(([step]) => step.steps?.length === 0) ?? [];
    if (empty) empty.dataset.level = "error";
    if (empty || !steps.length) say(empty ? `Step ${empty.dataset.step} repeats nothing.` : "There is no step yet.", "error");
    return !empty && steps.length > 0;
  }
  /** @param {number} first */
  async function check(first) {
    const mine = (checks += 1);
    const told = whole() ? await ask("arm.check_program", { steps, first: first + 1 }) : null;
    if (!told || mine !== checks) return false;
    const refused = told.find(({ refusal }) => refusal);
    if (refused) {
      mark(refused.number, "error");
      say(`Step ${refused.number}: ${refused.refusal}`, "error");
      if (refused.fits !== null) offer(refused.number, refused.fits);
      return false;
    }
    say(`All ${told.length} motions are allowed from here.`);
    return true;
  }
  /**
   * Offer the speed at which a recording is not too fast.
   * @param {string} number
   * @param {number} fits
   */
  function offer(number, fits) {
    note.append(" ", button(`Play it at ${fits} of its speed`, () => {
      const step = stepAt(steps, number);
      if (step && "play" in step) step.factor = fits;
      changed();
      check(0);
    }));
  }
  /** @param {number} first */
  async function run(first) {
    // From here on, so that nothing begins twice, nor after a stop that comes while it is being checked.
    /** @type {ProgramRun} */
    const mine = (running = { ends: page.attend(), over: "", goOn: null });
    lock();
    if (!(await check(first))) {
      running = null;
      lock();
      return;
    }
    const todo = [...unrolled(steps.slice(first), "", first)];
    for (const [number, step] of todo) {
      if (gone(mine)) break;
      mark(number, "now");
      rowAt(number)?.scrollIntoView({ block: "nearest" });
      say(`Step ${number}: ${words(step)}`);
      const why = await done(mine, step);
      mark(number, "");
      if (why !== "arrived") mine.over ||= why;
    }
    if (running !== mine) return;
    running = null;
    lock();
    const over = mine.over;
    if (FINE.includes(over)) say("Ended before its last step.");
    else say(over ? `Ended: ${over}` : "The program has ended.", over ? "error" : "");
  }
  /**
   * Do a step; resolves with "arrived", or why the program does not go on.
   * @param {ProgramRun} mine
   * @param {PlainStep} step
   */
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
      if (document.activeElement === goOn) end.focus({ preventScroll: true });
      goOn.hidden = true;
    } else {
      return page.run(motionOf(step));
    }
    return gone(mine) ? mine.over : "arrived";
  }
  /** @param {ProgramRun} mine */
  function gone(mine) {
    mine.over ||= mine.ends();
    return Boolean(mine.over);
  }
  /** @param {string} why */
  function finish(why) {
    if (!running) return;
    running.over ||= why;
    hexwire.release(why === "ended" ? "ended" : "released");
  }
  function lock() {
    const busy = running !== null;
    // What was pressed cannot be pressed now.
    const pressed = end.hidden === busy && root.contains(document.activeElement);
    end.hidden = !busy;
    const able = page.mine && page.unready === "";
    for (const one of all(root, "button, input, select")) {
      if (one !== end && one !== goOn) one.toggleAttribute("disabled", busy || (one.classList.contains("arm-need") && !able));
    }
    undone.disabled = busy || draft.past.length === 0;
    if (pressed) (busy ? end : start).focus({ preventScroll: true });
  }
  name.addEventListener("input", () => (draft.name = name.value));
  page.on("need", lock);
  name.value = draft.name;
  ask("arm.programs").then(listed);
  draw();
  Promise.all([hexwire.operates ? ask("arm.recordings") : [], ask("arm.poses")]).then(([files, saved]) => {
    recordings = files ?? [];
    poses = (saved ?? []).map((one) => one.name);
    // Whoever is at a step by now stays there; new rows have the lists.
    if (!dragged && !list.contains(document.activeElement)) draw();
  });
}

/** @type {(step: Step, other: Step) => boolean} */
const holds = (step, other) => (step.steps ?? []).some((one) => one === other || holds(one, other));

/**
 * The step with a number such as 3.1.
 * @param {Step[]} steps
 * @param {string} number
 * @returns {Step | undefined}
 */
function stepAt(steps, number) {
  const [place, ...rest] = number.split("."), step = steps[Number(place) - 1];
  return rest.length ? stepAt(step?.steps ?? [], rest.join(".")) : step;
}

/**
 * @param {Step[]} of
 * @param {Step[]} inner
 * @returns {{ of: Step[], i: number } | null}
 */
function parent(of, inner) {
  for (const [i, step] of of.entries()) {
    if (step.steps === inner) return { of, i };
    const found = step.steps && parent(step.steps, inner);
    if (found) return found;
  }
  return null;
}

/**
 * What is done, in its order, with the number of each step; the numbers begin behind `first`.
 * @param {Step[]} steps
 * @param {string} before
 * @returns {Generator<[string, PlainStep]>}
 */
function* unrolled(steps, before, first = 0) {
  for (const [i, step] of steps.entries()) {
    const number = `${before}${first + i + 1}`;
    if (!step.steps) yield [number, step];
    else for (let time = 0; time < step.repeat; time += 1) yield* unrolled(step.steps, `${number}.`);
  }
}

/**
 * A step as the server takes a motion: radians and metres.
 * @param {MoveStep} step
 * @returns {Record<string, unknown>}
 */
function motionOf(step) {
  const speed = step.speed === undefined ? {} : { speed: step.speed };
  if ("pose" in step) return { what: "pose", name: step.pose, ...speed };
  if ("joints" in step) return { what: "joints", goals: Object.fromEntries(Object.entries(step.joints).map(([name, angle]) => [name, radians(angle)])), ...speed };
  if ("grip" in step) return { what: "grip", share: step.grip / 100, ...speed };
  if ("play" in step) {
    const part = { recording: step.play, begin: step.from ?? 0, smooth: step.smooth ?? 0, factor: step.factor ?? 1, fit: Boolean(step.fit) };
    return { what: "play", ...part, ...(step.to === undefined ? {} : { end: step.to }), ...speed };
  }
  const place = { what: "place", position: step.place.map((value) => value / 1000), relative: Boolean(step.relative), straight: Boolean(step.line), ...speed };
  if (step.branch) Object.assign(place, { branch: step.branch });
  if (step.rpy) return { ...place, aim: "rpy", rpy: step.rpy.map(radians) };
  if (step.pitch !== undefined) return { ...place, aim: "pitch", pitch: radians(step.pitch), ...(step.roll === undefined ? {} : { roll: radians(step.roll) }) };
  return { ...place, aim: step.aim ?? "arm" };
}

/**
 * A step of a kind, from where the arm is now.
 * @param {ArmPage} page
 * @param {string} kind
 * @param {string[]} recordings
 * @returns {Step | Refused}
 */
function makeStep(page, kind, recordings) {
  const speed = round(page.speed, 2);
  if (kind === "wait") return { wait: 1 };
  if (kind === "ask") return { ask: "Continue?" };
  if (kind === "repeat") return { repeat: 2, steps: [] };
  if (kind === "pose") return { pose: "home", speed };
  if (kind === "play") return recordings.length ? { play: recordings[0], speed } : { error: "There is no recording yet: teach one, and save it." };
  if (kind === "grip") return { grip: 100, speed };
  const positions = page.positions();
  if (!positions || ![...positions].every(Number.isFinite)) return { error: "Nobody knows where the joints are." };
  const { joints } = page.args;
  if (kind === "joints") return { joints: Object.fromEntries(joints.map(({ name }, i) => [name, round(degrees(positions[i]), 2)])), speed };
  const place = ["x", "y", "z"].map((axis) => Number(page.find(`[data-tip="${axis}"]`)?.textContent?.replace("−", "-")));
  if (!place.every(Number.isFinite)) return { error: "The place of this arm's tip is not known." };
  return { place, ...(kind === "line" ? { line: true } : {}), speed };
}

/** @param {PlainStep} step */
function words(step) {
  if ("pose" in step) return `to ${step.pose}`;
  if ("joints" in step) return "to joint angles";
  if ("place" in step) return `${step.line ? "straight " : ""}${step.relative ? "by" : "to"} ${step.place.join(" ")} mm`;
  if ("grip" in step) return `gripper ${step.grip} % open`;
  if ("play" in step) return step.play;
  return "wait" in step ? `wait ${step.wait} s` : step.ask;
}

/**
 * What of a step can be changed. `edited` is told of each change; of what is chosen, `known` has the names.
 * @param {Step} step
 * @param {() => void} edited
 * @param {{ recordings: string[], poses: string[] }} known
 */
function fields(step, edited, known) {
  /** @type {(Node | string)[]} */
  const parts = [];
  /** @type {<E extends HTMLElement>(made: E, put: (made: E) => unknown) => E} */
  const changes = (made, put) => {
    made.addEventListener("change", () => {
      put(made);
      edited();
    });
    return made;
  };
  /** @type {(label: string, now: string, names: string[][], put: (value: string) => unknown) => HTMLElement} */
  const choice = (label, now, names, put) => {
    // What is not there any more, or is on another computer, stays as it was written.
    const rows = names.some(([value]) => value === now) ? names : [[now, now], ...names];
    return changes(node("select", { "aria-label": label }, ...rows.map(([value, words]) => node("option", { value, selected: value === now }, words))), (made) => put(made.value));
  };
  /**
   * `put` keeps a number within what it may be, and gives what is shown of it.
   * @type {(label: string, value: number, put: (value: number) => number, attributes?: Record<string, number>) => HTMLElement}
   */
  const number = (label, value, put, attributes = {}) =>
    changes(node("input", { "aria-label": label, value: String(value), type: "number", step: "any", class: "arm-number-field", ...attributes }), (made) => {
      if (Number.isFinite(made.valueAsNumber)) value = put(made.valueAsNumber);
      made.value = String(value);
    });
  /** @type {(low: number, high: number, value: number) => number} */
  const between = (low, high, value) => Math.min(high, Math.max(low, value));
  /** @type {(label: string, now: boolean | undefined, put: (so: boolean) => unknown) => HTMLElement} */
  const flag = (label, now, put) => node("label", {}, changes(node("input", { type: "checkbox", checked: Boolean(now) }), (made) => put(made.checked)), ` ${label}`);
  /** @type {(words: string, input: HTMLElement, unit?: string) => HTMLElement} */
  const named = (words, input, unit = "") => node("label", { class: "arm-step-value" }, node("span", { "aria-hidden": "true" }, words), input, unit);
  if ("pose" in step) parts.push("to the pose ", choice("Pose", step.pose, known.poses.map((one) => [one, one]), (value) => (step.pose = value)));
  else if ("joints" in step) {
    parts.push("joints, °: ", ...Object.entries(step.joints).map(([name, angle]) => named(name, number(`${name}, degrees`, angle, (value) => (step.joints[name] = value)))));
  } else if ("place" in step) {
    parts.push("tip, mm: ", ...step.place.map((value, i) => named("xyz"[i], number(`${"xyz"[i]}, millimetres`, value, (typed) => (step.place[i] = typed)))),
      flag("straight", step.line, (so) => (so ? (step.line = true) : delete step.line)), flag("relative", step.relative, (so) => (so ? (step.relative = true) : delete step.relative)));
    if (!step.rpy && step.pitch === undefined) {
      step.aim ??= "arm";
      parts.push(named("tool", choice("The tool", step.aim, AIMS, (value) => (step.aim = value))));
    }
  } else if ("grip" in step) parts.push("gripper ", number("Opening, percent", step.grip, (value) => (step.grip = between(0, 100, value)), { min: 0, max: 100 }), " % open");
  else if ("play" in step) {
    parts.push("play ", choice("Recording", step.play, known.recordings.map((one) => [one, one]), (value) => (step.play = value)),
      named("speed ×", number("Factor of its speed", step.factor ?? 1, (value) => (step.factor = between(0.1, 4, value)), { min: 0.1, max: 4 })));
    if (step.from !== undefined || step.to !== undefined) parts.push(`${step.from ?? 0} to ${step.to ?? "its end"} s`);
    if (step.smooth) parts.push(`smoothed by ${step.smooth} s`);
    if (step.fit) parts.push("slower if too fast");
  } else if ("wait" in step) parts.push("wait ", number("Seconds", step.wait, (value) => (step.wait = between(0, 3600, value)), { min: 0, max: 3600 }), " s");
  else if ("ask" in step) parts.push("wait for me: ", changes(node("input", { "aria-label": "Text", value: step.ask, maxlength: 200 }), (made) => (step.ask = made.value)));
  else parts.push("repeat ", number("Times", step.repeat, (value) => (step.repeat = between(1, 10000, Math.round(value))), { min: 1, max: 10000 }), " times");
  if (step.speed !== undefined) parts.push(named("at", number("Speed, percent of the limits", round(100 * step.speed, 0), (value) => round(100 * (step.speed = between(0.01, 1, value / 100)), 0), { min: 1, max: 100 }), "%"));
  return node("span", { class: "arm-step-fields" }, ...parts);
}
