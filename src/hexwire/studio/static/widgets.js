// Small pieces that pages share: elements, texts, style sheets, groups of switches. Must not know what they mean.

/** An element with properties, such as className, and children. */
export function make(tag, properties = {}, ...children) {
  const made = document.createElement(tag);
  for (const [key, value] of Object.entries(properties)) {
    if (key === "role" || key.startsWith("data-")) made.setAttribute(key, value);
    else made[key] = value;
  }
  made.append(...children);
  return made;
}

/** An element with attributes, such as class; those that begin with "on" are listeners. */
export function node(name, attributes = {}, ...children) {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) {
    if (key.startsWith("on")) made.addEventListener(key.slice(2), value);
    else if (value !== false) made.setAttribute(key, value === true ? "" : value);
  }
  made.append(...children);
  return made;
}

class Markup {
  constructor(text) { this.text = text; }
}

const escaped = (value) => {
  if (value instanceof Markup) return value.text;
  if (Array.isArray(value)) return value.map(escaped).join("");
  return value === null || value === undefined || value === false ? "" : String(value).replace(/[&<>"']/g, (c) => `&#${c.charCodeAt(0)};`);
};

/** Markup: html`<b title="${name}">${words}</b>`. What is put into it is text, unless it is markup or a list of it. */
export const html = (parts, ...values) => new Markup(String.raw({ raw: parts }, ...values.map(escaped)));

/** Show markup in an element. */
export function fill(element, markup) {
  element.innerHTML = markup.text;
  return element;
}

/** Offer a file to save. */
export function download(name, text) {
  const url = URL.createObjectURL(new Blob([text], { type: "application/octet-stream" }));
  node("a", { href: url, download: name }).click();
  setTimeout(() => URL.revokeObjectURL(url), 10_000);
}

/** Ask before a change. Escape stops the arm and closes the question. @returns {Promise<boolean>} whether the person agrees */
export function question(title, text, yes, level = "danger") {
  const lines = text.split("\n").filter(Boolean).map((line) => node("p", {}, line));
  return dialog(title, lines, yes, level, () => true).then(Boolean);
}

/** A dialog with two buttons. @returns {Promise} what `value` gives when the person agrees; null otherwise */
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
    (box.querySelector("[autofocus]") || box.querySelector("button")).focus();
    box.addEventListener("keydown", (event) => event.key === "Escape" && box.close());
  });
}

/** Set a text; an unchanged one costs the browser nothing. */
export function put(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

/** Load a style sheet once. @returns {Promise} when it is there: without it the page would jump under a pointer */
export function loadSheet(address) {
  if (document.querySelector(`link[href="${address}"]`)) return Promise.resolve();
  return new Promise((resolve) => {
    document.head.append(make("link", { rel: "stylesheet", href: address, onload: resolve, onerror: resolve }));
  });
}

/** Tabs; arrow keys go from one to the next. `choose` gets the key of the one that is shown. @returns their row, and what shows one */
export function tabs(label, names, choose) {
  const row = node("div", { class: "hw-tabs", role: "tablist", "aria-label": label },
    ...Object.entries(names).map(([key, words]) => node("button", { type: "button", role: "tab", class: "hw-tab", "data-part": key, onclick: () => show(key) }, words)));
  const all = /** @type {HTMLElement[]} */ ([...row.children]);
  const show = (key) => {
    for (const tab of all) {
      const on = tab.dataset.part === key;
      tab.setAttribute("aria-selected", String(on));
      tab.tabIndex = on ? 0 : -1;
    }
    choose(key);
  };
  row.addEventListener("keydown", (event) => {
    const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
    if (!step) return;
    const next = all[(all.indexOf(/** @type {HTMLElement} */ (event.target)) + step + all.length) % all.length];
    next.focus();
    show(next.dataset.part);
  });
  return { row, show };
}

/** A group of switches; `changed` gets the keys that are on, in order. */
export function chips(label, items, on, changed, options = {}) {
  const group = make("fieldset", { className: "pl-chips" }, make("legend", { textContent: label }));
  const boxes = items.map(({ key, text, unit, colour }) => {
    const box = make("input", { type: "checkbox", checked: on.includes(key), value: key });
    const chip = make("label", { className: "pl-chip" }, box, make("span", { textContent: text }));
    if (unit) chip.append(make("small", { textContent: unit }));
    if (colour) chip.style.setProperty("--chip", `var(${colour})`);
    box.addEventListener("change", tell);
    group.append(chip);
    return box;
  });
  if (options.all) {
    const all = make("button", { type: "button", className: "pl-all", textContent: "all", title: `All ${label.toLowerCase()}` });
    all.setAttribute("aria-label", `All ${label.toLowerCase()}`);
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
