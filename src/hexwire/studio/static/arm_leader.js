/* A leader arm on the page Move: choose one, see how far each joint is from it, and let the arm follow it.

Owns the form, the table and the hold. Following lasts while this page is in sight, as a motion to a goal does: whoever moves
the leader has no hand for a button. Loaded when the part is first chosen. Must not decide what may move: the server meets the
leader slowly, checks each target, and ends it by itself. */

import { capital, degrees, fixed } from "./arm.js";
import hexwire from "./live.js";
import { node } from "./widgets.js";

const NEAR = 1.5; // degrees at which a joint has met the leader's
const OTHER = "other";

export function mountLeader(page, root) {
  const joints = page.args.joints.map(({ name }) => name);
  const port = node("select", { "aria-label": "Port of the leader" });
  const address = node("input", { "aria-label": "Address of the leader", placeholder: "zenoh:lab/leader", maxlength: "200", hidden: true });
  const robot = node("input", { "aria-label": "Type or file of the leader", list: "arm-leader-robots", maxlength: "200" });
  const robots = node("datalist", { id: "arm-leader-robots" });
  const mirror = node("input", { type: "checkbox" });
  const button = (words, act, more = "") => node("button", { class: `hw-button ${more}`, type: "button", onclick: act }, words);
  const connect = button("Connect", choose, "arm-need");
  const drop = button("Disconnect", () => ask("unlead"), "arm-need");
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
    node("div", { class: "hw-row" }, page.args.jaws && node("label", {}, "Gripper stops at ", force, " % load"), start, end));
  const note = node("p", { class: "arm-note", role: "status" });
  root.append(form, chosen, note);
  let leader = null;
  let found = null;
  let following = null; // the hold
  end.hidden = true;

  const say = (text, level = "") => {
    note.textContent = text;
    note.dataset.level = level;
  };
  const ask = async (name, values = {}) => {
    const answer = await page.call(name, values);
    if (answer?.error) say(capital(answer.error), "error");
    return answer?.error ? null : { answer };
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
    const answer = await ask("leaders");
    if (!answer) return;
    found = answer.answer;
    const before = port.value;
    const rows = found.ports.map(({ device, guess, obstacle }) => [device, `${device}: ${obstacle || guess}`]);
    if (found.emulated) rows.push([found.emulated, "emulated, on this computer"]);
    rows.push([OTHER, "another address"]);
    port.replaceChildren(...rows.map(([value, words]) => node("option", { value, selected: value === before }, words)));
    robots.replaceChildren(...found.robots.map((name) => node("option", { value: name })));
    robot.value ||= found.robot;
    advise();
  }
  async function choose() {
    connect.disabled = true;
    say("The leader is being connected.");
    const url = port.value === OTHER ? address.value : port.value;
    // An emulated or shared arm says itself what it is.
    if (await ask("lead", { url, robot: url.includes(":/") || url.startsWith("zenoh:") ? "" : robot.value, mirror: mirror.checked })) say("");
    connect.disabled = !page.mine;
  }
  port.addEventListener("change", advise);
  page.on("way", (name) => name === "leader" && !leader && look());

  // -- following ----------------------------------------------------------------------------------------

  function begin() {
    const share = page.args.jaws ? { force: Number(force.value) / 100 } : {};
    const mine = (following = hexwire.hold("follow", { speed: page.speed, ...share }, { attended: true }));
    say(`The arm follows, at most at ${Math.round(100 * page.speed)} % of its speed limits, while this page is in sight.`);
    draw();
    mine.then((why) => {
      if (following === mine) following = null;
      draw();
      const fine = why === "released" || why === "ended";
      say(fine ? "The arm holds; the leader still has no torque." : `${capital(why)}. The arm holds.`, fine ? "" : "error");
    });
  }

  // -- what is shown ------------------------------------------------------------------------------------

  const put = (element, text) => element.textContent === text || (element.textContent = text);
  function draw() {
    form.hidden = leader !== null;
    chosen.hidden = leader === null;
    const pressed = [start, end].includes(document.activeElement);
    start.hidden = following !== null;
    end.hidden = following === null;
    // What was pressed is hidden now.
    if (pressed) (following ? end : start).focus({ preventScroll: true });
    if (!leader) return;
    put(named, `${leader.robot} at ${leader.url}${leader.mirror ? ", facing the arm" : ""}: ${leader.error || (leader.stopped ? "stopped" : `torque ${leader.torque || "unknown"}`)}`);
    named.dataset.level = leader.error || leader.stopped ? "error" : "";
    start.disabled = !page.mine || page.unready !== "" || leader.error !== "";
    if (!following && !page.plan) page.ghost(leader.error ? null : led());
  }
  /** Where the arm would be led, without what is unknown. */
  const led = () => Object.fromEntries(Object.entries(leader.led).filter(([, angle]) => angle !== null));
  page.on("draw", () => {
    if (!leader || root.hidden) return;
    const here = page.positions();
    joints.forEach((name, i) => {
      const to = leader.led[name] ?? NaN;
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
  if (leader === null) {
    say("Move another arm by hand, and this one follows it. Hold the leader before you press Follow: its torque goes off then, and this arm moves slowly to where the leader is.");
    look();
  }
}
