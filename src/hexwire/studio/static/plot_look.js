// What all plots share: colours of the theme, texts of numbers and times, and uPlot itself.
//
// Owns look and wording. Must not know data.

const here = (/** @type {string} */ name) => new URL(name, import.meta.url).href;

/**
 * Load a style sheet; resolves when its rules apply, since colours are read from them.
 * @param {string} name
 */
function sheet(name) {
  const href = here(name);
  const there = document.querySelector(`link[href="${href}"]`);
  const link = there instanceof HTMLLinkElement ? there : document.createElement("link");
  if (link.sheet) return Promise.resolve();
  const loaded = new Promise((done) => { link.addEventListener("load", done); link.addEventListener("error", done); });
  if (!there) {
    link.rel = "stylesheet";
    link.href = href;
    document.head.append(link);
  }
  return loaded;
}

/**
 * uPlot, a plain script, once for all modules of the page.
 * @returns {Untyped}
 */
function script() {
  if (window.uPlot) return window.uPlot;
  return new Promise((done, failed) => {
    const tag = document.createElement("script");
    tag.src = here("./uPlot.iife.min.js");
    tag.onload = () => done(window.uPlot);
    tag.onerror = () => failed(new Error("uPlot could not be loaded"));
    document.head.append(tag);
  });
}

await Promise.all(["./uPlot.min.css", "./plot.css"].map(sheet));
export const uPlot = await script();

export const FONT = '12px system-ui, -apple-system, "Segoe UI", Roboto, Ubuntu, Cantarell, "Noto Sans", sans-serif';

export const CURSORS = /** @type {const} */ (["a", "b"]);

/**
 * Colours of the theme at an element: text, background, and lines between them.
 * @param {Element} element
 */
export function themeOf(element) {
  const style = getComputedStyle(element);
  let background = "rgb(255, 255, 255)";
  for (let one = /** @type {Element | null} */ (element); one; one = one.parentElement) {
    const found = getComputedStyle(one).backgroundColor;
    if (found && found !== "transparent" && !/, 0\)$/.test(found)) { background = found; break; }
  }
  const text = style.color;
  return {
    text, background,
    muted: mixed(text, background, 0.72),
    grid: mixed(text, background, 0.13),
    line: mixed(text, background, 0.28),
  };
}

/** @param {string} colour */
function parts(colour) {
  const found = colour.match(/[\d.]+/g);
  return found ? found.slice(0, 3).map(Number) : [128, 128, 128];
}

/**
 * @param {string} a
 * @param {string} b
 * @param {number} share
 */
function mixed(a, b, share) {
  const [p, q] = [parts(a), parts(b)];
  return `rgb(${p.map((v, i) => Math.round(share * v + (1 - share) * q[i])).join(", ")})`;
}

/**
 * A colour: CSS text, or the number of a joint (from 0) in the palette.
 * @param {Element} element
 * @param {string | number} colour
 */
export function colourOf(element, colour) {
  if (typeof colour !== "number") return colour.startsWith("--") ? variable(element, colour) : colour;
  return variable(element, `--joint-${(colour % 8) + 1}`);
}

/**
 * @param {Element} element
 * @param {string} name
 */
function variable(element, name) {
  return getComputedStyle(element).getPropertyValue(name).trim() || "gray";
}

/**
 * Calls back when the theme changes: the system's, or the page's by class or attribute.
 * @param {() => void} changed
 */
export function onTheme(changed) {
  const media = matchMedia("(prefers-color-scheme: dark)");
  const later = () => requestAnimationFrame(changed);
  media.addEventListener("change", later);
  const watch = new MutationObserver(later);
  for (const element of [document.documentElement, document.body]) {
    watch.observe(element, { attributes: true, attributeFilter: ["class", "data-theme", "style"] });
  }
  return () => { media.removeEventListener("change", later); watch.disconnect(); };
}

/** @type {Record<string, number>} */
const DIGITS = { "°": 2, "°/s": 1, "%": 1, V: 2, A: 3, "°C": 1, Hz: 1, ms: 2, s: 3, mm: 1, "": 2 };
/** @type {Record<string, number>} */
const LEAST = { "°": 1, "°/s": 2, "%": 4, V: 0.4, A: 0.05, "°C": 2, Hz: 2, ms: 0.2, mm: 1 };

/**
 * Decimals with which values of a unit are written.
 * @param {{ digits?: number, unit: string }} series
 */
export const digitsOf = (series) => series.digits ?? DIGITS[series.unit] ?? 3;

/**
 * A value in words; a dash if it is unknown.
 * @param {number} value
 * @param {number} digits
 */
export function valueText(value, digits) {
  if (!Number.isFinite(value)) return "–";
  const text = value.toFixed(digits);
  return (/^-0\.?0*$/.test(text) ? text.slice(1) : text).replace("-", "−");
}

/**
 * The range of an axis: values with some room, and never so narrow that noise fills the plot.
 * @param {number} low
 * @param {number} high
 * @param {string} unit
 */
export function rangeOf(low, high, unit) {
  if (!(low <= high)) return [0, LEAST[unit] ?? 1];
  const least = LEAST[unit] ?? Math.max(1e-6, 0.01 * Math.max(Math.abs(low), Math.abs(high)));
  const span = Math.max(high - low, least);
  const middle = (low + high) / 2;
  return [middle - 0.56 * span, middle + 0.56 * span];
}

/**
 * A time in words: seconds, or minutes and seconds (by default from 100 s on).
 * @param {number} seconds
 */
export function timeText(seconds, step = 0.01, long = Math.abs(seconds) >= 100) {
  const digits = step >= 1 ? 0 : step >= 0.1 ? 1 : step >= 0.01 ? 2 : 3;
  const size = Number(Math.abs(seconds).toFixed(digits));
  const sign = seconds < 0 && size > 0 ? "−" : "";
  if (!long) return sign + size.toFixed(digits);
  const minutes = Math.floor(size / 60);
  return `${sign}${minutes}:${(size - 60 * minutes).toFixed(digits).padStart(digits ? 3 + digits : 2, "0")}`;
}
