/* A gamepad on the page Move: while its dead-man button is pressed, its sticks jog the arm as the page's buttons do.

Owns the mapping of sticks and buttons, which a person changes in a dialog and this browser keeps, and when a press of the
dead-man button is a hold. Loaded when the switch is first used. Must not decide what may move: each jog is checked by the
server, and ends there without signs of life. */

import hexwire, { capital } from "./live.js";
import { node } from "./widgets.js";

const SLACK = 0.15; // of a stick: it does not rest exactly in its middle
const AGAIN = 5000; // ms after which what the pad waits for is said again
const PACE = 40; // ms between two changes of a jog
const KEPT = "hexwire-gamepad"; // where the browser keeps the mapping
const AXES = ["along x", "along y", "along z", "about x", "about y", "about z"];
const FINE = ["released", "ended"];

/**
 * An input of the pad and its sign, for each axis or joint.
 * @typedef {[string, number][]} Ways
 * @typedef {{ deadman: number, mode: "space" | "joint", space: Ways, joint: Ways }} Mapping
 */

/** Two buttons against each other, as an axis: the one that counts as positive first. */
const PAIRS = /** @type {Record<string, string>} */ ({ "pair 15 14": "D-pad ↔", "pair 12 13": "D-pad ↕", "pair 7 6": "triggers", "pair 3 0": "Y and A", "pair 1 2": "B and X" });
const STICKS = ["left stick ↔", "left stick ↕", "right stick ↔", "right stick ↕"];
const BUTTONS = ["A", "B", "X", "Y", "L1", "R1", "L2", "R2", "select", "start", "left stick", "right stick", "D-pad up", "D-pad down", "D-pad left", "D-pad right", "home"];
/** @type {Mapping} */
const USUAL = {
  deadman: 4,
  mode: "space",
  space: [["axis 0", 1], ["axis 1", -1], ["axis 3", -1], ["pair 15 14", 1], ["pair 12 13", 1], ["axis 2", -1]],
  joint: [["axis 0", 1], ["axis 1", -1], ["axis 3", -1], ["axis 2", 1], ["pair 12 13", 1], ["pair 15 14", 1], ["pair 7 6", 1]],
};

/** @param {ArmPage} page */
export function mountPad(page) {
  const on = page.get("#arm-pad", HTMLInputElement);
  const joints = page.args.joints.map(({ name }) => name);
  const map = kept(joints.length);
  if (!page.args.space) map.mode = "joint";
  /** @type {{ text: string, told: number } | null} */
  let mine = null; // the jog that is held
  let armed = false; // the dead-man button was seen released since the last jog: a stop is not undone by a thumb that stays
  let words = "", said = 0;

  /** @type {(text: string, now: number) => void} */
  const say = (text, now) => {
    if (text === words && now - said < AGAIN) return;
    said = now;
    hexwire.say((words = text));
  };
  const letGo = () => mine && hexwire.release();

  /** @param {Gamepad} pad */
  function jog(pad) {
    const turns = map[map.mode].map(([input, sign]) => sign * deflection(pad, input));
    if (map.mode === "space") return { kind: "space", args: { tool: turns.slice(0, 6), speed: page.speed }, moves: turns.some(Boolean) };
    const named = joints.map((name, i) => [name, turns[i] || 0]);
    return { kind: "joint", args: { directions: Object.fromEntries(named), speed: page.speed }, moves: turns.some(Boolean) };
  }

  /** @param {number} now */
  function look(now) {
    if (!page.root.isConnected || !on.checked) {
      letGo();
      return;
    }
    requestAnimationFrame(look);
    const pad = firstPad();
    if (!pad) {
      letGo();
      armed = false;
      say("no gamepad: connect one, and press a button of it", now);
      return;
    }
    if (!pad.buttons[map.deadman]?.pressed) {
      letGo();
      armed = true;
      say(`gamepad: hold ${buttonWords(map.deadman)} and move a stick`, now);
      return;
    }
    const { kind, args, moves } = jog(pad);
    if (mine) {
      const text = JSON.stringify(args);
      if (text === mine.text || now - mine.told < PACE) return;
      Object.assign(mine, { text, told: now });
      hexwire.update(args);
    } else if (armed && moves && page.mine && !hexwire.holding) {
      armed = false;
      const begun = (mine = { text: JSON.stringify(args), told: now });
      hexwire.hold(kind, args, { element: on }).then((why) => {
        if (mine === begun) mine = null;
        words = "";
        if (!FINE.includes(why)) hexwire.say(why);
      });
    }
  }

  const begin = () => {
    words = "";
    armed = false;
    if (on.checked) requestAnimationFrame(look);
  };
  on.addEventListener("change", begin);
  // Whoever takes control again says again that the pad moves the arm.
  page.on("need", () => page.mine || (on.checked = false));
  page.get("#arm-pad-map").addEventListener("click", () => dialog(page, map, joints));
  begin();
}

function firstPad() {
  return [...navigator.getGamepads()].find((pad) => pad?.connected) ?? null;
}

/**
 * How far an input is moved, -1 to 1; 0 for one that the pad does not have.
 * @param {Gamepad} pad
 * @param {string} input
 */
function deflection(pad, input) {
  const [kind, ...numbers] = input.split(" "), [a, b] = numbers.map(Number);
  const value = kind === "axis" ? pad.axes[a] ?? 0 : kind === "pair" ? (pad.buttons[a]?.value ?? 0) - (pad.buttons[b]?.value ?? 0) : 0;
  const size = Math.min(1, Math.abs(value));
  return size < SLACK || !Number.isFinite(value) ? 0 : Number(((Math.sign(value) * (size - SLACK)) / (1 - SLACK)).toFixed(3));
}

const buttonWords = (/** @type {number} */ i) => BUTTONS[i] ?? `button ${i + 1}`;
const inputWords = (/** @type {string} */ input) => (input === "" ? "nothing" : PAIRS[input] ?? STICKS[Number(input.split(" ")[1])]);
const inputs = () => ["", ...STICKS.map((_, i) => `axis ${i}`), ...Object.keys(PAIRS)];

/**
 * The mapping of this browser; where it has none that can be used, the usual one.
 * @param {number} joints
 * @returns {Mapping}
 */
function kept(joints) {
  let found = null;
  try {
    found = JSON.parse(localStorage.getItem(KEPT) ?? "null");
  } catch { /* nothing is kept, or what is kept is no mapping */ }
  const known = inputs();
  /** @type {(given: unknown, usual: [string, number]) => [string, number]} */
  const row = (given, usual) => (Array.isArray(given) && known.includes(given[0]) && [1, -1].includes(given[1]) ? [given[0], given[1]] : usual);
  /** @type {(mode: "space" | "joint", length: number) => Ways} */
  const rows = (mode, length) => Array.from({ length }, (_, i) => row(found?.[mode]?.[i], USUAL[mode][i] ?? ["", 1]));
  const deadman = Number.isInteger(found?.deadman) && found.deadman in BUTTONS ? found.deadman : USUAL.deadman;
  return { deadman, mode: found?.mode === "joint" ? "joint" : "space", space: rows("space", 6), joint: rows("joint", joints) };
}

/**
 * @param {ArmPage} page
 * @param {Mapping} map
 * @param {string[]} joints
 */
function dialog(page, map, joints) {
  hexwire.release();
  const save = () => {
    hexwire.release();
    try {
      localStorage.setItem(KEPT, JSON.stringify(map));
    } catch { /* the browser keeps nothing: the mapping lasts as long as the page */ }
  };
  /** @type {<T extends string | number>(label: string, values: [T, string][], now: T, put: (value: string) => void) => HTMLSelectElement} */
  const select = (label, values, now, put) => {
    const made = node("select", { "aria-label": label }, ...values.map(([value, words]) => node("option", { value, selected: String(value) === String(now) }, words)));
    made.addEventListener("change", () => {
      put(made.value);
      save();
    });
    return made;
  };
  const table = node("tbody");
  const draw = () => {
    const names = map.mode === "space" ? AXES : joints;
    table.replaceChildren(...names.map((name, i) => node("tr", {},
      node("th", { scope: "row" }, map.mode === "space" ? capital(name) : name),
      node("td", {}, select(`Input of ${name}`, inputs().map((input) => /** @type {Choice<string>} */ ([input, inputWords(input)])), map[map.mode][i][0], (value) => (map[map.mode][i] = [value, map[map.mode][i][1]]))),
      node("td", {}, select(`Direction of ${name}`, [[1, "as it is"], [-1, "reversed"]], map[map.mode][i][1], (value) => (map[map.mode][i] = [map[map.mode][i][0], Number(value)]))))));
  };
  draw();
  const pad = firstPad();
  const close = node("button", { class: "hw-button", type: "button" }, "Close");
  const usual = node("button", { class: "hw-button", type: "button" }, "Usual mapping");
  /** @type {Choice<Mapping["mode"]>[]} */
  const modes = [...(page.args.space ? [/** @type {Choice<"space">} */ (["space", "the tip along and about the axes of the base"])] : []), ["joint", "the joints"]];
  const box = node("dialog", { class: "hw-dialog", "aria-label": "Gamepad" },
    node("h2", {}, "Gamepad"),
    node("p", {}, pad ? `${pad.id}.` : "No gamepad is known to this page: connect one, and press a button of it.", " The arm moves only while the dead-man button is pressed, and holds when it is released."),
    node("p", { class: "hw-field" }, node("label", {}, "Dead-man button ", select("Dead-man button", BUTTONS.map((words, i) => /** @type {Choice<number>} */ ([i, words])), map.deadman, (value) => (map.deadman = Number(value))))),
    node("p", { class: "hw-field" }, node("label", {}, "Moves ", select("Moves", modes, map.mode, (value) => {
      map.mode = value === "space" ? "space" : "joint";
      draw();
    }))),
    node("table", { class: "arm-map" }, node("thead", {}, node("tr", {}, ...["Moves", "Stick or buttons", "Direction"].map((words) => node("th", { scope: "col" }, words)))), table),
    node("p", { class: "arm-buttons" }, usual, " ", close));
  usual.addEventListener("click", () => {
    Object.assign(map, structuredClone({ ...USUAL, mode: map.mode, joint: joints.map((_, i) => USUAL.joint[i] ?? ["", 1]) }));
    save();
    box.remove();
    dialog(page, map, joints);
  });
  close.addEventListener("click", () => box.remove());
  page.root.append(box);
  box.show();
  close.focus();
}
