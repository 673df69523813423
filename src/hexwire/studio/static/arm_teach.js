/* Teach mode and the timeline of the taught motion of the page Arm. Owns the drawing of the timeline; the cursor shows
a ghost of the arm and moves nothing. */

import { capital, showPlan } from "/static/arm.js";

const PAUSE = 150; // ms after the last change before a preview is asked for
const PAD = 6;

export function mountTeach(page) {
  const find = (name) => page.find(`#arm-${name}`);
  const hand = find("teach-hand");
  const start = find("teach-start");
  const stop = find("teach-stop");
  const note = find("teach-note");
  const box = find("taught");
  const cursor = find("time");
  const value = find("time-value");
  const factor = find("factor");
  const plan = find("play-plan");
  const plot = find("time-plot");
  let taught = null;
  let teaching = false;
  let began = 0;
  let timer = 0;
  let played = 0; // where the running play began

  const say = (text, level = "") => {
    note.textContent = text;
    note.dataset.level = level;
  };
  const need = () => {
    start.disabled = !page.mine || !hand.checked;
  };
  const show = () => {
    start.hidden = teaching;
    hand.parentElement.hidden = teaching;
    stop.hidden = !teaching;
    box.hidden = !taught || teaching;
    if (box.hidden) return;
    cursor.max = taught.duration;
    cursor.step = Math.max(0.001, taught.duration / 500);
    mark(Math.min(Number(cursor.value), taught.duration));
    draw();
  };
  const at = (time) => {
    const { times, rows, names } = taught;
    let k = times.findIndex((t) => t >= time);
    if (k < 0) k = times.length - 1;
    const a = rows[Math.max(0, k - 1)];
    const b = rows[k];
    const before = times[Math.max(0, k - 1)];
    const share = times[k] > before ? (time - before) / (times[k] - before) : 1;
    return Object.fromEntries(names.map((name, i) => [name, a[i] + share * (b[i] - a[i])]));
  };
  const mark = (time) => {
    cursor.value = time;
    value.textContent = `${time.toFixed(1)} of ${taught.duration.toFixed(1)} s`;
    cursor.setAttribute("aria-valuetext", `${time.toFixed(1)} seconds`);
    plot.parentElement.style.setProperty("--time", taught.duration > 0 ? time / taught.duration : 0);
  };
  const ghost = () => {
    const positions = page.positions();
    const here = positions ? Object.fromEntries(page.args.joints.map(({ name }, i) => [name, positions[i]])) : {};
    page.ghost({ ...here, ...at(Number(cursor.value)) });
    find("unghost").hidden = false;
  };
  const preview = async () => {
    timer = 0;
    if (!taught) return;
    const motion = { what: "play", begin: Number(cursor.value), factor: Number(factor.value), speed: page.speed };
    showPlan(plan, await page.call("preview", motion));
  };
  const soon = () => {
    clearTimeout(timer);
    timer = setTimeout(preview, PAUSE);
  };

  const draw = () => {
    const ratio = window.devicePixelRatio || 1;
    const { clientWidth: width, clientHeight: height } = plot;
    if (!width || !taught) return;
    plot.width = width * ratio;
    plot.height = height * ratio;
    const pen = plot.getContext("2d");
    pen.scale(ratio, ratio);
    pen.lineWidth = 1.5;
    const style = getComputedStyle(document.documentElement);
    // Each joint from where it began, so that a small motion is seen beside a far posture.
    const first = taught.rows[0];
    const all = taught.rows.flatMap((row) => row.map((angle, i) => angle - first[i]));
    const low = Math.min(...all, -0.05);
    const high = Math.max(...all, 0.05);
    const x = (time) => (taught.duration > 0 ? (time / taught.duration) * width : 0);
    const y = (angle) => height - PAD - ((angle - low) / (high - low)) * (height - 2 * PAD);
    taught.names.forEach((name, i) => {
      const place = page.args.joints.findIndex((joint) => joint.name === name);
      pen.strokeStyle = style.getPropertyValue(`--joint-${(place % 8) + 1}`).trim() || "#888";
      pen.beginPath();
      taught.times.forEach((time, k) => pen[k ? "lineTo" : "moveTo"](x(time), y(taught.rows[k][i] - first[i])));
      pen.stroke();
    });
  };

  page.on("taught", (told) => {
    const before = taught;
    if (told.teaching && !teaching) began = performance.now();
    teaching = told.teaching;
    taught = told.taught;
    if (taught && (!before || before.duration !== taught.duration)) cursor.value = 0;
    show();
    if (taught && !teaching) soon();
  });
  page.on("facts", need);
  page.on("need", need);
  page.on("draw", () => {
    if (!teaching) return;
    const words = `Teaching for ${((performance.now() - began) / 1000).toFixed(0)} s: move the arm by hand.`;
    if (note.textContent !== words) say(words, "warn");
  });
  hand.addEventListener("change", need);
  const teach = async (on) => {
    const answer = await page.call("teach", { on });
    if (!on) teaching = false;
    if (answer.error) say(capital(answer.error), "error");
    else say(capital(answer.text));
    if (!on) hand.checked = false;
    page.tell("taught", await page.call("taught"));
    need();
  };
  start.addEventListener("click", () => teach(true));
  stop.addEventListener("click", () => teach(false));
  cursor.addEventListener("input", () => {
    mark(Number(cursor.value));
    ghost();
    soon();
  });
  factor.addEventListener("change", soon);
  const play = (begin) => {
    played = begin;
    page.ghost(null);
    page.run({ what: "play", begin, factor: Number(factor.value) }).then((why) => {
      plan.dataset.level = ["arrived", "released", "ended"].includes(why) ? "" : "error";
      plan.textContent = why === "arrived" ? "Played." : capital(why);
    });
  };
  find("play").addEventListener("click", () => play(0));
  find("play-here").addEventListener("click", () => play(Number(cursor.value)));
  page.on("elapsed", ({ run, now }) => {
    if (!taught || teaching || run.title !== "the taught motion") return;
    mark(Math.min(taught.duration, played + Math.max(0, now - run.lead_in) * Number(factor.value)));
  });
  new ResizeObserver(draw).observe(plot);
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const again = () => {
    if (plot.isConnected) {
      draw();
      return;
    }
    dark.removeEventListener("change", again);
    themed.disconnect();
  };
  const themed = new MutationObserver(again);
  themed.observe(document.documentElement, { attributes: true, attributeFilter: ["data-theme"] });
  dark.addEventListener("change", again);
  show();
}
