// Small pieces that pages share: elements, texts, style sheets, groups of switches. Must not know what they mean.

/**
 * An element with properties, such as className, and children.
 * @template {keyof HTMLElementTagNameMap} T
 * @param {T} tag
 * @param {Partial<HTMLElementTagNameMap[T]> & { [name: `data-${string}`]: string }} properties
 * @param {...(Node | string)} children
 */
export function make(tag, properties = {}, ...children) {
  const made = document.createElement(tag);
  for (const [key, value] of Object.entries(properties)) {
    if (key === "role" || key.startsWith("data-")) made.setAttribute(key, String(value));
    else Object.assign(made, { [key]: value });
  }
  made.append(...children);
  return made;
}

/**
 * An element with attributes, such as class; functions are listeners, of names that begin with "on".
 * @template {keyof HTMLElementTagNameMap} T
 * @param {T} name
 * @param {Record<string, string | number | boolean | ((event: Event) => unknown)>} attributes
 * @param {...(Node | string)} children
 */
export function node(name, attributes = {}, ...children) {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) {
    if (typeof value === "function") made.addEventListener(key.slice(2), value);
    else if (value !== false) made.setAttribute(key, value === true ? "" : String(value));
  }
  made.append(...children);
  return made;
}

class Markup {
  /** @param {string} text */
  constructor(text) { this.text = text; }
}

/**
 * @param {unknown} value
 * @returns {string}
 */
const escaped = (value) => {
  if (value instanceof Markup) return value.text;
  if (Array.isArray(value)) return value.map(escaped).join("");
  return value === null || value === undefined || value === false ? "" : String(value).replace(/[&<>"']/g, (c) => `&#${c.charCodeAt(0)};`);
};

/**
 * Markup: html`<b title="${name}">${words}</b>`. What is put into it is text, unless it is markup or a list of it.
 * @param {TemplateStringsArray} parts
 * @param {...unknown} values
 */
export const html = (parts, ...values) => new Markup(String.raw({ raw: parts }, ...values.map(escaped)));

/**
 * Show markup in an element.
 * @template {Element} E
 * @param {E} element
 * @param {Markup} markup
 */
export function fill(element, markup) {
  element.innerHTML = markup.text;
  return element;
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
 * Set a text; an unchanged one costs the browser nothing.
 * @param {Element} element
 * @param {string} text
 */
export function put(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

/**
 * The element with a selector that an event came from, or in which that is.
 * @param {Event} event
 * @param {string} selector
 * @returns {HTMLElement | null}
 */
export const within = ({ target }, selector) => (target instanceof Element ? target.closest(selector) : null);

/**
 * Why something failed, in words.
 * @param {unknown} error
 */
export const whyOf = (error) => (error instanceof Error ? error.message : String(error));

/**
 * Load a style sheet once.
 * @param {string} address
 * @returns {Promise<unknown>} when it is there: without it the page would jump under a pointer
 */
export function loadSheet(address) {
  if (document.querySelector(`link[href="${address}"]`)) return Promise.resolve();
  return new Promise((resolve) => {
    document.head.append(make("link", { rel: "stylesheet", href: address, onload: resolve, onerror: resolve }));
  });
}

/**
 * Tabs; arrow keys go from one to the next. `choose` gets the key of the one that is shown.
 * @template {string} K
 * @param {string} label
 * @param {Record<K, string>} names
 * @param {(key: K) => void} choose
 * @returns {{ row: HTMLElement, show: (key: K) => void }} their row, and what shows one
 */
export function tabs(label, names, choose) {
  const keys = /** @type {K[]} */ (Object.keys(names));
  const all = keys.map((key) => node("button", { type: "button", role: "tab", class: "hw-tab", "data-part": key, onclick: () => show(key) }, names[key]));
  const row = node("div", { class: "hw-tabs", role: "tablist", "aria-label": label }, ...all);
  const show = (/** @type {K} */ shown) => {
    all.forEach((tab, i) => {
      const on = keys[i] === shown;
      tab.setAttribute("aria-selected", String(on));
      tab.tabIndex = on ? 0 : -1;
    });
    choose(shown);
  };
  row.addEventListener("keydown", ({ key, target }) => {
    const step = key === "ArrowRight" ? 1 : key === "ArrowLeft" ? -1 : 0;
    if (!step) return;
    const next = (all.findIndex((tab) => tab === target) + step + all.length) % all.length;
    all[next].focus();
    show(keys[next]);
  });
  return { row, show };
}

/**
 * A group of switches; `changed` gets the keys that are on, in order.
 * @param {string} label
 * @param {{ key: string, text: string, unit?: string, colour?: string }[]} items
 * @param {string[]} on
 * @param {(keys: string[]) => void} changed
 * @param {{ all?: boolean }} options
 */
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
