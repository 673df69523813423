// Parts of the page Servos that change what a servo keeps: its registers, its id and rate, backups. Owns forms and questions;
// the server says what may be written, and reads it back.

import { dialog, download, question } from "./forms.js";
import hexwire from "./live.js";
import { button, choice, chooser, field, form, hint, numeric, offer, put, row, section, table, valueOf } from "./servos_kit.js";
import { fill, html, node, within } from "./widgets.js";

const LARGEST = 1 << 20; // bytes of a file of backups
/** @type {Choice<string>[]} */
const FILTERS = [
  ["all", "all registers"],
  ["stored", "stored settings"],
  ["factory", "different from the factory"],
  ["backup", "different from the backup"],
  ["live", "live values"],
];
/** @typedef {import("./servos_kit.js").View} View */

const HEAD = ["Register", "#Value", "Unit", "Change", "#Raw", "Range", "#Factory", "#Backup", "Kept", "#At"];

// -- registers ---------------------------------------------------------------------------------------------------

/**
 * The registers of a servo; behind a board, of the joint's servo.
 * @param {View} view
 * @param {HTMLElement} place
 * @param {number} servo
 */
export function registers(view, place, servo) {
  const { joint } = view;
  /** @type {Register[]} */
  let rows = [];
  let reads = 0;
  const shown = choice(FILTERS), find = node("input", { maxlength: 40 });
  const undo = button("Undo", takeBack), body = node("div");
  undo.hidden = true;
  place.append(form(field("Show", shown), field("Find a register", find), button("Read again", read), undo), body);

  function draw() {
    const wanted = find.value.trim().toLowerCase();
    const kept = rows.filter((one) => fits(one, shown.value) && one.name.includes(wanted));
    fill(body, kept.length ? table(`Registers of servo ${servo}`, HEAD, kept.map(cells)) : html`<p class="sv-hint">No such register.</p>`);
  }

  async function read() {
    const mine = (reads += 1);
    const found = await (joint ? view.act("board.registers", { joint: joint.name }) : view.act("registers.read", { servo }));
    // One that was read before something was written may come last.
    if (!found || mine !== reads) return;
    rows = found.rows;
    undo.hidden = !found.undo;
    undo.title = found.undo;
    draw();
  }

  /** @param {Register} one */
  async function edit(one) {
    const typed = await ask(one);
    if (!typed) return;
    const wanted = { register: one.name, ...typed };
    const write = (sure = false) => (joint ? view.act("board.edit", { joint: joint.name, ...wanted, sure }) : view.act("registers.edit", { servo, ...wanted, sure }));
    let made = await write();
    if (made?.question) {
      if (!(await question(`Write ${one.name}`, made.question, "Write it"))) return;
      made = await write(true);
    }
    if (!made) return;
    hexwire.notify(made.told ?? "", "ok");
    read();
  }

  async function takeBack() {
    const undone = await view.act(joint ? "board.undo" : "registers.undo");
    if (undone === undefined) return;
    hexwire.notify(undone, "ok");
    read();
  }

  shown.addEventListener("change", draw);
  find.addEventListener("input", draw);
  body.addEventListener("click", (event) => {
    const pressed = within(event, "[data-register]"), one = rows.find(({ name }) => name === pressed?.dataset.register);
    if (one) edit(one);
  });
  read();
}

/**
 * @param {Register} one
 * @param {string} shown
 */
export function fits(one, shown) {
  if (shown === "stored") return one.stored;
  if (shown === "live") return one.kept === "until power-off";
  return shown === "all" || one.differs.includes(shown);
}

/** Units as on every page. */
const inWords = (/** @type {string} */ text) => text.replace("deg", "°");

/** @param {Register} one */
export function cells(one) {
  const words = [one.note, one.words].filter(Boolean).join("; ");
  const marked = (/** @type {"factory" | "backup"} */ name) => (one.differs.includes(name) ? html`<mark title="different">${inWords(one[name])} ≠</mark>` : inWords(one[name]));
  return [
    html`<span title="${words}">${one.name}</span>${one.words && html`<span class="sv-note">${words}</span>`}`,
    one.value,
    inWords(one.unit),
    one.why_not
      ? html`<span class="sv-why" title="${one.why_not}" tabindex="0" role="note" aria-label="${one.why_not}">–</span>`
      : html`<button type="button" class="hw-button sv-small" data-register="${one.name}" aria-label="Edit ${one.name}">Edit</button>`,
    one.raw, one.range, marked("factory"), marked("backup"), one.kept, one.address,
  ];
}

/**
 * Ask for a value: what was typed, and whether it is raw; null if it was cancelled.
 * @param {Register} one
 */
function ask(one) {
  const unit = choice([...(one.unit ? [/** @type {const} */ (["unit", inWords(one.unit)])] : []), ["raw", "raw count"]]);
  const text = node("input", { maxlength: 40, autofocus: true });
  const told = hint("");
  const tell = () => {
    const raw = unit.value === "raw";
    const now = raw ? one.raw : one.exact, limits = raw ? one.raw_range : one.exact_range;
    put(told, `now ${now}${limits && `; ${limits.replace("…", "to")}`}; ${one.stored ? "stored in the servo" : "forgotten at power-off"}`);
    text.value = now;
  };
  unit.addEventListener("change", tell);
  tell();
  const parts = [...(one.note ? [hint(one.note)] : []), field("Unit", unit), field(`New value of ${one.name}`, text), told];
  return dialog(`Edit ${one.name}`, parts, "Check and write", "accent", () => ({ text: text.value, raw: unit.value === "raw" }));
}

// -- id and rate -------------------------------------------------------------------------------------------------

/** @type {import("./servos_kit.js").LatePart} */
export async function identity(view, place, servo) {
  place.append(...section("Id and rate", "The id is changed first, then the rate. Each is read back, and goes back if the servo does not answer. If this is interrupted, the servo has its old or its new address, and is found there again."));
  const id = numeric(servo, { min: 0, max: 253, step: 1 }), rate = choice();
  const go = button("Change", change, { level: "accent" });
  const again = button("Look for it again", look);
  const steps = node("ol", { class: "sv-steps", "aria-live": "polite" });
  again.hidden = true;
  place.append(form(field("New id", id), field("New rate", rate), go), steps, again);
  hexwire.onSteps(({ rows }) => steps.replaceChildren(...rows.map((words) => node("li", {}, words))), steps);
  const found = await view.act("identity.rates", { servo });
  if (!found) return;
  const here = found.here;
  offer(rate, found.rates);
  if (found.rates.some(([baud]) => baud === here)) rate.value = String(here);
  let wanted = { id: servo, baud: here };

  async function change() {
    const number = valueOf(id);
    if (number === null || !Number.isInteger(number)) return hexwire.notify("an id is a whole number from 0 to 253", "error");
    wanted = { id: number, baud: Number(rate.value) || here };
    const what = [];
    if (wanted.id !== servo) what.push(`Servo ${servo} becomes servo ${wanted.id}. An arm that expects servo ${servo} misses it.`);
    if (wanted.baud !== here) what.push(`It answers at ${wanted.baud} baud only; the other servos stay at ${here}.`);
    if (!what.length) return hexwire.notify("nothing to change");
    if (!(await question("Change the servo's address", [...what, "Both are stored."].join("\n"), "Change it"))) return;
    steps.replaceChildren();
    again.hidden = go.hidden = true;
    const told = await view.act("identity.change", { servo, new_id: wanted.id, new_baud: wanted.baud });
    go.hidden = false;
    again.hidden = told !== undefined;
    if (told !== undefined) follow(wanted.id, told);
  }

  async function look() {
    const back = await view.act("identity.look", { ids: [servo, wanted.id], bauds: [here, wanted.baud] });
    if (back) follow(back.servo, back.told);
    else place.append(hint("Switch its supply off and on, then look again."));
  }

  /**
   * @param {number} number
   * @param {string} told
   */
  async function follow(number, told) {
    hexwire.notify(told, "ok");
    view.selected = number;
    await view.relist();
    view.redraw();
  }
}

// -- backup ------------------------------------------------------------------------------------------------------

/** @type {import("./servos_kit.js").Part} */
export function backup(view, place, servo) {
  const list = node("div");
  let looks = 0;
  const undo = button("Undo the restore", takeBack);
  undo.hidden = true;
  place.append(
    ...section("Backup", `Stored settings of all servos here, except their ids and rates, can be compared and restored later.${
      view.joint ? " The board writes them in maintenance, while no joint has torque." : ""}`),
    row(
      button("Back up all servos", () => take(null), { level: "accent" }),
      ...(view.joint ? [] : [button(`Back up servo ${servo}`, () => take([servo]))]),
      ...chooser("Load a backup", ".json,application/json", load), undo),
    list);

  async function takeBack() {
    const undone = await view.act("board.undo");
    if (undone === undefined) return;
    undo.hidden = true;
    hexwire.notify(undone, "ok");
    show();
  }

  /** @param {number[] | null} servos */
  async function take(servos) {
    const made = await (view.joint ? view.act("board.backup") : view.act("backup.take", { servos }));
    if (!made) return;
    kept(made.servos);
    download("servos.json", made.file);
  }

  /** @param {File} file */
  async function load(file) {
    if (file.size > LARGEST) return hexwire.notify("the file is larger than 1 MiB", "error");
    const found = await view.send("backup", file);
    if (found) kept(found.servos);
  }

  /** @param {number[]} servos */
  function kept(servos) {
    hexwire.notify(`a backup of servo ${servos.join(", ")}`, "ok");
    show();
  }

  async function show() {
    const mine = (looks += 1);
    const found = await view.act(view.joint ? "board.differences" : "backup.differences");
    if (!found || mine !== looks) return;
    if (!found.length) list.replaceChildren(hint("No backup was taken or loaded here."));
    else list.replaceChildren(...found.flatMap(one));
  }

  /** @param {Compared} compared */
  function one({ servo: id, title, differences }) {
    const head = node("h4", { class: "sv-h4" }, title);
    if (!differences) return [head, hint("This servo is not here.")];
    if (!differences.length) return [head, hint("No differences.")];
    const rows = differences.map(([name, here, there]) => [name, here ?? "–", there ?? "–"]);
    const names = differences.filter(([, , there]) => there !== null).map(([name]) => name).join(", ");
    const restore = async () => {
      const text = `These stored settings are overwritten: ${names}.\nId and rate stay. Each is read back.`;
      if (!(await question(`Restore servo ${id}`, text, "Restore"))) return;
      const changed = await view.act(view.joint ? "board.restore" : "backup.restore", { servo: id });
      if (!changed) return;
      undo.hidden = !view.joint || !changed.length;
      hexwire.notify(`restored: ${changed.join(", ") || "nothing to change"}`, "ok");
      show();
    };
    const cells = fill(node("div"), table(`Differences of servo ${id}`, ["Register", "#Servo", "#Backup"], rows));
    return [head, cells, button(`Restore servo ${id}`, restore, { level: "danger" })];
  }

  show();
}
