// The arm of a recording in 3D: its posture at the time under the pointer or at the cursor; of two recordings, or while one is
// played, the other one as a ghost. Owns which posture is shown; arm3d.js draws it.

import hexwire from "./live.js";

/**
 * Which values of a joint the arm and its ghost have.
 * @typedef {[string, string | null]} Keys
 * @typedef {import("./columns.js").Columns<{ names: string[] }>} Data
 */

/** @param {HTMLElement} place */
export function makeFigure(place) {
  /**
   * @type {{ robot: string, view: import("./arm3d.js").Arm3D | null, data: Data | null, keys: Keys, time: number | null,
   *   live: { joints: Map<string, number>, t: number } | null, round: number }}
   */
  const state = { robot: "", view: null, data: null, keys: ["position", null], time: null, live: null, round: 0 };
  place.hidden = true;

  return { choose, loaded, at, live, destroy };

  function destroy() {
    state.round++;
    state.view?.dispose();
    state.view = null;
  }

  /**
   * Show an arm of this kind; nothing for an unknown one.
   * @param {string} robot
   */
  async function choose(robot) {
    if (robot === state.robot) return;
    destroy();
    state.robot = robot;
    place.hidden = true;
    place.replaceChildren();
    if (!robot) return;
    const round = state.round;
    try {
      const { geometry } = await hexwire.call("recordings.geometry", { robot });
      const { Arm3D } = await import("./arm3d.js");
      if (round !== state.round || !geometry) return;
      place.hidden = false;
      state.view = new Arm3D(place, geometry, { theme: "auto" });
    } catch {
      if (round !== state.round) return;
      place.hidden = true;
    }
    draw();
  }

  /**
   * @param {Data} data
   * @param {Keys} keys
   */
  function loaded(data, keys) {
    Object.assign(state, { data, keys, time: null, live: null });
    draw();
  }

  /** @param {number | null} t */
  function at(t) {
    state.time = t;
    draw();
  }

  /**
   * Positions of a motion that goes on, radians by joint, at a time of the recording; null when it is over.
   * @param {Map<string, number> | null} joints
   */
  function live(joints, t = 0) {
    state.live = joints ? { joints, t } : null;
    draw();
  }

  /**
   * @param {Data} data
   * @param {string | null} key
   * @param {number} t
   */
  function posture({ times, columns, head }, key, t) {
    if (!key || !times.length) return null;
    let low = 0, high = times.length - 1;
    while (low < high) {
      const middle = (low + high + 1) >> 1;
      if (times[middle] <= t) low = middle;
      else high = middle - 1;
    }
    /** @type {Record<string, number>} */
    const found = {};
    for (const name of head.names) {
      const value = columns.get(`${name}.${key}`)?.[low] ?? NaN;
      if (Number.isFinite(value)) found[name] = value;
    }
    return found;
  }

  function draw() {
    const { view, data, live } = state;
    if (!view || !data) return;
    const [first, second] = state.keys;
    if (live) {
      view.setJoints(Object.fromEntries(live.joints));
      view.setGhost(posture(data, first, live.t));
      return;
    }
    const t = state.time ?? data.times[0] ?? 0;
    view.setJoints(posture(data, first, t) ?? {});
    view.setGhost(posture(data, second, t));
  }
}
