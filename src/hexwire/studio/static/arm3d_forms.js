/* Surfaces for the 3D view: boxes with bevelled edges, cylinders, balls and threads, as corners and normals.

Owns the triangles. Must not know arms or scenes. `THREE` is the library; lengths are metres. */

const CHAMFER = 0.0012;

/** One geometry of all shapes of a link, with a colour for each corner. */
export function mesh(THREE, shapes, colourOf) {
  const places = [], normals = [], colours = [], tint = new THREE.Color();
  for (const shape of shapes) {
    const [points, sides] = shape.kind === "box" ? bevelled(THREE, shape.size) : turned(shape);
    const turn = new THREE.Quaternion().fromArray(shape.turn), at = new THREE.Vector3().fromArray(shape.place);
    const v = new THREE.Vector3();
    tint.set(colourOf(shape));
    for (let i = 0; i < points.length; i += 3) {
      v.fromArray(points, i).applyQuaternion(turn).add(at).toArray(places, places.length);
      v.fromArray(sides, i).applyQuaternion(turn).toArray(normals, normals.length);
      tint.toArray(colours, colours.length);
    }
  }
  return buffered(THREE, { position: places, normal: normals, color: colours });
}

/** A geometry of flat lists with three numbers for each corner. */
export function buffered(THREE, lists) {
  const form = new THREE.BufferGeometry();
  for (const [name, list] of Object.entries(lists)) {
    form.setAttribute(name, new THREE.Float32BufferAttribute(list, 3));
  }
  return form;
}

/** A thin square rod along a line through points, in a flat list, metres: a line of one pixel is hard to see. */
export function thread(THREE, points, radius) {
  const places = [], from = new THREE.Vector3(), to = new THREE.Vector3(), way = new THREE.Vector3();
  const side = new THREE.Vector3(), other = new THREE.Vector3();
  for (let i = 0; i + 5 < points.length; i += 3) {
    from.fromArray(points, i);
    to.fromArray(points, i + 3);
    way.subVectors(to, from);
    if (way.lengthSq() < 1e-12) continue;
    way.normalize();
    // A little longer, so that there is no gap where the line turns.
    from.addScaledVector(way, -0.5 * radius);
    to.addScaledVector(way, 0.5 * radius);
    side.set(0, 0, 1).cross(way);
    if (side.lengthSq() < 1e-6) side.set(1, 0, 0);
    side.setLength(radius);
    other.crossVectors(way, side).setLength(radius);
    const ring = [side, other, side.clone().negate(), other.clone().negate()];
    for (let n = 0; n < 4; n++) {
      const a = ring[n], b = ring[(n + 1) % 4];
      for (const [end, off] of [[from, a], [from, b], [to, b], [from, a], [to, b], [to, a]]) {
        places.push(end.x + off.x, end.y + off.y, end.z + off.z);
      }
    }
  }
  return buffered(THREE, { position: places });
}

/** A box whose edges are cut off a little, so that they catch the light. */
function bevelled(THREE, size) {
  const cut = Math.min(CHAMFER, 0.2 * Math.min(...size)), half = size.map((length) => length / 2);
  const points = [], sides = [];
  const corner = (signs, axis) => signs.map((sign, i) => sign * (i === axis ? half[i] : half[i] - cut));
  const face = (corners) => {
    // A convex face about the origin: its normal points away from it.
    const [a, b, c] = corners.map((p) => new THREE.Vector3(...p));
    const normal = b.clone().sub(a).cross(c.clone().sub(a)).normalize();
    const out = normal.dot(a) >= 0, ring = out ? corners : [...corners].reverse();
    if (!out) normal.negate();
    for (let i = 1; i + 1 < ring.length; i++) {
      points.push(...ring[0], ...ring[i], ...ring[i + 1]);
      for (let n = 0; n < 3; n++) sides.push(normal.x, normal.y, normal.z);
    }
  };
  const with_ = (axis, sign, others) => {
    const signs = [0, 0, 0];
    signs[axis] = sign;
    others.forEach(([i, s]) => (signs[i] = s));
    return signs;
  };
  for (let axis = 0; axis < 3; axis++) {
    const [i, j] = [(axis + 1) % 3, (axis + 2) % 3];
    for (const sign of [1, -1]) {
      face([[1, 1], [-1, 1], [-1, -1], [1, -1]].map(([a, b]) => corner(with_(axis, sign, [[i, a], [j, b]]), axis)));
    }
    // The four edges along this axis.
    for (const a of [1, -1]) {
      for (const b of [1, -1]) {
        const low = with_(axis, -1, [[i, a], [j, b]]), high = with_(axis, 1, [[i, a], [j, b]]);
        face([corner(low, i), corner(high, i), corner(high, j), corner(low, j)]);
      }
    }
  }
  for (let i = 0; i < 8; i++) {
    const signs = [i & 1, i & 2, i & 4].map((bit) => (bit ? 1 : -1));
    face([0, 1, 2].map((axis) => corner(signs, axis)));
  }
  return [points, sides];
}

/** A cylinder along z with its edges cut off a little, or a ball. */
function turned({ kind, size }) {
  const [radius, length] = size, steps = radius > 0.02 ? 40 : 24, profile = [];
  if (kind === "sphere") {
    for (let i = 0; i <= 12; i++) {
      const angle = (Math.PI * i) / 12;
      profile.push([radius * Math.sin(angle), -radius * Math.cos(angle)]);
    }
  } else {
    const cut = Math.min(CHAMFER, 0.2 * Math.min(radius, length)), top = length / 2;
    profile.push([0, -top], [radius - cut, -top], [radius, cut - top]);
    profile.push([radius, top - cut], [radius - cut, top], [0, top]);
  }
  const points = [], sides = [];
  for (let p = 0; p + 1 < profile.length; p++) {
    const [r0, z0] = profile[p], [r1, z1] = profile[p + 1], long = Math.hypot(r1 - r0, z1 - z0);
    const out = (z1 - z0) / long, up = (r0 - r1) / long;
    for (let i = 0; i < steps; i++) {
      const a = (2 * Math.PI * i) / steps, b = (2 * Math.PI * (i + 1)) / steps;
      const at = (r, z, angle) => points.push(r * Math.cos(angle), r * Math.sin(angle), z);
      const side = (angle) => sides.push(out * Math.cos(angle), out * Math.sin(angle), up);
      at(r0, z0, a), at(r0, z0, b), at(r1, z1, b), at(r0, z0, a), at(r1, z1, b), at(r1, z1, a);
      side(a), side(b), side(b), side(a), side(b), side(a);
    }
  }
  return [points, sides];
}
