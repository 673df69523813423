// The page Arms: the stop of all arms, what is plugged in, what it probably is, and opening it; below, all arms. Owns its
// tables and the form; the server finds the ports, and opens them.

import hexwire, { capital, required } from "./live.js";
import { mountFleet } from "./fleet.js";
import { go } from "./studio.js";
import { fill, html, loadSheet, whyOf, within } from "./widgets.js";

const LOOK = 2000; // ms between two looks at the ports

/**
 * @param {HTMLElement} element
 * @param {Visitor} visitor
 */
export async function mount(element, { operates }) {
  await loadSheet("/static/arms.css");
  if (!element.isConnected) return;
  fill(element, html`<section class="hw-fleet-bar" aria-label="Stop"></section>
    <div class="hw-arms-head"><div class="hw-present"></div>
    <p>A new arm, or one that was never calibrated? <a href="/first">First run</a> takes you from its cable to its first motion,
      one step at a time.</p></div><div id="hw-ports"></div>
    <p class="hw-dim" id="hw-warning"></p>
    <form class="hw-row" autocomplete="off">
      <div class="hw-field hw-choice"><label for="hw-url">Port or address</label>
        <input id="hw-url" name="url" placeholder="zenoh:lab/arm1" maxlength="200"></div>
      <div class="hw-field hw-choice"><label for="hw-robot">Robot</label>
        <select id="hw-robot" name="robot"><option value=""></option></select></div>
      ${operates && html`<button class="hw-button" type="submit" aria-label="Open this address">Open</button>`}
    </form>
    <div id="hw-emulated"></div>
    <section class="hw-fleet" aria-labelledby="hw-shared"><h2 id="hw-shared">All arms, here and shared</h2><div></div></section>`);
  mountFleet(required(element, ".hw-fleet-bar"), required(element, ".hw-fleet > div"), { tab: hexwire.key, operates });
  const present = required(element, ".hw-present"), ports = required(element, "#hw-ports"), form = required(element, "form");
  const url = required(form, "#hw-url", HTMLInputElement), robot = required(form, "#hw-robot", HTMLSelectElement);
  let open = "";
  let seen = "";

  // Only after a change: a button that is made again loses the focus, and a press that has begun on it.
  hexwire.onFacts((facts) => {
    const now = `${facts.mode} ${facts.opened} ${facts.open_error}`;
    if (now === open) return;
    open = now;
    fill(present, presentMarkup(facts, operates));
  }, element);

  /** @param {Ports} found */
  function show(found) {
    const now = JSON.stringify(found.plugged);
    if (now === seen) return;
    seen = now;
    if (!found.plugged) fill(ports, html`<p class="hw-dim">Looking for ports …</p>`);
    else if (!found.plugged.length) fill(ports, html`<p>No serial port on this machine. Plug in the board or the adapter, or try another cable.</p>`);
    else fill(ports, table(found.plugged, found, operates));
  }

  async function look() {
    if (!element.isConnected) return;
    if (!document.hidden && hexwire.connected) await hexwire.call("ports").then(show, (error) => hexwire.connected && hexwire.say(whyOf(error)));
    setTimeout(look, LOOK);
  }

  /**
   * @param {string} url
   * @param {string} robot
   */
  async function openAddress(url, robot) {
    // A port takes its time: whoever is on another page by then stays there.
    if ((await hexwire.act("open", { url, robot })) !== undefined && element.isConnected) go("/move");
  }

  element.addEventListener("click", async (event) => {
    const button = within(event, "button[data-do]");
    if (button?.dataset.do === "close") hexwire.act("close");
    else if (button) openAddress(button.dataset.url ?? "", button.closest("tr")?.querySelector("select")?.value ?? "");
  });
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    if (operates) openAddress(url.value, robot.value);
  });

  // What was there a moment ago is shown at once: a table that comes later would push its neighbours away.
  const begin = () => hexwire.call("ports.known").then((known) => {
    fill(required(element, "#hw-emulated"), emulated(known.emulated, operates));
    robot.append(...known.robots.map((name) => new Option(name)));
    required(element, "#hw-warning").textContent = operates ? `A serial port, or a bridge to one: ${known.warning}.` : "";
    show(known);
    look();
  }, () => setTimeout(begin, LOOK / 10));
  begin();
}

/**
 * @param {Facts} facts
 * @param {boolean} operates
 */
function presentMarkup(facts, operates) {
  const error = facts.open_error && html`<p class="hw-bad">Not opened: ${facts.open_error}</p>`;
  if (facts.mode !== "arm" && facts.mode !== "bus") return html`${error}<p>Nothing is open. Choose a port, or enter an address.</p>`;
  return html`${error}<div class="hw-row"><span>Open: ${facts.mode === "arm" ? facts.url : "the servo bus"}${facts.uncalibrated && html`<span class="hw-bad">, ${facts.uncalibrated}</span>`}</span>
    ${operates && html`<button class="hw-button" type="button" data-do="close" aria-label="Close what is open">Close</button>`}</div>`;
}

const opener = (/** @type {Port} */ { device }) => html`<button class="hw-button" type="button" data-do="open" data-url="${device}"
  aria-label="Open ${device}">Open</button>`;

/**
 * What is plugged in.
 * @param {Port[]} rows
 * @param {Ports} known
 * @param {boolean} operates
 */
function table(rows, { robots, default: usual, warning }, operates) {
  // Said once, below, for what is typed there too.
  const condition = (/** @type {Port} */ { obstacle, advice }) => {
    const resets = operates && !obstacle && advice.startsWith(warning);
    const words = obstacle || `can be opened${resets ? "; keep clear, see below" : ""}`;
    return html`<div class="${obstacle && "hw-bad"}">${words}</div><div class="hw-dim">${resets ? capital(advice.slice(warning.length).replace("; ", "")) : advice}</div>`;
  };
  const choice = (/** @type {Port} */ row) => html`<select aria-label="Robot on ${row.device}">${
    [...new Set([...row.robots, usual, ...robots])].map((name) => html`<option>${name}</option>`)}</select>`;
  return html`<table class="hw-table hw-ports"><caption class="hw-caption">Plugged in</caption>
    <thead><tr><th scope="col">Port</th><th scope="col">Probably</th><th scope="col">State</th><th scope="col">Robot</th>
      <td></td></tr></thead>
    <tbody>${rows.map((row) => html`<tr><th scope="row" class="hw-code">${row.device}</th><td>${row.guess}</td>
      <td>${condition(row)}</td>
      <td>${choice(row)}</td><td>${operates && opener(row)}</td></tr>`)}</tbody></table>`;
}

/**
 * Emulated arms, of which there is no more to say than what they are.
 * @param {Port[]} rows
 * @param {boolean} operates
 */
function emulated(rows, operates) {
  return html`<h2 class="hw-caption" id="hw-without">Without hardware</h2><ul class="hw-emulated" aria-labelledby="hw-without">${rows.map((row) =>
    html`<li><span><span class="hw-code">${row.device}</span><span class="hw-dim">${row.guess}</span></span>${operates && opener(row)}</li>`)}</ul>`;
}
