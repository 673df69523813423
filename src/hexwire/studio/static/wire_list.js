// The list of frames: any number of rows, of which only the visible ones are elements. A batch of rows is drawn once,
// in the next frame of the browser. The style says how high a row is: a finger needs more than a mouse.

import { node, put, within } from "./widgets.js";

const MANY = 500; // rows that are dropped at a time
const AIMING = 500; // ms after the last move of a mouse over the list in which it stays
const SPARE = 8; // rows above and below what is visible

// Places in a row, as traffic.py writes it.
export const NUMBER = 0, TIME = 1, SENT = 2, KIND = 3, SIZE = 4, TEXT = 5, PROBLEM = 6, BAD = 7, REQUEST = 8, TOOK = 9;

// The frame itself has them; here they hide what changes.
const DULL = /time_us \d+, fields \d+, |, joints \d+, spare 0|count \d+ (?=\()/g;
const OF_SERVO = /\(servo_id (\d+), position /g;
const REPORT = /^2 \w+ report /; // what a board sends by itself, again and again

/**
 * @param {number} seconds
 * @param {number} offset
 */
export function clock(seconds, offset) {
  if (!seconds) return "–";
  const at = seconds + offset;
  if (at < 1e8) return `${at.toFixed(6)} s`;
  const date = new Date(at * 1000);
  const two = (/** @type {number} */ value) => String(value).padStart(2, "0");
  const milli = String(date.getMilliseconds()).padStart(3, "0");
  return `${two(date.getHours())}:${two(date.getMinutes())}:${two(date.getSeconds())}.${milli}`;
}

/**
 * A row as a line of text.
 * @param {WireRow} row
 * @param {number} offset
 */
export const asText = (row, offset) =>
  [row[NUMBER], clock(row[TIME], offset), row[SENT] ? "sent" : "received", row[TEXT], row[PROBLEM]].filter(Boolean).join("  ");

/**
 * The element of a row, the cells in it, and what they show.
 * @typedef {{ element: HTMLElement, cells: HTMLElement[], key: string }} Line
 */

export class FrameList {
  /** @type {WireRow[]} */
  rows = [];
  /** @type {Set<number>} */
  partners = new Set();
  /** @type {Map<number, number>} */
  answers = new Map(); // by request
  /** @type {Line[]} */
  pool = [];

  /**
   * @param {HTMLElement} element
   * @param {{ onSelect: (number: number) => void, onFollow: (follow: boolean) => void }} told
   */
  constructor(element, { onSelect, onFollow }) {
    this.element = element;
    this.onSelect = onSelect;
    this.onFollow = onFollow;
    this.offset = 0;
    this.selected = 0;
    this.follow = true; // what the person wants: only the box ticks it, and scrolling back unticks it
    this.live = true; // a file does not go on
    this.height = 22; // of a row, px
    this.placed = 0; // where the list was put last, not by the person
    this.grown = false; // rows have come since it was put there
    this.held = false; // by the mouse on its bar or by a key: only then, or by a finger, scrolling says what the person wants
    this.touched = false; // by a finger, under which the list must not move
    this.aimed = -Infinity; // when a mouse was moved over it last: what it aims at must not move away
    this.oldest = 0; // number that the studio has still
    this.asked = false;
    this.inner = document.createElement("div");
    this.inner.className = "hw-wire-inner";
    this.inner.setAttribute("role", "presentation");
    element.append(this.inner);
    element.addEventListener("scroll", () => this.scrolled());
    // The list may have moved on between press and release: what was pressed counts.
    /** @type {string | undefined} */
    let pressed;
    const at = (/** @type {Event} */ event) => within(event, ".hw-wire-row")?.dataset.number;
    element.addEventListener("pointerdown", (event) => (pressed = at(event)));
    element.addEventListener("click", (event) => {
      const number = pressed || at(event);
      pressed = undefined;
      if (number) this.select(Number(number));
    });
    element.addEventListener("keydown", (event) => this.key(event));
    element.addEventListener("wheel", (event) => this.wheel(event), { passive: true });
    const hold = (/** @type {string} */ until) => {
      this.held = true;
      window.addEventListener(until, () => (this.held = false), { once: true });
    };
    element.addEventListener("pointermove", (event) => {
      if (event.pointerType === "mouse") this.aimed = performance.now();
    });
    for (const name of ["touchstart", "touchend", "touchcancel"]) {
      element.addEventListener(name, (event) => {
        this.scrolled();
        this.touched = /** @type {TouchEvent} */ (event).touches.length > 0;
      }, { passive: true });
    }
    element.addEventListener("keydown", () => hold("keyup"));
    element.addEventListener("pointerdown", (event) => {
      if (event.target === element || event.button === 1) hold("pointerup");
    });
    new ResizeObserver(() => this.resize()).observe(element);
  }

  clear() {
    this.rows = [];
    for (const line of this.pool) line.key = "";
    this.answers.clear();
    this.selected = 0;
    this.partners.clear();
    this.element.scrollTop = this.placed = 0;
    this.draw();
  }

  /**
   * @param {WireRow[]} rows
   * @param {[number, number][]} answers that are not among the rows, after their requests
   * @param {number} oldest
   */
  push(rows, answers, oldest) {
    this.oldest = oldest;
    for (const [request, answer] of answers) this.answers.set(request, answer);
    if (!rows.length && !answers.length) return;
    for (const row of rows) {
      this.rows.push(row);
      if (row[REQUEST]) this.answers.set(row[REQUEST], row[NUMBER]);
    }
    const old = this.rows.length - this.kept;
    if (old >= MANY) {
      const gone = this.rows.splice(0, old);
      for (const row of gone) this.answers.delete(row[NUMBER]);
      const above = gone.length * this.height;
      if (!this.goesOn || this.touched) this.element.scrollTop -= above;
      this.placed -= above;
    }
    this.grown = rows.length > 0 || this.grown;
    this.draw();
  }

  /** How many of the rows the studio has still. */
  get kept() {
    return this.rows.length - this.place(this.oldest);
  }

  // The place of a number, or of the first one after it.
  /** @param {number} number */
  place(number) {
    let low = 0;
    let high = this.rows.length;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (this.rows[middle][NUMBER] < number) low = middle + 1;
      else high = middle;
    }
    return low;
  }

  /** @param {number} number */
  find(number) {
    const row = this.rows[this.place(number)];
    return row && row[NUMBER] === number ? row : null;
  }

  /** @param {number} number */
  select(number, { quiet = false } = {}) {
    const place = this.place(number);
    const row = this.rows[place];
    this.selected = number;
    this.partners = new Set();
    if (row && row[NUMBER] === number) {
      if (row[REQUEST]) this.partners.add(row[REQUEST]);
      const answer = this.answers.get(number);
      if (answer) this.partners.add(answer);
      this.reveal(place);
    }
    this.draw();
    if (!quiet) this.onSelect(number);
  }

  /** @param {number} place */
  reveal(place) {
    const { element, height } = this;
    const under = (place + 1) * height - element.clientHeight;
    element.scrollTop = Math.min(place * height, Math.max(under, element.scrollTop));
  }

  /** Show what is nearest to the selected frame, among other rows than before. */
  revealSelected() {
    if (this.selected) this.reveal(Math.min(this.rows.length - 1, this.place(this.selected)));
  }

  /** The list has another size, perhaps also its rows. What is looked at stays in sight. */
  resize() {
    const height = parseFloat(getComputedStyle(this.element).getPropertyValue("--row")) || this.height;
    const first = this.element.scrollTop / this.height;
    if (height !== this.height) for (const line of this.pool) line.key = "";
    this.height = height;
    this.inner.style.height = `${this.rows.length * height}px`;
    this.element.scrollTop = this.placed = first * height;
    const place = this.place(this.selected);
    if (this.find(this.selected)) for (const near of [place - 1, place + 1, place]) this.reveal(near);
    else this.grown = true;
    this.draw();
  }

  /** @param {KeyboardEvent} event */
  key(event) {
    const page = Math.max(1, Math.floor(this.element.clientHeight / this.height) - 1);
    /** @type {Record<string, number>} */
    const steps = { ArrowDown: 1, ArrowUp: -1, PageDown: page, PageUp: -page, Home: -Infinity, End: Infinity };
    if (!(event.key in steps) || !this.rows.length || event.altKey || event.ctrlKey || event.metaKey) return;
    event.preventDefault();
    const known = this.selected && this.find(this.selected);
    const from = known ? this.place(this.selected) : this.rows.length - 1;
    const oldest = Math.min(this.rows.length - 1, this.place(this.oldest));
    const to = Math.min(this.rows.length - 1, Math.max(oldest, known ? from + steps[event.key] : from));
    if (to < this.rows.length - 1) this.setFollow(false);
    this.select(this.rows[to][NUMBER]);
  }

  /** @param {WheelEvent} event */
  wheel(event) {
    const { scrollHeight, clientHeight } = this.element;
    if (event.deltaY < 0 && scrollHeight > clientHeight) this.setFollow(false);
  }

  scrolled() {
    if ((this.held || this.touched) && this.element.scrollTop < this.placed - this.height / 2) this.setFollow(false);
    this.draw();
  }

  /** @param {boolean} follow */
  setFollow(follow) {
    if (follow === this.follow) return;
    this.follow = this.grown = follow;
    this.onFollow(follow);
    this.draw();
  }

  /** Whether it goes along with new rows: it stays where a frame is read, and under a mouse that aims. */
  get goesOn() {
    return this.follow && this.live && !this.selected && performance.now() - this.aimed > AIMING;
  }

  draw() {
    if (this.asked) return;
    this.asked = true;
    requestAnimationFrame(() => {
      this.asked = false;
      this.paint();
    });
  }

  paint() {
    const { element, inner, rows, height } = this;
    const whole = `${rows.length * height}px`;
    if (inner.style.height !== whole) inner.style.height = whole;
    if (!this.touched) {
      if (this.goesOn && this.grown) element.scrollTop = rows.length * height;
      this.grown = false;
      this.placed = element.scrollTop;
    }
    const first = Math.max(0, Math.floor(element.scrollTop / height) - SPARE);
    const seen = Math.min(element.clientHeight, window.innerHeight); // however tall the list is without its style
    const last = Math.min(rows.length, Math.ceil((element.scrollTop + seen) / height) + SPARE);
    // A row keeps its element while it is in sight, so that little changes when new ones come.
    while (this.pool.length < last - first) this.pool.push(this.line());
    const size = this.pool.length;
    for (let i = first; i < last; i += 1) this.fill(this.pool[i % size], rows[i], i);
    for (let i = last; i < first + size; i += 1) {
      const line = this.pool[i % size];
      if (!line.element.hidden) line.element.hidden = true;
      line.key = "";
    }
    if (this.selected && document.getElementById(`hw-wire-${this.selected}`)) {
      element.setAttribute("aria-activedescendant", `hw-wire-${this.selected}`);
    } else {
      element.removeAttribute("aria-activedescendant");
    }
  }

  /** @returns {Line} */
  line() {
    const cells = ["number", "time", "way", "text", "took"].map((name) => node("span", { class: `hw-wire-${name}` }));
    const element = node("div", { role: "option", "aria-setsize": "-1" }, ...cells);
    this.inner.append(element);
    return { element, cells, key: "" };
  }

  /**
   * @param {Line} line
   * @param {WireRow} row
   * @param {number} place
   */
  fill(line, row, place) {
    const number = row[NUMBER];
    const selected = number === this.selected;
    const answer = this.answers.get(number);
    const partner = this.partners.has(number);
    const key = `${number} ${place} ${selected} ${partner} ${answer ?? ""}`;
    if (line.key === key) return;
    line.key = key;
    const { element, cells: [numberCell, time, way, text, took] } = line;
    const report = REPORT.test(row[TEXT]) ? " hw-wire-report" : "";
    const level = row[BAD] ? " hw-wire-bad" : row[PROBLEM] ? " hw-wire-doubt" : "";
    element.className = `hw-wire-row${report}${level}${selected ? " hw-wire-selected" : ""}${partner ? " hw-wire-partner" : ""}`;
    element.hidden = false;
    element.id = `hw-wire-${number}`;
    element.dataset.number = String(number);
    element.style.transform = `translateY(${place * this.height}px)`;
    element.setAttribute("aria-selected", selected ? "true" : "false");
    element.setAttribute("aria-posinset", String(place + 1));
    put(numberCell, String(number));
    put(time, clock(row[TIME], this.offset));
    put(way, row[SENT] ? "→" : "←");
    way.title = row[SENT] ? "sent" : "received";
    put(text, row[TEXT].replace(DULL, "").replace(OF_SERVO, "($1: "));
    text.title = row[PROBLEM] || row[TEXT];
    const ms = row[TOOK];
    put(took, ms !== null ? `${ms.toFixed(2)} ms` : answer ? `▸${answer}` : "");
  }
}
