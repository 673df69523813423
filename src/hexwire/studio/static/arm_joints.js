/* Joint table, sliders and jog buttons of the page Arm. Owns how a press, a drag or a key becomes a hold, and the
numbers at frame rate. The server limits speed and range, and ends a hold whose signs of life stop. */

import hexwire, { faultsOf, FLAG } from "/static/live.js";
import { degrees, fixed } from "/static/arm.js";

const OVER = 0.06; // share of the range that a slider shows beyond each limit
const GRAB = 24; // pixels from the marker at which a drag begins
const PACE = 40; // ms between two changes of a drag
const SPOKEN = 500; // ms between two changes of what a screen reader is told
const MORE = { ArrowRight: 1, ArrowUp: 1, ArrowLeft: -1, ArrowDown: -1 };
const IDLE_KEYS = new Set(["Home", "End", "PageUp", "PageDown"]);

export function mountJoints(page) {
  page.args.joints.forEach((joint, i) => {
    const row = page.find(`tr[data-joint="${CSS.escape(joint.name)}"]`);
    if (row) mountRow(page, row, joint, i);
  });
  for (const button of page.all(".arm-space .arm-jog")) {
    const tool = [0, 0, 0, 0, 0, 0];
    tool[Number(button.dataset.axis)] = Number(button.dataset.turn);
    hexwire.holdButton(button, "space", () => ({ tool, speed: page.speed }));
  }
}

function mountRow(page, row, joint, i) {
  const cell = (name) => row.querySelector(`[data-value="${name}"]`);
  const slider = row.querySelector(".arm-slider");
  const low = joint.min - OVER * (joint.max - joint.min);
  const high = joint.max + OVER * (joint.max - joint.min);
  const share = (angle) => Math.min(1, Math.max(0, (angle - low) / (high - low)));
  slider.style.setProperty("--low", share(joint.min));
  slider.style.setProperty("--high", share(joint.max));
  for (const button of row.querySelectorAll(".arm-jog")) {
    const turn = Number(button.dataset.turn);
    hexwire.holdButton(button, "joint", () => ({ directions: { [joint.name]: turn }, speed: page.speed }));
  }
  mountSlider(page, slider, joint, i, { low, high, share });
  drawRow(page, { cell, slider, share, joint, i, row });
}

function drawRow(page, { cell, slider, share, joint, i, row }) {
  const cells = { position: cell("position"), goal: cell("goal"), load: cell("load"), state: cell("state") };
  const shown = {};
  let spoken = 0;
  const put = (name, text) => {
    if (shown[name] === text) return;
    shown[name] = text;
    cells[name].textContent = text;
    if (name === "state") cells.state.title = text; // it may be cut off
  };
  page.on("facts", () => {
    const known = page.knows(i);
    row.classList.toggle("arm-silent", !known);
    for (const button of row.querySelectorAll(".arm-jog")) button.disabled = !page.mine || !known;
  });
  page.on("draw", (frame) => {
    const position = frame.position[i];
    const known = page.knows(i);
    put("position", fixed(degrees(position)));
    put("goal", fixed(degrees(frame.goal[i])));
    put("load", fixed(100 * frame.load[i], 0));
    const flags = frame.flags[i];
    const faults = faultsOf(flags);
    const torque = flags & FLAG.unknown ? "torque unknown" : flags & FLAG.torque ? "holds" : "no torque";
    put("state", !known && !faults.length ? "unknown" : faults.join(", ") || torque);
    const level = faults.length ? "error" : "";
    if (cells.state.dataset.level !== level) cells.state.dataset.level = level;
    const out = known && (position < joint.min - 0.005 || position > joint.max + 0.005);
    if (row.classList.contains("arm-outside") !== out) row.classList.toggle("arm-outside", out);
    const at = known ? share(position).toFixed(4) : "";
    if (shown.at !== at) {
      shown.at = at;
      slider.style.setProperty("--at", at || 0);
      slider.classList.toggle("arm-unknown", !at);
    }
    const now = performance.now();
    if (now - spoken > SPOKEN && shown.spoken !== shown.position) {
      spoken = now;
      shown.spoken = shown.position;
      slider.setAttribute("aria-valuenow", known ? degrees(position).toFixed(0) : "0");
      slider.setAttribute("aria-valuetext", known ? `${degrees(position).toFixed(1)} degrees` : "unknown");
    }
  });
}

function mountSlider(page, slider, joint, i, { low, high, share }) {
  const aim = slider.querySelector(".arm-aim");
  const args = (goal) => ({ goals: { [joint.name]: goal }, speed: page.speed });
  let drag = null;
  const angle = (event) => {
    const box = slider.getBoundingClientRect();
    const wanted = low + ((event.clientX - box.left) / box.width) * (high - low);
    return Math.min(joint.max, Math.max(joint.min, wanted));
  };
  const mark = (goal) => {
    aim.hidden = goal === null;
    if (goal !== null) slider.style.setProperty("--aim", share(goal));
  };
  const over = (mine, why) => {
    if (drag === mine) drag = null;
    mark(null);
    slider.classList.remove("hw-held");
    if (why !== "released") page.tell("why", why);
  };
  slider.addEventListener("pointerdown", (event) => {
    const positions = page.positions();
    if (event.button !== 0 || !page.mine || !positions || !Number.isFinite(positions[i])) return;
    const box = slider.getBoundingClientRect();
    // Only at the marker, so that a touch that scrolls the page moves nothing.
    if (Math.abs(event.clientX - box.left - share(positions[i]) * box.width) > GRAB) return;
    slider.setPointerCapture(event.pointerId);
    slider.classList.add("hw-held");
    const mine = (drag = { goal: angle(event), told: performance.now(), timer: 0 });
    mark(mine.goal);
    hexwire.hold("drag", args(mine.goal), { element: slider }).then((why) => over(mine, why));
  });
  slider.addEventListener("pointermove", (event) => {
    if (!drag) return;
    const mine = drag;
    mine.goal = angle(event);
    mark(mine.goal);
    const tell = () => {
      mine.timer = 0;
      if (drag !== mine) return;
      mine.told = performance.now();
      hexwire.update(args(mine.goal));
    };
    if (!mine.timer) mine.timer = setTimeout(tell, Math.max(0, mine.told + PACE - performance.now()));
  });
  for (const name of ["pointerup", "pointercancel", "lostpointercapture"]) {
    slider.addEventListener(name, () => drag && hexwire.release());
  }
  let key = "";
  slider.addEventListener("keydown", (event) => {
    if (IDLE_KEYS.has(event.key)) event.preventDefault();
    const turn = MORE[event.key];
    if (!turn || event.ctrlKey || event.altKey || event.metaKey) return;
    event.preventDefault();
    if (event.repeat || key || !page.mine || !page.knows(i)) return;
    key = event.key;
    slider.classList.add("hw-held");
    const jog = { directions: { [joint.name]: turn }, speed: page.speed };
    hexwire.hold("joint", jog, { element: slider }).then((why) => {
      key = "";
      over(null, why);
    });
  });
  slider.addEventListener("keyup", (event) => event.key === key && hexwire.release());
  slider.addEventListener("blur", () => (drag || key) && hexwire.release());
  slider.addEventListener("contextmenu", (event) => event.preventDefault());
}
