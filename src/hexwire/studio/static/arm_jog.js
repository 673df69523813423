/* Jog by steps and by keys, on the page Move: a click is one exact motion, a key does what its button does, and a map shows
which key that is.

Owns what waits behind the present step, and the keys. Loaded after the first picture. Must not decide what may move: a step
is planned and checked by the server like every motion. */

import { radians } from "./arm.js";
import hexwire, { capital } from "./live.js";
import { node, within } from "./widgets.js";

const MOST = 20; // clicks that may wait behind a step
const PLUS = ["q", "w", "e", "r", "t", "y"], MINUS = ["a", "s", "d", "f", "g", "h"]; // along x y z, about x y z
const AXES = ["along x", "along y", "along z", "about x", "about y", "about z"];
const DIGIT = /^Digit([1-9])$/;
const TYPED = "input:not([type='checkbox'], [type='radio'], [type='range']), select, textarea";
const FINE = ["arrived", "released", "ended"];

/**
 * A joint or an axis of space, and the direction.
 * @typedef {{ joint?: string, axis?: number, turn: number }} Way
 */

/** @param {ArmPage} page */
export function mountJog(page) {
  const steps = mountSteps(page);
  mountKeys(page, steps);
}

/**
 * @param {HTMLButtonElement} button
 * @returns {Way}
 */
function wayOf(button) {
  const joint = button.closest("tr")?.dataset.joint, turn = Number(button.dataset.turn);
  return joint ? { joint, turn } : { axis: Number(button.dataset.axis), turn };
}

/**
 * Clicks of the page's buttons as steps.
 * @param {ArmPage} page
 */
export function mountSteps(page) {
  /** @type {Map<string | number, number>} */
  const waiting = new Map(); // how far, in degrees or millimetres, by joint or axis
  let clicks = 0; // that wait
  let busy = false;

  /** @type {(key: string | number, far: number) => Record<string, unknown>} */
  const motion = (key, far) => {
    if (typeof key === "string") return { what: "step", joint: key, by: radians(far) };
    const along = key < 3, by = [0, 0, 0];
    by[key % 3] = along ? far / 1000 : radians(far);
    return { what: "step", [along ? "move" : "turn"]: by };
  };
  const forget = () => {
    waiting.clear();
    clicks = 0;
  };
  const go = async () => {
    busy = true;
    // The one that waits longest; others may come meanwhile.
    for (const [key, far] of waiting) {
      if (!page.root.isConnected) break; // nobody sees the page from which it was asked for
      waiting.delete(key);
      clicks = 0;
      if (Math.abs(far) < 1e-9) continue; // there and back
      const why = await page.run(motion(key, far));
      // Only after an arrival: what waits behind a stop, a refusal or another motion is not done later.
      if (why !== "arrived") forget();
      if (!FINE.includes(why)) hexwire.say(why);
    }
    busy = false;
  };

  /**
   * One step. While the one before is under way it is added to what waits, so that no click is lost.
   * @param {Way} way
   */
  function press({ joint, axis, turn }) {
    const key = joint ?? axis ?? 0;
    if (clicks >= MOST) {
      hexwire.say(`${MOST} steps wait already: this one was left out`);
      return;
    }
    clicks += 1;
    waiting.set(key, (waiting.get(key) ?? 0) + turn * page.step);
    if (!busy) go();
  }

  for (const button of page.all(".arm-jog", HTMLButtonElement)) {
    button.addEventListener("click", () => page.step && press(wayOf(button)));
    // A key that is held down is one click.
    button.addEventListener("keydown", (event) => page.step && event.repeat && event.preventDefault());
  }
  for (const choice of page.all('[name="step"]', HTMLInputElement)) {
    choice.disabled = false;
    choice.addEventListener("change", () => {
      hexwire.release();
      forget();
      page.step = Number(choice.value);
    });
  }
  return press;
}

/**
 * @param {ArmPage} page
 * @param {(way: Way) => void} press
 */
function mountKeys(page, press) {
  const keys = page.get("#arm-keys", HTMLInputElement), help = page.get("#arm-map");
  const joints = page.args.joints.map(({ name }) => name);
  /** @type {{ code: string } | null} */
  let held = null; // the key that holds a jog
  /** @type {HTMLDialogElement | null} */
  let map = null;

  /** @type {(event: KeyboardEvent) => Way | null} */
  const wayOfKey = ({ key, code, shiftKey }) => {
    const digit = DIGIT.exec(code);
    const joint = digit && joints[Number(digit[1]) - 1];
    if (digit) return joint ? { joint, turn: shiftKey ? -1 : 1 } : null;
    if (!page.args.space) return null;
    const letter = key.toLowerCase();
    if (PLUS.includes(letter)) return { axis: PLUS.indexOf(letter), turn: 1 };
    return MINUS.includes(letter) ? { axis: MINUS.indexOf(letter), turn: -1 } : null;
  };
  const down = (/** @type {KeyboardEvent} */ event) => {
    if (event.ctrlKey || event.altKey || event.metaKey || within(event, TYPED)) return;
    if (event.key === "?") {
      event.preventDefault();
      toggle();
      return;
    }
    const way = keys.checked ? wayOfKey(event) : null;
    if (!way) return;
    event.preventDefault();
    if (event.repeat || keys.disabled) return;
    if (page.step) press(way);
    else hold(way, event.code);
  };
  /** @type {(way: Way, code: string) => void} */
  const hold = (way, code) => {
    const tool = [0, 0, 0, 0, 0, 0];
    if (way.axis !== undefined) tool[way.axis] = way.turn;
    const jog = way.joint ? { directions: { [way.joint]: way.turn } } : { tool };
    const mine = (held = { code });
    hexwire.hold(way.joint ? "joint" : "space", { ...jog, speed: page.speed }, { element: keys }).then((why) => {
      if (held === mine) held = null;
      if (!FINE.includes(why)) hexwire.say(why);
    });
  };
  const up = (/** @type {KeyboardEvent} */ event) => held && (event.code === held.code || event.key === "Shift") && hexwire.release();
  /** @type {["keydown" | "keyup", (event: KeyboardEvent) => unknown][]} */
  const heard = [["keydown", down], ["keyup", up]];
  for (const [name, act] of heard) {
    document.addEventListener(name, function once(event) {
      if (page.root.isConnected) act(event);
      else document.removeEventListener(name, once);
    });
  }
  keys.addEventListener("change", () => hexwire.release());
  // Whoever takes control again says again that keys move the arm.
  page.on("need", () => page.mine || (keys.checked = false));

  function toggle() {
    if (map?.isConnected) {
      map.remove();
      return;
    }
    /** @type {(plus: string, minus: string, what: string) => HTMLElement} */
    const row = (plus, minus, what) => node("tr", {}, node("th", { scope: "row" }, what), node("td", {}, node("kbd", {}, plus)), node("td", {}, node("kbd", {}, minus)));
    const rows = joints.slice(0, 9).map((name, i) => row(`${i + 1}`, `Shift ${i + 1}`, name));
    if (page.args.space) rows.push(...AXES.map((words, i) => row(PLUS[i].toUpperCase(), MINUS[i].toUpperCase(), capital(words))));
    const close = node("button", { class: "hw-button", type: "button", onclick: toggle }, "Close");
    map = node("dialog", { class: "hw-dialog", "aria-label": "Keys" },
      node("h2", {}, "Keys"),
      node("p", {}, "While the switch Keys is on, a key does what its button does: it jogs while it is held, or makes one step."),
      node("table", { class: "arm-map" },
        node("thead", {}, node("tr", {}, ...["Joint or axis", "+", "−"].map((words) => node("th", { scope: "col" }, words)))),
        node("tbody", {}, ...rows)),
      node("p", {}, node("kbd", {}, "Esc"), " stops the arm, ", node("kbd", {}, "?"), " shows and hides this map."),
      close);
    page.root.append(map);
    map.show();
    close.focus();
  }
  help.addEventListener("click", toggle);
  help.hidden = false;
}
