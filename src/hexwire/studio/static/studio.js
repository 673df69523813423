// The pages: which there are, and going from one to the other without losing the socket, and with it control. Owns the part
// below the header, and the theme. Must not know what a page shows.
//
// A page is a module of this folder with `mount(element, { tab, operates })`. It fills the element, listens with
// `hexwire.onFacts(call, element)` and its like, which end when the element is gone, and asks by `hexwire.call(name, args)`.

import hexwire, { required } from "./live.js";
import { node, within } from "./widgets.js";

/** @type {Record<string, string[]>} */
const PAGES = {
  "/move": ["Move", "arm.js"],
  "/servos": ["Servos", "servos.js"],
  "/signals": ["Signals", "plots.js"],
  "/wire": ["Wire", "wire.js"],
  "/recordings": ["Recordings", "recordings.js"],
  "/first": ["First run", "first.js"],
  "/": ["Arms", "arms.js"],
};
const THEMES = ["auto", "light", "dark"];

const main = required(document, "#hw-main");
let shown = "";
/** @type {Element | null} */
let unloaded = null; // the page that could not be loaded last

async function show() {
  const path = location.pathname;
  if (path === shown) return;
  shown = path;
  const [title, file] = PAGES[path];
  document.title = `${title} – hexwire studio`;
  for (const link of /** @type {NodeListOf<HTMLAnchorElement>} */ (document.querySelectorAll(".hw-nav-link"))) {
    // First run is a part of Arms.
    if (link.pathname === path) link.setAttribute("aria-current", "page");
    else if (path === "/first" && link.pathname === "/") link.setAttribute("aria-current", "true");
    else link.removeAttribute("aria-current");
  }
  document.querySelectorAll("dialog").forEach((each) => each.close());
  const place = node("div", { class: "hw-page" });
  // The header shows which page it is; who does not see it hears it.
  main.replaceChildren(node("h1", { class: "hw-hidden" }, title), place);
  try {
    const page = await import(`./${file}`);
    if (place.isConnected) await page.mount(place, { tab: hexwire.key, operates: hexwire.operates });
  } catch (error) {
    if (hexwire.connected) throw error;
    // Its files are with the studio, too.
    unloaded = place;
    place.replaceChildren(node("p", {}, "No connection to the studio: this page is loaded when the studio is back."));
  }
}
hexwire.onLink((is) => is && unloaded?.isConnected && location.reload());

/**
 * Go to a page.
 * @param {string} path
 */
export function go(path) {
  history.pushState(null, "", path);
  show();
}

document.addEventListener("click", (event) => {
  const link = within(event, "a[href]");
  const plain = event.button === 0 && !event.ctrlKey && !event.metaKey && !event.shiftKey;
  if (!(link instanceof HTMLAnchorElement) || !plain || link.origin !== location.origin || link.hash || link.download || !(link.pathname in PAGES)) return;
  event.preventDefault();
  if (link.pathname !== location.pathname) go(link.pathname);
});
addEventListener("popstate", show);

const sheet = required(document, "#hw-status", HTMLDetailsElement);
document.addEventListener("pointerdown", ({ target }) => sheet.contains(/** @type {Node} */ (target)) || (sheet.open = false));

// -- the theme -------------------------------------------------------------------------------------------------

const button = required(document, "#hw-theme");
const dark = matchMedia("(prefers-color-scheme: dark)");
const kept = localStorage.getItem("hexwire-theme") ?? "";
let theme = THEMES.includes(kept) ? kept : "auto";

function paint() {
  const isDark = theme === "auto" ? dark.matches : theme === "dark";
  document.body.classList.toggle("body--dark", isDark);
  document.documentElement.dataset.theme = isDark ? "dark" : "light";
  button.textContent = `Theme: ${theme}`;
}

button.addEventListener("click", () => {
  theme = THEMES[(THEMES.indexOf(theme) + 1) % THEMES.length];
  localStorage.setItem("hexwire-theme", theme);
  paint();
});
dark.addEventListener("change", paint);
paint();
show();
