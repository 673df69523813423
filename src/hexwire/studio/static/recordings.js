// The page Recordings: the list, recording the session, files in and out. recordings_view.js shows one or two of them,
// recordings_play.js plays one.

import hexwire, { all } from "./live.js";
import { ask, save, withQuery } from "./columns.js";
import { loadSheet, node, whyOf } from "./widgets.js";
import { makeView } from "./recordings_view.js";

const LOOK = 1500; // ms between two looks at the list

/**
 * What the parts of the page share. `act` asks, and resolves to undefined after an error was shown, which is `refusal` then.
 * @typedef {{
 *   args: Visitor, state: { list: RecordingList | null, refusal: string }, outdate: () => void,
 *   act: <N extends keyof Calls>(name: N, args?: Calls[N]["args"]) => Promise<Calls[N]["answer"] | undefined>,
 *   entry: (name: string) => Recording | undefined
 * }} RecordingsPage
 */

/**
 * @param {HTMLElement} element
 * @param {Visitor} args
 */
export async function mount(element, args) {
  element.classList.add("pl-page");
  await Promise.all([loadSheet("/static/plots.css"), loadSheet("/static/recordings.css")]);
  if (!element.isConnected) return;
  const none = `No recordings yet.${args.operates ? " Record the arm, add a file, or use hexwire --record FILE.mcap." : ""}`;
  /**
   * @type {{ list: RecordingList | null, chosen: string, rows: Map<string, { key: string, made: HTMLTableRowElement }>, asked: number,
   *   shown: number, outdated: number, looking: number, lost: boolean, refusal: string }}
   */
  const state = { list: null, chosen: "", rows: new Map(), asked: 0, shown: 0, outdated: 0, looking: 0, lost: false, refusal: "" };
  const note = node("p", { class: "pl-note rc-note", role: "status" });
  const record = button("Record the arm", toggleRecord, "rc-record");
  record.disabled = true; // until it is known whether one is being made
  const recording = node("span", { class: "rc-recording" });
  const seen = node("input", { type: "checkbox" });
  const cameras = node("label", { class: "rc-with", hidden: true }, seen, " with cameras");
  const file = node("input", { type: "file", accept: ".mcap", class: "rc-file", id: "rc-file" });
  const add = node("label", { class: "hw-button rc-add", for: "rc-file" }, "Add a file");
  const bar = node("div", { class: "rc-bar" });
  if (args.operates) bar.append(record, cameras, recording, file, add);
  const folder = node("span", { class: "rc-folder" });
  bar.append(folder);
  const remark = node("p", { class: "pl-note rc-remark" });
  const body = node("tbody", {}, empty("Reading the folder …"));
  const table = node("table", { class: "rc-list" },
    node("caption", {}, "Recordings, newest first"),
    node("thead", {}, node("tr", {}, ...["Recording", "Recorded", "Robot", "Duration", "States", "Size", "File", "Actions"].map(
      (text) => node("th", { scope: "col" }, text)))), body);
  const frame = node("div", { class: "rc-scroll" }, table);
  const place = node("div", { class: "rc-view" });
  element.replaceChildren(bar, note, frame, remark, place);
  /** @type {RecordingsPage} */
  const page = { args, state, act, outdate, entry: (name) => state.list?.entries.find((one) => one.name === name) };
  const view = makeView(page, place);

  file.addEventListener("change", upload);
  const timer = setInterval(() => {
    if (!element.isConnected) { clearInterval(timer); view.destroy(); return; }
    // A large folder may take longer than the time between two looks.
    if (!document.hidden && !state.looking) look();
  }, LOOK);
  hexwire.onHello(() => look(), element);
  if (!state.looking) look();

  /** @param {string} text */
  function say(text, bad = false) {
    note.textContent = text;
    note.dataset.level = bad ? "error" : "";
  }

  /** What was asked for until now, and has not come yet, is not true any more. */
  function outdate() { state.outdated = state.asked; }

  /** @returns {Promise<void>} */
  async function look() {
    if (!hexwire.connected) return;
    state.looking += 1;
    const round = ++state.asked;
    try {
      const list = await hexwire.call("recordings");
      if (round <= state.outdated) return await look();
      if (round < state.shown) return;
      state.shown = round;
      state.list = list;
      if (state.lost) say("");
      state.lost = false;
    } catch (error) {
      state.lost = true;
      say(whyOf(error), true);
      return;
    } finally {
      state.looking -= 1;
    }
    draw();
    view.update(state.list);
  }

  /**
   * Ask the server for something. Undefined after an error was shown.
   * @template {keyof Calls} N
   * @param {N} name
   * @param {Calls[N]["args"]} args
   */
  async function act(name, args = {}) {
    say("");
    try {
      const found = await hexwire.call(name, args);
      await look();
      return found;
    } catch (error) {
      outdate();
      state.refusal = whyOf(error);
      say(state.refusal, true);
      return undefined;
    }
  }

  async function toggleRecord() {
    if (!state.list?.recorder.name) await act("recordings.record", { cameras: seen.checked });
    else {
      const ended = await act("recordings.end");
      if (ended !== undefined) say(ended);
    }
  }

  async function upload() {
    const chosen = file.files?.[0];
    file.value = "";
    if (!chosen) return;
    if (state.list && chosen.size > state.list.largest) {
      say(`${chosen.name} is larger than ${sizeText(state.list.largest)}`, true);
      return;
    }
    say(`adding ${chosen.name} …`);
    try {
      const answer = await ask(withQuery("/data/recording", { name: chosen.name }), { method: "POST", body: chosen });
      /** @type {{ name: string, problem: string }} */
      const found = await answer.json();
      say(`${found.name} was added${found.problem ? `: ${found.problem}` : ""}`);
      await look();
      choose(found.name);
    } catch (error) {
      say(`${chosen.name}: ${whyOf(error)}`, true);
    }
  }

  /** @param {string} name */
  function choose(name) {
    state.chosen = name;
    draw();
    view.choose(name);
  }

  function draw() {
    const { list } = state;
    if (!list) return;
    const { recorder } = list;
    record.textContent = recorder.name ? "End the recording" : "Record the arm";
    record.classList.toggle("on", Boolean(recorder.name));
    record.disabled = !recorder.name && !list.robot;
    record.title = record.disabled ? "No arm is open" : "";
    cameras.hidden = Boolean(recorder.name) || !list.cameras.length;
    recording.textContent = recorder.name ? recordingText(recorder) : "";
    folder.textContent = list.folder;
    remark.textContent = list.remark;
    if (!list.entries.length) {
      state.rows.clear();
      if (body.textContent !== none) body.replaceChildren(empty(none));
      return;
    }
    // A row that has not changed stays as it is: a press that has begun on it, and a question there, go on.
    const before = state.rows;
    state.rows = new Map(list.entries.map((one) => {
      const key = JSON.stringify([one, one.name === state.chosen]);
      const old = before.get(one.name);
      return [one.name, old?.key === key ? old : { key, made: row(one) }];
    }));
    const focused = body.contains(document.activeElement) ? document.activeElement?.getAttribute("data-key") : null;
    const wanted = [...state.rows.values()].map((one) => one.made);
    const there = new Set(wanted);
    for (const old of [...body.rows]) if (!there.has(old)) old.remove();
    wanted.forEach((made, i) => { if (body.rows[i] !== made) body.insertBefore(made, body.rows[i] || null); });
    if (focused && document.activeElement?.getAttribute("data-key") !== focused) all(body, `[data-key="${CSS.escape(focused)}"]`)[0]?.focus();
  }

  /** @param {string} text */
  function empty(text) {
    return node("tr", {}, node("td", { colspan: 8, class: "rc-empty" }, text));
  }

  /** @param {Recording} one */
  function row(one) {
    const name = button(one.name, () => choose(one.name), "rc-name", `open ${one.name}`);
    name.setAttribute("aria-pressed", String(one.name === state.chosen));
    const actions = node("td", { class: "rc-actions" });
    actions.append(button("Save", () => save("/data/recording.mcap", { name: one.name }).catch((error) => say(whyOf(error), true)),
      "rc-small", `save ${one.name}`));
    if (args.operates) {
      if (one.recoverable) actions.append(button("Recover", () => recover(one), "rc-small", `recover ${one.name}`));
      const remove = button("Delete", () => sure(remove, one), "rc-small", `delete ${one.name}`);
      actions.append(remove);
    }
    const made = node("tr", { class: one.name === state.chosen ? "chosen" : "" },
      node("th", { scope: "row" }, name),
      cell("recorded", one.begin ? dateText(one.begin) : "–"),
      cell("robot", one.robot || (one.joints.length ? `${one.joints.length} joints` : "–")),
      cell("duration", one.begin ? durationText(one.duration) : "–", true),
      cell("states", String(one.states), true),
      cell("size", sizeText(one.size), true),
      cell("state", stateText(one)), actions);
    const condition = made.cells[6];
    condition.dataset.level = one.problem ? "error" : "";
    condition.classList.add("rc-state");
    return made;
  }

  /** @param {Recording} one */
  async function recover(one) {
    const name = await act("recordings.recover", { name: one.name });
    if (!name) return;
    choose(name);
    say(`the intact part is in ${name}; ${one.name} stays as it is`);
  }

  /**
   * Delete at the second press, within three seconds.
   * @param {HTMLElement} pressed
   * @param {Recording} one
   */
  function sure(pressed, one) {
    if (pressed.dataset.sure) { act("recordings.remove", { name: one.name }).then((found) => found !== undefined && say(`${one.name} was deleted`)); return; }
    pressed.style.minWidth = `${pressed.offsetWidth}px`;
    pressed.dataset.sure = "1";
    pressed.textContent = "Sure?";
    setTimeout(() => { delete pressed.dataset.sure; pressed.textContent = "Delete"; }, 3000);
  }
}

/**
 * @param {string} text
 * @param {() => unknown} act
 */
export function button(text, act, className = "", label = "") {
  const made = node("button", { type: "button", class: `hw-button ${className}` }, text);
  if (label) { made.setAttribute("aria-label", label); made.dataset.key = label; }
  made.addEventListener("click", act);
  return made;
}

/**
 * @param {string} name
 * @param {string} text
 */
function cell(name, text, number = false) {
  return node("td", { class: number ? "number" : "", "data-name": name }, text);
}

/** @param {Recording} one */
function stateText(one) {
  if (!one.problem) return one.states ? "whole" : "whole, without joint states";
  return one.recoverable ? `${one.problem}. Recover it to keep that part.` : one.problem;
}

/** @param {number} seconds */
export function durationText(seconds) {
  if (seconds < 60) return `${seconds.toFixed(1)} s`;
  const minutes = Math.floor(seconds / 60);
  return minutes < 60 ? `${minutes} min ${Math.floor(seconds % 60)} s` : `${Math.floor(minutes / 60)} h ${minutes % 60} min`;
}

/** @param {number} bytes */
function sizeText(bytes) {
  return bytes < 1 << 20 ? `${Math.max(1, Math.round(bytes / 1024))} KiB` : `${(bytes / (1 << 20)).toFixed(1)} MiB`;
}

/**
 * What is being recorded, and how fast the disk fills.
 * @param {Recorder} recorder
 */
function recordingText({ name, seconds, states, pictures, lost, size, problems }) {
  const rate = size && seconds ? `, ${sizeText(size)}, ${sizeText(size / seconds)}/s` : "";
  const seen = pictures ? `, ${pictures} pictures` : "";
  return [`${name}: ${durationText(seconds)}, ${states} states${seen}${lost ? `, ${lost} lost` : ""}${rate}`, ...Object.values(problems)].join("; ");
}

/** @param {number} seconds */
function dateText(seconds) {
  const two = (/** @type {number} */ n) => String(n).padStart(2, "0");
  const d = new Date(1000 * seconds);
  return `${d.getFullYear()}-${two(d.getMonth() + 1)}-${two(d.getDate())} ${two(d.getHours())}:${two(d.getMinutes())}:${two(d.getSeconds())}`;
}
