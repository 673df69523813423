// What the cameras of a recording saw at the time under the pointer, at the cursor, or of the motion that is played. Owns which
// picture is shown; of the times that are asked for while one is on its way, only the last counts.

import { withQuery } from "./columns.js";
import { node } from "./widgets.js";

/** @param {HTMLElement} place */
export function makePictures(place) {
  /** @type {ReturnType<typeof tile>[]} */
  let tiles = [];
  let begin = 0;

  return { choose, begins, at };

  /**
   * Show the cameras of a recording; none of one that has none, or is gone.
   * @param {Recording | undefined} entry
   */
  function choose(entry) {
    tiles = entry ? entry.cameras.map((topic) => tile(entry.name, topic)) : [];
    place.replaceChildren(...tiles.map((one) => one.element));
    place.hidden = !tiles.length;
  }

  /**
   * When the recording that is shown begins, seconds since 1970.
   * @param {number} seconds
   */
  function begins(seconds) {
    begin = seconds;
    at(0);
  }

  /**
   * Show a time, seconds from there; its beginning for null.
   * @param {number | null} t
   */
  function at(t) {
    for (const one of tiles) one.show(begin + (t ?? 0));
  }

  /**
   * @param {string} name
   * @param {string} topic
   */
  function tile(name, topic) {
    const camera = topic.replace(/^\/camera\//, "");
    const image = node("img", { alt: `Camera ${camera}`, hidden: true });
    const said = node("figcaption", {}, camera);
    /** @type {number | null} */
    let wanted = null;
    let coming = false;
    const next = () => {
      coming = wanted !== null;
      if (coming) image.src = withQuery("/data/picture", { name, topic, at: wanted });
      wanted = null;
    };
    image.addEventListener("load", () => { image.hidden = false; said.textContent = camera; next(); });
    image.addEventListener("error", () => { image.hidden = true; said.textContent = `${camera}: no picture at this time`; next(); });
    const show = (/** @type {number} */ time) => {
      wanted = time;
      if (!coming) next();
    };
    return { element: node("figure", {}, image, said), show };
  }
}
