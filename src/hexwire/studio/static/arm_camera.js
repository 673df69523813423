/* Cameras beside the 3D view of the page Move, a tile each with its choice of camera: those of the browser's computer, whose
picture stays in the browser unless the person shares it, and those of the studio, each over a socket of its own (camera_views.py).

Owns what a tile shows, and that a camera is switched off when its tile is closed or nobody sees its page. Loaded when the button
is first pressed. */

import hexwire, { all } from "./live.js";
import { loadSheet, node, whyOf } from "./widgets.js";

const MOST = 4; // tiles
const SIZE = { width: { ideal: 640 }, height: { ideal: 480 }, frameRate: { ideal: 15, max: 30 } };
const PERIOD = 1000 / 15; // ms between two pictures that are sent to the studio
const MOST_WAITING = 200_000; // bytes that wait for the line; a picture more waits for the next turn
const AGAIN = 2000; // ms until a lost connection to a camera is made again
/** @type {Record<string, string>} */
const WHY = {
  NotAllowedError: "the browser, or the system, does not allow this page to use a camera",
  NotFoundError: "no camera is connected to this computer",
  NotReadableError: "another program uses this camera",
  OverconstrainedError: "this camera is gone",
};
const NO_TLS = "browsers show cameras only to pages with TLS, or on the computer of the studio: see 'hexwire studio --cert', or '--camera' for one of the studio's computer";
const STUDIO = "studio:"; // before the name of a camera of the studio's computer

/**
 * What a tile shows, of the browser or of the studio; only the first can be shared.
 * @typedef {{ element: HTMLElement, device: string, close: () => void, share?: (is: boolean, refused: (why: string) => void) => void }} Camera
 */

/** @param {unknown} error */
const wordsOf = (error) => (error instanceof Error && WHY[error.name]) || `no camera: ${whyOf(error)}`;

/**
 * @param {ArmPage} page
 * @param {HTMLButtonElement} button
 */
export function mountCameras(page, button) {
  const tiles = page.get("#arm-cameras");
  const add = async () => {
    button.disabled = true;
    await loadSheet("/static/arm_ways.css");
    try {
      const there = (await hexwire.call("cameras")).map(({ name }) => STUDIO + name);
      if (tiles.children.length >= MOST) hexwire.say(`there are ${MOST} cameras already: close one`);
      else if (tiles.isConnected) await tile(page, tiles, there);
    } catch (error) {
      hexwire.say(wordsOf(error));
    }
    button.disabled = false;
  };
  button.addEventListener("click", add);
  add();
}

/**
 * @param {ArmPage} page
 * @param {HTMLElement} tiles
 * @param {string[]} there cameras of the studio
 */
async function tile(page, tiles, there) {
  const choice = node("select", { "aria-label": "Camera" });
  const close = node("button", { class: "hw-button", type: "button", "aria-label": "Close this camera" }, "×");
  const said = node("span", { class: "arm-camera-said", role: "status" });
  const shared = node("input", { type: "checkbox" });
  const share = node("label", { title: "Other pages of this studio see it while they look, and a recording with cameras has it" }, shared, " share");
  const box = node("figure", { class: "arm-camera-tile" }, node("figcaption", {}, choice, share, said, close));
  /** @type {Camera | null} */
  let camera = null;
  let turn = 0, watch = 0;
  const end = () => {
    turn += 1;
    clearInterval(watch);
    camera?.close();
    box.remove();
  };
  const show = async (/** @type {string} */ wanted) => {
    const mine = (turn += 1);
    camera?.close();
    camera = null;
    said.textContent = "";
    share.hidden = true;
    shared.checked = false;
    /** @type {Camera | null} */
    let made = null;
    try {
      made = wanted.startsWith(STUDIO) ? ofStudio(wanted, (text) => (said.textContent = text)) : await ofBrowser(wanted, end);
    } catch (error) {
      if (mine === turn) throw error;
    }
    if (mine !== turn || !made) {
      // Another one was chosen, or the tile closed, while the browser opened this one.
      made?.close();
      return;
    }
    const { element, device: here } = (camera = made);
    share.hidden = wanted.startsWith(STUDIO) || !hexwire.operates;
    box.dataset.device = here;
    box.querySelector(":scope > :not(figcaption)")?.remove();
    box.prepend(element);
    choice.replaceChildren(
      ...there.map((device) => option(device, device.slice(STUDIO.length), here)),
      ...(await devices()).map(({ deviceId, label }, i) => option(deviceId, label || `camera ${i + 1}`, here)),
    );
  };
  close.addEventListener("click", end);
  shared.addEventListener("change", () => {
    said.textContent = "";
    camera?.share?.(shared.checked, (why) => {
      shared.checked = false;
      said.textContent = why;
    });
  });
  choice.addEventListener("change", () => show(choice.value).catch((error) => {
    end();
    hexwire.say(wordsOf(error));
  }));
  // One that no tile shows yet; any if this computer has not said which there are.
  const shown = all(tiles, ":scope > *").map(({ dataset }) => dataset.device);
  const free = [...there, ...known].find((device) => device && !shown.includes(device)) ?? "";
  try {
    await show(free);
  } catch (error) {
    end();
    throw error;
  }
  if (!tiles.isConnected) return end();
  tiles.append(box);
  // Not before: the person may take as long as they like to allow a camera, and some take seconds to open.
  watch = setInterval(() => box.isConnected || end(), 1000);
}

/** @type {(value: string, text: string, here: string) => HTMLOptionElement} */
function option(value, text, here) {
  return node("option", { value, selected: value === here }, text);
}

// -- of the browser's computer -------------------------------------------------------------------------------------

/** @type {string[]} */
let known = [];
async function devices() {
  const found = ((await navigator.mediaDevices?.enumerateDevices()) ?? []).filter(({ kind, deviceId }) => kind === "videoinput" && deviceId);
  known = found.map(({ deviceId }) => deviceId);
  return found;
}

/**
 * @param {string} device
 * @param {() => void} ended
 * @returns {Promise<Camera>}
 */
async function ofBrowser(device, ended) {
  if (!navigator.mediaDevices) throw new Error(NO_TLS);
  const video = device ? { ...SIZE, deviceId: { exact: device } } : SIZE;
  const stream = await navigator.mediaDevices.getUserMedia({ audio: false, video });
  const element = node("video", { muted: true, playsinline: true, "aria-label": "Camera" });
  const [track] = stream.getVideoTracks();
  element.srcObject = stream;
  // Unplugged, or taken back by the person.
  track.addEventListener("ended", ended);
  // Its tile may be closed before the first picture.
  element.play().catch(() => {});
  /** @type {{ close: () => void } | null} */
  let sharing = null;
  /** @type {(is: boolean, refused: (why: string) => void) => void} */
  const share = (is, refused) => {
    sharing?.close();
    sharing = is ? sender(element, refused) : null;
  };
  return { element, device: track.getSettings().deviceId ?? "", share, close: () => { sharing?.close(); track.stop(); } };
}

/**
 * Sends pictures of a video to the studio while somebody there looks at them.
 * @param {HTMLVideoElement} video
 * @param {(why: string) => void} refused
 */
function sender(video, refused) {
  const canvas = new OffscreenCanvas(SIZE.width.ideal, SIZE.height.ideal);
  const context = canvas.getContext("2d");
  let timer = 0, over = false, making = false;
  const socket = new WebSocket(address(`?tab=${encodeURIComponent(hexwire.key)}`));
  const send = async () => {
    // A slow line drops pictures.
    if (!context || making || !video.videoWidth || socket.bufferedAmount > MOST_WAITING) return;
    making = true;
    const scale = Math.min(canvas.width / video.videoWidth, canvas.height / video.videoHeight);
    const [width, height] = [scale * video.videoWidth, scale * video.videoHeight];
    context.drawImage(video, (canvas.width - width) / 2, (canvas.height - height) / 2, width, height);
    try {
      const picture = await canvas.convertToBlob({ type: "image/jpeg", quality: 0.8 });
      if (socket.readyState === WebSocket.OPEN) socket.send(picture);
    } finally {
      making = false;
    }
  };
  socket.onmessage = ({ data }) => {
    const told = JSON.parse(data);
    clearInterval(timer);
    if (told.refused) {
      over = true;
      refused(told.refused);
    } else if (told.wanted) timer = setInterval(send, PERIOD);
  };
  socket.onclose = () => {
    clearInterval(timer);
    if (!over) refused("the connection to the studio was lost");
  };
  return { close: () => { over = true; socket.close(); } };
}

/** @param {string} rest */
function address(rest) {
  return `${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/camera${rest}`;
}

// -- of the studio -------------------------------------------------------------------------------------------------

/**
 * @param {string} device
 * @param {(text: string) => void} say
 * @returns {Camera}
 */
function ofStudio(device, say) {
  const name = device.slice(STUDIO.length);
  const element = node("canvas", { width: 640, height: 480, role: "img", "aria-label": `Camera ${name}` });
  const context = element.getContext("2d");
  /** @type {WebSocket | null} */
  let socket = null;
  let timer = 0, refused = false;
  const open = () => {
    clearTimeout(timer);
    if (refused || socket || document.hidden) return;
    const mine = (socket = new WebSocket(address(`/${encodeURIComponent(name)}`)));
    const show = async (/** @type {unknown} */ data) => {
      if (socket !== mine) return;
      if (typeof data === "string") {
        const told = JSON.parse(data);
        refused = "refused" in told;
        say(told.refused ?? told.problem);
        return;
      }
      let problem = "";
      try {
        const image = await createImageBitmap(/** @type {Blob} */ (data));
        if (element.width !== image.width || element.height !== image.height) Object.assign(element, { width: image.width, height: image.height });
        context?.drawImage(image, 0, 0);
        image.close();
      } catch {
        problem = "a picture of this camera is damaged";
      }
      if (socket !== mine) return;
      say(problem);
      // Only so many are sent ahead of what is shown: a slow page drops pictures, and shows none that is old.
      mine.send("shown");
    };
    // In turn: a picture that is ready after the words that came behind it would wipe them out.
    let shown = Promise.resolve();
    mine.onmessage = ({ data }) => {
      shown = shown.then(() => show(data));
    };
    mine.onclose = () => {
      if (socket !== mine) return;
      socket = null;
      timer = setTimeout(open, AGAIN);
    };
  };
  // Nobody looks at a page that is hidden.
  const seen = () => (document.hidden ? off() : open());
  const off = () => {
    clearTimeout(timer);
    const mine = socket;
    socket = null;
    mine?.close();
  };
  document.addEventListener("visibilitychange", seen);
  open();
  return { element, device, close: () => { document.removeEventListener("visibilitychange", seen); off(); refused = true; } };
}
