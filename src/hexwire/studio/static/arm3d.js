/* A 3D view of an arm, drawn with three.js: the arm, the floor with its grid and numbers, and the surfaces of which both are
made.

Owns the drawing and the camera. Must not know pages, sockets or robots. It draws only after something changed. Lengths are
metres.

  import { Arm3D } from "./arm3d.js";
  const view = new Arm3D(element, geometry, { theme: "light" });   // geometry: hexwire.studio.geometry.make_geometry
  view.setJoints(float32Array)       joint positions in radians in the order of geometry.joints, or {name: radians};
                                     once a frame is fine: values that did not change draw nothing
  view.setJoints(values, known)      which of them are from now (booleans): what the others move is grey, where it was last
  view.setGhost(joints | null)       a second, translucent arm: where the arm would go
  view.setHighlight(name | "" | null) the part that a joint moves, in one strong colour; "": the foot; null: nothing
  view.setTip(pose | "own" | null)   axes at a pose {position: [x, y, z], quaternion: [x, y, z, w]}, in metres; "own":
                                     at this arm's own tip
  view.setTable(height | null)       height of the table in metres; null: no table, the grid is at 0
  view.trace(points | null)          a line through points, [[x, y, z], ...] or a flat Float32Array, metres
  view.tip()                         {position, quaternion} of the drawn arm's tip
  view.setTheme("light" | "dark" | "auto")
  view.resetView("home" | "front" | "side" | "top" | "tip")   but for "tip" the camera follows an arm that leaves the
                                     picture, until somebody turns it
  view.lookAt([x, y, z])             turns about this place from now on; a double click does it with a joint
  view.resize()                      only needed where ResizeObserver does not notice
  view.dispose()
  view.available                     false without WebGL: then the element says so, and every call does nothing
  view.drawn, view.pending           number of pictures drawn so far; whether one is due

Mouse: drag turns, wheel zooms once the view has the focus, right drag moves, a double click looks at a joint. Touch: one finger turns, two zoom and
move; a finger that starts up or down scrolls the page. Keys: arrows turn, Shift and arrows move, + and - zoom, 0 or
Home resets. Escape is not taken. */

/** @type {Three} */
let THREE;
/** @type {Three} */
let OrbitControls;
try {
  [THREE, { OrbitControls }] = await Promise.all([import("./vendor/three.module.min.js"), import("./vendor/OrbitControls.js")]);
} catch (error) {
  console.warn("arm3d: three.js is missing", error);
}

/** @type {Record<Theme, Look>} */
const LOOKS = {
  light: { sky: "#fbfcfd", ground: "#e3e8ee", floor: "#d9dfe6", minor: "#cfd6de", major: "#a9b4c0", text: "#4a5563",
           shadow: "#c3cad3", lost: "#8a929c", key: 1.9, fill: 1.2, trace: "#b02800", ghost: "#0a58b0" },
  dark: { sky: "#1b2129", ground: "#101419", floor: "#161b21", minor: "#2a333e", major: "#465362", text: "#a3afbd",
          shadow: "#0b0e12", lost: "#7d8793", key: 1.8, fill: 1.1, trace: "#efbb11", ghost: "#689bdc" },
};
const LABEL = "3D view of the arm. Arrow keys turn it, Shift and arrow keys move it, plus and minus zoom, 0 resets.";
const SOFTWARE_PAUSE = 60, STILL = 250;
const EDGE = 0.85; // share of the half picture beyond which joints are about to leave it
/** @type {Record<string, number[]>} */
const VIEWS = { home: [0.95, -1.25, 0.62], front: [1, 0, 0.12], side: [0, -1, 0.08], top: [-0.001, 0, 1] };

export class Arm3D {
  /** @type {Theme | null} */
  theme = null;
  /** @type {Figure | undefined} */
  _arm;
  /** @type {Figure | undefined} */
  _ghost;
  /** @type {boolean[]} */
  _grey = [];
  /** @type {number | null} */
  _table = null;
  /** @type {(() => void)[]} */
  _stops = [];
  /** @type {string | null} */
  _marked = null;
  /** @type {Map<Link, Surface[]>} */
  _meshes = new Map(); // surfaces that were loaded
  /** @type {Theme | "auto"} */
  _wanted = "auto";
  _seen = false;
  _sized = false;
  _from = ""; // the view that the camera has; empty once somebody has turned it
  _room = EDGE; // of that view
  _ownTip = false;
  _tipWanted = false;
  _pause = 0; // ms between two pictures
  _legend = document.createElement("p");
  _plain = document.createElement("p"); // says which links are drawn plainly
  /** @type {boolean[]} */
  _moves = []; // which links a joint moves
  /** @type {HTMLElement | undefined} */
  _note;

  /**
   * @param {HTMLElement} element
   * @param {Geometry} geometry
   * @param {ViewOptions} options
   */
  constructor(element, geometry, options = {}) {
    this.element = element;
    this.geometry = geometry;
    this.options = options;
    this.available = false;
    this.drawn = 0;
    this._next = this._frame = this._later = this._still = 0;
    this._names = geometry.joints.map((joint) => joint.name);
    if (getComputedStyle(element).position === "static") element.style.position = "relative";
    if (!THREE || !OrbitControls) {
      this._say("The 3D view is missing here: its library was not found. Everything else on this page works.");
      return;
    }
    let context = contextOf(true);
    if (!context) {
      this._say("This browser shows no 3D here: WebGL is off. Everything else on this page works.");
      return;
    }
    // Without a graphics chip every pixel costs processor time, which the arm's own programs may need.
    this._pause = isSoftware(context) ? SOFTWARE_PAUSE : 0;
    if (this._pause) context = contextOf(false) ?? context;
    this._renderer = new THREE.WebGLRenderer({ canvas: context.canvas, context });
    this.available = true;
    this._prepare();
    this.setTheme(options.theme ?? "auto");
    this.setJoints(new Float32Array(this._names.length));
    this.resetView();
    this.resize();
    this._loadMeshes();
  }

  // -- what is shown ---------------------------------------------------------------------------------------------

  /**
   * @param {Joints} joints
   * @param {boolean[] | null} known
   */
  setJoints(joints, known = null) {
    if (!this._arm) return;
    const moved = this._place(this._arm, joints);
    if (this._mark(this._arm, known, joints) || moved) this._change();
    // The first posture that is known decides what the camera sees.
    if (!this._seen && known?.some(Boolean)) {
      this._seen = true;
      this.resetView();
    } else if (moved && this._from && this._extent(this._arm) > this._room) this.resetView(this._from);
  }

  /**
   * How far from the middle of the picture a joint or the tip is, as a share of the way to its edge.
   * @param {Figure} arm
   */
  _extent(arm) {
    const place = new THREE.Vector3();
    this._camera.updateMatrixWorld();
    return Math.max(...arm.frames.map((frame) => {
      frame.getWorldPosition(place).project(this._camera);
      return Math.max(Math.abs(place.x), Math.abs(place.y));
    }));
  }

  /**
   * Make grey what a joint moves of which nobody knows where it is.
   * @param {Figure} arm
   * @param {boolean[] | null} known
   * @param {Joints} joints
   */
  _mark(arm, known, joints) {
    const lost = this._names.map((name, i) => (known ? !known[i] : Number.isNaN(valueOf(joints, name, i))));
    const { links } = this.geometry;
    /** @type {boolean[]} */
    const grey = [];
    links.forEach((link, i) => grey.push(Boolean((link.axis && lost[link.joint]) || grey[link.parent])));
    const seen = lost.map(Number).join("");
    if (seen === arm.lost) return false;
    arm.lost = seen;
    this._grey = grey;
    this._paintGrey(arm);
    const names = this._names.filter((_, i) => lost[i]);
    const all = names.length === lost.length;
    this._legend.textContent = names.length ? `Grey: ${all ? "the arm" : `what ${names.join(" ")} moves`} may be elsewhere` : "";
    this._legend.hidden = !names.length;
    return true;
  }

  /** @param {Figure} arm */
  _paintGrey(arm) {
    arm.bodies.forEach((body, i) => {
      if (body) body.material = this._grey[i] ? this._lostMaterial : this._isMarked(i) ? this._markedMaterial : body.userData.own;
    });
    for (const [shade, , i] of arm.shades) shade.visible = !this._grey[i];
    this._tipAxes.visible = this._tipWanted && !(this._ownTip && this._grey[this.geometry.tip]);
  }

  /** @param {string | null} name */
  setHighlight(name) {
    if (!this._arm || this._marked === name) return;
    this._marked = name;
    this._paintGrey(this._arm);
    this._change();
  }

  /** @param {number} i */
  _isMarked(i) {
    const link = this.geometry.links[i];
    if (this._marked === "") return !this._moves[i];
    return Boolean(this._marked && link.axis && this._names[link.joint] === this._marked);
  }

  /** @param {Joints | null} joints */
  setGhost(joints) {
    const ghost = this._ghost;
    if (!ghost) return;
    const shown = ghost.root.visible;
    ghost.root.visible = joints !== null;
    if ((joints && this._place(ghost, joints)) || shown !== ghost.root.visible) this._change();
  }

  /** @param {TipPose | "own" | null} pose */
  setTip(pose) {
    if (!this.available) return;
    this._ownTip = pose === "own";
    this._tipWanted = pose !== null;
    this._tipAxes.visible = this._tipWanted && !(this._ownTip && this._grey[this.geometry.tip]);
    if (pose === "own") this._followTip();
    else if (pose) this._putTip(pose);
    this._change();
  }

  /** @param {number | null} height */
  setTable(height) {
    if (!this.available) return;
    this._table = height;
    this._floor.position.z = height ?? 0;
    this._shade();
    this._change();
  }

  /** @param {number[][] | Float32Array | null} points */
  trace(points) {
    if (!this.available) return;
    const flat = points instanceof Float32Array ? points : (points ?? []).flat();
    this._trace.geometry.dispose();
    this._trace.geometry = thread(flat, 0.0022 * this.geometry.reach);
    this._trace.visible = flat.length > 3;
    this._change();
  }

  get pending() {
    return Boolean(this._frame || this._later || this._still);
  }

  /** @returns {{ position: number[], quaternion: number[] } | null} */
  tip() {
    if (!this._arm) return null;
    const position = new THREE.Vector3(), quaternion = new THREE.Quaternion(), scale = new THREE.Vector3();
    this._arm.root.updateMatrixWorld();
    this._arm.frames[this.geometry.tip].matrixWorld.decompose(position, quaternion, scale);
    return { position: position.toArray(), quaternion: quaternion.toArray() };
  }

  /** @param {Theme | "auto"} theme */
  setTheme(theme) {
    if (!this.available) return;
    this._wanted = theme;
    const root = document.documentElement.dataset.theme;
    const asked = theme === "auto" ? (root === "light" || root === "dark" ? root : null) : theme;
    const dark = asked ? asked === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
    const name = dark ? "dark" : "light";
    if (name === this.theme) return;
    this.theme = name;
    this._dress();
    this._change();
  }

  resetView(name = "home") {
    if (!this._arm) return;
    const tip = name === "tip" ? this.tip() : null;
    if (tip) {
      this.lookAt(tip.position, 0.55 * this.geometry.reach);
      return;
    }
    const { reach, heading } = this.geometry, up = new THREE.Vector3(0, 0, 1);
    // What is there now fills the picture, with some room to move.
    const box = new THREE.Box3();
    this._arm.root.updateMatrixWorld();
    for (const body of this._arm.bodies) if (body) box.expandByObject(body);
    const aim = box.getCenter(new THREE.Vector3()).toArray();
    const size = Math.max(0.5 * box.getSize(new THREE.Vector3()).length(), 0.35 * reach);
    const way = new THREE.Vector3(...(VIEWS[name] ?? VIEWS.home)).normalize().applyAxisAngle(up, heading);
    // A narrow picture is filled by the arm's width, so the camera steps back.
    const far = 3.5 * size * Math.max(1, 1.05 / this._camera.aspect);
    this._controls.target.set(...aim);
    this._camera.position.set(...aim).addScaledVector(way, far);
    this._controls.update();
    this._from = name;
    // An arm that fills the picture is near its edge already.
    this._room = Math.max(EDGE, this._extent(this._arm) + 0.04);
    this._change();
  }

  /**
   * @param {number[]} place
   * @param {number | null} far
   */
  lookAt(place, far = null) {
    if (!this.available) return;
    this._from = "";
    const { target } = this._controls, way = this._camera.position.clone().sub(target);
    if (far !== null) way.setLength(far);
    target.fromArray(place);
    this._camera.position.copy(target).add(way);
    this._controls.update();
    this._change();
  }

  /**
   * Look at the joint that moves what is under the pointer.
   * @param {MouseEvent} event
   */
  _choose(event) {
    if (!this._arm) return;
    const box = this._renderer.domElement.getBoundingClientRect(), ray = new THREE.Raycaster();
    const x = ((event.clientX - box.left) / box.width) * 2 - 1, y = 1 - ((event.clientY - box.top) / box.height) * 2;
    ray.setFromCamera(new THREE.Vector2(x, y), this._camera);
    const [hit] = ray.intersectObjects(this._arm.bodies.filter(Boolean), false);
    if (!hit) return;
    const at = this._arm.bodies.indexOf(hit.object), place = new THREE.Vector3();
    this.lookAt(this._arm.frames[at].getWorldPosition(place).toArray());
  }

  resize() {
    if (!this.available) return;
    const { clientWidth: width, clientHeight: height } = this.element;
    if (!width || !height) return;
    this._renderer.setPixelRatio(this._pause ? 1 : Math.min(devicePixelRatio || 1, 2));
    this._renderer.setSize(width, height, false);
    this._camera.aspect = width / height;
    this._camera.updateProjectionMatrix();
    if (!this._sized) {
      this._sized = true;
      this.resetView();
    }
    this._change();
  }

  dispose() {
    if (!this.available) return;
    this.available = false;
    this._arm = this._ghost = undefined;
    cancelAnimationFrame(this._frame);
    clearTimeout(this._later);
    clearTimeout(this._still);
    for (const stop of this._stops) stop();
    this._controls.dispose();
    this._clear(this._scene);
    this._renderer.dispose();
    this._renderer.domElement.remove();
    this._legend.remove();
    this._plain.remove();
  }

  /** Load meshes where the arm has some; until then, and where one is broken, its link is drawn as plain rods. */
  async _loadMeshes() {
    const { links, faults = [] } = this.geometry;
    if (faults.length) this._sayPlain(faults);
    if (!links.some((link) => link.meshes?.length)) return;
    const said = await import("./arm_meshes.js").then(
      ({ loadMeshes }) => loadMeshes(THREE, links, (link, surfaces) => this._meshes.set(link, surfaces)),
      () => ["the studio is gone, which has the meshes"],
    );
    if (!this.available) return;
    if (said.length) this._sayPlain([...faults, ...said]);
    this._dress();
    this.resetView();
  }

  /**
   * One line says which links are plain, and why.
   * @param {string[]} faults
   */
  _sayPlain(faults) {
    this._plain.textContent = `Drawn plainly: ${faults[0]}${faults.length > 1 ? `, and ${faults.length - 1} more` : ""}`;
    this._plain.title = faults.join("\n");
    this._plain.hidden = false;
  }

  // -- scene -----------------------------------------------------------------------------------------------------

  _prepare() {
    /** @type {HTMLCanvasElement} */
    const canvas = this._renderer.domElement;
    Object.assign(canvas.style, { width: "100%", height: "100%", display: "block" });
    canvas.tabIndex = 0;
    canvas.setAttribute("role", "application");
    canvas.setAttribute("aria-label", this.options.label ?? LABEL);
    for (const line of [this._legend, this._plain]) {
      line.setAttribute("role", "status");
      line.hidden = true;
      Object.assign(line.style, { position: "absolute", left: "12px", bottom: "8px", margin: "0", fontSize: "12px", pointerEvents: "none" });
    }
    Object.assign(this._plain.style, { bottom: "26px", right: "12px" });
    this.element.append(canvas, this._legend, this._plain);
    this._scene = new THREE.Scene();
    this._camera = new THREE.PerspectiveCamera(32, 1, 0.02, 20);
    this._camera.up.set(0, 0, 1);
    const controls = (this._controls = new OrbitControls(this._camera, canvas));
    Object.assign(controls, { enableZoom: false, minDistance: 0.08, maxDistance: 6, maxPolarAngle: 0.62 * Math.PI });
    // On a phone the view is as wide as the page, which must still scroll.
    canvas.style.touchAction = "pan-y";
    controls.addEventListener("change", () => this._change());
    controls.addEventListener("start", () => (this._from = ""));
    this._sky = new THREE.HemisphereLight();
    this._key = new THREE.DirectionalLight();
    this._key.position.set(0.5, -0.75, 1.5);
    this._back = new THREE.DirectionalLight();
    this._back.position.set(-1, 0.8, 0.4);
    this._floor = new THREE.Group();
    this._trace = new THREE.Mesh(new THREE.BufferGeometry(), new THREE.MeshBasicMaterial({ side: THREE.DoubleSide }));
    this._trace.frustumCulled = this._trace.visible = false;
    this._tipAxes = axesOf(0.09 * this.geometry.reach, 0.0035 * this.geometry.reach);
    this._tipAxes.visible = false;
    // A lamp at the camera, so that no side that is looked at is in the dark.
    this._lamp = new THREE.DirectionalLight();
    this._lamp.position.set(-0.3, 0.25, 1);
    this._camera.add(this._lamp);
    this._scene.add(this._camera, this._sky, this._key, this._back, this._floor, this._trace, this._tipAxes);
    this._listen(canvas);
  }

  /** @param {HTMLCanvasElement} canvas */
  _listen(canvas) {
    /** @type {<E extends Event>(target: EventTarget, name: string, act: (event: E) => void) => void} */
    const on = (target, name, act) => {
      const listener = /** @type {EventListener} */ (act);
      target.addEventListener(name, listener);
      this._stops.push(() => target.removeEventListener(name, listener));
    };
    on(canvas, "keydown", (/** @type {KeyboardEvent} */ event) => this._key_down(event));
    on(canvas, "dblclick", (/** @type {MouseEvent} */ event) => this._choose(event));
    // The wheel scrolls the page until somebody has chosen the view.
    on(canvas, "focus", () => (this._controls.enableZoom = true));
    on(canvas, "blur", () => (this._controls.enableZoom = false));
    on(canvas, "pointerdown", () => canvas.focus({ preventScroll: true }));
    on(canvas, "webglcontextlost", (event) => {
      event.preventDefault();
      this._say("This browser's graphics were reset. The 3D view returns when they do.");
    });
    on(canvas, "webglcontextrestored", () => {
      this._note?.remove();
      this._change();
    });
    on(matchMedia("(prefers-color-scheme: dark)"), "change", () => this.setTheme(this._wanted));
    const size = new ResizeObserver(() => this.resize());
    size.observe(this.element);
    const themed = new MutationObserver(() => this.setTheme(this._wanted));
    themed.observe(document.documentElement, { attributes: true, attributeFilter: ["data-theme"] });
    this._stops.push(() => size.disconnect(), () => themed.disconnect());
  }

  _dress() {
    const dark = this.theme === "dark", theme = dark ? "dark" : "light", look = LOOKS[theme], before = [this._arm, this._ghost];
    this.element.style.background = `linear-gradient(${look.sky}, ${look.ground})`;
    this._sky.color.set("#ffffff");
    this._sky.groundColor.set(dark ? "#5c6672" : "#aeb6c0");
    this._sky.intensity = look.fill;
    this._key.intensity = look.key;
    this._back.intensity = 0.4 * look.key;
    this._lamp.intensity = 0.42 * look.key;
    this._trace.material.color.set(this.options.traceColour ?? look.trace);
    for (const arm of before) if (arm) this._clear(arm.root);
    const solid = new THREE.MeshPhongMaterial({ vertexColors: true, shininess: 28, specular: "#262626" });
    this._shadeMaterial = new THREE.MeshBasicMaterial({ color: look.shadow });
    this._markedMaterial = new THREE.MeshPhongMaterial({ color: look.trace, emissive: look.trace, emissiveIntensity: 0.3 });
    this._lostMaterial = new THREE.MeshLambertMaterial({ color: look.lost, transparent: true, opacity: 0.5 });
    const arm = (this._arm = this._assemble(solid, theme, true));
    arm.lost = before[0]?.lost;
    this._paintGrey(arm);
    // Behind the arm where both are at the same place.
    const behind = { polygonOffset: true, polygonOffsetFactor: 2, polygonOffsetUnits: 8 };
    const veil = new THREE.MeshLambertMaterial({ color: look.ghost, transparent: true, opacity: 0.42, ...behind });
    this._depthMaterial = new THREE.MeshBasicMaterial({ colorWrite: false, ...behind });
    const ghost = (this._ghost = this._assemble(veil, theme, false));
    ghost.root.visible = Boolean(before[1]?.root.visible);
    this._scene.add(arm.root, ghost.root);
    if (before[0]?.joints) this._place(arm, before[0].joints);
    if (before[1]?.joints) this._place(ghost, before[1].joints);
    this._lay(look);
    this._shade();
  }

  /**
   * One mesh for each link, with colours in its corners; `solid` adds the shadows on the table.
   * @param {Three} material
   * @param {Theme} theme
   * @param {boolean} solid
   * @returns {Figure}
   */
  _assemble(material, theme, solid) {
    const root = new THREE.Group();
    /** @type {Pick<Figure, "frames" | "shades" | "bodies">} */
    const { frames, shades, bodies } = { frames: [], shades: [], bodies: [] };
    /** @type {boolean[]} */
    const moves = [];
    const palette = this.options.palette?.[theme] ?? this.geometry.palette[theme];
    const colours = this.geometry.colours[theme];
    for (const link of this.geometry.links) {
      const frame = new THREE.Group();
      frame.position.fromArray(link.place);
      frame.quaternion.fromArray(link.turn);
      (link.parent < 0 ? root : frames[link.parent]).add(frame);
      frames.push(frame);
      moves.push(Boolean(link.axis) || (link.parent >= 0 && moves[link.parent]));
      // What does not move needs no second picture.
      bodies.push(null);
      const loaded = this._meshes.get(link) ?? [];
      const shapes = [...link.shapes, ...(loaded.length ? [] : (link.plain ?? []))];
      if (!(shapes.length || loaded.length) || (!solid && !moves.at(-1))) continue;
      const form = mesh(shapes, (shape) =>
        shape.rgb ?? (shape.joint === undefined ? colours[shape.colour ?? ""] : palette[shape.joint % palette.length]), loaded);
      if (!solid) {
        // Depth first, so that the inner faces of a translucent arm do not shine through.
        const depth = new THREE.Mesh(form, this._depthMaterial);
        depth.renderOrder = 1;
        frame.add(depth);
      }
      const body = new THREE.Mesh(form, material);
      body.renderOrder = solid ? 0 : 2;
      body.userData.own = material;
      bodies[bodies.length - 1] = body;
      frame.add(body);
      if (solid) {
        const shade = new THREE.Mesh(form, this._shadeMaterial);
        shade.matrixAutoUpdate = false;
        shade.matrixWorldAutoUpdate = false;
        shade.frustumCulled = false;
        shade.renderOrder = -1;
        shades.push([shade, frame, bodies.length - 1]);
        root.add(shade);
      }
    }
    this._moves = moves;
    return { root, frames, shades, bodies, joints: null };
  }

  /**
   * @param {Figure} arm
   * @param {Joints} joints
   */
  _place(arm, joints) {
    const values = this._names.map((name, i) => {
      const value = valueOf(joints, name, i);
      return Number.isFinite(value) ? value : (arm.joints?.[i] ?? 0);
    });
    if (arm.joints?.every((value, i) => Math.abs(value - values[i]) < 2e-5)) return false;
    arm.joints = values;
    const turn = new THREE.Quaternion(), axis = new THREE.Vector3();
    this.geometry.links.forEach((link, i) => {
      if (!link.axis) return;
      const value = link.multiplier * values[link.joint] + link.offset;
      axis.fromArray(link.axis);
      if (link.slides) {
        arm.frames[i].position.copy(axis).multiplyScalar(value).applyQuaternion(turn.fromArray(link.turn));
        arm.frames[i].position.add(axis.fromArray(link.place));
        return;
      }
      turn.setFromAxisAngle(axis, value);
      arm.frames[i].quaternion.fromArray(link.turn).multiply(turn);
    });
    if (arm === this._arm) {
      if (this._ownTip) this._followTip();
      this._shade();
    }
    return true;
  }

  /** Flatten every link along the light onto the table. */
  _shade() {
    if (!this._arm) return;
    const z = (this._table ?? 0) + 0.0004, light = this._key.position;
    const x = light.x / light.z, y = light.y / light.z;
    const flat = new THREE.Matrix4().set(1, 0, -x, x * z, 0, 1, -y, y * z, 0, 0, 0.0005, z, 0, 0, 0, 1);
    this._arm.root.updateMatrixWorld();
    for (const [shade, frame] of this._arm.shades) shade.matrixWorld.multiplyMatrices(flat, frame.matrixWorld);
  }

  /** @param {Look} look */
  _lay(look) {
    this._clear(this._floor);
    this._floor.clear();
    this._floor.add(...floorParts(this.geometry, look));
    this._floor.position.z = this._table ?? 0;
  }

  _followTip() {
    const tip = this.tip();
    if (tip) this._putTip(tip);
  }

  /** @param {TipPose} pose */
  _putTip({ position, quaternion }) {
    this._tipAxes.position.fromArray(position);
    if (quaternion) this._tipAxes.quaternion.fromArray(quaternion);
  }

  /** @param {Three} group */
  _clear(group) {
    group.traverse((/** @type {Three} */ part) => {
      part.geometry?.dispose();
      part.material?.map?.dispose();
      part.material?.dispose();
    });
    if (group.parent && group !== this._floor) group.removeFromParent();
  }

  // -- drawing and keys ------------------------------------------------------------------------------------------

  _change() {
    if (this._frame || !this.available) return;
    this._frame = requestAnimationFrame((now) => {
      this._frame = 0;
      if (now < this._next) {
        clearTimeout(this._later);
        this._later = setTimeout(() => {
          this._later = 0;
          this._change();
        }, this._next - now);
        return;
      }
      if (!this.element.clientWidth || !this.element.clientHeight || !this._arm) return;
      this._next = now + this._pause;
      if (this._pause) this._refine();
      this._draw();
    });
  }

  _draw() {
    this._renderer.render(this._scene, this._camera);
    this.drawn += 1;
  }

  /** Coarse while things move; once they stand still, one picture at twice the size has smooth edges. */
  _refine() {
    clearTimeout(this._still);
    if (this._renderer.getPixelRatio() !== 1) this._renderer.setPixelRatio(1);
    this._still = setTimeout(() => {
      this._still = 0;
      if (!this.element.clientWidth) return;
      this._renderer.setPixelRatio(2);
      this._draw();
    }, STILL);
  }

  /** @param {KeyboardEvent} event */
  _key_down(event) {
    if (event.ctrlKey || event.altKey || event.metaKey) return;
    /** @type {Record<string, number[]>} */
    const ways = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
    const way = ways[event.key];
    if (way) this._step(way[0], way[1], event.shiftKey);
    else if (event.key === "+" || event.key === "=") this._zoom(1 / 1.12);
    else if (event.key === "-") this._zoom(1.12);
    else if (event.key === "0" || event.key === "Home") this.resetView();
    else return;
    event.preventDefault();
  }

  /**
   * @param {number} x
   * @param {number} y
   * @param {boolean} moves
   */
  _step(x, y, moves) {
    this._from = "";
    const target = this._controls.target;
    const arm = this._camera.position.clone().sub(target);
    if (moves) {
      const by = new THREE.Vector3(x, y, 0).multiplyScalar(0.05 * arm.length());
      by.applyQuaternion(this._camera.quaternion);
      target.add(by);
      this._camera.position.add(by);
    } else {
      const up = new THREE.Vector3(0, 0, 1), round = new THREE.Spherical();
      const upright = new THREE.Quaternion().setFromUnitVectors(up, new THREE.Vector3(0, 1, 0));
      round.setFromVector3(arm.applyQuaternion(upright));
      round.theta += 0.12 * x;
      round.phi = Math.min(Math.max(round.phi - 0.1 * y, 0.02), this._controls.maxPolarAngle);
      arm.setFromSpherical(round).applyQuaternion(upright.invert());
      this._camera.position.copy(target).add(arm);
    }
    this._controls.update();
    this._change();
  }

  /** @param {number} by */
  _zoom(by) {
    this._from = "";
    const target = this._controls.target, arm = this._camera.position.clone().sub(target);
    arm.clampLength(this._controls.minDistance, this._controls.maxDistance).multiplyScalar(by);
    this._camera.position.copy(target).add(arm);
    this._controls.update();
    this._change();
  }

  /** @param {string} words */
  _say(words) {
    this._note?.remove();
    this._note = document.createElement("p");
    this._note.textContent = words;
    this._note.setAttribute("role", "status");
    const middle = { display: "grid", placeItems: "center", textAlign: "center" };
    Object.assign(this._note.style, { position: "absolute", inset: "0", margin: "0", padding: "1rem", ...middle });
    this.element.append(this._note);
  }
}

/** @type {(joints: Joints, name: string, i: number) => number} */
const valueOf = (joints, name, i) => (Array.isArray(joints) || joints instanceof Float32Array || joints instanceof Float64Array ? joints[i] : joints[name]);

/**
 * @param {boolean} antialias
 * @returns {WebGL2RenderingContext | null}
 */
function contextOf(antialias) {
  const wishes = { antialias, alpha: true, powerPreference: "low-power" };
  return /** @type {WebGL2RenderingContext | null} */ (document.createElement("canvas").getContext("webgl2", wishes));
}

/** @param {WebGL2RenderingContext} context */
function isSoftware(context) {
  const info = context.getExtension("WEBGL_debug_renderer_info");
  const name = context.getParameter(info ? info.UNMASKED_RENDERER_WEBGL : context.RENDERER);
  return /swiftshader|llvmpipe|softpipe|software|basic render/i.test(String(name));
}

// -- the floor: a plate, a grid with numbers, axes --------------------------------------------------------------

const AXES = ["#d64545", "#3f9e4d", "#3f76d6"];

/**
 * Plate, lines, numbers and axes: a line each 50 mm, a darker one each 100 mm. `look` has their colours.
 * @param {Geometry} geometry
 * @param {Look} look
 * @returns {Three[]}
 */
function floorParts(geometry, look) {
  const half = Math.max(2, Math.ceil((geometry.reach * 1.05) / 0.1)) * 0.1;
  /** @type {Record<"minor" | "major", number[]>} */
  const lines = { minor: [], major: [] };
  for (let i = -Math.round(half / 0.05); i <= Math.round(half / 0.05); i++) {
    const at = 0.05 * i, row = i % 2 ? lines.minor : lines.major;
    row.push(at, -half, 0, at, half, 0, -half, at, 0, half, at, 0);
  }
  const paint = { color: look.floor, transparent: true, opacity: 0.55, side: THREE.DoubleSide, depthWrite: false };
  const plate = new THREE.Mesh(new THREE.PlaneGeometry(2 * half, 2 * half), new THREE.MeshBasicMaterial(paint));
  plate.position.z = -0.0006;
  plate.renderOrder = -3;
  const parts = [plate];
  for (const name of /** @type {const} */ (["minor", "major"])) {
    const form = buffered({ position: lines[name] });
    const ink = new THREE.LineBasicMaterial({ color: look[name], depthWrite: false });
    const line = new THREE.LineSegments(form, ink);
    line.renderOrder = -2;
    parts.push(line);
  }
  const axes = axesOf(0.07, 0.0018);
  axes.position.set(-half, -half, 0.001);
  return [...parts, ...numbers(geometry, look.text), axes];
}

/**
 * x, y and z in red, green and blue.
 * @param {number} length
 * @param {number} radius
 */
function axesOf(length, radius) {
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

/**
 * Millimetres along the arm's right side, and across in front of it, near enough to be seen with the arm.
 * @param {Geometry} geometry
 * @param {string} colour
 * @returns {Three[]}
 */
function numbers({ reach, heading }, colour) {
  /** @type {Three[]} */
  const found = [];
  const ahead = Math.max(0.2, Math.floor(6 * reach) / 10), right = -0.13;
  const c = Math.round(Math.cos(heading)), s = Math.round(Math.sin(heading));
  /** @type {(x: number, y: number, along: "ahead" | "across") => void} */
  const put = (x, y, along) => {
    // From the arm's view of ahead and left to the frame of its foot.
    const at = [c * x - s * y, s * x + c * y];
    const axis = along === "ahead" ? (c ? 0 : 1) : c ? 1 : 0;
    const words = `${Math.round(1000 * at[axis])}`;
    found.push(text(words === "0" ? `${"xy"[axis]} 0 mm` : words, [...at, 0.004], colour, reach));
  };
  for (let x = 0; x < ahead + 0.05; x += 0.1) put(x, right, "ahead");
  for (let y = 0; y < 0.15; y += 0.1) put(ahead + 0.03, y, "across");
  return found;
}

/**
 * @param {string} words
 * @param {number[]} place
 * @param {string} colour
 * @param {number} reach
 */
function text(words, place, colour, reach) {
  const canvas = document.createElement("canvas");
  canvas.width = 160;
  canvas.height = 48;
  const pen = canvas.getContext("2d");
  if (pen) {
    Object.assign(pen, { font: "500 28px system-ui, sans-serif", fillStyle: colour, textAlign: "center", textBaseline: "middle" });
    pen.fillText(words, 80, 24);
  }
  const map = new THREE.CanvasTexture(canvas);
  map.colorSpace = THREE.SRGBColorSpace;
  const sprite = new THREE.Sprite(new THREE.SpriteMaterial({ map, depthWrite: false }));
  sprite.scale.set(0.16 * reach, 0.048 * reach, 1);
  sprite.position.fromArray(place);
  return sprite;
}

// -- surfaces: boxes with bevelled edges, cylinders, balls, threads, as corners and normals -----------------------

const CHAMFER = 0.0012;

/**
 * One geometry of all shapes of a link and of its loaded surfaces, with a colour for each corner.
 * @param {Shape[]} shapes
 * @param {(shape: Shape) => string | number[]} colourOf
 * @param {Surface[]} loaded
 */
function mesh(shapes, colourOf, loaded = []) {
  /** @type {Record<keyof Surface, number[]>} */
  const { position: places, normal: normals, color: colours } = { position: [], normal: [], color: [] };
  const tint = new THREE.Color();
  for (const shape of shapes) {
    const [points, sides] = shape.kind === "box" ? bevelled(shape.size) : turned(shape);
    const turn = new THREE.Quaternion().fromArray(shape.turn), at = new THREE.Vector3().fromArray(shape.place);
    const v = new THREE.Vector3();
    tint.set(colourOf(shape));
    for (let i = 0; i < points.length; i += 3) {
      v.fromArray(points, i).applyQuaternion(turn).add(at).toArray(places, places.length);
      v.fromArray(sides, i).applyQuaternion(turn).toArray(normals, normals.length);
      tint.toArray(colours, colours.length);
    }
  }
  if (!loaded.length) return buffered({ position: places, normal: normals, color: colours });
  const form = new THREE.BufferGeometry();
  const lists = { position: places, normal: normals, color: colours };
  for (const name of /** @type {const} */ (["position", "normal", "color"])) {
    const parts = [Float32Array.from(lists[name]), ...loaded.map((surface) => surface[name])];
    const all = new Float32Array(parts.reduce((sum, part) => sum + part.length, 0));
    let at = 0;
    for (const part of parts) {
      all.set(part, at);
      at += part.length;
    }
    form.setAttribute(name, new THREE.BufferAttribute(all, 3));
  }
  return form;
}

/**
 * A geometry of flat lists with three numbers for each corner.
 * @param {Record<string, number[]>} lists
 */
function buffered(lists) {
  const form = new THREE.BufferGeometry();
  for (const [name, list] of Object.entries(lists)) {
    form.setAttribute(name, new THREE.Float32BufferAttribute(list, 3));
  }
  return form;
}

/**
 * A thin square rod along a line through points, in a flat list, metres: a line of one pixel is hard to see.
 * @param {ArrayLike<number>} points
 * @param {number} radius
 */
function thread(points, radius) {
  /** @type {number[]} */
  const places = [];
  const from = new THREE.Vector3(), to = new THREE.Vector3(), way = new THREE.Vector3();
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
  return buffered({ position: places });
}

/**
 * A box whose edges are cut off a little, so that they catch the light.
 * @param {number[]} size
 * @returns {[number[], number[]]}
 */
function bevelled(size) {
  const cut = Math.min(CHAMFER, 0.2 * Math.min(...size)), half = size.map((length) => length / 2);
  /** @type {[number[], number[]]} */
  const [points, sides] = [[], []];
  /** @type {(signs: number[], axis: number) => number[]} */
  const corner = (signs, axis) => signs.map((sign, i) => sign * (i === axis ? half[i] : half[i] - cut));
  const face = (/** @type {number[][]} */ corners) => {
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
  /** @type {(axis: number, sign: number, others: number[][]) => number[]} */
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

/**
 * A cylinder along z with its edges cut off a little, or a ball.
 * @param {Shape} shape
 * @returns {[number[], number[]]}
 */
function turned({ kind, size }) {
  const [radius, length] = size, steps = radius > 0.02 ? 40 : 24;
  /** @type {number[][]} */
  const profile = [];
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
  /** @type {[number[], number[]]} */
  const [points, sides] = [[], []];
  for (let p = 0; p + 1 < profile.length; p++) {
    const [r0, z0] = profile[p], [r1, z1] = profile[p + 1], long = Math.hypot(r1 - r0, z1 - z0);
    const out = (z1 - z0) / long, up = (r0 - r1) / long;
    for (let i = 0; i < steps; i++) {
      const a = (2 * Math.PI * i) / steps, b = (2 * Math.PI * (i + 1)) / steps;
      /** @type {(r: number, z: number, angle: number) => unknown} */
      const at = (r, z, angle) => points.push(r * Math.cos(angle), r * Math.sin(angle), z);
      const side = (/** @type {number} */ angle) => sides.push(out * Math.cos(angle), out * Math.sin(angle), up);
      at(r0, z0, a), at(r0, z0, b), at(r1, z1, b), at(r0, z0, a), at(r1, z1, b), at(r1, z1, a);
      side(a), side(b), side(b), side(a), side(b), side(a);
    }
  }
  return [points, sides];
}
