/* A leader arm on the page Move: choose one, see how far each joint is from it, and let the arm follow it.

Owns the form, the table and the hold. Following lasts while this page is in sight, as a motion to a goal does: whoever moves
the leader has no hand for a button. Loaded when the part is first chosen. Must not decide what may move: the server meets the
leader slowly, checks each target, and ends it by itself. */

import { degrees, fixed, isRefused } from "./arm.js";
import hexwire, { capital } from "./live.js";
import { node, put } from "./widgets.js";

const NEAR = 1.5; // degrees at which a joint has met the leader's
const OTHER = "other";

/** @type {Promise<string> | null} */
let following = null; // the hold: it goes on while another page is looked at

/**
 * @param {ArmPage} page
 * @param {HTMLElement} root
 */
export function mountLeader(page, root) {
  const joints = page.args.joints.map(({ name }) => name);
  const port = node("select", { "aria-label": "Port of the leader" });
  const address = node("input", { "aria-label": "Address of the leader", placeholder: "zenoh:lab/leader", maxlength: "200", hidden: true });
  const robot = node("input", { "aria-label": "Type or file of the leader", list: "arm-leader-robots", maxlength: "200" });
  const robots = node("datalist", { id: "arm-leader-robots" });
  const mirror = node("input", { type: "checkbox" });
  /** @type {(words: string, act: (event: Event) => unknown, more?: string) => HTMLButtonElement} */
  const button = (words, act, more = "") => node("button", { class: `hw-button ${more}`, type: "button", onclick: act }, words);
  const connect = button("Connect", choose, "arm-need");
  const drop = button("Disconnect", () => ask("arm.unlead"), "arm-need");
  const advice = node("p", { class: "arm-note" });
  const form = node("div", {},
    node("div", { class: "hw-row" }, port, address, node("label", {}, "Type or file ", robot), robots, node("label", {}, mirror, " the arms face each other"), connect),
    advice);
  const named = node("span", { class: "arm-leader-name" });
  const cells = joints.map(() => ["led", "here", "apart"].map(() => node("td", { class: "arm-number" }, "–")));
  const table = node("table", { class: "arm-leader", "aria-label": "Distance from the leader" },
    node("thead", {}, node("tr", {}, node("th", { scope: "col" }, "Joint"), ...["Leader °", "Arm °", "Apart °"].map((words) => node("th", { scope: "col", class: "arm-number" }, words)))),
    node("tbody", {}, ...joints.map((name, i) => node("tr", {}, node("th", { scope: "row" }, name), ...cells[i]))));
  const force = node("input", { type: "number", min: "1", max: "100", step: "1", value: "35", class: "arm-number-field", "aria-label": "Load at which the gripper stops closing, percent" });
  const start = button("Follow", begin, "arm-primary arm-need arm-whole");
  const end = button("End following", () => hexwire.release("ended"));
  const chosen = node("div", { hidden: true },
    node("div", { class: "hw-row" }, named, drop), table,
    node("div", { class: "hw-row" }, ...(page.args.jaws ? [node("label", {}, "Gripper stops at ", force, " % load")] : []), start, end));
  const note = node("p", { class: "arm-note", role: "status" });
  root.append(form, chosen, note);
  /** @type {LeaderTold["leader"]} */
  let leader = null;
  /** @type {Calls["arm.leaders"]["answer"] | null} */
  let found = null;
  end.hidden = true;

  const say = (/** @type {string} */ text, level = "") => {
    note.textContent = text;
    note.dataset.level = level;
  };
  /**
   * @template {keyof Calls} N
   * @param {N} name
   * @param {Calls[N]["args"]} values
   */
  const ask = async (name, values = {}) => {
    const answer = await page.call(name, values);
    if (!isRefused(answer)) return { answer };
    say(capital(answer.error), "error");
    return null;
  };

  // -- which ------------------------------------------------------------------------------------------

  const row = () => found?.ports.find(({ device }) => device === port.value);
  const advise = () => {
    address.hidden = port.value !== OTHER;
    const { obstacle = "", advice: words = "" } = row() ?? {};
    advice.textContent = capital([obstacle, words].filter(Boolean).join(". "));
    advice.dataset.level = obstacle ? "error" : "";
  };
  async function look() {
    if (!hexwire.operates) return;
    const answer = await ask("arm.leaders");
    if (!answer) return;
    const there = (found = answer.answer);
    const before = port.value;
    const rows = there.ports.map(({ device, guess, obstacle }) => [device, `${device}: ${obstacle || guess}`]);
    if (there.emulated) rows.push([there.emulated, "emulated, on this computer"]);
    rows.push([OTHER, "another address"]);
    port.replaceChildren(...rows.map(([value, words]) => node("option", { value, selected: value === before }, words)));
    robots.replaceChildren(...there.robots.map((name) => node("option", { value: name })));
    robot.value ||= there.robot;
    advise();
  }
  async function choose() {
    connect.disabled = true;
    say("The leader is being connected.");
    const url = port.value === OTHER ? address.value : port.value;
    // An emulated or shared arm says itself what it is.
    if (await ask("arm.lead", { url, robot: url.includes(":/") || url.startsWith("zenoh:") ? "" : robot.value, mirror: mirror.checked })) say("");
    connect.disabled = !page.mine;
  }
  port.addEventListener("change", advise);
  page.on("way", (name) => name === "leader" && !leader && look());

  // -- following ----------------------------------------------------------------------------------------

  function begin() {
    const share = page.args.jaws ? { force: Number(force.value) / 100 } : {};
    const mine = (following = hexwire.hold("follow", { speed: page.speed, ...share }, { attended: true }));
    mine.then(() => following === mine && (following = null));
    say(`The arm follows, at most at ${Math.round(100 * page.speed)} % of its speed limits, while this page is in sight.`);
    attend(mine);
  }
  /** @param {Promise<string>} mine */
  function attend(mine) {
    draw();
    mine.then((why) => {
      draw();
      const fine = why === "released" || why === "ended";
      say(fine ? "The arm holds; the leader still has no torque." : `${capital(why)}. The arm holds.`, fine ? "" : "error");
    });
  }

  // -- what is shown ------------------------------------------------------------------------------------

  function draw() {
    form.hidden = leader !== null;
    chosen.hidden = leader === null;
    const pressed = document.activeElement === start || document.activeElement === end;
    start.hidden = following !== null;
    end.hidden = following === null;
    // What was pressed is hidden now.
    if (pressed) (following ? end : start).focus({ preventScroll: true });
    if (!leader) return;
    put(named, `${leader.robot} at ${leader.url}${leader.mirror ? ", facing the arm" : ""}: ${leader.error || (leader.stopped ? "stopped" : `torque ${leader.torque || "unknown"}`)}`);
    named.dataset.level = leader.error || leader.stopped ? "error" : "";
    start.disabled = !page.mine || page.unready !== "" || leader.error !== "";
    if (!following && !page.plan) page.ghost(leader.error ? null : known(leader.led));
  }
  page.on("draw", () => {
    const here = page.positions();
    if (!leader || root.hidden || !here) return;
    const { led } = leader;
    joints.forEach((name, i) => {
      const to = led[name] ?? NaN;
      const apart = degrees(to - here[i]);
      [degrees(to), degrees(here[i]), apart].forEach((value, k) => put(cells[i][k], fixed(value)));
      const level = Math.abs(apart) > NEAR ? "warn" : "";
      if (cells[i][2].dataset.level !== level) cells[i][2].dataset.level = level;
    });
  });
  page.on("need", draw);
  hexwire.onLeader((told) => {
    const had = leader !== null;
    leader = told.leader;
    if (had && !leader) {
      page.ghost(null);
      look();
    }
    draw();
  }, root);
  if (following) attend(following);
  if (leader === null) {
    say("Move another arm by hand, and this one follows it. Hold the leader before you press Follow: its torque goes off then, and this arm moves slowly to where the leader is.");
    look();
  }
}

/**
 * Where the arm would be led, without what is unknown.
 * @param {Record<string, number | null>} led
 * @returns {Record<string, number>}
 */
const known = (led) => Object.fromEntries(Object.entries(led).flatMap(([name, angle]) => (angle === null ? [] : [[name, angle]])));
