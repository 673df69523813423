// Meshes of a robot's URDF, for the 3D view: loaded only where an arm has some. Owns the bound of triangles, and how a file
// becomes flat surfaces in the frame of its link. The server has checked each file (studio/mesh_files.py); what is broken all
// the same is left out, and why is said.

import { whyOf } from "./widgets.js";

const MOST = 500_000; // triangles of a robot
const FAR = 100; // metres

/**
 * Load the meshes of links. A link whose meshes are not all there gets none.
 * @param {Three} THREE
 * @param {Link[]} links
 * @param {(link: Link, surfaces: Surface[]) => unknown} take
 * @returns {Promise<string[]>} what is not shown, and why
 */
export async function loadMeshes(THREE, links, take) {
  /** @type {Map<string, Three>} */
  const loaders = new Map();
  /** @type {Map<number, Three[]>} */
  const files = new Map();
  /** @type {string[]} */
  const said = [];
  let left = MOST;
  for (const link of links) {
    if (!link.meshes?.length) continue;
    try {
      const surfaces = [];
      for (const mesh of link.meshes) {
        const forms = files.get(mesh.mesh) ?? (await read(mesh, loaders));
        files.set(mesh.mesh, forms);
        for (const form of forms) {
          left -= form.getAttribute("position").count / 3;
          if (left < 0) throw new Error(`the robot has more than ${MOST} triangles`);
          surfaces.push(surface(THREE, form, mesh));
        }
      }
      take(link, surfaces);
    } catch (error) {
      said.push(`${link.name}: ${whyOf(error)}`);
    }
  }
  for (const forms of files.values()) for (const form of forms) form.dispose();
  return said;
}

/**
 * @param {MeshShape} mesh
 * @param {Map<string, Three>} loaders by kind
 * @returns {Promise<Three[]>}
 */
async function read({ mesh, kind }, loaders) {
  const answer = await fetch(`/meshes/${mesh}`);
  if (!answer.ok) throw new Error("its mesh is not there any more");
  const bytes = await answer.arrayBuffer();
  if (!loaders.has(kind)) {
    const made = kind === "stl" ? (await import("./vendor/STLLoader.js")).STLLoader : (await import("./vendor/GLTFLoader.js")).GLTFLoader;
    loaders.set(kind, new made());
  }
  /** @type {Three[]} */
  const forms = [];
  const loader = loaders.get(kind);
  if (kind === "stl") forms.push(loader.parse(bytes));
  else {
    const { scene } = await loader.parseAsync(bytes, "");
    scene.updateMatrixWorld(true);
    scene.traverse((/** @type {Three} */ part) => {
      if (!part.isMesh) return;
      const form = (part.geometry.index ? part.geometry.toNonIndexed() : part.geometry.clone()).applyMatrix4(part.matrixWorld);
      form.userData.colour = part.material.color;
      forms.push(form);
    });
  }
  return forms;
}

/**
 * A form in the frame of its link, as flat lists: positions, normals, colours.
 * @param {Three} THREE
 * @param {Three} form
 * @param {MeshShape} mesh
 * @returns {Surface}
 */
function surface(THREE, form, { kind, size, place, turn, rgb }) {
  const made = new THREE.BufferGeometry();
  made.setAttribute("position", form.getAttribute("position").clone());
  // Those of an STL are often left out, or zero.
  if (kind !== "stl" && form.getAttribute("normal")) made.setAttribute("normal", form.getAttribute("normal").clone());
  else made.computeVertexNormals();
  made.applyMatrix4(new THREE.Matrix4().compose(new THREE.Vector3(...place), new THREE.Quaternion(...turn), new THREE.Vector3(...size)));
  /** @type {Float32Array[]} */
  const [position, normal] = [made.getAttribute("position").array, made.getAttribute("normal").array];
  // What is no number is not near, either.
  if (!position.every((value) => Math.abs(value) <= FAR)) throw new Error(`its mesh is larger than ${FAR} m: is it in millimetres, without a scale?`);
  // A hostile or damaged file may have no usable direction; the light needs one.
  for (let i = 0; i < normal.length; i++) if (!Number.isFinite(normal[i])) normal[i] = 0;
  const tint = form.userData.colour ?? new THREE.Color(rgb), colour = new Float32Array(position.length);
  for (let i = 0; i < colour.length; i += 3) tint.toArray(colour, i);
  return { position, normal, color: colour };
}
