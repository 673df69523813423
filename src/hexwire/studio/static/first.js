// The page First run: one panel that takes an arm from its cable to its first motion, with a picture of what to look at.
// Owns the buttons, and what the picture shows at each step; the server has the steps, and says what each is about and what is missing.

import { Picture } from "./arm_picture.js";
import { download, question } from "./forms.js";
import hexwire, { all, required } from "./live.js";
import { showRanges } from "./servos_calibration.js";
import { button, choice, field, row } from "./servos_kit.js";
import { fill, html, loadSheet, node, put } from "./widgets.js";
import { go } from "./studio.js";

const STEPS = ["Connect", "What it is", "Calibrated?", "Range of each joint", "First jog"];
const STAGES = ["", "what", "calibrated", "ranges", "jog", "done"];
const LOOK = 2000; // ms between two looks at the ports
const JOG = (5 * Math.PI) / 180; // as `setup/first_run.py`, for the ghost only

/**
 * @param {HTMLElement} element
 * @param {Visitor} visitor
 */
export async function mount(element, { operates }) {
  await Promise.all([loadSheet("/static/servos.css"), loadSheet("/static/first.css")]);
  element.classList.add("fr-page");
  fill(element, html`<ol class="fr-steps" aria-label="Steps">${STEPS.map((words) => html`<li>${words}</li>`)}</ol>
    <div class="fr-body">
      <section class="fr-picture" aria-label="Picture"><div class="fr-view"></div><p class="fr-caption" role="status"></p></section>
      <section class="fr-panel" aria-labelledby="fr-title"><h2 id="fr-title" tabindex="-1"></h2><p class="fr-text"></p>
        <div class="fr-more"></div><div class="fr-rows"></div><div class="hw-row fr-go"></div>
        <p class="fr-missing" role="status"></p></section>
    </div>`);
  const page = new Page(element, operates);
  hexwire.onFirst((told) => {
    page.heard += 1;
    page.draw(told);
  }, element);
  let opened = -1;
  hexwire.onFacts((facts) => {
    page.mark(facts);
    if (facts.opened === opened) return;
    opened = facts.opened;
    page.look();
  }, element);
  hexwire.onRange(({ rows }) => page.ranges(rows), element);
  hexwire.onFrame((frame) => page.frame(frame), element);
  hexwire.onLink((is) => is && page.look(), element);
  // Whoever leaves the page cannot see what a hand does any more: torque stays off, and nothing is stored.
  const watch = setInterval(() => {
    if (element.isConnected) return;
    clearInterval(watch);
    if (page.measures) hexwire.call("servos.cancel").catch(() => {});
  }, 500);
}

class Page {
  /** @type {First | null} */
  told = null;
  drawn = "";
  heard = 0; // how often the studio has told of the run by itself
  shownOnce = false;
  /** @type {HTMLSelectElement | null} */
  robots = null;
  measures = false;
  mine = false;
  torque = "";
  missing = "";

  /**
   * @param {HTMLElement} element
   * @param {boolean} operates
   */
  constructor(element, operates) {
    const find = (/** @type {string} */ selector) => required(element, selector);
    this.element = element;
    this.operates = operates;
    this.title = find("h2");
    this.text = find(".fr-text");
    this.more = find(".fr-more");
    this.rows = find(".fr-rows");
    this.buttons = find(".fr-go");
    this.why = find(".fr-missing");
    this.steps = all(element, ".fr-steps li");
    this.picture = new Picture(find(".fr-view"), find(".fr-caption"));
  }

  look() {
    const before = this.heard;
    // What was told meanwhile is newer than the answer may be.
    hexwire.call("first.look").then((told) => this.element.isConnected && before === this.heard && this.draw(told), () => {});
  }

  /** @param {Facts} facts */
  mark(facts) {
    const mine = facts.holder_tab !== undefined && facts.holder_tab !== "" && facts.holder_tab === hexwire.tab;
    const { torque = "" } = facts, changed = mine !== this.mine || torque !== this.torque;
    Object.assign(this, { mine, torque });
    if (changed && this.told?.stage) this.draw(this.told, true);
  }

  /** @param {First} told */
  draw(told, again = false) {
    const now = JSON.stringify(told);
    if (now === this.drawn && !again) return;
    const moved = told.stage !== this.told?.stage;
    this.drawn = now;
    this.told = told;
    const at = STAGES.indexOf(told.stage ?? "");
    this.steps.forEach((step, i) => {
      step.classList.toggle("fr-over", i < at);
      if (i === at) step.setAttribute("aria-current", "step");
      else step.removeAttribute("aria-current");
    });
    // What is drawn again must not take the place from under a finger, nor the focus from a button that stays.
    const focused = this.element.contains(document.activeElement) ? document.activeElement?.getAttribute("data-key") : null;
    if (!told.stage) this.connect(moved);
    else this.step(told);
    this.look_at(told);
    if (moved && this.shownOnce) this.title.focus();
    else if (focused) all(this.element, `[data-key="${focused}"]`)[0]?.focus();
    this.shownOnce = true;
  }

  /**
   * Show in the picture what the step is about.
   * @param {First | null} told
   */
  async look_at(told) {
    if (!told?.stage) return;
    // An open arm has its own limits.
    await this.picture.show(told.robot, `${told.robot} ${hexwire.facts?.mode === "arm" ? hexwire.facts.opened : ""}`);
    if (told !== this.told || (told.stage === "ranges" && told.measuring)) return; // its rows say it
    const sweeps = told.stage === "calibrated" || told.stage === "ranges";
    this.picture.mark(told.joint || null, sweeps);
  }

  // -- the first step: nothing is open for it yet ----------------------------------------------------------------

  /** @param {boolean} first whether another step was shown before */
  async connect(first) {
    if (!first && this.robots) return;
    put(this.title, "Connect the arm");
    put(this.text, "Put the arm down where it may move, and keep a hand at the switch of its supply. Connect the supply, then the USB cable: to the adapter at the foot of an SO-100 or SO-101, or to the board of a Hex7Bot. The picture shows where.");
    put(this.why, this.operates ? "" : "You watch: somebody who may operate begins it.");
    this.buttons.replaceChildren(this.key(button("Leave", () => go("/")), "leave"));
    this.rows.replaceChildren();
    const known = await hexwire.call("ports.known").catch(() => null);
    if (!known || !this.element.isConnected || this.told?.stage) return;
    const robots = (this.robots = choice(known.robots.map((name) => /** @type {const} */ ([name, name]))));
    // What is open says itself which one it is.
    robots.value = [hexwire.model.robot, "so101", known.default].find((name) => known.robots.includes(name)) ?? "";
    const ports = node("div", { class: "fr-ports" });
    this.more.replaceChildren(field("Which arm is it?", robots), ports, node("p", { class: "hw-dim" }, `A serial port: ${known.warning}.`));
    let seen = "";
    const list = (/** @type {Ports} */ found) => {
      const rows = [...(found.plugged ?? []), ...found.emulated.filter((one) => one.robots.includes(robots.value))];
      const here = hexwire.facts?.url ?? "";
      const now = JSON.stringify([rows, here, robots.value]);
      if (now === seen) return;
      seen = now;
      /** @type {(words: string, about: string, args: Calls["first.begin"]["args"]) => HTMLElement} */
      const offer = (words, about, args) => node("div", { class: "fr-port" },
        button(words, (pressed) => this.begin(pressed, args)), node("span", { class: "hw-dim" }, about));
      ports.replaceChildren(
        ...(here ? [offer("Begin with what is open", here, { robot: robots.value })] : []),
        ...rows.map((one) => offer(`Begin at ${one.device}`, one.obstacle || [one.guess, one.advice === known.warning ? "" : one.advice].filter(Boolean).join(". "), { url: one.device, robot: robots.value })));
      if (!rows.length) ports.append(node("p", {}, "No serial port on this machine yet. Plug the cable in, or try another one."));
      ports.querySelectorAll("button").forEach((each, i) => {
        each.disabled = !this.operates;
        each.classList.toggle("hw-accent", i === 0); // the likeliest one
      });
    };
    robots.addEventListener("change", () => {
      this.picture.show(robots.value).then(() => this.picture.mark(""));
      hexwire.call("ports.known").then(list, () => {});
    });
    this.picture.show(robots.value).then(() => this.picture.mark(""));
    list(known);
    const look = async () => {
      if (!robots.isConnected) return;
      if (!document.hidden && hexwire.connected) await hexwire.call("ports").then(list, () => {});
      setTimeout(look, LOOK);
    };
    look();
  }

  /**
   * @param {HTMLButtonElement} pressed
   * @param {Calls["first.begin"]["args"]} args
   */
  async begin(pressed, args) {
    pressed.disabled = true;
    const words = "Opening it, and asking what answers …";
    put(this.why, words);
    await hexwire.act("first.begin", args);
    // The next step may be there already, with what it needs.
    if (this.why.textContent === words) put(this.why, "");
    pressed.disabled = false;
  }

  // -- the other steps --------------------------------------------------------------------------------------------

  /** @param {FirstRun} told */
  step(told) {
    this.robots = null;
    put(this.title, told.title);
    put(this.text, told.measuring ? this.doing(told) : told.text);
    const more = told.stage === "ranges" ? this.rangeButtons(told) : told.stage === "jog" ? this.torqueButton() : told.stage === "what" && told.missing && told.bare ? this.newServos() : [];
    this.more.replaceChildren(...more);
    if (!told.measuring) this.list(told);
    const going = told.measuring ? [] : [
      ...(told.stage === "what" ? [] : [this.key(button("Back", () => hexwire.act("first.back")), "back")]),
      ...(told.stage === "jog" || told.stage === "done" ? [] : [this.key(button("Look again", () => hexwire.act("first.again")), "again")]),
      ...(told.next ? [this.key(button(told.next, () => hexwire.act("first.next"), { level: "accent" }), "next")] : []),
      ...(told.stage === "done" ? [this.key(button("Go to Move", () => this.leave("/move"), { level: "accent" }), "move")] : []),
    ];
    this.buttons.replaceChildren(...going, this.key(button("Leave", () => this.leave("/")), "leave"));
    for (const each of all(this.element, ".fr-panel button:not([data-key=leave])", HTMLButtonElement)) each.disabled ||= !this.mine;
    if (told.missing) for (const next of all(this.buttons, "[data-key=next]", HTMLButtonElement)) next.disabled = true;
    const control = this.mine ? "" : this.operates ? "Take control to go on." : "You watch: only the page with control goes on.";
    put(this.why, control || (told.missing && !told.measuring ? `Before the next step: ${told.missing}.` : ""));
  }

  /**
   * @param {HTMLButtonElement} made
   * @param {string} key
   */
  key(made, key) {
    made.dataset.key = key;
    return made;
  }

  /** @param {FirstRun} told */
  doing(told) {
    const middle = told.middle ? `Put ${told.endless.join(" and ")} in its middle and say so: it has no stops. ` : "";
    const hand = told.hand ? ` This arm is emulated: in a terminal, “hexwire sim hand shoulder_pan 120 --port ${told.hand}” moves a joint as a hand would.` : "";
    return `Torque is off. ${middle}Move every joint to both of its ends; the table says what is missing.${hand}`;
  }

  /** @param {FirstRun} told */
  list({ stage, rows, joints, bare }) {
    if (stage === "jog") {
      const bars = rows.map(([name, value, level]) => {
        /** @type {(way: number, words: string) => HTMLElement} */
        const hold = (way, words) => {
          const made = this.key(button(words, () => {}, { label: `${name} ${way > 0 ? "plus" : "minus"}` }), `${name} ${way}`);
          made.classList.add("sv-hold");
          hexwire.holdButton(made, "first", { joint: name, way });
          for (const event of ["pointerenter", "focus"]) made.addEventListener(event, () => this.picture.preview(name, way * JOG));
          for (const event of ["pointerleave", "blur"]) made.addEventListener(event, () => {
            this.picture.preview(null);
            this.look_at(this.told);
          });
          made.disabled = this.torque === "off";
          return made;
        };
        return node("div", { class: "fr-jog", role: "group", "aria-label": name }, node("span", {}, name), hold(-1, "−"), hold(1, "+"),
          node("span", { class: "hw-dim", "data-level": level || false }, value));
      });
      this.rows.replaceChildren(...bars);
      return;
    }
    if (stage === "ranges" && !bare) return;
    fill(this.rows, html`${rows.length > 0 && html`<dl class="fr-found">${rows.map(([name, value, level]) =>
      html`<div><dt>${name}</dt><dd data-level="${level}">${value}</dd></div>`)}</dl>`}`);
    if (!joints.length) this.rows.replaceChildren();
  }

  /** @param {FirstRun} told */
  rangeButtons(told) {
    if (!told.bare) {
      const off = async () => {
        if (await question("Torque off", "All joints lose their torque, and the arm sinks. Hold it.", "I hold it: torque off")) hexwire.act("torque", { on: false });
      };
      return [row(this.key(button("Torque off", off, { level: "accent" }), "limp"))];
    }
    if (told.measuring) {
      const middle = told.middle ? [this.key(button(`${told.endless.join(" and ")}: in its middle now`, () => hexwire.act("first.middle"), { level: "accent" }), "middle")] : [];
      return [row(...middle, this.key(button("Finish", () => this.finish(), { level: "accent" }), "finish"),
        this.key(button("Cancel", () => hexwire.act("servos.cancel")), "cancel"))];
    }
    const words = told.measured ? "Measure again: torque off" : told.missing ? "Begin: torque off" : "Measure anew: torque off";
    const measure = this.key(button(words, () => this.measure(), { level: told.missing && !told.measured ? "accent" : "" }), "measure");
    const undo = told.undo ? [this.key(button("Take it back", () => this.undo()), "undo")] : [];
    if (!told.measured) return [row(measure, ...undo)];
    const { toml, lerobot, no_lerobot: none } = told.measured;
    return [row(this.key(button("Store in the servos", () => this.store(told), { level: "danger" }), "store"), measure,
      button("Save as file", () => download("calibration.toml", toml)),
      button("Save for LeRobot", () => (none ? hexwire.notify(none, "error") : download("calibration.json", lerobot))))];
  }

  torqueButton() {
    if (this.torque === "on") return [];
    const on = this.key(button("Torque on: it holds where it is", () => hexwire.act("torque", { on: true }), { level: "accent" }), "torque");
    return [row(on)];
  }

  newServos() {
    return [row(this.key(button("Set up new servos one at a time", () => go("/servos")), "set-up"))];
  }

  async measure() {
    if (!(await question("Torque off", "All joints lose their torque, and the arm sinks. Hold it.\nNothing is stored by this.", "I hold it: torque off"))) return;
    this.measures = true;
    await hexwire.act("first.measure");
    this.measures = false;
  }

  async finish() {
    const missing = await hexwire.act("first.finish");
    if (missing && (await question("Something is missing", `${missing}.\nA joint may be limited on purpose.`, "Accept it as it is", "accent"))) hexwire.act("first.finish", { sure: true });
  }

  /** @param {FirstRun} told */
  async store(told) {
    const lines = told.rows.map(([name, what]) => `${name}: ${what}`);
    const text = [...lines, "Each value is read back. If one fails, all servos get their old values."].join("\n");
    if (await question("Store in the servos", text, "Store them")) {
      if ((await hexwire.act("first.store")) !== undefined) hexwire.notify("stored in the servos, and read back", "ok");
    }
  }

  async undo() {
    const text = "Offset and range of every servo become what they were before they were stored here.";
    if (await question("Take it back", text, "Write the old values")) hexwire.act("first.undo");
  }

  /** @param {string} path */
  async leave(path) {
    if (this.measures) await hexwire.act("servos.cancel");
    if (this.mine && this.told?.stage) await hexwire.act("first.leave");
    go(path);
  }

  // -- what comes all the time ------------------------------------------------------------------------------------

  /** @param {RangeRow[]} rows */
  ranges(rows) {
    const { told } = this;
    if (told?.stage !== "ranges" || (told.bare && !told.measuring)) return;
    if (!this.rows.querySelector(".sv-range")) this.rows.replaceChildren();
    showRanges(this.rows, rows);
    if (told.bare) this.picture.follow(rows);
    else {
      const next = rows.find(({ missing }) => missing);
      this.picture.mark(next ? next.name : null, Boolean(next));
    }
  }

  /** @param {Frame} frame */
  frame(frame) {
    if (hexwire.facts?.mode === "arm") this.picture.joints(frame.position, hexwire.known ? frame.known : []);
  }
}
