// The arm of a recording in 3D: its posture at the time under the pointer or at the cursor; of two recordings, or while one is
// played, the other one as a ghost. Owns which posture is shown; arm3d.js draws it.

import hexwire from "./live.js";

export function makeFigure(place) {
  const state = { robot: "", view: null, data: null, keys: ["position", null], time: null, live: null, round: 0 };
  place.hidden = true;

  return { choose, loaded, at, live, destroy };

  function destroy() {
    state.round++;
    state.view?.dispose();
    state.view = null;
  }

  /** Show an arm of this kind; nothing for an unknown one. */
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
      place.hidden = true;
    }
    draw();
  }

  function loaded(data, keys) {
    Object.assign(state, { data, keys, time: null, live: null });
    draw();
  }

  function at(t) {
    state.time = t;
    draw();
  }

  /** Positions of a motion that goes on, radians by joint, at a time of the recording; null when it is over. */
  function live(joints, t) {
    state.live = joints ? { joints, t } : null;
    draw();
  }

  function posture(key, t) {
    const { times, columns, head } = state.data;
    if (!key || !times.length) return null;
    let low = 0, high = times.length - 1;
    while (low < high) {
      const middle = (low + high + 1) >> 1;
      if (times[middle] <= t) low = middle;
      else high = middle - 1;
    }
    const found = {};
    for (const name of head.names) {
      const value = columns.get(`${name}.${key}`)?.[low];
      if (Number.isFinite(value)) found[name] = value;
    }
    return found;
  }

  function draw() {
    if (!state.view || !state.data) return;
    const [first, second] = state.keys;
    if (state.live) {
      state.view.setJoints(Object.fromEntries(state.live.joints));
      state.view.setGhost(posture(first, state.live.t));
      return;
    }
    const t = state.time ?? state.data.times[0] ?? 0;
    state.view.setJoints(posture(first, t) ?? {});
    state.view.setGhost(posture(second, t));
  }
}
