/* Teach and play on the page Move: the arm is moved by hand, and what was taught, or a recording, is a timeline of curves of its
joints, of which a part is played: smoothed, at another speed, several times, from where the cursor is.

Owns what is chosen and where the cursor is, which shows a ghost of the arm and moves nothing. Each round is one motion that this
page holds, planned and checked by the server like every other; so it ends when the page is hidden, and STOP voids the rounds that
are left. A recording is changed by nothing but saving, as a new one unless somebody agrees to replace it. */

import { isRefused, showPlan } from "./arm.js";
import { question } from "./forms.js";
import hexwire, { capital } from "./live.js";
import { fill, html, node } from "./widgets.js";

const PAUSE = 150; // ms after the last change before a preview is asked for
const AGAIN = 2000; // ms until another look, when there was an error instead of a plan
const PAD = 6;
const STEP = 0.1; // seconds of an arrow key on a handle
const LEAP = 10; // times that with shift, or page up and down
const TICK = 70; // pixels between two times, at least
const TICKS = [0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 60, 120, 300, 600]; // seconds
/** @type {Record<string, number>} */
const KEYS = { ArrowRight: 1, ArrowUp: 1, ArrowLeft: -1, ArrowDown: -1, PageUp: LEAP, PageDown: -LEAP };
const LEAST = 0.02; // seconds between the handles
const FINE = ["arrived", "released", "ended"];
const SMOOTH = [["0", "as it is"], ["0.1", "0.1 s"], ["0.2", "0.2 s"], ["0.5", "0.5 s"], ["1", "1 s"]];
const TAUGHT = ""; // of the source: what was taught since this arm was opened

let began = 0; // when the teaching began that goes on, also while another page is looked at; 0: none goes on

/**
 * Teach mode, and the timeline.
 * @param {ArmPage} page
 * @param {HTMLElement} root
 */
export function mountTeach(page, root) {
  fill(root, teachMarkup());
  const hand = page.get("#arm-teach-hand", HTMLInputElement);
  const start = page.get("#arm-teach-start", HTMLButtonElement);
  const stop = page.get("#arm-teach-stop");
  const note = page.get("#arm-teach-note");
  let teaching = false;

  const say = (/** @type {string} */ text, level = "") => {
    note.textContent = text;
    note.dataset.level = level;
  };
  const need = () => (start.disabled = !page.mine || !hand.checked);
  page.on("taught", (told) => {
    teaching = told.teaching;
    began = teaching ? began || performance.now() : 0;
    start.hidden = teaching;
    if (hand.parentElement) hand.parentElement.hidden = teaching;
    stop.hidden = !teaching;
  });
  page.on("facts", need);
  page.on("need", need);
  page.on("draw", () => {
    // What was refused stays in sight.
    if (!teaching || note.dataset.level === "error") return;
    const words = `Teaching for ${((performance.now() - began) / 1000).toFixed(0)} s: move the arm by hand.`;
    if (note.textContent !== words) say(words, "warn");
  });
  hand.addEventListener("change", need);
  const teach = async (/** @type {boolean} */ on) => {
    const answer = await page.call("arm.teach", { on });
    if (isRefused(answer)) say(capital(answer.error), "error");
    else {
      if (!on) teaching = hand.checked = false;
      say(capital(answer));
    }
    await page.tellTaught();
    need();
  };
  start.addEventListener("click", () => teach(true));
  stop.addEventListener("click", () => teach(false));
  mountTimeline(page, page.get("#arm-timeline"));
}

export function teachMarkup() {
  return html`<h2>Teach</h2>
  <div class="hw-row">
    <label><input type="checkbox" id="arm-teach-hand"> I hold the arm: it will sink</label>
    <button class="hw-button arm-need" id="arm-teach-start" type="button" disabled>Start teaching</button>
    <button class="hw-button arm-need" id="arm-teach-stop" type="button" hidden>End teaching: hold here</button>
  </div>
  <p class="arm-note" id="arm-teach-note" role="status">Teaching switches torque off and records how you move the
  arm by hand.</p>
  <h2>Play</h2>
  <div id="arm-timeline"></div>`;
}

/**
 * @param {ArmPage} page
 * @param {HTMLElement} root
 */
function mountTimeline(page, root) {
  /** @type {Curves | null} */
  let taught = null; // what the source is now, as smooth as it is wanted
  /** @type {Curves | null} */
  let hand = null; // what was taught; null for nothing
  let teaching = false;
  /** @type {string[]} */
  let names = []; // recordings
  let begin = 0;
  let end = 0;
  let cursor = 0;
  let left = 0; // rounds that are left of a paused play
  /** @type {{ first: number, rate: number, why: string } | null} */
  let playing = null; // the round that is played
  /** @type {number | null} */
  let fits = null; // the greatest factor that keeps the limits, of a motion that is too fast
  let loading = false; // what is chosen is not shown yet
  let refused = false; // what is refused cannot be begun, until something is changed
  let timer = 0;
  let asked = 0;
  let whole = true; // what is asked for is another motion than the one that is shown: all of it is played
  let lists = 0; // of recordings that were asked for

  /** @type {(words: string, act: () => unknown, more?: Record<string, string | boolean>) => HTMLButtonElement} */
  const button = (words, act, more = {}) => node("button", { class: "hw-button", type: "button", onclick: act, ...more }, words);
  /** @type {(words: string, input: HTMLElement) => HTMLElement} */
  const field = (words, input) => node("label", { class: "arm-field arm-inline" }, node("span", {}, words), input);
  const source = node("select", { id: "arm-source", "aria-label": "Motion" });
  const plot = node("canvas", { id: "arm-time-plot", "aria-hidden": "true" });
  const off = [node("span", { class: "arm-time-off" }), node("span", { class: "arm-time-off" })];
  const handles = [handle("Begin", () => begin, (time) => (begin = Math.min(time, end - LEAST))), handle("End", () => end, (time) => (end = Math.max(time, begin + LEAST)))];
  const curves = node("div", { class: "arm-curves" }, plot, ...off, ...handles);
  const time = node("input", { id: "arm-time", type: "range", min: 0, max: 1, step: "any", value: 0, "aria-label": "Time in the taught motion" });
  const value = node("output", { id: "arm-time-value", for: "arm-time" });
  const part = node("span", { class: "arm-note" });
  const factor = node("input", { id: "arm-factor", type: "number", min: 0.1, max: 4, step: "any", value: 1 });
  const smooth = node("select", { id: "arm-smooth", "aria-label": "Smooth" }, ...SMOOTH.map(([seconds, words]) => node("option", { value: seconds }, words)));
  const rounds = node("input", { id: "arm-rounds", type: "number", min: 1, max: 1000, step: 1, value: 1 });
  const start = button("Play", () => play(), { id: "arm-play", class: "hw-button arm-primary arm-need arm-whole" });
  const pause = button("Pause", () => halt("paused"), { id: "arm-pause", hidden: true });
  const stop = button("Rewind", () => (playing ? halt("stopped") : back()), { id: "arm-play-stop" });
  const slower = button("", () => play(fits), { id: "arm-play-fits", class: "hw-button arm-need arm-whole", hidden: true });
  const plan = node("p", { class: "arm-plan", id: "arm-play-plan", role: "status" });
  const name = node("input", { "aria-label": "Name of the new recording", placeholder: "name", maxlength: 80 });
  const save = node("form", { class: "hw-row arm-save", autocomplete: "off" }, name, node("button", { class: "hw-button", type: "submit" }, "Save as a recording"));
  const kept = node("p", { class: "arm-note", role: "status" });
  const legend = node("span", { class: "hw-row arm-legend" });
  const box = node("div", { id: "arm-taught", hidden: true },
    node("div", { class: "arm-time" }, curves, time),
    node("div", { class: "hw-row" }, value, part, legend),
    node("div", { class: "hw-row" }, field("Speed ×", factor), field("Smooth", smooth), field("Rounds", rounds)),
    node("div", { class: "hw-row" }, start, pause, stop, slower),
    plan, save, kept);
  const from = node("div", { class: "hw-row", hidden: true }, field("Motion", source));
  const empty = node("p", { class: "arm-note" }, "Nothing was taught yet, and there is no recording: teach a motion, or record the arm on the page Recordings.");
  const failed = node("p", { class: "arm-plan", role: "status", hidden: true, "data-level": "error" });
  root.append(empty, from, failed, box);

  // -- what is shown --------------------------------------------------------------------------------

  const list = (told = names) => {
    names = told;
    const now = source.value;
    const rows = [...(hand ? [[TAUGHT, "what was taught"]] : []), ...names.map((one) => [one, one])];
    // Nothing is chosen by the way: a recording is read when somebody wants it.
    if (!hand) rows.unshift([TAUGHT, "choose a recording"]);
    source.replaceChildren(...rows.map(([key, words]) => node("option", { value: key, selected: key === now }, words)));
    const none = !names.length && !hand;
    from.hidden = teaching || none;
    empty.hidden = !none;
  };
  const motion = (/** @type {number} */ first) => ({
    what: "play", begin: first, smooth: Number(smooth.value), factor: wantedFactor(),
    ...(source.value === TAUGHT ? {} : { recording: source.value }), ...(end < length() ? { end } : {}),
  });
  /** Seconds of all of it. */
  function length() {
    return taught?.duration ?? 0;
  }
  function wantedFactor() {
    return Number.isFinite(factor.valueAsNumber) ? factor.valueAsNumber : 1;
  }
  /**
   * Read what is chosen, as smooth as it is wanted; `anew`: all of it is played.
   * @param {boolean} anew
   */
  async function load(anew) {
    const mine = (asked += 1);
    if (anew) {
      smooth.value = "0";
      whole = true;
    }
    // Nothing is begun of what is not shown yet.
    loading = true;
    offer(null);
    if (source.value === TAUGHT && !hand) {
      loading = false;
      taught = null;
      failed.hidden = true;
      show();
      return;
    }
    const wanted = { what: "play", smooth: Number(smooth.value), ...(source.value === TAUGHT ? {} : { recording: source.value }) };
    const told = await page.call("arm.timeline", { motion: wanted });
    if (mine !== asked) return;
    loading = false;
    // What cannot be smoothed so stays as it was.
    if (!isRefused(told)) taught = told;
    else if (whole) taught = null;
    failed.hidden = !isRefused(told);
    failed.textContent = isRefused(told) ? `${capital(told.error)}.` : "";
    if (taught && whole) {
      [begin, end, cursor, left] = [0, taught.duration, 0, 0];
      kept.textContent = "";
      whole = false;
    }
    show();
    soon();
  }
  function show() {
    box.hidden = !taught || teaching;
    if (!taught || teaching) return;
    end = Math.min(end, taught.duration);
    time.max = String(taught.duration);
    time.step = String(Math.max(0.001, taught.duration / 500));
    mark(Math.min(cursor, taught.duration));
    bounds();
    legend.replaceChildren(...taught.names.map((joint) => {
      const swatch = node("span", { class: "arm-swatch" });
      swatch.style.setProperty("--colour", `var(${colour(joint)})`);
      return node("span", {}, swatch, joint);
    }));
    draw();
  }
  const colour = (/** @type {string} */ joint) => `--joint-${(page.args.joints.findIndex((one) => one.name === joint) % 8) + 1}`;
  const share = (/** @type {number} */ at) => (length() > 0 ? at / length() : 0);
  function bounds() {
    off[0].style.width = `${100 * share(begin)}%`;
    off[1].style.width = `${100 * (1 - share(end))}%`;
    for (const [i, at] of [begin, end].entries()) {
      handles[i].style.left = `${100 * share(at)}%`;
      const attributes = { valuemin: "0", valuemax: length().toFixed(2), valuenow: at.toFixed(2), valuetext: `${at.toFixed(1)} seconds` };
      for (const [key, text] of Object.entries(attributes)) handles[i].setAttribute(`aria-${key}`, text);
    }
    part.textContent = begin > 0 || end < length() ? `plays ${begin.toFixed(1)} to ${end.toFixed(1)} s` : "";
  }
  /** @param {number} at */
  function mark(at) {
    cursor = at;
    time.value = String(at);
    value.textContent = `${at.toFixed(1)} of ${length().toFixed(1)} s`;
    time.setAttribute("aria-valuetext", `${at.toFixed(1)} seconds`);
    curves.style.setProperty("--time", String(share(at)));
  }
  function ghost() {
    if (!taught) return;
    const { times, rows, names: joints } = taught;
    let k = times.findIndex((t) => t >= cursor);
    if (k < 0) k = times.length - 1;
    const [a, b, before] = [rows[Math.max(0, k - 1)], rows[k], times[Math.max(0, k - 1)]];
    const between = times[k] > before ? (cursor - before) / (times[k] - before) : 1;
    const positions = page.positions();
    const here = positions ? Object.fromEntries(page.args.joints.map((joint, i) => [joint.name, positions[i]])) : {};
    page.ghost({ ...here, ...Object.fromEntries(joints.map((joint, i) => [joint, a[i] + between * (b[i] - a[i])])) });
    page.get("#arm-unghost").hidden = false;
  }
  function draw() {
    const ratio = window.devicePixelRatio || 1;
    const { clientWidth: width, clientHeight: height } = plot;
    if (!width || !taught) return;
    plot.width = width * ratio;
    plot.height = height * ratio;
    const pen = plot.getContext("2d");
    if (!pen) return;
    pen.scale(ratio, ratio);
    pen.lineWidth = 1.5;
    const style = getComputedStyle(document.documentElement);
    /** @type {(x: number, from: number, to: number) => void} */
    const line = (x, from, to) => {
      pen.beginPath();
      pen.moveTo(x, from);
      pen.lineTo(x, to);
      pen.stroke();
    };
    const [grid, words] = ["--hw-line", "--hw-dim"].map((one) => getComputedStyle(plot).getPropertyValue(one).trim());
    const all = taught.duration, tick = TICKS.find((step) => all / step <= width / TICK) ?? TICKS[TICKS.length - 1];
    [pen.strokeStyle, pen.fillStyle, pen.font] = [grid, words, "11px system-ui, sans-serif"];
    for (let t = tick; t < all; t += tick) {
      line(share(t) * width, 0, height);
      pen.fillText(`${Number(t.toFixed(1))} s`, share(t) * width + 3, height - 3);
    }
    // Each joint from where it began, so that a small motion is seen beside a far posture.
    const { times, rows } = taught, first = rows[0];
    let [low, high] = [-0.05, 0.05];
    for (const row of rows) {
      for (const [i, angle] of row.entries()) [low, high] = [Math.min(low, angle - first[i]), Math.max(high, angle - first[i])];
    }
    const y = (/** @type {number} */ angle) => height - PAD - ((angle - low) / (high - low)) * (height - 2 * PAD);
    taught.names.forEach((joint, i) => {
      pen.strokeStyle = style.getPropertyValue(colour(joint)).trim() || "#888";
      pen.beginPath();
      times.forEach((t, k) => pen[k ? "lineTo" : "moveTo"](share(t) * width, y(rows[k][i] - first[i])));
      pen.stroke();
    });
  }
  /** @param {string} text */
  function say(text, level = "") {
    plan.textContent = text;
    plan.dataset.level = level;
  }

  // -- what is changed ------------------------------------------------------------------------------

  /**
   * A handle of the part that is played; `put` keeps it on its side of the other one.
   * @param {string} words
   * @param {() => number} at
   * @param {(time: number) => void} put
   */
  function handle(words, at, put) {
    const made = node("div", { class: "arm-time-handle", role: "slider", tabindex: 0, "aria-label": words, "aria-orientation": "horizontal" });
    const move = (/** @type {number} */ to) => {
      if (playing || !taught) return;
      put(Math.min(taught.duration, Math.max(0, to)));
      left = 0;
      mark(Math.min(end, Math.max(begin, at())));
      bounds();
      ghost();
      soon();
    };
    made.addEventListener("keydown", (event) => {
      const way = KEYS[event.key];
      if (way) move(at() + way * STEP * (event.shiftKey ? LEAP : 1));
      else if (event.key === "Home") move(0);
      else if (event.key === "End") move(length());
      else return;
      event.preventDefault();
    });
    made.addEventListener("pointerdown", (event) => event.button === 0 && made.setPointerCapture(event.pointerId));
    made.addEventListener("pointermove", (event) => {
      if (!made.hasPointerCapture(event.pointerId)) return;
      const { left: edge, width } = curves.getBoundingClientRect();
      move(((event.clientX - edge) / width) * length());
    });
    return made;
  }
  time.addEventListener("input", () => {
    if (playing) return mark(cursor);
    left = 0;
    mark(Number(time.value));
    ghost();
    soon();
  });
  factor.addEventListener("input", () => soon());
  rounds.addEventListener("input", () => (left = 0));
  smooth.addEventListener("change", () => load(false));
  source.addEventListener("change", () => load(true));
  source.addEventListener("pointerdown", () => refresh());
  page.on("speed", () => taught && soon());
  async function refresh() {
    const mine = (lists += 1);
    const told = await page.call("arm.recordings");
    // A list that changes while it is open would close.
    if (mine === lists && root.isConnected && !isRefused(told) && String(told) !== String(names)) list(told);
  }

  async function preview() {
    timer = 0;
    if (!taught || playing || !root.isConnected) return;
    const mine = asked;
    const told = await page.call("arm.preview", { motion: { ...motion(where()), speed: page.speed } });
    if (mine !== asked || playing || !taught) return;
    showPlan(plan, told);
    // What cannot be previewed would not be played either; but an error may pass, as that of a busy studio.
    refused = isRefused(told) || told.refusal !== "";
    if (isRefused(told)) timer = setTimeout(preview, AGAIN);
    offer(isRefused(told) ? null : told.fits);
  }
  /** @param {number | null} found */
  function offer(found) {
    fits = found;
    need();
    slower.hidden = fits === null;
    slower.textContent = `Play at ${fits} of its speed`;
  }
  function need() {
    const able = page.mine && page.unready === "";
    start.disabled = !able || loading || refused;
    slower.disabled = !able;
  }
  function soon() {
    clearTimeout(timer);
    refused = false;
    offer(null);
    timer = setTimeout(preview, PAUSE);
  }

  // -- play -----------------------------------------------------------------------------------------

  /** Where a play begins: at the cursor, or if it is not before the end of the part, at its begin. */
  function where() {
    return cursor >= begin && cursor < end - LEAST ? cursor : begin;
  }
  /** @param {number | null} at its factor; what is entered if null */
  async function play(at = null) {
    if (playing || !taught || !page.mine) return;
    if (at !== null) factor.value = String(at);
    const ends = page.attend();
    const all = left || Math.min(1000, Math.max(1, Math.round(rounds.valueAsNumber) || 1));
    const mine = (playing = { first: where(), rate: wantedFactor(), why: "" });
    lock();
    page.ghost(null);
    let why = "arrived";
    let done = 0;
    while (why === "arrived" && done < all) {
      if (done) mine.first = begin;
      if (all > 1) say(`Round ${done + 1} of ${all}.`);
      why = await page.run(motion(mine.first));
      if (why !== "arrived") break;
      done += 1;
      if (done < all) why = mine.why || ends() || why;
    }
    playing = null;
    left = mine.why === "paused" ? all - done : 0;
    if (!root.isConnected) return;
    lock();
    if (mine.why === "paused" && done < all) say(`Paused at ${cursor.toFixed(1)} s: Play goes on from here.`);
    else if (mine.why === "stopped") back();
    else if (why === "arrived") {
      mark(end);
      say("Played.");
    } else say(capital(why), FINE.includes(why) ? "" : "error");
  }
  /** @param {string} why */
  function halt(why) {
    if (!playing) return;
    playing.why = why;
    hexwire.release("ended");
  }
  function back() {
    left = 0;
    mark(begin);
    say("");
    soon();
  }
  function lock() {
    const busy = playing !== null;
    const pressed = [start, pause, slower].some((one) => one === document.activeElement);
    start.hidden = busy;
    pause.hidden = !busy;
    stop.textContent = busy ? "Stop" : "Rewind";
    if (busy) offer(null);
    for (const one of [source, factor, smooth, rounds, time]) one.disabled = busy;
    for (const one of handles) one.setAttribute("aria-disabled", String(busy));
    // What was pressed is hidden now.
    if (pressed) (busy ? pause : start).focus({ preventScroll: true });
  }
  page.on("elapsed", ({ run, now }) => {
    if (playing) mark(Math.min(end, playing.first + Math.max(0, now - run.lead_in) * playing.rate));
  });

  // -- keep -----------------------------------------------------------------------------------------

  save.addEventListener("submit", async (event) => {
    event.preventDefault();
    if (!taught) return;
    const file = `${name.value.trim()}.mcap`;
    const there = names.includes(file);
    const own = file === source.value ? "It is the one that you see here; what is cut off or smoothed is lost." : "";
    if (there && !(await question(`Replace ${file}?`, `A recording of this name exists.\n${own}`, "Replace it"))) return;
    const told = await page.call("arm.save_taught", { name: name.value.trim(), motion: motion(begin), force: there });
    kept.dataset.level = isRefused(told) ? "error" : "";
    kept.textContent = isRefused(told) ? capital(told.error) : `Saved ${file}: on the page Recordings, for programs and hexwire play.`;
    if (isRefused(told)) return;
    lists += 1;
    list(told);
    if (there && file === source.value) load(true);
  });

  page.on("taught", (told) => {
    const before = hand;
    teaching = told.teaching;
    hand = told.taught;
    list();
    if (playing) return;
    const anew = !before || before.duration !== hand?.duration;
    if (hand && !teaching && anew) source.value = TAUGHT;
    if (source.value === TAUGHT) load(anew);
    else show();
  });
  new ResizeObserver(draw).observe(plot);
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const again = () => {
    if (plot.isConnected) {
      draw();
      return;
    }
    dark.removeEventListener("change", again);
    themed.disconnect();
  };
  const themed = new MutationObserver(again);
  themed.observe(document.documentElement, { attributes: true, attributeFilter: ["data-theme"] });
  dark.addEventListener("change", again);
  if (hexwire.operates) refresh();
  else save.hidden = true;
  page.on("need", need);
  need();
  page.tellTaught();
}
