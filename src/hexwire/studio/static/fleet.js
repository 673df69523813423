// The part of the page Arms about all arms: what is open here and all shared arms that the studio may see, and their stop.
// Owns the table; the server decides who may stop and open, and says what has become of a stop.

import hexwire, { all } from "./live.js";
import { ask, withQuery } from "./columns.js";
import { go } from "./studio.js";
import { node, put, whyOf } from "./widgets.js";

const PERIOD = 150; // ms between two looks: what is old is grey within a second
const OLD = 750; // ms after an answer
const HEAD = ["Arm", "State", "Faults", "Control", "Torque", "Age, ms", "Robot", "Computer", ""];

/**
 * `bar` gets the stop of all arms and what became of it, `root` the arms.
 * @param {HTMLElement} bar
 * @param {HTMLElement} root
 * @param {Visitor} args
 */
export function mountFleet(bar, root, args) {
  new FleetPage(bar, root, args.tab, args.operates);
}

/**
 * @param {FleetArm} arm
 * @returns {[string, Level]}
 */
function condition(arm) {
  if (arm.silent) return [`no answer: ${arm.why}`, "error"];
  if (arm.stopped) return [arm.why ? `stopped: ${arm.why}` : "stopped", "warn"];
  return arm.why ? [arm.why, "warn"] : ["ok", "ok"];
}

class FleetPage {
  /** @type {Map<string, HTMLTableRowElement>} */
  rows = new Map();
  told = -Infinity; // when the studio told of the arms last
  timer = 0;
  asking = false;

  /**
   * @param {HTMLElement} bar
   * @param {HTMLElement} root
   * @param {string} tab
   * @param {boolean} operate
   */
  constructor(bar, root, tab, operate) {
    this.root = root;
    this.tab = tab;
    this.operate = operate;
    this.body = node("tbody");
    this.stopAll = node("button", { type: "button", class: "hw-button hw-fleet-all", onclick: () => this.stop(null) }, "Stop all arms");
    this.summary = node("span", { role: "status" }, "Looking for arms ...");
    this.note = node("p", { class: "hw-fleet-note", hidden: true });
    this.problem = node("p", { class: "hw-fleet-error", role: "alert", hidden: true });
    this.refusal = node("p", { class: "hw-fleet-error", role: "alert", hidden: true });
    this.results = node("ul", { class: "hw-fleet-results", "aria-live": "assertive", "aria-label": "Results of the last stop" });
    this.table = node("table", { class: "hw-fleet-table", hidden: true },
      node("thead", {}, node("tr", {}, ...HEAD.map((text) => node("th", { scope: "col" }, text || node("span", { class: "hw-hidden" }, "Actions"))))),
      this.body);
    // What is told has a place of its own: no button must move by it.
    bar.replaceChildren(this.stopAll, node("div", { class: "hw-fleet-told" }, this.summary, this.results, this.refusal, this.problem));
    root.replaceChildren(
      node("div", { class: "hw-fleet-scroll" }, this.table),
      this.note);
    const seen = () => (this.root.isConnected ? this.poll() : document.removeEventListener("visibilitychange", seen));
    document.addEventListener("visibilitychange", seen);
    this.poll();
    // A studio that hangs says nothing: what it said before is old.
    const watch = setInterval(() => {
      if (!this.root.isConnected) clearInterval(watch);
      else if (performance.now() - this.told > OLD) for (const row of this.rows.values()) row.classList.add("hw-fleet-old");
    }, PERIOD);
  }

  /**
   * By HTTP: it needs no socket, and waits for nothing else that this page asks for.
   * @param {Record<string, string>} values
   * @returns {Promise<{ line: string, confirmed: boolean }[]>}
   */
  async askStop(values) {
    return (await ask(withQuery("/fleet/stop", { tab: this.tab, ...values }), { method: "POST" })).json();
  }

  async poll() {
    clearTimeout(this.timer);
    if (!this.root.isConnected || document.hidden || this.asking) return;
    if (hexwire.connected) {
      this.asking = true;
      try {
        this.show(await hexwire.call("fleet.arms"));
        this.told = performance.now();
      } catch (error) {
        if (hexwire.connected) this.fail(whyOf(error));
      }
      this.asking = false;
    }
    this.timer = setTimeout(() => this.poll(), PERIOD);
  }

  /** @param {Calls["fleet.arms"]["answer"]} found */
  show(found) {
    this.fail(found.error);
    const gone = found.gone.length ? `; gone: ${found.gone.join(", ")}` : "";
    const count = found.arms.length === 1 ? "1 arm" : `${found.arms.length} arms`;
    const where = found.router ? `, also behind ${found.router}` : " on this machine";
    put(this.summary, found.error ? "" : found.looking ? "Looking for arms ..." : `${count}${where}${gone}`);
    put(this.note, found.note);
    this.note.hidden = !found.note;
    this.table.hidden = !found.arms.length;
    const there = new Set(found.arms.map((arm) => arm.name));
    for (const [name, row] of this.rows) {
      if (!there.has(name)) {
        row.remove();
        this.rows.delete(name);
      }
    }
    found.arms.forEach((arm, place) => {
      const row = this.row(arm);
      this.fill(row, arm);
      if (this.body.children[place] !== row) this.body.insertBefore(row, this.body.children[place] || null);
    });
  }

  /** @param {FleetArm} arm */
  row({ name, own }) {
    let row = this.rows.get(name);
    if (!row) {
      const buttons = node("td", { class: "hw-fleet-buttons" },
        node("button", { type: "button", class: "hw-button hw-fleet-stop", "aria-label": `Stop ${name}`, onclick: () => this.stop(name, own) }, "Stop"));
      if (own) buttons.append(node("span", { class: "hw-dim hw-fleet-own" }, "open here"));
      else if (this.operate) {
        /** @type {HTMLButtonElement} */
        const open = node("button", { type: "button", class: "hw-button", "aria-label": `Open ${name} in this studio`, onclick: () => this.open(name, open) }, "Open");
        buttons.append(open);
      }
      const cells = HEAD.slice(1, -1).map((label) => node("td", { "data-label": label }));
      row = node("tr", {}, node("th", { scope: "row" }, name), ...cells, buttons);
      this.rows.set(name, row);
    }
    return row;
  }

  /**
   * @param {HTMLTableRowElement} row
   * @param {FleetArm} arm
   */
  fill(row, arm) {
    const [words, level] = condition(arm);
    const age = arm.age === null ? "–" : (1000 * arm.age).toFixed(0);
    const texts = [words, arm.faults || (arm.silent ? "–" : "none"), arm.holder || "nobody", arm.torque || "–", age, arm.robot || "–", arm.host || "–"];
    texts.forEach((text, i) => put(row.cells[i + 1], text));
    row.classList.toggle("hw-fleet-old", !arm.known);
    row.cells[1].dataset.level = level;
    row.cells[2].dataset.level = arm.faults ? "error" : "";
  }

  /** @param {string} text */
  fail(text) {
    put(this.problem, text);
    this.problem.hidden = !text;
  }

  /** @param {string | null} name null: of all arms */
  async stop(name, own = false) {
    const told = name || "all arms";
    // What another stop has come to may still be on its way: it has a place of its own.
    const mine = node("li", { "data-under-way": true }, `Stopping ${told} ...`);
    this.results.replaceChildren(mine, ...all(this.results, "[data-under-way]"));
    try {
      const done = await this.askStop(own ? { own: "1" } : name ? { name } : { all: "1" });
      if (!done.length) throw new Error("it is not open any more");
      mine.replaceWith(...done.map((row) => {
        const more = row.confirmed ? "" : ". Switch its power off if it may move.";
        return node("li", { "data-level": row.confirmed ? "ok" : "error" }, row.line + more);
      }));
    } catch (error) {
      mine.replaceWith(node("li", { "data-level": "error" }, `${told}: NOT CONFIRMED: ${whyOf(error)}`));
    }
    this.poll();
  }

  /**
   * @param {string} name
   * @param {HTMLButtonElement} button what was pressed
   */
  async open(name, button) {
    button.disabled = true;
    this.refusal.hidden = true;
    try {
      await hexwire.call("fleet.open", { name });
      if (this.root.isConnected) go("/move");
    } catch (error) {
      put(this.refusal, `${name} is not open here: ${whyOf(error)}`);
      this.refusal.hidden = false;
    }
    button.disabled = false;
  }
}
