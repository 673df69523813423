/* One servo moved by hand on the page Servos: its slider, two buttons, steps, and the speed. A servo of an arm moves as its
joint does on the page Move, whose row this is; a bare one within its own limits.

Owns where the values of the row come from. Must not decide what may move: the server checks every hold and step. */

import { jointMarkup, makePage, mountRow, radians, stepsMarkup } from "./arm.js";
import { mountSteps } from "./arm_jog.js";
import hexwire, { FLAG, required } from "./live.js";
import { fill, html } from "./widgets.js";

/** @typedef {import("./servos_kit.js").View} View */

/**
 * Joint `i` of the arm that is open.
 * @param {View} view
 * @param {HTMLElement} place
 * @param {JointRange[]} joints
 * @param {number} i
 */
export function moveJoint(view, place, joints, i) {
  const page = draw(view, place, joints, i);
  hexwire.onFrame((frame) => frame.position.length === joints.length && page.tell("draw", frame), page.root);
}

/**
 * A servo of the open bus.
 * @param {View} view
 * @param {HTMLElement} place
 * @param {number} servo
 */
export async function moveServo(view, place, servo) {
  const range = await view.act("slide.range", { servo });
  if (!range || !place.isConnected) return;
  const page = draw(view, place, [{ name: `servo ${servo}`, ...range }], 0);
  /** @type {(values: Record<string, unknown>) => [string, object]} */
  const held = (values) => ["servo", { servo, speed: page.speed, ...values }];
  /** @type {LiveRow | null} */
  let now = null;
  page.jog = (_, turn) => held({ turn });
  page.drag = (_, goal) => held({ goal });
  page.run = ({ by }) => hexwire.hold(...held({ by }), { attended: true });
  page.knows = () => hexwire.known && now !== null && !now.error;
  const position = () => (page.knows(0) ? radians(now?.deg ?? NaN) : NaN);
  page.positions = () => [position()];
  hexwire.onServos(({ rows }) => {
    now = rows.find(({ id }) => id === servo) ?? now;
    if (!now) return;
    const flags = now.error ? FLAG.silent : FLAG.unknown;
    page.tell("draw", { position: [position()], goal: [NaN], load: [now.load === null ? NaN : now.load / 100], flags: [flags] });
  }, page.root);
}

/**
 * @param {View} view
 * @param {HTMLElement} place
 * @param {JointRange[]} joints
 * @param {number} i
 */
function draw(view, place, joints, i) {
  const joint = joints[i];
  const root = required(fill(place, html`<div class="arm-page sv-move"><div class="arm-bar">
    <label for="sv-speed">Speed</label><input id="sv-speed" type="range" min="1" max="100" value="30" step="1">
    <output for="sv-speed">30 %</output>${stepsMarkup("°")}</div>
    <table class="arm-joints" aria-label="Move ${joint.name}"><tbody>${jointMarkup(joint)}</tbody></table></div>`), ".sv-move");
  const page = makePage(root, { joints }, view.opened);
  const speed = page.get("#sv-speed", HTMLInputElement), shown = page.get("output");
  speed.addEventListener("input", () => {
    page.speed = Number(speed.value) / 100;
    shown.textContent = `${speed.value} %`;
  });
  // Once what the row holds is known, too: a bare servo has other kinds of motion.
  queueMicrotask(() => {
    mountRow(page, page.get("tbody tr"), joint, i);
    mountSteps(page);
    hexwire.onFacts((facts) => {
      page.mine = hexwire.known && facts.holder_tab !== "" && facts.holder_tab === hexwire.tab;
      for (const button of page.all(".arm-need")) button.toggleAttribute("disabled", !page.mine);
      page.tell("facts", facts);
    }, root);
  });
  return page;
}
