// Parts of the page Servos about a whole arm: the middle of a servo and the calibration by hand, and setting an arm up servo by
// servo. Owns forms, questions and the table of ranges; the server measures, says what comes next, and stores.

import { download, question } from "./forms.js";
import hexwire, { all } from "./live.js";
import { Work, button, choice, chooser, facts, field, form, hint, number, offer, put, row, section, table, workAt } from "./servos_kit.js";
import { fill, html, node } from "./widgets.js";

const LARGEST = 256 * 1024; // bytes of a file

/** @type {Work<Calibration, { arm: string, how: string, needsMiddle: boolean }> | null} */
let calibrated = null; // the last calibration, measured or loaded
/** @type {Work<SetUp, { arm: string, role: string }> | null} */
let looked = null; // the last look of a set-up

/** @type {import("./servos_kit.js").LatePart} */
export async function calibration(view, place, servo) {
  const middle = async () => {
    const counted = view.live.get(servo)?.counts ?? null;
    const here = counted === null ? "" : ` It reports ${counted} counts now.`;
    const text = `All positions of servo ${servo} are counted anew from here; this is stored.${here}`;
    if (!(await question("Set the middle", text, "This is the middle"))) return;
    const counts = await view.act("servos.middle", { servo });
    if (counts !== undefined) hexwire.notify(`servo ${servo} reports ${counts} here now`, "ok");
  };
  const arm = choice();
  const begin = button("Begin: torque off", start, { level: "accent" });
  const mark = button("Joints without stops are in their middle", markMiddle);
  const finish = button("Finish", () => view.act("calibration.finish"), { level: "accent" });
  const cancel = button("Cancel", () => view.act("servos.cancel"), { offline: true });
  const [file, pick] = chooser("Load a calibration", ".toml,.json", load);
  const ranges = node("div"), result = node("div");
  place.append(
    ...section("Middle", "The present position of the servo becomes the middle of its turn. Nothing moves; its torque must be off."),
    button(`Set the middle of servo ${servo} here`, middle),
    ...section("Calibration by hand", "Without torque, move every joint to both of its ends; the table says what is missing. Offsets and limits can then be stored in the servos, and the calibration saved to a file, also for LeRobot. In place of measuring, a file of either kind can be loaded."),
    form(field("Arm", arm), begin, mark, finish, cancel, file, pick), ranges, result);
  const buttons = (/** @type {boolean} */ running, needsMiddle = false) => {
    begin.hidden = pick.hidden = running;
    finish.hidden = cancel.hidden = !running;
    mark.hidden = !running || !needsMiddle;
  };
  buttons(false);
  hexwire.onRange(({ rows }) => showRanges(ranges, rows), ranges);
  const found = await view.act("calibration.arms");
  if (found) offer(arm, found.arms).value = found.likely;
  const before = workAt(view, calibrated);
  if (before) follow(before);

  async function start() {
    if (!(await question("Torque off", "All joints lose their torque, and the arm sinks. Hold it.", "I hold it: torque off"))) return;
    result.replaceChildren();
    const needsMiddle = await view.act("calibration.begin", { arm: arm.value });
    if (needsMiddle === undefined) return;
    follow(calibrated = new Work(view, view.act("calibration.work"), { arm: arm.value, how: "Calibrated", needsMiddle }));
  }

  /**
   * Show a calibration that goes on, and then what came of it.
   * @param {NonNullable<typeof calibrated>} work
   */
  async function follow(work) {
    const { about } = work;
    arm.value = about.arm;
    buttons(work.running, about.needsMiddle);
    const made = await work.over;
    buttons(false);
    if (made) show(made, about);
  }

  async function markMiddle() {
    if (!(await view.act("calibration.middle"))) return;
    if (calibrated) calibrated.about.needsMiddle = false;
    mark.hidden = true;
  }

  /** @param {File} chosen */
  async function load(chosen) {
    if (chosen.size > LARGEST) return hexwire.notify("the file is larger than 256 KiB", "error");
    const about = { arm: arm.value, how: `Loaded from ${chosen.name}`, needsMiddle: false };
    const made = await view.send("calibration", chosen, { arm: about.arm, name: chosen.name });
    if (made) follow(calibrated = new Work(view, Promise.resolve(made), about));
  }

  /**
   * @param {Calibration} made
   * @param {{ arm: string, how: string }} about
   */
  function show(made, { arm: chosen, how }) {
    const store = async () => {
      const text = "Offset and limits of every servo are overwritten, and read back.\nIf one fails, all get their old values.";
      if (!(await question("Store in the servos", text, "Store them"))) return;
      const changed = await view.act("calibration.store", { arm: chosen, name: "calibration.toml", text: made.toml });
      if (changed) hexwire.notify(`stored: ${changed.join(", ") || "nothing to change"}`, "ok");
    };
    const lerobot = () => (made.no_lerobot ? hexwire.notify(made.no_lerobot, "error") : download("calibration.json", made.lerobot));
    result.replaceChildren(
      node("p", { role: "status" }, `${how}.`),
      fill(node("div"), table("Calibration", ["Joint", "#Servo", "#Offset", "#Lowest count", "#Highest count"], made.rows)),
      row(button("Store in the servos", store, { level: "danger" }),
        button("Save as file", () => download("calibration.toml", made.toml), { offline: true }),
        button("Save for LeRobot", lerobot, { offline: true })));
  }
}

/**
 * A table of how far each joint was moved, and what is missing.
 * @param {HTMLElement} element
 * @param {RangeRow[]} rows
 */
export function showRanges(element, rows) {
  if (element.querySelectorAll("tbody tr").length !== rows.length) {
    const bar = html`<span class="sv-range"><span></span><i></i></span>`;
    fill(element, table("Ranges", ["Joint", "#Min °", "#Now °", "#Max °", "Range", "Missing"], rows.map(({ name }) => [name, "", "", "", bar, ""])));
  }
  const lines = all(element, "tbody tr", HTMLTableRowElement);
  rows.forEach((one, i) => {
    const { cells } = lines[i], [bar, mark] = all(cells[4], ".sv-range > *"), low = one.low ?? 0, high = one.high ?? 0;
    put(cells[0], one.name);
    put(cells[1], number(one.low, 1));
    put(cells[2], number(one.now, 1));
    put(cells[3], number(one.high, 1));
    put(cells[5], one.missing || "nothing", one.missing ? "warn" : "ok");
    const span = Math.max(one.usual || 0, high - low, 1) * 1.1, middle = (high + low) / 2;
    const at = (/** @type {number} */ value) => Math.min(100, Math.max(0, 50 + (100 * (value - middle)) / span));
    bar.style.left = `${at(low)}%`;
    bar.style.width = `${at(high) - at(low)}%`;
    mark.style.left = `${at(one.now ?? 0)}%`;
  });
}

// -- a whole arm -------------------------------------------------------------------------------------------------

/**
 * @param {import("./servos_kit.js").View} view
 * @param {HTMLElement} place
 */
export async function setUp(view, place) {
  const arm = choice(), role = choice();
  const begin = button("Look what is connected", () => look(false), { level: "accent" });
  const everywhere = button("Look at every id and rate", () => look(true));
  const cancel = button("Cancel", () => view.act("servos.cancel"), { offline: true });
  const told = hint("", { role: "status" }), shown = node("div");
  const screen = node("div", { class: "sv-view" }), caption = hint("");
  const drawing = node("div", { hidden: true }, screen, caption);
  let begun = false, turn = 0;
  /** @type {Promise<import("./arm_picture.js").Picture> | null} */
  let picture = null;
  place.append(
    node("h2", { class: "sv-h2" }, "Set up an arm"),
    ...section("Servo by servo", "New servos all have id 1: connect them one at a time. Each gets its id and rate, and is read back. The servos themselves are asked what is done, so a set-up can be resumed at any time. Nothing moves."),
    form(field("Arm", arm), field("Leader or follower", role), begin, everywhere, cancel), told, drawing, shown);
  cancel.hidden = true;
  // What is shown was about another arm.
  const renew = () => {
    begun = false;
    turn += 1;
    if (!looked?.running) looked = null;
    drawing.hidden = true;
    shown.replaceChildren();
  };
  arm.addEventListener("change", renew);
  role.addEventListener("change", renew);
  const found = await view.act("set_up.choices");
  if (found) {
    offer(arm, found.arms);
    offer(role, found.roles);
  }
  const before = workAt(view, looked);
  if (before) follow(before);

  /** @param {boolean} all whether at every id and rate */
  async function look(all) {
    const about = { arm: arm.value, role: role.value };
    follow(looked = new Work(view, view.act("set_up.look", { ...about, again: begun, everywhere: all }), about));
  }

  /**
   * Show a look that goes on, and then what it has found.
   * @param {NonNullable<typeof looked>} work
   */
  async function follow(work) {
    const mine = turn, { running } = work;
    arm.value = work.about.arm;
    role.value = work.about.role;
    begin.hidden = everywhere.hidden = running;
    cancel.hidden = !running;
    const end = hexwire.onFacts(({ job }) => job && put(told, job), told);
    const step = await work.over;
    end();
    put(told, "");
    begin.hidden = everywhere.hidden = false;
    cancel.hidden = true;
    // Another arm may have been chosen meanwhile.
    if (step === undefined || mine !== turn) return;
    begun = true;
    draw(step);
    if (running) view.relist();
  }

  /** @param {string} joint */
  async function showJoint(joint) {
    picture ||= import("./arm_picture.js").then(({ Picture }) => new Picture(screen, caption));
    const shows = await picture;
    await shows.show(arm.value);
    shows.mark(joint);
  }

  /** @param {SetUp} step */
  function draw(step) {
    const give = async () => {
      if (!(await question("Set this servo up", step.question, "Set it up"))) return;
      const done = await view.act("set_up.assign");
      if (done !== undefined) hexwire.notify(done, "ok");
      look(false);
    };
    shown.replaceChildren();
    drawing.hidden = !step.joint;
    if (step.joint) showJoint(step.joint);
    shown.append(node("p", { role: "status" }, step.text));
    if (step.found) shown.append(hint(step.found));
    if (step.blocked) shown.append(node("p", { "data-level": "error" }, step.blocked));
    if (step.warning) shown.append(node("p", { "data-level": "warn" }, step.warning));
    if (step.question) shown.append(button("Give it this id and rate", give, { level: "danger" }));
    shown.append(facts(step.joints), ...step.remarks.map((words) => node("p", { "data-level": "warn" }, words)));
  }
}
