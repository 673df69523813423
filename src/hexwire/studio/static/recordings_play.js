// Plays a recording on the twin or on the arm. Owns the controls and what was measured meanwhile; the server checks and moves.
//
// On the arm the motion lasts while this page attends to it: closing, hiding or freezing the page ends it, as STOP does.

import hexwire from "./live.js";
import { fetchColumns } from "./columns.js";
import { DEG } from "./signals.js";
import { node, whyOf } from "./widgets.js";

const LOOK = 250; // ms between two looks at the twin

/**
 * What is played of a recording, seconds.
 * @typedef {{ begin: number, factor: number, end?: number }} PlayedPart
 *
 * `points`: times of the recording, and positions then; `began`: when the motion began, on the clock of frames.
 * @typedef {{
 *   entry: Recording | undefined, list: RecordingList | null, times: Float64Array | null, names: string[], on: "" | "twin" | "arm",
 *   poll: number, drawn: number, points: [number, Map<string, number>][], run: Run | null, began?: number, part: PlayedPart | null,
 *   fits: number | null, of: Recording | undefined, turn: number
 * }} PlayState
 */

/**
 * @param {import("./recordings.js").RecordingsPage} page
 * @param {HTMLElement} place
 * @param {import("./recordings_view.js").ViewState} view
 * @param {(found: Map<string, Float32Array>) => void} shown gets what was played, on the recording's times
 * @param {(joints: Map<string, number> | null, at?: number) => void} moved gets each posture, and null at the end
 */
export function makePlayer(page, place, view, shown, moved) {
  /** @type {PlayState} */
  const state = { entry: undefined, list: null, times: null, names: [], on: "", poll: 0, drawn: 0, points: [], run: null, part: null, fits: null, of: undefined, turn: 0 };
  /** @type {(label: string, value: string, min: string, max: string, step: string) => [HTMLLabelElement, HTMLInputElement]} */
  const number = (label, value, min, max, step) => {
    const box = node("input", { type: "number", class: "rc-number", value, min, max, step });
    const made = node("label", { class: "rc-field" }, label, box);
    return [made, box];
  };
  const [fromField, from] = number("from, s", "0", "0", "3600", "0.1");
  const [toField, to] = number("to, s", "", "0", "3600", "0.1");
  const [factorField, factor] = number("speed", "1", "0.1", "4", "0.1");
  to.placeholder = "end";
  factor.title = "2 plays twice as fast";
  /** @type {(text: string, act: () => unknown) => HTMLButtonElement} */
  const press = (text, act) => node("button", { type: "button", class: "hw-button", onclick: act }, text);
  const twin = press("Play on the twin", playTwin);
  const arm = press("Play on the arm", playArm);
  const slower = press("", () => {
    factor.value = String(state.fits);
    playArm();
  });
  slower.hidden = true;
  const stop = press("End", end);
  stop.hidden = true;
  const said = node("span", { class: "rc-said", role: "status" });
  const bar = node("progress", { max: 1, value: 0, hidden: true });
  bar.setAttribute("aria-label", "Progress of the motion");
  place.replaceChildren(fromField, toField, factorField, ...(page.args.operates ? [twin, arm, slower, stop] : []), bar, said);

  hexwire.onRun((run) => {
    if (state.on !== "arm" || !run || run.outcome) return;
    state.run = run;
    if (state.began === undefined && hexwire.frame) state.began = hexwire.frame.time - run.elapsed;
    progress(run);
  }, place);
  hexwire.onFrame((frame) => {
    if (state.on !== "arm" || state.began === undefined || !state.run) return;
    collect(frame.time - state.began, state.run.lead_in, new Map(frame.joints.map((name, i) => [name, frame.position[i]])));
    progress({ ...state.run, elapsed: frame.time - state.began });
    draw();
  }, place);

  return { choose, loaded, update, destroy };

  function destroy() { clearInterval(state.poll); }

  /** @param {Recording | undefined} entry */
  function choose(entry) {
    state.entry = entry;
    state.times = null;
    if (!state.on) { said.textContent = ""; bar.hidden = true; offer(null); }
    from.value = "0";
    to.value = "";
    if (state.list) update(state.list);
  }

  /** @param {import("./recordings_view.js").Data} data */
  function loaded(data) {
    state.times = data.times;
    state.names = data.head.names;
    to.placeholder = data.times.length ? data.times[data.times.length - 1].toFixed(1) : "end";
  }

  /** @param {RecordingList} list */
  function update(list) {
    state.list = list;
    const entry = page.entry(state.entry?.name ?? "") ?? state.entry;
    const busy = Boolean(state.on) || list.twin.busy;
    twin.disabled = busy || !entry?.twin;
    twin.title = entry?.twin ? `An emulated ${entry.twin} in this program; nothing real moves` : "No emulated arm has these joints";
    arm.disabled = busy || !entry?.fits;
    arm.title = entry?.fits ? "Moves the open arm, after the usual checks" : list.robot ? "The open arm does not have these joints" : "No arm is open";
    if (list.twin.busy && !state.on) { stop.hidden = false; follow(); }
  }

  /** @returns {PlayedPart} */
  function part() {
    /** @type {(box: HTMLInputElement, other: number) => number} */
    const value = (box, other) => (box.value === "" ? other : Number(box.value));
    const found = { begin: value(from, 0), factor: value(factor, 1) };
    return to.value === "" ? found : { ...found, end: Number(to.value) };
  }

  /**
   * @param {"twin" | "arm"} on
   * @param {string} text
   */
  function prepare(on, text) {
    const wanted = part();
    Object.assign(state, { on, began: undefined, run: null, points: [], part: wanted, of: state.entry });
    offer(null);
    said.textContent = text;
    said.dataset.level = "";
    stop.hidden = false;
    bar.hidden = false;
    bar.removeAttribute("value");
    if (state.list) update(state.list);
    return wanted;
  }

  /**
   * @param {string} text
   * @param {boolean} bad
   */
  function finish(text, bad) {
    // A list from before still says that the twin moves, which would be followed once more.
    page.outdate();
    if (state.on === "twin" && state.list) state.list.twin.busy = false;
    state.on = "";
    moved(null);
    stop.hidden = true;
    bar.hidden = true;
    draw(true);
    said.textContent = [text, figures()].filter(Boolean).join("; ");
    said.dataset.level = bad ? "error" : "";
    if (state.list) update(state.list);
  }

  // -- the twin ------------------------------------------------------------------------------------------

  async function playTwin() {
    if (!state.entry) return;
    const part = prepare("twin", "starting the twin …");
    const begun = await page.act("recordings.twin", { name: state.entry.name, topic: view.topic, part });
    if (begun === undefined) finish(page.state.refusal, true);
    else follow();
  }

  function follow() {
    clearInterval(state.poll);
    if (!state.on) state.of = state.entry; // begun elsewhere
    state.on = "twin";
    let after = -1e18, looking = false;
    state.poll = setInterval(async () => {
      if (looking) return;
      looking = true;
      try {
        const { head, times, columns } = await fetchColumns("/data/twin", { after });
        if (times.length) after = times[times.length - 1];
        const twinState = head.state;
        state.part ??= part();
        times.forEach((time, i) => collect(time - twinState.began, twinState.lead_in,
          new Map(head.names.map((name) => [name, columns.get(`${name}.position`)?.[i] ?? NaN]))));
        if (twinState.running) {
          progress(twinState);
          draw();
        } else {
          clearInterval(state.poll);
          const text = twinState.arrived ? `the twin (${twinState.robot}) arrived` : `the twin: ${twinState.ended}`;
          finish(text, !twinState.arrived && twinState.ended !== "stopped");
        }
      } catch (error) {
        clearInterval(state.poll);
        finish(whyOf(error), true);
      }
      looking = false;
    }, LOOK);
  }

  // -- the arm -------------------------------------------------------------------------------------------

  async function playArm() {
    if (!state.entry) return;
    const motion = { what: "play", recording: state.entry.name, topic: view.topic, ...prepare("arm", "checking …") };
    const why = attend();
    const plan = await page.act("arm.preview", { motion });
    if (!plan) { finish(page.state.refusal, true); return; }
    const ended = why();
    if (ended) { finish(ended, false); return; }
    if (plan.refusal || plan.unready) {
      finish(plan.refusal || plan.unready, true);
      offer(plan.fits);
      return;
    }
    said.textContent = `${plan.lead_in.toFixed(1)} s to the start, then ${(plan.duration - plan.lead_in).toFixed(1)} s`;
    const over = await hexwire.hold("run", motion, { attended: true });
    finish(over, over !== "arrived" && over !== "released");
  }

  /** From now on, why a motion that is still being checked is not to begin; empty if it may. */
  function attend() {
    const mine = (state.turn += 1), stops = () => hexwire.frame?.stops ?? hexwire.facts?.stops ?? 0, before = stops();
    let hidden = false;
    const hides = () => (hidden ||= document.hidden);
    document.addEventListener("visibilitychange", hides);
    return () => {
      document.removeEventListener("visibilitychange", hides);
      if (!place.isConnected) return "its page was left";
      if (hidden || document.hidden) return "the page was hidden";
      if (mine !== state.turn) return "ended before it began";
      return stops() === before ? "" : "stopped";
    };
  }

  /**
   * Offer the speed at which it is not too fast.
   * @param {number | null} fits
   */
  function offer(fits) {
    state.fits = fits;
    slower.hidden = fits === null;
    if (fits !== null) slower.textContent = `Play at ${fits} of its speed`;
  }

  function end() {
    if (state.on === "arm") {
      state.turn += 1;
      hexwire.release();
    } else page.act("recordings.end_twin");
  }

  // -- what was measured ---------------------------------------------------------------------------------

  /** @param {{ elapsed: number, duration: number, lead_in: number }} run */
  function progress(run) {
    const left = Math.max(0, run.duration - run.elapsed);
    bar.value = run.duration ? Math.min(1, run.elapsed / run.duration) : 0;
    const where = run.elapsed < run.lead_in ? "to the start" : "playing";
    said.textContent = `${where}, ${left.toFixed(1)} s left`;
  }

  /**
   * Note joint positions at a time of the motion, as a time of the recording.
   * @param {number} elapsed
   * @param {number} leadIn
   * @param {Map<string, number>} positions
   */
  function collect(elapsed, leadIn, positions) {
    // Another recording may be shown by now.
    if (!state.part || state.of?.name !== state.entry?.name) return;
    const at = state.part.begin + (elapsed - leadIn) * state.part.factor;
    moved(positions, at);
    if (at >= state.part.begin) state.points.push([at, positions]);
    if (state.points.length > 50000) state.points.splice(0, 10000);
  }

  /** Positions that were played, on the recording's times. */
  function played() {
    const { times, points, names } = state;
    if (!times || !times.length || points.length < 2 || state.of?.name !== state.entry?.name) return null;
    const found = new Map(names.filter((name) => points[0][1].has(name)).map((name) => [name, new Float32Array(times.length).fill(NaN)]));
    const last = Math.min(points[points.length - 1][0], state.part?.end ?? Infinity);
    let k = 0;
    for (let i = 0; i < times.length; i++) {
      const t = times[i];
      if (t < points[0][0] || t > last) continue;
      while (k < points.length - 2 && points[k + 1][0] < t) k++;
      const [a, p] = points[k], [b, q] = points[k + 1];
      const share = b > a ? Math.min(1, Math.max(0, (t - a) / (b - a))) : 0;
      for (const [name, row] of found) {
        const here = p.get(name) ?? NaN;
        row[i] = here + share * ((q.get(name) ?? NaN) - here);
      }
    }
    return found;
  }

  function draw(now = false) {
    if (!now && performance.now() - state.drawn < 600) return;
    state.drawn = performance.now();
    const found = played();
    if (found) shown(found);
  }

  function figures() {
    const found = played();
    if (!found || !view.data) return "";
    let sum = 0, count = 0, worst = 0, where = "";
    for (const [name, row] of found) {
      const wanted = view.data.columns.get(`${name}.position`);
      if (!wanted) continue;
      row.forEach((value, i) => {
        const off = value - wanted[i];
        if (!Number.isFinite(off)) return;
        sum += off * off;
        count++;
        if (Math.abs(off) > worst) { worst = Math.abs(off); where = name; }
      });
    }
    return count ? `off the recording by ${(DEG * Math.sqrt(sum / count)).toFixed(2)} ° RMS, at most ${(DEG * worst).toFixed(2)} ° (${where})` : "";
  }
}
