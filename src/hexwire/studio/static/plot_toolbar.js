// The row of buttons above a plot. Owns them; what they do is the plot's.

import { CURSORS } from "./plot_look.js";
import { node } from "./widgets.js";

/** @type {[number, string][]} */
const WINDOWS = [[5, "5 s"], [10, "10 s"], [30, "30 s"], [60, "1 min"], [180, "3 min"], [600, "10 min"]];

/** @param {import("./plot.js").Plot} plot */
export function makeToolbar(plot) {
  const element = node("div", { class: "hx-plot-bar", role: "toolbar", "aria-label": `${plot.options.title || "Plot"}: view` });
  const live = plot.options.live;

  /** @type {(text: string, label: string, act: () => unknown) => HTMLButtonElement} */
  const button = (text, label, act) => {
    const made = node("button", { type: "button", class: "hw-button", title: label, "aria-label": label, onclick: act }, text);
    element.append(made);
    return made;
  };
  element.append(node("span", { class: "hx-plot-title" }, plot.options.title));
  const pause = live ? button("Pause", "Pause", () => (plot.paused ? plot.resume() : plot.pause())) : null;
  const windows = live ? node("select", { "aria-label": "Time shown" }) : null;
  if (windows) {
    for (const [seconds, text] of WINDOWS) windows.append(new Option(text, String(seconds)));
    windows.append(new Option("other", "other"));
    windows.addEventListener("change", () => windows.value !== "other" && plot.setWindow(Number(windows.value)));
    element.append(windows);
  }
  button("+", "Zoom in", () => plot.scale(0.7));
  button("−", "Zoom out", () => plot.scale(1 / 0.7));
  button("All", "Show everything", () => plot.showAll());
  const cursors = new Map(CURSORS.map((name) => [name, button(name.toUpperCase(), `Cursor ${name.toUpperCase()}`, () => {
    const [from, to] = plot.range;
    plot.cursor(name, plot.cursors[name] === null ? from + (name === "a" ? 0.35 : 0.65) * (to - from) : null);
  })]));
  button("PNG", "Save as PNG", async () => {
    const href = URL.createObjectURL(await plot.png());
    node("a", { href, download: `${plot.options.fileName || plot.options.title || "plot"}.png` }).click();
    setTimeout(() => URL.revokeObjectURL(href), 10000);
  });

  const update = () => {
    if (pause) {
      pause.textContent = plot.paused ? "Follow" : "Pause";
      pause.title = plot.paused ? "Follow the newest values" : "Pause";
      pause.setAttribute("aria-label", pause.title);
      pause.classList.toggle("on", plot.paused);
    }
    if (windows) {
      const known = WINDOWS.some(([seconds]) => seconds === plot.window);
      windows.value = known ? String(plot.window) : "other";
      windows.options[windows.length - 1].hidden = known;
    }
    for (const [name, made] of cursors) made.setAttribute("aria-pressed", String(plot.cursors[name] !== null));
  };
  update();
  return { element, update };
}
