/* The floor of the 3D view: a plate, a grid with numbers, and axes.

Owns what lies on the table and how it is written. Must not know arms or cameras. `THREE` is the library; lengths are
metres. */

import { buffered } from "./arm3d_forms.js";

const AXES = ["#d64545", "#3f9e4d", "#3f76d6"];

/** Plate, lines, numbers and axes: a line each 50 mm, a darker one each 100 mm. `look` has their colours. */
export function floorParts(THREE, geometry, look) {
  const half = Math.max(2, Math.ceil((geometry.reach * 1.05) / 0.1)) * 0.1, lines = { minor: [], major: [] };
  for (let i = -Math.round(half / 0.05); i <= Math.round(half / 0.05); i++) {
    const at = 0.05 * i, row = i % 2 ? lines.minor : lines.major;
    row.push(at, -half, 0, at, half, 0, -half, at, 0, half, at, 0);
  }
  const paint = { color: look.floor, transparent: true, opacity: 0.55, side: THREE.DoubleSide, depthWrite: false };
  const plate = new THREE.Mesh(new THREE.PlaneGeometry(2 * half, 2 * half), new THREE.MeshBasicMaterial(paint));
  plate.position.z = -0.0006;
  plate.renderOrder = -3;
  const parts = [plate];
  for (const [name, row] of Object.entries(lines)) {
    const form = buffered(THREE, { position: row });
    const ink = new THREE.LineBasicMaterial({ color: look[name], depthWrite: false });
    const line = new THREE.LineSegments(form, ink);
    line.renderOrder = -2;
    parts.push(line);
  }
  const axes = axesOf(THREE, 0.07, 0.0018);
  axes.position.set(-half, -half, 0.001);
  return [...parts, ...numbers(THREE, geometry, look.text), axes];
}

/** x, y and z in red, green and blue. */
export function axesOf(THREE, length, radius) {
  const axes = new THREE.Group();
  AXES.forEach((colour, i) => {
    const form = new THREE.CylinderGeometry(radius, radius, length, 10);
    form.translate(0, length / 2, 0);
    if (i === 0) form.rotateZ(-Math.PI / 2);
    if (i === 2) form.rotateX(Math.PI / 2);
    const paint = { color: colour, emissive: colour, emissiveIntensity: 0.35 };
    axes.add(new THREE.Mesh(form, new THREE.MeshLambertMaterial(paint)));
  });
  return axes;
}

/** Millimetres along the arm's right side, and across in front of it, near enough to be seen with the arm. */
function numbers(THREE, { reach, heading }, colour) {
  const ahead = Math.max(0.2, Math.floor(6 * reach) / 10), right = -0.13, found = [];
  const c = Math.round(Math.cos(heading)), s = Math.round(Math.sin(heading));
  const put = (x, y, along) => {
    // From the arm's view of ahead and left to the frame of its foot.
    const at = [c * x - s * y, s * x + c * y];
    const axis = along === "ahead" ? (c ? 0 : 1) : c ? 1 : 0;
    const words = `${Math.round(1000 * at[axis])}`;
    found.push(text(THREE, words === "0" ? `${"xy"[axis]} 0 mm` : words, [...at, 0.004], colour, reach));
  };
  for (let x = 0; x < ahead + 0.05; x += 0.1) put(x, right, "ahead");
  for (let y = 0; y < 0.15; y += 0.1) put(ahead + 0.03, y, "across");
  return found;
}

function text(THREE, words, place, colour, reach) {
  const canvas = document.createElement("canvas");
  canvas.width = 160;
  canvas.height = 48;
  const pen = canvas.getContext("2d");
  Object.assign(pen, { font: "500 28px system-ui, sans-serif", fillStyle: colour });
  Object.assign(pen, { textAlign: "center", textBaseline: "middle" });
  pen.fillText(words, 80, 24);
  const map = new THREE.CanvasTexture(canvas);
  map.colorSpace = THREE.SRGBColorSpace;
  const sprite = new THREE.Sprite(new THREE.SpriteMaterial({ map, depthWrite: false }));
  sprite.scale.set(0.16 * reach, 0.048 * reach, 1);
  sprite.position.fromArray(place);
  return sprite;
}
