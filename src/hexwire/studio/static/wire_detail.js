// One frame: its bytes, and the tree of its layers and fields. Pick a byte and see its field, pick a field and see its
// bytes, by mouse or by keyboard.

import { BAD, PROBLEM, REQUEST, SENT, SIZE, TEXT, TIME, asText, clock } from "./wire_list.js";
import { node, put, within } from "./widgets.js";

const SELECT = "Select a frame in the list to see its bytes and fields here.";
const WIDTH = 16;
const MOST_PARTS = 1500;
const MOST_BYTES = 8192;
/** @type {Record<string, string>} */
const LAYERS = { "session header": "session", "command frame": "command", body: "body", "servo packet": "servo" };

/** @type {Set<string>} */
const closed = new Set(); // names of the parts that the user has folded, in every frame

/**
 * A part in the tree; `within` are those that it consists of, as far as they are shown.
 * @typedef {WirePart & { level: number, parent: Piece | null, index: number, layer: string, item: HTMLElement, shown: boolean, within: Piece[] }} Piece
 */

// Scrolls an item of a box into sight, and nothing around the box.
/**
 * @param {HTMLElement} box
 * @param {HTMLElement | undefined} item
 */
function reveal(box, item) {
  if (!item || box.scrollHeight <= box.clientHeight) return;
  const outer = box.getBoundingClientRect();
  const inner = item.getBoundingClientRect();
  if (inner.top < outer.top) box.scrollTop -= outer.top - inner.top;
  else if (inner.bottom > outer.bottom) box.scrollTop += inner.bottom - outer.bottom;
}

export class Detail {
  /** @type {WireFrame | null} */
  data = null;
  /** @type {Piece | null} */
  chosen = null;
  /** @type {Piece[]} */
  parts = [];
  /** @type {HTMLElement[]} */
  cells = []; // of the bytes
  byte = 0;
  offset = 0;

  /**
   * @param {HTMLElement} element
   * @param {{ onSelect: (number: number) => void, onClose: () => void }} told
   */
  constructor(element, { onSelect, onClose }) {
    this.onSelect = onSelect;
    this.head = node("div", { class: "hw-wire-head", role: "status" });
    this.bytes = node("div", { class: "hw-wire-bytes", tabindex: 0, role: "listbox", "aria-label": "Bytes of the frame" });
    this.info = node("div", { class: "hw-wire-info", "aria-live": "polite" });
    this.tree = node("div", { class: "hw-wire-tree", tabindex: 0, role: "tree", "aria-label": "Layers and fields of the frame" });
    this.copyButton = node("button", { type: "button", class: "hw-button", onclick: () => this.copy() }, "Copy");
    element.append(
      node("div", { class: "hw-wire-tools" },
        this.copyButton,
        node("button", { type: "button", class: "hw-button", onclick: onClose }, "Close")),
      this.head, this.bytes, this.info, this.tree,
    );
    this.bytes.addEventListener("keydown", (event) => this.byteKey(event));
    this.tree.addEventListener("keydown", (event) => this.treeKey(event));
    for (const box of [this.bytes, this.tree]) {
      box.addEventListener("pointerover", (event) => this.hover(event));
      box.addEventListener("pointerleave", () => this.mark(this.chosen));
      box.addEventListener("click", (event) => this.click(event));
    }
    this.clear();
  }

  clear(text = SELECT) {
    this.data = null;
    this.chosen = null;
    this.head.replaceChildren(text);
    for (const box of [this.bytes, this.tree]) {
      box.replaceChildren();
      box.hidden = true;
      box.removeAttribute("aria-activedescendant");
    }
    this.info.hidden = true;
  }

  /**
   * @param {WireFrame} data
   * @param {number} offset
   */
  show(data, offset) {
    const before = this.chosen && this.chosen.start;
    this.data = data;
    this.offset = offset;
    this.parts = [];
    this.collect(data.tree, 1, null);
    this.bytes.hidden = this.tree.hidden = this.info.hidden = false;
    this.showHead(data, offset);
    this.showBytes(data.hex);
    this.showTree();
    // The field at the same place, so that one can step through frames and compare it.
    const kept = before !== null && before < data.row[SIZE] ? this.leaf(before) : null;
    const first = this.parts.find((part) => part.name === "cmd" || part.name === "instruction" || part.name === "error");
    const wrong = this.parts.find((part) => part.problem && !part.parts);
    this.choose(wrong || kept || first || this.parts[0], { scroll: false });
    reveal(this.tree, this.chosen?.item);
    reveal(this.bytes, this.cells[this.byte]);
  }

  /**
   * @param {WirePart} part
   * @param {number} level
   * @param {Piece | null} parent
   */
  collect(part, level, parent) {
    if (this.parts.length >= MOST_PARTS) return;
    const layer = LAYERS[part.name] || parent?.layer || "";
    /** @type {Piece} */
    const piece = { ...part, level, parent, index: this.parts.length, layer, item: node("div", { class: "hw-wire-part" }), shown: false, within: [] };
    this.parts.push(piece);
    parent?.within.push(piece);
    for (const child of part.parts || []) this.collect(child, level + 1, piece);
  }

  /** @param {number} at */
  leaf(at) {
    return this.parts.findLast((part) => part.start <= at && at < part.end) || this.parts[0];
  }

  /**
   * @param {WireFrame} data
   * @param {number} offset
   */
  showHead(data, offset) {
    const row = data.row;
    const when = row[TIME] ? ` ${clock(row[TIME], offset)}` : "";
    const words = `Frame ${data.number}, ${row[SENT] ? "sent" : "received"}${when}, ${row[SIZE]} bytes. `;
    this.head.replaceChildren(words);
    /** @type {(number: number, text: string) => void} */
    const pair = (number, text) => {
      this.head.append(node("button", { type: "button", class: "hw-wire-link", onclick: () => this.onSelect(number) }, text), " ");
    };
    const after = data.took === null ? "" : ` after ${data.took.toFixed(2)} ms`;
    if (row[REQUEST]) pair(row[REQUEST], `Answers ${row[REQUEST]}${after}`);
    if (data.answered) pair(data.answered, `Answered by ${data.answered}${after}`);
    const told = row[PROBLEM] && row[TEXT].includes(row[PROBLEM]);
    this.head.append(node("div", { class: `hw-wire-text-of${told ? (row[BAD] ? " hw-wire-error" : " hw-wire-warning") : ""}` }, row[TEXT]));
    if (row[PROBLEM] && !told) this.head.append(node("div", { class: row[BAD] ? "hw-wire-error" : "hw-wire-warning" }, row[PROBLEM]));
  }

  /** @param {string} hex */
  showBytes(hex) {
    const size = Math.min(hex.length / 2, MOST_BYTES);
    const boxes = document.createDocumentFragment();
    this.cells = [];
    for (let i = 0; i < size; i += 1) {
      if (i % WIDTH === 0) {
        boxes.append(node("span", { class: "hw-wire-place", "aria-hidden": "true" }, i.toString(16).padStart(4, "0")));
      }
      const cell = node("span", { class: "hw-wire-byte" }, hex.slice(2 * i, 2 * i + 2).toUpperCase());
      const leaf = this.leaf(i);
      cell.id = `hw-wire-byte-${i}`;
      cell.dataset.at = String(i);
      cell.dataset.layer = leaf.layer;
      if (leaf.problem) cell.dataset.problem = "yes";
      cell.setAttribute("role", "option");
      cell.setAttribute("aria-label", `byte ${i}: ${cell.textContent}, ${leaf.name}`);
      this.cells.push(cell);
      boxes.append(cell);
    }
    this.bytes.replaceChildren(boxes);
  }

  showTree() {
    const boxes = document.createDocumentFragment();
    for (const part of this.parts) {
      const { item } = part;
      item.id = `hw-wire-part-${part.index}`;
      item.dataset.index = String(part.index);
      item.dataset.layer = part.layer;
      item.setAttribute("role", "treeitem");
      item.setAttribute("aria-level", String(part.level));
      item.style.setProperty("--level", String(part.level - 1));
      if (part.problem) item.classList.add("hw-wire-wrong");
      const place = part.end - part.start === 1 ? `${part.start}` : `${part.start}–${part.end - 1}`;
      item.append(
        node("span", { class: "hw-wire-fold" }),
        node("span", { class: "hw-wire-name" }, part.name),
        node("span", { class: "hw-wire-words" }, part.words || ""),
        node("span", { class: "hw-wire-range" }, place),
      );
      boxes.append(item);
    }
    if (this.parts.length >= MOST_PARTS) boxes.append(node("div", { class: "hw-wire-note" }, "More fields follow; see the bytes."));
    this.tree.replaceChildren(boxes);
    this.fold();
  }

  fold() {
    for (const part of this.parts) {
      part.shown = !part.parent || (part.parent.shown && !closed.has(part.parent.name));
      part.item.hidden = !part.shown;
      if (part.parts) {
        part.item.setAttribute("aria-expanded", closed.has(part.name) ? "false" : "true");
        put(part.item.children[0], closed.has(part.name) ? "▸" : "▾");
      }
    }
  }

  /**
   * What is copied of the frame from the element with the focus; empty if that is none of its.
   * @param {EventTarget | null} from
   */
  copied(from) {
    if (from === this.bytes) return this.hex();
    return from === this.tree && this.chosen ? `${this.chosen.name}  ${this.chosen.words || ""}`.trim() : "";
  }

  hex() {
    return (this.data?.hex.match(/../g) || []).join(" ").toUpperCase();
  }

  /** Copy the frame, also where the page is not from this computer: there is no navigator.clipboard without TLS. */
  copy() {
    if (!this.data) return;
    const text = `${asText(this.data.row, this.offset)}\n${this.hex()}`;
    const give = (/** @type {ClipboardEvent} */ event) => {
      event.clipboardData?.setData("text/plain", text);
      event.preventDefault();
    };
    document.addEventListener("copy", give, { once: true });
    put(this.copyButton, document.execCommand("copy") ? "Copied" : "Not copied");
    setTimeout(() => put(this.copyButton, "Copy"), 2000);
  }

  // -- choosing ------------------------------------------------------------------------------------------

  /** @param {Event} event */
  hover(event) {
    const part = this.partAt(event);
    if (part) this.mark(part);
  }

  /** @param {Event} event */
  click(event) {
    const part = this.partAt(event);
    if (!part) return;
    if (part.parts && within(event, ".hw-wire-fold")) this.toggle(part);
    this.byte = Number(within(event, ".hw-wire-byte")?.dataset.at ?? part.start);
    this.choose(part);
  }

  /**
   * The part of the byte, or the part itself, from which an event came.
   * @param {Event} event
   */
  partAt(event) {
    const byte = within(event, ".hw-wire-byte"), part = within(event, ".hw-wire-part");
    return byte ? this.leaf(Number(byte.dataset.at)) : part && this.parts[Number(part.dataset.index)];
  }

  /** @param {Piece} part */
  toggle(part, so = !closed.has(part.name)) {
    if (so) closed.add(part.name);
    else closed.delete(part.name);
    this.fold();
  }

  /** @param {Piece} part */
  choose(part, { scroll = true } = {}) {
    this.chosen?.item.removeAttribute("aria-selected");
    this.chosen = part;
    if (this.byte < part.start || this.byte >= part.end) this.byte = part.start;
    for (let above = part.parent; above; above = above.parent) closed.delete(above.name);
    this.fold();
    part.item.setAttribute("aria-selected", "true");
    this.tree.setAttribute("aria-activedescendant", part.item.id);
    this.bytes.setAttribute("aria-activedescendant", `hw-wire-byte-${this.byte}`);
    if (scroll) {
      reveal(this.tree, part.item);
      reveal(this.bytes, this.cells[this.byte]);
    }
    this.mark(part);
  }

  // Shows which bytes and which item belong together, for what is chosen or under the pointer.
  /** @param {Piece | null} part */
  mark(part) {
    const { chosen } = this;
    if (!part || !chosen || !this.data) return;
    for (let i = 0; i < this.cells.length; i += 1) {
      const classes = this.cells[i].classList;
      classes.toggle("hw-wire-on", part.start <= i && i < part.end);
      classes.toggle("hw-wire-chosen", chosen.start <= i && i < chosen.end);
      classes.toggle("hw-wire-cursor", i === this.byte);
    }
    for (const each of this.parts) each.item.classList.toggle("hw-wire-on", each === part);
    chosen.item.classList.add("hw-wire-chosen");
    for (const each of this.parts) if (each !== chosen) each.item.classList.remove("hw-wire-chosen");
    const place = part.end - part.start === 1 ? `byte ${part.start}` : `bytes ${part.start} to ${part.end - 1}`;
    const lines = [node("strong", {}, `${part.name}, ${place}`)];
    if (part.words) lines[0].append(node("span", { class: "hw-wire-value" }, part.words));
    this.bytes.classList.toggle("hw-wire-wide", Boolean(part.parts));
    if (part.meaning) lines.push(node("div", {}, part.meaning));
    if (part.problem) lines.push(node("div", { class: "hw-wire-error" }, part.problem));
    this.info.replaceChildren(...lines);
  }

  /** @param {KeyboardEvent} event */
  byteKey(event) {
    const columns = getComputedStyle(this.bytes).gridTemplateColumns.split(" ").length;
    const width = columns - (columns % 8); // 8 or 16 of them are bytes
    /** @type {Record<string, number>} */
    const steps = { ArrowRight: 1, ArrowLeft: -1, ArrowDown: width, ArrowUp: -width, Home: -Infinity, End: Infinity };
    if (!(event.key in steps) || !this.data || event.altKey || event.ctrlKey || event.metaKey) return;
    event.preventDefault();
    this.byte = Math.min(this.cells.length - 1, Math.max(0, this.byte + steps[event.key]));
    this.choose(this.leaf(this.byte));
  }

  /** @param {KeyboardEvent} event */
  treeKey(event) {
    const { chosen } = this;
    if (!this.data || !chosen || event.altKey || event.ctrlKey || event.metaKey) return;
    const shown = this.parts.filter((part) => part.shown);
    const at = shown.indexOf(chosen);
    /** @type {Record<string, number>} */
    const steps = { ArrowDown: 1, ArrowUp: -1, Home: -Infinity, End: Infinity };
    if (event.key in steps) {
      this.choose(shown[Math.min(shown.length - 1, Math.max(0, at + steps[event.key]))]);
    } else if (event.key === "ArrowLeft") {
      if (chosen.parts && !closed.has(chosen.name)) this.toggle(chosen, true);
      else if (chosen.parent) this.choose(chosen.parent);
    } else if (event.key === "ArrowRight" && chosen.parts) {
      if (closed.has(chosen.name)) this.toggle(chosen, false);
      else if (chosen.within.length) this.choose(chosen.within[0]);
    } else {
      return;
    }
    event.preventDefault();
  }
}
