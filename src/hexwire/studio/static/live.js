// The tab's own socket: frames of state in; signs of life, holds, stops and calls out, their answers in; and the header,
// which shows what is always in sight. Needs no other module, so that STOP works while all else hangs. The bytes of a frame
// are described in studio/frames.py.

const BEAT = 60; // ms between two signs of life while something is held
const SEEN = 10; // frames after which the server hears that they were seen; it sends only so many ahead
const SURE = 300; // ms in which a stop is confirmed; after them it is sent again, by HTTP
const HEARD = 750; // ms without a word of the studio after which nothing is known; it says something four times a second
const LOOK = 150; // ms between two looks at that: what is not known is grey within a second
const READ = 8000; // ms for which a message stays in sight
/** Bits of a joint, as `JointFlag`. The server sets `silent` for every joint of which nobody knows what it does now. */
export const FLAG = { voltage: 1, encoder: 2, temperature: 4, current: 8, clamped: 16, overload: 32, torque: 64, silent: 128, unknown: 256 };
const FAULTS = /** @type {const} */ (["voltage", "encoder", "temperature", "current", "overload", "silent"]);

const meta = (/** @type {string} */ name) => required(document, `meta[name="hexwire-${name}"]`, HTMLMetaElement).content;
const key = meta("tab");
/** @type {Listeners} */
const listeners = { frame: new Set(), facts: new Set(), hello: new Set(), news: new Set(), run: new Set(), link: new Set(), servos: new Set(), wave: new Set(), range: new Set(), steps: new Set(), leader: new Set(), first: new Set() };
/**
 * What was asked for by a call, and has no answer yet.
 * @type {Map<number, { resolve: (value: any) => void, reject: (error: Error) => void }>}
 */
const answers = new Map();
/** @type {NothingOpen} */
const NOTHING = { mode: "none", opened: 0, opening: "", open_error: "", refused: "" };
let calls = 0;
/** @type {WebSocket | null} */
let socket = null;
let retry = 200;
/** @type {Held | null} */
let held = null;
let number = 0;
let stopConfirmed = 0;
let stopsAsked = Math.floor(5e8 * Math.random()); // a copy of this page has other numbers
let told = { text: "", until: 0, urgent: false };
let hinted = { text: "", element: document.body }; // of the page that is shown
let lasted = "";
let seen = 0;
let wasKnown = true;
let hadControl = false;
let leaving = false; // it was given back here
/** @type {LeaderTold | null} */
let leader = null; // what was said last
/** @type {{ told: Run, at: number } | null} */
let run = null; // the motion that goes on, and when that was said
let stranger = false; // the studio that answers at this address has not this page's session
let heard = -Infinity; // when the studio said something last

/** @type {Hexwire} */
const hexwire = {
  model: { kind: "hello", tab: "", right: 0, robot: "", joints: [], space: false },
  facts: null,
  frame: null,
  tab: "",
  get connected() {
    return socket !== null && socket.readyState === WebSocket.OPEN;
  },
  /** Whether this page may be given control. */
  operates: Number(meta("right")) > 1,
  key,
  /** Whether this page still hears the studio, which may hang although the connection is there. */
  get heard() {
    return hexwire.connected && performance.now() - heard < HEARD;
  },
  /** Whether what is shown is from now: the studio says so, and this page still hears it. */
  get known() {
    const { facts } = hexwire;
    if (!facts || !hexwire.heard) return false;
    return facts.known || (facts.mode !== "arm" && facts.mode !== "bus");
  },
  get holding() {
    return held !== null;
  },
  /** Whether it holds what lasts while this page is in sight, without a pressed button. */
  get attending() {
    return held !== null && held.attended;
  },
  onFrame: listener("frame"),
  onFacts: (call, element) => {
    const end = listener("facts")(call, element);
    if (hexwire.facts) call(hexwire.facts);
    return end;
  },
  onHello: (call, element) => {
    const end = listener("hello")(call, element);
    if (hexwire.model.joints.length) call(hexwire.model);
    return end;
  },
  onNews: listener("news"),
  onRun: (call, element) => {
    const end = listener("run")(call, element);
    if (run) call({ ...run.told, elapsed: run.told.elapsed + (performance.now() - run.at) / 1000 });
    return end;
  },
  onLink: listener("link"),
  onServos: listener("servos"),
  onWave: listener("wave"),
  onRange: listener("range"),
  onFirst: listener("first"),
  onSteps: listener("steps"),
  onLeader: (call, element) => {
    const end = listener("leader")(call, element);
    if (leader) call(leader);
    return end;
  },
  call,
  act,
  hold,
  update,
  release,
  holdButton,
  stop,
  say,
  hint,
  notify,
};
export default hexwire;

/** What the bits of a joint say is wrong with it, in words. */
export const faultsOf = (/** @type {number} */ flags) => FAULTS.filter((name) => flags & FLAG[name]);
window.hexwire = hexwire;

/**
 * The element that a selector finds, where a page without it is broken.
 * @type {Find}
 */
export function required(root, selector, kind) {
  const [found] = all(root, selector, kind);
  if (found) return found;
  throw new Error(`the page has no ${selector}`);
}

/**
 * All elements of a kind that a selector finds.
 * @template {Element} [E=HTMLElement]
 * @param {ParentNode} root
 * @param {string} selector
 * @param {Kind<E>} [kind]
 */
export function all(root, selector, kind) {
  return /** @type {E[]} */ ([...root.querySelectorAll(selector)].filter((each) => each instanceof (kind ?? HTMLElement)));
}

// -- listeners -----------------------------------------------------------------------------------------

/**
 * @template {keyof Told} K
 * @param {K} kind
 * @returns {Listen<K>}
 */
function listener(kind) {
  return (call, element) => {
    const row = { call, element };
    listeners[kind].add(row);
    return () => listeners[kind].delete(row);
  };
}

/**
 * @template {keyof Told} K
 * @param {K} kind
 * @param {Told[K]} value
 */
function tell(kind, value) {
  for (const row of listeners[kind]) {
    if (row.element && !row.element.isConnected) {
      listeners[kind].delete(row);
      continue;
    }
    try {
      row.call(value);
    } catch (error) {
      console.error(error);
    }
  }
}

// -- the socket ----------------------------------------------------------------------------------------

function open() {
  const scheme = location.protocol === "https:" ? "wss" : "ws";
  const mine = new WebSocket(`${scheme}://${location.host}/live?tab=${encodeURIComponent(key)}`);
  mine.binaryType = "arraybuffer";
  socket = mine;
  let opened = false;
  mine.onopen = () => {
    opened = true;
    stranger = false;
    retry = 200;
    seen = 0;
    tell("link", true);
  };
  mine.onmessage = (event) => {
    heard = performance.now();
    if (typeof event.data === "string") receive(JSON.parse(event.data));
    else draw(event.data);
  };
  mine.onclose = (event) => {
    if (socket !== mine) return;
    socket = null;
    ended("the connection to the studio was lost");
    for (const { reject } of answers.values()) reject(new Error("the connection to the studio was lost"));
    answers.clear();
    tell("link", false);
    if (event.code === 4404) {
      location.reload(); // the server has forgotten this page
      return;
    }
    if (!opened) {
      fetch("/static/studio.css", { cache: "no-store" }).then(
        ({ status }) => {
          stranger = status === 401;
          header(hexwire.facts || NOTHING);
        },
        () => {},
      );
    }
    setTimeout(open, retry);
    retry = Math.min(2 * retry, 3000);
  };
}

/** @param {object} message */
function send(message) {
  if (socket?.readyState !== WebSocket.OPEN) return false;
  socket.send(JSON.stringify(message));
  return true;
}

/** @param {Message} message */
function receive(message) {
  if (message.kind === "hello") {
    hexwire.model = message;
    hexwire.frame = null; // that of another arm counts other stops
    run = null;
    hexwire.tab = message.tab || hexwire.tab;
    tell("hello", message);
  } else if (message.kind === "facts") {
    hexwire.facts = message;
    tell("facts", message);
  } else if (message.kind === "ended") {
    if (held && held.number === message.id) ended(message.why, message.fine);
  } else if (message.kind === "answer") {
    const asked = answers.get(message.id);
    answers.delete(message.id);
    if ("error" in message) asked?.reject(new Error(message.error));
    else asked?.resolve(message.value);
  } else if (message.kind === "stopping") {
    stopConfirmed = performance.now();
  } else if (message.kind !== "held" && message.kind in listeners) {
    if (message.kind === "leader") leader = message;
    if (message.kind === "run") run = message.outcome ? null : { told: message, at: performance.now() };
    tell(message.kind, message);
  }
}

/** @param {ArrayBuffer} bytes */
function draw(bytes) {
  seen += 1;
  if (seen % SEEN === 0) send({ do: "seen", frames: seen });
  const view = new DataView(bytes);
  if (view.getUint8(0) !== 2) return; // 0: a sign of life
  const n = view.getUint8(1);
  const bits = view.getUint16(2, true);
  const column = (/** @type {number} */ i) => new Float32Array(bytes, 16 + 4 * n * i, n);
  const position = column(0), flags = new Uint16Array(bytes, 16 + 4 * n * 7, n);
  const frame = {
    time: view.getFloat64(8, true),
    joints: hexwire.model.joints.map((joint) => joint.name),
    stops: view.getUint32(4, true),
    stopped: Boolean(bits & 1),
    tripped: Boolean(bits & 2),
    maintenance: Boolean(bits & 4),
    held: Boolean(bits & 16),
    position,
    velocity: column(1),
    load: column(2),
    current: column(3),
    voltage: column(4),
    temperature: column(5),
    goal: column(6),
    flags,
    known: Array.from(flags, (bits, i) => !(bits & FLAG.silent) && Number.isFinite(position[i])),
  };
  hexwire.frame = frame;
  tell("frame", frame);
}

// -- calls ---------------------------------------------------------------------------------------------

/**
 * Nothing is kept for later: without a connection it is refused.
 * @type {Ask}
 */
function call(name, args = {}, opened = null) {
  const id = (calls += 1);
  return new Promise((resolve, reject) => {
    if (send({ do: "call", id, name, args, opened })) answers.set(id, { resolve, reject });
    else reject(new Error("No connection to the studio: nothing was done"));
  });
}

/**
 * As `call`, for what a person has pressed: what is refused is told.
 * @type {Act}
 */
function act(name, args = {}, opened = null) {
  return call(name, args, opened).catch((error) => {
    notify(error.message, "error");
    return undefined;
  });
}

// -- holds ---------------------------------------------------------------------------------------------

/** @type {Hexwire["hold"]} */
function hold(kind, args, options = {}) {
  release();
  number += 1;
  const stops = hexwire.frame ? hexwire.frame.stops : hexwire.facts?.stops || 0;
  return new Promise((settle) => {
    const mine = (held = { number, settle, attended: Boolean(options.attended), element: options.element || null, timer: 0 });
    // With what is held by now: a change that was sent before the motion began was in vain.
    if (send({ do: "hold", id: number, kind, args, stops })) mine.timer = setInterval(beat, BEAT);
    else ended("there is no connection to the studio");
  });
}

function beat() {
  if (!held) return;
  const { element } = held;
  // Not every browser says so: what was pressed is gone with its page, and nobody can let go of it any more.
  if (element && (!element.isConnected || ("disabled" in element && element.disabled))) release("what was pressed is gone");
  else send({ do: "beat", id: held.number, args: held.args });
}


/** @type {Hexwire["update"]} */
function update(args) {
  if (!held) return;
  held.args = args;
  send({ do: "beat", id: held.number, args });
}

function release(why = "released") {
  if (!held) return;
  send({ do: "release", id: held.number });
  ended(why, why === "released");
}

/**
 * `fine`: it ended as it was asked for, which is no news for the bar of alarms.
 * @param {string} why
 */
function ended(why, fine = false) {
  if (!held) return;
  clearInterval(held.timer);
  held.fine = fine;
  const { settle } = held;
  held = null;
  settle(why);
}

/**
 * Let a button hold a motion while it is pressed; not while `options.idle` says that it does something else.
 * @type {Hexwire["holdButton"]}
 */
function holdButton(element, kind, args, options = {}) {
  const begin = () => {
    const over = hold(kind, typeof args === "function" ? args() : args, { ...options, element });
    const mine = held;
    element.classList.add("hw-held");
    over.then((why) => {
      element.classList.remove("hw-held");
      if (options.onEnd) options.onEnd(why);
      if (!mine?.fine) say(why);
    });
  };
  element.addEventListener("pointerdown", (event) => {
    if (event.button !== 0 || element.disabled || options.idle?.()) return;
    element.setPointerCapture(event.pointerId);
    begin();
  });
  // The press of a second button takes the focus from the first after its own hold has begun.
  const letGo = () => held && held.element === element && release();
  for (const name of ["pointerup", "pointercancel", "lostpointercapture"]) element.addEventListener(name, letGo);
  element.addEventListener("keydown", (event) => {
    if (event.repeat || (event.key !== " " && event.key !== "Enter") || element.disabled || options.idle?.()) return;
    event.preventDefault();
    begin();
  });
  element.addEventListener("keyup", (event) => {
    if (event.key === " " || event.key === "Enter") letGo();
  });
  element.addEventListener("blur", letGo);
  element.addEventListener("contextmenu", (event) => event.preventDefault());
}

window.addEventListener("blur", () => held && !held.attended && release("the page lost the focus"));
document.addEventListener("visibilitychange", () => document.hidden && release("the page is hidden"));
window.addEventListener("pagehide", () => release("the page was closed"));

// -- stop ----------------------------------------------------------------------------------------------

function stop() {
  const asked = performance.now();
  const id = (stopsAsked += 1);
  if (send({ do: "stop", id })) {
    setTimeout(() => stopConfirmed < asked && stopByRequest(id), SURE);
  } else {
    stopByRequest(id);
  }
  ended("stopped");
}

// With the number of the stop: what the server has heard already is not a second one, which would undo a Resume.
/** @param {number} id */
function stopByRequest(id) {
  fetch(`/stop?${new URLSearchParams({ tab: key, id: String(id) })}`, { method: "POST", keepalive: true }).then(
    (answer) => answer.ok || say("STOP was refused: switch the arm's power off", true),
    () => say("STOP did not reach the studio: switch the arm's power off", true),
  );
}

document.addEventListener(
  "keydown",
  (event) => {
    if (event.key === "Escape") stop();
  },
  { capture: true },
);
/** @param {Event} event */
const onStop = ({ target }) => target instanceof Element && target.closest("#hw-stop");
document.addEventListener(
  "pointerdown",
  (event) => {
    if (onStop(event)) stop();
  },
  { capture: true },
);
document.addEventListener(
  "click",
  (event) => {
    // detail 0: by keyboard or by a screen reader; a pointer has stopped the arm already.
    if (event.detail === 0 && onStop(event)) stop();
  },
  { capture: true },
);

// -- the header ----------------------------------------------------------------------------------------

/**
 * Show a message for a while, beside what lasts; an urgent one before it, whatever changes meanwhile.
 * @param {string} text
 */
function say(text, urgent = false) {
  if (told.urgent && !urgent && performance.now() < told.until) return;
  told = { text: capital(text), until: performance.now() + READ, urgent };
  header(hexwire.facts || NOTHING);
}

/**
 * What a person has to do first, while an element is on the page and nothing else is to be said.
 * @type {Hexwire["hint"]}
 */
function hint(text, element) {
  if (hinted.text === text && hinted.element === element) return;
  hinted = { text, element };
  header(hexwire.facts || NOTHING);
}

export const capital = (/** @type {string} */ words) => words.charAt(0).toUpperCase() + words.slice(1);

/**
 * @param {string} lasting
 * @param {string} note
 */
function banner(lasting, note) {
  const element = document.getElementById("hw-banner");
  if (!element) return;
  if (lasted !== lasting) {
    lasted = lasting;
    if (!told.urgent) told.until = 0; // it was about what was before
  }
  const news = performance.now() < told.until ? told.text : "";
  const parts = told.urgent ? [news, lasting] : [lasting, news];
  const text = parts.filter(Boolean).join(". ") || note;
  // Red is for what lasts until somebody does something about it.
  element.dataset.level = lasting || (news && told.urgent) ? "error" : "warn";
  if (element.textContent === text) return;
  // What is said leads to where it is mended.
  const [words, page] = text.split(/(?=First run$)/);
  element.replaceChildren(words);
  if (page) element.append(Object.assign(document.createElement("a"), { href: "/first", textContent: page }));
}

/**
 * @param {string} name
 * @param {string} text
 */
function put(name, text, level = "") {
  const element = document.getElementById(`hw-fact-${name}`);
  if (!element) return;
  if (element.textContent !== text) element.textContent = element.title = text; // it may be cut off
  element.dataset.level = level;
}

/**
 * The line of the header: what is open, and the one thing about it that matters most.
 * @param {Facts} facts
 * @param {Record<"arm" | "bus" | "link" | "known" | "mine", boolean>} is
 */
function brief(facts, { arm, bus, link, known, mine }) {
  const name = !link ? "No connection" : facts.opening ? "Opening …" : arm ? (bus ? "Servo bus" : facts.robot ?? "") : "No arm";
  const faults = arm && known && facts.faults ? facts.faults : [];
  let words = "", level = "";
  if (!link) words = "to the studio", level = "error";
  else if (!arm) words = facts.opening || "nothing is open";
  else if (!facts.connected) words = "not connected", level = "error";
  else if (!known) words = "not known now", level = "warn";
  else if (facts.stopped) words = "stopped", level = "error";
  else if (faults.length) words = faults.join("; "), level = "error";
  else words = [`torque ${facts.torque}`, !mine && facts.holder ? `${facts.holder} has control` : ""].filter(Boolean).join(" · ");
  for (const [id, text] of [["hw-name", name], ["hw-brief", words]]) {
    const element = required(document, `#${id}`);
    if (element.textContent !== text) element.textContent = element.title = text;
    if (id === "hw-brief") element.dataset.level = level;
  }
  required(document, "#hw-dot").dataset.level = level || (arm && facts.torque === "on" ? "ok" : "");
}

/**
 * @param {string} name
 * @param {boolean} so
 */
function show(name, so) {
  const element = document.getElementById(`hw-${name}`);
  if (element) element.hidden = !so;
}

/**
 * Of when what is shown in grey is.
 * @param {Facts} facts
 */
function since(facts) {
  const last = hexwire.heard ? 1000 * (facts.last ?? 0) : performance.timeOrigin + heard;
  if (!(last > 0)) return "";
  return `. What is grey is from ${new Date(last).toLocaleTimeString([], { hourCycle: "h23" })}`;
}

/** @param {Facts} facts */
function header(facts) {
  const bus = facts.mode === "bus";
  const arm = facts.mode === "arm" || bus;
  const link = hexwire.connected;
  const where = facts.opening ? `opening ${facts.opening}` : arm ? `${facts.robot} ${facts.url}` : "nothing open";
  if (!link) put("connection", "no connection to the studio", "error");
  else if (arm && !facts.connected) put("connection", `lost: ${facts.error}`, "error");
  else put("connection", where, arm ? "ok" : "");
  put("dialect", arm && facts.dialect ? String(facts.dialect) : "–");
  const known = hexwire.known;
  document.body.classList.toggle("hw-unknown", !known);
  if (wasKnown !== known) {
    wasKnown = known;
    if (hexwire.facts) tell("facts", hexwire.facts);
  }
  put("rate", bus ? (facts.baud ? `${facts.baud} baud` : "–") : arm && facts.rate !== null ? `${facts.rate.toFixed(0)} Hz` : "–");
  put("trip", arm && facts.round_trip_ms !== null ? `${facts.round_trip_ms.toFixed(1)} ms` : "–");
  const faults = arm ? facts.faults : null;
  put("faults", faults ? faults.join("; ") || "none" : "–", faults && faults.length ? "error" : "");
  const mine = arm && facts.holder_tab !== "" && facts.holder_tab === hexwire.tab;
  put("holder", arm ? (mine ? "this page" : facts.holder || "nobody") : "–", mine ? "ok" : "");
  put("torque", arm ? facts.torque : "–", known && arm && facts.torque === "on" ? "ok" : "");
  brief(facts, { arm, bus, link, known, mine });
  const lost = hadControl && !mine && !leaving && link && arm;
  hadControl = mine;
  leaving &&= mine;
  if (lost) say(facts.holder ? `This page has lost control: ${facts.holder} has it` : "This page has lost control");
  show("take", link && arm && !mine && hexwire.operates);
  show("leave", link && mine);
  show("resume", link && mine && known && facts.stopped !== "");
  show("torque-on", link && mine && known && facts.stopped === "" && facts.torque !== "on");
  show("torque-off", link && mine && facts.torque !== "off");
  show("limp", link && mine && facts.torque !== "off");
  document.body.classList.toggle("hw-stopped", arm && facts.stopped !== "");
  let lasting = "";
  // What to do comes first: on a phone, what is at the end may be out of sight.
  if (!link && stranger) lasting = "The studio does not know this page any more, perhaps since it was started again: open its new address. STOP may be refused: switch the arm's power off";
  else if (!link) lasting = `No connection to the studio: switch the arm's power off. STOP will try another way${since(facts)}`;
  else if (!hexwire.heard && since(facts)) lasting = `The studio does not answer: switch the arm's power off. STOP will be tried${since(facts)}`;
  else if (arm && !facts.connected) lasting = `${bus ? "The servo bus cannot be read" : "The arm is not connected"}: ${facts.error}${since(facts)}`;
  else if (facts.mode === "arm" && !known) lasting = `The arm is silent: it may do anything. STOP will be tried${since(facts)}`;
  else if (arm && facts.stopped) lasting = `Stopped: ${facts.stopped}`;
  const note = facts.note || (facts.uncalibrated ? `The arm is ${facts.uncalibrated}; see First run` : "");
  banner(lasting, (facts.mode === "arm" && capital(facts.unready)) || note || (hinted.element.isConnected ? hinted.text : ""));
}

hexwire.onFacts(header);
hexwire.onNews((news) => say(news.text, news.level === "error"));
hexwire.onLink(() => header(hexwire.facts || NOTHING));

const torqueOff = () => act("torque", { on: false });
const BUTTONS = { take: () => act("take"), leave: () => act("leave"), resume: () => act("resume"), "torque-on": () => act("torque", { on: true }), "torque-off": torqueOff, limp: torqueOff };
for (const [id, ask] of Object.entries(BUTTONS)) {
  required(document, `#hw-${id}`).addEventListener("click", () => {
    leaving ||= id === "leave";
    ask();
  });
}

/**
 * Show for a while, above everything but in nobody's way, what has become of what was asked for.
 * @param {string} text
 */
function notify(text, level = "") {
  const told = Object.assign(document.createElement("p"), { textContent: text });
  told.dataset.level = level;
  required(document, "#hw-notices").append(told);
  setTimeout(() => told.remove(), READ);
}

// Facts are told only when they change; that the studio is heard no more is not told at all.
setInterval(() => hexwire.facts && header(hexwire.facts), LOOK);
open();
