// What the parts of the page Servos share: buttons, fields, tables, live values, and calls about the bus that is shown. Must
// not know what a part shows.

import hexwire, { faultsOf } from "./live.js";
import { ask, withQuery } from "./columns.js";
import { html, node, put as write } from "./widgets.js";

const DIGITS = { deg: 1, counts: 0, speed: 1, load: 0, volts: 1, celsius: 0, amps: 2 };
const FRAME = { position: [180 / Math.PI, 1], velocity: [180 / Math.PI, 1], load: [100, 0], voltage: [1, 1], temperature: [1, 0], current: [1, 2] };

/** What a part gets: the servo that is shown, and calls about the bus for which the page was drawn. */
export class View {
  constructor(opened) {
    this.opened = opened;
    this.selected = null;
    this.joint = null; // name and place of the joint, of a servo of an arm
    this.kinds = []; // what the arm's protocol tells of each servo, in the order of its joints
    this.tell = () => {}; // called when that is known
    this.part = "";
    this.live = new Map(); // the newest values by id
    this.found = { servos: [], elsewhere: [], rates: [], rate: "" };
    this.redraw = () => {};
    this.relist = () => {};
  }

  /** Ask; what is refused is told. Resolves to undefined then. */
  act(name, args = {}) {
    return hexwire.act(name, args, this.opened);
  }

  /** Send a file; what is refused is told. Resolves to undefined then. */
  async send(what, file, values = {}) {
    const address = withQuery(`/servos/${what}`, { tab: hexwire.key, opened: this.opened, ...values });
    try {
      return await (await ask(address, { method: "POST", body: file })).json();
    } catch (error) {
      return hexwire.notify(error.message, "error");
    }
  }

  get servo() {
    return this.found.servos.find((one) => one.id === this.selected);
  }

  /** Fill a choice with the pairs of value and words that the studio names. */
  async choices(select, name, values, args = {}) {
    const found = await this.act(name, args);
    if (found) select.append(...found[values].map(([value, words]) => new Option(words, value)));
    return found;
  }
}

/** A button. `late`: it ends something, so it can always be pressed; `offline`: also while nobody knows how the servos are. */
export function button(words, act, { level = "", label = "", offline = false } = {}) {
  const made = node("button", { type: "button", class: `hw-button ${level && `hw-${level}`} ${offline ? "sv-offline" : ""}`, "aria-label": label || false }, words);
  made.addEventListener("click", () => act(made));
  return made;
}

let fields = 0;

/** A labelled input or choice. */
export function field(words, input) {
  input.id = `hw-field-${(fields += 1)}`;
  return node("div", { class: "hw-field" }, node("label", { for: input.id }, words), input);
}

export function choice(rows = []) {
  const made = node("select");
  made.append(...rows.map(([value, words]) => new Option(words, value)));
  return made;
}

export function numeric(value, attributes = {}) {
  return node("input", { type: "number", value, step: "any", ...attributes });
}

/** The number in a field; null if there is none. */
export const valueOf = (input) => (input.value.trim() === "" ? null : Number(input.value));

export const row = (...parts) => node("div", { class: "hw-row" }, ...parts);
export const form = (...parts) => node("div", { class: "sv-form" }, ...parts);
export const hint = (words, attributes = {}) => node("p", { class: "sv-hint", ...attributes }, words);

/** A heading of a part, and a sentence about it. */
export function section(words, about = "", level = "h3") {
  return [node(level, { class: "sv-h3" }, words), ...(about ? [hint(about)] : [])];
}

/** Names and values in two columns. */
export function facts(rows) {
  return node("dl", { class: "sv-facts" }, ...rows.map(([name, value]) => node("div", {}, node("dt", {}, name), node("dd", {}, value))));
}

/** A table as markup: heads, of which those with a `#` are of numbers; rows of cells. */
export function table(caption, head, rows) {
  const kind = head.map((name) => (name.startsWith("#") ? "sv-num" : ""));
  return html`<div class="sv-scroll" tabindex="0" role="region" aria-label="${caption}"><table class="sv-table">
    <caption>${caption}</caption>
    <thead><tr>${head.map((name, i) => html`<th scope="col" class="${kind[i]}">${name.replace("#", "")}</th>`)}</tr></thead>
    <tbody>${rows.map(([first, ...rest]) => html`<tr><th scope="row" class="${kind[0]}">${first}</th>${rest.map((cell, i) =>
      html`<td class="${kind[i + 1]}">${cell}</td>`)}</tr>`)}</tbody></table></div>`;
}

export function number(value, digits) {
  return value === null || !Number.isFinite(value) ? "–" : value.toFixed(digits).replace("-", "−");
}

export function put(cell, text, level = "") {
  write(cell, text);
  if (cell.dataset.level !== level) cell.dataset.level = level;
}

/** Fill the cells of an element that have `data-live`, as values come. */
export function live(element) {
  element.classList.add("hw-live");
  hexwire.onServos(({ rows }) => {
    for (const one of rows) {
      for (const cell of element.querySelectorAll(`[data-live][data-id="${one.id}"]`)) {
        const name = cell.dataset.live;
        if (name === "state") put(cell, one.error ? "silent" : one.faults.join(", ") || "ok", one.error || one.faults.length ? "error" : "ok");
        else put(cell, number(one[name], DIGITS[name]));
      }
    }
  }, element);
}

/** Fill the cells of an element that have `data-frame`, from the states of an arm. */
export function frames(element) {
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

/** How far what is under way is, until `over`; `told` gets it in words. */
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

/** A file that a person chooses. `take` gets it. */
export function chooser(words, kinds, take) {
  const file = node("input", { type: "file", accept: kinds, hidden: true });
  file.addEventListener("change", async () => {
    if (file.files.length) await take(file.files[0]);
    file.value = "";
  });
  return [file, button(words, () => file.click(), { offline: true })];
}
