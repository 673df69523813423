// The page Servos: a list at the left, one servo at the right; on a phone one below the other. Owns the order of the parts,
// the search and the lists: of a bus, or of an arm that is open, whose protocol tells of its servos. Must not know what a servo may do.

import { question } from "./forms.js";
import hexwire, { all, required } from "./live.js";
import { backup, identity, registers } from "./servos_settings.js";
import { health, ofJoint, overview, stress, wave } from "./servos_checks.js";
import { calibration, setUp } from "./servos_calibration.js";
import { View, Work, button, choice, field, form, frames, hint, live, offer, progress, put, row, table, workAt } from "./servos_kit.js";
import { fill, html, loadSheet, node, tabs, within } from "./widgets.js";

/** @type {Record<string, [string, import("./servos_kit.js").Part]>} */
const PARTS = {
  overview: ["Overview", overview],
  joint: ["Overview", ofJoint],
  registers: ["Registers", registers],
  identity: ["Id and rate", identity],
  middle: ["Calibration", calibration],
  wave: ["Wave", wave],
  health: ["Health", health],
  stress: ["Stress test", stress],
  backup: ["Backup", backup],
  whole_arm: ["Set up an arm", setUp],
};

/** @type {Work<number> | null} */
let searched = null; // the last search

/**
 * @param {HTMLElement} element
 * @param {Visitor} visitor
 */
export async function mount(element, { operates }) {
  await loadSheet("/static/servos.css");
  element.classList.add("sv-page");
  let shown = "";
  hexwire.onFacts((facts) => {
    const now = `${facts.mode} ${facts.opened}`;
    if (now === shown) return;
    shown = now;
    // A place of its own: what comes late about what was open before is drawn nowhere.
    const place = node("div");
    element.replaceChildren(place);
    if (facts.mode === "bus") workbench(place, facts);
    else if (facts.mode === "arm") board(place, facts);
    else closed(place, facts, operates);
  }, element);
}

// -- nothing, or an arm ------------------------------------------------------------------------------------------

/**
 * Nothing is open: offer to open a bus.
 * @param {HTMLElement} element
 * @param {Facts} facts
 * @param {boolean} operates
 */
async function closed(element, facts, operates) {
  element.append(node("p", { class: "sv-hint" }, "Nothing is open. Open the adapter of a servo bus here, or an arm on ", node("a", { href: "/" }, "Arms"), "."));
  const warning = hint("");
  // What could not be opened as an arm may be a bus of servos that are none yet.
  const url = node("input", { value: facts.refused, maxlength: 200 });
  const address = field("Port or address of the adapter", url);
  address.classList.add("sv-address");
  element.append(warning, form(address));
  // Both at once: this part of the page is gone as soon as the bus is open.
  const start = () => url.value.trim() && hexwire.act("open_bus", { url: url.value });
  if (operates) address.after(button("Open the servo bus", start, { level: "accent" }));
  const known = await hexwire.call("ports.known").catch(() => null);
  if (known) put(warning, `If a controller board is there instead: ${known.warning}.`);
}

/**
 * The servos of an arm that is open, laid out as those of a bus; and the way to the bare servos.
 * @param {HTMLElement} element
 * @param {Facts} facts
 */
async function board(element, facts) {
  const view = new View(facts.opened);
  const found = await view.act("board.servos");
  if (!found || !element.isConnected) return;
  const { left, right } = columns(element);
  const list = node("div", { class: "sv-list" }), more = node("div");
  fill(list, table("Servos of the arm", ["Joint", "#°", "#V", "#°C", "State"], found.joints.map(({ name, servo }, i) => [
    html`<button type="button" class="sv-pick" aria-label="${name}, servo ${servo}">${name}</button>
      <span class="sv-chip">servo ${servo}<span data-told="${i}"></span></span>`,
    ...["position", "voltage", "temperature", "flags"].map((each) => html`<span data-frame="${each}" data-joint="${i}">–</span>`),
  ])));
  frames(list);
  const picks = all(list, ".sv-pick");
  /** @type {(i: number, words: string, level: string) => void} */
  const tell = (i, words, level) => put(required(list, `[data-told="${i}"]`), `, ${words}`, level);
  const select = (/** @type {number} */ at, shows = true) => {
    view.joint = { ...found.joints[at], i: at };
    view.selected = view.joint.servo;
    picks.forEach((pick, i) => pick.setAttribute("aria-pressed", String(i === at)));
    view.redraw();
    if (shows) reveal(right);
  };
  picks.forEach((pick, i) => pick.addEventListener("click", () => select(i)));
  const ask = async () => {
    const report = await view.act("board.ask");
    if (!report) return;
    report.servos.forEach(([, , series, present], i) => tell(i, present === "yes" ? series : present, present === "yes" ? "" : "error"));
    view.kinds = report.servos;
    view.tell();
    fill(more, html`${report.firmware && html`<p class="sv-hint">${report.firmware}</p>`}
      <details class="sv-details"><summary>Details: counters that are not 0</summary>${table("Counters", ["Counter", "#Count"], report.counters)}</details>`);
  };
  const ping = async () => {
    const answers = await view.act("board.ping");
    answers?.forEach(([, , words], i) => tell(i, `ping: ${words}`, words === "ok" ? "ok" : "error"));
  };
  left.append(node("h2", { class: "sv-h2" }, "Servos"), list, row(button("Ask again", ask), button("Ping every servo", ping)), more);
  if (found.bare) {
    const switchOver = async () => {
      const text = "The arm is closed: motions end, joints with torque keep it and hold where they are.\nSTOP then reaches the servos directly.";
      if (await question("Work at the servos", text, "Close the arm, open its servos", "accent")) view.act("open_bus");
    };
    left.append(hint("The arm is open as a whole. Registers, ids, rates, calibration and waves need its servos one by one: this closes the arm, and joints with torque hold where they are."),
      button("Work at the servos", switchOver, { level: "accent" }));
  } else {
    left.append(hint("A board answers for the servos. Registers are read through it at any time, and written while no joint has torque; ids and rates need an adapter on the servo bus itself."));
  }
  const kept = !found.bare && hexwire.operates;
  buildParts(view, right, kept ? ["joint", "registers", "health", "backup"] : ["joint", "health"]);
  select(0, false);
  ask();
}

/** @param {HTMLElement} element */
function columns(element) {
  const left = node("section", { class: "sv-left", "aria-label": "Servos found" });
  const right = node("section", { class: "sv-right", "aria-label": "One servo" });
  const both = node("div", { class: "sv-columns" }, left, right);
  element.append(both);
  return { left, right, both };
}

/**
 * On a phone the chosen servo is below the list: go there.
 * @param {HTMLElement} right
 */
function reveal(right) {
  if (matchMedia("(max-width: 800px)").matches) right.scrollIntoView();
}

// -- a bus -------------------------------------------------------------------------------------------------------

/**
 * @param {HTMLElement} element
 * @param {Facts} facts
 */
async function workbench(element, facts) {
  const view = new View(facts.opened);
  const { left, right, both } = columns(element);
  buildSearch(view, left, right);
  buildParts(view, right, Object.keys(PARTS).filter((name) => name !== "joint"));
  silenced(both);
  hexwire.onServos(({ rows }) => rows.forEach((one) => view.live.set(one.id, one)), both);
  const close = async () => {
    if (await question("Close the servo bus", "Servos with torque keep it and hold where they are.", "Close it", "accent")) view.act("close");
  };
  left.append(button("Close the servo bus", close));
  await view.relist();
  view.redraw();
}

/**
 * What needs a servo to answer cannot be pressed while nobody knows how the servos are.
 * @param {HTMLElement} page
 */
function silenced(page) {
  const mark = () => {
    const unknown = hexwire.facts?.mode === "bus" && !hexwire.known;
    for (const each of all(page, ".sv-right .hw-button:not(.sv-offline)")) {
      if (each.inert !== unknown) each.inert = unknown;
    }
  };
  // Parts come and go.
  new MutationObserver(mark).observe(page, { childList: true, subtree: true });
  hexwire.onFacts(mark, page);
}

/**
 * @param {View} view
 * @param {HTMLElement} left
 * @param {HTMLElement} right
 */
function buildSearch(view, left, right) {
  const rate = choice(), ids = node("input", { value: "0-253", maxlength: 60 });
  const start = button("Search", search, { level: "accent" });
  const cancel = button("Cancel", () => view.act("servos.cancel"), { offline: true });
  const bar = node("progress", { class: "sv-progress", max: 1, "aria-label": "Progress of the search", hidden: true });
  const told = node("p", { class: "sv-hint sv-status", role: "status" });
  const doing = node("p", { class: "sv-doing" });
  const list = node("div", { class: "sv-list" });
  cancel.hidden = true;
  left.append(node("h2", { class: "sv-h2" }, "Search"), form(field("Rates", rate), field("Ids", ids), start, cancel),
    node("div", { class: "sv-progress-place" }, bar), told, doing, list);
  live(list);
  // Its own search is told of beside its bar.
  hexwire.onFacts((facts) => put(doing, (start.hidden ? "" : facts.job) || ""), doing);

  const before = workAt(view, searched);
  if (before?.running) follow(before);

  function search() {
    follow(searched = new Work(view, view.act("servos.search", { rate: Number(rate.value), ids: ids.value }), null));
  }

  /**
   * Show a search that goes on, and then how many servos it has found.
   * @param {NonNullable<typeof searched>} work
   */
  async function follow(work) {
    start.hidden = true;
    cancel.hidden = false;
    const found = await progress(bar, told, work.over);
    start.hidden = false;
    cancel.hidden = true;
    put(told, found === undefined ? "" : found ? `${found} servo${found === 1 ? "" : "s"} found` : "no servo answers: check power, cable and rate");
    if (found === undefined) return;
    await view.relist();
    view.redraw();
  }

  let lists = 0;
  view.relist = async () => {
    const mine = (lists += 1);
    const found = await view.act("servos.list");
    if (!found || mine !== lists) return;
    view.found = found;
    const usable = found.servos.filter((one) => one.usable).map((one) => one.id);
    if (view.selected === null || !usable.includes(view.selected)) view.selected = usable[0] ?? null;
    if (!rate.options.length) offer(rate, found.rates);
    fill(list, listMarkup(view));
  };
  list.addEventListener("click", async (event) => {
    const pressed = within(event, "[data-do]");
    if (!pressed) return;
    const value = Number(pressed.dataset.value);
    if (pressed.dataset.do === "select") {
      view.selected = value;
      fill(list, listMarkup(view));
      required(list, `[data-value="${value}"]`).focus();
    } else if ((await view.act("servos.rate", { baud: value })) === undefined) return;
    else await view.relist();
    view.redraw();
    if (pressed.dataset.do === "select") reveal(right);
  });
}

/** @param {Pick<View, "found" | "selected">} view */
export function listMarkup({ found, selected }) {
  /** @type {(id: number, name: string) => ReturnType<typeof html>} */
  const cell = (id, name) => html`<span data-live="${name}" data-id="${id}">–</span>`;
  const rows = found.servos.map(({ id, usable, model, more, level, remarks }) => {
    const words = remarks.map(({ text }) => text).join("; ") || "nothing known against it";
    return [
      usable ? html`<button type="button" class="sv-pick" data-do="select" data-value="${id}" aria-pressed="${String(id === selected)}"
        aria-label="Servo ${id}">${id}</button>` : id,
      // One that cannot be chosen says why in its row.
      html`${model}<span class="sv-chip">${more}</span>${!usable && html`<span class="sv-note" data-level="${level}">${words}</span>`}`,
      ...["deg", "volts", "celsius"].map((name) => cell(id, name)),
      html`<span class="sv-mark" data-level="${level}" title="${words}" role="img" aria-label="${words}">${{ error: "!", warn: "i", ok: "✓" }[level]}</span>
        <span class="sv-state" data-live="state" data-id="${id}"></span>`,
    ];
  });
  return html`${rows.length > 0 && table(`Servos at ${found.rate}`, ["Id", "Model", "#°", "#V", "#°C", "State"], rows)}
    ${!rows.length && !found.elsewhere.length && html`<p class="sv-hint">No servo is known yet. Take control, then search.</p>`}
    ${found.elsewhere.map(([baud, ids]) => html`<p class="sv-hint">At ${baud} baud: ${ids.join(", ")}
      <button type="button" class="hw-button" data-do="rate" data-value="${baud}">Work at ${baud} baud</button></p>`)}`;
}

/**
 * @param {View} view
 * @param {HTMLElement} right
 * @param {string[]} names
 */
function buildParts(view, right, names) {
  [view.part] = names;
  const body = node("div", { class: "sv-part", role: "tabpanel", tabindex: "0" });
  const parts = tabs("Parts", Object.fromEntries(names.map((name) => [name, PARTS[name][0]])), (name) => {
    view.part = name;
    // A place of its own: what comes late for the part of before is drawn nowhere.
    const place = node("div");
    body.replaceChildren(place);
    const [, part] = PARTS[view.part];
    if (part === setUp) setUp(view, place);
    else if (view.selected === null) place.append(hint("Search servos first, then choose one."));
    else {
      place.append(node("h2", { class: "sv-h2" }, view.joint ? `${view.joint.name}, servo ${view.selected}` : `Servo ${view.selected}`));
      part(view, place, view.selected);
    }
  });
  view.redraw = () => parts.show(view.part);
  right.append(parts.row, body);
}
