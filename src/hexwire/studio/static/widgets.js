// Small pieces that pages share: elements, texts, style sheets, tabs. Must not know what they mean.

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
    document.head.append(node("link", { rel: "stylesheet", href: address, onload: resolve, onerror: resolve }));
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
