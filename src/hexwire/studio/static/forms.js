// Pieces that pages share for what a person chooses, is asked and saves: groups of switches, questions, files. Apart from
// widgets.js, since the first picture needs none of them. Must not know what they mean.

import { node } from "./widgets.js";

/**
 * A group of switches; `changed` gets the keys that are on, in order.
 * @param {string} label
 * @param {{ key: string, text: string, unit?: string, colour?: string }[]} items
 * @param {string[]} on
 * @param {(keys: string[]) => void} changed
 * @param {{ all?: boolean }} options
 */
export function chips(label, items, on, changed, options = {}) {
  const group = node("fieldset", { class: "pl-chips" }, node("legend", {}, label));
  const boxes = items.map(({ key, text, unit, colour }) => {
    const box = node("input", { type: "checkbox", checked: on.includes(key), value: key });
    const chip = node("label", { class: "pl-chip" }, box, node("span", {}, text));
    if (unit) chip.append(node("small", {}, unit));
    if (colour) chip.style.setProperty("--chip", `var(${colour})`);
    box.addEventListener("change", tell);
    group.append(chip);
    return box;
  });
  if (options.all) {
    const words = `All ${label.toLowerCase()}`;
    const all = node("button", { type: "button", class: "pl-all", title: words, "aria-label": words }, "all");
    all.addEventListener("click", () => {
      const every = boxes.every((box) => box.checked);
      boxes.forEach((box, i) => { box.checked = !every || i === 0; });
      tell();
    });
    group.append(all);
  }
  function tell() { changed(boxes.filter((box) => box.checked).map((box) => box.value)); }
  return group;
}

/**
 * Ask before a change. Escape stops the arm and closes the question.
 * @param {string} title
 * @param {string} text
 * @param {string} yes
 * @returns {Promise<boolean>} whether the person agrees
 */
export function question(title, text, yes, level = "danger") {
  const lines = text.split("\n").filter(Boolean).map((line) => node("p", {}, line));
  return dialog(title, lines, yes, level, () => true).then(Boolean);
}

/**
 * A dialog with two buttons.
 * @template T
 * @param {string} title
 * @param {(Node | string)[]} parts
 * @param {string} yes
 * @param {string} level
 * @param {() => T} value
 * @returns {Promise<T | null>} what `value` gives when the person agrees
 */
export function dialog(title, parts, yes, level, value) {
  return new Promise((resolve) => {
    const box = node("dialog", { class: "hw-dialog", "aria-label": title });
    const form = node("form", { method: "dialog" }, node("h2", {}, title), ...parts,
      node("div", { class: "hw-row" },
        node("button", { class: `hw-button hw-${level}`, value: "yes" }, yes),
        node("button", { class: "hw-button", type: "button", onclick: () => box.close() }, "Cancel")));
    box.append(form);
    box.addEventListener("close", () => {
      box.remove();
      resolve(box.returnValue === "yes" ? value() : null);
    });
    document.body.append(box);
    // Not modal: STOP is in the header, and must be pressed beside it.
    box.show();
    const first = box.querySelector("[autofocus]") || box.querySelector("button");
    if (first instanceof HTMLElement) first.focus();
    box.addEventListener("keydown", (event) => event.key === "Escape" && box.close());
  });
}

/**
 * Offer a file to save.
 * @param {string} name
 * @param {string} text
 */
export function download(name, text) {
  const url = URL.createObjectURL(new Blob([text], { type: "application/octet-stream" }));
  node("a", { href: url, download: name }).click();
  setTimeout(() => URL.revokeObjectURL(url), 10_000);
}
