// A picture of an arm in 3D for somebody who works at it: what to look at in a strong colour, and how it moves as a ghost.
// Owns the view and its caption; who shows it says which joint.

import { Arm3D } from "./arm3d.js";
import hexwire from "./live.js";
import { node, put } from "./widgets.js";

const SWEEP = 80; // ms between two postures of the ghost
const PERIOD = 4000; // ms in which it goes there and back

export class Picture {
  /** @type {string | null} */
  shown = null;
  /** @type {Arm3D | null} */
  view = null;
  /** @type {Geometry | null} */
  geometry = null;
  /** @type {string | null} */
  joint = null;
  timer = 0;
  /** @type {Record<string, number>} */
  pose = {};
  /** @type {Promise<void>} */
  loaded = Promise.resolve();

  /**
   * @param {HTMLElement} place
   * @param {HTMLElement} caption
   */
  constructor(place, caption) {
    this.place = place;
    this.caption = caption;
    this.still = matchMedia("(prefers-reduced-motion: reduce)");
    const watch = setInterval(() => {
      if (place.isConnected) return;
      clearInterval(watch);
      clearInterval(this.timer);
      this.view?.dispose();
    }, 1000);
  }

  /**
   * Show an arm; `which` tells two of one kind apart. Resolves when it is there to be marked.
   * @param {string} robot
   * @returns {Promise<void>}
   */
  show(robot, which = robot) {
    if (robot && which !== this.shown) {
      this.shown = which;
      this.loaded = this.load(robot, which);
    }
    return this.loaded;
  }

  /**
   * @param {string} robot
   * @param {string} which
   */
  async load(robot, which) {
    const geometry = await hexwire.call("first.shape", { robot }).catch(() => null);
    if (which !== this.shown || !this.place.isConnected) return;
    this.view?.dispose();
    clearInterval(this.timer);
    this.place.replaceChildren();
    Object.assign(this, { view: null, geometry, pose: {}, joint: null, timer: 0 });
    if (!geometry) {
      this.place.append(node("p", {}, "Nobody knows what this arm looks like."));
      return;
    }
    this.view = new Arm3D(this.place, geometry, { theme: "auto", label: "Picture of the arm; the text below it says what is coloured." });
    this.view.lookAt([0, 0, 0.4 * geometry.reach], 2.7 * geometry.reach);
  }

  /**
   * Colour what a joint moves, the foot (""), or nothing (null); `sweeps`: a ghost shows its range.
   * @param {string | null} joint
   */
  mark(joint, sweeps = false) {
    this.view?.setHighlight(joint);
    put(this.caption, joint ? `In colour: ${joint}` : joint === "" ? "In colour: the foot, where the cables are" : "");
    if (joint !== this.joint || !sweeps !== !this.timer) this.sweep(sweeps ? joint : null);
    this.joint = joint;
  }

  /**
   * The ghost goes from one end of a joint to the other and back.
   * @param {string | null} joint
   */
  sweep(joint) {
    clearInterval(this.timer);
    this.timer = 0;
    const limits = this.geometry?.joints.find(({ name }) => name === joint);
    const { view } = this;
    view?.setGhost(null);
    if (!limits || !view) return;
    const from = performance.now();
    const step = () => {
      if (document.hidden) return;
      const share = this.still.matches ? 1 : 0.5 - 0.5 * Math.cos((2 * Math.PI * (performance.now() - from)) / PERIOD);
      view.setGhost({ ...this.pose, [limits.name]: limits.minimum + share * (limits.maximum - limits.minimum) });
    };
    step();
    this.timer = setInterval(step, this.still.matches ? 1000 : SWEEP);
  }

  /**
   * Where a small step of a joint would lead, radians; null hides it.
   * @param {string | null} joint
   */
  preview(joint, by = 0) {
    if (!this.view) return;
    if (joint !== null) this.mark(joint);
    this.view.setGhost(joint === null ? null : { ...this.pose, [joint]: (this.pose[joint] ?? 0) + by });
  }

  /**
   * The posture of an arm whose angles are known.
   * @param {Float32Array} values
   * @param {boolean[]} known
   */
  joints(values, known) {
    if (!this.geometry || values.length !== this.geometry.joints.length) return;
    this.geometry.joints.forEach(({ name }, i) => (this.pose[name] = values[i]));
    this.view?.setJoints(values, known);
  }

  /**
   * While joints are measured nobody knows their angles yet: each is drawn about the middle of what was seen.
   * @param {RangeRow[]} rows
   */
  follow(rows) {
    const { view, geometry } = this;
    if (!view || !geometry) return;
    for (const { name, low, now, high } of rows) {
      const limits = geometry.joints.find((one) => one.name === name);
      if (!limits || now === null) continue;
      const angle = (limits.minimum + limits.maximum) / 2 + ((now - ((low ?? now) + (high ?? now)) / 2) * Math.PI) / 180;
      this.pose[name] = Math.min(limits.maximum, Math.max(limits.minimum, angle));
    }
    view.setJoints(this.pose);
    const next = rows.find(({ missing }) => missing);
    this.mark(next ? next.name : null, Boolean(next));
  }
}
