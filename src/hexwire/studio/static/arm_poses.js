/* Poses by name, and the gripper, of the page Arm. Owns their list and buttons; the server keeps the poses. */

import { capital, fixed } from "/static/arm.js";
import { make } from "/static/widgets.js";

const SURE = 4000; // ms in which a second press confirms
const WHOLE = "arm-need arm-whole"; // needs all joints

export function mountPoses(page) {
  const list = page.find("#arm-poses");
  const form = page.find("#arm-pose-form");
  const note = page.find("#arm-pose-note");
  const say = (text, level = "") => {
    note.textContent = text;
    note.dataset.level = level;
  };
  const change = async (name, values, done) => {
    const answer = await page.call(name, values);
    if (answer.error) {
      say(capital(answer.error), "error");
      return false;
    }
    show(answer.poses);
    say(done);
    return true;
  };
  const go = (name) => {
    page.run({ what: "pose", name }).then((why) => {
      page.ghost(null);
      if (why === "arrived") say(`At ${name}.`);
      else if (why !== "released" && why !== "ended") say(capital(why), "error");
    });
  };
  const preview = async (name) => {
    const plan = await page.call("preview", { what: "pose", name, speed: page.speed });
    const fault = plan.error || plan.refusal;
    if (!plan.error && plan.known) page.ghost(plan.goal, plan.trace);
    page.find("#arm-unghost").hidden = Boolean(plan.error);
    say(fault ? capital(fault) : `${name}: ${plan.duration.toFixed(1)} s from here${plan.unready ? `; not now: ${plan.unready}` : ""}`, fault ? "error" : plan.unready ? "warn" : "");
  };
  const button = (words, label, act, need = "arm-need") => {
    const element = make("button", { type: "button", className: `hw-button arm-small ${need}`, textContent: words });
    element.setAttribute("aria-label", label);
    element.disabled = (need && !page.mine) || (need === WHOLE && page.unready !== "");
    element.addEventListener("click", () => act(element));
    return element;
  };
  const twice = (act, words) => (element) => {
    if (element.dataset.sure) {
      act();
      return;
    }
    const before = element.textContent;
    element.style.minWidth = `${element.offsetWidth}px`; // its neighbours stay where they are
    element.dataset.sure = "1";
    element.textContent = words;
    setTimeout(() => {
      delete element.dataset.sure;
      element.textContent = before;
    }, SURE);
  };
  const rename = (row, name) => {
    const input = make("input", { type: "text", value: name, maxLength: 40 });
    input.setAttribute("aria-label", `New name of ${name}`);
    const entry = make("form", { className: "hw-row" }, input, button("Keep", `Keep the new name of ${name}`, () => entry.requestSubmit()), button("Cancel", `Do not rename ${name}`, () => refresh(), ""));
    entry.addEventListener("submit", (event) => {
      event.preventDefault();
      change("rename", { name, new: input.value }, "Renamed.");
    });
    row.replaceChildren(entry);
    input.focus();
    input.select();
  };
  const show = (poses) => {
    const rows = poses.map(({ name, saved }) => {
      const row = make("li", {}, make("span", { className: "arm-pose-name", textContent: name, title: name }));
      row.append(button("Go", `Go to ${name}`, () => go(name), WHOLE), button("Show", `Preview ${name}`, () => preview(name), ""));
      if (saved) {
        row.append(
          button("Replace", `Replace ${name} by the present pose`, twice(() => change("save", { name, force: true, gripper: form.elements.gripper ? form.elements.gripper.checked : true }, `${name} is the present pose now.`), "Sure?")),
          button("Rename", `Rename ${name}`, () => rename(row, name)),
          button("Remove", `Remove ${name}`, twice(() => change("remove", { name }, `${name} is removed.`), "Sure?")),
        );
      } else {
        row.append(make("span", { className: "arm-note", textContent: name === "home" ? "the middle of every joint" : "from the settings" }));
      }
      return row;
    });
    list.replaceChildren(...rows);
  };
  const refresh = async () => {
    const answer = await page.call("poses");
    if (answer.error) say(capital(answer.error), "error");
    else show(answer.poses);
  };
  form.addEventListener("submit", async (event) => {
    event.preventDefault();
    const name = form.elements.name.value;
    const gripper = form.elements.gripper ? form.elements.gripper.checked : true;
    if (await change("save", { name, gripper }, `Saved ${name.trim()}.`)) form.elements.name.value = "";
  });
  refresh();
}

export function mountGripper(page) {
  const form = page.find("#arm-grip");
  const jaws = page.args.jaws;
  if (!form || !jaws) return;
  const bar = page.find("#arm-grip-bar");
  const value = page.find("#arm-grip-value");
  const place = page.args.joints.findIndex((joint) => joint.name === jaws.joint);
  const set = (share) => page.run({ what: "grip", share }).then((why) => {
    if (!["arrived", "released", "ended"].includes(why)) page.tell("why", why);
  });
  for (const button of form.querySelectorAll("[data-share]")) {
    button.addEventListener("click", () => set(Number(button.dataset.share)));
  }
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    if (page.mine) set(Number(form.elements.share.value) / 100);
  });
  let shown = "";
  page.on("draw", () => {
    const share = (page.positions()[place] - jaws.closed) / (jaws.opened - jaws.closed);
    const text = `${fixed(100 * share, 0)} % open`;
    if (text === shown) return;
    shown = text;
    value.textContent = text;
    bar.value = Number.isFinite(share) ? Math.min(1, Math.max(0, share)) : 0;
  });
}
