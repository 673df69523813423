// What the cameras of a recording saw at the time under the pointer, at the cursor, or of the motion that is played. Owns which
// picture is shown; of the times that are asked for while one is on its way, only the last counts.

import { withQuery } from "./columns.js";
import { make } from "./widgets.js";

export function makePictures(place) {
  let tiles = [], begin = 0;

  return { choose, begins, at };

  /** Show the cameras of a recording; none of one that has none, or of null. */
  function choose(entry) {
    tiles = (entry?.cameras ?? []).map((topic) => tile(entry.name, topic));
    place.replaceChildren(...tiles.map((one) => one.element));
    place.hidden = !tiles.length;
  }

  /** When the recording that is shown begins, seconds since 1970. */
  function begins(seconds) {
    begin = seconds;
    at(0);
  }

  /** Show a time, seconds from there. */
  function at(t) {
    for (const one of tiles) one.show(begin + (t ?? 0));
  }

  function tile(name, topic) {
    const camera = topic.replace(/^\/camera\//, "");
    const image = make("img", { alt: `Camera ${camera}`, hidden: true });
    const said = make("figcaption", { textContent: camera });
    let wanted = null, coming = false;
    const next = () => {
      coming = wanted !== null;
      if (coming) image.src = withQuery("/data/picture", { name, topic, at: wanted });
      wanted = null;
    };
    image.addEventListener("load", () => { image.hidden = false; said.textContent = camera; next(); });
    image.addEventListener("error", () => { image.hidden = true; said.textContent = `${camera}: no picture at this time`; next(); });
    const show = (time) => {
      wanted = time;
      if (!coming) next();
    };
    return { element: make("figure", {}, image, said), show };
  }
}
