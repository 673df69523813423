// What the parts of the page Servos share: buttons, fields, tables, live values, and calls about the bus that is shown. Must
// not know what a part shows.

import hexwire, { all, faultsOf } from "./live.js";
import { ask, withQuery } from "./columns.js";
import { html, node, put as write, whyOf } from "./widgets.js";

/**
 * What a cell shows: text, markup, or a number.
 * @typedef {string | number | ReturnType<typeof html>} Cell
 * @typedef {{ name: string, servo: number, i: number }} JointOf
 * @typedef {(view: View, place: HTMLElement, servo: number) => void | Promise<void>} Part
 * @typedef {(view: View, place: HTMLElement, servo: number) => Promise<void>} LatePart
 */

/** @type {Record<Exclude<keyof LiveRow, "id" | "faults" | "error">, number>} */
const DIGITS = { deg: 1, counts: 0, speed: 1, load: 0, volts: 1, celsius: 0, amps: 2 };
/** @type {Record<"position" | "velocity" | "load" | "voltage" | "temperature" | "current", [number, number]>} */
const FRAME = { position: [180 / Math.PI, 1], velocity: [180 / Math.PI, 1], load: [100, 0], voltage: [1, 1], temperature: [1, 0], current: [1, 2] };

/** What a part gets: the servo that is shown, and calls about the bus for which the page was drawn. */
export class View {
  /** @type {number | null} */
  selected = null;
  /** @type {JointOf | null} */
  joint = null;
  /** @type {string[][]} */
  kinds = []; // what the arm's protocol tells of each servo, in the order of its joints
  tell = () => {}; // called when that is known
  part = "";
  /** @type {Map<number, LiveRow>} */
  live = new Map(); // the newest values by id
  /** @type {ServoList} */
  found = { servos: [], elsewhere: [], rates: [], rate: "" };
  redraw = () => {};
  relist = async () => {};

  /** @param {number} opened `facts.opened` of what is shown */
  constructor(opened) {
    this.opened = opened;
  }

  /**
   * Ask; what is refused is told. Resolves to undefined then.
   * @template {keyof Calls} N
   * @param {N} name
   * @param {Calls[N]["args"]} args
   */
  act(name, args = {}) {
    return hexwire.act(name, args, this.opened);
  }

  /**
   * Send a file; what is refused is told. Resolves to undefined then.
   * @template {keyof Sent} W
   * @param {W} what
   * @param {File} file
   * @param {Record<string, string>} values
   * @returns {Promise<Sent[W] | undefined>}
   */
  async send(what, file, values = {}) {
    const address = withQuery(`/servos/${what}`, { tab: hexwire.key, opened: this.opened, ...values });
    try {
      return await (await ask(address, { method: "POST", body: file })).json();
    } catch (error) {
      hexwire.notify(whyOf(error), "error");
      return undefined;
    }
  }

  get servo() {
    return this.found.servos.find((one) => one.id === this.selected);
  }
}

/**
 * What was begun here, and goes on while another part or page is looked at: whoever draws its part again finds it here.
 * @template T, [A=null]
 */
export class Work {
  running = true;

  /**
   * @param {View} view
   * @param {Promise<T | undefined>} over
   * @param {A} about
   */
  constructor(view, over, about) {
    this.opened = view.opened;
    this.about = about;
    this.over = over.finally(() => (this.running = false));
  }
}

/**
 * That at the bus that is shown; what was begun at another one is over.
 * @template {Work<any, any>} W
 * @param {View} view
 * @param {W | null} work
 */
export const workAt = (view, work) => (work?.opened === view.opened ? work : null);

/**
 * A button. `late`: it ends something, so it can always be pressed; `offline`: also while nobody knows how the servos are.
 * @param {string} words
 * @param {(made: HTMLButtonElement) => unknown} act
 * @param {{ level?: string, label?: string, offline?: boolean }} options
 */
export function button(words, act, { level = "", label = "", offline = false } = {}) {
  const made = node("button", { type: "button", class: `hw-button ${level && `hw-${level}`} ${offline ? "sv-offline" : ""}`, "aria-label": label || false }, words);
  made.addEventListener("click", () => act(made));
  return made;
}

let fields = 0;

/**
 * A labelled input or choice.
 * @param {string} words
 * @param {HTMLElement} input
 */
export function field(words, input) {
  input.id = `hw-field-${(fields += 1)}`;
  return node("div", { class: "hw-field" }, node("label", { for: input.id }, words), input);
}

/**
 * Add pairs of value and words to a choice.
 * @param {HTMLSelectElement} select
 * @param {(readonly [string | number, string])[]} rows
 */
export function offer(select, rows) {
  select.append(...rows.map(([value, words]) => new Option(words, String(value))));
  return select;
}

/** @param {(readonly [string | number, string])[]} rows */
export const choice = (rows = []) => offer(node("select"), rows);

/**
 * @param {number} value
 * @param {Record<string, number>} attributes
 */
export function numeric(value, attributes = {}) {
  return node("input", { type: "number", value, step: "any", ...attributes });
}

/**
 * The number in a field; null if there is none.
 * @param {HTMLInputElement} input
 */
export const valueOf = (input) => (input.value.trim() === "" ? null : Number(input.value));

/** @type {(...parts: (Node | string)[]) => HTMLElement} */
export const row = (...parts) => node("div", { class: "hw-row" }, ...parts);
/** @type {(...parts: (Node | string)[]) => HTMLElement} */
export const form = (...parts) => node("div", { class: "sv-form" }, ...parts);
/** @type {(words: string, attributes?: Record<string, string>) => HTMLElement} */
export const hint = (words, attributes = {}) => node("p", { class: "sv-hint", ...attributes }, words);

/**
 * A heading of a part, and a sentence about it.
 * @param {string} words
 */
export function section(words, about = "") {
  return [node("h3", { class: "sv-h3" }, words), ...(about ? [hint(about)] : [])];
}

/**
 * Names and values in two columns.
 * @param {string[][]} rows
 */
export function facts(rows) {
  return node("dl", { class: "sv-facts" }, ...rows.map(([name, value]) => node("div", {}, node("dt", {}, name), node("dd", {}, value))));
}

/**
 * A table as markup: heads, of which those with a `#` are of numbers; rows of cells.
 * @param {string} caption
 * @param {string[]} head
 * @param {Cell[][]} rows
 */
export function table(caption, head, rows) {
  const kind = head.map((name) => (name.startsWith("#") ? "sv-num" : ""));
  return html`<div class="sv-scroll" tabindex="0" role="region" aria-label="${caption}"><table class="sv-table">
    <caption>${caption}</caption>
    <thead><tr>${head.map((name, i) => html`<th scope="col" class="${kind[i]}">${name.replace("#", "")}</th>`)}</tr></thead>
    <tbody>${rows.map(([first, ...rest]) => html`<tr><th scope="row" class="${kind[0]}">${first}</th>${rest.map((cell, i) =>
      html`<td class="${kind[i + 1]}">${cell}</td>`)}</tr>`)}</tbody></table></div>`;
}

/**
 * @param {number | null} value
 * @param {number} digits
 */
export function number(value, digits) {
  return value === null || !Number.isFinite(value) ? "–" : value.toFixed(digits).replace("-", "−");
}

/**
 * @param {HTMLElement} cell
 * @param {string} text
 */
export function put(cell, text, level = "") {
  write(cell, text);
  if (cell.dataset.level !== level) cell.dataset.level = level;
}

/**
 * Fill the cells of an element that have `data-live`, as values come.
 * @param {HTMLElement} element
 */
export function live(element) {
  element.classList.add("hw-live");
  hexwire.onServos(({ rows }) => {
    for (const one of rows) {
      for (const cell of all(element, `[data-live][data-id="${one.id}"]`)) {
        const name = /** @type {keyof typeof DIGITS | "state"} */ (cell.dataset.live);
        if (name === "state") put(cell, one.error ? "silent" : one.faults.join(", ") || "ok", one.error || one.faults.length ? "error" : "ok");
        else put(cell, number(one[name], DIGITS[name]));
      }
    }
  }, element);
}

/**
 * Fill the cells of an element that have `data-frame`, from the states of an arm.
 * @param {HTMLElement} element
 */
export function frames(element) {
  element.classList.add("hw-live");
  let last = 0;
  hexwire.onFrame((frame) => {
    const now = performance.now();
    if (now - last < 200) return;
    last = now;
    for (const cell of all(element, "[data-frame]")) {
      const name = /** @type {keyof typeof FRAME | "flags"} */ (cell.dataset.frame), i = Number(cell.dataset.joint);
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

/**
 * How far what is under way is, until `over`; `told` gets it in words.
 * @template T
 * @param {HTMLProgressElement} bar
 * @param {HTMLElement | null} told
 * @param {Promise<T>} over
 */
export function progress(bar, told, over) {
  bar.hidden = false;
  bar.value = 0;
  const end = hexwire.onFacts(({ job, share }) => {
    if (told && job) put(told, job);
    if (share !== null && share !== undefined) bar.value = share;
  }, bar);
  return over.finally(() => {
    end();
    bar.hidden = true;
  });
}

/**
 * A file that a person chooses. `take` gets it.
 * @param {string} words
 * @param {string} kinds
 * @param {(file: File) => unknown} take
 */
export function chooser(words, kinds, take) {
  const file = node("input", { type: "file", accept: kinds, hidden: true });
  file.addEventListener("change", async () => {
    if (file.files?.length) await take(file.files[0]);
    file.value = "";
  });
  return [file, button(words, () => file.click(), { offline: true })];
}
