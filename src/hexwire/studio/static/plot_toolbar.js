// The row of buttons above a plot. Owns them; what they do is the plot's.

import { CURSORS } from "./plot_look.js";

/** @type {[number, string][]} */
const WINDOWS = [[5, "5 s"], [10, "10 s"], [30, "30 s"], [60, "1 min"], [180, "3 min"], [600, "10 min"]];

/** @param {import("./plot.js").Plot} plot */
export function makeToolbar(plot) {
  const element = document.createElement("div");
  element.className = "hx-plot-bar";
  element.setAttribute("role", "toolbar");
  element.setAttribute("aria-label", `${plot.options.title || "Plot"}: view`);
  const live = plot.options.live;

  /** @type {(text: string, label: string, act: () => unknown) => HTMLButtonElement} */
  const button = (text, label, act) => {
    const made = document.createElement("button");
    made.type = "button";
    made.textContent = text;
    made.title = label;
    made.setAttribute("aria-label", label);
    made.addEventListener("click", act);
    element.append(made);
    return made;
  };
  const title = document.createElement("span");
  title.className = "hx-plot-title";
  title.textContent = plot.options.title;
  element.append(title);
  const pause = live ? button("Pause", "Pause", () => (plot.paused ? plot.resume() : plot.pause())) : null;
  const windows = live ? document.createElement("select") : null;
  if (windows) {
    windows.setAttribute("aria-label", "Time shown");
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
    const link = document.createElement("a");
    link.href = URL.createObjectURL(await plot.png());
    link.download = `${plot.options.fileName || plot.options.title || "plot"}.png`;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 10000);
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
