/* Cameras of the browser's computer beside the 3D view of the page Move: a tile each, with its choice of camera.

Owns what a tile shows, and that a camera is switched off when its tile is closed or its page is gone. The picture stays in the
browser. Loaded when the button is first pressed. */

import { node } from "./widgets.js";

const MOST = 4; // tiles
const SIZE = { width: { ideal: 640 }, height: { ideal: 480 }, frameRate: { ideal: 15, max: 30 } };
const WHY = {
  NotAllowedError: "the browser, or the system, does not allow this page to use a camera",
  NotFoundError: "no camera is connected to this computer",
  NotReadableError: "another program uses this camera",
  OverconstrainedError: "this camera is gone",
};

export function mountCameras(page, button) {
  const tiles = page.find("#arm-cameras");
  const add = async () => {
    button.disabled = true;
    if (!navigator.mediaDevices) {
      page.tell("why", "browsers show cameras only to pages with TLS, or on the computer of the studio: see 'hexwire studio --cert'");
    } else if (tiles.children.length >= MOST) {
      page.tell("why", `there are ${MOST} cameras already: close one`);
    } else {
      await tile(page, tiles).catch((error) => page.tell("why", WHY[error.name] ?? `no camera: ${error.message}`));
    }
    button.disabled = false;
  };
  button.addEventListener("click", add);
  add();
}

async function tile(page, tiles) {
  let stream = await open(unused(tiles));
  const video = node("video", { muted: true, playsinline: true, "aria-label": "Camera" });
  const choice = node("select", { "aria-label": "Camera" });
  const close = node("button", { class: "hw-button", type: "button", "aria-label": "Close this camera" }, "×");
  const box = node("figure", { class: "arm-camera-tile" }, video, node("figcaption", {}, choice, close));
  const devices = async () => {
    const found = (await navigator.mediaDevices.enumerateDevices()).filter(({ kind }) => kind === "videoinput");
    const now = stream.getVideoTracks()[0].getSettings().deviceId;
    box.dataset.device = now ?? "";
    choice.replaceChildren(...found.map(({ deviceId, label }, i) => node("option", { value: deviceId, selected: deviceId === now }, label || `camera ${i + 1}`)));
  };
  const show = async () => {
    video.srcObject = stream;
    // Unplugged, or taken back by the person.
    stream.getVideoTracks()[0].addEventListener("ended", end);
    await devices();
    await video.play();
  };
  const off = () => stream.getTracks().forEach((track) => track.stop());
  const end = () => {
    clearInterval(watch);
    off();
    box.remove();
  };
  const watch = setInterval(() => box.isConnected || end(), 1000);
  close.addEventListener("click", end);
  choice.addEventListener("change", async () => {
    off();
    try {
      stream = await open(choice.value);
      await show();
    } catch (error) {
      end();
      page.tell("why", WHY[error.name] ?? `no camera: ${error.message}`);
    }
  });
  if (!tiles.isConnected) {
    end();
    return;
  }
  tiles.append(box);
  await show();
}

/** A camera that no tile shows yet; any if this computer has not said which there are. */
let known = [];
function unused(tiles) {
  const shown = [...tiles.children].map(({ dataset }) => dataset.device);
  return known.find((id) => id && !shown.includes(id)) ?? "";
}

async function open(device) {
  const made = await navigator.mediaDevices.getUserMedia({ audio: false, video: device ? { ...SIZE, deviceId: { exact: device } } : SIZE });
  known = (await navigator.mediaDevices.enumerateDevices()).filter(({ kind }) => kind === "videoinput").map(({ deviceId }) => deviceId);
  return made;
}
