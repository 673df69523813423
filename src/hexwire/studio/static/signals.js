// The quantities of an arm as people read them: words, units, factors from SI. The same for live plots and recordings.

/**
 * @typedef {"position" | "goal" | "velocity" | "load" | "current" | "voltage" | "temperature"} Measured
 * @typedef {{ key: Measured | "error", words: string, unit: string, factor: number, dash?: number[], panel?: string, digits?: number }} JointSignal
 * @typedef {{ key: "rate" | "round_trip" | "faults", words: string, unit: string, factor: number, digits?: number }} ArmSignal
 */

/** Degrees in a radian. */
export const DEG = 180 / Math.PI;

/** @type {JointSignal[]} */
export const JOINT_SIGNALS = [
  { key: "position", words: "position", unit: "°", factor: DEG },
  { key: "goal", words: "goal", unit: "°", factor: DEG, dash: [5, 3] },
  { key: "error", words: "goal − position", unit: "°", factor: DEG, panel: "error" },
  { key: "velocity", words: "velocity", unit: "°/s", factor: DEG },
  { key: "load", words: "load", unit: "%", factor: 100 },
  { key: "current", words: "current", unit: "A", factor: 1 },
  { key: "voltage", words: "voltage", unit: "V", factor: 1 },
  { key: "temperature", words: "temperature", unit: "°C", factor: 1 },
];

/** @type {ArmSignal[]} */
export const ARM_SIGNALS = [
  { key: "rate", words: "state rate", unit: "Hz", factor: 1 },
  { key: "round_trip", words: "round trip", unit: "ms", factor: 1000 },
  { key: "faults", words: "joints with faults", unit: "", factor: 1, digits: 0 },
];

/**
 * A series of `Plot` for a joint's signal.
 * @param {string} joint
 * @param {number} index
 * @param {JointSignal} signal
 */
export function jointSeries(joint, index, signal) {
  return { name: `${joint} ${signal.words}`, quantity: signal.words, unit: signal.unit, colour: index, dash: signal.dash,
    digits: signal.digits, panel: signal.panel };
}

/**
 * Values in a signal's own unit; null if there are none. `find(key)` gives columns in SI units.
 * @param {JointSignal | ArmSignal} signal
 * @param {(key: string) => Float32Array | undefined} find
 */
export function valuesOf(signal, find) {
  if (signal.key === "error") {
    const goal = find("goal"), position = find("position");
    return goal && position ? goal.map((value, i) => signal.factor * (value - position[i])) : null;
  }
  const found = find(signal.key);
  if (!found) return null;
  return signal.factor === 1 ? found : found.map((value) => signal.factor * value);
}
