// One recording, or two on one time axis. Owns what is shown of them; plot.js draws.

import { chips } from "./forms.js";
import hexwire from "./live.js";
import { Plot } from "./plot.js";
import { fetchColumns } from "./columns.js";
import { DEG, JOINT_SIGNALS, jointSeries, valuesOf } from "./signals.js";
import { node, whyOf } from "./widgets.js";
import { makeFigure } from "./recordings_arm.js";
import { makePictures } from "./recordings_cameras.js";
import { makePlayer } from "./recordings_play.js";

/**
 * Of one recording, or a comparison of two.
 * @typedef {import("./columns.js").Columns<{ names: string[] } & Partial<Heads["/data/recording"] & Heads["/data/compare"]>>} Data
 *
 * @typedef {{
 *   name: string, other: string, topic: string, data: Data | null, plot: Plot | null, signals: string[], joints: string[],
 *   names: string | null, align: string, round: number, played: Map<string, Float32Array> | null
 * }} ViewState
 */

/**
 * Which colour a joint has: that of the open arm's joint of this name, as on every other page.
 * @param {string} name
 * @param {number} place in the recording
 */
function colourOf(name, place) {
  const own = hexwire.model.joints.findIndex((joint) => joint.name === name);
  return own < 0 ? place : own;
}

/**
 * @param {import("./recordings.js").RecordingsPage} page
 * @param {HTMLElement} place
 */
export function makeView(page, place) {
  /** @type {ViewState} */
  const state = { name: "", other: "", topic: "", data: null, plot: null, signals: ["position"], joints: [], names: null, align: "start", round: 0, played: null };
  const title = node("h2", { class: "rc-title", tabindex: -1 });
  const topics = node("select", { hidden: true });
  topics.setAttribute("aria-label", "Arm in the recording");
  const other = node("select", { id: "rc-other" });
  const align = node("select", { id: "rc-align" }, new Option("both from their start", "start"),
    new Option("where they agree best", "best"));
  const aligned = node("span", { class: "rc-aligned" }, node("label", { for: "rc-align" }, "aligned"), align);
  const bar = node("div", { class: "rc-bar" }, topics, node("label", { for: "rc-other" }, "Compare with"), other, aligned);
  const note = node("p", { class: "pl-note rc-note", role: "status" });
  const pick = node("div", { class: "pl-pick" });
  const figures = node("div", { class: "rc-figures" });
  const plotPlace = node("div", { class: "pl-plot" });
  const playPlace = node("div", { class: "rc-play" });
  const armPlace = node("div", { class: "rc-arm" });
  const body = node("div", { class: "rc-body" }, plotPlace, armPlace);
  const picturesPlace = node("div", { class: "rc-cameras", hidden: true });
  place.append(title, bar, note, playPlace, figures, pick, body, picturesPlace);
  place.hidden = true;
  const figure = makeFigure(armPlace);
  const pictures = makePictures(picturesPlace);
  const player = makePlayer(page, playPlace, state, showPlayed, (joints, at) => {
    figure.live(joints, at);
    if (joints) pictures.at(at ?? null);
  });

  topics.addEventListener("change", () => { state.topic = topics.value; load(); });
  other.addEventListener("change", () => { state.other = other.value; load(); });
  align.addEventListener("change", () => { state.align = align.value; load(); });

  return { choose, update, destroy };

  function destroy() {
    state.plot?.destroy();
    player.destroy();
    figure.destroy();
  }

  /** @param {string} name */
  function choose(name) {
    Object.assign(state, { name, other: "", topic: "", data: null, played: null });
    place.hidden = !name;
    const entry = page.entry(name);
    title.textContent = name;
    topics.replaceChildren(...(entry?.topics ?? []).map((topic) => new Option(topic.replace(/\/?joint_states$/, "") || "/", topic)));
    topics.hidden = (entry?.topics.length ?? 0) < 2;
    state.topic = entry?.topics[0] ?? "";
    update(page.state.list);
    player.choose(entry);
    figure.choose(entry?.twin ?? "");
    pictures.choose(entry);
    load();
    title.focus({ preventScroll: true });
    place.scrollIntoView({ block: "nearest" });
  }

  /** @param {RecordingList | null} list */
  function update(list) {
    if (!list) return;
    player.update(list);
    if (!state.name) return;
    if (!page.entry(state.name)) {
      destroyPlot();
      state.name = "";
      place.hidden = true;
      return;
    }
    const names = list.entries.filter((one) => one.states && one.name !== state.name).map((one) => one.name);
    const wanted = ["", ...names];
    if (!other.options.length || [...other.options].map((one) => one.value).join("\n") !== wanted.join("\n")) {
      other.replaceChildren(new Option(names.length ? "nothing" : "there is no other", ""), ...names.map((name) => new Option(name, name)));
    }
    other.value = names.includes(state.other) ? state.other : "";
    aligned.hidden = !other.value;
  }

  function destroyPlot() {
    state.plot?.destroy();
    state.plot = null;
    figures.replaceChildren();
    pick.replaceChildren();
  }

  async function load() {
    const round = ++state.round;
    destroyPlot();
    state.data = null;
    state.played = null;
    aligned.hidden = !state.other;
    playPlace.hidden = Boolean(state.other);
    note.textContent = "reading …";
    note.dataset.level = "";
    /** @type {Data} */
    let data;
    try {
      data = state.other
        ? await fetchColumns("/data/compare", { a: state.name, topic_a: state.topic, b: state.other, align: state.align })
        : await fetchColumns("/data/recording", { name: state.name, topic: state.topic });
    } catch (error) {
      if (round === state.round) { note.textContent = whyOf(error); note.dataset.level = "error"; }
      return;
    }
    if (round !== state.round) return;
    state.data = data;
    const left = data.head.left_out?.length ? `not in both: ${data.head.left_out.join(", ")}` : "";
    note.textContent = data.head.problem || left;
    const names = data.head.names;
    // A choice is kept for recordings of the same joints.
    if (state.names !== names.join("\n")) state.joints = names;
    state.names = names.join("\n");
    if (state.other) table(data);
    pictures.begins(data.head.begin ?? 0);
    figure.loaded(data, state.other ? ["first", "second"] : ["position", null]);
    choices(data);
    draw();
    player.loaded(data);
  }

  /** @param {Data} data */
  function choices({ head: { names }, columns }) {
    const groups = [chips("Joints", names.map((name, i) => ({ key: name, text: name, colour: `--joint-${(colourOf(name, i) % 8) + 1}` })), state.joints,
      (values) => { state.joints = values; draw(); }, { all: true })];
    if (!state.other) {
      const known = JOINT_SIGNALS.filter((signal) => names.some((name) => valuesOf(signal, (key) => columns.get(`${name}.${key}`))));
      state.signals = state.signals.filter((key) => known.some((one) => one.key === key));
      if (!state.signals.length) state.signals = ["position"];
      groups.push(chips("Signals", known.map((one) => ({ key: one.key, text: one.words, unit: one.unit })), state.signals,
        (values) => { state.signals = values; draw(); }));
    }
    pick.replaceChildren(...groups);
  }

  /** @param {Data} data */
  function rows(data) {
    /** @type {[import("./plot.js").SeriesOptions, Float32Array][]} */
    const found = [];
    const scaled = (/** @type {Float32Array | undefined} */ column) => column?.map((value) => DEG * value) ?? new Float32Array(data.times.length).fill(NaN);
    data.head.names.forEach((joint, place) => {
      if (!state.joints.includes(joint)) return;
      const i = colourOf(joint, place);
      if (state.other) {
        const base = { colour: i, unit: "°" };
        found.push([{ ...base, name: `${joint} of the first`, quantity: "position" }, scaled(data.columns.get(`${joint}.first`))]);
        found.push([{ ...base, name: `${joint} of the second`, quantity: "position", dash: [5, 3] }, scaled(data.columns.get(`${joint}.second`))]);
        found.push([{ ...base, name: `${joint} second − first`, quantity: "difference", panel: "difference" }, scaled(data.columns.get(`${joint}.difference`))]);
        return;
      }
      for (const signal of JOINT_SIGNALS.filter((one) => state.signals.includes(one.key))) {
        const values = valuesOf(signal, (key) => data.columns.get(`${joint}.${key}`));
        if (values) found.push([jointSeries(joint, i, signal), values]);
      }
      const played = state.played?.get(joint);
      if (played) found.push([{ colour: i, unit: "°", name: `${joint} played`, quantity: "position", dash: [2, 2] }, scaled(played)]);
    });
    return found;
  }

  function draw() {
    const { data } = state;
    if (!data) return;
    const before = state.plot;
    const found = rows(data);
    const panels = new Set(found.map(([series]) => series.panel ?? series.unit)).size;
    const options = { title: "", live: false, fileName: state.other ? `${state.name} and ${state.other}` : state.name,
      onTime: (/** @type {number | null} */ t) => {
        figure.at(t);
        pictures.at(t);
      },
      series: found.map(([series]) => series), height: Math.max(300, 150 * panels), capacity: data.times.length + 1024 };
    const range = before && before.columns.length ? before.range : null;
    before?.destroy();
    state.plot = new Plot(plotPlace, options);
    state.plot.set([data.times, ...found.map(([, values]) => values)]);
    if (range && range[1] - range[0] > 0.01) state.plot.zoom(range[0], range[1]);
  }

  /**
   * Values that were played meanwhile, on the recording's times.
   * @param {Map<string, Float32Array>} played
   */
  function showPlayed(played) {
    state.played = played;
    if (!state.other) draw();
  }

  /** @param {Data} data */
  function table({ head: { lag = 0, joints = [] } }) {
    const text = (/** @type {number | null} */ value) => (value === null ? "–" : (DEG * value).toFixed(2).replace("-", "−"));
    const later = Math.abs(lag) < 0.0005 ? "" : `; the second one was ${Math.abs(lag).toFixed(3)} s ${lag > 0 ? "later" : "earlier"}`;
    figures.replaceChildren(node("table", { class: "rc-table" },
      node("caption", {}, `Second minus first${later}`),
      node("thead", {}, node("tr", {}, ...["joint", "RMS, °", "greatest, °", "at, s"].map((one) => node("th", { scope: "col" }, one)))),
      node("tbody", {}, ...joints.map((one) => node("tr", {}, node("th", { scope: "row" }, one.name),
        node("td", {}, text(one.rms)), node("td", {}, text(one.largest)),
        node("td", {}, one.at === null ? "–" : one.at.toFixed(2)))))));
  }
}
