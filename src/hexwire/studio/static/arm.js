/* The page Move in the browser: the 3D view, joints, jog, the pose of the tip, and the motion that this page holds.

Owns what the parts share (`page`): speed, calls to the server, the ghost, the running motion; how a press, a drag or a key
becomes a hold, and the numbers at frame rate. Must not decide what may move: the server checks every hold and every call. */

import hexwire, { all, capital, faultsOf, FLAG, required } from "./live.js";
import { gotoMarkup, gripperMarkup, mountGoto, mountGripper, mountPoses, posesMarkup } from "./arm_motion.js";
import { fill, html, loadSheet, tabs, whyOf } from "./widgets.js";

const OVER = 0.06; // share of the range that a slider shows beyond each limit
const GRAB = 24; // pixels from the marker at which a drag begins
const PACE = 40; // ms between two changes of a drag
const SPOKEN = 500; // ms between two changes of what a screen reader is told
/** @type {Record<string, number>} */
const MORE = { ArrowRight: 1, ArrowUp: 1, ArrowLeft: -1, ArrowDown: -1 };
const IDLE_KEYS = new Set(["Home", "End", "PageUp", "PageDown"]);
const GIMBAL = 1e-9;
const WAYS = { drive: "Jog and go", teach: "Teach and play", program: "Program", leader: "Leader arm" };
// Of Jog and go: on a phone one at a time, so that none is far down.
/** @type {Record<Part, string>} */
const PARTS = { joints: "Joints", space: "Space", grip: "Gripper", goto: "Go to", poses: "Poses" };
// Not in the first picture.
/** @type {Partial<Record<Way, () => Promise<(page: ArmPage, root: HTMLElement) => void>>>} */
const LATER = {
  teach: () => import("./arm_timeline.js").then(({ mountTeach }) => mountTeach),
  program: () => import("./arm_program.js").then(({ mountProgram }) => mountProgram),
  leader: () => import("./arm_leader.js").then(({ mountLeader }) => mountLeader),
};

/** @type {{ of: number, name: Way }} */
let way = { of: -1, name: "drive" }; // what is shown beside the arm: it stays when the page is left
/** @type {Part} */
let part = "joints"; // and which part of it on a phone

export const degrees = (/** @type {number} */ value) => (value * 180) / Math.PI;
export const radians = (/** @type {number} */ value) => (value * Math.PI) / 180;

/**
 * Whether an answer of `page.call` says that it was refused.
 * @type {(answer: unknown) => answer is Refused}
 */
export const isRefused = (answer) => typeof answer === "object" && answer !== null && "error" in answer;

/** @param {number} value */
export function fixed(value, digits = 1) {
  if (!Number.isFinite(value)) return "–";
  const text = value.toFixed(digits);
  return Number(text) === 0 ? text.replace("-", "") : text.replace("-", "−");
}

/**
 * The page follows what is open.
 * @param {HTMLElement} element
 */
export function mount(element) {
  let shown = "";
  let taught = "";
  /** @type {ArmPage | null} */
  let page = null;
  const follow = async (/** @type {Facts} */ facts) => {
    const now = `${facts.mode} ${facts.opened} ${facts.mode === "arm" ? "" : facts.open_error}`;
    if (now !== shown) {
      shown = now;
      page = null;
      if (facts.mode !== "arm") {
        fill(element, nothing(facts));
        return;
      }
      const args = await hexwire.call("arm.values", {}, facts.opened).catch((error) => ({ error: whyOf(error) }));
      if (now !== shown) return;
      if (isRefused(args)) {
        shown = ""; // asked again with the next facts
        fill(element, html`<p class="hw-bad">${args.error}</p>`);
        return;
      }
      page = draw(element, args, facts.opened);
      taught = "";
    }
    const what = `${facts.teaching} ${facts.taught}`;
    if (page && what !== taught) {
      taught = what;
      page.tellTaught();
    }
  };
  hexwire.onFacts(follow, element);
}

/** @param {Facts} facts */
function nothing({ mode, open_error: error }) {
  if (mode === "opening") return html`<p>The arm is being opened.</p>`;
  if (mode === "bus") {
    return html`<p>The servos are open one by one, without the arm around them. To move the arm as a whole, open it on
      <a href="/">Arms</a>.</p>`;
  }
  return html`${error && html`<p class="hw-bad">Not opened: ${error}</p>`}<p>No arm is open. Choose one on
    <a href="/">Arms</a>, or a servo bus on <a href="/servos">Servos</a>.</p>`;
}

/**
 * @param {HTMLElement} element
 * @param {ArmValues} args
 * @param {number} opened
 */
function draw(element, args, opened) {
  const root = required(fill(element, markup(args)), ".arm-page");
  const page = makePage(root, args, opened);
  mountBar(page);
  mountJoints(page);
  mountTip(page);
  mountGoto(page);
  mountGripper(page);
  mountPoses(page);
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
  mountView(page);
  // Not in the first picture: nobody jogs by steps or keys before the page has control.
  /** @type {Promise<unknown> | null} */
  let jog = null;
  const pad = page.get("#arm-pad"), map = page.get("#arm-pad-map");
  pad.addEventListener("change", () => import("./arm_pad.js").then(({ mountPad }) => root.isConnected && mountPad(page)), { once: true });
  const camera = page.find("#arm-camera");
  if (camera instanceof HTMLButtonElement) camera.addEventListener("click", () => {
    camera.disabled = true; // until there is a picture
    import("./arm_camera.js").then(({ mountCameras }) => root.isConnected && mountCameras(page, camera));
  }, { once: true });
  pad.addEventListener("change", () => (map.hidden = false), { once: true });
  /** @type {Partial<Record<Way, Promise<unknown>>>} */
  const loaded = {};
  const load = (/** @type {Way} */ name) => {
    const later = LATER[name];
    if (later) loaded[name] ||= Promise.all([later(), loadSheet("/static/arm_ways.css")]).then(([part]) => root.isConnected && part(page, page.get(`#arm-${name}`)));
  };
  const ways = tabs("Ways to move the arm", WAYS, (name) => {
    way = { of: opened, name };
    for (const panel of page.all("[role=tabpanel]")) panel.hidden = panel.id !== `arm-${name}`;
    load(name);
    page.tell("way", name);
  });
  page.get(".arm-right").prepend(ways.row);
  ways.show(way.of === opened ? way.name : "drive");
  mountParts(page);
  page.on("need", () => {
    if (!page.mine) return;
    jog ||= import("./arm_jog.js").then(({ mountJog }) => root.isConnected && mountJog(page));
    load("teach");
  });
  return page;
}

/**
 * What the parts of a page about joints share.
 * @param {HTMLElement} root
 * @param {Args} args
 * @param {number} opened `facts.opened` of what is shown
 */
export function makePage(root, args, opened) {
  /** @type {PageListeners} */
  const listeners = { draw: [], facts: [], speed: [], taught: [], need: [], way: [], run: [], elapsed: [] };
  let asked = 0; // what was taught
  /** @type {ArmPage} */
  const page = {
    root,
    args,
    view: null,
    plan: null, // the previewed motion
    mine: false, // has control, and knows what the arm does
    unready: "", // why the arm as a whole cannot be moved now
    speed: 0.3,
    hidden: 0, // how often the page was hidden
    lost: 0, // and how often it had no control
    step: 0, // degrees or millimetres of a click; 0: the arm moves while a button is held
    find: (selector) => root.querySelector(selector),
    get: (selector, kind) => required(root, selector, kind),
    all: (selector, kind) => all(root, selector, kind),
    on(name, act) {
      listeners[name].push(act);
    },
    tell(name, value) {
      for (const act of listeners[name]) act(value);
    },
    /** Ask the server; the answer has `error` if it refused. */
    call: (name, values = {}) => hexwire.call(name, values, opened).catch((error) => ({ error: whyOf(error) })),
    /** Show what was taught, or that it is being taught. */
    async tellTaught() {
      const mine = (asked += 1);
      const told = await page.call("arm.taught");
      // An older answer may come after a newer one.
      if (mine === asked && !isRefused(told)) page.tell("taught", told);
    },
    /** Begin a motion that lasts while this page is in sight; resolves with why it ended. */
    run(values) {
      return hexwire.hold("run", { speed: page.speed, ...values }, { attended: true });
    },
    /** What to hold for a joint: while it turns in a direction, or goes to an angle. */
    jog: (joint, turn) => ["joint", { directions: { [joint]: turn }, speed: page.speed }],
    drag: (joint, goal) => ["drag", { goals: { [joint]: goal }, speed: page.speed }],
    /** From now on, why what this page does in several motions is to end, as one that it holds would; empty if it may go on. */
    attend() {
      const stops = () => hexwire.frame?.stops ?? hexwire.facts?.stops ?? 0;
      const before = { stops: stops(), hidden: page.hidden, lost: page.lost };
      return () => {
        if (!root.isConnected) return "its page was left";
        if (document.hidden || page.hidden !== before.hidden) return "the page was hidden";
        if (!page.mine || page.lost !== before.lost) return "this page has no control, or nobody knows what the arm does";
        return stops() === before.stops ? "" : "stopped";
      };
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
  document.addEventListener("visibilitychange", function hides() {
    if (!root.isConnected) document.removeEventListener("visibilitychange", hides);
    else if (document.hidden) page.hidden += 1;
  });
  return page;
}

/**
 * The parts of Jog and go as tabs, where they are shown one at a time.
 * @param {ArmPage} page
 */
function mountParts(page) {
  const panel = page.get("#arm-drive"), parts = all(panel, "[data-part]");
  const there = Object.fromEntries(parts.map(({ dataset }) => [dataset.part, PARTS[/** @type {Part} */ (dataset.part)]]));
  const choice = tabs("Parts of Jog and go", /** @type {typeof PARTS} */ (there), (name) => {
    part = name;
    for (const one of parts) one.classList.toggle("arm-other", one.dataset.part !== name);
  });
  choice.row.classList.add("arm-parts");
  panel.prepend(choice.row);
  choice.show(part in there ? part : "joints");
}

/** @param {ArmPage} page */
async function mountView(page) {
  const element = page.find("#arm-view"), geometry = page.args.look ?? page.args.geometry;
  if (!element || !geometry) return;
  const { Arm3D } = await import("./arm3d.js");
  if (!element.isConnected) return;
  const view = (page.view = new Arm3D(element, geometry, { theme: "auto" }));
  view.setTable(page.args.table ?? null);
  view.setTip("own");
  const none = new Float32Array(page.args.joints.length);
  view.setJoints(none, []);
  const show = () => hexwire.frame && view.setJoints(hexwire.frame.position, hexwire.known ? hexwire.frame.known : []);
  page.on("draw", show);
  page.on("facts", show);
  for (const button of page.all("[data-view]")) button.addEventListener("click", () => view.resetView(button.dataset.view));
  const large = page.get("#arm-large"), part = page.get(".arm-view-part");
  large.addEventListener("click", () => {
    const now = part.classList.toggle("arm-large");
    large.setAttribute("aria-pressed", String(now));
  });
  const watch = setInterval(() => {
    if (element.isConnected) return;
    clearInterval(watch);
    view.dispose();
  }, 1000);
}

// -- speed, and what keeps the arm from moving -----------------------------------------------------------

/** @param {ArmPage} page */
function mountBar(page) {
  const speed = page.get("#arm-speed", HTMLInputElement);
  const value = page.get("#arm-speed-value");
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
  page.on("facts", (facts) => {
    const holds = facts.holder_tab !== "" && facts.holder_tab === hexwire.tab;
    page.mine = holds && hexwire.known;
    if (!page.mine) page.lost += 1;
    page.unready = facts.unready || (hexwire.known ? "" : "nobody knows what the arm does");
    for (const element of page.all(".arm-need")) element.toggleAttribute("disabled", !page.mine);
    for (const element of page.all(".arm-whole")) element.toggleAttribute("disabled", !page.mine || page.unready !== "");
    page.root.classList.toggle("arm-idle", !page.mine);
    let text = "";
    if (!page.mine) text = hexwire.operates ? "To move the arm, take control first." : "This page only watches.";
    else if (facts.torque === "off") text = "Torque is off: the arm does not move until it is on.";
    else if (facts.torque === "partly on") text = "Some joints have no torque and do not move.";
    hexwire.hint(text, page.root);
    page.tell("need", null);
  });
}

// -- the motion that runs ----------------------------------------------------------------------------------

/** @param {ArmPage} page */
function mountRun(page) {
  const bar = page.get("#arm-run-bar", HTMLProgressElement);
  const text = page.get("#arm-run-text");
  const end = page.get("#arm-run-end", HTMLButtonElement);
  /** @type {Run | null} */
  let run = null;
  let since = 0;
  const elapsed = (/** @type {Run} */ run) => Math.min(run.duration, run.elapsed + (run.outcome ? 0 : (performance.now() - since) / 1000));
  hexwire.onRun((told) => {
    run = told;
    since = performance.now();
    if (told.outcome) {
      const words = told.outcome !== "succeeded" ? told.text || told.outcome : told.holds ? "holds an object" : told.off ? `arrived, ${told.off}` : "arrived";
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
    const now = elapsed(run);
    bar.value = run.duration > 0 ? now / run.duration : 1;
    const words = `${capital(run.title)}: ${now.toFixed(1)} of ${run.duration.toFixed(1)} s`;
    if (text.textContent !== words) text.textContent = words;
    page.tell("elapsed", { run, now });
  });
  page.on("draw", () => {
    // Also while it follows a leader, which is no run.
    if (end.disabled === hexwire.attending) end.disabled = !hexwire.attending;
  });
  end.addEventListener("click", () => hexwire.release("ended"));
}

/**
 * A solution of the inverse kinematics in words: of the two of the wrist, one is turned over.
 * @param {string} name
 */
export const branchWords = (name) => name.replace(/,? ?wrist 1$/, "").replace("wrist 2", "wrist turned over") || "wrist as usual";

/**
 * What a plan comes to, in words, into an element.
 * @param {HTMLElement} element
 * @param {Plan | Refused} plan
 */
export function showPlan(element, plan) {
  element.dataset.level = "";
  if (isRefused(plan) || plan.refusal) {
    element.textContent = isRefused(plan) ? plan.error : capital(plan.refusal);
    element.dataset.level = "error";
    return;
  }
  const parts = [plan.duration < 0.001 ? "The arm is there already" : `Takes ${plan.duration.toFixed(1)} s`];
  if (plan.lead_in > 0.05) parts.push(`${plan.lead_in.toFixed(1)} s of it to the start`);
  if (plan.branch) parts.push(branchWords(plan.branch));
  element.textContent = parts.join("; ");
  if (plan.unready) {
    element.textContent += `. Not now: ${plan.unready}`;
    element.dataset.level = "warn";
  }
}

// -- joints and jog ------------------------------------------------------------------------------------------------

/** @param {ArmPage} page */
function mountJoints(page) {
  page.args.joints.forEach((joint, i) => {
    const row = page.find(`tr[data-joint="${CSS.escape(joint.name)}"]`);
    if (row) mountRow(page, row, joint, i);
  });
  for (const button of page.all(".arm-space .arm-jog", HTMLButtonElement)) {
    const tool = [0, 0, 0, 0, 0, 0];
    tool[Number(button.dataset.axis)] = Number(button.dataset.turn);
    hexwire.holdButton(button, "space", () => ({ tool, speed: page.speed }), { idle: () => page.step });
  }
}

/**
 * A joint's row: buttons, slider, values.
 * @param {ArmPage} page
 * @param {HTMLElement} row
 * @param {JointRange} joint
 * @param {number} i
 */
export function mountRow(page, row, joint, i) {
  const slider = required(row, ".arm-slider");
  const low = joint.min - OVER * (joint.max - joint.min);
  const high = joint.max + OVER * (joint.max - joint.min);
  const share = (/** @type {number} */ angle) => Math.min(1, Math.max(0, (angle - low) / (high - low)));
  row.style.setProperty("--colour", `var(--joint-${(i % 8) + 1})`);
  slider.style.setProperty("--low", String(share(joint.min)));
  slider.style.setProperty("--high", String(share(joint.max)));
  for (const button of all(row, ".arm-jog", HTMLButtonElement)) {
    const turn = Number(button.dataset.turn);
    const [kind] = page.jog(joint.name, turn);
    hexwire.holdButton(button, kind, () => page.jog(joint.name, turn)[1], { idle: () => page.step });
  }
  mountSlider(page, slider, joint, i, { low, high, share });
  drawRow(page, { slider, share, joint, i, row });
}

/**
 * @param {ArmPage} page
 * @param {{ slider: HTMLElement, share: (angle: number) => number, joint: JointRange, i: number, row: HTMLElement }} parts
 */
function drawRow(page, { slider, share, joint, i, row }) {
  const cell = (/** @type {string} */ name) => required(row, `[data-value="${name}"]`);
  const cells = { position: cell("position"), goal: cell("goal"), load: cell("load"), state: cell("state") };
  /** @type {Record<string, string>} */
  const shown = {};
  let spoken = 0;
  /** @type {(name: keyof typeof cells, text: string) => void} */
  const put = (name, text) => {
    if (shown[name] === text) return;
    shown[name] = text;
    cells[name].textContent = text;
    if (name === "state") cells.state.title = text; // it may be cut off
  };
  page.on("facts", () => {
    const known = page.knows(i);
    row.classList.toggle("arm-silent", !known);
    for (const button of all(row, ".arm-jog", HTMLButtonElement)) button.disabled = !page.mine || !known;
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
      slider.style.setProperty("--at", at || "0");
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

/**
 * @param {ArmPage} page
 * @param {HTMLElement} slider
 * @param {JointRange} joint
 * @param {number} i
 * @param {{ low: number, high: number, share: (angle: number) => number }} ends
 */
function mountSlider(page, slider, joint, i, { low, high, share }) {
  const aim = required(slider, ".arm-aim");
  /** @type {{ goal: number, told: number, timer: number } | null} */
  let drag = null;
  const angle = (/** @type {PointerEvent} */ event) => {
    const box = slider.getBoundingClientRect();
    const wanted = low + ((event.clientX - box.left) / box.width) * (high - low);
    return Math.min(joint.max, Math.max(joint.min, wanted));
  };
  const mark = (/** @type {number | null} */ goal) => {
    aim.hidden = goal === null;
    if (goal !== null) slider.style.setProperty("--aim", String(share(goal)));
  };
  /** @type {(mine: typeof drag, why: string) => void} */
  const over = (mine, why) => {
    if (drag === mine) drag = null;
    mark(null);
    slider.classList.remove("hw-held");
    if (why !== "released") hexwire.say(why);
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
    hexwire.hold(...page.drag(joint.name, mine.goal), { element: slider }).then((why) => over(mine, why));
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
      hexwire.update(page.drag(joint.name, mine.goal)[1]);
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
    hexwire.hold(...page.jog(joint.name, turn), { element: slider }).then((why) => {
      key = "";
      over(null, why);
    });
  });
  slider.addEventListener("keyup", (event) => event.key === key && hexwire.release());
  slider.addEventListener("blur", () => (drag || key) && hexwire.release());
  slider.addEventListener("contextmenu", (event) => event.preventDefault());
}

// -- the tip ---------------------------------------------------------------------------------------------------------

/**
 * @param {number[]} first
 * @param {number[]} second
 */
function times([a, b, c, d], [x, y, z, w]) {
  return [d * x + a * w + b * z - c * y, d * y - a * z + b * w + c * x, d * z + a * y - b * x + c * w, d * w - a * x - b * y - c * z];
}

/**
 * @param {number[]} turn
 * @param {number[]} place
 */
function turned([a, b, c, d], [x, y, z]) {
  const [u, v, w] = [2 * (b * z - c * y), 2 * (c * x - a * z), 2 * (a * y - b * x)];
  return [x + d * u + b * w - c * v, y + d * v + c * u - a * w, z + d * w + a * v - b * u];
}

/**
 * Position in metres and quaternion x, y, z, w of the tip at joint positions in radians.
 * @param {Geometry} geometry
 * @param {ArrayLike<number>} positions
 */
export function tipOf(geometry, positions) {
  /** @type {{ position: number[], quaternion: number[] }[]} */
  const frames = [];
  for (const link of geometry.links) {
    let turn = link.turn;
    if (link.axis) {
      const half = (link.multiplier * positions[link.joint] + link.offset) / 2;
      const [x, y, z] = link.axis.map((value) => value * Math.sin(half));
      turn = times(turn, [x, y, z, Math.cos(half)]);
    }
    const parent = frames[link.parent];
    if (!parent) frames.push({ position: link.place, quaternion: turn });
    else {
      const place = turned(parent.quaternion, link.place);
      frames.push({ position: place.map((value, k) => value + parent.position[k]), quaternion: times(parent.quaternion, turn) });
    }
  }
  return frames[geometry.tip];
}

/**
 * Roll, pitch and yaw about the base's fixed axes of a quaternion, radians; at a pitch of a quarter turn, roll is 0.
 * @param {number[]} quaternion
 */
export function rpyOf([x, y, z, w]) {
  const row = [1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)]; // first column of the rotation
  const cosine = Math.hypot(row[0], row[1]);
  const pitch = Math.atan2(-row[2], cosine);
  if (cosine < GIMBAL) return [0, pitch, Math.atan2(-2 * (x * y - z * w), 1 - 2 * (x * x + z * z))];
  return [Math.atan2(2 * (y * z + x * w), 1 - 2 * (x * x + y * y)), pitch, Math.atan2(row[1], row[0])];
}

/**
 * Values of the tip by name: x, y, z in metres, angles in radians.
 * @param {{ geometry: Geometry, turns?: ArmValues["turns"] }} args
 * @param {ArrayLike<number>} positions
 */
export function tipValues(args, positions) {
  const { position, quaternion } = tipOf(args.geometry, positions);
  const [roll, pitch, yaw] = rpyOf(quaternion);
  /** @type {Record<string, number>} */
  const values = { x: position[0], y: position[1], z: position[2], roll, pitch, yaw };
  (args.turns || []).forEach(({ offset, factors }, k) => {
    const sum = Object.entries(factors).reduce((total, [i, factor]) => total + factor * positions[Number(i)], offset);
    values[k ? "toolroll" : "toolpitch"] = sum;
  });
  return values;
}

/** @param {ArmPage} page */
function mountTip(page) {
  const cells = page.all("[data-tip]"), { geometry, turns } = page.args;
  if (!geometry || !cells.length) return;
  page.on("draw", () => {
    const positions = page.positions();
    if (!positions) return;
    const values = tipValues({ geometry, turns }, positions);
    for (const cell of cells) {
      const name = cell.dataset.tip ?? "";
      const text = name.length === 1 ? fixed(1000 * values[name]) : fixed(degrees(values[name]));
      if (cell.textContent !== text) cell.textContent = text;
    }
  });
}

// -- what is drawn -----------------------------------------------------------------------------------------------

/** @param {ArmValues} args */
function markup({ joints, space, jaws, geometry, look, emulated }) {
  return html`<div class="arm-page">
<div class="arm-bar">
  <label for="arm-speed">Speed</label>
  <input id="arm-speed" type="range" min="1" max="100" value="30" step="1" aria-describedby="arm-speed-value">
  <output id="arm-speed-value" for="arm-speed">30 %</output>
  ${stepsMarkup()}
  <label class="arm-keys"><input type="checkbox" id="arm-keys" class="arm-need"> Keys</label>
  <button class="hw-button arm-help" id="arm-map" type="button" aria-label="Map of the keys" title="Map of the keys (?)" hidden>?</button>
  <label class="arm-pad"><input type="checkbox" id="arm-pad" class="arm-need"> Gamepad</label>
  <button class="hw-button arm-help" id="arm-pad-map" type="button" aria-label="Mapping of the gamepad" title="Mapping of the gamepad" hidden>⚙</button>
</div>
<div class="arm-left">${viewMarkup(look ?? geometry, space, emulated)}</div>
<div class="arm-right"><div class="arm-panel" id="arm-drive" role="tabpanel" aria-label="${WAYS.drive}">
  ${jointsMarkup(joints)}${space && spaceMarkup()}${jaws && gripperMarkup()}${gotoMarkup(joints, space)}${posesMarkup(jaws)}</div>
  ${Object.entries(WAYS).slice(1).map(([name, words]) => html`<section class="arm-part" id="arm-${name}" role="tabpanel" aria-label="${words}" hidden></section>`)}</div>
</div>`;
}

/** Whether a button moves while it is held, or makes a step. */
export function stepsMarkup(unit = "° or mm") {
  return html`<fieldset class="hw-segments"><legend>Jog</legend>
    ${[["0", "while held"], ["0.1", "0.1"], ["1", "1"], ["10", "10"]].map(([value, words]) => html`<label><input type="radio" name="step"
      value="${value}" ${value === "0" ? "checked" : "disabled"} aria-label="${value === "0" ? words : `steps of ${words} degrees or millimetres`}"><span>${words}</span></label>`)}
    <span class="arm-unit">${unit}</span></fieldset>`;
}

/**
 * @param {Geometry | null} geometry
 * @param {number | null} space
 * @param {string} emulated
 */
function viewMarkup(geometry, space, emulated) {
  return html`<section class="arm-part arm-view-part" aria-label="View and motion">
  ${geometry ? html`<div class="arm-view" id="arm-view"></div>
    <div class="arm-camera" role="toolbar" aria-label="Camera">${["home", "front", "side", "top", "tip"].map((name) => html`<button
      type="button" data-view="${name}" title="Look from ${name === "tip" ? "nearby at the tip" : name === "home" ? "the usual place" : `the ${name}`}">${capital(name)}</button>`)}
      <button type="button" id="arm-large" aria-pressed="false" title="As large as the window" aria-label="Large view">⤢</button>
      <button type="button" id="arm-camera" title="Show a camera below">Camera</button></div>` : html`<p class="arm-note">The lengths of this arm are unknown,
    so it has no 3D view, no tip, and no jog in space.</p>`}
  <div class="arm-cameras" id="arm-cameras"></div>
  ${space && tipMarkup(space)}
  <div class="arm-run" id="arm-run">
    <progress id="arm-run-bar" max="1" value="0" aria-label="Progress of the motion"></progress>
    <span id="arm-run-text" role="status">No motion</span>
    <button class="hw-button" id="arm-run-end" type="button" disabled>End motion</button>
  </div>
</section>
${emulated && html`<p class="arm-note arm-emulated">${emulated}</p>`}`;
}

/** @param {JointRange[]} joints */
export function jointsMarkup(joints) {
  return html`<section class="arm-part" data-part="joints" aria-labelledby="arm-joints-title">
  <div class="arm-head"><h2 id="arm-joints-title">Joints</h2>
    <p class="arm-note">Hold − or +, drag a marker, or hold an arrow key on it.</p></div>
  <table class="arm-joints">
    <thead><tr>
      <th scope="col">Joint</th><th scope="col">Jog and drag</th>
      <th scope="col" class="arm-number">Position&nbsp;°</th>
      <th scope="col" class="arm-number arm-wide">Goal&nbsp;°</th>
      <th scope="col" class="arm-number arm-wide">Load&nbsp;%</th><th scope="col" class="arm-wide">State</th>
    </tr></thead>
    <tbody>${joints.map(jointMarkup)}</tbody>
  </table>
</section>`;
}

/** @param {JointRange} joint */
export function jointMarkup({ name, min, max }) {
  const [low, high] = [min, max].map((angle) => String(Number(degrees(angle).toFixed(1)) || 0));
  return html`<tr data-joint="${name}">
  <th scope="row"><span class="arm-swatch"></span>${name}</th>
  <td><div class="arm-drive">
    <button class="hw-button arm-jog arm-need" type="button" data-turn="-1" aria-label="Jog ${name} down">−</button>
    <div class="arm-slider arm-unknown" role="slider" tabindex="0" aria-label="${name}" aria-orientation="horizontal"
      aria-valuemin="${low}" aria-valuemax="${high}" aria-valuenow="0" aria-valuetext="unknown">
      <span class="arm-track"></span><span class="arm-aim" hidden></span><span class="arm-thumb"></span>
      <span class="arm-end arm-low">${low.replace("-", "−")}</span><span class="arm-end arm-high">${high.replace("-", "−")}</span>
    </div>
    <button class="hw-button arm-jog arm-need" type="button" data-turn="1" aria-label="Jog ${name} up">+</button>
  </div></td>
  <td class="arm-number" data-value="position">–</td><td class="arm-number arm-wide" data-value="goal">–</td>
  <td class="arm-number arm-wide" data-value="load">–</td><td class="arm-wide" data-value="state">–</td>
</tr>`;
}

/**
 * The pose of the tip; an arm of five joints aims its tool by pitch and roll.
 * @param {number} space
 */
export function tipMarkup(space) {
  const turns = space === 5 ? [["toolpitch", "pitch"], ["toolroll", "roll"]] : [["roll", "roll"], ["pitch", "pitch"], ["yaw", "yaw"]];
  const rows = [...["x", "y", "z"].map((axis) => [axis, axis, "mm"]), ...turns.map((turn) => [...turn, "°"])];
  return html`<dl class="arm-tip hw-live" aria-label="Tip">${rows.map(([key, words, unit]) => html`<div><dt>${words} <span class="arm-unit">${unit}</span></dt>
    <dd data-tip="${key}">–</dd></div>`)}</dl>`;
}

function spaceMarkup() {
  /** @type {(place: number, turn: number, label: string) => object} */
  const press = (place, turn, label) => html`<button class="hw-button arm-jog arm-need arm-whole" type="button"
    data-axis="${place}" data-turn="${turn}" aria-label="${label}, ${turn > 0 ? "plus" : "minus"}">${turn > 0 ? "+" : "−"}</button>`;
  /** @type {(what: string, words: string, first: number) => object} */
  const group = (what, words, first) => html`<div class="arm-axes" role="group" aria-label="${words}">
    <span class="arm-axes-name">${words}</span>${["x", "y", "z"].map((axis, i) => html`<span class="arm-axis arm-axis-${axis}">
      ${press(first + i, -1, `${words} ${what} ${axis}`)}<span>${axis}</span>${press(first + i, 1, `${words} ${what} ${axis}`)}</span>`)}</div>`;
  return html`<section class="arm-part" data-part="space" aria-labelledby="arm-space-title">
  <div class="arm-head"><h2 id="arm-space-title">Jog in space</h2><p class="arm-note">In the axes of the base.</p></div>
  <div class="arm-space">${group("along", "Move", 0)}${group("about", "Turn", 3)}</div>
</section>`;
}
