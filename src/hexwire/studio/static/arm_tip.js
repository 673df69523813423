/* Pose of the tip, computed from the joint positions of each frame with the geometry of the 3D view. Owns forward
kinematics over its links, and the numbers of the part Tip. */

import { degrees, fixed } from "/static/arm.js";

const GIMBAL = 1e-9;

function times([a, b, c, d], [x, y, z, w]) {
  return [d * x + a * w + b * z - c * y, d * y - a * z + b * w + c * x, d * z + a * y - b * x + c * w, d * w - a * x - b * y - c * z];
}

function turned([a, b, c, d], [x, y, z]) {
  const [u, v, w] = [2 * (b * z - c * y), 2 * (c * x - a * z), 2 * (a * y - b * x)];
  return [x + d * u + b * w - c * v, y + d * v + c * u - a * w, z + d * w + a * v - b * u];
}

/** Position in metres and quaternion x, y, z, w of the tip at joint positions in radians. */
export function tipOf(geometry, positions) {
  const frames = [];
  for (const link of geometry.links) {
    let turn = link.turn;
    if (link.axis) {
      const half = (link.multiplier * positions[link.joint] + link.offset) / 2;
      turn = times(turn, [...link.axis.map((value) => value * Math.sin(half)), Math.cos(half)]);
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

/** Roll, pitch and yaw about the base's fixed axes of a quaternion, radians; at a pitch of a quarter turn, roll is 0. */
export function rpyOf([x, y, z, w]) {
  const row = [1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)]; // first column of the rotation
  const cosine = Math.hypot(row[0], row[1]);
  const pitch = Math.atan2(-row[2], cosine);
  if (cosine < GIMBAL) return [0, pitch, Math.atan2(-2 * (x * y - z * w), 1 - 2 * (x * x + z * z))];
  return [Math.atan2(2 * (y * z + x * w), 1 - 2 * (x * x + y * y)), pitch, Math.atan2(row[1], row[0])];
}

/** Values of the tip by name: x, y, z in metres, angles in radians. */
export function tipValues(args, positions) {
  const { position, quaternion } = tipOf(args.geometry, positions);
  const [roll, pitch, yaw] = rpyOf(quaternion);
  const values = { x: position[0], y: position[1], z: position[2], roll, pitch, yaw };
  (args.turns || []).forEach(({ offset, factors }, k) => {
    const sum = Object.entries(factors).reduce((total, [i, factor]) => total + factor * positions[i], offset);
    values[k ? "toolroll" : "toolpitch"] = sum;
  });
  return values;
}

export function mountTip(page) {
  const cells = page.all("[data-tip]");
  if (!page.args.geometry || !cells.length) return;
  page.on("draw", () => {
    const values = tipValues(page.args, page.positions());
    for (const cell of cells) {
      const name = cell.dataset.tip;
      const text = name.length === 1 ? fixed(1000 * values[name]) : fixed(degrees(values[name]));
      if (cell.textContent !== text) cell.textContent = text;
    }
  });
}
