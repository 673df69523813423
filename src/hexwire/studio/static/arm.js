/* The page Arm in the browser: joins its parts, the 3D view, and motions that this page holds.

Owns what the parts share (`page`): speed, calls to the server, the ghost, the running motion. Must not decide what may
move: the server checks every hold and every call. */

import hexwire from "/static/live.js";
import { mountJoints } from "/static/arm_joints.js";
import { mountTip } from "/static/arm_tip.js";
import { mountGoto } from "/static/arm_goto.js";
import { mountPoses, mountGripper } from "/static/arm_poses.js";
import { mountTeach } from "/static/arm_teach.js";
import { loadSheet } from "/static/widgets.js";

const PATIENCE = 20000; // ms for an answer of the server
const QUESTIONS = new Set(["preview", "poses", "taught"]); // they change nothing
const READ = 6000; // ms for which a reason stays in sight

export const degrees = (radians) => (radians * 180) / Math.PI;
export const radians = (value) => (value * Math.PI) / 180;

export function fixed(value, digits = 1) {
  if (!Number.isFinite(value)) return "–";
  const text = value.toFixed(digits);
  return Number(text) === 0 ? text.replace("-", "") : text.replace("-", "−");
}

const answers = new Map();
let calls = 0;
let present = null;

window.hexwireArm = {
  answer(id, values) {
    const settle = answers.get(id);
    answers.delete(id);
    if (settle) settle(values);
  },
  taught(values) {
    if (present) present.tell("taught", values);
  },
};

export async function mount(root, args) {
  await Promise.all([loadSheet("/static/palette.css"), loadSheet("/static/arm.css")]);
  if (!root.isConnected) return;
  const page = (present = makePage(root, args));
  mountBar(page);
  mountJoints(page);
  mountTip(page);
  mountGoto(page);
  mountPoses(page);
  mountGripper(page);
  mountTeach(page);
  mountRun(page);
  let asked = 0;
  hexwire.onFrame(() => {
    // However many frames have come, one change of the page for each picture.
    asked ||= requestAnimationFrame(() => {
      asked = 0;
      // Another arm may have been opened meanwhile.
      const { frame } = hexwire;
      if (root.isConnected && frame && frame.position.length === args.joints.length) page.tell("draw", frame);
    });
  }, root);
  hexwire.onFacts((facts) => page.tell("facts", facts), root);
  await mountView(page);
}

function makePage(root, args) {
  const listeners = {};
  const page = {
    root,
    args,
    view: null,
    plan: null, // the previewed motion
    speed: 0.3,
    find: (selector) => root.querySelector(selector),
    all: (selector) => [...root.querySelectorAll(selector)],
    on(name, act) {
      (listeners[name] ||= []).push(act);
    },
    tell(name, value) {
      for (const act of listeners[name] || []) act(value);
    },
    /** Ask the server; the answer has `error` if it refused. */
    call(name, values = {}) {
      if (hexwire.late && !QUESTIONS.has(name)) return Promise.resolve({ error: "there is no connection to the studio" });
      const id = (calls += 1);
      return new Promise((resolve) => {
        answers.set(id, resolve);
        setTimeout(() => window.hexwireArm.answer(id, { error: "the studio did not answer" }), PATIENCE);
        root.dispatchEvent(new CustomEvent("hw-call", { detail: { id, name, args: values } }));
      });
    },
    /** Begin a motion that lasts while this page is in sight; resolves with why it ended. */
    run(values) {
      return hexwire.hold("run", { speed: page.speed, ...values }, { attended: true });
    },
    /** Show where a motion would end; null hides it. */
    ghost(goal, trace = null) {
      if (!page.view) return;
      page.view.setGhost(goal);
      page.view.trace(trace && trace.length > 1 ? trace : null);
    },
    /** Where the joints are; NaN for one of which nobody knows it. */
    positions() {
      const { frame, known } = hexwire;
      return frame && frame.position.map((angle, i) => (known && frame.known[i] ? angle : NaN));
    },
    knows: (i) => Boolean(hexwire.known && hexwire.frame && hexwire.frame.known[i]),
  };
  return page;
}

async function mountView(page) {
  const element = page.find("#arm-view");
  if (!element || !page.args.geometry) return;
  const { Arm3D } = await import("/static/arm3d.js");
  if (!element.isConnected) return;
  const view = (page.view = new Arm3D(element, page.args.geometry, { theme: "auto" }));
  view.setTable(page.args.table);
  view.setTip("own");
  const none = new Float32Array(page.args.joints.length);
  view.setJoints(none, []);
  const show = () => hexwire.frame && view.setJoints(hexwire.frame.position, hexwire.known ? hexwire.frame.known : []);
  page.on("draw", show);
  page.on("facts", show);
  const watch = setInterval(() => {
    if (element.isConnected) return;
    clearInterval(watch);
    view.dispose();
  }, 1000);
}

// -- speed, and what keeps the arm from moving -----------------------------------------------------------

function mountBar(page) {
  const speed = page.find("#arm-speed");
  const value = page.find("#arm-speed-value");
  const show = () => {
    page.speed = Number(speed.value) / 100;
    value.textContent = `${speed.value} %`;
    speed.setAttribute("aria-valuetext", `${speed.value} percent of the limits`);
  };
  speed.addEventListener("input", () => {
    show();
    page.tell("speed", page.speed);
  });
  show();
  const hint = page.find("#arm-hint");
  let lasting = "";
  let until = 0;
  page.on("facts", (facts) => {
    const holds = facts.holder_tab !== "" && facts.holder_tab === hexwire.tab;
    page.mine = holds && hexwire.known;
    page.unready = hexwire.known ? facts.unready : facts.unready || "nobody knows what the arm does";
    for (const element of page.all(".arm-need")) element.disabled = !page.mine;
    for (const element of page.all(".arm-whole")) element.disabled = !page.mine || page.unready !== "";
    page.root.classList.toggle("arm-idle", !page.mine);
    let text = "";
    if (page.unready) text = `${capital(page.unready)}.`;
    else if (!page.mine) text = "To move the arm, take control first.";
    else if (facts.stopped) text = "The arm is stopped; resume first.";
    else if (facts.torque === "off") text = "Torque is off: the arm does not move until it is on.";
    else if (facts.torque === "partly on") text = "Some joints have no torque and do not move.";
    lasting = text;
    if (performance.now() > until && hint.textContent !== text) hint.textContent = text;
    page.tell("need");
  });
  page.on("why", (text) => {
    hint.textContent = capital(text);
    until = performance.now() + READ;
    setTimeout(() => performance.now() >= until && (hint.textContent = lasting), READ + 50);
  });
}

// -- the motion that runs ----------------------------------------------------------------------------------

function mountRun(page) {
  const bar = page.find("#arm-run-bar");
  const text = page.find("#arm-run-text");
  const end = page.find("#arm-run-end");
  let run = null;
  let since = 0;
  const elapsed = () => Math.min(run.duration, run.elapsed + (run.outcome ? 0 : (performance.now() - since) / 1000));
  hexwire.onRun((told) => {
    run = told;
    since = performance.now();
    page.root.classList.toggle("arm-running", !told.outcome);
    if (told.outcome) {
      const words = { succeeded: told.holds ? "holds an object" : told.off ? `arrived, ${told.off}` : "arrived" }[told.outcome] || told.text || told.outcome;
      text.textContent = `${capital(told.title)}: ${words}`;
      bar.value = told.outcome === "succeeded" ? 1 : bar.value;
      text.dataset.level = told.outcome === "aborted" ? "error" : "";
    } else {
      text.dataset.level = "";
    }
    page.tell("run", told);
  }, page.root);
  page.on("draw", () => {
    if (!run || run.outcome) return;
    const now = elapsed();
    bar.value = run.duration > 0 ? now / run.duration : 1;
    const words = `${capital(run.title)}: ${now.toFixed(1)} of ${run.duration.toFixed(1)} s`;
    if (text.textContent !== words) text.textContent = words;
    page.tell("elapsed", { run, now });
  });
  page.on("draw", () => {
    const mine = hexwire.holding && page.root.classList.contains("arm-running");
    if (end.disabled === mine) end.disabled = !mine;
  });
  end.addEventListener("click", () => hexwire.release("ended"));
}

export const capital = (words) => words.charAt(0).toUpperCase() + words.slice(1);

/** What a plan comes to, in words, into an element. */
export function showPlan(element, plan) {
  element.dataset.level = "";
  if (plan.error || plan.refusal) {
    element.textContent = plan.error || capital(plan.refusal);
    element.dataset.level = "error";
    return;
  }
  const parts = [plan.duration < 0.001 ? "The arm is there already" : `Takes ${plan.duration.toFixed(1)} s`];
  if (plan.lead_in > 0.05) parts.push(`${plan.lead_in.toFixed(1)} s of it to the start`);
  if (plan.branch) parts.push(plan.branch);
  element.textContent = parts.join("; ");
  if (plan.unready) {
    element.textContent += `. Not now: ${plan.unready}`;
    element.dataset.level = "warn";
  }
}
